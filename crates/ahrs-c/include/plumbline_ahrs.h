/* Plumbline: attitude and heading from a gyro and an accelerometer, optionally with a magnetometer
 * and a satellite receiver.
 *
 * Generated from crates/ahrs-c/src by `cargo test --release -p plumbline-ahrs-c`; do not edit.
 *
 * All units are SI units, with angles in radians; the magnetic field is in microtesla. The axes of
 * the sensors are right, forward, up unless the builder sets others. An accelerometer measures
 * specific force: at rest it points up with 9.81 m/s^2. The reference axes are east, north, up
 * unless a frame is given.
 *
 * Functions that can fail return a PlumblineStatus. plumbline_error_message() describes the newest
 * error of the calling thread. Only plumbline_builder_new() and plumbline_ahrs_new() allocate
 * memory. A filter may be used by one thread at a time; different filters are independent. */


#ifndef PLUMBLINE_AHRS_H
#define PLUMBLINE_AHRS_H

#include <stddef.h>
#include <stdint.h>

/*
 The rate is not finite and was replaced by the last valid one.
 */
#define PLUMBLINE_FLAG_RATE_INVALID (1 << 0)

/*
 The specific force is not finite; the last valid one is forwarded but not used.
 */
#define PLUMBLINE_FLAG_FORCE_INVALID (1 << 1)

/*
 A component of the rate is at the limit of the sensor's range.
 */
#define PLUMBLINE_FLAG_RATE_CLIPPED (1 << 2)

/*
 A component of the specific force is at the limit of the sensor's range.
 */
#define PLUMBLINE_FLAG_FORCE_CLIPPED (1 << 3)

/*
 The gyro has repeated the same value for too long and is considered stuck.
 */
#define PLUMBLINE_FLAG_RATE_STUCK (1 << 4)

/*
 The accelerometer has repeated the same value for too long; it is considered stuck and not
 used.
 */
#define PLUMBLINE_FLAG_FORCE_STUCK (1 << 5)

/*
 The specific force is near zero. It has no direction then, and is not used.
 */
#define PLUMBLINE_FLAG_FORCE_SMALL (1 << 6)

/*
 The interval before this sample exceeds the gap limit.
 */
#define PLUMBLINE_FLAG_GAP (1 << 7)

/*
 The sensor's clock jumped or ran backwards; time was continued with the usual interval.
 */
#define PLUMBLINE_FLAG_CLOCK_LEAP (1 << 8)

/*
 Earlier readings were rejected because they were duplicated or out of order.
 */
#define PLUMBLINE_FLAG_REFUSED_BEFORE (1 << 9)

/*
 The rate is the value at the end of the interval, not its mean.
 */
#define PLUMBLINE_FLAG_RATE_INSTANT (1 << 10)

/*
 The output of the gyro service did not arrive, so the attitude was held.
 */
#define PLUMBLINE_FLAG_GYRO_MISSING (1 << 11)

/*
 The output of the accel service did not arrive, so the attitude followed the gyro.
 */
#define PLUMBLINE_FLAG_ACCEL_MISSING (1 << 12)

/*
 Ticks before this one were lost in transit.
 */
#define PLUMBLINE_FLAG_LOST_BEFORE (1 << 13)

/*
 The attitude was re-initialised at this tick.
 */
#define PLUMBLINE_FLAG_ALIGNED (1 << 14)

/*
 The estimate was not finite and was reset.
 */
#define PLUMBLINE_FLAG_RESET (1 << 15)

/*
 The body was detected to be at rest.
 */
#define PLUMBLINE_FLAG_AT_REST (1 << 16)

/*
 The nose is near the vertical, where yaw and roll cannot be distinguished.
 */
#define PLUMBLINE_FLAG_NEAR_GIMBAL (1 << 17)

/*
 No accelerometer sample has arrived yet; the attitude is only an initial value.
 */
#define PLUMBLINE_FLAG_UNALIGNED (1 << 18)

/*
 The topic `mag` has a magnetic field sample for this tick.
 */
#define PLUMBLINE_FLAG_FIELD (1 << 19)

/*
 The topic `gnss` has a fix for this tick.
 */
#define PLUMBLINE_FLAG_FIX (1 << 20)

/*
 The magnetic field was out of range or not finite and was discarded.
 */
#define PLUMBLINE_FLAG_FIELD_INVALID (1 << 21)

/*
 The fix was invalid and was discarded.
 */
#define PLUMBLINE_FLAG_FIX_INVALID (1 << 22)

