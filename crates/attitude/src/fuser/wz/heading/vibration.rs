//! Vibration detector. Vibration appears as changes of the force from sample to sample, beyond a
//! steady trend.

use crate::scalars::scalars;

/// Threshold above which a body counts as vibrating, m/s².
///
/// The threshold applies to the RMS of the second difference of the force's norm.
///
/// With BROAD's sensor at 286 Hz, the RMS is 1.7 m/s² for a vibrating phone and less than 0.4 m/s²
/// for any movement.
const VIBRATION_THRESHOLD_M_S2: f64 = 1.2;

/// Sum of squared second differences over an interval.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct VibrationDetector {
    /// Norms of the last two forces, newest first, m/s².
    last_norms_m_s2: [f64; 2],
    square_m2_s4: f64,
    samples: f64,
}

impl VibrationDetector {
    /// Processes one sample.
    #[inline]
    pub(super) fn observe(&mut self, norm_m_s2: f64) {
        let [last, second] = self.last_norms_m_s2;
        let second_difference = norm_m_s2 - 2.0 * last + second;
        self.square_m2_s4 += second_difference * second_difference;
        self.samples += 1.0;
        self.last_norms_m_s2 = [norm_m_s2, last];
    }

    /// Ends the interval. Returns `true` if the body vibrated during it.
    pub(super) fn end_interval(&mut self) -> bool {
        let (square, samples) = (core::mem::take(&mut self.square_m2_s4), core::mem::take(&mut self.samples));
        square > VIBRATION_THRESHOLD_M_S2 * VIBRATION_THRESHOLD_M_S2 * samples
    }

    /// Returns the reason why the state is invalid, or `None` if it is valid.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        (self.square_m2_s4 < 0.0 || self.samples < 0.0).then_some("a sum of squares or count below zero")
    }
}

scalars!(VibrationDetector: last_norms_m_s2, square_m2_s4, samples);
