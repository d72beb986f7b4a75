//! Standard deviation of a low-pass filtered angle, derived from the innovations of the angle.

use core::f64::consts::PI;

use crate::scalars::scalars;

/// Standard deviation of the gyro bias that is assumed by a stage without a bias estimate, rad/s.
///
/// The value is typical of a calibrated consumer MEMS gyro.
pub(super) const ASSUMED_BIAS_SD_RAD_S: f64 = 0.003;
/// Averaging time of the innovations' mean square, s.
const MEMORY_S: f64 = 1.0;
/// Standard deviation of an initial level, rad. It allows for a vehicle that accelerates by 1 m/s²
/// when the level is initialised.
const INITIAL_SD_RAD: f64 = 0.1;

/// Uncertainty of an angle.
///
/// If the angle is corrected by the fraction g of a white innovation, its variance σ² becomes (1 −
/// g)² σ² + g² ⟨innovation²⟩. Between corrections, the drift caused by a gyro bias is added to σ
/// itself. The model does not cover correlated innovations, such as those of a turning vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct AngleUncertainty {
    sd_rad: f64,
    innovation2_rad2: f64,
}

impl AngleUncertainty {
    /// Uncertainty of an unknown angle.
    pub(super) const UNKNOWN: Self = Self { sd_rad: PI, innovation2_rad2: 0.0 };
    /// Uncertainty of an angle that was just set from one sample.
    pub(super) const INITIAL: Self = Self { sd_rad: INITIAL_SD_RAD, innovation2_rad2: INITIAL_SD_RAD * INITIAL_SD_RAD };

    /// Creates the uncertainty from another stage's standard deviation.
    pub(super) fn from_sd(sd_rad: f64) -> Self {
        let sd_rad = sd_rad.min(PI);
        Self { sd_rad, innovation2_rad2: sd_rad * sd_rad }
    }

    /// Adds the drift that a gyro bias causes over `dt_s`.
    pub(super) fn drift(&mut self, bias_sd_rad_s: f64, dt_s: f64) {
        self.sd_rad = (self.sd_rad + bias_sd_rad_s * dt_s).min(PI);
    }

    /// Records a correction by the fraction `gain` of an innovation.
    pub(super) fn record_correction(&mut self, innovation_rad: f64, gain: f64, dt_s: f64) {
        self.innovation2_rad2 += (innovation_rad * innovation_rad - self.innovation2_rad2) * (dt_s / (MEMORY_S + dt_s));
        let remaining_rad = (1.0 - gain) * self.sd_rad;
        self.sd_rad = libm::sqrt(remaining_rad * remaining_rad + gain * gain * self.innovation2_rad2).min(PI);
    }

    /// Returns the root mean square of the innovations, rad.
    pub(super) fn innovation_rms_rad(&self) -> f64 {
        libm::sqrt(self.innovation2_rad2)
    }

    /// Returns the standard deviation, rad. It is at most π.
    pub(super) fn sd_rad(&self) -> f64 {
        self.sd_rad
    }

    pub(super) fn validation_error(&self) -> Option<&'static str> {
        (self.sd_rad < 0.0 || self.innovation2_rad2 < 0.0).then_some("a variance below zero")
    }
}

scalars!(AngleUncertainty: sd_rad, innovation2_rad2);