/*
 The magnetic field differs from that of the location; the heading follows the gyro.
 */
#define PLUMBLINE_FLAG_FIELD_DISTURBED (1 << 23)

/*
 A magnetic field sample or a fix did not arrive.
 */
#define PLUMBLINE_FLAG_AIDING_MISSING (1 << 24)

/*
 The fault script of the launch file altered this tick, or dropped a reading before it.
 */
#define PLUMBLINE_FLAG_FAULT_INJECTED (1 << 25)

/*
 Another stage runs in a slot from this tick on.
 */
#define PLUMBLINE_FLAG_SWAPPED (1 << 26)

/*
 Status that a function returns.
 */
enum PlumblineStatus
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  /*
   Success.
   */
  PLUMBLINE_STATUS_OK = 0,
  /*
   A pointer that must not be null is null.
   */
  PLUMBLINE_STATUS_NULL_POINTER = 1,
  /*
   An argument is not one of the allowed constants, or a text is not UTF-8.
   */
  PLUMBLINE_STATUS_INVALID_ARGUMENT = 2,
  /*
   A value is out of range or not a number.
   */
  PLUMBLINE_STATUS_OUT_OF_RANGE = 3,
  /*
   No stage, parameter or entry has this name or index.
   */
  PLUMBLINE_STATUS_NOT_FOUND = 4,
  /*
   The matrix or bias of a calibration or mounting is invalid.
   */
  PLUMBLINE_STATUS_INVALID_CALIBRATION = 5,
  /*
   Memory allocation failed.
   */
  PLUMBLINE_STATUS_OUT_OF_MEMORY = 6,
  /*
   The memory of the caller is too small or not aligned.
   */
  PLUMBLINE_STATUS_INVALID_MEMORY = 7,
  /*
   The snapshot is damaged or belongs to a filter with other stages.
   */
  PLUMBLINE_STATUS_INVALID_SNAPSHOT = 8,
  /*
   A stage has failed permanently. The attitude no longer changes.
   */
  PLUMBLINE_STATUS_STAGE_FAILED = 9,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum PlumblineStatus PlumblineStatus;
#else
typedef uint32_t PlumblineStatus;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/*
 Frame of an attitude.
 */
enum PlumblineFrame
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  /*
   Reference east, north, up; body right, forward, up. This is the native frame.
   */
  PLUMBLINE_FRAME_ENU_RFU = 0,
  /*
   Reference east, north, up; body forward, left, up: ROS.
   */
  PLUMBLINE_FRAME_ENU_FLU = 1,
  /*
   Reference north, west, up; body forward, left, up.
   */
  PLUMBLINE_FRAME_NWU_FLU = 2,
  /*
   Reference north, east, down; body forward, right, down: PX4, ArduPilot, MAVLink.
   */
  PLUMBLINE_FRAME_NED_FRD = 3,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum PlumblineFrame PlumblineFrame;
#else
typedef uint32_t PlumblineFrame;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/*
 Axes of a body or of sensors.
 */
enum PlumblineBody
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  /*
   Right, forward, up. This is the native order.
   */
  PLUMBLINE_BODY_RFU = 0,
  /*
   Forward, left, up.
   */
  PLUMBLINE_BODY_FLU = 1,
  /*
   Forward, right, down.
   */
  PLUMBLINE_BODY_FRD = 2,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum PlumblineBody PlumblineBody;
#else
typedef uint32_t PlumblineBody;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/*
 Slot that a stage fills.
 */
enum PlumblineSlot
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  /*
   Integrates the rate.
   */
  PLUMBLINE_SLOT_GYRO = 0,
  /*
   Computes the up direction from the force.
   */
  PLUMBLINE_SLOT_ACCEL = 1,
  /*
   Fuses the sensors.
   */
  PLUMBLINE_SLOT_FUSER = 2,
  /*
   Computes the angles and the heading.
   */
  PLUMBLINE_SLOT_COURSE = 3,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum PlumblineSlot PlumblineSlot;
#else
typedef uint32_t PlumblineSlot;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/*
 Sensor that can be calibrated.
 */
enum PlumblineSensor
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  /*
   Gyro.
   */
  PLUMBLINE_SENSOR_GYRO = 0,
  /*
   Accelerometer.
   */
  PLUMBLINE_SENSOR_ACCEL = 1,
  /*
   Magnetometer.
   */
  PLUMBLINE_SENSOR_MAG = 2,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum PlumblineSensor PlumblineSensor;
#else
typedef uint32_t PlumblineSensor;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/*
 Direction in which the heading is zero.
 */
