/* Stage `@name@` for the slot fuser: the attitude, from gyro and accelerometer. */
#include "plumbline.h"

/* Complementary filter: the attitude follows the gyro, and each tick corrects a fraction
   1 - exp(-dt/T) of the tilt difference from the accelerometer. */
static struct { plumbline_attitude attitude; double started; } state;
static struct { double time_constant_s; } settings;
static const plumbline_parameter parameters[] = {
    {"time_constant_s", "s", 0.01, 1000.0, 1.0, "Time constant of the correction of the tilt towards the accelerometer."},
};

static void step(const plumbline_fuser_input *input, plumbline_fused *output)
{
    const plumbline_point *up = &input->inclination.up;
    double direction[3], own[3], re, im, dt_s = 0.0;
    if (input->has_motion) {
        state.attitude = plumbline_rotated(&state.attitude, &input->motion.rotation);
        memcpy(output->rate_rad_s, input->motion.rate_rad_s, sizeof output->rate_rad_s);
        dt_s = input->motion.dt_s;
    }
    if (input->has_inclination && !state.started) {
        state.attitude = plumbline_realigned(&state.attitude, up);
        state.started = output->aligned = 1.0;
    } else if (input->has_inclination) {
        plumbline_direction(up, direction);
        plumbline_direction(&state.attitude.up, own);
        const double vertical = 1.0 + direction[0] * own[0] + direction[1] * own[1] + direction[2] * own[2];
        if (vertical > 1e-6) {
            const double gain = -expm1(-dt_s / settings.time_constant_s) / vertical;
            plumbline_horizontal(&state.attitude, direction, &re, &im);
            output->innovation_rad = 2.0 * atan(hypot(re, im) / vertical);
            state.attitude = plumbline_tilted(&state.attitude, re * gain, im * gain);
            output->tilt = 1.0;
        }
    }
    output->attitude = state.attitude;
    output->inclination_sd_rad = 0.1;
    output->heading_sd_rad = PLUMBLINE_PI;
}

/* Re-initialises the level from the next inclination, for example after a gap in the data. */
static void realign(void) { state.started = 0.0; }

static const char *validation_error(const void *numbers)
{
    return plumbline_attitude_validation_error((const plumbline_attitude *)numbers);
}

static void common(plumbline_estimate *estimate)
{
    estimate->attitude = state.attitude;
    estimate->inclination_sd_rad = 0.1;
    estimate->heading_sd_rad = PLUMBLINE_PI;
    estimate->bias_sd_rad_s = estimate->hard_iron_sd_ut = estimate->leaky_velocity_sd_m_s = INFINITY;
    for (int i = 0; i < 3; i++) estimate->gyro_scale_sd[i] = INFINITY;
}

static int adopt(const plumbline_estimate *estimate)
{
    if (plumbline_estimate_validation_error(estimate) != NULL) return -1;
    state.attitude = estimate->attitude;
    state.started = 1.0;
    return 0;
}

int main(void)
{
    const plumbline_fuser fuser = {
        {parameters, 1, &settings.time_constant_s, (double *)&state, PLUMBLINE_COUNT(state), validation_error}, step, common, adopt, realign,
    };
    return plumbline_run_fuser(&fuser);
}
