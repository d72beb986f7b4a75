//! Yaw, pitch and roll.
//!
//! Input: an attitude. Output: angles of the sequence ψ about ζ, ϑ about ξ, γ about η. Time: none.
//! Failure: none; at ϑ = ±90° yaw and roll are not unique and only their sum or difference means something.

use crate::{Vector3, state::Attitude, turn::Turn};

/// cos ϑ below which the nose is vertical: yaw and roll by themselves would be rounding.
const VERTICAL: f64 = 1e-8;

/// Yaw ψ counter-clockwise from above, pitch ϑ nose up, roll γ right side down — Matveev 2025, (22).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Angles {
    /// ψ, rad, (−π, π].
    pub yaw_rad: f64,
    /// ϑ, rad, [−π/2, π/2].
    pub pitch_rad: f64,
    /// γ, rad, (−π, π].
    pub roll_rad: f64,
}

impl Attitude {
    /// From yaw, pitch and roll — Matveev 2025, (22), (26).
    pub fn of_angles(angles: Angles) -> Self {
        let about = |x: f64, y: f64, z: f64| Turn::of_rotation_vector(Vector3::new(x, y, z));
        let turn = about(0.0, 0.0, angles.yaw_rad).then(about(angles.pitch_rad, 0.0, 0.0)).then(about(
            0.0,
            angles.roll_rad,
            0.0,
        ));
        Self::of_quaternion(turn.quaternion())
    }

    /// Matveev 2025, (23)–(25), with the two-argument arctangent; pitch by the arctangent too, exact up to the vertical.
    pub fn angles(self) -> Angles {
        let (u, v) = (self.up.w.re, self.up.w.im);
        let rho = u * u + v * v;
        let sign = self.up.chart.sign();
        let (sin, cos) = libm::sincos(self.z_rad);
        let (east, north) = (1.0 + u * u - v * v, 2.0 * u * v);
        let level = libm::hypot(2.0 * u, 1.0 - rho);
        if level < VERTICAL * (1.0 + rho) {
            // Of the turns that make up yaw and roll only one is left: all of it is yaw, from the first row of A.
            let across = 1.0 - u * u + v * v;
            let yaw_rad = libm::atan2(across * sin - north * cos, across * cos + north * sin);
            return Angles { yaw_rad, pitch_rad: libm::atan2(sign * 2.0 * v, level), roll_rad: 0.0 };
        }
        Angles {
            yaw_rad: libm::atan2(sign * (east * sin + north * cos), sign * (east * cos - north * sin)),
            pitch_rad: libm::atan2(sign * 2.0 * v, level),
            roll_rad: libm::atan2(-2.0 * u, sign * (1.0 - rho)),
        }
    }
}
