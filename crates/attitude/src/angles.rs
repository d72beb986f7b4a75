//! Yaw, pitch and roll.
//!
//! Input: an attitude.
//!
//! Output: angles of the sequence ψ about ζ, ϑ about ξ, γ about η.
//!
//! Failure: at ϑ = ±90° yaw and roll are not unique; only their sum or difference is meaningful.

use crate::{Vector3, rotation::Rotation, scalars::scalars, state::Attitude};

/// Smallest cos ϑ at which yaw and roll are computed separately. Below it, both would consist of
/// rounding errors.
const MIN_PITCH_COSINE: f64 = 1e-8;

/// Yaw ψ counter-clockwise from above, pitch ϑ nose up and roll γ right side down — Matveev 2025,
/// (22).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Angles {
    /// Yaw ψ, counter-clockwise from above, rad, (−π, π].
    pub yaw_rad: f64,
    /// Pitch ϑ, nose up, rad, [−π/2, π/2].
    pub pitch_rad: f64,
    /// Roll γ, right side down, rad, (−π, π].
    pub roll_rad: f64,
}

scalars!(Angles: yaw_rad, pitch_rad, roll_rad);

impl Attitude {
    /// Creates the attitude from yaw, pitch and roll — Matveev 2025, (22), (26).
    pub fn from_angles(angles: Angles) -> Self {
        let about = |x: f64, y: f64, z: f64| Rotation::from_rotation_vector(Vector3::new(x, y, z));
        let rotation = about(0.0, 0.0, angles.yaw_rad).then(about(angles.pitch_rad, 0.0, 0.0)).then(about(
            0.0,
            angles.roll_rad,
            0.0,
        ));
        Self::from_quaternion(rotation.quaternion())
    }

    /// Returns yaw, pitch and roll — Matveev 2025, (23)–(25), with the two-argument arctangent.
    ///
    /// Pitch is also computed with the arctangent, which stays exact up to the vertical.
    #[inline]
    pub fn angles(self) -> Angles {
        let (u, v) = (self.up.w.re, self.up.w.im);
        let rho = u * u + v * v;
        let sign = self.up.chart.sign();
        let (sin, cos) = libm::sincos(self.z_rad);
        let (east, north) = (1.0 + u * u - v * v, 2.0 * u * v);
        let level = libm::hypot(2.0 * u, 1.0 - rho);
        if level < MIN_PITCH_COSINE * (1.0 + rho) {
            // Only the sum or the difference of yaw and roll is defined. It is computed from the
            // first row of the direction cosine matrix A and assigned to yaw; roll is set to 0.
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
