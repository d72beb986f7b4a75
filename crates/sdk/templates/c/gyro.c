/* Stage `@name@` for the slot gyro: the rotation of the body over each interval, from its rate. */
#include "plumbline.h"

/* Limit to which rates are clamped. It is above the range of any gyro. */
#define MAX_RATE_RAD_S 1000.0

/* The attitude is rotated by the mean rate over the interval, which is exact if the rate is
   constant. */
static struct { plumbline_attitude attitude; double started, previous_rad_s[3]; } state;

static void step(const plumbline_rate_sample *sample, plumbline_motion *motion)
{
    double mean_rad_s[3];
    for (int i = 0; i < 3; i++) {
        const double end_rad_s = fmax(-MAX_RATE_RAD_S, fmin(MAX_RATE_RAD_S, sample->rate_rad_s[i]));
        /* If the rate is known at both ends of the interval, the mean is half their sum. */
        const double start_rad_s = state.started && sample->instant ? state.previous_rad_s[i] : end_rad_s;
        mean_rad_s[i] = 0.5 * (start_rad_s + end_rad_s);
        state.previous_rad_s[i] = end_rad_s;
    }
    state.started = 1.0;
    motion->dt_s = sample->dt_s;
    motion->rotation = plumbline_rotation_from_vector(mean_rad_s[0] * motion->dt_s, mean_rad_s[1] * motion->dt_s,
                                                      mean_rad_s[2] * motion->dt_s);
    motion->attitude = state.attitude = plumbline_rotated(&state.attitude, &motion->rotation);
    memcpy(motion->rate_rad_s, mean_rad_s, sizeof mean_rad_s);
}

/* Sets the attitude from which to integrate. */
static void align(const plumbline_attitude *attitude) { state.attitude = *attitude; }

static const char *validation_error(const void *numbers)
{
    const double *rate_rad_s = (const double *)numbers + 5;
    for (int i = 0; i < 3; i++) {
        if (!(fabs(rate_rad_s[i]) <= MAX_RATE_RAD_S)) return "a rate above 1000 rad/s";
    }
    return plumbline_attitude_validation_error((const plumbline_attitude *)numbers);
}

static void common(plumbline_attitude *attitude) { *attitude = state.attitude; }

static int adopt(const plumbline_attitude *attitude)
{
    if (plumbline_attitude_validation_error(attitude) != NULL) return -1;
    state.attitude = *attitude;
    return 0;
}

int main(void)
{
    const plumbline_gyro gyro = {{NULL, 0, NULL, (double *)&state, PLUMBLINE_COUNT(state), validation_error}, step, common, adopt, align};
    return plumbline_run_gyro(&gyro);
}
