//! New magnetometer samples in a sequence that repeats them.
//!
//! Input: the magnetic field at every tick.
//!
//! Output: the magnetic field only at the ticks at which it is new, as a fuser expects it.
//!
//! A magnetometer is slower than a gyro. Recordings and drivers often repeat its newest sample
//! until the next one arrives. A fuser would treat every repetition as a new measurement.

use crate::{Vector3, state_words::StateWords};

/// Filter that removes repeated magnetometer samples.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RepeatFilter {
    previous_ut: Option<Vector3<f64>>,
}

impl RepeatFilter {
    /// Returns the magnetic field (µT), or `None` if it is missing or equal to the previous one.
    pub fn new_sample(&mut self, field_ut: Option<Vector3<f64>>) -> Option<Vector3<f64>> {
        field_ut.filter(|field_ut| self.previous_ut.replace(*field_ut) != Some(*field_ut))
    }
}

impl StateWords for RepeatFilter {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.previous_ut.visit(visit);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_sample_is_removed_across_ticks_without_field() {
        let [a, b] = [Vector3::new(20.0, 0.0, -40.0), Vector3::new(20.0, 0.1, -40.0)].map(Some);
        let mut filter = RepeatFilter::default();
        let found = [a, a, None, a, b, b, a].map(|field_ut| filter.new_sample(field_ut));
        assert_eq!(found, [a, None, None, None, b, None, a]);
    }
}