enum PlumblineHeadingReference
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  /*
   Arbitrary direction, because no sensor observes north.
   */
  PLUMBLINE_HEADING_REFERENCE_ARBITRARY = 0,
  /*
   Magnetic north.
   */
  PLUMBLINE_HEADING_REFERENCE_MAGNETIC = 1,
  /*
   True north.
   */
  PLUMBLINE_HEADING_REFERENCE_TRUE = 2,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum PlumblineHeadingReference PlumblineHeadingReference;
#else
typedef uint32_t PlumblineHeadingReference;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/*
 Relation of a gyro sample to the interval before it.
 */
enum PlumblineGyroSamples
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  /*
   Mean over the interval.
   */
  PLUMBLINE_GYRO_SAMPLES_MEAN = 0,
  /*
   Value at the end of the interval.
   */
  PLUMBLINE_GYRO_SAMPLES_INSTANT = 1,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum PlumblineGyroSamples PlumblineGyroSamples;
#else
typedef uint32_t PlumblineGyroSamples;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/*
 Attitude and heading reference system.
 */
typedef struct PlumblineAhrs PlumblineAhrs;

/*
 Properties of the sensors and the stages of a filter.

 Every property has a default, and an ideal sensor needs none of them.
 */
typedef struct PlumblineBuilder PlumblineBuilder;

/*
 Adjustable parameter of a stage. The texts end with a zero byte.
 */
typedef struct PlumblineParameter {
  /*
   Name, with the unit as its suffix.
   */
  char name[64];
  /*
   Unit; empty for a dimensionless number.
   */
  char unit[16];
  /*
   Meaning of the parameter.
   */
  char description[512];
  /*
   Default value, in the unit of the parameter.
   */
  double default_value;
  /*
   Minimum allowed value.
   */
  double min;
  /*
   Maximum allowed value.
   */
  double max;
} PlumblineParameter;

/*
 Attitude after a sample, with heading, gyro bias, standard deviations and flags.
 */
typedef struct PlumblineAttitude {
  /*
   Unit quaternion from body to reference axes, w x y z: v_ref = q v_body q*. In the native
   frame, its sign is continuous with that of the previous attitude.
   */
  double quaternion[4];
  /*
   Yaw by the convention of the frame, rad. In the native frame counter-clockwise from above.
   */
  double yaw_rad;
  /*
   Pitch by the convention of the frame, rad. In the native frame nose up.
   */
  double pitch_rad;
  /*
   Roll by the convention of the frame, rad. In the native frame right side down.
   */
  double roll_rad;
  /*
   Heading in every frame, rad, clockwise from above, [0, 2 pi).
   */
  double heading_rad;
  /*
   Standard deviation of the heading, rad; pi if the heading is unknown.
   */
  double heading_sd_rad;
  /*
   Standard deviation of the inclination, rad.
   */
  double inclination_sd_rad;
  /*
   Declination that the heading includes, rad, east positive.
   */
  double declination_rad;
  /*
   Body rate with the bias removed, rad/s, body axes of the frame.
   */
  double rate_rad_s[3];
  /*
   Estimated gyro bias, rad/s, body axes of the frame; zero if the stage does not estimate it.
   */
  double gyro_bias_rad_s[3];
  /*
   Angle between the up directions of accelerometer and attitude, rad.
   */
  double innovation_rad;
  /*
   Newest jump of the attitude as a rotation, w x y z, body axes of the frame.
   */
  double jump[4];
  /*
   Number of jumps of the attitude or the heading since the first alignment.
   */
  uint64_t reset_counter;
  /*
   Faults and events of the sample: bits PLUMBLINE_FLAG_...
   */
  uint64_t flags;
  /*
   Number of accepted samples before this one.
   */
  uint64_t tick;
  /*
   Time of the attitude, ns: the sample timestamp, corrected for jumps of the sensor clock.
   */
  int64_t t_ns;
  /*
   PlumblineHeadingReference: direction in which the heading is zero.
   */
  uint32_t heading_reference;
} PlumblineAttitude;

/*
 Velocity over ground from a satellite receiver. An unknown value is NaN.
 */
typedef struct PlumblineFix {
  /*
   Velocity, m/s: east, north, up.
   */
  double velocity_m_s[3];
  /*
   Standard deviation of each component, m/s, or NaN.
   */
  double velocity_sd_m_s;
  /*
   Age of the velocity when it arrives, s, or NaN.
   */
  double age_s;
  /*
   Geodetic latitude, rad, north positive, or NaN.
   */
  double latitude_rad;
} PlumblineFix;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/*
 Creates a builder for ideal sensors and the default stages. Returns null if memory is exhausted.

 Free the builder with plumbline_builder_free().
 */
