//! The filter in parts, for programs that process many samples.
//!
//! A sample passes through the parts in the order of the table. No part depends on a later one, so
//! each can be ahead of the next, for example in a thread of its own. The results equal those of
//! [`Ahrs::update`](crate::Ahrs::update) bit for bit.
//!
//! | part | content | output |
//! | --- | --- | --- |
//! | [`Sensors`] | checks of the samples; stages of gyro and accelerometer | [`CheckedSample`] |
//! | [`Aided`] | model `aided` of the fuser `multiple-model` | [`AidedOutput`] |
//! | [`Output`] | all other parts: the rest of the fuser; stage of the course | [`DeferredAttitude`] |
//!
//! [`Fusion`] holds the last two parts. With a stage other than `multiple-model` it cannot be
//! divided. It also processes the samples for which the parts depend on each other:
//!
//! - a sample after an outage of the gyro, because the attitude decides whether the level is
//!   re-initialised ([`CheckedSample::is_independent`]);
//! - a sample with an invalid output, because it resets the stage ([`Output::process`]).
//!
//! ```
//! use plumbline_ahrs::{
//!     Ahrs,
//!     parts::{CheckedSample, Parts, SampleTime},
//! };
//!
//! let mut ahrs = Ahrs::new();
//! let Parts { mut sensors, mut fusion } = ahrs.parts();
//! let mut samples = [CheckedSample::default(); 200];
//! for sample in &mut samples {
//!     let time = SampleTime::Interval { dt_s: 0.01 };
//!     sensors.process([0.0, 0.0, 0.1], [0.0, 0.0, 9.81], None, time, sample);
//! }
//! for sample in &samples {
//!     fusion.process(sample);
//! }
//! fusion.finish();
//! assert!(ahrs.attitude().is_aligned());
//! ```

use attitude::{
    accel::Accelerometer,
    conditioner::{Conditioner, Reading, Sample},
    course::{
        Course, DeferredAngles, DeferredReading, SupervisedCourse,
        supervised::{CourseTick, SupervisedReading},
    },
    flags::Flags,
    frames::Frame,
    fuser::{
        Fused, FuserStage,
        supervised::{
            AidedPart, InputSupervisor, SensorTick, StageSupervisor, SupervisedFused, SupervisedInput, WzPart,
        },
    },
    gnss::ReceiverFix,
    gyro::{Gyro, Motion, SupervisedGyro, supervised::GyroTick},
    validated_stage::ValidatedStage,
};

pub use attitude::fuser::multiple_model::AidedOutput;

use crate::Attitude;

/// Parts of a filter.
#[derive(Debug)]
pub struct Parts<'a, F> {
    /// Checks of the samples, and the stages of gyro and accelerometer.
    pub sensors: Sensors<'a>,
    /// The other stages.
    pub fusion: Fusion<'a, F>,
}

/// Time of a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SampleTime {
    /// Time since the previous sample, as for [`Ahrs::update`](crate::Ahrs::update).
    Interval {
        /// Interval, s.
        dt_s: f64,
    },
    /// Time on the clock of the sensors, as for [`Ahrs::update_at`](crate::Ahrs::update_at).
    Stamp {
        /// Timestamp, ns.
        t_ns: i64,
    },
}

/// Sample after the checks, with the results of the stages of gyro and accelerometer.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CheckedSample {
    is_accepted: bool,
    tick: u64,
    t_end_ns: i64,
    dt_s: f64,
    flags: Flags,
    fuser: SupervisedInput,
}

impl CheckedSample {
    /// Returns `true` if [`Aided`] and [`Output`] can process the sample. Otherwise only
    /// [`Fusion::process`] can.
    #[inline]
    pub fn is_independent(&self) -> bool {
        !self.is_accepted || self.fuser.is_independent()
    }
}

/// Checks of the samples, and the stages of gyro and accelerometer.
#[derive(Debug)]
pub struct Sensors<'a> {
    pub(crate) conditioner: &'a mut Conditioner,
    pub(crate) gyro: &'a mut SupervisedGyro<Gyro>,
    pub(crate) accel: &'a mut ValidatedStage<Accelerometer>,
    pub(crate) inputs: InputSupervisor<'a>,
    pub(crate) t_ns: &'a mut i64,
    pub(crate) pending_field_ut: &'a mut Option<[f64; 3]>,
    pub(crate) pending_fix: &'a mut Option<ReceiverFix>,
}

