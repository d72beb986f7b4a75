//! Fuser with supervised inputs and outputs.
//!
//! Input: the sensor values of a tick with their faults. Every value may be missing.
//!
//! Output: the fused attitude, with flags and a counter of the jumps of the attitude.
//!
//! Time: the interval of each tick, ns. Only differences are used.
//!
//! Failure:
//! - The rotation over missing ticks is computed from the gyro's open-loop attitudes. A gap longer
//!   than [`MAX_BRIDGED_GAP_S`] re-initialises the level.
//! - After a rate outage the level is re-initialised if its error has become too large.
//! - The specific force of a dead accelerometer is not used.
//! - A stage whose output is invalid is reset. If the output after the reset is also invalid, the
//!   stage has failed.

use super::{
    Fused, FuserInput, FuserStage, innovation_rad,
    multiple_model::{AidedModel, AidedOutput, WzModel},
};
use crate::{
    Vector3,
    accel::Inclination,
    flags::Flags,
    gnss::Fix,
    gyro::{MAX_BRIDGED_GAP_S, Motion},
    resetting::{ResettingStage, StageFailure},
    rotation::Rotation,
    stage::Validate as _,
    state::Attitude,
    state_words::StateWords,
};

/// Longest rate outage after which the attitude is still trusted, s.
const RATE_OUTAGE_LIMIT_S: f64 = 0.2;
/// Minimum tilt error that causes a realignment after an outage, rad (5°). Noise and vehicle
/// manoeuvres stay below it.
const REALIGN_TILT_RAD: f64 = 0.087;
/// Rate above which the body certainly rotates, rad/s (2 °/s). No gyro bias is that large.
const MIN_ROTATION_RATE_RAD_S: f64 = 0.035;

/// Sensor values of a tick, with their faults.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SensorTick {
    /// Start of the interval, ns.
    pub t_start_ns: i64,
    /// End of the interval, ns.
    pub t_end_ns: i64,
    /// Set if there is a gap in time before this tick, or if ticks before it were lost.
    pub is_after_gap: bool,
    /// Set if the stage of the gyro or the accelerometer was reset for this tick.
    pub is_sensor_stage_reset: bool,
    /// Motion over the interval, from a gyro stage; `None` if the rate is missing.
    pub motion: Option<Motion>,
    /// Faults of the rate.
    pub rate_faults: RateFaults,
    /// Specific force in body axes as measured, m/s²; `None` if it is missing.
    pub force_m_s2: Option<Vector3<f64>>,
    /// Inclination from an accelerometer stage; `None` if the force has no direction.
    pub inclination: Option<Inclination>,
    /// Faults detected in the specific force.
    pub force_faults: ForceFaults,
    /// Magnetic field in body axes, µT. Present only for a new sample.
    pub field_ut: Option<Vector3<f64>>,
    /// Fix of the satellite receiver. Present only at the tick at which it arrived.
    pub fix: Option<Fix>,
}

impl SensorTick {
    /// Returns the interval and the faults of a tick, without its sensor values.
    #[inline]
    pub fn from_flags(t_start_ns: i64, t_end_ns: i64, flags: Flags) -> Self {
        Self {
            t_start_ns,
            t_end_ns,
            is_after_gap: flags.any(Flags::GAP | Flags::LOST_BEFORE),
            is_sensor_stage_reset: flags.any(Flags::RESET),
            rate_faults: RateFaults {
                is_invalid: flags.any(Flags::RATE_INVALID),
                is_clipped: flags.any(Flags::RATE_CLIPPED),
                is_stuck: flags.any(Flags::RATE_STUCK),
            },
            force_faults: ForceFaults {
                is_invalid: flags.any(Flags::FORCE_INVALID),
                is_small: flags.any(Flags::FORCE_SMALL),
                is_stuck: flags.any(Flags::FORCE_STUCK),
            },
            ..Self::default()
        }
    }
}

/// Faults of a rate sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RateFaults {
    /// The rate is not finite.
    pub is_invalid: bool,
    /// The rate is outside the range of the gyro.
    pub is_clipped: bool,
    /// The gyro repeats a value.
    pub is_stuck: bool,
}

