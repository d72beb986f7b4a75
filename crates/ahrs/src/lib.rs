//! Attitude and heading from a gyro and an accelerometer, optionally with a magnetometer and a
//! satellite receiver.
//!
//! ```
//! use plumbline_ahrs::Ahrs;
//!
//! let mut ahrs = Ahrs::new();
//! for _ in 0..200 {
//!     let gyro_rad_s = [0.0, 0.0, 0.1];
//!     let accel_m_s2 = [0.0, 0.0, 9.81];
//!     let field_ut = [0.0, 20.0, -40.0];
//!     ahrs.update(gyro_rad_s, accel_m_s2, Some(field_ut), 0.01);
//! }
//! let attitude = ahrs.attitude();
//! assert!(attitude.is_aligned());
//! assert!(attitude.angles().pitch_rad.abs() < 0.01);
//! ```
//!
//! The results equal those of the Plumbline system bit for bit, because the crate uses the same
//! sample checks, stages and supervision. No setting is necessary. Dead, frozen, clipped, missing
//! and late sensors are detected and handled; [`Attitude::flags`] reports them.
//!
//! The crate needs neither the standard library nor an allocator, and no update panics or fails.
//!
//! # Conventions
//!
//! All units are SI units, with angles in radians; the magnetic field is in µT. The axes of the
//! sensors are right, forward, up by default; [`AhrsBuilder::axes`] and [`AhrsBuilder::mounting`]
//! set others. An accelerometer measures specific force: at rest it points up with 9.81 m/s².
//! The reference axes are east, north, up. [`Attitude::quaternion_in`] and [`Attitude::angles_in`]
//! convert to the frames of ROS ([`Frame::EnuFlu`]) and of PX4 ([`Frame::NedFrd`]).
//!
//! # Choice of the method
//!
//! | the sensors | call |
//! | --- | --- |
//! | deliver all values together, at a known interval | [`Ahrs::update`] |
//! | deliver all values together, with a timestamp | [`Ahrs::update_at`] |
//! | have their own rates | one of these without a field, [`Ahrs::update_mag`], [`Ahrs::update_gnss`] |
//!
//! # Faults of the sensors
//!
//! A value that is missing is passed as NaN, or as `None` for the magnetic field.
//!
//! | fault | effect |
//! | --- | --- |
//! | a rate or force is NaN, infinite or far beyond its range | flagged; the last valid value is used, and the rate is 0 after 0.1 s |
//! | a rate or force is at the end of its range | flagged; a clipped rate corrects no bias |
//! | a sensor repeats its value for 0.5 s | flagged; a frozen force is not used while the rate varies |
//! | a magnetic field is NaN, beyond its range or repeated | not used |
//! | the magnetic field differs from that of the location | flagged; the heading follows the gyro |
//! | samples are missing for less than 1 s | bridged |
//! | samples are missing for longer | the level is initialised again and flagged |
//! | a sample is repeated or outdated | rejected and counted, see [`Ahrs::rejected`] |
//!
//! The limits are parameters of the [`AhrsBuilder`].
#![no_std]
#![forbid(unsafe_code)]

mod ahrs;
mod attitude_output;
mod builder;
pub mod parts;
mod snapshot;

pub use attitude;
pub use attitude::{
    angles::Angles,
    calibration::{Calibration, CalibrationError, Mounting},
    course::CourseReference,
    flags::Flags,
    frames::{Body, Frame},
    gyro::RateKind,
    parameters::{Parameter, ParameterError},
};

pub use ahrs::{Ahrs, GnssFix};
pub use attitude::slot::Slot;
pub use attitude_output::Attitude;
pub use builder::{AhrsBuilder, BuildError, Name, Sensor};
pub use snapshot::SnapshotError;

/// Stages for the slot `fuser`, for choosing one by type.
///
/// The type [`Fuser`](stages::Fuser) holds any of these stages and is created by name. A program
/// that chooses a stage by type contains only the code of that stage.
pub mod stages {
    pub use attitude::fuser::{
        Fuser, FuserStage,
        aided::Aided,
        levelling::{Levelling, LevellingPi, LevellingUnified},
        madgwick::Madgwick,
        multiple_model::MultipleModel,
        vqf::Vqf,
        wz::Wz,
        wz_closed::WzClosed,
        wz_open::WzOpen,
    };
}
