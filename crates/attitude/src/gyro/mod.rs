//! Gyro stages: compute an open-loop attitude and the exact rotation of each step from the rate.
//!
//! Input: the body rate and the length of the interval.
//!
//! Output: the integrated attitude, and the rotation (p, s) that a fuser applies to its own state.
//!
//! Time: the length of the interval. An interval that is negative or not finite counts as 0.
//!
//! Failure: a rate that is not finite is replaced by the previous one. Because of the gyro bias,
//! the attitude drifts without bound.

mod coning;
mod motion;
pub mod supervised;

pub use motion::{Motion, RateKind, RateSample};
pub use supervised::SupervisedGyro;

use crate::{
    Vector3, kinematics,
    rotation::Rotation,
    scalars::{Scalars, are_finite},
    stage::{RestoreError, Stage, attitude_validation_error},
    state::Attitude,
};
use coning::Coning;

/// Longest interval between two rate samples that is still integrated, s. A longer interval resets
/// the level.
pub const MAX_BRIDGED_GAP_S: f64 = 1.0;

/// Maximum rate, rad/s. It is above the range of any gyro. Larger rates are clamped.
const MAX_RATE_RAD_S: f64 = 1000.0;

/// Integration method of a gyro stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Method {
    Mobius,
    MobiusConing,
    Rk4,
    Euler,
}

/// Gyro stage: `mobius`, `mobius-coning`, `rk4` or `euler`.
///
/// - `mobius` is exact for a constant rate.
/// - `mobius-coning` is meant for bodies that vibrate. It also compensates for the motion of the
///   rotation axis, which it estimates from the previous samples.
/// - `rk4` is the method of simulation S1 of Matveev 2025. In a rotation of 4 rad/s sampled at 286
///   Hz it drifts by about 2e-6° per minute.
/// - `euler` drifts by tens of degrees per minute at 4 rad/s. It is included because Matveev 2025
///   counts operations for this method.
#[derive(Debug, Clone, PartialEq)]
pub struct Gyro {
    method: Method,
    attitude: Attitude,
    previous_rate_rad_s: Vector3<f64>,
    started: bool,
    coning: Coning,
}

impl Default for Gyro {
    /// Returns the stage `mobius`.
    fn default() -> Self {
        Self {
            method: Method::Mobius,
            attitude: Attitude::default(),
            previous_rate_rad_s: Vector3::zeros(),
            started: false,
            coning: Coning::default(),
        }
    }
}

impl Gyro {
    /// Names of the stages; the first is the default.
    pub const NAMES: [&'static str; 4] = ["mobius", "mobius-coning", "rk4", "euler"];

    /// Creates the stage with the given name, or returns `None` for an unknown name.
    pub fn from_name(name: &str) -> Option<Self> {
        let method = match name {
            "mobius" => Method::Mobius,
            "mobius-coning" => Method::MobiusConing,
            "rk4" => Method::Rk4,
            "euler" => Method::Euler,
            _ => return None,
        };
        Some(Self { method, ..Self::default() })
    }

    /// Returns the open-loop attitude.
    pub fn attitude(&self) -> Attitude {
        self.attitude
    }
}

/// Stage that can fill the slot `gyro`.
pub trait GyroStage: Stage<Input = RateSample, Output = Motion, Common = Attitude> + Clone {
    /// Sets the attitude from which integration continues.
    fn align(&mut self, attitude: Attitude);
}

impl GyroStage for Gyro {
    fn align(&mut self, attitude: Attitude) {
        self.attitude = attitude;
    }
}

impl Stage for Gyro {
    type Input = RateSample;
    type Output = Motion;
    /// Open-loop attitude.
    type Common = Attitude;

    fn name(&self) -> &'static str {
        match self.method {
            Method::Mobius => "mobius",
            Method::MobiusConing => "mobius-coning",
            Method::Rk4 => "rk4",
            Method::Euler => "euler",
        }
    }

    #[inline(always)]
    fn step(&mut self, sample: &RateSample) -> Motion {
        let is_valid = sample.dt_s >= 0.0 && sample.dt_s.is_finite();
        let dt_s = if is_valid { sample.dt_s } else { 0.0 };
        let rate_rad_s =
            if are_finite(sample.rate_rad_s.into()) { sample.rate_rad_s } else { self.previous_rate_rad_s };
        let end_rad_s = rate_rad_s.map(|component| component.clamp(-MAX_RATE_RAD_S, MAX_RATE_RAD_S));
        let start_rad_s = match sample.kind {
            RateKind::Instant if self.started => self.previous_rate_rad_s,
            _ => end_rad_s,
        };
        let mut mean_rad_s = start_rad_s * 0.5 + end_rad_s * 0.5;
        let start = self.attitude;
        let rotation = match self.method {
            Method::Mobius => {
                let rotation = Rotation::from_rotation_vector(mean_rad_s * dt_s);
                self.attitude.rotate(rotation);
                rotation
            }
            Method::MobiusConing => {
                let interval = self.coning.step(&RateSample { rate_rad_s: end_rad_s, dt_s, ..*sample });
                mean_rad_s = interval.mean_rate_rad_s;
                let rotation = Rotation::from_rotation_vector(interval.vector_rad);
                self.attitude = start.rotated(rotation).attitude;
                rotation
            }
            Method::Rk4 => {
                self.attitude =
                    kinematics::rk4(start, |fraction| start_rad_s + (end_rad_s - start_rad_s) * fraction, dt_s);
                Rotation::between(start, self.attitude)
            }
            Method::Euler => {
                self.attitude = kinematics::euler(start, start_rad_s, dt_s);
                Rotation::between(start, self.attitude)
            }
        };
        self.previous_rate_rad_s = end_rad_s;
        self.started = true;
        Motion { attitude: self.attitude, rotation, rate_rad_s: mean_rad_s, dt_s }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.attitude.visit(visit);
        self.previous_rate_rad_s.visit(visit);
        self.started.visit(visit);
        if self.method == Method::MobiusConing {
            self.coning.visit(visit);
        }
    }

    fn validation_error(&self) -> Option<&'static str> {
        let too_fast = self.previous_rate_rad_s.amax() > MAX_RATE_RAD_S;
        attitude_validation_error(self.attitude)
            .or(too_fast.then_some("a rate above 1000 rad/s"))
            .or_else(|| self.coning.validation_error())
    }

    fn common(&self) -> Attitude {
        self.attitude
    }

    fn adopt(&mut self, attitude: &Attitude) -> Result<(), RestoreError> {
        attitude.validate()?;
        self.attitude = *attitude;
        Ok(())
    }
}