/// Faults of a specific force.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ForceFaults {
    /// The specific force is not finite.
    pub is_invalid: bool,
    /// The force is too small to have a direction.
    pub is_small: bool,
    /// The accelerometer repeats a value.
    pub is_stuck: bool,
}

/// Output of a [`SupervisedFuser`] at a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SupervisedFused {
    /// Output of the stage. Its `corrections` also flag a realignment, rest and a disturbed
    /// magnetic field.
    pub fused: Fused,
    /// Set once the attitude has been aligned. Before that, the attitude is arbitrary.
    pub is_aligned: bool,
    /// Set if the stage was reset for this output, because its first output was invalid.
    pub is_reset: bool,
    /// Number of jumps of the attitude after the first alignment.
    pub reset_counter: u64,
}

impl SupervisedFused {
    /// Returns the flags of the output.
    #[inline]
    pub fn flags(&self) -> Flags {
        let Self { fused, is_aligned, is_reset, .. } = self;
        Flags::RESET.when(*is_reset)
            | Flags::ALIGNED.when(fused.corrections.aligned)
            | Flags::UNALIGNED.when(!is_aligned)
            | Flags::AT_REST.when(fused.corrections.rest)
            | Flags::FIELD_DISTURBED.when(fused.corrections.disturbed)
    }
}

/// Fuser stage with the supervision of its inputs and outputs.
#[derive(Debug, Clone)]
pub struct SupervisedFuser<S> {
    resetting: ResettingStage<S>,
    state: SupervisedState,
}

/// State of a [`SupervisedFuser`], excluding its stage.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SupervisedState {
    /// Open-loop attitude of the gyro at the end of the newest motion, and the time at which this
    /// motion ended, ns.
    pub previous_motion: Option<(Attitude, i64)>,
    /// Set once the attitude has been aligned.
    pub is_aligned: bool,
    /// Number of jumps of the attitude after the first alignment.
    pub reset_counter: u64,
    /// Duration of the current rate outage, s.
    pub rate_outage_s: f64,
    /// Newest fused attitude.
    pub attitude: Attitude,
    /// Newest specific force in body axes as measured, m/s².
    pub force_m_s2: [f64; 3],
    /// Set if the body has rotated since the force last changed.
    pub has_rotated: bool,
}

impl SupervisedState {
    /// Returns the reason why the state is invalid, or `None` if it is valid.
    pub fn validation_error(&self) -> Option<&'static str> {
        let previous = self.previous_motion.map_or(Attitude::default(), |(attitude, _)| attitude);
        let are_finite =
            [self.attitude, previous].iter().all(|attitude| attitude.quaternion().coords.norm().is_finite());
        (!are_finite || !self.rate_outage_s.is_finite()).then_some("a number that is not finite")
    }
}

impl StateWords for SupervisedState {
    #[inline]
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        let Self { previous_motion, is_aligned, reset_counter, rate_outage_s, attitude, force_m_s2, has_rotated } =
            self;
        previous_motion.visit(visit);
        is_aligned.visit(visit);
        reset_counter.visit(visit);
        rate_outage_s.visit(visit);
        attitude.visit(visit);
        force_m_s2.visit(visit);
        has_rotated.visit(visit);
    }
}

impl<S: FuserStage> SupervisedFuser<S> {
    /// Supervises a stage that has not been stepped yet.
    pub fn new(stage: S) -> Self {
        Self { resetting: ResettingStage::new(stage), state: SupervisedState::default() }
    }

    /// Returns the supervised stage.
    pub fn stage(&self) -> &S {
        &self.resetting.stage
    }

    /// Returns a mutable reference to the stage, for restoring its state.
    pub fn stage_mut(&mut self) -> &mut S {
        &mut self.resetting.stage
    }

    /// Returns the state, excluding that of the stage.
    pub fn state(&self) -> &SupervisedState {
        &self.state
    }

