//! Reported standard deviations: those of the filters, enlarged by errors that the filters do not
//! model.
//!
//! - The accelerometer bias rotates with the body and is not observable. It limits how well the
//!   level is known.
//! - On a rotating body, timing errors of a few milliseconds and misaligned axes affect the
//!   inclination.
//! - The local magnetic field limits how well the heading is known.
//!
//! The filters' own standard deviations stay unchanged, because the filter gains depend on them.

use core::f64::consts::PI;

use super::settings::Settings;
use crate::GRAVITY_M_S2;

/// Inclination error of a rotating body per unit of its rate, s.
const INCLINATION_SD_PER_RATE_S: f64 = 1.5e-3;
/// Smallest standard deviation of a heading, rad (0.4°).
const HEADING_SD_FLOOR_RAD: f64 = 6.981_317e-3;
/// Fraction of the filter's heading standard deviation that is reported. It is below 1 because the
/// filter allows for stronger local magnetic fields than most places have.
const HEADING_SD_FACTOR: f64 = 0.9;

/// Returns the standard deviation of the inclination about each horizontal axis, rad.
///
/// `rate2_rad2_s2` is the square of the rate, rad²/s².
#[inline]
pub(super) fn inclination_sd_rad(filter_sd_rad: f64, rate2_rad2_s2: f64, settings: &Settings) -> f64 {
    let bias_sd_rad = settings.residual_accel_bias_sd_m_s2 / GRAVITY_M_S2;
    let rate_variance_rad2 = INCLINATION_SD_PER_RATE_S * INCLINATION_SD_PER_RATE_S * rate2_rad2_s2;
    libm::sqrt(filter_sd_rad * filter_sd_rad + bias_sd_rad * bias_sd_rad + rate_variance_rad2).min(PI)
}

/// Returns the standard deviation of the heading, rad.
#[inline]
pub(super) fn heading_sd_rad(filter_sd_rad: f64) -> f64 {
    // The factor approaches 1 as the heading becomes unknown.
    let filter_sd_rad = filter_sd_rad * (HEADING_SD_FACTOR + (1.0 - HEADING_SD_FACTOR) * filter_sd_rad / PI);
    libm::sqrt(filter_sd_rad * filter_sd_rad + HEADING_SD_FLOOR_RAD * HEADING_SD_FLOOR_RAD).min(PI)
}
