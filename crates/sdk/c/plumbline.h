/*
 * Library for Plumbline stages in C or C++. A stage is a single file that includes this header.
 *
 * A stage consists of the numbers that form its state and of a few functions. Its main function
 * returns plumbline_run_fuser(&stage), or the corresponding function of another slot. Plumbline
 * starts the program and sends requests to its standard input. Printed output is shown to the user.
 *
 * The structures for inputs, outputs and states contain only doubles, in the order in which they
 * are transmitted. A boolean is 0 or 1. All numbers in the input of a stage are finite.
 *
 * Requires C99 or C++11, Linux and -lm.
 */
#ifndef PLUMBLINE_H
#define PLUMBLINE_H

#include <math.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/socket.h>

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "frames are little-endian; big-endian machines are not supported"
#endif

#define PLUMBLINE_VERSION 2
#define PLUMBLINE_MAX_STATE_VALUES 1536
#define PLUMBLINE_MAX_FRAME_BYTES 16384
#define PLUMBLINE_PI 3.14159265358979323846

/* Reference directions of a heading or course: initial direction, magnetic north, true north. */
enum { PLUMBLINE_ARBITRARY = 0, PLUMBLINE_MAGNETIC = 1, PLUMBLINE_TRUE = 2 };

/* ---- Quantities as defined in Matveev 2025. Body axes are right, forward, up. ---- */

/* Unit vector in body axes: w = u + j v is projected from -zeta or, if inverted, from +zeta. */
typedef struct { double inverted, u, v; } plumbline_point;
/* Attitude: a rotation z about the vertical, followed by the shortest rotation that tilts the body
   to w. */
typedef struct { plumbline_point up; double z_rad; } plumbline_attitude;
/* Rotation of the body in its own axes: the unit quaternion d0 + d1 i + d2 j + d3 k with
   p = d0 + j d3 and s = d1 + j d2. */
typedef struct { double p_re, p_im, s_re, s_im; } plumbline_rotation;

/* ---- Inputs, outputs and common states of the slots. ---- */

/* Input of gyro. `instant`: 1 if the rate is the value at the end of the interval, 0 if it is the
   mean over the interval. */
typedef struct { double rate_rad_s[3], dt_s, instant; } plumbline_rate_sample;
/* Output of gyro: the open-loop attitude, the rotation and the mean rate over the interval. */
typedef struct { plumbline_attitude attitude; plumbline_rotation rotation; double rate_rad_s[3], dt_s; } plumbline_motion;
/* Input of accel: the specific force, m/s^2. */
typedef struct { double m_s2[3]; } plumbline_force;
/* Output of accel. `trust`: 1 at |f| = g, 0 if `up` was not computed from this force. */
typedef struct { plumbline_point up; double force_m_s2[3], norm_m_s2, trust; } plumbline_inclination;
/* Fix from a satellite receiver. The velocity over ground has the components east, north and up. An
   optional value is valid if its `has_` flag is 1. */
typedef struct {
    double velocity_m_s[3], has_sd, sd_m_s, has_age, age_s, has_latitude, latitude_rad;
} plumbline_fix;
/* Input of fuser. A part is valid if its `has_` flag is 1. `rest_credible`: the sensors are
   working, so constant readings mean rest. `rate_credible`: the measured motion is that of the
   body. */
typedef struct {
    double has_motion; plumbline_motion motion;
    double has_inclination; plumbline_inclination inclination;
    double has_field, field_ut[3];
    double has_fix; plumbline_fix fix;
    double rest_credible, rate_credible;
} plumbline_fuser_input;
/* Output of fuser. The standard deviation of an unknown heading is pi. The last seven fields are
   the corrections and states of the tick. `aligned`: the attitude was re-initialised and jumps. */