struct PlumblineBuilder *plumbline_builder_new(void);

/*
 Frees a builder. A null pointer has no effect.
 */
void plumbline_builder_free(struct PlumblineBuilder *builder);

/*
 Sets the nominal sampling rate of gyro and accelerometer, 0.1 to 100000 Hz; default 100.
 */
PlumblineStatus plumbline_builder_sample_rate_hz(struct PlumblineBuilder *builder, double rate_hz);

/*
 Sets the range of the gyro, 1 to 100000 degrees per second; default 2000.
 */
PlumblineStatus plumbline_builder_gyro_range_deg_s(struct PlumblineBuilder *builder,
                                                   double range_deg_s);

/*
 Sets the range of the accelerometer, 0.1 to 10000 g; default 16.
 */
PlumblineStatus plumbline_builder_accel_range_g(struct PlumblineBuilder *builder, double range_g);

/*
 Sets the range of the magnetometer, 1 to 1000000 microtesla; default 2000.
 */
PlumblineStatus plumbline_builder_mag_range_ut(struct PlumblineBuilder *builder, double range_ut);

/*
 Sets the interval between samples above which a gap is flagged, 0.001 to 10 s; default 0.1.
 */
PlumblineStatus plumbline_builder_gap_s(struct PlumblineBuilder *builder, double gap_s);

/*
 Sets the time after which a sensor that repeats its value counts as frozen, 0.01 to 60 s;
 default 0.5.
 */
PlumblineStatus plumbline_builder_frozen_after_s(struct PlumblineBuilder *builder, double frozen_s);

/*
 Sets the magnetic declination, -180 to 180 degrees, east positive; default 0. It converts a
 magnetic heading to a true heading. Choose the course stage first.
 */
PlumblineStatus plumbline_builder_declination_deg(struct PlumblineBuilder *builder,
                                                  double declination_deg);

/*
 Sets whether a gyro sample is the mean over the interval before it or the value at its end.
 `kind` is a PlumblineGyroSamples. The default is the mean.
 */
PlumblineStatus plumbline_builder_gyro_samples(struct PlumblineBuilder *builder, uint32_t kind);

/*
 Sets the axes of the sensors: a PlumblineBody; default right, forward, up.
 */
PlumblineStatus plumbline_builder_axes(struct PlumblineBuilder *builder, uint32_t axes);

/*
 Sets the orientation of the sensors in the body: the 9 numbers of a rotation matrix M, row by
 row, v_body = M v_sensor.
 */
PlumblineStatus plumbline_builder_mounting(struct PlumblineBuilder *builder, const double *matrix);

/*
 Sets the calibration of a sensor, a PlumblineSensor, in its own axes: out = M (raw - bias).

 `matrix` has the 9 numbers of M, row by row, and `bias` 3 numbers in raw units.
 */
PlumblineStatus plumbline_builder_calibration(struct PlumblineBuilder *builder,
                                              uint32_t sensor,
                                              const double *matrix,
                                              const double *bias);

/*
 Chooses the stage of a slot, a PlumblineSlot, by name, such as "wz". Its parameters have their
 defaults.
 */
PlumblineStatus plumbline_builder_set_stage(struct PlumblineBuilder *builder,
                                            uint32_t slot,
                                            const char *name);

/*
 Sets a parameter of the stage in a slot, a PlumblineSlot. Choose the stage first.
 */
PlumblineStatus plumbline_builder_set_parameter(struct PlumblineBuilder *builder,
                                                uint32_t slot,
                                                const char *name,
                                                double value);

/*
 Returns the number of parameters of the stage in a slot, or 0 after an error.
 */
size_t plumbline_builder_parameter_count(const struct PlumblineBuilder *builder, uint32_t slot);

/*
 Writes one parameter of a slot's stage to `parameter`. The index counts from 0.
 */
PlumblineStatus plumbline_builder_parameter_at(const struct PlumblineBuilder *builder,
                                               uint32_t slot,
                                               size_t index,
                                               struct PlumblineParameter *parameter);

/*
 Creates a filter with the properties of a builder, or with the defaults if it is null. Returns
 null if memory is exhausted.

 Free the filter with plumbline_ahrs_free(). The builder can be freed before it.
 */
struct PlumblineAhrs *plumbline_ahrs_new(const struct PlumblineBuilder *builder);

