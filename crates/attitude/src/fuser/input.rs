//! Input of a fuser.

use crate::{Vector3, accel::Inclination, gnss::Fix, gyro::Motion, scalars::scalars};

/// Input of a fuser at a tick.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FuserInput {
    /// Motion from the gyro slot.
    pub motion: Option<Motion>,
    /// Inclination from the accel slot. Present only if derived from a usable specific force.
    pub inclination: Option<Inclination>,
    /// Magnetic field in body axes, µT. Present only for a new sample.
    pub field_ut: Option<Vector3<f64>>,
    /// Fix of the satellite receiver. Present only at the tick at which it arrived.
    pub fix: Option<Fix>,
    /// `true` if gyro and accelerometer are working, so that constant readings mean rest.
    pub rest_credible: bool,
    /// `true` if `motion` can be trusted: the rate is not missing, stuck or saturated.
    pub rate_credible: bool,
}

scalars!(FuserInput: motion, inclination, field_ut, fix, rest_credible, rate_credible);
