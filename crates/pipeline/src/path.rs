//! Runs the slots of the data path in one process.
//!
//! [`Path`] uses the same slots, joins and hand-overs as the services, so its output is
//! bit-identical to theirs.

use launch::Slot;
use messages::{AttitudeOutput, FusedState};
use readings::conditioner::Sample;
use runtime::{RuntimeError, ServiceConfig};

use crate::{schedule::Schedule, slot_runner::SlotRunner};

/// Data path from sample to attitude.
pub struct Path {
    gyro: SlotRunner<runtime::SingleInputSlot<slots::gyro::GyroProcessor>>,
    accel: SlotRunner<runtime::SingleInputSlot<slots::accel::AccelProcessor>>,
    fuser: SlotRunner<slots::fuser::FuserSlot>,
    course: SlotRunner<slots::course::CourseSlot>,
}

impl Path {
    /// Creates the path with the stages that `config` names.
    ///
    /// # Errors
    ///
    /// Returns an error if a stage cannot be built.
    pub fn new(config: &ServiceConfig) -> Result<Self, RuntimeError> {
        Self::with_schedule(config, &Schedule::default())
    }

    /// Creates the path with the stages that `config` names and the stages that replace them later.
    ///
    /// # Errors
    ///
    /// Returns an error if a stage cannot be built.
    pub fn with_schedule(config: &ServiceConfig, schedule: &Schedule) -> Result<Self, RuntimeError> {
        Ok(Self {
            gyro: SlotRunner::new(slots::gyro::slot, config, schedule)?,
            accel: SlotRunner::new(slots::accel::slot, config, schedule)?,
            fuser: SlotRunner::new(slots::fuser::slot, config, schedule)?,
            course: SlotRunner::new(slots::course::slot, config, schedule)?,
        })
    }

    /// Processes a sample and passes each resulting attitude to `publish`.
    ///
    /// # Errors
    ///
    /// Returns an error if a stage has failed.
    pub fn offer(&mut self, sample: Sample, publish: &mut dyn FnMut(AttitudeOutput)) -> Result<(), RuntimeError> {
        self.offer_observed(sample, &mut |_| {}, publish)
    }

    /// Processes a sample as [`Path::offer`] does and also passes each fused state to `on_fused`.
    ///
    /// # Errors
    ///
    /// Returns an error if a stage has failed.
    pub fn offer_observed(
        &mut self,
        sample: Sample,
        on_fused: &mut dyn FnMut(&FusedState),
        publish: &mut dyn FnMut(AttitudeOutput),
    ) -> Result<(), RuntimeError> {
        let Self { gyro, accel, fuser, course } = self;
        let Sample { imu, mag, gnss, .. } = sample;
        course.advance_to(imu.header.tick, publish)?;
        if let Some(fix) = gnss {
            course.offer(fix.into(), publish);
        }
        let mut fused = |state: FusedState| {
            on_fused(&state);
            course.offer(state.into(), publish);
        };
        fuser.advance_to(imu.header.tick, &mut fused)?;
        if let Some(field) = mag {
            fuser.offer(field.into(), &mut fused);
        }
        if let Some(fix) = gnss {
            fuser.offer(fix.into(), &mut fused);
        }
        accel.advance_to(imu.header.tick, &mut |point| fuser.offer(point.into(), &mut fused))?;
        gyro.advance_to(imu.header.tick, &mut |step| fuser.offer(step.into(), &mut fused))?;
        accel.offer(imu, &mut |point| fuser.offer(point.into(), &mut fused));
        gyro.offer(imu, &mut |step| fuser.offer(step.into(), &mut fused));
        let failures = [
            (Slot::Gyro, gyro.failure()),
            (Slot::Accel, accel.failure()),
            (Slot::Fuser, fuser.failure()),
            (Slot::Course, course.failure()),
        ];
        let failure = failures.into_iter().find_map(|(slot, cause)| Some((slot, cause?)));
        failure.map_or(Ok(()), |(slot, cause)| Err(RuntimeError::StageFailed { slot, cause }))
    }
}
