//! One full turn at 1 rad/s about x, then one about y, then one about z, each 2π s long, from level; at rest after that.
//!
//! The simulation of S3 (improved orientation of a UAV by the Madgwick filter). It leaves the field open; here it is inclined as
//! in middle latitudes, η0 towards magnetic north.

use core::f64::consts::TAU;

use attitude::{Vector3, state::Attitude, rotation::Rotation};

/// The magnetic field, µT, reference axes: 20 µT to the north, 44 µT down, an inclination of 66°.
pub const FIELD_UT: [f64; 3] = [0.0, 20.0, -44.0];

/// All three turns, s.
pub const DURATION_S: f64 = 3.0 * TAU;

/// Attitude and body rate, rad/s, at `t_s`.
pub(crate) fn at(t_s: f64) -> (Attitude, Vector3<f64>) {
    let rate_rad_s = match t_s {
        t if !(0.0..DURATION_S).contains(&t) => Vector3::zeros(),
        t if t < TAU => Vector3::x(),
        t if t < 2.0 * TAU => Vector3::y(),
        _ => Vector3::z(),
    };
    let angles_rad = rotation_rad(t_s);
    let about = [Vector3::x(), Vector3::y(), Vector3::z()];
    let attitude = (0..3).fold(Attitude::default(), |attitude, axis| {
        attitude.rotated(Rotation::from_rotation_vector(about[axis] * angles_rad[axis])).attitude
    });
    (attitude, rate_rad_s)
}

/// The integral of the body rate from 0 to `t_s`, rad.
pub(crate) fn rotation_rad(t_s: f64) -> Vector3<f64> {
    Vector3::new(t_s, t_s - TAU, t_s - 2.0 * TAU).map(|turned_rad| turned_rad.clamp(0.0, TAU))
}
