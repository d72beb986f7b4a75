//! The fuser stage `levelling`: S4 as printed, aided and autonomous, switching by itself.

use super::{
    limits::{credible, interval_s},
    platform::{Law, Levelled, Platform},
    speed::Speed,
};
use crate::{
    Vector3,
    course::Reference,
    fuser::{
        carried::Carried,
        estimate::Estimate,
        fused::{Corrections, Fused},
        input::FuserInput,
        leaky_velocity::LeakyVelocity,
    },
    numbers::Numbers,
    parameters::{Parameter, ParameterError, Parameters, settings},
    stage::{RestoreError, Stage},
};
use core::f64::consts::PI;

settings! {
    /// Settings of `levelling`.
    pub struct PrintedSettings {
        /// Time constant of levelling with satellite velocity, 1/(K g). A short one hides the gyro's bias and shows the noise.
        time_constant_s: 5.0 in 1.0 .. 1000.0, "s";
        /// Time constant of levelling without it.
        autonomous_time_constant_s: 60.0 in 1.0 .. 10000.0, "s";
        /// Low-pass of the specific force without satellite velocity.
        low_pass_s: 20.0 in 0.0 .. 1000.0, "s";
        /// Time after the last fix from which levelling is autonomous.
        gap_s: 1.5 in 0.1 .. 60.0, "s";
    }
}

/// The fuser stage `levelling`.
///
/// The heading is free: it follows the gyro from wherever it began.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Levelling {
    settings: PrintedSettings,
    platform: Platform,
    speed: Speed,
    carried: Carried,
}

impl Levelling {
    pub(in crate::fuser) fn realign(&mut self) {
        self.platform.realign();
    }

    /// The law that is in force at this tick.
    fn law(&self) -> Law {
        if self.speed.is_told(self.settings.gap_s) {
            Law::Aided {
                speed_m_s: self.speed.along_m_s(),
                along_m_s2: self.speed.rate_m_s2(),
                time_constant_s: self.settings.time_constant_s,
            }
        } else {
            Law::Autonomous { time_constant_s: self.settings.autonomous_time_constant_s }
        }
    }
}

impl Stage for Levelling {
    type Input = FuserInput;
    type Output = Fused;
    type Common = Estimate;

    fn name(&self) -> &'static str {
        "levelling"
    }

    fn parameters(&self) -> &'static [Parameter] {
        PrintedSettings::TABLE
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        self.settings.set(name, value)
    }

    fn step(&mut self, input: &FuserInput) -> Fused {
        let mut room = None;
        let input = input.finite(&mut room);
        let mut corrections = Corrections::default();
        let dt_s = interval_s(input.motion.as_ref());
        let rate_rad_s = input.motion.map_or(Vector3::zeros(), |motion| motion.rate_rad_s);
        self.platform.turn(input.motion.as_ref(), dt_s);
        self.carried.observe(input);
        self.speed.wait(dt_s);
        if let Some(fix) = credible(input.fix.as_ref()) {
            self.speed.take(fix, self.settings.gap_s);
            corrections.velocity = true;
        }
        let mut innovation = 0.0;
        if let Some(inclination) = &input.inclination {
            match self.platform.see(inclination, rate_rad_s, self.law(), self.settings.low_pass_s) {
                Levelled::Set => corrections.aligned = true,
                Levelled::Moved { innovation_rad } => {
                    innovation = innovation_rad;
                    corrections.tilt = true;
                }
            }
        }
        self.speed.spend(dt_s);
        Fused {
            attitude: self.platform.attitude,
            rate_rad_s,
            bias_rad_s: Vector3::zeros(),
            innovation_rad: innovation,
            inclination_sd_rad: self.platform.inclination_sd_rad(),
            heading_sd_rad: PI,
            reference: Reference::Arbitrary,
            corrections,
        }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.platform.visit(visit);
        self.speed.visit(visit);
        self.carried.visit(visit);
    }

    fn flaw(&self) -> Option<&'static str> {
        self.platform.flaw().or_else(|| self.speed.flaw()).or_else(|| self.carried.flaw())
    }

    fn common(&self) -> Estimate {
        let (bias_rad_s, bias_sd_rad_s) = self.carried.bias();
        Estimate {
            attitude: self.platform.attitude,
            reference: Reference::Arbitrary,
            bias_rad_s,
            inclination_sd_rad: self.platform.inclination_sd_rad(),
            heading_sd_rad: PI,
            bias_sd_rad_s,
            gyro_scale: self.carried.gyro_scale(),
            hard_iron: self.carried.hard_iron(),
            leaky_velocity: LeakyVelocity::UNKNOWN,
        }
    }

    fn adopt(&mut self, common: &Estimate) -> Result<(), RestoreError> {
        common.checked()?;
        self.platform.adopt(common.attitude, self.settings.low_pass_s);
        self.carried = Carried::of(common);
        Ok(())
    }
}
