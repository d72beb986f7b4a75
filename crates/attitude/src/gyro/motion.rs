//! Rate samples and the motion that a gyro stage computes from them.

use crate::{
    Vector3,
    rotation::Rotation,
    scalars::{Scalars, scalars},
    stage::{UNIT_NORM_SQUARED_TOLERANCE, Validate, attitude_validation_error},
    state::Attitude,
};

/// Meaning of a rate sample: the mean over its interval or the value at the end of it.
///
/// The distinction matters. If an instantaneous value is treated as a mean, the attitude lags by
/// half an interval, which is 1.1° at 4 rad/s and 100 Hz. The lag also biases the estimate of the
/// gyro bias. If a mean is averaged with the previous mean, the attitude lags by the same amount. A
/// MEMS gyro that is read at its filter rate reports means. A simulation, or a gyro that is read at
/// a much lower rate, reports instantaneous values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum RateKind {
    #[default]
    /// Mean over the interval, as from an integrating or low-pass filtered sensor.
    Mean,
    /// Value at the end of the interval. The mean over the interval is computed from the values at
    /// both ends.
    Instant,
}

/// Gyro sample of one interval.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RateSample {
    /// Body rate, rad/s.
    pub rate_rad_s: Vector3<f64>,
    /// Length of the interval, s; 0 for the first sample.
    pub dt_s: f64,
    /// Meaning of the rate: the mean over the interval or the value at the end of it.
    pub kind: RateKind,
}

/// Motion over one interval.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Motion {
    /// Open-loop attitude at the end of the interval.
    pub attitude: Attitude,
    /// Rotation of the body over the interval.
    pub rotation: Rotation,
    /// Mean rate over the interval, rad/s.
    pub rate_rad_s: Vector3<f64>,
    /// Length of the interval, s.
    pub dt_s: f64,
}

impl Validate for Motion {
    #[inline]
    fn validation_error(&self) -> Option<&'static str> {
        let Self { attitude, rotation, rate_rad_s, dt_s } = self;
        let unit = libm::fabs(rotation.p.norm_sqr() + rotation.s.norm_sqr() - 1.0) <= UNIT_NORM_SQUARED_TOLERANCE;
        let finite = (rate_rad_s.sum() + dt_s).is_finite();
        attitude_validation_error(*attitude)
            .or((!unit).then_some("a rotation that is not of unit length"))
            .or((!finite).then_some("a number that is not finite"))
    }
}

impl Scalars for RateSample {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let Self { rate_rad_s, dt_s, kind } = self;
        rate_rad_s.visit(visit);
        dt_s.visit(visit);
        let mut instant = *kind == RateKind::Instant;
        instant.visit(visit);
        *kind = if instant { RateKind::Instant } else { RateKind::Mean };
    }
}

scalars!(Motion: attitude, rotation, rate_rad_s, dt_s);
