//! Stage `@name@` for the slot gyro: the rotation of the body over each interval, from its rate.
//!
//! Input: the body rate.
//!
//! Output: the rotation over the interval, and the open-loop attitude.
//!
//! Time: the length of the interval.
//!
//! Failure: a non-finite rate is replaced by the previous one.

use attitude::{
    Vector3,
    gyro::{GyroStage, Motion, RateKind, RateSample},
    rotation::Rotation,
    scalars::Scalars,
    stage::{RestoreError, Stage, attitude_validation_error},
    state::Attitude,
};

/// Limit to which rates are clamped, rad/s. It is above the range of any gyro.
const MAX_RATE_RAD_S: f64 = 1000.0;

/// Stage that rotates the attitude by the mean rate over each interval.
///
/// The result is exact if the rate is constant.
#[derive(Debug, Clone, Default)]
pub struct @Class@ {
    attitude: Attitude,
    previous_rad_s: Option<Vector3<f64>>,
}

impl GyroStage for @Class@ {
    fn align(&mut self, attitude: Attitude) {
        self.attitude = attitude;
    }
}

impl Stage for @Class@ {
    type Input = RateSample;
    type Output = Motion;
    type Common = Attitude;

    fn name(&self) -> &'static str {
        "@name@"
    }

    fn step(&mut self, sample: &RateSample) -> Motion {
        let dt_s = if sample.dt_s.is_finite() { sample.dt_s.max(0.0) } else { 0.0 };
        let is_finite = sample.rate_rad_s.iter().all(|x| x.is_finite());
        let rate_rad_s = if is_finite { sample.rate_rad_s } else { self.previous_rad_s.unwrap_or_default() };
        let end_rad_s = rate_rad_s.map(|x| x.clamp(-MAX_RATE_RAD_S, MAX_RATE_RAD_S));
        // If the rates at both ends of the interval are known, the mean is half the sum of the two.
        let start_rad_s = self.previous_rad_s.replace(end_rad_s).filter(|_| sample.kind == RateKind::Instant);
        let mean_rad_s = (start_rad_s.unwrap_or(end_rad_s) + end_rad_s) * 0.5;
        let rotation = Rotation::from_rotation_vector(mean_rad_s * dt_s);
        self.attitude = self.attitude.rotated(rotation).attitude;
        Motion { attitude: self.attitude, rotation, rate_rad_s: mean_rad_s, dt_s }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let Self { attitude, previous_rad_s } = self;
        attitude.visit(visit);
        previous_rad_s.visit(visit);
    }

    fn validation_error(&self) -> Option<&'static str> {
        let too_fast = self.previous_rad_s.is_some_and(|rate| rate.amax() > MAX_RATE_RAD_S);
        attitude_validation_error(self.attitude).or(too_fast.then_some("a rate above 1000 rad/s"))
    }

    fn common(&self) -> Attitude {
        self.attitude
    }

    fn adopt(&mut self, common: &Attitude) -> Result<(), RestoreError> {
        common.validate()?;
        self.attitude = *common;
        Ok(())
    }
}
