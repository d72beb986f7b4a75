//! Course stage that also reports the jumps of the attitude.
//!
//! Input: the fused attitude of each tick with the counter of its resets.
//!
//! Output: the reading of the stage, the jump of the newest reset, and the number of resets.
//!
//! Failure: if an attitude is missing, the previous one is used. A stage whose output is invalid is
//! reset. If the output after the reset is also invalid, the stage has failed.

use super::{Course, CourseInput, CourseReading, CourseReference, DeferredReading};
use crate::{
    Vector3,
    gnss::Fix,
    rotation::Rotation,
    stage::{Stage, Validate as _},
    state::Attitude,
    state_words::StateWords,
    validated_stage::ValidatedStage,
};

/// Fused attitude of a tick.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CourseTick {
    /// Fused attitude; `None` if it is missing.
    pub attitude: Option<Attitude>,
    /// Body rate with the bias removed, rad/s.
    pub rate_rad_s: [f64; 3],
    /// Reference direction of the heading.
    pub reference: CourseReference,
    /// Standard deviation of the heading, rad.
    pub heading_sd_rad: f64,
    /// Number of resets of the attitude.
    pub reset_counter: u64,
    /// Set if another fuser stage computed the attitude from this tick on.
    pub is_swapped: bool,
    /// Fix from the satellite receiver, present only at the tick at which it arrived.
    pub fix: Option<Fix>,
    /// Length of the tick's interval, s.
    pub dt_s: f64,
}

/// Output of a [`SupervisedCourse`] at a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SupervisedReading<R = CourseReading> {
    /// Output of the stage.
    pub reading: R,
    /// Set if the stage was reset for this output, because its first output was invalid.
    pub is_reset: bool,
    /// Number of resets of attitude and course.
    pub reset_counter: u64,
    /// Rotation that the newest reset applied to the attitude, in body axes, w x y z.
    pub jump: [f64; 4],
}

/// Course stage with the supervision of its inputs and outputs.
#[derive(Debug, Clone)]
pub struct SupervisedCourse<S> {
    /// Course stage, which is reset after an invalid output.
    pub validated: ValidatedStage<S>,
    state: SupervisedCourseState,
}

/// State of a [`SupervisedCourse`], excluding its stage.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SupervisedCourseState {
    /// Newest fused attitude, used again while the attitude is missing.
    pub attitude: Attitude,
    /// Number of resets of the fuser, followed by the number of resets of the course.
    pub reset_counts: [u64; 2],
    /// Rotation that the newest reset applied to the attitude, in body axes, w x y z.
    pub jump: [f64; 4],
    /// Number of swaps of the fuser.
    pub swap_count: u64,
}

impl Default for SupervisedCourseState {
    fn default() -> Self {
        Self { attitude: Attitude::default(), reset_counts: [0; 2], jump: [1.0, 0.0, 0.0, 0.0], swap_count: 0 }
    }
}

impl SupervisedCourseState {
    /// Returns the input of the stage, and `true` if the attitude has jumped.
    #[inline(always)]
    fn next_input(&mut self, tick: &CourseTick) -> (CourseInput, bool) {
        let attitude = tick.attitude.unwrap_or(self.attitude);
        let has_jumped = tick.reset_counter != self.reset_counts[0] || tick.is_swapped;
        if has_jumped {
            let rotation_rad = Vector3::from(tick.rate_rad_s) * tick.dt_s;
            let expected = self.attitude.rotated(Rotation::from_rotation_vector(rotation_rad)).attitude;
            let jump = Rotation::between(expected, attitude).quaternion();
            self.jump = [jump.w, jump.i, jump.j, jump.k];
            self.reset_counts[0] = tick.reset_counter;
            self.swap_count += u64::from(tick.is_swapped);
        }
        self.attitude = attitude;
        let CourseTick { reference, heading_sd_rad, fix, dt_s, .. } = *tick;
        (CourseInput { attitude, reference, heading_sd_rad, fix, dt_s }, has_jumped)
    }

