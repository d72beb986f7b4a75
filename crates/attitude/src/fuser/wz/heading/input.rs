//! The input of the heading.

use crate::{Complex, Vector3, state::Attitude};

/// What the heading sees at a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::fuser::wz) struct HeadingInput {
    /// The attitude, its heading that of the gyro alone.
    pub(in crate::fuser::wz) attitude: Attitude,
    /// e^{jz} of that attitude.
    pub(in crate::fuser::wz) azimuth: Complex<f64>,
    /// Body rate less the bias, rad/s.
    pub(in crate::fuser::wz) rate_rad_s: Vector3<f64>,
    /// Horizontal part of the specific force, m/s².
    pub(in crate::fuser::wz) force_m_s2: Complex<f64>,
    /// Length of the specific force, m/s².
    pub(in crate::fuser::wz) norm_m_s2: Option<f64>,
    /// Variance of what is left of the gyro's scale, each axis.
    pub(in crate::fuser::wz) scale_variance: [f64; 3],
    /// Magnetic field, µT, body axes.
    pub(in crate::fuser::wz) field_ut: Option<Vector3<f64>>,
    /// The body rests.
    pub(in crate::fuser::wz) at_rest: bool,
    /// Length of the tick's interval, s.
    pub(in crate::fuser::wz) dt_s: f64,
    /// How much of it, or beside it, nobody saw the body turn, s.
    pub(in crate::fuser::wz) gyro_outage_s: f64,
}
