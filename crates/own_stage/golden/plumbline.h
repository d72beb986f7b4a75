/*
 * Plumbline's messages. Written by `plumb stage header`; not to be edited.
 *
 * A topic is an iceoryx2 publish-subscribe service of the name PLUMBLINE_TOPIC_*. A payload is a slice of bytes (uint8_t) that holds
 * one struct; the attributes layout.0, layout.1, ... hold PLUMBLINE_LAYOUT_* in pieces. How a program joins a system: docs/own-stage.md.
 */
#ifndef PLUMBLINE_H
#define PLUMBLINE_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
#define PLUMBLINE_ASSERT(condition, text) static_assert(condition, text)
#else
#define PLUMBLINE_ASSERT(condition, text) _Static_assert(condition, text)
#endif

#define PLUMBLINE_CHART_UPRIGHT 0u
#define PLUMBLINE_CHART_INVERTED 1u

#define PLUMBLINE_COURSE_ARBITRARY 0u
#define PLUMBLINE_COURSE_MAGNETIC 1u
#define PLUMBLINE_COURSE_TRUE 2u

#define PLUMBLINE_STATE_READY 1u
#define PLUMBLINE_STATE_RUNNING 2u
#define PLUMBLINE_STATE_FINISHED 3u

#define PLUMBLINE_SERVICE_INGEST 0u
#define PLUMBLINE_SERVICE_GYRO 1u
#define PLUMBLINE_SERVICE_ACCEL 2u
#define PLUMBLINE_SERVICE_FUSER 3u
#define PLUMBLINE_SERVICE_COURSE 4u
#define PLUMBLINE_SERVICE_GATEWAY 5u

#define PLUMBLINE_FLAG_RATE_INVALID (UINT64_C(1) << 0)
#define PLUMBLINE_FLAG_FORCE_INVALID (UINT64_C(1) << 1)
#define PLUMBLINE_FLAG_RATE_CLIPPED (UINT64_C(1) << 2)
#define PLUMBLINE_FLAG_FORCE_CLIPPED (UINT64_C(1) << 3)
#define PLUMBLINE_FLAG_RATE_STUCK (UINT64_C(1) << 4)
#define PLUMBLINE_FLAG_FORCE_STUCK (UINT64_C(1) << 5)
#define PLUMBLINE_FLAG_FORCE_SMALL (UINT64_C(1) << 6)
#define PLUMBLINE_FLAG_GAP (UINT64_C(1) << 7)
#define PLUMBLINE_FLAG_CLOCK_LEAP (UINT64_C(1) << 8)
#define PLUMBLINE_FLAG_REFUSED_BEFORE (UINT64_C(1) << 9)
#define PLUMBLINE_FLAG_RATE_INSTANT (UINT64_C(1) << 10)
#define PLUMBLINE_FLAG_GYRO_MISSING (UINT64_C(1) << 11)
#define PLUMBLINE_FLAG_ACCEL_MISSING (UINT64_C(1) << 12)
#define PLUMBLINE_FLAG_LOST_BEFORE (UINT64_C(1) << 13)
#define PLUMBLINE_FLAG_ALIGNED (UINT64_C(1) << 14)
#define PLUMBLINE_FLAG_RESET (UINT64_C(1) << 15)
#define PLUMBLINE_FLAG_AT_REST (UINT64_C(1) << 16)
#define PLUMBLINE_FLAG_NEAR_GIMBAL (UINT64_C(1) << 17)
#define PLUMBLINE_FLAG_UNALIGNED (UINT64_C(1) << 18)
#define PLUMBLINE_FLAG_FIELD (UINT64_C(1) << 19)
#define PLUMBLINE_FLAG_FIX (UINT64_C(1) << 20)
#define PLUMBLINE_FLAG_FIELD_INVALID (UINT64_C(1) << 21)
#define PLUMBLINE_FLAG_FIX_INVALID (UINT64_C(1) << 22)
#define PLUMBLINE_FLAG_FIELD_DISTURBED (UINT64_C(1) << 23)
#define PLUMBLINE_FLAG_AIDING_MISSING (UINT64_C(1) << 24)
#define PLUMBLINE_FLAG_FAULT_INJECTED (UINT64_C(1) << 25)
#define PLUMBLINE_FLAG_EXCHANGED (UINT64_C(1) << 26)

