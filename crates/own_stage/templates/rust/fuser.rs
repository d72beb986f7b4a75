//! The stage `@name@` for the slot fuser: where up is, from the gyro's motion and the accelerometer's direction.
//!
//! Input: what of motion and inclination a tick has. Output: the attitude. Time: the motion's interval. Failure: what is missing or not
//! a number is left out.

use attitude::{
    Vector3,
    course::Reference,
    fuser::{Corrections, Estimate, Fused, FuserInput, FuserStage, innovation_rad},
    parameters::{Parameter, ParameterError},
    point::Chart,
    stage::{RestoreError, Stage},
    state::Attitude,
};

/// The name by which it is chosen.
pub const NAME: &str = "@name@";

/// Standard deviations that are told as long as nothing better is known, rad.
const INCLINATION_SD_RAD: f64 = 0.1;
const HEADING_SD_RAD: f64 = std::f64::consts::PI;

const PARAMETERS: &[Parameter] = &[Parameter {
    name: "time_constant_s",
    unit: "s",
    default: 1.0,
    least: 0.01,
    most: 1000.0,
    about: "What is faster comes from the gyro, what is slower from the accelerometer.",
}];

/// Turns with the gyro and leans towards the accelerometer, by 1 − e^{−dt/T} of the way at each tick.
#[derive(Debug, Clone)]
pub struct @Class@ {
    time_constant_s: f64,
    attitude: Attitude,
    started: bool,
}

impl Default for @Class@ {
    fn default() -> Self {
        Self { time_constant_s: PARAMETERS[0].default, attitude: Attitude::default(), started: false }
    }
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
        NAME
    }

    fn parameters(&self) -> &'static [Parameter] {
        PARAMETERS
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        let known = PARAMETERS.iter().find(|parameter| parameter.name == name);
        let parameter = known.ok_or(ParameterError::Unknown { known: PARAMETERS })?;
        if !(parameter.least..=parameter.most).contains(&value) {
            return Err(ParameterError::OutOfRange { parameter, value });
        }
        self.time_constant_s = value;
        Ok(())
    }

    fn step(&mut self, input: &FuserInput) -> Fused {
        let mut room = None;
        let input = input.finite(&mut room);
        let mut corrections = Corrections::default();
        let mut innovation = 0.0;
        if let Some(motion) = &input.motion {
            self.attitude = self.attitude.turned(motion.turn).attitude;
        }
        if let Some(inclination) = &input.inclination {
            let seen = inclination.up.direction();
            let vertical = 1.0 + seen.dot(&self.attitude.up.direction());
            if !self.started {
                self.attitude = self.attitude.realigned(inclination.up).attitude;
                self.started = true;
                corrections.aligned = true;
            } else if vertical > 1e-6 {
                innovation = innovation_rad(inclination, self.attitude);
                let dt_s = input.motion.map_or(0.0, |motion| motion.dt_s);
                let share = -(-dt_s / self.time_constant_s).exp_m1();
                let lean = self.attitude.horizontal(seen) / vertical;
                self.attitude = self.attitude.leaned(lean * share).attitude;
                corrections.tilt = true;
            }
        }
        Fused {
            attitude: self.attitude,
            rate_rad_s: input.motion.map_or(Vector3::zeros(), |motion| motion.rate_rad_s),
            bias_rad_s: Vector3::zeros(),
            innovation_rad: innovation,
            inclination_sd_rad: INCLINATION_SD_RAD,
            heading_sd_rad: HEADING_SD_RAD,
            reference: Reference::Arbitrary,
            corrections,
        }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let mut inverted = f64::from(self.attitude.up.chart as u8);
        let mut started = f64::from(u8::from(self.started));
        visit(&mut self.attitude.up.w.re);
        visit(&mut self.attitude.up.w.im);
        visit(&mut inverted);
        visit(&mut self.attitude.z_rad);
        visit(&mut started);
        self.attitude.up.chart = if inverted > 0.5 { Chart::Inverted } else { Chart::Upright };
        self.started = started > 0.5;
    }

    fn flaw(&self) -> Option<&'static str> {
        let inside = self.attitude.up.w.norm_sqr() <= 2.0 && self.attitude.z_rad.abs() <= 4.0;
        (!inside).then_some("an attitude outside its chart")
    }

    fn common(&self) -> Estimate {
        Estimate {
            attitude: self.attitude,
            inclination_sd_rad: INCLINATION_SD_RAD,
            heading_sd_rad: HEADING_SD_RAD,
            ..Estimate::UNKNOWN
        }
    }

    fn adopt(&mut self, common: &Estimate) -> Result<(), RestoreError> {
        common.checked()?;
        (self.attitude, self.started) = (common.attitude, true);
        Ok(())
    }
}
