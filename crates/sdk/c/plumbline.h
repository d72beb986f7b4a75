/*
 * A stage for Plumbline in C or C++: one file that includes this one.
 *
 * A stage is a state of numbers and a few functions; its main returns plumbline_run_fuser(&stage), or that of its slot. It is started by Plumbline
 * and answers requests on standard input; what it prints is for people. Every structure here is made of double alone, in the order in
 * which the numbers are sent: a truth is 0 or 1. Numbers that a stage is given are finite. C99 or C++11, Linux, -lm.
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
#error "frames are little-endian, and so must be the machine"
#endif

#define PLUMBLINE_VERSION 2
#define PLUMBLINE_STATE_MAX 1536
#define PLUMBLINE_FRAME_MAX 16384
#define PLUMBLINE_PI 3.14159265358979323846

/* What a heading or a course is counted from. */
enum { PLUMBLINE_ARBITRARY = 0, PLUMBLINE_MAGNETIC = 1, PLUMBLINE_TRUE = 2 };

/* ---- What stages work on: Matveev 2025. Body axes are right, forward, up. ---- */

/* A unit vector of the body frame: w = u + j v, projected from -zeta or, inverted, from +zeta. */
typedef struct { double inverted, u, v; } plumbline_point;
/* First a turn z about the vertical, then the shortest turn that tilts it to w. */
typedef struct { plumbline_point up; double z_rad; } plumbline_attitude;
/* A rotation of the body in its own axes: the unit quaternion d0 + d1 i + d2 j + d3 k, p = d0 + j d3, s = d1 + j d2. */
typedef struct { double p_re, p_im, s_re, s_im; } plumbline_turn;

/* ---- What a stage of each slot is given, and gives. ---- */

/* gyro: given. `instant`: the rate is the value at the interval's end, not its mean. */
typedef struct { double rate_rad_s[3], dt_s, instant; } plumbline_rate_sample;
/* gyro: gives. The attitude is open loop, the rate the mean over the interval. */
typedef struct { plumbline_attitude attitude; plumbline_turn turn; double rate_rad_s[3], dt_s; } plumbline_motion;
/* accel: given, m/s^2. */
typedef struct { double m_s2[3]; } plumbline_force;
/* accel: gives. Trust is 1 at |f| = g, 0 where the point is not from this sample. */
typedef struct { plumbline_point up; double force_m_s2[3], norm_m_s2, trust; } plumbline_inclination;
/* A satellite receiver's velocity, east, north, up; each of the others where its `has_` is 1. */
typedef struct {
    double velocity_m_s[3], has_sd, sd_m_s, has_age, age_s, has_latitude, latitude_rad;
} plumbline_fix;
/* fuser: given; each part where its `has_` is 1. Credible: what is still is at rest; the motion is what the body did. */
typedef struct {
    double has_motion; plumbline_motion motion;
    double has_inclination; plumbline_inclination inclination;
    double has_field, field_ut[3];
    double has_fix; plumbline_fix fix;
    double rest_credible, rate_credible;
} plumbline_fuser_input;
/* fuser: gives. Standard deviation of a heading of which nothing is known: pi. The last seven say what the tick was corrected by, or what
   was found; `aligned`: the attitude was set anew and jumps. */