    /// Returns a mutable reference to the state, for restoring it.
    pub fn state_mut(&mut self) -> &mut SupervisedState {
        &mut self.state
    }

    /// Returns the cause if the stage has failed permanently, else `None`.
    pub fn failure(&self) -> Option<StageFailure<'_>> {
        self.resetting.failure()
    }

    /// Processes a tick. Returns `None` once the stage has failed permanently.
    #[inline(always)]
    pub fn step(&mut self, tick: &SensorTick) -> Option<SupervisedFused> {
        let (mut inputs, mut stage) = self.parts();
        stage.step(&inputs.check(tick))
    }

    /// Returns the supervision of the inputs and the stage with the supervision of its outputs.
    ///
    /// The first part does not depend on the second, so it can be several ticks ahead.
    #[inline(always)]
    pub fn parts(&mut self) -> (InputSupervisor<'_>, StageSupervisor<'_, S>) {
        let Self { resetting, state } = self;
        let SupervisedState {
            previous_motion,
            is_aligned,
            reset_counter,
            rate_outage_s,
            attitude,
            force_m_s2,
            has_rotated,
        } = state;
        let outputs = OutputSupervisor { is_aligned, reset_counter, attitude };
        (
            InputSupervisor { previous_motion, rate_outage_s, force_m_s2, has_rotated },
            StageSupervisor { resetting, outputs },
        )
    }
}

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
    previous_motion: &'a mut Option<(Attitude, i64)>,
    rate_outage_s: &'a mut f64,
    force_m_s2: &'a mut [f64; 3],
    has_rotated: &'a mut bool,
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

/// Supervision of the outputs of a stage.
#[derive(Debug)]
struct OutputSupervisor<'a> {
    is_aligned: &'a mut bool,
    reset_counter: &'a mut u64,
    attitude: &'a mut Attitude,
}

impl OutputSupervisor<'_> {
    #[inline(always)]
    fn supervise(&mut self, fused: Fused, is_reset: bool, is_sensor_stage_reset: bool) -> SupervisedFused {
        *self.attitude = fused.attitude;
        let has_jumped = fused.corrections.aligned || is_reset || is_sensor_stage_reset;
        *self.reset_counter += u64::from(*self.is_aligned && has_jumped);
        *self.is_aligned |= fused.corrections.aligned;
        SupervisedFused { fused, is_aligned: *self.is_aligned, is_reset, reset_counter: *self.reset_counter }
    }
}

/// Stage with the supervision of its outputs.
#[derive(Debug)]
pub struct StageSupervisor<'a, S> {
    resetting: &'a mut ResettingStage<S>,
    outputs: OutputSupervisor<'a>,
}

impl<S: FuserStage> StageSupervisor<'_, S> {
    /// Returns the models of the stage `multiple-model`, which can run in different threads.
    ///
    /// Returns `None` for any other stage, and once the stage has failed permanently.
    pub fn models(&mut self) -> Option<(AidedPart<'_>, WzPart<'_>)> {
        if self.resetting.has_failed() {
            return None;
        }
        let OutputSupervisor { is_aligned, reset_counter, attitude } = &mut self.outputs;
        let outputs = OutputSupervisor { is_aligned, reset_counter, attitude };
        let (aided, model) = self.resetting.stage.models()?;
        Some((AidedPart(aided), WzPart { model, outputs }))
    }

    /// Resets the stage after an invalid output and steps it again. Returns `None` if the stage has
    /// failed permanently.
    #[cold]
    pub fn reset_and_step(&mut self, input: &SupervisedInput) -> Option<SupervisedFused> {
        let fused = self.resetting.reset_and_step(&input.input)?;
        Some(self.outputs.supervise(fused, true, input.is_sensor_stage_reset))
    }

    /// Steps the stage. Returns `None` once the stage has failed permanently.
    #[inline(always)]
    pub fn step(&mut self, input: &SupervisedInput) -> Option<SupervisedFused> {
        if self.needs_realignment(input) {
            self.resetting.stage.realign();
        }
        let (fused, is_reset) = self.resetting.step(&input.input)?;
        Some(self.outputs.supervise(fused, is_reset, input.is_sensor_stage_reset))
    }

    #[inline(always)]
    fn needs_realignment(&self, input: &SupervisedInput) -> bool {
        match input.realignment {
            Realignment::No => false,
            Realignment::Yes => true,
            Realignment::IfTilted => input
                .input
                .inclination
                .is_some_and(|inclination| innovation_rad(&inclination, *self.outputs.attitude) > REALIGN_TILT_RAD),
        }
    }
}

