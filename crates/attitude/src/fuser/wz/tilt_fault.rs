//! A tilt fault: the level is wrong, not the vehicle in motion.
//!
//! A wrong level and an acceleration show the same horizontal force. They differ in its length: a body at a steady velocity reads g,
//! however wrong its level, and one that accelerates by a reads √(g² + a²), in a straight line, in a turn that never ends, at any
//! speed. So the innovations are summed while they keep to one side, and once they make a velocity the force's length decides.

use crate::{Complex, GRAVITY_M_S2, numbers::Numbers};

/// The change of velocity that the length of the force is asked about, m/s.
const VELOCITY_M_S: f64 = 8.0;
/// Least horizontal force over g of a level that is begun anew: from there on its square is above the scale error of an
/// accelerometer, and what is less wrong the loop levels by itself.
const FORCE_MIN: f64 = 0.25;
/// How much of the length that an acceleration would add, a²/2g², may be there.
const SHARE_MAX: f64 = 0.5;

/// Sums innovations while they point one way.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TiltFaultMonitor {
    /// ∫ of the innovation, over g, s.
    sum_s: Complex<f64>,
    /// ∫ of the levelled force, over g, and of its length's excess over g, over g, s.
    force_s: Complex<f64>,
    excess_s: f64,
    since_s: f64,
}

impl Default for TiltFaultMonitor {
    fn default() -> Self {
        let zero = Complex::new(0.0, 0.0);
        Self { sum_s: zero, force_s: zero, excess_s: 0.0, since_s: 0.0 }
    }
}

impl TiltFaultMonitor {
    /// An innovation of `interval_s`, with the levelled force and the length of the force, all over g. What the level is wrong by,
    /// rad, if no acceleration is like that.
    pub(super) fn observe(
        &mut self,
        innovation: Complex<f64>,
        force: Complex<f64>,
        length: f64,
        interval_s: f64,
    ) -> Option<Complex<f64>> {
        if innovation.re * self.sum_s.re + innovation.im * self.sum_s.im < 0.0 {
            *self = Self::default();
        }
        self.sum_s += innovation * interval_s;
        self.force_s += force * interval_s;
        self.excess_s += (length - 1.0) * interval_s;
        self.since_s += interval_s;
        let velocity2 = self.sum_s.norm_sqr() * (GRAVITY_M_S2 * GRAVITY_M_S2);
        if velocity2 <= VELOCITY_M_S * VELOCITY_M_S {
            return None;
        }
        let Self { sum_s, force_s, excess_s, since_s } = core::mem::take(self);
        let force2 = force_s.norm_sqr() / (since_s * since_s);
        let level_is_wrong =
            force2 > FORCE_MIN * FORCE_MIN && (excess_s / since_s).abs() < 0.5 * SHARE_MAX * force2.min(1.0);
        level_is_wrong.then(|| sum_s / since_s)
    }

    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        (self.since_s < 0.0).then_some("a time of a tilt fault below zero")
    }
}

impl Numbers for TiltFaultMonitor {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.sum_s.visit(visit);
        self.force_s.visit(visit);
        self.excess_s.visit(visit);
        self.since_s.visit(visit);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INTERVAL_S: f64 = 0.2;

    #[test]
    fn a_wrong_level_is_told_with_its_error() {
        let (mut tilt_fault, wrong_rad) = (TiltFaultMonitor::default(), Complex::new(0.3, -0.4));
        let told = (0..10).find_map(|_| tilt_fault.observe(wrong_rad, wrong_rad, 1.0, INTERVAL_S));
        assert!(told.is_some_and(|told| (told - wrong_rad).norm_sqr() < 1e-20), "{told:?}");
    }

    #[test]
    fn an_acceleration_is_never_doubted_however_long_it_lasts() {
        for acceleration in [0.1, 0.3, 0.8, 2.0] {
            let (mut tilt_fault, force) = (TiltFaultMonitor::default(), Complex::new(0.0, acceleration));
            let told =
                (0..10_000).find_map(|_| tilt_fault.observe(force, force, f64::hypot(1.0, acceleration), INTERVAL_S));
            assert_eq!(told, None, "{acceleration} g");
        }
    }

    #[test]
    fn accelerations_that_end_in_no_velocity_are_never_doubted() {
        let mut tilt_fault = TiltFaultMonitor::default();
        for i in 0..10_000 {
            let force = Complex::new(if i / 5 % 2 == 0 { 0.7 } else { -0.7 }, 0.1);
            assert_eq!(tilt_fault.observe(force, force, 1.0, INTERVAL_S), None, "{i}");
        }
    }
}
