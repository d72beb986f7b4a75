//! What gyro and accelerometer say on their own.
//!
//! Input: checked samples. Output: the attitude that the gyro's stage integrates from the first specific force on, and the point where the accelerometer's
//! stage sees up. Time: the samples' own. Failure: stages that cannot start; `None` where a stage says nothing that can be used.

use accel::AccelProcessor;
use attitude::{point::Point, state::Attitude};
use gyro::GyroProcessor;
use messages::ImuSample;
use runtime::{SingleInputSlot, RuntimeError, ServiceConfig, Slot, convert};

/// The gyro's and the accelerometer's slot of a run, once more beside it.
pub(crate) struct Sensors {
    gyro: SingleInputSlot<GyroProcessor>,
    accel: SingleInputSlot<AccelProcessor>,
}

impl Sensors {
    pub(crate) fn new(config: &ServiceConfig) -> Result<Self, RuntimeError> {
        Ok(Self { gyro: gyro::slot(config)?, accel: accel::slot(config)? })
    }

    /// What both say of a sample.
    pub(crate) fn take(&mut self, sample: &ImuSample) -> (Option<Attitude>, Option<Point>) {
        let (mut open_loop, mut seen) = (None, None);
        self.gyro.offer(*sample, &mut |step| open_loop = convert::motion(&step, 0.0).map(|motion| motion.attitude));
        self.accel.offer(*sample, &mut |point| seen = convert::up(&point));
        (open_loop, seen)
    }
}
