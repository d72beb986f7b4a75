//! Tumbling: a constant rate about a body-fixed axis, starting from level and passing through the
//! inverted attitude.

use attitude::{Vector3, rotation::Rotation, state::Attitude};

/// Returns the body rate of the scenario `tumble` in rad/s, which is 500 °/s about (3, −2, 1).
///
/// The axis is 75° from the vertical, so the inclination reaches 149°.
pub fn rate_rad_s() -> Vector3<f64> {
    Vector3::new(3.0, -2.0, 1.0).normalize() * 500f64.to_radians()
}

/// Returns the attitude at `t_s`.
pub(crate) fn at(rate_rad_s: Vector3<f64>, t_s: f64) -> Attitude {
    Attitude::default().rotated(Rotation::from_rotation_vector(rate_rad_s * t_s)).attitude
}