    /// Counts the resets. If the attitude and the course are reset at the same tick, only one reset
    /// is counted.
    #[inline(always)]
    fn supervise<R>(
        &mut self,
        reading: R,
        is_course_aligned: bool,
        is_reset: bool,
        has_jumped: bool,
    ) -> SupervisedReading<R> {
        self.reset_counts[1] += u64::from(is_course_aligned && !has_jumped);
        let reset_counter = self.reset_counts.iter().sum::<u64>() + self.swap_count;
        SupervisedReading { reading, is_reset, reset_counter, jump: self.jump }
    }

    /// Returns the reason why the state is invalid, or `None` if it is valid.
    pub fn validation_error(&self) -> Option<&'static str> {
        let is_finite = self.attitude.quaternion().coords.norm().is_finite() && self.jump.iter().all(|x| x.is_finite());
        (!is_finite).then_some("a number that is not finite")
    }
}

impl<S: Stage<Input = CourseInput, Output = CourseReading> + Clone> SupervisedCourse<S> {
    /// Supervises a stage that has not been stepped yet.
    pub fn new(stage: S) -> Self {
        Self { validated: ValidatedStage::new(stage), state: SupervisedCourseState::default() }
    }

    /// Returns the state, excluding that of the stage.
    pub fn state(&self) -> &SupervisedCourseState {
        &self.state
    }

    /// Returns a mutable reference to the state, for restoring it.
    pub fn state_mut(&mut self) -> &mut SupervisedCourseState {
        &mut self.state
    }

    /// Processes a tick. `to_true_north` converts a reading with a magnetic course to one with a
    /// true course.
    ///
    /// Returns `None` once the stage has failed permanently.
    #[inline(always)]
    pub fn step(
        &mut self,
        tick: &CourseTick,
        to_true_north: impl FnOnce(CourseReading) -> CourseReading,
    ) -> Option<SupervisedReading> {
        let (input, has_jumped) = self.state.next_input(tick);
        let (reading, is_reset) = self.validated.step(&input)?;
        let reading = to_true_north(reading);
        Some(self.state.supervise(reading, reading.aligned, is_reset, has_jumped))
    }
}

impl SupervisedCourse<Course> {
    /// Processes a tick like [`step`](Self::step), but without the angles and the course.
    ///
    /// After the last tick, the state needs [`store_course`](Self::store_course). Returns `None`
    /// once the stage has failed permanently.
    #[inline(always)]
    pub fn step_deferred(&mut self, tick: &CourseTick) -> Option<SupervisedReading<DeferredReading>> {
        let (input, has_jumped) = self.state.next_input(tick);
        let mut reading = None;
        if !self.validated.has_failed() {
            reading = Some(self.validated.stage.step_deferred(&input));
        }
        let (reading, is_reset) = match reading.filter(|reading| reading.validation_error().is_none()) {
            Some(reading) => (reading, false),
            None => self.repeat_step(input)?,
        };
        Some(self.state.supervise(reading, reading.aligned, is_reset, has_jumped))
    }

    /// Repeats a step with an invalid reading. The complete reading is invalid, too, so the stage
    /// is reset.
    #[cold]
    fn repeat_step(&mut self, input: CourseInput) -> Option<(DeferredReading, bool)> {
        let (reading, is_reset) = self.validated.step(&input)?;
        Some((DeferredReading::from_reading(input.attitude, &reading), is_reset))
    }

    /// Completes the state with the course of the newest [`DeferredReading`], rad.
    pub fn store_course(&mut self, course_rad: f64) {
        self.validated.stage.store_course(course_rad);
    }
}

impl StateWords for SupervisedCourseState {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        let Self { attitude, reset_counts, jump, swap_count } = self;
        attitude.visit(visit);
        reset_counts.visit(visit);
        jump.visit(visit);
        swap_count.visit(visit);
    }
}
