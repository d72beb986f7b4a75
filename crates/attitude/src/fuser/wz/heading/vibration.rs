//! Vibration: what the force changes by from sample to sample, beyond a change that goes on.

use crate::numbers::Numbers;

/// Root mean square of the second difference of the force's length from which on a body vibrates, m/s². Of BROAD's sensor at 286 Hz, of
/// which a phone that vibrates reads 1.7 and every movement less than 0.4.
const SHAKEN_M_S2: f64 = 1.2;

/// Sums second differences over an interval.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Vibration {
    /// The last force's length and the one before, m/s².
    before_m_s2: [f64; 2],
    square_m2_s4: f64,
    samples: f64,
}

impl Vibration {
    /// One sample.
    #[inline]
    pub(super) fn observe(&mut self, norm_m_s2: f64) {
        let [last, second] = self.before_m_s2;
        let bend = norm_m_s2 - 2.0 * last + second;
        self.square_m2_s4 += bend * bend;
        self.samples += 1.0;
        self.before_m_s2 = [norm_m_s2, last];
    }

    /// The interval is over; the body vibrated in it.
    pub(super) fn take(&mut self) -> bool {
        let (square, samples) = (core::mem::take(&mut self.square_m2_s4), core::mem::take(&mut self.samples));
        square > SHAKEN_M_S2 * SHAKEN_M_S2 * samples
    }

    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        (self.square_m2_s4 < 0.0 || self.samples < 0.0).then_some("a vibration below zero")
    }
}

impl Numbers for Vibration {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.before_m_s2.iter_mut().for_each(&mut *visit);
        self.square_m2_s4.visit(visit);
        self.samples.visit(visit);
    }
}