typedef struct {
    plumbline_attitude attitude;
    double rate_rad_s[3], bias_rad_s[3], innovation_rad, inclination_sd_rad, heading_sd_rad, reference;
    double tilt, bias, magnetic, velocity, disturbed, rest, aligned;
} plumbline_fused;
/* Common state of fuser. Infinite standard deviations mean "unknown". */
typedef struct {
    plumbline_attitude attitude;
    double reference, bias_rad_s[3], inclination_sd_rad, heading_sd_rad, bias_sd_rad_s;
    /* Relative scale error of the rate about each axis. */
    double gyro_scale[3], gyro_scale_sd[3];
    double hard_iron_ut[3], hard_iron_sd_ut;
    /* Leaky integral V of the horizontal specific force h: V' = h - V/T, where T is 1.5 to 3 s. A
       levelling loop tilts its level at a rate proportional to V. The components are east and north
       in the attitude's reference frame. If V is unknown, it is 0 and its standard deviation is
       infinite. */
    double leaky_velocity_m_s[2], leaky_velocity_sd_m_s;
} plumbline_estimate;
/* Input of course. */
typedef struct {
    plumbline_attitude attitude;
    double reference, heading_sd_rad, has_fix; plumbline_fix fix;
    double dt_s;
} plumbline_course_input;
/* Output of course. The course is measured clockwise from above, in [0, 2 pi). The declination is
   the one that was added to a magnetic heading. The quaternion rotates from the body to the
   reference frame, and its components are in the order i, j, k, w. */
typedef struct {
    double yaw_rad, pitch_rad, roll_rad, course_rad, reference, course_sd_rad, declination_rad, quaternion_xyzw[4];
    double near_gimbal, aligned;
} plumbline_course_reading;
/* Common state of course. */
typedef struct { double quaternion_xyzw[4], has_course, course_rad, reference, sd_rad; } plumbline_last_reading;

/* ---- Stages. ---- */

/* Adjustable parameter. Its name ends with the unit, as in time_constant_s. */
typedef struct { const char *name, *unit; double min, max, default_value; const char *description; } plumbline_parameter;

/* Members that stages of all slots have. `settings` contains the values of the parameters, in the
   same order, and `state` contains all numbers on which the next output depends. `validation_error`
   returns why a state is invalid, or NULL if it is valid. */
typedef struct {
    const plumbline_parameter *parameters;
    int parameter_count;
    double *settings;
    double *state;
    int state_count;
    const char *(*validation_error)(const void *state);
} plumbline_stage;

/* Number of values in a structure that consists of double only. */
#define PLUMBLINE_COUNT(structure) ((int)(sizeof(structure) / sizeof(double)))

enum {
    PLUMBLINE_DESCRIBE = 1, PLUMBLINE_SET, PLUMBLINE_STEP, PLUMBLINE_SNAPSHOT, PLUMBLINE_RESTORE,
    PLUMBLINE_COMMON, PLUMBLINE_ADOPT, PLUMBLINE_ALIGN, PLUMBLINE_REALIGN
};

typedef struct { uint16_t version, kind; uint32_t rejected; uint64_t number; } plumbline_frame_header;
/* Handles a request that depends on the slot. Returns the length of the response in bytes, or -1 to
   reject the request. */
typedef int (*plumbline_slot_handler)(const void *stage, int kind, const double *payload, int count, double *response);

/* Writes the slot and the parameters of a stage as tab-separated lines. Returns the length. */
static inline int plumbline_describe(const plumbline_stage *stage, const char *slot, char *text, size_t room)
{
    int length = snprintf(text, room, "slot\t%s\n", slot);
    for (int i = 0; i < stage->parameter_count && length > 0 && (size_t)length < room; i++) {
        const plumbline_parameter *parameter = &stage->parameters[i];
        length += snprintf(text + length, room - (size_t)length, "parameter\t%s\t%s\t%.17g\t%.17g\t%.17g\t%s\n", parameter->name,
                           parameter->unit, parameter->default_value, parameter->min, parameter->max, parameter->description);
    }
    return length;
}

