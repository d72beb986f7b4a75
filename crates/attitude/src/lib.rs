//! Attitude in the parameters (w, z): the mathematics and all built-in stages.
//!
//! Input: rates and specific forces in body axes.
//!
//! Output: attitude, angles and course.
//!
//! Time: each step receives its duration. The crate reads no clock.
//!
//! Failure: a step never panics and its state stays finite. The caller omits samples that a stage
//! cannot use.
//!
//! # Conventions
//!
//! Reference frame (ξ0, η0, ζ0): right-handed, ζ0 up. Body frame (ξ, η, ζ): ξ right, η forward, ζ
//! up. Units are SI units, with angles in radians. Rates are those of the body relative to the
//! reference frame, in body axes. An accelerometer measures specific force: at rest it points up
//! with |f| = g. A quaternion q converts body to reference axes, v_ref = q v_body q*; the matrix A
//! converts reference to body axes.
//!
//! Equation numbers (1)–(28) are those of Matveev et al., parameters (w, z) in strapdown attitude
//! systems, *Devices and Methods of Measurements* 16(3), 2025, 202–211 ("Matveev 2025").
//!
//! | module | content |
//! | --- | --- |
//! | [`point`] | direction as a point of the plane, in one of two charts |
//! | [`state`] | attitude (w, z) and its updates |
//! | [`rotation`] | exact rotation of one step, (p, s) |
//! | [`angles`] | yaw, pitch and roll |
//! | [`kinematics`] | differential equations (18)–(20) |
//! | [`stage`] | contract of a stage and its snapshot |
//! | [`validated_stage`] | validation of the outputs of a stage, and its reset |
//! | [`scalars`] | traversal of the numbers that make up a value |
//! | [`state_words`] | state as 64-bit words |
//! | [`parameters`] | adjustable parameters of a stage |
//! | [`conditioner`] | checked samples from readings |
//! | [`flags`] | faults and events of a tick |
//! | [`calibration`] | sensor calibration and mounting |
//! | [`gnss`] | satellite fixes |
//! | [`magnetometer`] | new samples of a magnetometer that repeats them |
//! | [`frames`] | conversion to and from other frames, such as those of ROS and PX4 |
//! | [`metrics`] | errors of an estimate against a reference |
//! | [`slot`] | steps of the estimation, with the names of their stages |
//! | [`gyro`], [`accel`], [`fuser`], [`course`] | stages of each slot |
#![no_std]
#![forbid(unsafe_code)]

pub mod accel;
pub mod angles;
pub mod calibration;
pub mod conditioner;
pub mod course;
pub mod flags;
pub mod frames;
pub mod fuser;
pub mod gnss;
pub mod gyro;
pub mod kinematics;
pub mod magnetometer;
pub mod metrics;
pub mod parameters;
pub mod point;
pub mod rotation;
pub mod scalars;
pub mod slot;
pub mod stage;
pub mod state;
pub mod state_words;
pub mod validated_stage;

pub use nalgebra::{Complex, Matrix3, Quaternion, Vector3};

/// Standard gravity, m/s².
pub const GRAVITY_M_S2: f64 = 9.806_65;
/// Rotation rate of the earth, rad/s (WGS 84).
pub const EARTH_RATE_RAD_S: f64 = 7.292_115e-5;

/// Imaginary unit, j in the papers.
pub(crate) const J: Complex<f64> = Complex::new(0.0, 1.0);