typedef struct {
    plumbline_attitude attitude;
    double rate_rad_s[3], bias_rad_s[3], innovation_rad, inclination_sd_rad, heading_sd_rad, reference;
    double tilt, bias, magnetic, velocity, disturbed, rest, aligned;
} plumbline_fused;
/* fuser: what every one can hand over to every other. A standard deviation is infinite where nobody estimated what it is of. */
typedef struct {
    plumbline_attitude attitude;
    double reference, bias_rad_s[3], inclination_sd_rad, heading_sd_rad, bias_sd_rad_s;
    /* By which part of itself the rate about each axis is read too large. */
    double gyro_scale[3], gyro_scale_sd[3];
    double hard_iron_ut[3], hard_iron_sd_ut;
    /* V by which the level leans, east and north of the attitude's reference frame: V' = h - V/T, h the horizontal specific force, T 1.5 to
       3 s. 0 and an infinite deviation where there is none. */
    double leaky_velocity_m_s[2], leaky_velocity_sd_m_s;
} plumbline_estimate;
/* course: given. */
typedef struct {
    plumbline_attitude attitude;
    double reference, heading_sd_rad, has_fix; plumbline_fix fix;
    double dt_s;
} plumbline_course_input;
/* course: gives. The course is clockwise, [0, 2 pi); the declination is what made it true; the quaternion, i j k w, takes body to reference. */
typedef struct {
    double yaw_rad, pitch_rad, roll_rad, course_rad, reference, course_sd_rad, declination_rad, quaternion_xyzw[4];
    double near_gimbal, aligned;
} plumbline_reading;
/* course: what every one can hand over to every other. */
typedef struct { double quaternion_xyzw[4], has_course, course_rad, reference, sd_rad; } plumbline_last_reading;

/* ---- What a stage is. ---- */

/* A number by which it can be set; its name ends in its unit. */
typedef struct { const char *name, *unit; double least, most, initial; const char *meaning; } plumbline_parameter;

/* What stages of all slots have. `settings` has the value of each parameter, in order; `state`, all that the next output depends on; `check`
   tells what is wrong with numbers that are to be the state, NULL for nothing. */
typedef struct {
    const plumbline_parameter *parameters;
    int parameter_count;
    double *settings;
    double *state;
    int state_count;
    const char *(*check)(const void *state);
} plumbline_stage;

/* Of a structure of double alone, how many there are. */
#define PLUMBLINE_COUNT(structure) ((int)(sizeof(structure) / sizeof(double)))

enum {
    PLUMBLINE_DESCRIBE = 1, PLUMBLINE_SET, PLUMBLINE_STEP, PLUMBLINE_SNAPSHOT, PLUMBLINE_RESTORE,
    PLUMBLINE_COMMON, PLUMBLINE_ADOPT, PLUMBLINE_ALIGN, PLUMBLINE_REALIGN
};

typedef struct { uint16_t version, kind; uint32_t refused; uint64_t number; } plumbline_head;
/* Answers what only stages of one slot are asked: bytes of the answer, or -1, refused. */
typedef int (*plumbline_of_slot)(const void *stage, int kind, const double *given, int count, double *answer);

/* A stage's slot and parameters, a line for each, its parts between tabs. */
static inline int plumbline_describe(const plumbline_stage *stage, const char *slot, char *text, size_t room)
{
    int length = snprintf(text, room, "slot\t%s\n", slot);
    for (int i = 0; i < stage->parameter_count && length > 0 && (size_t)length < room; i++) {
        const plumbline_parameter *it = &stage->parameters[i];
        length += snprintf(text + length, room - (size_t)length, "parameter\t%s\t%s\t%.17g\t%.17g\t%.17g\t%s\n", it->name, it->unit,
                           it->initial, it->least, it->most, it->meaning);
    }
    return length;
}

/* Bytes of the answer, or -1, refused. */
static inline int plumbline_answer(const plumbline_stage *stage, const char *slot, plumbline_of_slot of_slot, const void *whole, int kind,
                                   const double *given, int count, double *answer)
{
    const int bytes = stage->state_count * (int)sizeof(double);
    switch (kind) {
    case PLUMBLINE_DESCRIBE:
        return plumbline_describe(stage, slot, (char *)answer, PLUMBLINE_FRAME_MAX - sizeof(plumbline_head));
    case PLUMBLINE_SET: {
        const int place = count == 2 ? (int)given[0] : -1;
        if (place < 0 || place >= stage->parameter_count) return -1;
        const plumbline_parameter *it = &stage->parameters[place];
        if (!(it->least <= given[1] && given[1] <= it->most)) return -1;
        stage->settings[place] = given[1];
        return 0;
    }
    case PLUMBLINE_SNAPSHOT:
        memcpy(answer, stage->state, (size_t)bytes);
        return bytes;
    case PLUMBLINE_RESTORE:
        if (count != stage->state_count || stage->check(given) != NULL) return -1;
        memcpy(stage->state, given, (size_t)bytes);
        return 0;
    default:
        return of_slot(whole, kind, given, count, answer);
    }
}