/* Handles a request. Returns the length of the response in bytes, or -1 to reject the request. */
static inline int plumbline_handle(const plumbline_stage *stage, const char *slot, plumbline_slot_handler handle_slot_request,
                                   const void *slot_stage, int kind, const double *payload, int count, double *response)
{
    const int bytes = stage->state_count * (int)sizeof(double);
    switch (kind) {
    case PLUMBLINE_DESCRIBE:
        return plumbline_describe(stage, slot, (char *)response, PLUMBLINE_MAX_FRAME_BYTES - sizeof(plumbline_frame_header));
    case PLUMBLINE_SET: {
        const int index = count == 2 ? (int)payload[0] : -1;
        if (index < 0 || index >= stage->parameter_count) return -1;
        const plumbline_parameter *parameter = &stage->parameters[index];
        if (!(parameter->min <= payload[1] && payload[1] <= parameter->max)) return -1;
        stage->settings[index] = payload[1];
        return 0;
    }
    case PLUMBLINE_SNAPSHOT:
        memcpy(response, stage->state, (size_t)bytes);
        return bytes;
    case PLUMBLINE_RESTORE:
        if (count != stage->state_count || stage->validation_error(payload) != NULL) return -1;
        memcpy(stage->state, payload, (size_t)bytes);
        return 0;
    default:
        return handle_slot_request(slot_stage, kind, payload, count, response);
    }
}

/* Handles requests until the service closes the socket. Returns the exit code. */
static inline int plumbline_run(const plumbline_stage *stage, const char *slot, plumbline_slot_handler handle_slot_request,
                                const void *slot_stage)
{
    static struct {
        plumbline_frame_header header;
        double numbers[(PLUMBLINE_MAX_FRAME_BYTES - sizeof(plumbline_frame_header)) / sizeof(double)];
    } in, out;
    /* The kernel kills the program when the service ends, even during an endless step. */
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    for (int i = 0; i < stage->parameter_count; i++) stage->settings[i] = stage->parameters[i].default_value;
    if (stage->state_count > PLUMBLINE_MAX_STATE_VALUES) {
        return fprintf(stderr, "the state has %d numbers, at most %d are allowed\n", stage->state_count, PLUMBLINE_MAX_STATE_VALUES), 1;
    }
    for (;;) {
        const ssize_t received = recv(0, &in, sizeof in, 0);
        if (received == 0) return 0;
        if (received < (ssize_t)sizeof in.header) {
            return perror("Plumbline starts the stage, try `plumb stage test`; socket on standard input"), 1;
        }
        if (in.header.version != PLUMBLINE_VERSION) {
            return fprintf(stderr, "the frame has version %d, expected %d; update plumbline.h with `plumb stage new`\n", in.header.version,
                           PLUMBLINE_VERSION), 1;
        }
        const int count = (int)(((size_t)received - sizeof in.header) / sizeof(double));
        const int bytes = plumbline_handle(stage, slot, handle_slot_request, slot_stage, in.header.kind, in.numbers, count, out.numbers);
        out.header = in.header;
        out.header.rejected = bytes < 0;
        if (send(0, &out, sizeof out.header + (size_t)(bytes < 0 ? 0 : bytes), MSG_NOSIGNAL) < 0) return perror("sending a response"), 1;
    }
}

/* Declares the stage type of a slot and its run function. `step` processes one tick. `common`
   writes the state that another stage can adopt. `adopt` continues from such a state and returns 0,
   or rejects the state and returns another value. */
