//! State of a sensor over a log: whether it works, and its rate.
//!
//! Input: the samples of one sensor in file order.
//!
//! Output: the [`Sensor`] of the summary, and whether the sensor is chosen by default.

use foreign::ForeignText;

use crate::{
    Sensor,
    timeline::{Segment, SegmentFinder},
};

/// Minimum number of equal samples at which a sensor is considered dead.
const MIN_CONSTANT_SAMPLES: u64 = 50;

/// State of one sensor, computed from its samples.
#[derive(Debug, Clone, Default)]
pub(crate) struct SensorState {
    /// Number of samples.
    pub(crate) samples: u64,
    /// Number of samples that the log marks as unhealthy.
    unhealthy: u64,
    /// First value of each vector of the sensor.
    first: [Option<[f64; 3]>; 2],
    /// For each vector, `true` if a sample differs from the first one.
    varies: [bool; 2],
    /// `true` if equal samples are normal, as for a receiver at rest.
    may_be_constant: bool,
    pub(crate) segments: SegmentFinder,
}

impl SensorState {
    /// Creates the state of a receiver. Its samples may all be equal.
    pub(crate) fn of_receiver() -> Self {
        Self { may_be_constant: true, ..Self::default() }
    }

    /// Adds a sample. A vector that the sensor does not measure is `None`.
    pub(crate) fn push(&mut self, t_ns: i64, values: [Option<[f64; 3]>; 2], is_healthy: bool) {
        self.samples += 1;
        self.unhealthy += u64::from(!is_healthy);
        for ((value, first), varies) in values.into_iter().zip(&mut self.first).zip(&mut self.varies) {
            if let Some(value) = value {
                // Compares the bits, because NaN differs from itself.
                let bits = |vector: [f64; 3]| vector.map(f64::to_bits);
                *varies |= bits(*first.get_or_insert(value)) != bits(value);
            }
        }
        self.segments.push(t_ns);
    }

    /// Returns `true` if the sensor works: each of its vectors varies, and at most half of its
    /// samples are marked as unhealthy.
    pub(crate) fn is_healthy(&self) -> bool {
        self.samples > 0 && self.problem().is_none()
    }

    /// Returns the reason why the sensor does not work.
    pub(crate) fn problem(&self) -> Option<&'static str> {
        let mut vectors = self.first.iter().zip(self.varies);
        let is_constant = !self.may_be_constant
            && self.samples >= MIN_CONSTANT_SAMPLES
            && vectors.any(|(first, varies)| first.is_some() && !varies);
        match (is_constant, 2 * self.unhealthy > self.samples) {
            (true, _) => Some("dead: constant"),
            (_, true) => Some("unhealthy: marked so in the log"),
            _ => None,
        }
    }

    /// Returns the entry of the summary. `option` is the name of the option that chooses the
    /// sensor by its `number`.
    pub(crate) fn sensor(&self, option: &str, number: usize, name: impl Into<ForeignText>, is_read: bool) -> Sensor {
        let duration_s = self.segments.segments().iter().map(Segment::duration_s).sum::<f64>();
        Sensor {
            option: format!("{option} {number}"),
            name: name.into(),
            samples: self.samples,
            rate_hz: self.samples.saturating_sub(1) as f64 / duration_s,
            state: self.problem().unwrap_or("healthy"),
            is_read,
        }
    }
}