/* Where a message comes from: the tick, unchanged from ingest to the end, and what happened to it on the way. */
struct plumbline_header {
    /* The number ingest gave to the IMU sample, from 0, without a gap. */
    uint64_t tick;
    /* Start of the sample's interval on the source's clock, ns. */
    int64_t t_start_ns;
    /* End of the sample's interval on the source's clock, ns; grows with every tick. */
    int64_t t_end_ns;
    /* When ingest took the sample, CLOCK_MONOTONIC, ns. */
    uint64_t t_born_ns;
    /* When this message was published, CLOCK_MONOTONIC, ns. */
    uint64_t t_sent_ns;
    /* Ticks before this one that its stream does not have. */
    uint64_t lost_upstream;
    /* What is to be said about the sample and what was made of it. */
    uint64_t flags;
    /* The supervisor's decision under which the sender owns its slot. */
    uint32_t epoch;
    /* The life of the sender. */
    uint32_t incarnation;
};
PLUMBLINE_ASSERT(sizeof(struct plumbline_header) == 64, "size of header");
PLUMBLINE_ASSERT(offsetof(struct plumbline_header, tick) == 0, "place of tick");
PLUMBLINE_ASSERT(offsetof(struct plumbline_header, t_start_ns) == 8, "place of t_start_ns");
PLUMBLINE_ASSERT(offsetof(struct plumbline_header, t_end_ns) == 16, "place of t_end_ns");
PLUMBLINE_ASSERT(offsetof(struct plumbline_header, t_born_ns) == 24, "place of t_born_ns");
PLUMBLINE_ASSERT(offsetof(struct plumbline_header, t_sent_ns) == 32, "place of t_sent_ns");
PLUMBLINE_ASSERT(offsetof(struct plumbline_header, lost_upstream) == 40, "place of lost_upstream");
PLUMBLINE_ASSERT(offsetof(struct plumbline_header, flags) == 48, "place of flags");
PLUMBLINE_ASSERT(offsetof(struct plumbline_header, epoch) == 56, "place of epoch");
PLUMBLINE_ASSERT(offsetof(struct plumbline_header, incarnation) == 60, "place of incarnation");

/* A reading as it comes from a sensor, before anything was checked: any value may be NaN. */
#define PLUMBLINE_TOPIC_SENSOR_READING "sensor"
#define PLUMBLINE_LAYOUT_SENSOR_READING \
    "plumbline.SensorReading.1 80 t_sensor_ns:i64@0 rate_rad_s:[f64; 3]@8 force_m_s2:[f64; 3]@32 field_ut:[f64; 3]@56"
struct plumbline_sensor_reading {
    /* The sensor's own time stamp, ns. */
    int64_t t_sensor_ns;
    /* Body rate, rad/s. */
    double rate_rad_s[3];
    /* Specific force, m/s². */
    double force_m_s2[3];
    /* Magnetic field, µT; NaN where this reading brings none. */
    double field_ut[3];
};
PLUMBLINE_ASSERT(sizeof(struct plumbline_sensor_reading) == 80, "size of sensor_reading");
PLUMBLINE_ASSERT(offsetof(struct plumbline_sensor_reading, t_sensor_ns) == 0, "place of t_sensor_ns");
PLUMBLINE_ASSERT(offsetof(struct plumbline_sensor_reading, rate_rad_s) == 8, "place of rate_rad_s");
PLUMBLINE_ASSERT(offsetof(struct plumbline_sensor_reading, force_m_s2) == 32, "place of force_m_s2");
PLUMBLINE_ASSERT(offsetof(struct plumbline_sensor_reading, field_ut) == 56, "place of field_ut");

/* A fix as it comes from a satellite receiver, before anything was checked; it belongs to the next sensor reading. */
#define PLUMBLINE_TOPIC_RECEIVER_READING "receiver"
#define PLUMBLINE_LAYOUT_RECEIVER_READING \
    "plumbline.ReceiverReading.1 48 velocity_m_s:[f64; 3]@0 velocity_sd_m_s:f64@24 age_s:f64@32 latitude_rad:f64@40"
