//! Scenario S3: one full turn at 1 rad/s about x, then y, then z, starting from level; then rest.
//!
//! Each turn lasts 2π s. The motion is taken from the paper S3, on improved orientation of a UAV by
//! the Madgwick filter. The paper does not specify the magnetic field. The magnetic field used here
//! has an inclination typical of middle latitudes and points to magnetic north.

use core::f64::consts::TAU;

use attitude::{Vector3, rotation::Rotation, state::Attitude};

/// Magnetic field, µT, reference axes: 20 µT north and 44 µT down, with an inclination of 66°.
pub const FIELD_UT: [f64; 3] = [0.0, 20.0, -44.0];

/// Duration of the three turns, s.
pub const DURATION_S: f64 = 3.0 * TAU;

/// Returns the attitude and the body rate in rad/s at `t_s`.
pub(crate) fn at(t_s: f64) -> (Attitude, Vector3<f64>) {
    let rate_rad_s = match t_s {
        t if !(0.0..DURATION_S).contains(&t) => Vector3::zeros(),
        t if t < TAU => Vector3::x(),
        t if t < 2.0 * TAU => Vector3::y(),
        _ => Vector3::z(),
    };
    let angles_rad = rotation_rad(t_s);
    let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
    let attitude = (0..3).fold(Attitude::default(), |attitude, axis| {
        attitude.rotated(Rotation::from_rotation_vector(axes[axis] * angles_rad[axis])).attitude
    });
    (attitude, rate_rad_s)
}

/// Returns the integral of the body rate from 0 to `t_s`, rad.
pub(crate) fn rotation_rad(t_s: f64) -> Vector3<f64> {
    Vector3::new(t_s, t_s - TAU, t_s - 2.0 * TAU).map(|turned_rad| turned_rad.clamp(0.0, TAU))
}
