//! Attitude in the parameters (w, z): mathematics and every stage that fills a slot.
//!
//! Input: rates and specific forces in body axes. Output: attitude, angles, course. Time: none; each step is told its length.
//! Failure: a step never panics and never leaves the finite numbers; what a stage cannot use, the caller leaves out.
//!
//! # Conventions
//!
//! Reference frame (ξ0, η0, ζ0): right-handed, ζ0 up. Body frame (ξ, η, ζ): ξ right, η forward, ζ up. SI units, radians, seconds.
//! Rates are of the body against the reference frame, in body axes. An accelerometer measures specific force: at rest it points
//! up with |f| = g. A quaternion q takes body to reference, v_ref = q v_body q*; the matrix A takes reference to body.
//!
//! Equation numbers (1)–(28) are those of Matveev et al., parameters (w, z) in strapdown attitude systems, *Devices and Methods
//! of Measurements* 16(3), 2025, 202–211 ("Matveev 2025").
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`point`] | a direction as a point of the plane, in one of two charts |
//! | [`state`] | the attitude (w, z) and what acts on it |
//! | [`turn`] | the exact rotation of one step, (p, s) |
//! | [`angles`] | yaw, pitch, roll |
//! | [`kinematics`] | the differential equations (18)–(20) |
//! | [`stage`] | the contract of a stage, its snapshot |
//! | [`numbers`] | a value as the numbers it is made of |
//! | [`parameters`] | the numbers by which a stage can be set |
//! | [`calibration`] | from a sensor's raw axes to exact body axes |
//! | [`gnss`] | what a satellite receiver tells |
//! | [`frames`] | the attitude in the frames of others, as ROS and PX4 |
//! | [`metrics`] | how far an estimate is from the truth |
//! | [`gyro`], [`accel`], [`fuser`], [`course`] | the stages, slot by slot |
#![no_std]
#![forbid(unsafe_code)]

pub mod accel;
pub mod angles;
pub mod calibration;
pub mod course;
pub mod frames;
pub mod fuser;
pub mod gnss;
pub mod gyro;
pub mod kinematics;
pub mod metrics;
pub mod numbers;
pub mod parameters;
pub mod point;
pub mod stage;
pub mod state;
pub mod turn;

pub use nalgebra::{Complex, Matrix3, Quaternion, Vector3};

/// Standard gravity, m/s².
pub const GRAVITY_M_S2: f64 = 9.806_65;

/// The imaginary unit, j in the papers.
pub(crate) const J: Complex<f64> = Complex::new(0.0, 1.0);