struct plumbline_receiver_reading {
    /* Velocity over ground, m/s, east, north, up. */
    double velocity_m_s[3];
    /* Standard deviation of each component, m/s; NaN where unknown. */
    double velocity_sd_m_s;
    /* How old the velocity is on arrival, s; NaN where unknown. */
    double age_s;
    /* Geodetic latitude, rad, north positive; NaN where unknown. */
    double latitude_rad;
};
PLUMBLINE_ASSERT(sizeof(struct plumbline_receiver_reading) == 48, "size of receiver_reading");
PLUMBLINE_ASSERT(offsetof(struct plumbline_receiver_reading, velocity_m_s) == 0, "place of velocity_m_s");
PLUMBLINE_ASSERT(offsetof(struct plumbline_receiver_reading, velocity_sd_m_s) == 24, "place of velocity_sd_m_s");
PLUMBLINE_ASSERT(offsetof(struct plumbline_receiver_reading, age_s) == 32, "place of age_s");
PLUMBLINE_ASSERT(offsetof(struct plumbline_receiver_reading, latitude_rad) == 40, "place of latitude_rad");

/* One checked IMU sample: finite, its time grows, what is wrong with it is in the flags. */
#define PLUMBLINE_TOPIC_IMU_SAMPLE "imu"
#define PLUMBLINE_LAYOUT_IMU_SAMPLE \
    "plumbline.ImuSample.1 112 tick:u64@0 t_start_ns:i64@8 t_end_ns:i64@16 t_born_ns:u64@24 t_sent_ns:u64@32 lost_upstream:u64@40 flags:Flags@48 epoch:u32@56 incarnation:u32@60 rate_rad_s:[f64; 3]@64 force_m_s2:[f64; 3]@88"
struct plumbline_imu_sample {
    struct plumbline_header header;
    /* Body rate, rad/s, body axes. */
    double rate_rad_s[3];
    /* Specific force, m/s², body axes; up at rest. */
    double force_m_s2[3];
};
PLUMBLINE_ASSERT(sizeof(struct plumbline_imu_sample) == 112, "size of imu_sample");
PLUMBLINE_ASSERT(offsetof(struct plumbline_imu_sample, rate_rad_s) == 64, "place of rate_rad_s");
PLUMBLINE_ASSERT(offsetof(struct plumbline_imu_sample, force_m_s2) == 88, "place of force_m_s2");

/* The magnetic field at a tick; the sample of that tick is flagged field. */
#define PLUMBLINE_TOPIC_MAG_SAMPLE "mag"
#define PLUMBLINE_LAYOUT_MAG_SAMPLE \
    "plumbline.MagSample.1 88 tick:u64@0 t_start_ns:i64@8 t_end_ns:i64@16 t_born_ns:u64@24 t_sent_ns:u64@32 lost_upstream:u64@40 flags:Flags@48 epoch:u32@56 incarnation:u32@60 field_ut:[f64; 3]@64"
struct plumbline_mag_sample {
    struct plumbline_header header;
    /* Magnetic field, µT, body axes. */
    double field_ut[3];
};
PLUMBLINE_ASSERT(sizeof(struct plumbline_mag_sample) == 88, "size of mag_sample");
PLUMBLINE_ASSERT(offsetof(struct plumbline_mag_sample, field_ut) == 64, "place of field_ut");

/* What a satellite receiver said, at the tick at which it arrived; the sample of that tick is flagged fix. */
#define PLUMBLINE_TOPIC_GNSS_FIX "gnss"
#define PLUMBLINE_LAYOUT_GNSS_FIX \
    "plumbline.GnssFix.1 112 tick:u64@0 t_start_ns:i64@8 t_end_ns:i64@16 t_born_ns:u64@24 t_sent_ns:u64@32 lost_upstream:u64@40 flags:Flags@48 epoch:u32@56 incarnation:u32@60 velocity_m_s:[f64; 3]@64 velocity_sd_m_s:f64@88 age_s:f64@96 latitude_rad:f64@104"
struct plumbline_gnss_fix {
    struct plumbline_header header;
    /* Velocity over ground, m/s, east, north, up. */
    double velocity_m_s[3];
    /* Standard deviation of each component, m/s; NaN where unknown. */
    double velocity_sd_m_s;
    /* How old the velocity was on arrival, s; NaN where unknown. */
    double age_s;
    /* Geodetic latitude, rad, north positive; NaN where unknown. */
    double latitude_rad;
};
PLUMBLINE_ASSERT(sizeof(struct plumbline_gnss_fix) == 112, "size of gnss_fix");
PLUMBLINE_ASSERT(offsetof(struct plumbline_gnss_fix, velocity_m_s) == 64, "place of velocity_m_s");
PLUMBLINE_ASSERT(offsetof(struct plumbline_gnss_fix, velocity_sd_m_s) == 88, "place of velocity_sd_m_s");
PLUMBLINE_ASSERT(offsetof(struct plumbline_gnss_fix, age_s) == 96, "place of age_s");
PLUMBLINE_ASSERT(offsetof(struct plumbline_gnss_fix, latitude_rad) == 104, "place of latitude_rad");

