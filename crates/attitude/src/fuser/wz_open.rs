//! The open loop as published: w_c = HPF(w_gyro) + LPF(w_acc).
//!
//! Because HPF = 1 − LPF, w_c = w_gyro + e with T e' = (w_acc − w_gyro) − e — Matveev 2025, fig. 9, T = 1 s. The gyro channel
//! integrates by itself and drifts without bound, so the error grows with time: that is the published method, kept for comparison.

use super::{Corrections, Estimate, Fused, FuserInput, innovation_rad, low_pass_gain, wz_closed::POINT_LIMIT};
use core::f64::consts::PI;

use crate::{
    Complex, Vector3,
    course::Reference,
    gyro::Motion,
    point::Point,
    stage::{Numbers, RestoreError, Stage, attitude_flaw},
    state::{Attitude, arg},
};

/// The fuser stage `wz-open`.
#[derive(Debug, Clone, PartialEq)]
pub struct WzOpen {
    time_constant_s: f64,
    gyro: Attitude,
    difference: Complex<f64>,
    /// The fused z less the gyro's: what another stage had found.
    heading_rad: f64,
    /// `gyro` is not the gyro's attitude yet but that of another stage.
    adopted: bool,
    started: bool,
    innovation2_rad2: f64,
}

impl Default for WzOpen {
    fn default() -> Self {
        Self {
            time_constant_s: 1.0,
            gyro: Attitude::default(),
            difference: Complex::new(0.0, 0.0),
            heading_rad: 0.0,
            adopted: false,
            started: false,
            innovation2_rad2: 0.0,
        }
    }
}

impl WzOpen {
    pub(super) fn realign(&mut self) {
        self.started = false;
    }

    fn fused(&self) -> Attitude {
        let up = Point { w: self.gyro.up.w + self.difference, chart: self.gyro.up.chart };
        Attitude { up, z_rad: self.gyro.z_rad + self.heading_rad }.rebounded()
    }

    /// Holds the gyro's attitude against the one taken over, turned with the body since.
    fn part(&mut self, motion: &Motion) {
        let fused = self.fused().turned(motion.turn).attitude;
        self.gyro = motion.attitude;
        self.difference = fused.up.seen_in(self.gyro.up.chart, POINT_LIMIT) - self.gyro.up.w;
        self.heading_rad = 0.0;
        let about_vertical = fused.quaternion() * self.fused().quaternion().conjugate();
        self.heading_rad = 2.0 * arg(Complex::new(about_vertical.w, about_vertical.k));
    }

    /// Follows the gyro's attitude into its chart; the fused point stays where it is.
    fn follow(&mut self, gyro: Attitude) {
        if gyro.up.chart != self.gyro.up.chart {
            let fused = Point { w: self.gyro.up.w + self.difference, chart: self.gyro.up.chart };
            let before = self.gyro.up.seen_in(gyro.up.chart, POINT_LIMIT);
            self.difference = fused.seen_in(gyro.up.chart, POINT_LIMIT) - before;
        }
        self.gyro = gyro;
    }
}

impl Stage for WzOpen {
    type Input = FuserInput;
    type Output = Fused;
    type Common = Estimate;

    fn name(&self) -> &'static str {
        "wz-open"
    }

    fn step(&mut self, input: &FuserInput) -> Fused {
        let mut corrections = Corrections::default();
        let dt_s = input.motion.map_or(0.0, |motion| motion.dt_s);
        if let Some(motion) = &input.motion {
            if core::mem::take(&mut self.adopted) {
                self.part(motion);
            } else {
                self.follow(motion.attitude);
            }
        }
        let gain = low_pass_gain(dt_s, self.time_constant_s);
        let mut innovation = 0.0;
        if let Some(inclination) = &input.inclination {
            let Point { w, chart } = self.gyro.up;
            let distance = inclination.up.seen_in(chart, POINT_LIMIT) - w;
            if self.started {
                self.difference += (distance - self.difference) * gain;
                innovation = innovation_rad(inclination, self.fused());
                self.innovation2_rad2 += (innovation * innovation - self.innovation2_rad2) * gain;
                corrections.tilt = true;
            } else {
                self.difference = distance;
                self.started = true;
                corrections.aligned = true;
            }
        }
        Fused {
            attitude: self.fused(),
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
        self.gyro.visit(visit);
        self.difference.visit(visit);
        self.heading_rad.visit(visit);
        self.adopted.visit(visit);
        self.started.visit(visit);
        self.innovation2_rad2.visit(visit);
    }
    fn flaw(&self) -> Option<&'static str> {
        attitude_flaw(self.gyro).or((self.innovation2_rad2 < 0.0).then_some("a mean square below zero"))
    }

    fn common(&self) -> Estimate {
        Estimate {
            attitude: self.fused(),
            reference: Reference::Arbitrary,
            bias_rad_s: Vector3::zeros(),
            inclination_sd_rad: libm::sqrt(self.innovation2_rad2),
            heading_sd_rad: PI,
            bias_sd_rad_s: f64::INFINITY,
        }
    }

    fn adopt(&mut self, common: &Estimate) -> Result<(), RestoreError> {
        common.checked()?;
        self.gyro = common.attitude;
        self.difference = Complex::new(0.0, 0.0);
        self.heading_rad = 0.0;
        self.adopted = true;
        self.started = true;
        Ok(())
    }
}
