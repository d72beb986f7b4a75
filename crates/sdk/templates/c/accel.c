/* The stage `@name@` for the slot accel: where up seems to be, from the specific force. */
#include "plumbline.h"

#define GRAVITY_M_S2 9.80665
/* Below this the direction of the force is noise. */
#define FORCE_MIN_M_S2 0.5

/* Up is where the force points, trusted as far as the force is as large as gravity. */
static struct { plumbline_point up; } state;
static struct { double distrusted_g; } settings;
static const plumbline_parameter parameters[] = {
    {"distrusted_g", "g", 0.001, 10.0, 0.5, "Difference from gravity at which a force is no longer trusted."},
};

static void step(const plumbline_force *force, plumbline_inclination *output)
{
    const double norm_m_s2 = hypot(hypot(force->m_s2[0], force->m_s2[1]), force->m_s2[2]);
    const int seen = norm_m_s2 >= FORCE_MIN_M_S2 && plumbline_point_of(force->m_s2, &state.up);
    output->up = state.up;
    memcpy(output->force_m_s2, force->m_s2, sizeof output->force_m_s2);
    output->norm_m_s2 = fmin(norm_m_s2, 1e300);
    output->trust = seen ? fmax(0.0, 1.0 - fabs(norm_m_s2 / GRAVITY_M_S2 - 1.0) / settings.distrusted_g) : 0.0;
}

static const char *check(const void *numbers)
{
    const plumbline_attitude levelled = {*(const plumbline_point *)numbers, 0.0};
    return plumbline_check_attitude(&levelled);
}

static void common(plumbline_point *it) { *it = state.up; }

static int adopt(const plumbline_point *it)
{
    if (check(it) != NULL) return -1;
    state.up = *it;
    return 0;
}

int main(void)
{
    const plumbline_accel accel = {
        {parameters, 1, &settings.distrusted_g, (double *)&state, PLUMBLINE_COUNT(state), check}, step, common, adopt,
    };
    return plumbline_run_accel(&accel);
}
