//! Leaky velocity of a levelling loop, as handed over from one fuser to another.
//!
//! V' = h − V/T, where h is the horizontal specific force and T is 1.5 s in `vqf` and 2 s in `wz`.
//! V summarises the accelerations of the last seconds. The loop tilts its level at a rate
//! proportional to V. If V is not handed over, the new loop mistakes the braking at the end of a
//! movement for a tilt.

use crate::{Complex, scalars::scalars};

/// Largest velocity that is accepted, m/s. A loop with a larger velocity has lost its level.
const MAX_VELOCITY_M_S: f64 = 100.0;
/// Largest velocity that is handed over, m/s. It is below [`MAX_VELOCITY_M_S`], because rounding
/// during a rotation of the frame can increase the velocity.
const MAX_HANDED_OVER_M_S: f64 = 99.0;
/// Standard deviation of a loop's velocity, m/s. It corresponds to a level that was wrong by 2° for
/// a few seconds.
const SD_M_S: f64 = 1.0;
/// Standard deviation of an unknown velocity, m/s: the typical leaky velocity of a braking vehicle.
const UNKNOWN_SD_M_S: f64 = 4.0;

/// Leaky integral of the horizontal specific force in a levelling loop, with its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LeakyVelocity {
    /// Velocity along east and north of the attitude's reference frame, as ξ + jη, m/s.
    pub velocity_m_s: Complex<f64>,
    /// Standard deviation of each component, m/s; infinite if unknown.
    pub sd_m_s: f64,
}

impl LeakyVelocity {
    /// Unknown velocity: zero, with an infinite standard deviation.
    pub const UNKNOWN: Self = Self { velocity_m_s: Complex::new(0.0, 0.0), sd_m_s: f64::INFINITY };

    /// Creates the value from a loop's velocity.
    ///
    /// `remaining_sd_m_s` is the standard deviation of the error that remains from the loop's
    /// initial velocity. The result is unknown if the velocity is implausible.
    pub(super) fn from_loop(velocity_m_s: Complex<f64>, remaining_sd_m_s: f64) -> Self {
        // The comparison also rejects NaN.
        if velocity_m_s.norm_sqr() <= MAX_HANDED_OVER_M_S * MAX_HANDED_OVER_M_S {
            Self { velocity_m_s, sd_m_s: libm::hypot(SD_M_S, remaining_sd_m_s) }
        } else {
            Self::UNKNOWN
        }
    }

    /// Returns the velocity with which a loop starts, m/s; zero if unknown.
    pub(super) fn initial_m_s(&self) -> Complex<f64> {
        if self.sd_m_s.is_finite() { self.velocity_m_s } else { Self::UNKNOWN.velocity_m_s }
    }

    /// Returns the standard deviation of the initial velocity, m/s.
    pub(super) fn initial_sd_m_s(&self) -> f64 {
        self.sd_m_s.min(UNKNOWN_SD_M_S)
    }

    /// Returns the velocity in the axes of another frame. Rotating the axes of that frame by
    /// `angle_rad` gives the present axes.
    pub(super) fn rotated(self, angle_rad: f64) -> Self {
        let (sin, cos) = libm::sincos(angle_rad);
        Self { velocity_m_s: self.velocity_m_s * Complex::new(cos, sin), ..self }
    }

    /// Returns the reason why the value is invalid, or `None` if it is valid.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        let valid_velocity = self.velocity_m_s.norm_sqr() <= MAX_VELOCITY_M_S * MAX_VELOCITY_M_S;
        let valid_sd = self.sd_m_s >= 0.0;
        let error = (!valid_velocity).then_some("a leaky velocity above 100 m/s");
        error.or((!valid_sd).then_some("a standard deviation below zero"))
    }
}

impl Default for LeakyVelocity {
    fn default() -> Self {
        Self::UNKNOWN
    }
}

// An infinite standard deviation, which means "unknown", is visited unchanged.
scalars!(LeakyVelocity: velocity_m_s, sd_m_s);
