//! C interface of `plumbline-ahrs`.
//!
//! The public functions and types are those of `include/plumbline_ahrs.h`, which is generated from
//! them.
//!
//! Input: pointers of the caller, which may be null.
//!
//! Failure: a null pointer, an unknown constant and an invalid value are reported as a status; the
//! objects are then unchanged.
// Each function of the interface receives pointers from the caller and has a fixed symbol name.
#![allow(unsafe_code)]

mod attitude_output;
mod boundary;
mod builder;
mod filter;
mod flags;
mod status;
mod text;

pub use attitude_output::{PlumblineAttitude, PlumblineHeadingReference};
pub use builder::{
    PlumblineBody, PlumblineBuilder, PlumblineGyroSamples, PlumblineParameter, PlumblineSensor, PlumblineSlot,
    plumbline_builder_accel_range_g, plumbline_builder_axes, plumbline_builder_calibration,
    plumbline_builder_declination_deg, plumbline_builder_free, plumbline_builder_frozen_after_s,
    plumbline_builder_gap_s, plumbline_builder_gyro_range_deg_s, plumbline_builder_gyro_samples,
    plumbline_builder_mag_range_ut, plumbline_builder_mounting, plumbline_builder_new, plumbline_builder_parameter_at,
    plumbline_builder_parameter_count, plumbline_builder_sample_rate_hz, plumbline_builder_set_parameter,
    plumbline_builder_set_stage,
};
pub use filter::{
    PlumblineAhrs, PlumblineFix, PlumblineFrame, plumbline_ahrs_align, plumbline_ahrs_attitude, plumbline_ahrs_free,
    plumbline_ahrs_init, plumbline_ahrs_new, plumbline_ahrs_rejected, plumbline_ahrs_restore, plumbline_ahrs_save,
    plumbline_ahrs_size, plumbline_ahrs_snapshot_size, plumbline_ahrs_update, plumbline_ahrs_update_at,
    plumbline_ahrs_update_gnss, plumbline_ahrs_update_mag,
};
pub use flags::*;
pub use status::{PlumblineStatus, plumbline_error_message, plumbline_status_text};
