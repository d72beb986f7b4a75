/* Stage `@name@` for the slot course: angles and course, from the fused attitude. */
#include "plumbline.h"

#define REVOLUTION_RAD (2.0 * PLUMBLINE_PI)
/* Pitch beyond which yaw and roll cannot be separated: 89 degrees. */
#define GIMBAL_RAD 1.553343

/* The course is the fuser's heading, measured clockwise. The declination is added if the heading is
   magnetic. */
static struct { plumbline_last_reading last; } state = {{{0.0, 0.0, 0.0, 1.0}, 0.0, 0.0, 0.0, 0.0}};
static struct { double declination_deg; } settings;
static const plumbline_parameter parameters[] = {
    {"declination_deg", "°", -180.0, 180.0, 0.0, "Magnetic declination, east positive. It converts a magnetic course to a true one."},
};

static void step(const plumbline_course_input *input, plumbline_course_reading *output)
{
    const int is_corrected = input->reference == PLUMBLINE_MAGNETIC && settings.declination_deg != 0.0;
    double *quaternion = output->quaternion_xyzw, dot = 0.0;
    output->declination_rad = is_corrected ? settings.declination_deg * (PLUMBLINE_PI / 180.0) : 0.0;
    output->reference = is_corrected ? (double)PLUMBLINE_TRUE : input->reference;
    plumbline_angles(&input->attitude, &output->yaw_rad, &output->pitch_rad, &output->roll_rad);
    output->course_rad = fmod(output->declination_rad - output->yaw_rad, REVOLUTION_RAD);
    if (output->course_rad < 0.0) output->course_rad = fmod(output->course_rad + REVOLUTION_RAD, REVOLUTION_RAD);
    output->course_sd_rad = input->heading_sd_rad >= 0.0 ? fmin(input->heading_sd_rad, PLUMBLINE_PI) : PLUMBLINE_PI;
    plumbline_quaternion(&input->attitude, quaternion);
    /* The sign is kept continuous, because a change of sign would break interpolation. */
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

static const char *validation_error(const void *numbers)
{
    const plumbline_last_reading *last = (const plumbline_last_reading *)numbers;
    double norm_squared = 0.0;
    for (int i = 0; i < 4; i++) norm_squared += last->quaternion_xyzw[i] * last->quaternion_xyzw[i];
    if (!(fabs(norm_squared - 1.0) <= 1e-6)) return "a quaternion that is not of unit length";
    const int valid = last->course_rad >= 0.0 && last->course_rad < REVOLUTION_RAD && last->sd_rad >= 0.0;
    return valid || !last->has_course ? NULL : "a course outside [0, 2π) or a negative standard deviation";
}

static void common(plumbline_last_reading *last) { *last = state.last; }

static int adopt(const plumbline_last_reading *last)
{
    if (validation_error(last) != NULL) return -1;
    state.last = *last;
    return 0;
}

int main(void)
{
    const plumbline_course course = {
        {parameters, 1, &settings.declination_deg, (double *)&state, PLUMBLINE_COUNT(state), validation_error}, step, common, adopt,
    };
    return plumbline_run_course(&course);
}
