//! The closed loop of first order: the exact step applied to the fused point, then a move towards the accelerometer's.
//!
//! w_c' = f(w_c, ω) + (w_acc − w_c)/T — Matveev 2025, fig. 9, closed; z likewise by the magnetic field, and by the gyro alone without.

use super::{
    carried::Carried,
    compass::Compass,
    estimate::Estimate,
    fused::{Corrections, Fused, innovation_rad},
    input::FuserInput,
    leaky_velocity::LeakyVelocity,
    low_pass::low_pass_gain,
    spread::{BIAS_SD_RAD_S, Spread},
};
use crate::{
    Vector3,
    numbers::Numbers,
    parameters::{Parameter, ParameterError, Parameters, settings},
    point::Point,
    stage::{RestoreError, Stage, attitude_flaw},
    state::{Attitude, wrapped_rad},
};

/// Farthest that the accelerometer's point is taken to be from the chart's centre: 168.6° of tilt. Beyond it the sum of points
/// would leave the finite numbers.
pub(super) const POINT_LIMIT: f64 = 10.0;

settings! {
    /// Settings of `wz-closed`.
    pub struct Settings {
        /// Time constant T of the tilt: what is faster comes from the gyro, what is slower from the accelerometer.
        time_constant_s: 1.0 in 0.01 .. 1000.0, "s";
        /// The same for the heading, between the gyro and the magnetic field.
        heading_time_constant_s: 20.0 in 0.01 .. 10000.0, "s";
    }
}

/// The fuser stage `wz-closed`.
#[derive(Debug, Clone, PartialEq)]
pub struct WzClosed {
    settings: Settings,
    attitude: Attitude,
    started: bool,
    tilt: Spread,
    compass: Compass,
    carried: Carried,
}

impl Default for WzClosed {
    fn default() -> Self {
        Self {
            settings: Settings::default(),
            attitude: Attitude::default(),
            started: false,
            tilt: Spread::UNKNOWN,
            compass: Compass::default(),
            carried: Carried::default(),
        }
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
            self.attitude = self.attitude.turned(motion.turn).attitude;
        }
        self.tilt.drift(BIAS_SD_RAD_S, dt_s);
        self.compass.drift(dt_s);
        self.carried.observe(input);
        let mut innovation = 0.0;
        if let Some(inclination) = &input.inclination {
            if self.started {
                innovation = innovation_rad(inclination, self.attitude);
                let gain = low_pass_gain(dt_s, self.settings.time_constant_s);
                let Point { w, chart } = self.attitude.up;
                self.attitude.up.w += (inclination.up.seen_in(chart, POINT_LIMIT) - w) * gain;
                self.attitude = self.attitude.rebounded();
                self.tilt.corrected(innovation, gain, dt_s);
                corrections.tilt = true;
            } else {
                self.attitude = self.attitude.realigned(inclination.up).attitude;
                (self.started, self.tilt) = (true, Spread::FIRST);
                corrections.aligned = true;
            }
        }
        if let (true, Some(field_ut)) = (self.started, input.field_ut) {
            let time_constant_s = self.settings.heading_time_constant_s;
            let z_rad = self.compass.correction_rad(self.attitude, field_ut, time_constant_s, &mut corrections);
            self.attitude.z_rad = wrapped_rad(self.attitude.z_rad + z_rad);
        }
        Fused {
            attitude: self.attitude,
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
        self.attitude.visit(visit);
        self.started.visit(visit);
        self.tilt.visit(visit);
        self.compass.visit(visit);
        self.carried.visit(visit);
    }

    fn flaw(&self) -> Option<&'static str> {
        attitude_flaw(self.attitude)
            .or_else(|| self.tilt.flaw())
            .or_else(|| self.compass.flaw())
            .or_else(|| self.carried.flaw())
    }

    fn common(&self) -> Estimate {
        let (bias_rad_s, bias_sd_rad_s) = self.carried.bias();
        Estimate {
            attitude: self.attitude,
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

    fn adopt(&mut self, common: &Estimate) -> Result<(), RestoreError> {
        common.checked()?;
        self.attitude = common.attitude;
        self.started = true;
        self.tilt = Spread::of(common.inclination_sd_rad);
        self.compass = Compass::of(common.reference, common.heading_sd_rad);
        self.carried = Carried::of(common);
        Ok(())
    }
}
