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
//!   than [`MAX_BRIDGED_GAP_S`](crate::gyro::MAX_BRIDGED_GAP_S) re-initialises the level.
//! - After a rate outage the level is re-initialised if its error has become too large.
//! - The specific force of a dead accelerometer is not used.
//! - A stage whose output is invalid is reset. If the output after the reset is also invalid, the
//!   stage has failed.
//!
//! | module | contents |
//! | --- | --- |
//! | `sensor_tick` | [`SensorTick`], the input |
//! | `input_supervisor` | [`InputSupervisor`]: missing ticks, unusable values, outages |
//! | `stage_supervisor` | [`StageSupervisor`]: realignment, step, reset |
//! | `output_flags` | [`SupervisedFused`], the output: flags and counter of jumps |

mod input_supervisor;
mod output_flags;
mod sensor_tick;
mod stage_supervisor;

pub use input_supervisor::{InputSupervisor, Realignment, SupervisedInput};
pub use output_flags::SupervisedFused;
pub use sensor_tick::{ForceFaults, RateFaults, SensorTick};
pub use stage_supervisor::{AidedPart, StageSupervisor, WzPart};

use super::FuserStage;
use crate::{
    state::Attitude,
    state_words::StateWords,
    validated_stage::{StageFailure, ValidatedStage},
};
use output_flags::OutputSupervisor;

/// Fuser stage with the supervision of its inputs and outputs.
#[derive(Debug, Clone)]
pub struct SupervisedFuser<S> {
    validated: ValidatedStage<S>,
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
        Self { validated: ValidatedStage::new(stage), state: SupervisedState::default() }
    }

    /// Returns the supervised stage.
    pub fn stage(&self) -> &S {
        &self.validated.stage
    }

    /// Returns a mutable reference to the stage, for restoring its state.
    pub fn stage_mut(&mut self) -> &mut S {
        &mut self.validated.stage
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
        self.validated.failure()
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
        let Self { validated, state } = self;
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
            StageSupervisor { validated, outputs },
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        GRAVITY_M_S2, Vector3,
        accel::Inclination,
        fuser::{Corrections, Estimate, Fused, Fuser, FuserInput, finite::fuser_items},
        gyro::{Gyro, Motion, RateKind, RateSample},
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