/* The true attitude at a tick, as far as the source knows it. */
#define PLUMBLINE_TOPIC_REFERENCE "reference"
#define PLUMBLINE_LAYOUT_REFERENCE \
    "plumbline.Reference.1 48 tick:u64@0 scored:u64@8 quaternion:[f64; 4]@16"
struct plumbline_reference {
    /* The IMU sample's tick. */
    uint64_t tick;
    /* 1 where an estimate is to be judged by it, else 0. */
    uint64_t scored;
    /* Body → reference, w x y z, unit. */
    double quaternion[4];
};
PLUMBLINE_ASSERT(sizeof(struct plumbline_reference) == 48, "size of reference");
PLUMBLINE_ASSERT(offsetof(struct plumbline_reference, tick) == 0, "place of tick");
PLUMBLINE_ASSERT(offsetof(struct plumbline_reference, scored) == 8, "place of scored");
PLUMBLINE_ASSERT(offsetof(struct plumbline_reference, quaternion) == 16, "place of quaternion");

/* The motion over one tick's interval. */
#define PLUMBLINE_TOPIC_GYRO_STEP "gyro"
#define PLUMBLINE_LAYOUT_GYRO_STEP \
    "plumbline.GyroStep.1 152 tick:u64@0 t_start_ns:i64@8 t_end_ns:i64@16 t_born_ns:u64@24 t_sent_ns:u64@32 lost_upstream:u64@40 flags:Flags@48 epoch:u32@56 incarnation:u32@60 w:[f64; 2]@64 z_rad:f64@80 chart:Chart@88 p:[f64; 2]@96 s:[f64; 2]@112 rate_rad_s:[f64; 3]@128"
struct plumbline_gyro_step {
    struct plumbline_header header;
    /* Open-loop point u, v at the interval's end. */
    double w[2];
    /* Open-loop turn about the vertical, rad. */
    double z_rad;
    /* The chart of w and z_rad. */
    uint64_t chart;
    /* The body's turn over the interval, p = d0 + j d3. */
    double p[2];
    /* The body's turn over the interval, s = d1 + j d2. */
    double s[2];
    /* Mean rate over the interval, rad/s, body axes. */
    double rate_rad_s[3];
};
PLUMBLINE_ASSERT(sizeof(struct plumbline_gyro_step) == 152, "size of gyro_step");
PLUMBLINE_ASSERT(offsetof(struct plumbline_gyro_step, w) == 64, "place of w");
PLUMBLINE_ASSERT(offsetof(struct plumbline_gyro_step, z_rad) == 80, "place of z_rad");
PLUMBLINE_ASSERT(offsetof(struct plumbline_gyro_step, chart) == 88, "place of chart");
PLUMBLINE_ASSERT(offsetof(struct plumbline_gyro_step, p) == 96, "place of p");
PLUMBLINE_ASSERT(offsetof(struct plumbline_gyro_step, s) == 112, "place of s");
PLUMBLINE_ASSERT(offsetof(struct plumbline_gyro_step, rate_rad_s) == 128, "place of rate_rad_s");

/* Where the accelerometer sees up. */
#define PLUMBLINE_TOPIC_ACCEL_POINT "accel"
#define PLUMBLINE_LAYOUT_ACCEL_POINT \
    "plumbline.AccelPoint.1 128 tick:u64@0 t_start_ns:i64@8 t_end_ns:i64@16 t_born_ns:u64@24 t_sent_ns:u64@32 lost_upstream:u64@40 flags:Flags@48 epoch:u32@56 incarnation:u32@60 w:[f64; 2]@64 chart:Chart@80 norm_m_s2:f64@88 trust:f64@96 force_m_s2:[f64; 3]@104"
struct plumbline_accel_point {
    struct plumbline_header header;
    /* u, v. */
    double w[2];
    /* The chart of w. */
    uint64_t chart;
    /* |f|, m/s². */
    double norm_m_s2;
    /* 1 at |f| = g, 0 where the point is not from this sample. */
    double trust;
    /* Specific force, m/s², body axes. */
    double force_m_s2[3];
};
PLUMBLINE_ASSERT(sizeof(struct plumbline_accel_point) == 128, "size of accel_point");
PLUMBLINE_ASSERT(offsetof(struct plumbline_accel_point, w) == 64, "place of w");
PLUMBLINE_ASSERT(offsetof(struct plumbline_accel_point, chart) == 80, "place of chart");
PLUMBLINE_ASSERT(offsetof(struct plumbline_accel_point, norm_m_s2) == 88, "place of norm_m_s2");
PLUMBLINE_ASSERT(offsetof(struct plumbline_accel_point, trust) == 96, "place of trust");
PLUMBLINE_ASSERT(offsetof(struct plumbline_accel_point, force_m_s2) == 104, "place of force_m_s2");