impl Sensors<'_> {
    /// Processes a sample and replaces `sample` by the result.
    ///
    /// The arguments are those of [`Ahrs::update`](crate::Ahrs::update) and
    /// [`Ahrs::update_at`](crate::Ahrs::update_at). A rejected sample does not change the other
    /// parts.
    #[inline]
    pub fn process(
        &mut self,
        gyro_rad_s: [f64; 3],
        accel_m_s2: [f64; 3],
        field_ut: Option<[f64; 3]>,
        time: SampleTime,
        sample: &mut CheckedSample,
    ) {
        let t_ns = match time {
            SampleTime::Interval { dt_s } => next_ns(*self.t_ns, dt_s),
            SampleTime::Stamp { t_ns } => t_ns,
        };
        sample.is_accepted = self.check(gyro_rad_s, accel_m_s2, field_ut, t_ns, sample).is_some();
        if sample.is_accepted {
            sample.fuser.input.sanitize();
        }
    }

    /// Replaces the values of `sample`.
    ///
    /// Returns `None` if the sample is rejected, and once a stage has failed.
    #[inline(always)]
    pub(crate) fn check(
        &mut self,
        gyro_rad_s: [f64; 3],
        accel_m_s2: [f64; 3],
        field_ut: Option<[f64; 3]>,
        t_ns: i64,
        sample: &mut CheckedSample,
    ) -> Option<()> {
        *self.t_ns = t_ns;
        let pending_ut = self.pending_field_ut.take();
        let reading = Reading {
            t_ns,
            rate_rad_s: gyro_rad_s,
            force_m_s2: accel_m_s2,
            field_ut: field_ut.or(pending_ut),
            // Most samples have no fix, and a fix is large.
            fix: if self.pending_fix.is_some() { self.pending_fix.take() } else { None },
        };
        let Sample { tick, t_start_ns, t_end_ns, flags, rate_rad_s, force_m_s2, field_ut, fix } =
            self.conditioner.condition(&reading.without_negative_zero())?;
        let (inclination, is_accel_reset) = self.accel.step(&force_m_s2.into())?;
        let (motion, is_gyro_reset) =
            self.gyro.step(&GyroTick { t_start_ns, t_end_ns, flags, rate_rad_s, force_m_s2 })?;
        let flags = flags | inclination.flags() | Flags::RESET.when(is_accel_reset || is_gyro_reset);
        let dt_s = (t_end_ns - t_start_ns) as f64 * 1e-9;
        sample.fuser = self.inputs.check(&SensorTick {
            motion: Some(Motion { dt_s, ..motion }),
            force_m_s2: Some(force_m_s2.into()),
            inclination: Some(inclination),
            field_ut: field_ut.map(Into::into),
            fix: fix.map(|received| received.fix),
            ..SensorTick::from_flags(t_start_ns, t_end_ns, flags)
        });
        (sample.tick, sample.t_end_ns, sample.dt_s, sample.flags) = (tick, t_end_ns, dt_s, flags);
        Some(())
    }
}

/// Returns the time of a sample `dt_s` after the time `t_ns`, ns.
#[inline]
pub(crate) fn next_ns(t_ns: i64, dt_s: f64) -> i64 {
    // The conversion saturates, and NaN becomes 0.
    t_ns.saturating_add(libm::round(dt_s * 1e9) as i64)
}

/// Computes the attitude after a sample. Returns `None` once a stage has failed.
#[inline(always)]
pub(crate) fn complete_attitude<F: FuserStage>(
    fuser: &mut StageSupervisor<'_, F>,
    course: &mut SupervisedCourse<Course>,
    sample: &CheckedSample,
) -> Option<Attitude> {
    let fused = fuser.step(&sample.fuser)?;
    let SupervisedReading { reading, is_reset, reset_counter, jump } =
        course.step(&course_tick(sample, &fused), core::convert::identity)?;
    let flags = sample.flags | fused.flags() | reading.flags() | Flags::RESET.when(is_reset);
    let CheckedSample { tick, t_end_ns: t_ns, .. } = *sample;
    Some(Attitude { tick, t_ns, flags, fused: fused.fused, reading, reset_counter, jump })
}

