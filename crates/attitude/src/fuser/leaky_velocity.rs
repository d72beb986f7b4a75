//! The velocity by which a levelling loop leans, as one fuser hands it over to the next.
//!
//! V' = h − V/T, h the horizontal specific force, T 1.5 s in `vqf` and 3 s in `wz`: the accelerations of the last seconds, by which the loop
//! moves its level. A loop that begins without it takes the braking that ends a movement for a tilt.

use crate::{Complex, numbers::Numbers};

/// More than a loop gathers on a body that moves to and fro, m/s; whoever gathers more has lost its level.
const MOST_M_S: f64 = 100.0;
/// The most that is handed over, m/s: less than that, for a turn of the frame rounds.
const MOST_GIVEN_M_S: f64 = 99.0;
/// Standard deviation of what a loop gathers, m/s: a level that has been off by 2° for some seconds.
const SD_M_S: f64 = 1.0;
/// The same where nobody has it, m/s: a loop's memory of a vehicle that brakes.
const UNKNOWN_SD_M_S: f64 = 4.0;

/// The leaky velocity of a levelling loop, and how well it is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LeakyVelocity {
    /// m/s; east and north of the attitude's reference frame, as ξ + jη.
    pub velocity_m_s: Complex<f64>,
    /// Standard deviation of each of its components, m/s; infinite where nobody has it.
    pub sd_m_s: f64,
}

impl LeakyVelocity {
    /// Nobody has it.
    pub const UNKNOWN: Self = Self { velocity_m_s: Complex::new(0.0, 0.0), sd_m_s: f64::INFINITY };

    /// As a loop has it, of whose first velocity this deviation is left; unknown where no body moves like that.
    pub(super) fn of_loop(velocity_m_s: Complex<f64>, left_sd_m_s: f64) -> Self {
        // The comparison also refuses what is not a number.
        if velocity_m_s.norm_sqr() <= MOST_GIVEN_M_S * MOST_GIVEN_M_S {
            Self { velocity_m_s, sd_m_s: libm::hypot(SD_M_S, left_sd_m_s) }
        } else {
            Self::UNKNOWN
        }
    }

    /// With what a loop begins, m/s: nothing where nobody has it.
    pub(super) fn first_m_s(&self) -> Complex<f64> {
        if self.sd_m_s.is_finite() { self.velocity_m_s } else { Self::UNKNOWN.velocity_m_s }
    }

    /// Standard deviation of that, m/s.
    pub(super) fn first_sd_m_s(&self) -> f64 {
        self.sd_m_s.min(UNKNOWN_SD_M_S)
    }

    /// The same in a reference frame from which this one is turned by the angle.
    pub(super) fn turned(self, angle_rad: f64) -> Self {
        let (sin, cos) = libm::sincos(angle_rad);
        Self { velocity_m_s: self.velocity_m_s * Complex::new(cos, sin), ..self }
    }

    /// What is wrong with it.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        let possible = self.velocity_m_s.norm_sqr() <= MOST_M_S * MOST_M_S;
        let allowed = self.sd_m_s >= 0.0;
        let flaw = (!possible).then_some("a velocity that no loop gathers");
        flaw.or((!allowed).then_some("a standard deviation below zero"))
    }
}

impl Default for LeakyVelocity {
    fn default() -> Self {
        Self::UNKNOWN
    }
}

/// An infinite standard deviation stays one.
impl Numbers for LeakyVelocity {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.velocity_m_s.visit(visit);
        self.sd_m_s.visit(visit);
    }
}