/* The fused attitude. */
#define PLUMBLINE_TOPIC_FUSED_STATE "fused"
#define PLUMBLINE_LAYOUT_FUSED_STATE \
    "plumbline.FusedState.1 184 tick:u64@0 t_start_ns:i64@8 t_end_ns:i64@16 t_born_ns:u64@24 t_sent_ns:u64@32 lost_upstream:u64@40 flags:Flags@48 epoch:u32@56 incarnation:u32@60 w:[f64; 2]@64 z_rad:f64@80 chart:Chart@88 rate_rad_s:[f64; 3]@96 bias_rad_s:[f64; 3]@120 innovation_rad:f64@144 inclination_sd_rad:f64@152 heading_sd_rad:f64@160 course_reference:CourseReference@168 reset_counter:u64@176"
struct plumbline_fused_state {
    struct plumbline_header header;
    /* u, v. */
    double w[2];
    /* Turn about the vertical, rad. */
    double z_rad;
    /* The chart of w and z_rad. */
    uint64_t chart;
    /* Body rate less the bias, rad/s, body axes. */
    double rate_rad_s[3];
    /* Gyro bias, rad/s, body axes; zero where the stage does not estimate it. */
    double bias_rad_s[3];
    /* Angle between the accelerometer's up and the attitude's, rad. */
    double innovation_rad;
    /* Standard deviation of the inclination, rad. */
    double inclination_sd_rad;
    /* Standard deviation of the heading, rad; π where nothing is known. */
    double heading_sd_rad;
    /* What the heading is counted from. */
    uint64_t course_reference;
    /* Times the attitude was set anew. */
    uint64_t reset_counter;
};
PLUMBLINE_ASSERT(sizeof(struct plumbline_fused_state) == 184, "size of fused_state");
PLUMBLINE_ASSERT(offsetof(struct plumbline_fused_state, w) == 64, "place of w");
PLUMBLINE_ASSERT(offsetof(struct plumbline_fused_state, z_rad) == 80, "place of z_rad");
PLUMBLINE_ASSERT(offsetof(struct plumbline_fused_state, chart) == 88, "place of chart");
PLUMBLINE_ASSERT(offsetof(struct plumbline_fused_state, rate_rad_s) == 96, "place of rate_rad_s");
PLUMBLINE_ASSERT(offsetof(struct plumbline_fused_state, bias_rad_s) == 120, "place of bias_rad_s");
PLUMBLINE_ASSERT(offsetof(struct plumbline_fused_state, innovation_rad) == 144, "place of innovation_rad");
PLUMBLINE_ASSERT(offsetof(struct plumbline_fused_state, inclination_sd_rad) == 152, "place of inclination_sd_rad");
PLUMBLINE_ASSERT(offsetof(struct plumbline_fused_state, heading_sd_rad) == 160, "place of heading_sd_rad");
PLUMBLINE_ASSERT(offsetof(struct plumbline_fused_state, course_reference) == 168, "place of course_reference");
PLUMBLINE_ASSERT(offsetof(struct plumbline_fused_state, reset_counter) == 176, "place of reset_counter");

/* The attitude as people and autopilots read it. */
#define PLUMBLINE_TOPIC_ATTITUDE_OUTPUT "attitude"
#define PLUMBLINE_LAYOUT_ATTITUDE_OUTPUT \
    "plumbline.AttitudeOutput.1 224 tick:u64@0 t_start_ns:i64@8 t_end_ns:i64@16 t_born_ns:u64@24 t_sent_ns:u64@32 lost_upstream:u64@40 flags:Flags@48 epoch:u32@56 incarnation:u32@60 quaternion:[f64; 4]@64 yaw_rad:f64@96 pitch_rad:f64@104 roll_rad:f64@112 course_rad:f64@120 course_reference:CourseReference@128 course_sd_rad:f64@136 declination_rad:f64@144 rate_rad_s:[f64; 3]@152 inclination_sd_rad:f64@176 reset_counter:u64@184 jump:[f64; 4]@192"
