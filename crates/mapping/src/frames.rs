//! Axes of others, in ours: body right, forward, up; earth east, north, up. Of vectors only signs and places change, so every value
//! stays exact.

use std::f64::consts::FRAC_1_SQRT_2;

/// By how much the length of an attitude's quaternion may differ from 1.
const LENGTH_TOLERANCE: f64 = 0.01;

/// A quaternion of unit length, as far as others round it.
pub fn is_rotation(quaternion: [f64; 4]) -> bool {
    let length = quaternion.iter().map(|part| part * part).sum::<f64>().sqrt();
    (length - 1.0).abs() <= LENGTH_TOLERANCE
}

/// Forward, right, down to right, forward, up. North, east, down to east, north, up is the same.
pub fn of_frd([forward, right, down]: [f64; 3]) -> [f64; 3] {
    [right, forward, -down]
}

/// Forward, left, up to right, forward, up.
pub fn of_flu([forward, left, up]: [f64; 3]) -> [f64; 3] {
    [-left, forward, up]
}

/// w, x, y, z from forward, right, down to north, east, down, made one from right, forward, up to east, north, up.
pub fn of_ned_frd([w, x, y, z]: [f64; 4]) -> [f64; 4] {
    [w, y, x, -z]
}

/// w, x, y, z from forward, left, up to east, north, up, made one from right, forward, up: an eighth of a turn in w and z.
pub fn of_enu_flu([w, x, y, z]: [f64; 4]) -> [f64; 4] {
    [w + z, x - y, x + y, z - w].map(|part| part * FRAC_1_SQRT_2)
}

/// Forward, right, down and right, forward, up are half a turn apart; so are north, east, down and east, north, up.
const HALF_TURN: [f64; 4] = [0.0, FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0];

/// The same attitude to east, north, up of one to north, east, down.
pub fn to_enu_of_ned(quaternion: [f64; 4]) -> [f64; 4] {
    product(HALF_TURN, quaternion)
}

/// The same attitude from right, forward, up of one from forward, right, down.
pub fn from_rfu_of_frd(quaternion: [f64; 4]) -> [f64; 4] {
    product(quaternion, HALF_TURN)
}

fn product([w, x, y, z]: [f64; 4], [a, b, c, d]: [f64; 4]) -> [f64; 4] {
    [
        w * a - x * b - y * c - z * d,
        w * b + x * a + y * d - z * c,
        w * c - x * d + y * a + z * b,
        w * d + x * c - y * b + z * a,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// v turned by q: (w² − u·u) v + 2 (u·v) u + 2 w u × v.
    fn turned([w, x, y, z]: [f64; 4], v: [f64; 3]) -> [f64; 3] {
        let u = [x, y, z];
        let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let cross = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        [0, 1, 2].map(|i| (w * w - dot(u, u)) * v[i] + 2.0 * dot(u, v) * u[i] + 2.0 * w * cross[i])
    }

    #[test]
    fn a_vector_turned_in_their_axes_is_the_one_turned_in_ours() {
        let (q, v) = ([0.1, -0.5, 0.7, 0.5], [1.0, -2.0, 3.5]);
        let (theirs, ours) = (of_frd(turned(q, v)), turned(of_ned_frd(q), of_frd(v)));
        assert!(theirs.iter().zip(ours).all(|(a, b)| (a - b).abs() < 1e-12), "{theirs:?} {ours:?}");
        for (theirs, ours) in [
            (turned(q, v), turned(of_enu_flu(q), of_flu(v))),
            (turned(q, v), turned(from_rfu_of_frd(q), of_frd(v))),
            (of_frd(turned(q, v)), turned(to_enu_of_ned(q), v)),
        ] {
            assert!(theirs.iter().zip(ours).all(|(a, b)| (a - b).abs() < 1e-12), "{theirs:?} {ours:?}");
        }
    }

    #[test]
    fn each_axis_goes_where_its_name_says() {
        assert_eq!(of_frd([1.0, 2.0, 3.0]), [2.0, 1.0, -3.0]);
        assert_eq!(of_flu([1.0, 2.0, 3.0]), [-2.0, 1.0, 3.0]);
    }
}
