//! Attitude estimates from the gyro alone and from the accelerometer alone.
//!
//! Input: checked samples.
//!
//! Output: the open-loop attitude from the gyro stage, which starts with the up direction of the
//! first specific force, and the up point from the accelerometer stage.
//!
//! Time: sample timestamps.
//!
//! Failure: an error if a stage cannot be built; `None` if an output is unusable.

use attitude::{point::Point, state::Attitude};
use messages::ImuSample;
use runtime::{RuntimeError, ServiceConfig, SingleInputSlot, SlotProcessor, convert};
use slots::accel::AccelProcessor;
use slots::gyro::GyroProcessor;

/// Separate instances of the gyro and accelerometer slots for a run.
pub(crate) struct SensorSlots {
    gyro: SingleInputSlot<GyroProcessor>,
    accel: SingleInputSlot<AccelProcessor>,
}

impl SensorSlots {
    pub(crate) fn new(config: &ServiceConfig) -> Result<Self, RuntimeError> {
        Ok(Self { gyro: slots::gyro::slot(config)?, accel: slots::accel::slot(config)? })
    }

    /// Processes a sample and returns the gyro's attitude and the accelerometer's up point.
    pub(crate) fn update(&mut self, sample: &ImuSample) -> (Option<Attitude>, Option<Point>) {
        let (mut open_loop, mut up) = (None, None);
        self.gyro.offer(*sample, &mut |step| open_loop = convert::motion(&step, 0.0).map(|motion| motion.attitude));
        self.accel.offer(*sample, &mut |point| up = convert::up(&point));
        (open_loop, up)
    }
}