struct plumbline_attitude_output {
    struct plumbline_header header;
    /* Body → reference, w x y z, unit: v_ref = q v_body q*. */
    double quaternion[4];
    /* ψ, rad, counter-clockwise from above, (−π, π. */
    double yaw_rad;
    /* ϑ, rad, nose up, −π/2, π/2. */
    double pitch_rad;
    /* γ, rad, right side down, (−π, π. */
    double roll_rad;
    /* Course, rad, clockwise from above, 0, 2π). */
    double course_rad;
    /* What the course is counted from. */
    uint64_t course_reference;
    /* Standard deviation of the course, rad; π where nothing is known. */
    double course_sd_rad;
    /* Magnetic declination by which a magnetic course was made true, rad, east positive; 0 where none was. */
    double declination_rad;
    /* Body rate less the bias, rad/s, body axes. */
    double rate_rad_s[3];
    /* Standard deviation of the inclination, rad. */
    double inclination_sd_rad;
    /* Times the attitude or the course was set anew. */
    uint64_t reset_counter;
    /* The jump of the last time: the turn from the attitude expected to the attitude set, w x y z. */
    double jump[4];
};
PLUMBLINE_ASSERT(sizeof(struct plumbline_attitude_output) == 224, "size of attitude_output");
PLUMBLINE_ASSERT(offsetof(struct plumbline_attitude_output, quaternion) == 64, "place of quaternion");
PLUMBLINE_ASSERT(offsetof(struct plumbline_attitude_output, yaw_rad) == 96, "place of yaw_rad");
PLUMBLINE_ASSERT(offsetof(struct plumbline_attitude_output, pitch_rad) == 104, "place of pitch_rad");
PLUMBLINE_ASSERT(offsetof(struct plumbline_attitude_output, roll_rad) == 112, "place of roll_rad");
PLUMBLINE_ASSERT(offsetof(struct plumbline_attitude_output, course_rad) == 120, "place of course_rad");
PLUMBLINE_ASSERT(offsetof(struct plumbline_attitude_output, course_reference) == 128, "place of course_reference");
PLUMBLINE_ASSERT(offsetof(struct plumbline_attitude_output, course_sd_rad) == 136, "place of course_sd_rad");
PLUMBLINE_ASSERT(offsetof(struct plumbline_attitude_output, declination_rad) == 144, "place of declination_rad");
PLUMBLINE_ASSERT(offsetof(struct plumbline_attitude_output, rate_rad_s) == 152, "place of rate_rad_s");
PLUMBLINE_ASSERT(offsetof(struct plumbline_attitude_output, inclination_sd_rad) == 176, "place of inclination_sd_rad");
PLUMBLINE_ASSERT(offsetof(struct plumbline_attitude_output, reset_counter) == 184, "place of reset_counter");
PLUMBLINE_ASSERT(offsetof(struct plumbline_attitude_output, jump) == 192, "place of jump");

/* Leave to publish: in live operation without end, in lockstep as far as the slowest reader allows. */
#define PLUMBLINE_TOPIC_CREDIT "credit"
#define PLUMBLINE_LAYOUT_CREDIT \
    "plumbline.Credit.1 8 ticks:u64@0"
struct plumbline_credit {
    /* Ingest may publish the ticks below this one. */
    uint64_t ticks;
};
PLUMBLINE_ASSERT(sizeof(struct plumbline_credit) == 8, "size of credit");
PLUMBLINE_ASSERT(offsetof(struct plumbline_credit, ticks) == 0, "place of ticks");

/* The state of a slot between two ticks: from it the next life of the service goes on, or another stage. */
#define PLUMBLINE_TOPIC_CHECKPOINT "checkpoint"
#define PLUMBLINE_LAYOUT_CHECKPOINT \
    "plumbline.Checkpoint.1 4680 next_tick:u64@0 checksum:u64@8 service:u32@16 incarnation:u32@20 stage:[u8; 32]@24 slot_words:u32@56 common_words:u32@60 stage_words:u32@64 reserved:u32@68 words:[u64; CHECKPOINT_WORDS]@72"
