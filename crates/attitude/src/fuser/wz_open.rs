//! The open loop as published: w_c = HPF(w_gyro) + LPF(w_acc).
//!
//! Because HPF = 1 − LPF, w_c = w_gyro + e with T e' = (w_acc − w_gyro) − e — Matveev 2025, fig. 9, T = 1 s; z likewise by the magnetic
//! field, and by the gyro alone without. The gyro channel integrates by itself and drifts without bound, so the error grows with
//! time: that is the published method, kept for comparison.

use super::{
    carried::Carried,
    compass::Compass,
    estimate::Estimate,
    fused::{Corrections, Fused, innovation_rad},
    input::FuserInput,
    leaky_velocity::LeakyVelocity,
    low_pass::low_pass_gain,
    spread::{BIAS_SD_RAD_S, Spread},
    wz_closed::POINT_LIMIT,
};
use crate::{
    Complex, Vector3,
    gyro::Motion,
    numbers::Numbers,
    parameters::{Parameter, ParameterError, Parameters, settings},
    point::Point,
    stage::{RestoreError, Stage, attitude_flaw},
    state::{Attitude, wrapped_rad},
};

settings! {
    /// Settings of `wz-open`.
    pub struct Settings {
        /// Time constant T of the tilt: what is faster comes from the gyro, what is slower from the accelerometer.
        time_constant_s: 1.0 in 0.01 .. 1000.0, "s";
        /// The same for the heading, between the gyro and the magnetic field.
        heading_time_constant_s: 20.0 in 0.01 .. 10000.0, "s";
    }
}

/// The fuser stage `wz-open`.
#[derive(Debug, Clone, PartialEq)]
pub struct WzOpen {
    settings: Settings,
    /// The gyro slot's own attitude, as it was last told.
    gyro: Attitude,
    /// Of the points, in the gyro's chart.
    difference: Complex<f64>,
    /// Of z, rad.
    z_difference_rad: f64,
    /// `gyro` is an attitude taken over, not the gyro slot's.
    adopted: bool,
    started: bool,
    tilt: Spread,
    compass: Compass,
    carried: Carried,
}

impl Default for WzOpen {
    fn default() -> Self {
        Self {
            settings: Settings::default(),
            gyro: Attitude::default(),
            difference: Complex::new(0.0, 0.0),
            z_difference_rad: 0.0,
            adopted: false,
            started: false,
            tilt: Spread::UNKNOWN,
            compass: Compass::default(),
            carried: Carried::default(),
        }
    }
}

impl WzOpen {
    pub(super) fn realign(&mut self) {
        self.started = false;
    }

    fn fused(&self) -> Attitude {
        let up = Point { w: self.gyro.up.w + self.difference, chart: self.gyro.up.chart };
        Attitude { up, z_rad: wrapped_rad(self.gyro.z_rad + self.z_difference_rad) }.rebounded()
    }

    /// Follows the gyro's attitude.
    fn follow(&mut self, motion: &Motion) {
        if self.adopted {
            self.compare(self.gyro.turned(motion.turn).attitude, motion.attitude);
            self.adopted = false;
        }
        self.follow_chart(motion.attitude);
    }

    /// Follows the gyro's attitude into its chart; the fused point stays where it is.
    fn follow_chart(&mut self, gyro: Attitude) {
        if gyro.up.chart != self.gyro.up.chart {
            let fused = Point { w: self.gyro.up.w + self.difference, chart: self.gyro.up.chart };
            let before = self.gyro.up.seen_in(gyro.up.chart, POINT_LIMIT);
            self.difference = fused.seen_in(gyro.up.chart, POINT_LIMIT) - before;
        }
        self.gyro = gyro;
    }

    /// Takes the difference between the fused attitude and the gyro's.
    fn compare(&mut self, fused: Attitude, gyro: Attitude) {
        self.difference = fused.up.seen_in(gyro.up.chart, POINT_LIMIT) - gyro.up.w;
        self.gyro = gyro;
        // What is left between the two is a turn about the vertical.
        let turn = fused.quaternion() * self.fused().quaternion().conjugate();
        self.z_difference_rad = wrapped_rad(self.z_difference_rad + 2.0 * libm::atan2(turn.k, turn.w));
    }
}

