//! Input of the heading filter.

use crate::{Complex, Vector3, state::Attitude};

/// Input of the heading filter at a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::fuser::wz) struct HeadingInput {
    /// Attitude with the heading of the gyro alone.
    pub(in crate::fuser::wz) attitude: Attitude,
    /// e^{jz}, with the azimuth z of `attitude`.
    pub(in crate::fuser::wz) azimuth: Complex<f64>,
    /// Body rate with gyro bias and scale error removed, rad/s.
    pub(in crate::fuser::wz) rate_rad_s: Vector3<f64>,
    /// Horizontal part of the specific force, m/s².
    pub(in crate::fuser::wz) horizontal_force_m_s2: Complex<f64>,
    /// Norm of the specific force, m/s².
    pub(in crate::fuser::wz) force_norm_m_s2: Option<f64>,
    /// Variance of the remaining gyro scale error of each axis.
    pub(in crate::fuser::wz) scale_variance: [f64; 3],
    /// Variance of the gyro bias about the vertical, rad²/s².
    pub(in crate::fuser::wz) vertical_bias_variance: f64,
    /// Magnetic field in body axes, µT.
    pub(in crate::fuser::wz) field_ut: Option<Vector3<f64>>,
    /// `true` while the body is at rest.
    pub(in crate::fuser::wz) at_rest: bool,
    /// Duration of the tick, s.
    pub(in crate::fuser::wz) dt_s: f64,
    /// Time without an observed rotation, s. It may exceed `dt_s`, because a tick without a motion
    /// has a zero interval.
    pub(in crate::fuser::wz) gyro_outage_s: f64,
}
