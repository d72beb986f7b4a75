//! The slots of the path in one process: the same slots, the same join, the same hand-over from stage to stage, the same bytes.

use ingest::conditioner::Sample;
use launch::Service;
use messages::{AttitudeOutput, FusedState};
use runtime::{RuntimeError, ServiceConfig};

use crate::{schedule::Schedule, seat::Seat};

/// The path from a sample to an attitude.
pub struct Path {
    gyro: Seat<runtime::SingleInputSlot<gyro::GyroProcessor>>,
    accel: Seat<runtime::SingleInputSlot<accel::AccelProcessor>>,
    fuser: Seat<fuser::FuserSlot>,
    course: Seat<course::CourseSlot>,
}

impl Path {
    /// The slots with the stages that `config` names.
    pub fn new(config: &ServiceConfig) -> Result<Self, RuntimeError> {
        Self::with_swaps(config, &Schedule::default())
    }

    /// The slots with the stages that `config` names, and those that have them later.
    pub fn with_swaps(config: &ServiceConfig, schedule: &Schedule) -> Result<Self, RuntimeError> {
        Ok(Self {
            gyro: Seat::new(Service::Gyro, gyro::slot, config, schedule)?,
            accel: Seat::new(Service::Accel, accel::slot, config, schedule)?,
            fuser: Seat::new(Service::Fuser, fuser::slot, config, schedule)?,
            course: Seat::new(Service::Course, course::slot, config, schedule)?,
        })
    }

    /// Hands every attitude that follows from `sample` to `publish`.
    pub fn offer(&mut self, sample: Sample, publish: &mut dyn FnMut(AttitudeOutput)) -> Result<(), RuntimeError> {
        self.offer_seen(sample, &mut |_| {}, publish)
    }

    /// The same, and every fused state on the way to `see`.
    pub fn offer_seen(
        &mut self,
        sample: Sample,
        see: &mut dyn FnMut(&FusedState),
        publish: &mut dyn FnMut(AttitudeOutput),
    ) -> Result<(), RuntimeError> {
        let Self { gyro, accel, fuser, course } = self;
        let Sample { imu, mag, gnss, .. } = sample;
        course.before(imu.header.tick, publish)?;
        if let Some(fix) = gnss {
            course.offer(fix.into(), publish);
        }
        let mut fused = |state: FusedState| {
            see(&state);
            course.offer(state.into(), publish);
        };
        fuser.before(imu.header.tick, &mut fused)?;
        if let Some(field) = mag {
            fuser.offer(field.into(), &mut fused);
        }
        if let Some(fix) = gnss {
            fuser.offer(fix.into(), &mut fused);
        }
        accel.before(imu.header.tick, &mut |point| fuser.offer(point.into(), &mut fused))?;
        gyro.before(imu.header.tick, &mut |step| fuser.offer(step.into(), &mut fused))?;
        accel.offer(imu, &mut |point| fuser.offer(point.into(), &mut fused));
        gyro.offer(imu, &mut |step| fuser.offer(step.into(), &mut fused));
        let failures = [
            (Service::Gyro, gyro.failure()),
            (Service::Accel, accel.failure()),
            (Service::Fuser, fuser.failure()),
            (Service::Course, course.failure()),
        ];
        let failed = failures.into_iter().find_map(|(slot, why)| Some(RuntimeError::StageFailed { slot, cause: why? }));
        failed.map_or(Ok(()), Err)
    }
}
