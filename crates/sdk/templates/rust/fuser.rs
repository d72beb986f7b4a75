//! Stage `@name@` for the slot fuser: the attitude, from gyro and accelerometer.
//!
//! Input: the motion and the inclination of a tick. Both may be missing.
//!
//! Output: the attitude.
//!
//! Time: the interval of the motion.
//!
//! Failure: non-finite numbers are treated as missing.

use attitude::{
    fuser::{Corrections, Estimate, Fused, FuserInput, FuserStage, innovation_rad},
    parameters::{Parameter, ParameterError, Parameters, settings},
    scalars::Scalars,
    stage::{RestoreError, Stage, attitude_validation_error},
    state::Attitude,
};

/// Reported standard deviation of the inclination, rad. It is fixed, because the stage does not
/// estimate it.
const INCLINATION_SD_RAD: f64 = 0.1;
/// Standard deviation of the heading, rad. The value π means that the heading is unknown.
const HEADING_SD_RAD: f64 = std::f64::consts::PI;

settings! {
    /// Settings of the stage.
    pub struct Settings {
        /// Time constant of the correction of the tilt towards the accelerometer.
        time_constant_s: 1.0 in 0.01 .. 1000.0, "s";
    }
}

/// Complementary filter: the attitude follows the gyro, and the accelerometer corrects its tilt.
///
/// Each tick of length dt corrects a fraction 1 − e^{−dt/T} of the tilt difference, where T is the
/// time constant.
#[derive(Debug, Clone, Default)]
pub struct @Class@ {
    settings: Settings,
    attitude: Attitude,
    started: bool,
}

impl FuserStage for @Class@ {
    fn realign(&mut self) {
        self.started = false;
    }
}

impl Stage for @Class@ {
    type Input = FuserInput;
    type Output = Fused;
    type Common = Estimate;

    fn name(&self) -> &'static str {
        "@name@"
    }

    fn parameters(&self) -> &'static [Parameter] {
        Settings::TABLE
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        self.settings.set(name, value)
    }

    fn step(&mut self, input: &FuserInput) -> Fused {
        let mut storage = None;
        let FuserInput { motion, inclination, .. } = input.sanitized(&mut storage);
        let motion = motion.unwrap_or_default();
        let mut fused = Fused { rate_rad_s: motion.rate_rad_s, ..Fused::default() };
        (fused.inclination_sd_rad, fused.heading_sd_rad) = (INCLINATION_SD_RAD, HEADING_SD_RAD);
        self.attitude = self.attitude.rotated(motion.rotation).attitude;
        if let Some(inclination) = inclination {
            let direction = inclination.up.direction();
            let vertical = 1.0 + direction.dot(&self.attitude.up.direction());
            if !self.started {
                self.attitude = self.attitude.realigned(inclination.up).attitude;
                self.started = true;
                fused.corrections = Corrections { aligned: true, ..fused.corrections };
            } else if vertical > 1e-6 {
                fused.innovation_rad = innovation_rad(inclination, self.attitude);
                let gain = -(-motion.dt_s / self.settings.time_constant_s).exp_m1();
                let tilt = self.attitude.horizontal(direction) / vertical;
                self.attitude = self.attitude.tilted(tilt * gain).attitude;
                fused.corrections = Corrections { tilt: true, ..fused.corrections };
            }
        }
        Fused { attitude: self.attitude, ..fused }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let Self { settings: _, attitude, started } = self;
        attitude.visit(visit);
        started.visit(visit);
    }

    fn validation_error(&self) -> Option<&'static str> {
        attitude_validation_error(self.attitude)
    }

    fn common(&self) -> Estimate {
        let (inclination_sd_rad, heading_sd_rad) = (INCLINATION_SD_RAD, HEADING_SD_RAD);
        Estimate { attitude: self.attitude, inclination_sd_rad, heading_sd_rad, ..Estimate::UNKNOWN }
    }

    fn adopt(&mut self, common: &Estimate) -> Result<(), RestoreError> {
        common.validate()?;
        (self.attitude, self.started) = (common.attitude, true);
        Ok(())
    }
}
