//! Samples that the messages of a bag contain.

use crate::row_writer::Attitude;

/// Sample of body rate, specific force or both in native axes, with the attitude from the same
/// message, if any.
pub(crate) struct InertialSample {
    pub(crate) t_ns: i64,
    /// Body rate, rad/s; `None` if it was not measured.
    pub(crate) rate_rad_s: Option<[f64; 3]>,
    /// Specific force, m/s²; `None` if it was not measured.
    pub(crate) force_m_s2: Option<[f64; 3]>,
    /// `true` if the rate is the value at the end of the interval instead of its mean over the
    /// interval.
    pub(super) is_instant: bool,
    pub(super) attitude: Option<Attitude>,
}

/// Velocity measured by a GNSS receiver, east, north, up.
pub(super) struct VelocityFix {
    pub(super) t_ns: i64,
    pub(super) velocity_m_s: [f64; 3],
    /// Position, if the same message contains it.
    pub(super) position: Option<Position>,
}

/// Position measured by a GNSS receiver.
#[derive(Clone, Copy)]
pub(super) struct Position {
    pub(super) latitude_deg: f64,
    pub(super) longitude_deg: f64,
    pub(super) altitude_m: f64,
}