/// Fuser and course of a filter.
#[derive(Debug)]
pub struct Fusion<'a, F> {
    pub(crate) fuser: StageSupervisor<'a, F>,
    pub(crate) course: &'a mut SupervisedCourse<Course>,
    pub(crate) newest: DeferredAttitude,
    pub(crate) attitude: &'a mut Attitude,
}

impl<F: FuserStage> Fusion<'_, F> {
    /// Processes a sample and returns the new attitude. A rejected sample does not change it.
    #[inline]
    pub fn process(&mut self, sample: &CheckedSample) -> &DeferredAttitude {
        if sample.is_accepted
            && let Some(fused) = self.fuser.step(&sample.fuser)
        {
            update_course(self.course, &mut self.newest, sample, &fused);
        }
        &self.newest
    }

    /// Resets the stage, processes the sample that [`Output::process`] has returned as invalid, and
    /// returns the new attitude.
    #[cold]
    pub fn reset_and_process(&mut self, sample: &CheckedSample) -> &DeferredAttitude {
        if let Some(fused) = self.fuser.reset_and_step(&sample.fuser) {
            update_course(self.course, &mut self.newest, sample, &fused);
        }
        &self.newest
    }

    /// Divides the fusion into two parts. Returns `None` unless the stage is `multiple-model`.
    pub fn divide(&mut self) -> Option<(Aided<'_>, Output<'_>)> {
        let Self { fuser, course, newest, attitude: _ } = self;
        let (aided, fuser) = fuser.models()?;
        Some((Aided(aided), Output { fuser, course, newest }))
    }

    /// Completes the attitude of the filter.
    pub fn finish(self) {
        if self.newest == DeferredAttitude::from_attitude(self.attitude) {
            return;
        }
        let attitude = self.newest.complete();
        self.course.store_course(attitude.heading_rad());
        *self.attitude = attitude;
    }
}

/// Model `aided` of the fuser `multiple-model`.
#[derive(Debug)]
pub struct Aided<'a>(AidedPart<'a>);

impl Aided<'_> {
    /// Processes an [independent](CheckedSample::is_independent) sample.
    ///
    /// Returns `None` if [`Output`] does not need the output of the model. This is the case while
    /// the body does not move over ground and the heading does not refer to true north.
    #[inline]
    pub fn process(&mut self, sample: &CheckedSample) -> Option<AidedOutput> {
        if sample.is_accepted { self.0.step(&sample.fuser) } else { None }
    }

    /// Replaces the state of the model by that of the model in a copy of the filter.
    ///
    /// A thread should process samples with a copy, because the models of one filter share cache
    /// lines. Two processors that write to the same cache line are many times slower.
    pub fn copy_from(&mut self, copy: &Aided<'_>) {
        self.0.copy_from(&copy.0);
    }
}

/// Model `wz` of the fuser `multiple-model`, the choice between the models, and the course.
#[derive(Debug)]
pub struct Output<'a> {
    fuser: WzPart<'a>,
    course: &'a mut SupervisedCourse<Course>,
    newest: &'a mut DeferredAttitude,
}

impl Output<'_> {
    /// Processes a sample and returns the new attitude. A rejected sample does not change it.
    ///
    /// `aided` is the result of [`Aided::process`] for the sample. Returns `None` if the output of
    /// the fuser is invalid. [`Fusion::reset_and_process`] must then process the sample, and
    /// [`Fusion::process`] all samples after it.
    #[inline]
    pub fn process(&mut self, sample: &CheckedSample, aided: Option<&AidedOutput>) -> Option<&DeferredAttitude> {
        if sample.is_accepted {
            let fused = self.fuser.step(&sample.fuser, aided)?;
            update_course(self.course, self.newest, sample, &fused);
        }
        Some(self.newest)
    }
}

