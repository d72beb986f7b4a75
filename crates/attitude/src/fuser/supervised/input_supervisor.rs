//! Supervision of the inputs of a stage: missing ticks, unusable values and outages.

use super::sensor_tick::{ForceFaults, RateFaults, SensorTick};
use crate::{
    accel::Inclination,
    fuser::FuserInput,
    gyro::{MAX_BRIDGED_GAP_S, Motion},
    rotation::Rotation,
    state::Attitude,
};

/// Longest rate outage after which the attitude is still trusted, s.
const RATE_OUTAGE_LIMIT_S: f64 = 0.2;
/// Rate above which the body certainly rotates, rad/s (2 °/s). No gyro bias is that large.
const MIN_ROTATION_RATE_RAD_S: f64 = 0.035;

/// Input of a stage, with the decisions of the supervision.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SupervisedInput {
    /// Input of the stage.
    pub input: FuserInput,
    /// Decision about the level before the step.
    pub realignment: Realignment,
    /// Set if the stage of the gyro or the accelerometer was reset for this tick.
    pub is_sensor_stage_reset: bool,
}

impl SupervisedInput {
    /// Returns `true` if the models of a stage can process the input independently of each other.
    ///
    /// Otherwise the realignment depends on the fused attitude of the previous tick.
    #[inline]
    pub fn is_independent(&self) -> bool {
        self.realignment != Realignment::IfTilted
    }
}

/// Decision about the re-initialisation of the level.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Realignment {
    /// The level is kept.
    #[default]
    No,
    /// The level is re-initialised.
    Yes,
    /// The level is re-initialised if the newest fused attitude has a large tilt error.
    IfTilted,
}

/// Supervision of the inputs of a stage.
#[derive(Debug)]
pub struct InputSupervisor<'a> {
    pub(super) previous_motion: &'a mut Option<(Attitude, i64)>,
    pub(super) rate_outage_s: &'a mut f64,
    pub(super) force_m_s2: &'a mut [f64; 3],
    pub(super) has_rotated: &'a mut bool,
}

impl InputSupervisor<'_> {
    /// Returns the input of the stage at a tick.
    #[inline(always)]
    pub fn check(&mut self, tick: &SensorTick) -> SupervisedInput {
        let motion = self.bridge(tick);
        let inclination = self.usable_inclination(tick, motion.as_ref());
        let RateFaults { is_invalid, is_clipped, is_stuck } = tick.rate_faults;
        let rate_credible = !(is_invalid || is_clipped || is_stuck) && motion.is_some();
        let interval_s = (tick.t_end_ns - tick.t_start_ns) as f64 * 1e-9;
        let is_over_gap = tick.is_after_gap && motion.is_some_and(|motion| motion.dt_s == 0.0);
        let realignment = if is_over_gap {
            Realignment::Yes
        } else {
            self.realignment_after_outage(rate_credible, interval_s, inclination.is_some())
        };
        let ForceFaults { is_invalid: is_force_invalid, is_stuck: is_force_stuck, .. } = tick.force_faults;
        let rest_credible = !(is_invalid || is_stuck || is_force_invalid || is_force_stuck);
        let SensorTick { field_ut, fix, is_sensor_stage_reset, .. } = *tick;
        let input = FuserInput { motion, inclination, field_ut, fix, rest_credible, rate_credible };
        SupervisedInput { input, realignment, is_sensor_stage_reset }
    }

    /// Returns the motion since the newest tick for which a motion is known.
    ///
    /// If ticks are missing in between, the rotation is computed from the gyro's open-loop
    /// attitudes. Over a gap longer than [`MAX_BRIDGED_GAP_S`], the rotation is the identity and
    /// `dt_s` is 0.
    #[inline(always)]
    fn bridge(&mut self, tick: &SensorTick) -> Option<Motion> {
        let mut motion = tick.motion?;
        if let Some((attitude, t_end_ns)) = self.previous_motion
            && *t_end_ns != tick.t_start_ns
        {
            motion.rotation = Rotation::between(*attitude, motion.attitude);
            motion.dt_s = (tick.t_end_ns - *t_end_ns) as f64 * 1e-9;
        }
        *self.previous_motion = Some((motion.attitude, tick.t_end_ns));
        if motion.dt_s > MAX_BRIDGED_GAP_S {
            motion.dt_s = 0.0;
            motion.rotation = Rotation::IDENTITY;
        }
        Some(motion)
    }

    /// Returns the inclination, or `None` if the force is missing or unusable.
    #[inline(always)]
    fn usable_inclination(&mut self, tick: &SensorTick, motion: Option<&Motion>) -> Option<Inclination> {
        let force_m_s2 = <[f64; 3]>::from(tick.force_m_s2?);
        // At rest the force may repeat. If it repeats during a rotation, the accelerometer is dead.
        let is_rotating = motion.is_some_and(|motion| motion.rate_rad_s.norm() > MIN_ROTATION_RATE_RAD_S);
        *self.has_rotated = is_rotating || (*self.has_rotated && force_m_s2 == *self.force_m_s2);
        *self.force_m_s2 = force_m_s2;
        let ForceFaults { is_invalid, is_small, is_stuck } = tick.force_faults;
        let is_dead = is_stuck && !tick.rate_faults.is_stuck && *self.has_rotated;
        tick.inclination.filter(|_| !(is_dead || is_invalid || is_small))
    }

    /// Decides whether the level is re-initialised at the first usable rate after an outage or a
    /// gap.
    #[inline(always)]
    fn realignment_after_outage(
        &mut self,
        is_rate_usable: bool,
        interval_s: f64,
        has_inclination: bool,
    ) -> Realignment {
        if !is_rate_usable {
            *self.rate_outage_s += interval_s;
            return Realignment::No;
        }
        let outage_s = core::mem::take(self.rate_outage_s).max(interval_s);
        if has_inclination && outage_s > RATE_OUTAGE_LIMIT_S { Realignment::IfTilted } else { Realignment::No }
    }
}