/// Model `aided` of a supervised stage `multiple-model`.
#[derive(Debug)]
pub struct AidedPart<'a>(&'a mut AidedModel);

impl AidedPart<'_> {
    /// Processes a tick. Returns `None` if [`WzPart`] does not need the output.
    ///
    /// The input must be [sanitized](FuserInput::sanitize) and
    /// [independent](SupervisedInput::is_independent).
    #[inline]
    pub fn step(&mut self, input: &SupervisedInput) -> Option<AidedOutput> {
        if input.realignment == Realignment::Yes {
            self.0.realign();
        }
        self.0.step(&input.input)
    }

    /// Replaces the state by that of the model in a copy of the stage.
    pub fn copy_from(&mut self, copy: &AidedPart<'_>) {
        self.0.clone_from(copy.0);
    }
}

/// Model `wz` of a supervised stage `multiple-model`, with the supervision of the outputs.
#[derive(Debug)]
pub struct WzPart<'a> {
    model: &'a mut WzModel,
    outputs: OutputSupervisor<'a>,
}

impl WzPart<'_> {
    /// Processes a tick for which `aided` has been computed by [`AidedPart`].
    ///
    /// Returns `None` if the output is invalid. The tick must then be repeated with
    /// [`StageSupervisor::reset_and_step`].
    #[inline]
    pub fn step(&mut self, input: &SupervisedInput, aided: Option<&AidedOutput>) -> Option<SupervisedFused> {
        if input.realignment == Realignment::Yes {
            self.model.realign();
        }
        let fused = self.model.step(&input.input, aided);
        let is_valid = fused.validation_error().is_none();
        is_valid.then(|| self.outputs.supervise(fused, false, input.is_sensor_stage_reset))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        GRAVITY_M_S2,
        fuser::{Corrections, Estimate, Fuser, finite::fuser_items},
        gyro::{Gyro, RateKind, RateSample},
        point::Point,
        stage::Stage,
    };

    const INTERVAL_NS: i64 = 10_000_000;

    /// Body with a gyro, simulated at 100 Hz. The accelerometer measures gravity along `up`.
    struct Body {
        fuser: SupervisedFuser<Fuser>,
        gyro: Gyro,
        t_ns: i64,
        up: Vector3<f64>,
    }

    impl Body {
        /// Creates a level body with an aligned fuser.
        fn aligned() -> Self {
            let mut body = Self {
                fuser: SupervisedFuser::new(Fuser::from_name("wz-closed").unwrap()),
                gyro: Gyro::from_name("mobius").unwrap(),
                t_ns: 0,
                up: Vector3::new(0.0, 0.0, 1.0),
            };
            let first = body.step(Vector3::zeros(), |_| {});
            assert!(first.is_aligned && first.fused.corrections.aligned && first.reset_counter == 0);
            body
        }

        /// Simulates a tick. `edit` changes the sensor values.
        fn step(&mut self, rate_rad_s: Vector3<f64>, edit: impl FnOnce(&mut SensorTick)) -> SupervisedFused {
            let (t_start_ns, t_end_ns) = (self.t_ns, self.t_ns + INTERVAL_NS);
            self.t_ns = t_end_ns;
            let dt_s = INTERVAL_NS as f64 * 1e-9;
            let motion = self.gyro.step(&RateSample { rate_rad_s, dt_s, kind: RateKind::Mean });
            let force_m_s2 = self.up * GRAVITY_M_S2;
            let up = Point::from_direction(force_m_s2).unwrap();
            let mut tick = SensorTick {
                t_start_ns,
                t_end_ns,
                motion: Some(motion),
                force_m_s2: Some(force_m_s2),
                inclination: Some(Inclination { up, force_m_s2, norm_m_s2: GRAVITY_M_S2, trust: 1.0 }),
                ..SensorTick::default()
            };
            edit(&mut tick);
            self.fuser.step(&tick).unwrap()
        }

        /// Tilts the body by `tilt_rad` while the gyro observes nothing.
        fn tilt_unobserved(&mut self, tilt_rad: f64) {
            self.up = Vector3::new(libm::sin(tilt_rad), 0.0, libm::cos(tilt_rad));
        }

        fn tilt_error_rad(&self, output: &SupervisedFused) -> f64 {
            self.up.angle(&output.fused.attitude.up.direction())
        }
    }

    const STILL: Vector3<f64> = Vector3::new(0.0, 0.0, 0.0);

    #[test]
    fn tilt_during_long_rate_outage_realigns_the_level() {
        for (outage_ticks, tilt_rad, realigns) in [(30, 0.5, true), (10, 0.5, false), (30, 0.05, false)] {
            let mut body = Body::aligned();
            body.tilt_unobserved(tilt_rad);
            for _ in 0..outage_ticks {
                let output = body.step(STILL, |tick| {
                    tick.rate_faults.is_stuck = true;
                    tick.inclination = None;
                });
                assert_eq!(output.reset_counter, 0);
            }
            let output = body.step(STILL, |_| {});
            assert_eq!(output.fused.corrections.aligned, realigns, "{outage_ticks} ticks, {tilt_rad} rad");
            assert_eq!(output.reset_counter, u64::from(realigns));
            assert_eq!(body.tilt_error_rad(&output) < 1e-9, realigns);
        }
    }

    #[test]
    fn missing_motion_counts_as_rate_outage() {
        let mut body = Body::aligned();
        body.tilt_unobserved(0.5);
        for _ in 0..30 {
            body.step(STILL, |tick| (tick.motion, tick.inclination) = (None, None));
        }
        let output = body.step(STILL, |_| {});
        assert!(output.fused.corrections.aligned && output.reset_counter == 1);
    }

    #[test]
    fn missing_ticks_are_bridged_by_open_loop_attitude() {
        let rate_rad_s = Vector3::new(0.0, 0.0, 0.5);
        let mut complete = Body::aligned();
        let mut with_gap = Body::aligned();
        let without_force = |tick: &mut SensorTick| (tick.force_m_s2, tick.inclination) = (None, None);
        for _ in 0..20 {
            complete.step(rate_rad_s, without_force);
            with_gap.gyro.step(&RateSample { rate_rad_s, dt_s: 0.01, kind: RateKind::Mean });
            with_gap.t_ns += INTERVAL_NS;
        }
        let expected = complete.step(rate_rad_s, without_force).fused.attitude.quaternion();
        let found = with_gap.step(rate_rad_s, |tick| {
            without_force(tick);
            tick.is_after_gap = true;
        });
        assert!((found.fused.attitude.quaternion() - expected).norm() < 1e-9);
        assert!(!found.fused.corrections.aligned);
    }

    #[test]
    fn gap_beyond_the_bridged_one_realigns_the_level() {
        for (gap_ns, realigns) in [(900_000_000, false), (1_500_000_000, true)] {
            let mut body = Body::aligned();
            body.tilt_unobserved(0.05);
            body.t_ns += gap_ns;
            let output = body.step(STILL, |tick| tick.is_after_gap = true);
            assert_eq!(output.fused.corrections.aligned, realigns, "{gap_ns} ns");
        }
    }

    #[test]
    fn force_that_repeats_during_rotation_is_not_used() {
        let mut body = Body::aligned();
        let stuck = |tick: &mut SensorTick| tick.force_faults.is_stuck = true;
        let at_rest = body.step(STILL, stuck);
        assert!(at_rest.fused.corrections.tilt, "at rest a force may repeat");
        let rotating = body.step(Vector3::new(0.1, 0.0, 0.0), stuck);
        assert!(!rotating.fused.corrections.tilt);
        let after = body.step(STILL, stuck);
        assert!(!after.fused.corrections.tilt, "the force has not changed since the rotation");
        body.tilt_unobserved(0.01);
        assert!(body.step(STILL, |_| {}).fused.corrections.tilt);
    }

    #[test]
    fn unusable_force_leaves_a_new_fuser_unaligned() {
        let faults: [fn(&mut SensorTick); 3] = [
            |tick| tick.force_faults.is_invalid = true,
            |tick| tick.force_faults.is_small = true,
            |tick| tick.force_m_s2 = None,
        ];
        for fault in faults {
            let mut body = Body::aligned();
            body.fuser = SupervisedFuser::new(Fuser::from_name("wz-closed").unwrap());
            assert!(!body.step(STILL, fault).is_aligned);
            assert!(body.step(STILL, |_| {}).is_aligned);
        }
    }

    /// Stage that records its input. Its output is aligned, and invalid for `invalid_steps` steps.
    #[derive(Debug, Clone, Default)]
    struct Probe {
        input: FuserInput,
        invalid_steps: u32,
        is_aligned: bool,
        realignments: u32,
    }

    impl Probe {
        fn fuse(&mut self, input: &FuserInput) -> Fused {
            self.input = *input;
            let is_invalid = self.invalid_steps > 0;
            self.invalid_steps = self.invalid_steps.saturating_sub(1);
            let corrections = Corrections { aligned: self.is_aligned, ..Corrections::default() };
            Fused { innovation_rad: if is_invalid { f64::NAN } else { 0.0 }, corrections, ..Fused::default() }
        }

        fn continue_from(&mut self, _: &Estimate) {}
    }

    impl FuserStage for Probe {
        fn realign(&mut self) {
            self.realignments += 1;
        }
    }

    impl Stage for Probe {
        fuser_items!();

        fn name(&self) -> &'static str {
            "probe"
        }

        fn visit_state(&mut self, _: &mut dyn FnMut(&mut f64)) {}

        fn common(&self) -> Estimate {
            Estimate::UNKNOWN
        }
    }

    /// Returns the tick that follows `previous`, with the body level and at rest.
    fn tick_after(previous: &SensorTick) -> SensorTick {
        let force_m_s2 = Vector3::new(0.0, 0.0, GRAVITY_M_S2);
        let inclination = Inclination { force_m_s2, norm_m_s2: GRAVITY_M_S2, trust: 1.0, ..Inclination::default() };
        SensorTick {
            t_start_ns: previous.t_end_ns,
            t_end_ns: previous.t_end_ns + INTERVAL_NS,
            motion: Some(Motion { dt_s: 0.01, ..Motion::default() }),
            force_m_s2: Some(force_m_s2),
            inclination: Some(inclination),
            ..SensorTick::default()
        }
    }

    #[test]
    fn faults_determine_credibility_of_rate_and_rest() {
        type Case = (fn(&mut SensorTick), (bool, bool));
        let cases: [Case; 8] = [
            (|_| {}, (true, true)),
            (|tick| tick.rate_faults.is_invalid = true, (false, false)),
            (|tick| tick.rate_faults.is_stuck = true, (false, false)),
            (|tick| tick.rate_faults.is_clipped = true, (false, true)),
            (|tick| tick.motion = None, (false, true)),
            (|tick| tick.force_faults.is_invalid = true, (true, false)),
            (|tick| tick.force_faults.is_stuck = true, (true, false)),
            (|tick| tick.force_faults.is_small = true, (true, true)),
        ];
        for (at, (edit, expected)) in cases.into_iter().enumerate() {
            let mut fuser = SupervisedFuser::new(Probe::default());
            let mut tick = tick_after(&SensorTick::default());
            edit(&mut tick);
            fuser.step(&tick).unwrap();
            let FuserInput { rate_credible, rest_credible, .. } = fuser.stage().input;
            assert_eq!((rate_credible, rest_credible), expected, "case {at}");
        }
    }

    #[test]
    fn reset_counter_counts_every_jump_after_the_alignment() {
        let mut fuser = SupervisedFuser::new(Probe::default());
        let mut tick = SensorTick::default();
        let mut step = |fuser: &mut SupervisedFuser<Probe>, is_sensor_stage_reset| {
            tick = SensorTick { is_sensor_stage_reset, ..tick_after(&tick) };
            let SupervisedFused { is_aligned, is_reset, reset_counter, .. } = fuser.step(&tick).unwrap();
            (is_aligned, is_reset, reset_counter)
        };
        assert_eq!(step(&mut fuser, true), (false, false, 0));
        fuser.stage_mut().is_aligned = true;
        assert_eq!(step(&mut fuser, true), (true, false, 0));
        assert_eq!(step(&mut fuser, false), (true, false, 1));
        fuser.stage_mut().is_aligned = false;
        assert_eq!(step(&mut fuser, false), (true, false, 1));
        assert_eq!(step(&mut fuser, true), (true, false, 2));
        fuser.stage_mut().invalid_steps = 1;
        assert_eq!(step(&mut fuser, false), (true, true, 3));
    }

    #[test]
    fn stage_fails_after_two_invalid_outputs() {
        let mut fuser = SupervisedFuser::new(Probe { invalid_steps: 2, ..Probe::default() });
        let tick = tick_after(&SensorTick::default());
        assert!(fuser.step(&tick).is_none() && fuser.failure().is_some());
        assert!(fuser.step(&tick_after(&tick)).is_none());
    }

    #[test]
    fn force_that_changes_after_a_rotation_is_used_again() {
        let mut fuser = SupervisedFuser::new(Probe::default());
        let mut tick = SensorTick::default();
        let mut is_used = |rate_rad_s, force_m_s2, are_stuck: [bool; 2]| {
            let [is_rate_stuck, is_force_stuck] = are_stuck;
            tick = tick_after(&tick);
            tick.motion = tick.motion.map(|motion| Motion { rate_rad_s, ..motion });
            tick.force_m_s2 = Some(force_m_s2);
            (tick.rate_faults.is_stuck, tick.force_faults.is_stuck) = (is_rate_stuck, is_force_stuck);
            fuser.step(&tick).unwrap();
            fuser.stage().input.inclination.is_some()
        };
        let (rotating, level) = (Vector3::new(0.1, 0.0, 0.0), Vector3::new(0.0, 0.0, GRAVITY_M_S2));
        assert!(!is_used(rotating, level, [false, true]));
        assert!(is_used(rotating, level, [true, true]), "a stuck gyro does not show a rotation");
        assert!(!is_used(STILL, level, [false, true]));
        assert!(is_used(STILL, level * 1.01, [false, true]), "the force has changed");
    }

    #[test]
    fn one_long_interval_is_a_rate_outage() {
        for (interval_ns, realigns) in [(190_000_000, 0), (210_000_000, 1)] {
            let mut fuser = SupervisedFuser::new(Probe::default());
            let mut tick = tick_after(&SensorTick::default());
            tick.t_end_ns = tick.t_start_ns + interval_ns;
            let up = Point::from_direction(Vector3::new(1.0, 0.0, 1.0)).unwrap();
            tick.inclination = tick.inclination.map(|inclination| Inclination { up, ..inclination });
            fuser.step(&tick).unwrap();
            assert_eq!(fuser.stage().realignments, realigns, "{interval_ns} ns");
        }
    }

    #[test]
    fn state_with_a_number_that_is_not_finite_is_invalid() {
        assert_eq!(SupervisedState::default().validation_error(), None);
        let not_finite = Attitude { z_rad: f64::NAN, ..Attitude::default() };
        let states = [
            SupervisedState { attitude: not_finite, ..SupervisedState::default() },
            SupervisedState { previous_motion: Some((not_finite, 0)), ..SupervisedState::default() },
            SupervisedState { rate_outage_s: f64::INFINITY, ..SupervisedState::default() },
        ];
        assert!(states.iter().all(|state| state.validation_error().is_some()));
    }
}
