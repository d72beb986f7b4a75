/* The stage `@name@` for the slot fuser: where up is, from the gyro's motion and the accelerometer's direction. */
#include "plumbline.h"

/* Turns with the gyro and leans towards the accelerometer, by 1 - exp(-dt/T) of the way at each tick. */
static struct { plumbline_attitude attitude; double started; } state;
static struct { double time_constant_s; } settings;
static const plumbline_parameter parameters[] = {
    {"time_constant_s", "s", 0.01, 1000.0, 1.0, "What is faster comes from the gyro, what is slower from the accelerometer."},
};

static void step(const plumbline_fuser_input *input, plumbline_fused *output)
{
    const plumbline_point *up = &input->inclination.up;
    double seen[3], own[3], re, im, dt_s = 0.0;
    if (input->has_motion) {
        state.attitude = plumbline_turned(&state.attitude, &input->motion.turn);
        memcpy(output->rate_rad_s, input->motion.rate_rad_s, sizeof output->rate_rad_s);
        dt_s = input->motion.dt_s;
    }
    if (input->has_inclination && !state.started) {
        state.attitude = plumbline_realigned(&state.attitude, up);
        state.started = output->aligned = 1.0;
    } else if (input->has_inclination) {
        plumbline_direction(up, seen);
        plumbline_direction(&state.attitude.up, own);
        const double vertical = 1.0 + seen[0] * own[0] + seen[1] * own[1] + seen[2] * own[2];
        if (vertical > 1e-6) {
            const double share = -expm1(-dt_s / settings.time_constant_s) / vertical;
            plumbline_horizontal(&state.attitude, seen, &re, &im);
            output->innovation_rad = 2.0 * atan(hypot(re, im) / vertical);
            state.attitude = plumbline_leaned(&state.attitude, re * share, im * share);
            output->tilt = 1.0;
        }
    }
    output->attitude = state.attitude;
    output->inclination_sd_rad = 0.1;
    output->heading_sd_rad = PLUMBLINE_PI;
}

/* After a gap in which the body may have turned anywhere: the next inclination sets the level anew. */
static void realign(void) { state.started = 0.0; }

static const char *check(const void *numbers) { return plumbline_check_attitude((const plumbline_attitude *)numbers); }

static void common(plumbline_estimate *it)
{
    it->attitude = state.attitude;
    it->inclination_sd_rad = 0.1;
    it->heading_sd_rad = PLUMBLINE_PI;
    it->bias_sd_rad_s = it->hard_iron_sd_ut = it->leaky_velocity_sd_m_s = INFINITY;
    for (int i = 0; i < 3; i++) it->gyro_scale_sd[i] = INFINITY;
}

static int adopt(const plumbline_estimate *it)
{
    if (plumbline_check_estimate(it) != NULL) return -1;
    state.attitude = it->attitude;
    state.started = 1.0;
    return 0;
}

int main(void)
{
    const plumbline_fuser fuser = {
        {parameters, 1, &settings.time_constant_s, (double *)&state, PLUMBLINE_COUNT(state), check}, step, common, adopt, realign,
    };
    return plumbline_run_fuser(&fuser);
}
