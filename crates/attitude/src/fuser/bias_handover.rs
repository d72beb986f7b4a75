//! Gyro bias to hand over on a swap: the value received, or the mean rate at rest, whichever is
//! newer.
//!
//! Used by every stage that does not estimate the bias itself, or whose own estimate may be less
//! certain than this bias.

use super::{
    estimate::{BIAS_WALK_RAD_S, Estimate},
    gyro_scale::GyroScale,
    hard_iron::HardIron,
    input::FuserInput,
    rest::{BIAS_SD_AT_REST_RAD_S, MAX_SPEED_AT_REST_M_S, RestDetector, RestInput},
};
use crate::{
    Vector3,
    accel::{Inclination, MAX_PLAUSIBLE_FORCE_M_S2},
    scalars::scalars,
    stage::bias_validation_error,
};

/// Largest plausible component of the rate, rad/s. Samples with a larger component are not used.
const MAX_PLAUSIBLE_RATE_RAD_S: f64 = 1e3;
/// Interval between updates of the rest detector, s. Slightly below 0.2 s to tolerate rounding in
/// sums of intervals.
const UPDATE_INTERVAL_S: f64 = 0.2 - 1e-6;

/// Last known gyro bias and its age.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct HandedOverBias {
    bias_rad_s: Vector3<f64>,
    sd_rad_s: f64,
    age_s: f64,
    known: bool,
    gyro_scale: GyroScale,
    hard_iron: HardIron,
    /// Set if the last fix reported motion. Without this check, a smooth ride would look like rest.
    is_moving: bool,
    rest: RestDetector,
    since_update_s: f64,
}

impl HandedOverBias {
    /// Creates a store from a received estimate. Gyro scale and hard iron are passed on unchanged.
    pub(super) fn from_estimate(common: &Estimate) -> Self {
        let unknown = Self { gyro_scale: common.gyro_scale, hard_iron: common.hard_iron, ..Self::default() };
        if common.bias_sd_rad_s.is_infinite() {
            return unknown;
        }
        Self { bias_rad_s: common.bias_rad_s, sd_rad_s: common.bias_sd_rad_s, known: true, ..unknown }
    }

    /// Processes one sample: ages the bias and, at rest, replaces it with the mean rate.
    pub(super) fn observe(&mut self, input: &FuserInput) {
        let Some(motion) = &input.motion else { return };
        self.age_s += motion.dt_s;
        self.since_update_s += motion.dt_s;
        if let Some(fix) = &input.fix {
            self.is_moving = fix.velocity_m_s.norm() > MAX_SPEED_AT_REST_M_S;
        }
        let is_plausible = |inclination: &&Inclination| {
            inclination.norm_m_s2 <= MAX_PLAUSIBLE_FORCE_M_S2 && motion.rate_rad_s.amax() <= MAX_PLAUSIBLE_RATE_RAD_S
        };
        let inclination = input.inclination.as_ref().filter(is_plausible);
        let (Some(inclination), true, false) = (inclination, input.rest_credible, self.is_moving) else {
            self.rest.interrupt();
            return;
        };
        self.rest.observe(motion.rate_rad_s, input.field_ut, motion.dt_s);
        if self.since_update_s < UPDATE_INTERVAL_S {
            return;
        }
        self.rest.update(&RestInput {
            force_m_s2: inclination.force_m_s2,
            known_bias_rad_s: self.known.then_some(self.bias_rad_s),
            interval_s: core::mem::take(&mut self.since_update_s),
        });
        if let Some(bias_rad_s) = self.rest.bias_rad_s() {
            (self.bias_rad_s, self.sd_rad_s, self.age_s, self.known) = (bias_rad_s, BIAS_SD_AT_REST_RAD_S, 0.0, true);
        }
    }

    /// Returns the bias and the standard deviation of each component, rad/s. The standard deviation
    /// is infinite if the bias is unknown.
    fn bias(&self) -> (Vector3<f64>, f64) {
        let sd_rad_s = libm::hypot(self.sd_rad_s, BIAS_WALK_RAD_S * libm::sqrt(self.age_s));
        (self.bias_rad_s, if self.known { sd_rad_s } else { f64::INFINITY })
    }

    /// Returns the stored sensor errors as an estimate with an unknown attitude.
    pub(super) fn sensor_errors(&self) -> Estimate {
        let (bias_rad_s, bias_sd_rad_s) = self.bias();
        let Self { gyro_scale, hard_iron, .. } = *self;
        Estimate { bias_rad_s, bias_sd_rad_s, gyro_scale, hard_iron, ..Estimate::UNKNOWN }
    }

    /// Returns the stored sensor errors. If the stage's own bias has a smaller standard deviation,
    /// it replaces the stored bias.
    pub(super) fn sensor_errors_or(&self, bias_rad_s: Vector3<f64>, bias_sd_rad_s: f64) -> Estimate {
        let stored = self.sensor_errors();
        if bias_sd_rad_s <= stored.bias_sd_rad_s { Estimate { bias_rad_s, bias_sd_rad_s, ..stored } } else { stored }
    }

    /// Returns the reason why the state is invalid, or `None` if it is valid.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        let negative = self.sd_rad_s < 0.0 || self.age_s < 0.0 || self.since_update_s < 0.0;
        let negative = negative.then_some("an age or standard deviation below zero");
        bias_validation_error(self.bias_rad_s)
            .or(negative)
            .or_else(|| self.rest.validation_error())
            .or_else(|| self.gyro_scale.validation_error())
            .or_else(|| self.hard_iron.validation_error())
    }
}

scalars!(HandedOverBias: bias_rad_s, sd_rad_s, age_s, known, gyro_scale, hard_iron, is_moving, rest, since_update_s);