struct plumbline_checkpoint {
    /* The tick that the slot takes next. */
    uint64_t next_tick;
    /* Checkpoint::sum. */
    uint64_t checksum;
    /* The service's place in the order ingest, gyro, accel, fuser, course. */
    uint32_t service;
    /* The life of the sender. */
    uint32_t incarnation;
    /* The stage's name, filled up with zeros. */
    uint8_t stage[32];
    /* How many words are the slot's own. */
    uint32_t slot_words;
    /* How many words after them are numbers that every stage of the slot can go on with. */
    uint32_t common_words;
    /* How many words after those are the numbers of this stage. */
    uint32_t stage_words;
    /* Zero. */
    uint32_t reserved;
    /* Numbers, each as its bits. */
    uint64_t words[576];
};
PLUMBLINE_ASSERT(sizeof(struct plumbline_checkpoint) == 4680, "size of checkpoint");
PLUMBLINE_ASSERT(offsetof(struct plumbline_checkpoint, next_tick) == 0, "place of next_tick");
PLUMBLINE_ASSERT(offsetof(struct plumbline_checkpoint, checksum) == 8, "place of checksum");
PLUMBLINE_ASSERT(offsetof(struct plumbline_checkpoint, service) == 16, "place of service");
PLUMBLINE_ASSERT(offsetof(struct plumbline_checkpoint, incarnation) == 20, "place of incarnation");
PLUMBLINE_ASSERT(offsetof(struct plumbline_checkpoint, stage) == 24, "place of stage");
PLUMBLINE_ASSERT(offsetof(struct plumbline_checkpoint, slot_words) == 56, "place of slot_words");
PLUMBLINE_ASSERT(offsetof(struct plumbline_checkpoint, common_words) == 60, "place of common_words");
PLUMBLINE_ASSERT(offsetof(struct plumbline_checkpoint, stage_words) == 64, "place of stage_words");
PLUMBLINE_ASSERT(offsetof(struct plumbline_checkpoint, reserved) == 68, "place of reserved");
PLUMBLINE_ASSERT(offsetof(struct plumbline_checkpoint, words) == 72, "place of words");

/* How far a candidate is from the stage that owns its slot: angle, inclination, heading. */
#define PLUMBLINE_TOPIC_DIFFERENCE "difference"
#define PLUMBLINE_LAYOUT_DIFFERENCE \
    "plumbline.Difference.1 120 tick:u64@0 ticks:u64@8 now_rad:[f64; 3]@16 mean_rad:[f64; 3]@40 rms_rad:[f64; 3]@64 max_rad:[f64; 3]@88 service:u32@112 incarnation:u32@116"
struct plumbline_difference {
    /* The newest tick compared. */
    uint64_t tick;
    /* Ticks compared. */
    uint64_t ticks;
    /* At that tick, rad. */
    double now_rad[3];
    /* Mean, rad. */
    double mean_rad[3];
    /* Root of the mean square, rad. */
    double rms_rad[3];
    /* Largest, rad. */
    double max_rad[3];
    /* The slot's place in the order ingest, gyro, accel, fuser, course. */
    uint32_t service;
    /* The candidate's life. */
    uint32_t incarnation;
};
PLUMBLINE_ASSERT(sizeof(struct plumbline_difference) == 120, "size of difference");
PLUMBLINE_ASSERT(offsetof(struct plumbline_difference, tick) == 0, "place of tick");
PLUMBLINE_ASSERT(offsetof(struct plumbline_difference, ticks) == 8, "place of ticks");
PLUMBLINE_ASSERT(offsetof(struct plumbline_difference, now_rad) == 16, "place of now_rad");
PLUMBLINE_ASSERT(offsetof(struct plumbline_difference, mean_rad) == 40, "place of mean_rad");
PLUMBLINE_ASSERT(offsetof(struct plumbline_difference, rms_rad) == 64, "place of rms_rad");
PLUMBLINE_ASSERT(offsetof(struct plumbline_difference, max_rad) == 88, "place of max_rad");
PLUMBLINE_ASSERT(offsetof(struct plumbline_difference, service) == 112, "place of service");
PLUMBLINE_ASSERT(offsetof(struct plumbline_difference, incarnation) == 116, "place of incarnation");

/* Who owns a slot from a tick on: the supervisor's decision. */
#define PLUMBLINE_TOPIC_CONTROL "control"
#define PLUMBLINE_LAYOUT_CONTROL \
    "plumbline.Control.1 24 from_tick:u64@0 epoch:u32@8 service:u32@12 owner:u32@16 reserved:u32@20"
