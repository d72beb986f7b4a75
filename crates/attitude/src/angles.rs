//! Yaw, pitch and roll.
//!
//! Input: an attitude. Output: angles of the sequence ψ about ζ, ϑ about ξ, γ about η. Time: none.
//! Failure: none; at ϑ = ±90° yaw and roll are not unique and only their sum or difference means something.

use core::f64::consts::{PI, TAU};

use crate::state::Attitude;

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
    /// Matveev 2025, (23)–(25), with the two-argument arctangent; pitch by the arctangent too, exact up to the vertical.
    pub fn angles(self) -> Angles {
        let (u, v) = (self.up.w.re, self.up.w.im);
        let rho = u * u + v * v;
        let sign = self.up.chart.sign();
        let (sin, cos) = libm::sincos(self.z_rad);
        let (east, north) = (1.0 + u * u - v * v, 2.0 * u * v);
        Angles {
            yaw_rad: libm::atan2(sign * (east * sin + north * cos), sign * (east * cos - north * sin)),
            pitch_rad: libm::atan2(sign * 2.0 * v, libm::hypot(2.0 * u, 1.0 - rho)),
            roll_rad: libm::atan2(-2.0 * u, sign * (1.0 - rho)),
        }
    }
}

/// The same angle in (−π, π].
pub fn wrapped_rad(angle_rad: f64) -> f64 {
    if angle_rad > -PI && angle_rad <= PI {
        return angle_rad;
    }
    let wrapped = angle_rad - TAU * libm::rint(angle_rad / TAU);
    if wrapped <= -PI { wrapped + TAU } else { wrapped }
}
