//! The input of a fuser.

use crate::{Vector3, accel::Inclination, gnss::Fix, gyro::Motion, numbers::Numbers};

/// What a fuser is offered at a tick.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FuserInput {
    /// From the gyro slot.
    pub motion: Option<Motion>,
    /// From the accel slot; only one made from a force that can be used.
    pub inclination: Option<Inclination>,
    /// The magnetic field, µT, body axes; only where it is a new sample.
    pub field_ut: Option<Vector3<f64>>,
    /// Of the satellite receiver; only at the tick at which it arrived.
    pub fix: Option<Fix>,
    /// Gyro and accelerometer are alive, so that stillness means rest.
    pub rest_credible: bool,
    /// The motion is what the body did: its rate is neither missing nor stuck nor at the end of the gyro's range.
    pub rate_credible: bool,
}

impl Numbers for FuserInput {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let Self { motion, inclination, field_ut, fix, rest_credible, rate_credible } = self;
        motion.visit(visit);
        inclination.visit(visit);
        field_ut.visit(visit);
        fix.visit(visit);
        rest_credible.visit(visit);
        rate_credible.visit(visit);
    }
}
