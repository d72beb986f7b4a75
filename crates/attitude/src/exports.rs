//! The attitude in the conventions of others.
//!
//! Input: the quaternion body → reference, or a body vector, in our frames (body right, forward, up; reference east, north, up).
//! Output: the same rotation or vector in theirs. Time: none. Failure: none. `docs/conventions.json` has test vectors.

use core::f64::consts::FRAC_1_SQRT_2;

use crate::{Quaternion, Vector3};

/// For ROS (REP-103): body forward, left, up → world east, north, up; in the order x, y, z, w of its messages.
///
/// q_ros = q (cos 45°, 0, 0, sin 45°): ROS counts yaw from east, so a body facing north has a yaw of 90° there.
pub fn ros_xyzw(q: Quaternion<f64>) -> [f64; 4] {
    let turned = q * Quaternion::new(FRAC_1_SQRT_2, 0.0, 0.0, FRAC_1_SQRT_2);
    [turned.i, turned.j, turned.k, turned.w]
}

/// For PX4 and MAVLink: body forward, right, down → world north, east, down; in the order w, x, y, z.
///
/// Both frames turn by π about the bisector of their first two axes, which swaps those and reverses the third.
pub fn ned_frd_wxyz(q: Quaternion<f64>) -> [f64; 4] {
    [q.w, q.j, q.i, -q.k]
}

/// A body vector, such as a rate, in forward, left, up.
pub fn flu(body: Vector3<f64>) -> Vector3<f64> {
    Vector3::new(body.y, -body.x, body.z)
}

/// A body vector in forward, right, down; a reference vector in north, east, down.
pub fn frd(vector: Vector3<f64>) -> Vector3<f64> {
    Vector3::new(vector.y, vector.x, -vector.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rotated(q: Quaternion<f64>, v: Vector3<f64>) -> Vector3<f64> {
        (q * Quaternion::from_imag(v) * q.conjugate()).imag()
    }

    #[test]
    fn a_vector_comes_to_the_same_place_by_every_convention() {
        let q = Quaternion::new(0.3, -0.5, 0.7, 0.4).normalize();
        let body = Vector3::new(0.2, -1.3, 0.8);
        let reference = rotated(q, body);
        let [x, y, z, w] = ros_xyzw(q);
        assert!((rotated(Quaternion::new(w, x, y, z), flu(body)) - reference).norm() < 1e-15);
        let [w, x, y, z] = ned_frd_wxyz(q);
        assert!((rotated(Quaternion::new(w, x, y, z), frd(body)) - frd(reference)).norm() < 1e-15);
    }

    #[test]
    fn facing_north_is_a_yaw_of_90_degrees_in_ros_and_of_zero_in_ned() {
        let north = Quaternion::new(1.0, 0.0, 0.0, 0.0);
        assert_eq!(ros_xyzw(north), [0.0, 0.0, FRAC_1_SQRT_2, FRAC_1_SQRT_2]);
        assert_eq!(ned_frd_wxyz(north), [1.0, 0.0, 0.0, -0.0]);
    }
}
