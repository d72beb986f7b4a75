//! Attitude estimates from gyro and accelerometer alone.
//!
//! Input: checked samples.
//!
//! Output: the open-loop attitude of the gyro's stage, which starts at the first specific force,
//! and the up point of the accelerometer's stage.
//!
//! Time: that of the samples.
//!
//! Failure: an error if a stage cannot be built; `None` for an unusable output.

use accel::AccelProcessor;
use attitude::{point::Point, state::Attitude};
use gyro::GyroProcessor;
use messages::ImuSample;
use runtime::{RuntimeError, ServiceConfig, SingleInputSlot, Slot, convert};

/// Second instances of the gyro and accelerometer slots of a run.
pub(crate) struct SensorSlots {
    gyro: SingleInputSlot<GyroProcessor>,
    accel: SingleInputSlot<AccelProcessor>,
}

impl SensorSlots {
    pub(crate) fn new(config: &ServiceConfig) -> Result<Self, RuntimeError> {
        Ok(Self { gyro: gyro::slot(config)?, accel: accel::slot(config)? })
    }

    /// Processes a sample and returns the attitude of the gyro and the up point of the
    /// accelerometer.
    pub(crate) fn update(&mut self, sample: &ImuSample) -> (Option<Attitude>, Option<Point>) {
        let (mut open_loop, mut up) = (None, None);
        self.gyro.offer(*sample, &mut |step| open_loop = convert::motion(&step, 0.0).map(|motion| motion.attitude));
        self.accel.offer(*sample, &mut |point| up = convert::up(&point));
        (open_loop, up)
    }
}
