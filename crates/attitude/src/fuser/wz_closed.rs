//! The closed loop of first order: the exact step applied to the fused point, then a move towards the accelerometer's.
//!
//! w_c' = f(w_c, ω) + (w_acc − w_c)/T — Matveev 2025, fig. 9, closed. z follows the gyro.

use super::{Corrections, Estimate, Fused, FuserInput, innovation_rad, low_pass_gain};
use core::f64::consts::PI;

use crate::{
    Vector3,
    course::Reference,
    point::Point,
    stage::{Numbers, RestoreError, Stage, attitude_flaw},
    state::Attitude,
};

/// Farthest that the accelerometer's point is taken to be from the chart's centre: 168.6° of tilt. Beyond it the sum of points
/// would leave the finite numbers.
pub(super) const POINT_LIMIT: f64 = 10.0;

/// The fuser stage `wz-closed`.
#[derive(Debug, Clone, PartialEq)]
pub struct WzClosed {
    time_constant_s: f64,
    attitude: Attitude,
    started: bool,
    innovation2_rad2: f64,
}

impl Default for WzClosed {
    fn default() -> Self {
        Self { time_constant_s: 1.0, attitude: Attitude::default(), started: false, innovation2_rad2: 0.0 }
    }
}

impl WzClosed {
    pub(super) fn realign(&mut self) {
        self.started = false;
    }
}

impl Stage for WzClosed {
    type Input = FuserInput;
    type Output = Fused;
    type Common = Estimate;

    fn name(&self) -> &'static str {
        "wz-closed"
    }

    fn step(&mut self, input: &FuserInput) -> Fused {
        let mut corrections = Corrections::default();
        let dt_s = input.motion.map_or(0.0, |motion| motion.dt_s);
        if let Some(motion) = &input.motion {
            self.attitude = self.attitude.turned(motion.turn).attitude;
        }
        let gain = low_pass_gain(dt_s, self.time_constant_s);
        let mut innovation = 0.0;
        if let Some(inclination) = &input.inclination {
            if self.started {
                innovation = innovation_rad(inclination, self.attitude);
                let Point { w, chart } = self.attitude.up;
                self.attitude.up.w += (inclination.up.seen_in(chart, POINT_LIMIT) - w) * gain;
                self.attitude = self.attitude.rebounded();
                self.innovation2_rad2 += (innovation * innovation - self.innovation2_rad2) * gain;
                corrections.tilt = true;
            } else {
                self.attitude = self.attitude.realigned(inclination.up).attitude;
                self.started = true;
                corrections.aligned = true;
            }
        }
        Fused {
            attitude: self.attitude,
            rate_rad_s: input.motion.map_or(Vector3::zeros(), |motion| motion.rate_rad_s),
            bias_rad_s: Vector3::zeros(),
            innovation_rad: innovation,
            // White noise through a first-order low-pass: variance times gain / (2 − gain).
            inclination_sd_rad: libm::sqrt(self.innovation2_rad2 * gain / (2.0 - gain)),
            heading_sd_rad: PI,
            reference: Reference::Arbitrary,
            corrections,
        }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.attitude.visit(visit);
        self.started.visit(visit);
        self.innovation2_rad2.visit(visit);
    }
    fn flaw(&self) -> Option<&'static str> {
        attitude_flaw(self.attitude).or((self.innovation2_rad2 < 0.0).then_some("a mean square below zero"))
    }

    fn common(&self) -> Estimate {
        Estimate {
            attitude: self.attitude,
            reference: Reference::Arbitrary,
            bias_rad_s: Vector3::zeros(),
            inclination_sd_rad: libm::sqrt(self.innovation2_rad2),
            heading_sd_rad: PI,
            bias_sd_rad_s: f64::INFINITY,
        }
    }

    fn adopt(&mut self, common: &Estimate) -> Result<(), RestoreError> {
        common.checked()?;
        self.attitude = common.attitude;
        self.started = true;
        Ok(())
    }
}