struct plumbline_control {
    /* The first tick of the decision. */
    uint64_t from_tick;
    /* The decision's number; it grows with every decision about the slot. */
    uint32_t epoch;
    /* The slot's place in the order ingest, gyro, accel, fuser, course. */
    uint32_t service;
    /* The life that owns it. */
    uint32_t owner;
    /* Zero. */
    uint32_t reserved;
};
PLUMBLINE_ASSERT(sizeof(struct plumbline_control) == 24, "size of control");
PLUMBLINE_ASSERT(offsetof(struct plumbline_control, from_tick) == 0, "place of from_tick");
PLUMBLINE_ASSERT(offsetof(struct plumbline_control, epoch) == 8, "place of epoch");
PLUMBLINE_ASSERT(offsetof(struct plumbline_control, service) == 12, "place of service");
PLUMBLINE_ASSERT(offsetof(struct plumbline_control, owner) == 16, "place of owner");
PLUMBLINE_ASSERT(offsetof(struct plumbline_control, reserved) == 20, "place of reserved");

/* What a service says of itself. */
#define PLUMBLINE_TOPIC_HEALTH "health"
#define PLUMBLINE_LAYOUT_HEALTH \
    "plumbline.Health.1 104 ticks:u64@0 lost:u64@8 duplicated:u64@16 repeated:u64@24 next_tick:u64@32 refused:u64@40 late_wakes:u64@48 flags:Flags@56 service:u32@64 state:State@68 incarnation:u32@72 pid:u32@76 epoch:u32@80 missed:u32@84 published_from:u64@88 flawed:u64@96"
struct plumbline_health {
    /* Ticks published since the start. */
    uint64_t ticks;
    /* Ticks that never came. */
    uint64_t lost;
    /* Messages that came twice or too late, and were left out. */
    uint64_t duplicated;
    /* Messages that a restarted service sent again, and that were left out. */
    uint64_t repeated;
    /* The tick that the service takes next. */
    uint64_t next_tick;
    /* Readings refused at the source. */
    uint64_t refused;
    /* Waits that ended by their limit although there was work: lost wake-ups. */
    uint64_t late_wakes;
    /* Every flag seen since the start. */
    uint64_t flags;
    /* The service's place in the order ingest, gyro, accel, fuser, course. */
    uint32_t service;
    /* What it does. */
    uint32_t state;
    /* Its life. */
    uint32_t incarnation;
    /* Its process. */
    uint32_t pid;
    /* The decision about its slot that it follows. */
    uint32_t epoch;
    /* 1 when that decision came too late for it to follow, else 0. */
    uint32_t missed;
    /* The first tick that it has published under that decision; u64::MAX for none. */
    uint64_t published_from;
    /* Outputs that were not finite. */
    uint64_t flawed;
};
PLUMBLINE_ASSERT(sizeof(struct plumbline_health) == 104, "size of health");
PLUMBLINE_ASSERT(offsetof(struct plumbline_health, ticks) == 0, "place of ticks");
PLUMBLINE_ASSERT(offsetof(struct plumbline_health, lost) == 8, "place of lost");
PLUMBLINE_ASSERT(offsetof(struct plumbline_health, duplicated) == 16, "place of duplicated");
PLUMBLINE_ASSERT(offsetof(struct plumbline_health, repeated) == 24, "place of repeated");
PLUMBLINE_ASSERT(offsetof(struct plumbline_health, next_tick) == 32, "place of next_tick");
PLUMBLINE_ASSERT(offsetof(struct plumbline_health, refused) == 40, "place of refused");
PLUMBLINE_ASSERT(offsetof(struct plumbline_health, late_wakes) == 48, "place of late_wakes");
PLUMBLINE_ASSERT(offsetof(struct plumbline_health, flags) == 56, "place of flags");
PLUMBLINE_ASSERT(offsetof(struct plumbline_health, service) == 64, "place of service");
PLUMBLINE_ASSERT(offsetof(struct plumbline_health, state) == 68, "place of state");
PLUMBLINE_ASSERT(offsetof(struct plumbline_health, incarnation) == 72, "place of incarnation");
PLUMBLINE_ASSERT(offsetof(struct plumbline_health, pid) == 76, "place of pid");
PLUMBLINE_ASSERT(offsetof(struct plumbline_health, epoch) == 80, "place of epoch");
PLUMBLINE_ASSERT(offsetof(struct plumbline_health, missed) == 84, "place of missed");
PLUMBLINE_ASSERT(offsetof(struct plumbline_health, published_from) == 88, "place of published_from");
PLUMBLINE_ASSERT(offsetof(struct plumbline_health, flawed) == 96, "place of flawed");

#endif
