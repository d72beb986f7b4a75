/* The stage `@name@` for the slot gyro: how the body turned over each interval, from its rate. */
#include "plumbline.h"

/* Faster than any gyro's range; what is beyond it is taken for this. */
#define RATE_MAX_RAD_S 1000.0

/* Turns by the mean rate of the interval: exact while the rate is constant. */
static struct { plumbline_attitude attitude; double started, before_rad_s[3]; } state;

static void step(const plumbline_rate_sample *sample, plumbline_motion *motion)
{
    double mean_rad_s[3];
    for (int i = 0; i < 3; i++) {
        const double after_rad_s = fmax(-RATE_MAX_RAD_S, fmin(RATE_MAX_RAD_S, sample->rate_rad_s[i]));
        /* The mean of an interval of which both ends are known is half their sum. */
        const double before_rad_s = state.started && sample->instant ? state.before_rad_s[i] : after_rad_s;
        mean_rad_s[i] = 0.5 * (before_rad_s + after_rad_s);
        state.before_rad_s[i] = after_rad_s;
    }
    state.started = 1.0;
    motion->dt_s = sample->dt_s;
    motion->turn = plumbline_turn_of(mean_rad_s[0] * motion->dt_s, mean_rad_s[1] * motion->dt_s, mean_rad_s[2] * motion->dt_s);
    motion->attitude = state.attitude = plumbline_turned(&state.attitude, &motion->turn);
    memcpy(motion->rate_rad_s, mean_rad_s, sizeof mean_rad_s);
}

/* Where to integrate from. */
static void align(const plumbline_attitude *attitude) { state.attitude = *attitude; }

static const char *check(const void *numbers)
{
    const double *rate_rad_s = (const double *)numbers + 5;
    for (int i = 0; i < 3; i++) {
        if (!(fabs(rate_rad_s[i]) <= RATE_MAX_RAD_S)) return "a rate that no gyro gives";
    }
    return plumbline_check_attitude((const plumbline_attitude *)numbers);
}

static void common(plumbline_attitude *it) { *it = state.attitude; }

static int adopt(const plumbline_attitude *it)
{
    if (plumbline_check_attitude(it) != NULL) return -1;
    state.attitude = *it;
    return 0;
}

int main(void)
{
    const plumbline_gyro gyro = {{NULL, 0, NULL, (double *)&state, PLUMBLINE_COUNT(state), check}, step, common, adopt, align};
    return plumbline_run_gyro(&gyro);
}
