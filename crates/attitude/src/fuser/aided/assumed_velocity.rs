//! Assumed velocity: the remembered speed along the course, and zero across it and vertically.
//!
//! The variances are large, and they increase further while the body turns. With fixed gains, the
//! update would be the autonomous law of platform levelling. That law uses the low-pass filtered
//! specific force minus V H', the product of speed and turn rate. An assumed velocity must not
//! change the course, so its gains for the heading and for the gyro bias about the body's vertical
//! are zero.

use super::{
    covariance::{ErrorState, GYRO, GYRO_UP, HEADING, Measurement, VELOCITY},
    filter::Aided,
    standstill::{WITH_RECEIVER, WITHOUT_RECEIVER},
    variance::{correlated_variance, square},
};
use crate::{
    Vector3,
    fuser::{input::FuserInput, rest::MAX_SPEED_AT_REST_M_S},
};

/// Interval between two updates with an assumed velocity, s.
const INTERVAL_S: f64 = 0.2;
/// Standard deviation of the zero velocity that is assumed at standstill, m/s.
const STANDSTILL_SD_M_S: f64 = 0.1;
/// Indices of the error states that an assumed velocity does not correct.
const CONSIDERED: [usize; 2] = [HEADING, GYRO_UP];

impl Aided {
    /// Updates the filter with an assumed velocity if one is due. Returns `true` if it was updated.
    ///
    /// An assumed velocity is used once the last fix is too old, or while fixes cannot be used
    /// because the course is unknown.
    pub(super) fn apply_assumed_velocity(&mut self) -> bool {
        let settings = self.settings;
        let interval_s = self.aiding.since_assumed_s;
        let has_fix = self.aiding.since_fix_s < settings.fix_timeout_s;
        if interval_s < INTERVAL_S - 5e-4 || (has_fix && self.course_known) {
            return false;
        }
        let Some((forward, _)) = self.forward() else { return false };
        self.aiding.since_assumed_s = 0.0;
        let (sin, cos) = libm::sincos(self.aiding.crab_rad);
        // Direction of travel: forward, rotated clockwise by the crab angle.
        let along = Vector3::new(cos * forward.x + sin * forward.y, cos * forward.y - sin * forward.x, 0.0);
        let across = Vector3::new(along.y, -along.x, 0.0);
        let turn_factor = 1.0 + square(self.turn_rate_rad_s / settings.half_weight_turn_rate_deg_s.to_radians());
        let (along_m_s, across_m_s) = (along.dot(&self.velocity_m_s), across.dot(&self.velocity_m_s));
        let (speed_m_s, along_sd_m_s) = if self.aiding.has_velocity {
            (self.aiding.speed_m_s, settings.along_sd_m_s)
        } else {
            (0.0, settings.speed_sd_m_s)
        };
        // If the heading does not refer to north, it defines the reference frame and therefore has
        // no error.
        let heading_factor = if self.course_known { 1.0 } else { 0.0 };
        let mut error = ErrorState::zeros();
        let mut measure = |residual: f64, row: &[(usize, f64)], variance: f64| {
            let measurement = Measurement { residual, row, variance, considered: &CONSIDERED };
            self.covariance.update(&mut error, settings.innovation_limit, &measurement);
        };
        measure(
            along_m_s - speed_m_s,
            &[(VELOCITY, along.x), (VELOCITY + 1, along.y), (HEADING, heading_factor * -across_m_s)],
            correlated_variance(along_sd_m_s, settings.along_memory_s, interval_s) * turn_factor,
        );
        measure(
            across_m_s,
            &[(VELOCITY, across.x), (VELOCITY + 1, across.y), (HEADING, heading_factor * along_m_s)],
            correlated_variance(settings.across_sd_m_s, settings.across_memory_s, interval_s) * turn_factor,
        );
        measure(
            self.velocity_m_s.z,
            &[(VELOCITY + 2, 1.0)],
            correlated_variance(settings.vertical_sd_m_s, settings.vertical_memory_s, interval_s),
        );
        self.apply_correction(&error);
        true
    }

    /// Updates the filter at standstill. Returns `true` if it was updated.
    ///
    /// At standstill the mean rate is a measurement of the gyro bias. If there are no recent fixes,
    /// a velocity of zero is used as a measurement, too.
    pub(super) fn apply_standstill(&mut self, input: &FuserInput, force_m_s2: Option<Vector3<f64>>) -> bool {
        let (Some(motion), Some(force_m_s2), true) = (&input.motion, force_m_s2, input.rest_credible) else {
            self.standstill.reset();
            return false;
        };
        let has_fix = self.aiding.since_fix_s < self.settings.fix_timeout_s;
        let limits = match (self.aiding.has_velocity, has_fix && self.aiding.speed_m_s < MAX_SPEED_AT_REST_M_S) {
            (true, true) => Some(&WITH_RECEIVER),
            (true, false) => None,
            (false, _) => Some(&WITHOUT_RECEIVER),
        };
        let rate_rad_s = motion.rate_rad_s.map(|x| x.clamp(-1e3, 1e3));
        let Some(mean_rad_s) = self.standstill.update(rate_rad_s, force_m_s2, motion.dt_s, limits) else {
            return false;
        };
        let mut error = ErrorState::zeros();
        let variance = square(self.settings.standstill_sd_deg_s.to_radians());
        for axis in 0..3 {
            let residual = self.gyro_bias_rad_s[axis] - mean_rad_s[axis];
            let row = [(GYRO + axis, 1.0)];
            let measurement = Measurement { residual, row: &row, variance, considered: &[] };
            self.covariance.update(&mut error, self.settings.innovation_limit, &measurement);
        }
        if !has_fix {
            for axis in 0..3 {
                let row = [(VELOCITY + axis, 1.0)];
                let (residual, variance) = (self.velocity_m_s[axis], square(STANDSTILL_SD_M_S));
                let measurement = Measurement { residual, row: &row, variance, considered: &CONSIDERED };
                self.covariance.update(&mut error, self.settings.innovation_limit, &measurement);
            }
        }
        self.apply_correction(&error);
        true
    }
}
