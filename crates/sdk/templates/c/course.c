/* The stage `@name@` for the slot course: angles and course, from the fused attitude. */
#include "plumbline.h"

#define TURN_RAD (2.0 * PLUMBLINE_PI)
/* Nearer to the vertical yaw and roll are not told apart: 89 degrees. */
#define GIMBAL_RAD 1.553343

/* The course is the fuser's heading, counted clockwise, and the declination where it is magnetic. */
static struct { plumbline_last_reading last; } state = {{{0.0, 0.0, 0.0, 1.0}, 0.0, 0.0, 0.0, 0.0}};
static struct { double declination_deg; } settings;
static const plumbline_parameter parameters[] = {
    {"declination_deg", "°", -180.0, 180.0, 0.0, "Magnetic declination, east positive: makes a magnetic course a true one."},
};

static void step(const plumbline_course_input *input, plumbline_reading *output)
{
    const int made_true = input->reference == PLUMBLINE_MAGNETIC && settings.declination_deg != 0.0;
    double *quaternion = output->quaternion_xyzw, dot = 0.0;
    output->declination_rad = made_true ? settings.declination_deg * (PLUMBLINE_PI / 180.0) : 0.0;
    output->reference = made_true ? (double)PLUMBLINE_TRUE : input->reference;
    plumbline_angles(&input->attitude, &output->yaw_rad, &output->pitch_rad, &output->roll_rad);
    output->course_rad = fmod(output->declination_rad - output->yaw_rad, TURN_RAD);
    if (output->course_rad < 0.0) output->course_rad = fmod(output->course_rad + TURN_RAD, TURN_RAD);
    output->course_sd_rad = input->heading_sd_rad >= 0.0 ? fmin(input->heading_sd_rad, PLUMBLINE_PI) : PLUMBLINE_PI;
    plumbline_quaternion(&input->attitude, quaternion);
    /* The other sign is the same attitude, and a jump for whoever interpolates. */
    for (int i = 0; i < 4; i++) dot += quaternion[i] * state.last.quaternion_xyzw[i];
    for (int i = 0; i < 4 && dot < 0.0; i++) quaternion[i] = -quaternion[i];
    output->near_gimbal = fabs(output->pitch_rad) > GIMBAL_RAD;
    output->aligned = state.last.has_course && state.last.reference != output->reference;
    memcpy(state.last.quaternion_xyzw, quaternion, sizeof state.last.quaternion_xyzw);
    state.last.has_course = 1.0;
    state.last.course_rad = output->course_rad;
    state.last.reference = output->reference;
    state.last.sd_rad = output->course_sd_rad;
}

static const char *check(const void *numbers)
{
    const plumbline_last_reading *it = (const plumbline_last_reading *)numbers;
    double size2 = 0.0;
    for (int i = 0; i < 4; i++) size2 += it->quaternion_xyzw[i] * it->quaternion_xyzw[i];
    if (!(fabs(size2 - 1.0) <= 1e-6)) return "a quaternion that is not of unit length";
    const int sound = it->course_rad >= 0.0 && it->course_rad < TURN_RAD && it->sd_rad >= 0.0;
    return sound || !it->has_course ? NULL : "a course that is none";
}

static void common(plumbline_last_reading *it) { *it = state.last; }

static int adopt(const plumbline_last_reading *it)
{
    if (check(it) != NULL) return -1;
    state.last = *it;
    return 0;
}

int main(void)
{
    const plumbline_course course = {
        {parameters, 1, &settings.declination_deg, (double *)&state, PLUMBLINE_COUNT(state), check}, step, common, adopt,
    };
    return plumbline_run_course(&course);
}