#define PLUMBLINE_SLOT(NAME, INPUT, OUTPUT, COMMON, FIELD, CASE)                                                                           \
    typedef struct {                                                                                                                       \
        plumbline_stage stage;                                                                                                             \
        void (*step)(const INPUT *input, OUTPUT *output);                                                                                  \
        void (*common)(COMMON *common);                                                                                                    \
        int (*adopt)(const COMMON *common);                                                                                                \
        FIELD                                                                                                                              \
    } plumbline_##NAME;                                                                                                                    \
    static inline int plumbline_handle_##NAME(const void *slot_stage, int kind, const double *payload, int count, double *response)        \
    {                                                                                                                                      \
        const plumbline_##NAME *stage = (const plumbline_##NAME *)slot_stage;                                                              \
        switch (kind) {                                                                                                                    \
        case PLUMBLINE_STEP:                                                                                                               \
            if (count != PLUMBLINE_COUNT(INPUT)) return -1;                                                                                \
            memset(response, 0, sizeof(OUTPUT));                                                                                           \
            stage->step((const INPUT *)(const void *)payload, (OUTPUT *)(void *)response);                                                 \
            return (int)sizeof(OUTPUT);                                                                                                    \
        case PLUMBLINE_COMMON:                                                                                                             \
            memset(response, 0, sizeof(COMMON));                                                                                           \
            stage->common((COMMON *)(void *)response);                                                                                     \
            return (int)sizeof(COMMON);                                                                                                    \
        case PLUMBLINE_ADOPT:                                                                                                              \
            return count == PLUMBLINE_COUNT(COMMON) && stage->adopt((const COMMON *)(const void *)payload) == 0 ? 0 : -1;                  \
            CASE                                                                                                                           \
        default: return -1;                                                                                                                \
        }                                                                                                                                  \
    }                                                                                                                                      \
    static inline int plumbline_run_##NAME(const plumbline_##NAME *stage)                                                                  \
    {                                                                                                                                      \
        return plumbline_run(&stage->stage, #NAME, plumbline_handle_##NAME, stage);                                                        \
    }

/* Functions that only one slot has: `align` sets the attitude from which a gyro stage integrates,
   and `realign` makes a fuser re-initialise the level from the next inclination. */
PLUMBLINE_SLOT(gyro, plumbline_rate_sample, plumbline_motion, plumbline_attitude, void (*align)(const plumbline_attitude *attitude);,
               case PLUMBLINE_ALIGN:
                   if (count != PLUMBLINE_COUNT(plumbline_attitude)) return -1;
                   stage->align((const plumbline_attitude *)(const void *)payload);
                   return 0;)
PLUMBLINE_SLOT(accel, plumbline_force, plumbline_inclination, plumbline_point, , )
PLUMBLINE_SLOT(fuser, plumbline_fuser_input, plumbline_fused, plumbline_estimate, void (*realign)(void);,
               case PLUMBLINE_REALIGN: stage->realign(); return 0;)
PLUMBLINE_SLOT(course, plumbline_course_input, plumbline_course_reading, plumbline_last_reading, , )

/* ---- Points, attitudes, rotations. ---- */

static inline double plumbline_sign(const plumbline_point *up) { return up->inverted != 0.0 ? -1.0 : 1.0; }

static inline double plumbline_wrapped_rad(double angle_rad)
{
    const double wrapped = remainder(angle_rad, 2.0 * PLUMBLINE_PI);
    return wrapped <= -PLUMBLINE_PI ? PLUMBLINE_PI : wrapped;
}

/* Writes the unit vector of a point in body axes. */
static inline void plumbline_direction(const plumbline_point *up, double direction[3])
{
    const double rho = up->u * up->u + up->v * up->v, scale = 1.0 / (1.0 + rho), sign = plumbline_sign(up);
    direction[0] = 2.0 * up->u * scale;
    direction[1] = sign * 2.0 * up->v * scale;
    direction[2] = sign * (1.0 - rho) * scale;
}

/* Projects a vector into the chart in which |w| <= 1. Returns 1, or 0 if the vector is zero or not
   finite. */
static inline int plumbline_point_from_direction(const double v[3], plumbline_point *up)
{
    const double norm = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]), sign = v[2] >= 0.0 ? 1.0 : -1.0;
    if (!(norm > 0.0 && norm <= 1.7e308)) return 0;
    const double scale = 1.0 / (norm + sign * v[2]);
    up->inverted = sign < 0.0;
    up->u = v[0] * scale;
    up->v = sign * v[1] * scale;
    return 1;
}

