/* Stage `@name@` for the slot accel: the measured up direction, from the specific force. */
#include "plumbline.h"

#define GRAVITY_M_S2 9.80665
/* Smallest usable force. The direction of a smaller force is only noise. */
#define MIN_FORCE_M_S2 0.5

/* Up is the direction of the force. The trust decreases with the difference from gravity. */
static struct { plumbline_point up; } state;
static struct { double zero_trust_difference_g; } settings;
static const plumbline_parameter parameters[] = {
    {"zero_trust_difference_g", "g", 0.001, 10.0, 0.5, "Difference from gravity at which the trust in a force is zero."},
};

static void step(const plumbline_force *force, plumbline_inclination *output)
{
    const double norm_m_s2 = hypot(hypot(force->m_s2[0], force->m_s2[1]), force->m_s2[2]);
    const int usable = norm_m_s2 >= MIN_FORCE_M_S2 && plumbline_point_from_direction(force->m_s2, &state.up);
    output->up = state.up;
    memcpy(output->force_m_s2, force->m_s2, sizeof output->force_m_s2);
    output->norm_m_s2 = fmin(norm_m_s2, 1e300);
    output->trust = usable ? fmax(0.0, 1.0 - fabs(norm_m_s2 / GRAVITY_M_S2 - 1.0) / settings.zero_trust_difference_g) : 0.0;
}

static const char *validation_error(const void *numbers)
{
    const plumbline_attitude attitude = {*(const plumbline_point *)numbers, 0.0};
    return plumbline_attitude_validation_error(&attitude);
}

static void common(plumbline_point *up) { *up = state.up; }

static int adopt(const plumbline_point *up)
{
    if (validation_error(up) != NULL) return -1;
    state.up = *up;
    return 0;
}

int main(void)
{
    const plumbline_accel accel = {
        {parameters, 1, &settings.zero_trust_difference_g, (double *)&state, PLUMBLINE_COUNT(state), validation_error}, step, common, adopt,
    };
    return plumbline_run_accel(&accel);
}