impl Stage for WzOpen {
    type Input = FuserInput;
    type Output = Fused;
    type Common = Estimate;

    fn name(&self) -> &'static str {
        "wz-open"
    }

    fn parameters(&self) -> &'static [Parameter] {
        Settings::TABLE
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        self.settings.set(name, value)
    }

    fn step(&mut self, input: &FuserInput) -> Fused {
        let mut room = None;
        let input = input.finite(&mut room);
        let mut corrections = Corrections::default();
        let dt_s = input.motion.map_or(0.0, |motion| motion.dt_s);
        if let Some(motion) = &input.motion {
            self.follow(motion);
        }
        self.tilt.drift(BIAS_SD_RAD_S, dt_s);
        self.compass.drift(dt_s);
        self.carried.observe(input);
        let mut innovation = 0.0;
        if let Some(inclination) = &input.inclination {
            let Point { w, chart } = self.gyro.up;
            let distance = inclination.up.seen_in(chart, POINT_LIMIT) - w;
            if self.started {
                let gain = low_pass_gain(dt_s, self.settings.time_constant_s);
                self.difference += (distance - self.difference) * gain;
                innovation = innovation_rad(inclination, self.fused());
                self.tilt.corrected(innovation, gain, dt_s);
                corrections.tilt = true;
            } else {
                self.difference = distance;
                (self.started, self.tilt) = (true, Spread::FIRST);
                corrections.aligned = true;
            }
        }
        if let (true, Some(field_ut)) = (self.started, input.field_ut) {
            let time_constant_s = self.settings.heading_time_constant_s;
            let z_rad = self.compass.correction_rad(self.fused(), field_ut, time_constant_s, &mut corrections);
            self.z_difference_rad = wrapped_rad(self.z_difference_rad + z_rad);
        }
        Fused {
            attitude: self.fused(),
            rate_rad_s: input.motion.map_or(Vector3::zeros(), |motion| motion.rate_rad_s),
            bias_rad_s: Vector3::zeros(),
            innovation_rad: innovation,
            inclination_sd_rad: self.tilt.sd_rad(),
            heading_sd_rad: self.compass.sd_rad(),
            reference: self.compass.reference(),
            corrections,
        }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.gyro.visit(visit);
        self.difference.visit(visit);
        self.z_difference_rad.visit(visit);
        self.adopted.visit(visit);
        self.started.visit(visit);
        self.tilt.visit(visit);
        self.compass.visit(visit);
        self.carried.visit(visit);
    }

    fn flaw(&self) -> Option<&'static str> {
        // Two points, each within the limit.
        let apart = self.difference.norm_sqr() > 4.0 * POINT_LIMIT * POINT_LIMIT || self.z_difference_rad.abs() > 4.0;
        attitude_flaw(self.gyro)
            .or(apart.then_some("a difference between two attitudes that no two have"))
            .or_else(|| self.tilt.flaw())
            .or_else(|| self.compass.flaw())
            .or_else(|| self.carried.flaw())
    }

    fn common(&self) -> Estimate {
        let (bias_rad_s, bias_sd_rad_s) = self.carried.bias();
        Estimate {
            attitude: self.fused(),
            reference: self.compass.reference(),
            bias_rad_s,
            inclination_sd_rad: self.tilt.sd_rad(),
            heading_sd_rad: self.compass.sd_rad(),
            bias_sd_rad_s,
            gyro_scale: self.carried.gyro_scale(),
            hard_iron: self.carried.hard_iron(),
            leaky_velocity: LeakyVelocity::UNKNOWN,
        }
    }

    /// The gyro's attitude comes from outside and is another one than this; the difference is taken at the next motion.
    fn adopt(&mut self, common: &Estimate) -> Result<(), RestoreError> {
        common.checked()?;
        self.gyro = common.attitude;
        (self.difference, self.z_difference_rad) = (Complex::new(0.0, 0.0), 0.0);
        (self.adopted, self.started) = (true, true);
        self.tilt = Spread::of(common.inclination_sd_rad);
        self.compass = Compass::of(common.reference, common.heading_sd_rad);
        self.carried = Carried::of(common);
        Ok(())
    }
}