/* Answers until there are no more requests; then, 0. */
static inline int plumbline_run(const plumbline_stage *stage, const char *slot, plumbline_of_slot of_slot, const void *whole)
{
    static struct { plumbline_head head; double numbers[(PLUMBLINE_FRAME_MAX - sizeof(plumbline_head)) / sizeof(double)]; } in, out;
    /* It ends with whoever asks, also in a step that never ends. */
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    for (int i = 0; i < stage->parameter_count; i++) stage->settings[i] = stage->parameters[i].initial;
    if (stage->state_count > PLUMBLINE_STATE_MAX) return fprintf(stderr, "a state of more than 1536 numbers\n"), 1;
    for (;;) {
        const ssize_t received = recv(0, &in, sizeof in, 0);
        if (received == 0) return 0;
        if (received < (ssize_t)sizeof in.head) return perror("a stage is started by Plumbline, not by hand: standard input"), 1;
        if (in.head.version != PLUMBLINE_VERSION) {
            return fprintf(stderr, "frames of version %d, plumbline.h speaks %d\n", in.head.version, PLUMBLINE_VERSION), 1;
        }
        const int count = (int)(((size_t)received - sizeof in.head) / sizeof(double));
        const int bytes = plumbline_answer(stage, slot, of_slot, whole, in.head.kind, in.numbers, count, out.numbers);
        out.head = in.head;
        out.head.refused = bytes < 0;
        if (send(0, &out, sizeof out.head + (size_t)(bytes < 0 ? 0 : bytes), MSG_NOSIGNAL) < 0) return perror("answering"), 1;
    }
}

/* A stage of a slot: what all stages have, and what is asked of it. `step` gives one tick's output, `common` what others can go on with; `adopt`
   goes on from there and returns 0, or anything else to refuse. */