/*
 Frees a filter created by plumbline_ahrs_new(). A null pointer has no effect.
 */
void plumbline_ahrs_free(struct PlumblineAhrs *ahrs);

/*
 Returns the size of a filter, bytes.
 */
size_t plumbline_ahrs_size(void);

/*
 Returns the alignment of a filter, bytes.
 */
size_t plumbline_ahrs_align(void);

/*
 Creates a filter in memory provided by the caller and writes its address to `ahrs`.

 `memory` has at least plumbline_ahrs_size() bytes with the alignment plumbline_ahrs_align(). The
 caller may release or reuse it at any time after the last call with the filter.
 */
PlumblineStatus plumbline_ahrs_init(const struct PlumblineBuilder *builder,
                                    void *memory,
                                    size_t size,
                                    struct PlumblineAhrs **ahrs);

/*
 Processes a sample of all sensors.

 `gyro_rad_s`: body rate, 3 numbers, rad/s. `accel_m_s2`: specific force, 3 numbers, m/s^2.
 `field_ut`: magnetic field, 3 numbers, microtesla, or null for the newest field that
 plumbline_ahrs_update_mag() has stored since the previous sample, if any. `dt_s`: time since the
 previous sample, s; a value that is 0, negative or not finite marks a late or repeated sample.
 `attitude`: receives the attitude after the sample in the native frame, or is null. A missing
 value is NaN. If the sample is rejected, the attitude is unchanged.
 */
PlumblineStatus plumbline_ahrs_update(struct PlumblineAhrs *ahrs,
                                      const double *gyro_rad_s,
                                      const double *accel_m_s2,
                                      const double *field_ut,
                                      double dt_s,
                                      struct PlumblineAttitude *attitude);

/*
 Processes a timestamped sample of all sensors.

 `t_ns`: end of the sample's interval on the clock of the sensors, ns. The other arguments are
 those of plumbline_ahrs_update().
 */
PlumblineStatus plumbline_ahrs_update_at(struct PlumblineAhrs *ahrs,
                                         const double *gyro_rad_s,
                                         const double *accel_m_s2,
                                         const double *field_ut,
                                         int64_t t_ns,
                                         struct PlumblineAttitude *attitude);

/*
 Stores a magnetometer sample, 3 numbers, microtesla. It takes effect with the next gyro and
 accelerometer sample.
 */
PlumblineStatus plumbline_ahrs_update_mag(struct PlumblineAhrs *ahrs, const double *field_ut);

/*
 Stores a velocity from the satellite receiver. It takes effect with the next gyro and
 accelerometer sample.
 */
PlumblineStatus plumbline_ahrs_update_gnss(struct PlumblineAhrs *ahrs,
                                           const struct PlumblineFix *fix);

/*
 Writes the newest attitude in a frame, a PlumblineFrame, to `attitude`. Before the first sample
 it is level, and flagged as unaligned.
 */
PlumblineStatus plumbline_ahrs_attitude(const struct PlumblineAhrs *ahrs,
                                        uint32_t frame,
                                        struct PlumblineAttitude *attitude);

/*
 Returns the number of rejected samples so far; 0 for a null pointer.
 */
uint64_t plumbline_ahrs_rejected(const struct PlumblineAhrs *ahrs);

/*
 Returns the size of a snapshot, bytes; 0 for a null pointer.
 */
size_t plumbline_ahrs_snapshot_size(const struct PlumblineAhrs *ahrs);

/*
 Writes a snapshot of the whole state to `buffer`. The properties that the builder has set are
 not part of the snapshot.
 */
PlumblineStatus plumbline_ahrs_save(const struct PlumblineAhrs *ahrs, void *buffer, size_t size);

/*
 Continues from a snapshot of a filter with the same stages. After an error, the filter is
 unchanged.
 */
PlumblineStatus plumbline_ahrs_restore(struct PlumblineAhrs *ahrs,
                                       const void *snapshot,
                                       size_t size);

/*
 Writes the names of the flags that are set, such as "rate-invalid, gap", with a terminating
 zero. A text that does not fit is truncated. Returns the length of the whole text without the
 zero.
 */
size_t plumbline_flags_text(uint64_t flags, char *buffer, size_t size);

/*
 Returns a description of a status, in English. The text is static.
 */
const char *plumbline_status_text(uint32_t status);

/*
 Returns the message of the newest error of the calling thread: cause, value found and remedy.

 The text is valid until the next error of the thread. It is empty before the first error.
 */
const char *plumbline_error_message(void);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* PLUMBLINE_AHRS_H */
