//! Azimuth of the platform, from the track over ground and from the direction of accelerations.
//!
//! The track is the direction of travel, which in wind is not the direction of the nose. It
//! corrects the azimuth over T = 50 s, as in equation (5) of S4 (see `levelling`), and the bias
//! about the vertical over 4 T.
//!
//! The force and the change of velocity each yield the acceleration vector, regardless of wind. In
//! a turn the angle between these two vectors is therefore the azimuth error. Once turns have
//! determined the azimuth, the track corrects it at half the rate.

use super::settings::PiSettings;
use crate::{Complex, fuser::low_pass::low_pass_gain, scalars::scalars, state::arg};
use core::f64::consts::PI;

/// Acceleration above which its direction can be determined despite the velocity noise, m/s².
const SIGNIFICANT_ACCELERATION_M_S2: f64 = 1.0;
/// Largest azimuth error inferred from one increment, rad.
const MAX_AZIMUTH_ERROR_RAD: f64 = 0.3;
/// Duration of accelerated motion after which the turns made determine the azimuth fully, s.
const FULL_TURNING_S: f64 = 40.0;
/// Typical wind across the track, m/s.
const TYPICAL_CROSSWIND_M_S: f64 = 6.0;

/// Correction of the azimuth and of the bias about the vertical.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct HeadingCorrection {
    /// Azimuth error to subtract, rad, positive counter-clockwise.
    pub(super) azimuth_rad: f64,
    /// Increment to add to the bias about the vertical, rad/s.
    ///
    /// The increment has the sign of the azimuth error, because a gyro that reads too high rotates
    /// the azimuth too far.
    pub(super) bias_rad_s: f64,
}

/// Estimate of the azimuth error.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Heading {
    /// Set if the axes of the platform are east and north.
    pub(super) known: bool,
    /// Standard deviation of the azimuth without the effect of the crab angle, rad.
    ///
    /// While the azimuth is unknown, the value is π.
    drift_sd_rad: f64,
    /// Total duration of the accelerated motion from which the azimuth has been corrected, s. It is
    /// limited to [`FULL_TURNING_S`].
    turning_s: f64,
}

impl Default for Heading {
    fn default() -> Self {
        Self { known: false, drift_sd_rad: PI, turning_s: 0.0 }
    }
}

impl Heading {
    /// Creates a known heading with the given standard deviation.
    pub(super) fn with_sd(sd_rad: f64) -> Self {
        Self { known: true, drift_sd_rad: sd_rad.min(PI), turning_s: 0.0 }
    }

    /// Increases the uncertainty by the drift that the bias error causes over `dt_s`.
    pub(super) fn advance(&mut self, bias_sd_rad_s: f64, dt_s: f64) {
        self.drift_sd_rad = (self.drift_sd_rad + bias_sd_rad_s * dt_s).min(PI);
    }

    /// Returns the correction that aligns the azimuth with the first track. The heading is known
    /// afterwards.
    pub(super) fn align_to_track(&mut self, forward: Complex<f64>, track: Complex<f64>) -> HeadingCorrection {
        *self = Self::with_sd(0.0);
        HeadingCorrection { azimuth_rad: arg(forward * track.conj()), bias_rad_s: 0.0 }
    }

    /// Returns the correction from a track, weighted by the interval `span_s`. `forward` is the
    /// forward direction in platform axes at the time of the track.
    pub(super) fn correct_by_track(
        &mut self,
        forward: Complex<f64>,
        track: Complex<f64>,
        span_s: f64,
        settings: &PiSettings,
    ) -> HeadingCorrection {
        let PiSettings { track_time_constant_s, turned_track_time_constant_s, .. } = *settings;
        let extra_s = turned_track_time_constant_s - track_time_constant_s;
        let time_constant_s = track_time_constant_s + extra_s * self.turning_s / FULL_TURNING_S;
        let gain = low_pass_gain(span_s, time_constant_s);
        self.drift_sd_rad -= self.drift_sd_rad * gain;
        let error_rad = arg(forward * track.conj());
        let share_per_s2 = 0.25 / (time_constant_s * time_constant_s);
        HeadingCorrection { azimuth_rad: error_rad * gain, bias_rad_s: error_rad * share_per_s2 * span_s }
    }

    /// Returns the correction from a velocity increment over `span_s`. `by_force_m_s` and
    /// `by_fixes_m_s` are this increment as measured by the force and by the fixes, in platform
    /// axes, m/s.
    pub(super) fn correct_by_acceleration(
        &mut self,
        by_force_m_s: Complex<f64>,
        by_fixes_m_s: Complex<f64>,
        span_s: f64,
        settings: &PiSettings,
    ) -> HeadingCorrection {
        let (norm2, threshold_m_s) = (by_force_m_s.norm_sqr(), SIGNIFICANT_ACCELERATION_M_S2 * span_s);
        let regularised = norm2 + threshold_m_s * threshold_m_s;
        let cross = (by_fixes_m_s.conj() * by_force_m_s).im;
        let error_rad = if regularised > 0.0 {
            (cross / regularised).clamp(-MAX_AZIMUTH_ERROR_RAD, MAX_AZIMUTH_ERROR_RAD)
        } else {
            0.0
        };
        if norm2 > threshold_m_s * threshold_m_s {
            self.turning_s = (self.turning_s + span_s).min(FULL_TURNING_S);
        }
        let time_constant_s = settings.turn_time_constant_s;
        let share_per_s2 = 0.25 / (time_constant_s * settings.track_time_constant_s);
        HeadingCorrection {
            azimuth_rad: error_rad * low_pass_gain(span_s, time_constant_s),
            bias_rad_s: error_rad * share_per_s2 * span_s,
        }
    }

    /// Returns the standard deviation at the given speed, rad. It combines the drift with the crab
    /// angle in a typical wind. Turns reduce the part due to the crab angle by up to half.
    pub(super) fn sd_rad(&self, speed_m_s: f64) -> f64 {
        if !self.known {
            return PI;
        }
        let crab_rad = libm::atan2(TYPICAL_CROSSWIND_M_S, speed_m_s) * (1.0 - 0.5 * self.turning_s / FULL_TURNING_S);
        libm::hypot(self.drift_sd_rad, crab_rad).min(PI)
    }

    pub(super) fn validation_error(&self) -> Option<&'static str> {
        let invalid = self.drift_sd_rad < 0.0 || !(0.0..=FULL_TURNING_S).contains(&self.turning_s);
        invalid.then_some("a negative standard deviation or a time out of range")
    }
}

scalars!(Heading: known, drift_sd_rad, turning_s);