/* Creates the rotation exp(phi / 2) from a rotation vector phi (rad, body axes). */
static inline plumbline_rotation plumbline_rotation_from_vector(double x, double y, double z)
{
    const double angle = sqrt(x * x + y * y + z * z), half = angle > 1e-12 ? sin(0.5 * angle) / angle : 0.5;
    const plumbline_rotation rotation = {cos(0.5 * angle), half * z, half * x, half * y};
    return rotation;
}

/* Returns the image numerator / m under a Moebius map, in the chart in which the image is far from
   the pole. */
static inline plumbline_attitude plumbline_mapped(const plumbline_attitude *from, double n_re, double n_im, double m_re, double m_im)
{
    const double n2 = n_re * n_re + n_im * n_im, m2 = m_re * m_re + m_im * m_im;
    plumbline_attitude to = *from;
    if (n2 > 1.44 * m2) {
        to.up.inverted = from->up.inverted != 0.0 ? 0.0 : 1.0;
        to.up.u = (m_re * n_re + m_im * n_im) / n2;
        to.up.v = (m_im * n_re - m_re * n_im) / n2;
        to.z_rad = plumbline_wrapped_rad(from->z_rad + 2.0 * atan2(n_re, -n_im));
    } else {
        to.up.u = (n_re * m_re + n_im * m_im) / m2;
        to.up.v = (n_im * m_re - n_re * m_im) / m2;
        to.z_rad = plumbline_wrapped_rad(from->z_rad + 2.0 * atan2(m_im, m_re));
    }
    return to;
}

/* Returns the attitude after a rotation of the body: (conj(p) w + j s) / m, m = p + j conj(s) w. */
static inline plumbline_attitude plumbline_rotated(const plumbline_attitude *from, const plumbline_rotation *rotation)
{
    const double sign = plumbline_sign(&from->up), u = from->up.u, v = from->up.v;
    const double a = rotation->p_re, b = sign * rotation->p_im, c = rotation->s_re, d = sign * rotation->s_im;
    return plumbline_mapped(from, a * u + b * v - d, a * v - b * u + c, a + d * u - c * v, b + c * u + d * v);
}

/* Returns the attitude after its level frame has been tilted about a horizontal axis:
   (w + l) / (1 - conj(w) l). */
static inline plumbline_attitude plumbline_tilted(const plumbline_attitude *from, double l_re, double l_im)
{
    const double u = from->up.u, v = from->up.v;
    return plumbline_mapped(from, u + l_re, v + l_im, 1.0 - (u * l_re + v * l_im), v * l_re - u * l_im);
}

/* Writes the horizontal part xi + j eta of a body vector in the level frame. */
static inline void plumbline_horizontal(const plumbline_attitude *attitude, const double body[3], double *re, double *im)
{
    const double sign = plumbline_sign(&attitude->up), u = attitude->up.u, v = attitude->up.v, y = sign * body[1];
    const double along = 2.0 / (1.0 + u * u + v * v) * (sign * body[2] + u * body[0] + v * y);
    *re = body[0] - u * along;
    *im = y - v * along;
}

/* Returns the attitude after the shortest tilt that makes `up` the up vector. The heading is
   kept. */
static inline plumbline_attitude plumbline_realigned(const plumbline_attitude *from, const plumbline_point *up)
{
    double direction[3], own[3], re, im;
    plumbline_direction(up, direction);
    plumbline_direction(&from->up, own);
    const double vertical = 1.0 + direction[0] * own[0] + direction[1] * own[1] + direction[2] * own[2];
    if (!(vertical > 1e-9)) return plumbline_tilted(from, 1e9, 0.0);
    plumbline_horizontal(from, direction, &re, &im);
    return plumbline_tilted(from, re / vertical, im / vertical);
}

