//! A sample of the rate, and the motion that a gyro stage makes of it.

use crate::{
    Vector3,
    numbers::Numbers,
    stage::{Sound, UNIT, attitude_flaw},
    state::Attitude,
    turn::Turn,
};

/// What a rate sample says about its interval.
///
/// It matters: an instant taken for a mean is half an interval late (at 4 rad/s and 100 Hz by 1.1°, with a wrong bias after it); a
/// mean that is averaged with the one before is late by as much. A MEMS gyro that is read as often as it filters gives means, a
/// simulation or a gyro read far more seldom gives instants.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum RateKind {
    #[default]
    /// The mean over the interval, as an integrating or low-passed sensor gives it.
    Mean,
    /// The value at the interval's end; the mean is taken as that of both ends.
    Instant,
}

/// One interval of the gyro.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RateSample {
    /// Body rate, rad/s.
    pub rate_rad_s: Vector3<f64>,
    /// Length of the interval, s; 0 for the first sample.
    pub dt_s: f64,
    /// What the rate means.
    pub kind: RateKind,
}

/// The motion over one interval.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Motion {
    /// Open-loop attitude at the interval's end.
    pub attitude: Attitude,
    /// The turn of the body over the interval.
    pub turn: Turn,
    /// Mean rate over the interval, rad/s.
    pub rate_rad_s: Vector3<f64>,
    /// Length of the interval, s.
    pub dt_s: f64,
}

impl Sound for Motion {
    fn flaw(&self) -> Option<&'static str> {
        let Self { attitude, turn, rate_rad_s, dt_s } = self;
        let unit = libm::fabs(turn.p.norm_sqr() + turn.s.norm_sqr() - 1.0) <= UNIT;
        let finite = (rate_rad_s.sum() + dt_s).is_finite();
        attitude_flaw(*attitude)
            .or((!unit).then_some("a turn that is not of unit length"))
            .or((!finite).then_some("a number that is not finite"))
    }
}

impl Numbers for RateSample {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let Self { rate_rad_s, dt_s, kind } = self;
        rate_rad_s.visit(visit);
        dt_s.visit(visit);
        let mut instant = *kind == RateKind::Instant;
        instant.visit(visit);
        *kind = if instant { RateKind::Instant } else { RateKind::Mean };
    }
}

impl Numbers for Motion {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let Self { attitude, turn, rate_rad_s, dt_s } = self;
        attitude.visit(visit);
        turn.visit(visit);
        rate_rad_s.visit(visit);
        dt_s.visit(visit);
    }
}