#define PLUMBLINE_SLOT(NAME, INPUT, OUTPUT, COMMON, FIELD, CASE)                                                                           \
    typedef struct {                                                                                                                       \
        plumbline_stage stage;                                                                                                             \
        void (*step)(const INPUT *input, OUTPUT *output);                                                                                  \
        void (*common)(COMMON *common);                                                                                                    \
        int (*adopt)(const COMMON *common);                                                                                                \
        FIELD                                                                                                                              \
    } plumbline_##NAME;                                                                                                                    \
    static inline int plumbline_of_##NAME(const void *whole, int kind, const double *given, int count, double *answer)                     \
    {                                                                                                                                      \
        const plumbline_##NAME *stage = (const plumbline_##NAME *)whole;                                                                   \
        switch (kind) {                                                                                                                    \
        case PLUMBLINE_STEP:                                                                                                               \
            if (count != PLUMBLINE_COUNT(INPUT)) return -1;                                                                                \
            memset(answer, 0, sizeof(OUTPUT));                                                                                             \
            stage->step((const INPUT *)(const void *)given, (OUTPUT *)(void *)answer);                                                     \
            return (int)sizeof(OUTPUT);                                                                                                    \
        case PLUMBLINE_COMMON:                                                                                                             \
            memset(answer, 0, sizeof(COMMON));                                                                                             \
            stage->common((COMMON *)(void *)answer);                                                                                       \
            return (int)sizeof(COMMON);                                                                                                    \
        case PLUMBLINE_ADOPT:                                                                                                              \
            return count == PLUMBLINE_COUNT(COMMON) && stage->adopt((const COMMON *)(const void *)given) == 0 ? 0 : -1;                    \
            CASE                                                                                                                           \
        default: return -1;                                                                                                                \
        }                                                                                                                                  \
    }                                                                                                                                      \
    static inline int plumbline_run_##NAME(const plumbline_##NAME *stage)                                                                  \
    {                                                                                                                                      \
        return plumbline_run(&stage->stage, #NAME, plumbline_of_##NAME, stage);                                                            \
    }

/* A gyro also aligns: from this attitude on it integrates. A fuser also realigns: the next inclination sets the level anew. */
PLUMBLINE_SLOT(gyro, plumbline_rate_sample, plumbline_motion, plumbline_attitude, void (*align)(const plumbline_attitude *attitude);,
               case PLUMBLINE_ALIGN:
                   if (count != PLUMBLINE_COUNT(plumbline_attitude)) return -1;
                   stage->align((const plumbline_attitude *)(const void *)given);
                   return 0;)
PLUMBLINE_SLOT(accel, plumbline_force, plumbline_inclination, plumbline_point, , )
PLUMBLINE_SLOT(fuser, plumbline_fuser_input, plumbline_fused, plumbline_estimate, void (*realign)(void);,
               case PLUMBLINE_REALIGN: stage->realign(); return 0;)
PLUMBLINE_SLOT(course, plumbline_course_input, plumbline_reading, plumbline_last_reading, , )

/* ---- Points, attitudes, turns. ---- */

static inline double plumbline_sign(const plumbline_point *up) { return up->inverted != 0.0 ? -1.0 : 1.0; }

static inline double plumbline_wrapped_rad(double angle_rad)
{
    const double wrapped = remainder(angle_rad, 2.0 * PLUMBLINE_PI);
    return wrapped <= -PLUMBLINE_PI ? PLUMBLINE_PI : wrapped;
}

/* The unit vector of a point, body axes. */
static inline void plumbline_direction(const plumbline_point *up, double direction[3])
{
    const double rho = up->u * up->u + up->v * up->v, scale = 1.0 / (1.0 + rho), sign = plumbline_sign(up);
    direction[0] = 2.0 * up->u * scale;
    direction[1] = sign * 2.0 * up->v * scale;
    direction[2] = sign * (1.0 - rho) * scale;
}

/* The point of a vector, where |w| <= 1; returns 0 for one that has no direction. */
static inline int plumbline_point_of(const double v[3], plumbline_point *up)
{
    const double norm = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]), sign = v[2] >= 0.0 ? 1.0 : -1.0;
    if (!(norm > 0.0 && norm <= 1.7e308)) return 0;
    const double scale = 1.0 / (norm + sign * v[2]);
    up->inverted = sign < 0.0;
    up->u = v[0] * scale;
    up->v = sign * v[1] * scale;
    return 1;
}

/* The turn exp(phi / 2) of a rotation vector, rad. */
static inline plumbline_turn plumbline_turn_of(double x, double y, double z)
{
    const double angle = sqrt(x * x + y * y + z * z), half = angle > 1e-12 ? sin(0.5 * angle) / angle : 0.5;
    const plumbline_turn turn = {cos(0.5 * angle), half * z, half * x, half * y};
    return turn;
}

/* The image of a Moebius map, numerator over m, in the chart where it is far from the pole. */
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

/* The attitude after a turn of the body: (conj(p) w + j s) / m, m = p + j conj(s) w. */
static inline plumbline_attitude plumbline_turned(const plumbline_attitude *from, const plumbline_turn *turn)
{
    const double sign = plumbline_sign(&from->up), u = from->up.u, v = from->up.v;
    const double a = turn->p_re, b = sign * turn->p_im, c = turn->s_re, d = sign * turn->s_im;
    return plumbline_mapped(from, a * u + b * v - d, a * v - b * u + c, a + d * u - c * v, b + c * u + d * v);
}

/* The attitude after a turn about a horizontal axis: (w + l) / (1 - conj(w) l). */
static inline plumbline_attitude plumbline_leaned(const plumbline_attitude *from, double l_re, double l_im)
{
    const double u = from->up.u, v = from->up.v;
    return plumbline_mapped(from, u + l_re, v + l_im, 1.0 - (u * l_re + v * l_im), v * l_re - u * l_im);
}

