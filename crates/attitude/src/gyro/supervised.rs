//! Gyro stage with supervised inputs and outputs.
//!
//! Input: checked samples.
//!
//! Output: the motion of each tick.
//!
//! Time: the interval of each tick, ns. Only differences are used.
//!
//! Failure: missing ticks are bridged with the mean of the adjacent rates, up to
//! [`MAX_BRIDGED_GAP_S`]. Over a longer gap the attitude is held. A stage whose output is invalid
//! is reset. If the output after the reset is also invalid, the stage has failed.

use super::{GyroStage, MAX_BRIDGED_GAP_S, Motion, RateKind, RateSample};
use crate::{
    Vector3, accel::MIN_FORCE_M_S2, flags::Flags, point::Point, state::Attitude, state_words::StateWords,
    validated_stage::ValidatedStage,
};

/// Rate and force of a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GyroTick {
    /// Start of the interval, ns.
    pub t_start_ns: i64,
    /// End of the interval, ns.
    pub t_end_ns: i64,
    /// Faults of the sample.
    pub flags: Flags,
    /// Body rate in body axes, rad/s.
    pub rate_rad_s: [f64; 3],
    /// Specific force in body axes, m/s².
    pub force_m_s2: [f64; 3],
}

/// Gyro stage with the supervision of its inputs and outputs.
#[derive(Debug, Clone)]
pub struct SupervisedGyro<S> {
    /// Gyro stage, which is reset after an invalid output.
    pub validated: ValidatedStage<S>,
    state: SupervisedGyroState,
}

/// State of a [`SupervisedGyro`], excluding its stage.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SupervisedGyroState {
    /// Set once the open-loop attitude has been aligned with a force.
    pub is_aligned: bool,
    /// End of the newest tick, ns.
    pub t_end_ns: Option<i64>,
}

impl<S: GyroStage> SupervisedGyro<S> {
    /// Supervises a stage that has not been stepped yet.
    pub fn new(stage: S) -> Self {
        Self { validated: ValidatedStage::new(stage), state: SupervisedGyroState::default() }
    }

    /// Returns a mutable reference to the state, for restoring it.
    pub fn state_mut(&mut self) -> &mut SupervisedGyroState {
        &mut self.state
    }

    /// Processes a tick. Returns the motion, and `true` if the stage was reset in this step.
    ///
    /// Returns `None` once the stage has failed permanently.
    #[inline(always)]
    pub fn step(&mut self, tick: &GyroTick) -> Option<(Motion, bool)> {
        let previous_ns = self.state.t_end_ns.replace(tick.t_end_ns).unwrap_or(tick.t_start_ns);
        let dt_s = (tick.t_end_ns - previous_ns) as f64 * 1e-9;
        let kind = if tick.flags.any(Flags::RATE_INSTANT) { RateKind::Instant } else { RateKind::Mean };
        let dt_s = if dt_s <= MAX_BRIDGED_GAP_S { dt_s } else { 0.0 };
        let sample = RateSample { rate_rad_s: tick.rate_rad_s.into(), dt_s, kind };
        let (mut motion, was_reset) = self.validated.step(&sample)?;
        if !self.state.is_aligned {
            motion.attitude = self.align_level(tick).unwrap_or(motion.attitude);
        }
        Some((motion, was_reset))
    }

    /// Aligns the open-loop attitude with the first force that has a direction.
    #[cold]
    fn align_level(&mut self, tick: &GyroTick) -> Option<Attitude> {
        let force_m_s2 = Vector3::from(tick.force_m_s2);
        let usable = !tick.flags.any(Flags::FORCE_INVALID | Flags::FORCE_SMALL);
        let up = Point::from_direction(force_m_s2).filter(|_| usable && force_m_s2.norm() >= MIN_FORCE_M_S2)?;
        let level = Attitude::from_up(up);
        self.validated.stage.align(level);
        self.state.is_aligned = true;
        Some(level)
    }
}

impl StateWords for SupervisedGyroState {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.is_aligned.visit(visit);
        self.t_end_ns.visit(visit);
    }
}
