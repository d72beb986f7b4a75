//! The slots of the path in one process: the same slots, the same join, the same bytes.

use ingest::conditioner::Sample;
use launch::Service;
use messages::{AttitudeOutput, FusedState};
use runtime::{RuntimeError, ServiceConfig, Slot};

/// The path from a sample to an attitude.
pub struct Path {
    gyro: runtime::EachTick<gyro::GyroWork>,
    accel: runtime::EachTick<accel::AccelWork>,
    fuser: fuser::FuserSlot,
    course: course::CourseSlot,
}

impl Path {
    /// The slots with the stages that `config` names.
    pub fn new(config: &ServiceConfig) -> Result<Self, RuntimeError> {
        Ok(Self {
            gyro: gyro::slot(config)?,
            accel: accel::slot(config)?,
            fuser: fuser::slot(config)?,
            course: course::slot(config)?,
        })
    }

    /// Hands every attitude that follows from `sample` to `publish`.
    pub fn offer(&mut self, sample: Sample, publish: &mut dyn FnMut(AttitudeOutput)) -> Result<(), RuntimeError> {
        let Self { gyro, accel, fuser, course } = self;
        let Sample { imu, mag, gnss } = sample;
        if let Some(fix) = gnss {
            course.offer(fix.into(), publish);
        }
        let mut fused = |state: FusedState| course.offer(state.into(), publish);
        if let Some(field) = mag {
            fuser.offer(field.into(), &mut fused);
        }
        if let Some(fix) = gnss {
            fuser.offer(fix.into(), &mut fused);
        }
        accel.offer(imu, &mut |point| fuser.offer(point.into(), &mut fused));
        gyro.offer(imu, &mut |step| fuser.offer(step.into(), &mut fused));
        let failures = [
            (Service::Gyro, gyro.failure()),
            (Service::Accel, accel.failure()),
            (Service::Fuser, fuser.failure()),
            (Service::Course, course.failure()),
        ];
        let failed = failures.into_iter().find_map(|(slot, why)| Some(RuntimeError::Failed { slot, why: why? }));
        failed.map_or(Ok(()), Err)
    }
}