/// Passes a fused attitude to the stage of the course. Without a reading, `newest` is unchanged.
#[inline(always)]
fn update_course(
    course: &mut SupervisedCourse<Course>,
    newest: &mut DeferredAttitude,
    sample: &CheckedSample,
    fused: &SupervisedFused,
) {
    if let Some(SupervisedReading { reading, is_reset, reset_counter, jump }) =
        course.step_deferred(&course_tick(sample, fused))
    {
        let flags = sample.flags | fused.flags() | reading.flags() | Flags::RESET.when(is_reset);
        let CheckedSample { tick, t_end_ns: t_ns, .. } = *sample;
        *newest = DeferredAttitude { tick, t_ns, flags, fused: fused.fused, reading, reset_counter, jump };
    }
}

/// Returns the input of the course.
#[inline(always)]
fn course_tick(sample: &CheckedSample, fused: &SupervisedFused) -> CourseTick {
    let SupervisedFused { fused, reset_counter, .. } = *fused;
    CourseTick {
        attitude: Some(fused.attitude),
        rate_rad_s: fused.rate_rad_s.into(),
        reference: fused.reference,
        heading_sd_rad: fused.heading_sd_rad,
        reset_counter,
        is_swapped: false,
        fix: sample.fuser.input.fix,
        dt_s: sample.dt_s,
    }
}

/// Attitude after a sample, without its angles and its heading, which [`angles`](Self::angles)
/// computes.
///
/// The methods are those of [`Attitude`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DeferredAttitude {
    tick: u64,
    t_ns: i64,
    flags: Flags,
    fused: Fused,
    reading: DeferredReading,
    reset_counter: u64,
    jump: [f64; 4],
}

impl DeferredAttitude {
    pub(crate) fn from_attitude(attitude: &Attitude) -> Self {
        let Attitude { tick, t_ns, flags, fused, reading, reset_counter, jump } = *attitude;
        let reading = DeferredReading::from_reading(fused.attitude, &reading);
        Self { tick, t_ns, flags, fused, reading, reset_counter, jump }
    }

    fn complete(&self) -> Attitude {
        let Self { tick, t_ns, flags, fused, reading, reset_counter, jump } = *self;
        Attitude { tick, t_ns, flags, fused, reading: reading.complete(), reset_counter, jump }
    }

    /// Returns the values from which angles and heading are computed.
    #[inline]
    pub fn angles(&self) -> DeferredAngles {
        self.reading.angles
    }

    /// Returns the unit quaternion from body to reference axes of `frame`, w x y z.
    #[inline]
    pub fn quaternion_in(&self, frame: Frame) -> [f64; 4] {
        let q = self.reading.quaternion;
        frame.quaternion([q.w, q.i, q.j, q.k])
    }

    /// Returns the standard deviation of the heading, rad; π if the heading is unknown.
    #[inline]
    pub fn heading_sd_rad(&self) -> f64 {
        self.reading.course_sd_rad
    }

    /// Returns the standard deviation of the inclination, rad.
    #[inline]
    pub fn inclination_sd_rad(&self) -> f64 {
        self.fused.inclination_sd_rad
    }

    /// Returns the body rate in the body axes of `frame` with the bias removed, rad/s.
    #[inline]
    pub fn rate_rad_s_in(&self, frame: Frame) -> [f64; 3] {
        frame.body().vector(self.fused.rate_rad_s.into())
    }

    /// Returns the estimated gyro bias in the body axes of `frame`, rad/s.
    #[inline]
    pub fn gyro_bias_rad_s_in(&self, frame: Frame) -> [f64; 3] {
        frame.body().vector(self.fused.bias_rad_s.into())
    }

    /// Returns the faults and events of the sample.
    #[inline]
    pub fn flags(&self) -> Flags {
        self.flags
    }

    /// Returns the number of jumps of the attitude or the heading since the first alignment.
    #[inline]
    pub fn reset_counter(&self) -> u64 {
        self.reset_counter
    }

    /// Returns the number of accepted samples before this one.
    #[inline]
    pub fn tick(&self) -> u64 {
        self.tick
    }
}
