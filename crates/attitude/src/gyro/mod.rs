//! Gyro stages: from the rate to an open-loop attitude and the exact rotation of each step.
//!
//! Input: the body rate and the length of the interval. Output: the integrated attitude, and the turn (p, s) that a fuser applies
//! to its own state. Time: the interval; one that is not finite or below zero is none. Failure: a rate that is not finite is that of
//! the sample before; the attitude drifts with the gyro's bias, without bound.

mod coning;
mod motion;

pub use motion::{Motion, RateKind, RateSample};

use crate::{
    Vector3, kinematics,
    numbers::Numbers,
    stage::{RestoreError, Stage, attitude_flaw},
    state::Attitude,
    turn::Turn,
};
use coning::Coning;

/// Faster than any gyro's range, rad/s; what is beyond it is taken for this.
const RATE_MAX_RAD_S: f64 = 1000.0;

/// How a gyro stage integrates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Method {
    Mobius,
    MobiusConing,
    Rk4,
    Euler,
}

/// A gyro stage: `mobius`, `mobius-coning`, `rk4` or `euler`.
///
/// `mobius` is exact for a constant rate. `mobius-coning` takes the turning of the rate's axis from the samples before into account,
/// for bodies that vibrate. `rk4` is what the simulation S1 of Matveev 2025 uses: in a rotation of 4 rad/s sampled at 286 Hz it drifts
/// by some 2e-6° a minute. `euler` drifts by tens of degrees a minute at 4 rad/s; it is here because the article counts its operations
/// on it.
#[derive(Debug, Clone, PartialEq)]
pub struct Gyro {
    method: Method,
    attitude: Attitude,
    rate_before_rad_s: Vector3<f64>,
    started: bool,
    coning: Coning,
}

impl Gyro {
    /// The stages of this slot; the first is the default.
    pub const NAMES: [&'static str; 4] = ["mobius", "mobius-coning", "rk4", "euler"];

    /// The stage of that name.
    pub fn named(name: &str) -> Option<Self> {
        let method = match name {
            "mobius" => Method::Mobius,
            "mobius-coning" => Method::MobiusConing,
            "rk4" => Method::Rk4,
            "euler" => Method::Euler,
            _ => return None,
        };
        Some(Self {
            method,
            attitude: Attitude::default(),
            rate_before_rad_s: Vector3::zeros(),
            started: false,
            coning: Coning::default(),
        })
    }

    /// The open-loop attitude.
    pub fn attitude(&self) -> Attitude {
        self.attitude
    }
}

/// A stage that the slot `gyro` takes.
pub trait GyroStage: Stage<Input = RateSample, Output = Motion, Common = Attitude> + Clone {
    /// Sets the attitude to integrate from.
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
    /// The open-loop attitude.
    type Common = Attitude;

    fn name(&self) -> &'static str {
        match self.method {
            Method::Mobius => "mobius",
            Method::MobiusConing => "mobius-coning",
            Method::Rk4 => "rk4",
            Method::Euler => "euler",
        }
    }

    #[inline]
    fn step(&mut self, sample: &RateSample) -> Motion {
        let in_time = sample.dt_s >= 0.0 && sample.dt_s.is_finite();
        let dt_s = if in_time { sample.dt_s } else { 0.0 };
        let number = sample.rate_rad_s.iter().all(|component| component.is_finite());
        let rate_rad_s = if number { sample.rate_rad_s } else { self.rate_before_rad_s };
        let after = rate_rad_s.map(|component| component.clamp(-RATE_MAX_RAD_S, RATE_MAX_RAD_S));
        let before = match sample.kind {
            RateKind::Instant if self.started => self.rate_before_rad_s,
            _ => after,
        };
        let mut mean = before * 0.5 + after * 0.5;
        let from = self.attitude;
        let turn = match self.method {
            Method::Mobius => {
                let turn = Turn::of_rotation_vector(mean * dt_s);
                self.attitude.turn(turn);
                turn
            }
            Method::MobiusConing => {
                let rotation = self.coning.step(&RateSample { rate_rad_s: after, dt_s, ..*sample });
                mean = rotation.mean_rate_rad_s;
                let turn = Turn::of_rotation_vector(rotation.vector_rad);
                self.attitude = from.turned(turn).attitude;
                turn
            }
            Method::Rk4 => {
                self.attitude = kinematics::rk4(from, |fraction| before + (after - before) * fraction, dt_s);
                Turn::between(from, self.attitude)
            }
            Method::Euler => {
                self.attitude = kinematics::euler(from, before, dt_s);
                Turn::between(from, self.attitude)
            }
        };
        self.rate_before_rad_s = after;
        self.started = true;
        Motion { attitude: self.attitude, turn, rate_rad_s: mean, dt_s }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.attitude.visit(visit);
        self.rate_before_rad_s.visit(visit);
        self.started.visit(visit);
        if self.method == Method::MobiusConing {
            self.coning.visit(visit);
        }
    }

    fn flaw(&self) -> Option<&'static str> {
        let beyond = self.rate_before_rad_s.amax() > RATE_MAX_RAD_S;
        attitude_flaw(self.attitude).or(beyond.then_some("a rate above 1000 rad/s")).or_else(|| self.coning.flaw())
    }

    fn common(&self) -> Attitude {
        self.attitude
    }

    fn adopt(&mut self, attitude: &Attitude) -> Result<(), RestoreError> {
        attitude.checked()?;
        self.attitude = *attitude;
        Ok(())
    }
}