/* Horizontal part of a body vector in the level frame: xi + j eta. */
static inline void plumbline_horizontal(const plumbline_attitude *attitude, const double body[3], double *re, double *im)
{
    const double sign = plumbline_sign(&attitude->up), u = attitude->up.u, v = attitude->up.v, y = sign * body[1];
    const double along = 2.0 / (1.0 + u * u + v * v) * (sign * body[2] + u * body[0] + v * y);
    *re = body[0] - u * along;
    *im = y - v * along;
}

/* The attitude after the shortest turn of its level that brings `up` up; heading does not follow. */
static inline plumbline_attitude plumbline_realigned(const plumbline_attitude *from, const plumbline_point *up)
{
    double seen[3], own[3], re, im;
    plumbline_direction(up, seen);
    plumbline_direction(&from->up, own);
    const double vertical = 1.0 + seen[0] * own[0] + seen[1] * own[1] + seen[2] * own[2];
    if (!(vertical > 1e-9)) return plumbline_leaned(from, 1e9, 0.0);
    plumbline_horizontal(from, seen, &re, &im);
    return plumbline_leaned(from, re / vertical, im / vertical);
}

/* Body to reference, unit: i, j, k, w. */
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

/* Yaw counter-clockwise from above, pitch nose up, roll right side down. */
static inline void plumbline_angles(const plumbline_attitude *attitude, double *yaw_rad, double *pitch_rad, double *roll_rad)
{
    const double u = attitude->up.u, v = attitude->up.v, rho = u * u + v * v, sign = plumbline_sign(&attitude->up);
    const double sine = sin(attitude->z_rad), cosine = cos(attitude->z_rad), level = hypot(2.0 * u, 1.0 - rho);
    *pitch_rad = atan2(sign * 2.0 * v, level);
    if (level < 1e-8 * (1.0 + rho)) {
        /* Of the turns that make up yaw and roll only one is left: all of it is yaw. */
        const double across = 1.0 - u * u + v * v, north = 2.0 * u * v;
        *yaw_rad = atan2(across * sine - north * cosine, across * cosine + north * sine);
        *roll_rad = 0.0;
        return;
    }
    const double east = 1.0 + u * u - v * v, north = 2.0 * u * v;
    *yaw_rad = atan2(sign * (east * sine + north * cosine), sign * (east * cosine - north * sine));
    *roll_rad = atan2(-2.0 * u, sign * (1.0 - rho));
}

/* What is wrong with an attitude, NULL for nothing; a number that is none is in no chart. */
static inline const char *plumbline_check_attitude(const plumbline_attitude *attitude)
{
    const double rho = attitude->up.u * attitude->up.u + attitude->up.v * attitude->up.v;
    return rho <= 2.0 && fabs(attitude->z_rad) <= 4.0 ? NULL : "an attitude outside its chart";
}

/* What is wrong with an estimate, NULL for nothing. */
static inline const char *plumbline_check_estimate(const plumbline_estimate *it)
{
    for (int i = 0; i < 3; i++) {
        if (!(fabs(it->bias_rad_s[i]) <= 10.0)) return "a gyro bias above 10 rad/s";
        if (!(fabs(it->gyro_scale[i]) <= 0.1)) return "a gyro scale error above 0.1";
        if (!(it->gyro_scale_sd[i] >= 0.0)) return "a standard deviation below zero";
        if (!(fabs(it->hard_iron_ut[i]) <= 1e4)) return "a hard iron above 10,000 µT";
    }
    if (!(hypot(it->leaky_velocity_m_s[0], it->leaky_velocity_m_s[1]) <= 100.0)) return "a leaky velocity above 100 m/s";
    if (!(it->inclination_sd_rad >= 0.0 && it->heading_sd_rad >= 0.0 && it->bias_sd_rad_s >= 0.0 && it->hard_iron_sd_ut >= 0.0 &&
          it->leaky_velocity_sd_m_s >= 0.0)) {
        return "a standard deviation below zero";
    }
    return plumbline_check_attitude(&it->attitude);
}

#endif
