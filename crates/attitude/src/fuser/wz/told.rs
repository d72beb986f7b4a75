//! The standard deviations that are told: those of the filters, and what no filter has in it.
//!
//! The bias of the accelerometer turns with the body, and nobody sees it: a level is known no better than that.
//! The samples of a body that turns are late or early on its attitude by some milliseconds and come on axes that are askew; a field is
//! known no better than the place it is in. The filters' own deviations are left alone, for their gains hang on them.

use core::f64::consts::PI;

use super::settings::Settings;
use crate::GRAVITY_M_S2;

/// Error of the inclination of a body that turns, for each rad/s, s.
const INCLINATION_BY_RATE_S: f64 = 1.5e-3;
/// Error of a heading, rad: 0.4°.
const HEADING_RAD: f64 = 6.981_317e-3;
/// Share of the filter's deviation that is true of a heading: it allows for more of the place than most places have.
const HEADING_SHARE: f64 = 0.9;

/// Standard deviation of the inclination about each horizontal axis, rad, at a rate of this square, rad²/s².
#[inline]
pub(super) fn inclination_rad(own_rad: f64, rate2_rad2_s2: f64, settings: &Settings) -> f64 {
    let bias_rad = settings.accel_bias_left_m_s2 / GRAVITY_M_S2;
    let by_rate_rad2 = INCLINATION_BY_RATE_S * INCLINATION_BY_RATE_S * rate2_rad2_s2;
    libm::sqrt(own_rad * own_rad + bias_rad * bias_rad + by_rate_rad2).min(PI)
}

/// Standard deviation of the heading, rad.
#[inline]
pub(super) fn heading_rad(own_rad: f64) -> f64 {
    // All of it where nothing is known.
    let own_rad = own_rad * (HEADING_SHARE + (1.0 - HEADING_SHARE) * own_rad / PI);
    libm::sqrt(own_rad * own_rad + HEADING_RAD * HEADING_RAD).min(PI)
}
