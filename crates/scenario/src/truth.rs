//! True state of a simulated body.

use attitude::{Vector3, state::Attitude};

/// True state of the body at a given time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    /// True attitude.
    pub attitude: Attitude,
    /// Body rate, rad/s, body axes.
    pub rate_rad_s: Vector3<f64>,
    /// Specific force, m/s², body axes. In all motions except the flights, the body rotates in
    /// place, so the force is due to gravity alone.
    pub force_m_s2: Vector3<f64>,
}
