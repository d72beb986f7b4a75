//! Doubt: the innovations have pointed one way for longer than any acceleration can.
//!
//! An acceleration ends in a velocity, and velocities are bounded; a wrong level shows the same horizontal force for as long as it
//! is wrong. So the innovations are summed while they keep to one side, and the sum is held against a change of velocity.

use crate::{Complex, GRAVITY_M_S2, stage::Numbers};

/// Largest change of velocity that is taken for one, m/s: a vehicle that comes to speed in a town.
const VELOCITY_MAX_M_S: f64 = 8.0;

/// Sums innovations while they point one way.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Doubt {
    /// ∫ of the innovation, over g, s.
    sum_s: Complex<f64>,
    since_s: f64,
}

impl Default for Doubt {
    fn default() -> Self {
        Self { sum_s: Complex::new(0.0, 0.0), since_s: 0.0 }
    }
}

impl Doubt {
    /// An innovation, over g, of `interval_s`. What the level is wrong by, rad, if no acceleration is like that.
    pub(super) fn saw(&mut self, innovation: Complex<f64>, interval_s: f64) -> Option<Complex<f64>> {
        if innovation.re * self.sum_s.re + innovation.im * self.sum_s.im < 0.0 {
            *self = Self::default();
        }
        self.sum_s += innovation * interval_s;
        self.since_s += interval_s;
        let velocity2 = self.sum_s.norm_sqr() * (GRAVITY_M_S2 * GRAVITY_M_S2);
        if velocity2 <= VELOCITY_MAX_M_S * VELOCITY_MAX_M_S {
            return None;
        }
        let Self { sum_s, since_s } = core::mem::take(self);
        Some(sum_s / since_s)
    }

    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        (self.since_s < 0.0).then_some("a time of doubt below zero")
    }
}

impl Numbers for Doubt {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.sum_s.visit(visit);
        self.since_s.visit(visit);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INTERVAL_S: f64 = 0.2;

    #[test]
    fn a_wrong_level_is_told_with_its_error() {
        let (mut doubt, wrong_rad) = (Doubt::default(), Complex::new(0.3, -0.4));
        let told = (0..10).find_map(|_| doubt.saw(wrong_rad, INTERVAL_S));
        assert!(told.is_some_and(|told| (told - wrong_rad).norm_sqr() < 1e-20), "{told:?}");
    }

    #[test]
    fn accelerations_that_end_in_no_velocity_are_never_doubted() {
        let mut doubt = Doubt::default();
        for i in 0..10_000 {
            let sign = if i / 5 % 2 == 0 { 0.7 } else { -0.7 };
            assert_eq!(doubt.saw(Complex::new(sign, 0.1), INTERVAL_S), None, "{i}");
        }
    }
}
