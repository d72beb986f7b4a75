//! Time constants of the levelling loop.

/// Time constant of the leaky velocity, s.
pub(super) const T1_S: f64 = 3.0;
/// Time constant of the tilt, s.
pub(super) const T2_S: f64 = 2.0;
