//! The stage `@name@` for the slot gyro: how the body turned over each interval, from its rate.
//!
//! Input: the body's rate. Output: the turn of the interval, and the attitude that all turns make. Time: the interval. Failure: a rate that
//! is not a number is that of the sample before.

use attitude::{
    Vector3,
    gyro::{GyroStage, Motion, RateKind, RateSample},
    scalars::Scalars,
    stage::{RestoreError, Stage, attitude_validation_error},
    state::Attitude,
    rotation::Rotation,
};

/// Faster than any gyro's range; what is beyond it is taken for this.
const MAX_RATE_RAD_S: f64 = 1000.0;

/// Turns by the mean rate of the interval: exact while the rate is constant.
#[derive(Debug, Clone, Default)]
pub struct @Class@ {
    attitude: Attitude,
    before_rad_s: Option<Vector3<f64>>,
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
        let known = sample.rate_rad_s.iter().all(|x| x.is_finite());
        let rate_rad_s = if known { sample.rate_rad_s } else { self.before_rad_s.unwrap_or_default() };
        let after_rad_s = rate_rad_s.map(|x| x.clamp(-MAX_RATE_RAD_S, MAX_RATE_RAD_S));
        // The mean of an interval of which both ends are known is half their sum.
        let before_rad_s = self.before_rad_s.replace(after_rad_s).filter(|_| sample.kind == RateKind::Instant);
        let mean_rad_s = (before_rad_s.unwrap_or(after_rad_s) + after_rad_s) * 0.5;
        let rotation = Rotation::from_rotation_vector(mean_rad_s * dt_s);
        self.attitude = self.attitude.rotated(rotation).attitude;
        Motion { attitude: self.attitude, rotation, rate_rad_s: mean_rad_s, dt_s }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let Self { attitude, before_rad_s } = self;
        attitude.visit(visit);
        before_rad_s.visit(visit);
    }

    fn validation_error(&self) -> Option<&'static str> {
        let beyond = self.before_rad_s.is_some_and(|rate| rate.amax() > MAX_RATE_RAD_S);
        attitude_validation_error(self.attitude).or(beyond.then_some("a rate that no gyro gives"))
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