/* Writes the unit quaternion from body to reference, in the order i, j, k, w. */
static inline void plumbline_quaternion(const plumbline_attitude *attitude, double xyzw[4])
{
    const double u = attitude->up.u, v = attitude->up.v, scale = 1.0 / sqrt(1.0 + u * u + v * v);
    const double re = cos(0.5 * attitude->z_rad) * scale, im = sin(0.5 * attitude->z_rad) * scale;
    const double second_re = v * re + u * im, second_im = v * im - u * re;
    const int inverted = attitude->up.inverted != 0.0;
    xyzw[0] = inverted ? -re : second_re;
    xyzw[1] = inverted ? -im : second_im;
    xyzw[2] = inverted ? second_im : im;
    xyzw[3] = inverted ? second_re : re;
}

/* Writes yaw (counter-clockwise from above), pitch (nose up) and roll (right side down), rad. */
static inline void plumbline_angles(const plumbline_attitude *attitude, double *yaw_rad, double *pitch_rad, double *roll_rad)
{
    const double u = attitude->up.u, v = attitude->up.v, rho = u * u + v * v, sign = plumbline_sign(&attitude->up);
    const double sine = sin(attitude->z_rad), cosine = cos(attitude->z_rad), level = hypot(2.0 * u, 1.0 - rho);
    *pitch_rad = atan2(sign * 2.0 * v, level);
    if (level < 1e-8 * (1.0 + rho)) {
        /* Only the sum or difference of yaw and roll is defined. It is assigned to yaw alone. */
        const double across = 1.0 - u * u + v * v, north = 2.0 * u * v;
        *yaw_rad = atan2(across * sine - north * cosine, across * cosine + north * sine);
        *roll_rad = 0.0;
        return;
    }
    const double east = 1.0 + u * u - v * v, north = 2.0 * u * v;
    *yaw_rad = atan2(sign * (east * sine + north * cosine), sign * (east * cosine - north * sine));
    *roll_rad = atan2(-2.0 * u, sign * (1.0 - rho));
}

/* Returns the reason why an attitude is invalid (outside its chart or not a number), or NULL if
   it is valid. */
static inline const char *plumbline_attitude_validation_error(const plumbline_attitude *attitude)
{
    const double rho = attitude->up.u * attitude->up.u + attitude->up.v * attitude->up.v;
    return rho <= 2.0 && fabs(attitude->z_rad) <= 4.0 ? NULL : "an attitude outside its chart";
}

/* Returns the reason why an estimate is invalid, or NULL if it is valid. */
static inline const char *plumbline_estimate_validation_error(const plumbline_estimate *estimate)
{
    for (int i = 0; i < 3; i++) {
        if (!(fabs(estimate->bias_rad_s[i]) <= 10.0)) return "a gyro bias above 10 rad/s";
        if (!(fabs(estimate->gyro_scale[i]) <= 0.1)) return "a gyro scale error above 0.1";
        if (!(estimate->gyro_scale_sd[i] >= 0.0)) return "a negative standard deviation";
        if (!(fabs(estimate->hard_iron_ut[i]) <= 1e4)) return "a hard iron above 10,000 µT";
    }
    if (!(hypot(estimate->leaky_velocity_m_s[0], estimate->leaky_velocity_m_s[1]) <= 100.0)) return "a leaky velocity above 100 m/s";
    if (!(estimate->inclination_sd_rad >= 0.0 && estimate->heading_sd_rad >= 0.0 && estimate->bias_sd_rad_s >= 0.0 &&
          estimate->hard_iron_sd_ut >= 0.0 && estimate->leaky_velocity_sd_m_s >= 0.0)) {
        return "a negative standard deviation";
    }
    return plumbline_attitude_validation_error(&estimate->attitude);
}

#endif
