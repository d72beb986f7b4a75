//! Combines the gyro and accelerometer records of a chip that appears as two devices.
//!
//! Input: bytes of both character devices, interleaved in any way.
//!
//! Output: a measurement per gyro record. Its force is interpolated between the two surrounding
//! accelerometer records if they are close to each other in time. Otherwise it is taken from the
//! nearest record.
//!
//! Time: the timestamp of the gyro record. Both devices use the same clock. A gyro record is held
//! until a later force arrives, for at most [`MAX_WAIT_NS`] on the gyro's clock.
//!
//! Failure: a rate without a force is counted as rejected. If either clock steps back, both queues
//! are cleared.

use std::collections::VecDeque;

use super::{IioError, Layout, records::Sample};
use crate::{Counts, Measurement, Value};

/// Maximum time for which a gyro record waits for a later force, ns. It is measured on the gyro's
/// clock.
pub const MAX_WAIT_NS: u64 = 200_000_000;
/// Longest interval between two forces that are interpolated, ns. If the interval is longer, the
/// nearest force is used, provided that it is at most this far from the rate.
pub const MAX_GAP_NS: u64 = 100_000_000;
/// Maximum number of queued records per device.
const MAX_QUEUED_RECORDS: usize = 8192;

/// Combined decoder of a gyro device and an accelerometer device.
#[derive(Debug, Clone)]
pub struct DevicePair {
    gyro: RecordBuffer,
    accel: RecordBuffer,
    rates: VecDeque<(u64, Sample)>,
    forces: VecDeque<(u64, [f64; 3])>,
    counts: Counts,
}

impl DevicePair {
    /// Creates a decoder for a gyro and an accelerometer with the given record layouts.
    ///
    /// # Errors
    ///
    /// Returns an error if the rate, the force or a timestamp is missing, or if the clocks differ.
    pub fn new(gyro: Layout, accel: Layout) -> Result<Self, IioError> {
        let missing = |missing| Err(IioError::MissingChannels { missing });
        match (&gyro, &accel) {
            (Layout { rate: None, .. }, _) => missing("in_anglvel"),
            (_, Layout { force: None, .. }) => missing("in_accel"),
            (Layout { time: None, .. }, _) | (_, Layout { time: None, .. }) => missing("in_timestamp"),
            _ if gyro.clock != accel.clock => Err(IioError::ClockMismatch { gyro: gyro.clock, accel: accel.clock }),
            _ => Ok(Self {
                gyro: RecordBuffer::new(gyro),
                accel: RecordBuffer::new(accel),
                rates: VecDeque::new(),
                forces: VecDeque::new(),
                counts: Counts::default(),
            }),
        }
    }

    /// Decodes bytes of the gyro and appends the completed measurements.
    pub fn push_gyro(&mut self, bytes: &[u8], measurements: &mut Vec<Measurement>) {
        for sample in self.gyro.push(bytes) {
            self.counts.frames += 1;
            let Some(now_ns) = sample.now_ns else {
                self.counts.rejected += 1;
                continue;
            };
            let last_ns = self.rates.back().map(|(last_ns, _)| *last_ns);
            if !self.check_order(now_ns, last_ns) {
                continue;
            }
            if self.rates.len() == MAX_QUEUED_RECORDS {
                self.rates.pop_front();
                self.counts.rejected += 1;
            }
            self.rates.push_back((now_ns, sample));
            self.emit_ready(measurements);
        }
    }

    /// Decodes bytes of the accelerometer and appends the completed measurements.
    pub fn push_accel(&mut self, bytes: &[u8], measurements: &mut Vec<Measurement>) {
        for sample in self.accel.push(bytes) {
            self.counts.frames += 1;
            let (Some(now_ns), Some(force_m_s2)) = (sample.now_ns, sample.force_m_s2) else {
                self.counts.rejected += 1;
                continue;
            };
            let last_ns = self.forces.back().map(|(last_ns, _)| *last_ns);
            if !self.check_order(now_ns, last_ns) {
                continue;
            }
            if self.forces.len() == MAX_QUEUED_RECORDS {
                self.forces.pop_front();
            }
            self.forces.push_back((now_ns, force_m_s2));
            self.emit_ready(measurements);
        }
    }

    /// Returns the totals of both devices.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Returns `false` and rejects the record if it has the same timestamp as its predecessor.
    ///
    /// An earlier timestamp means that the clock was reset. Both queues are then cleared.
    fn check_order(&mut self, now_ns: u64, last_ns: Option<u64>) -> bool {
        let Some(last_ns) = last_ns.filter(|last_ns| now_ns <= *last_ns) else { return true };
        if now_ns == last_ns {
            self.counts.rejected += 1;
            return false;
        }
        self.counts.rejected += self.rates.len() as u64;
        self.rates.clear();
        self.forces.clear();
        true
    }

    /// Emits a measurement for each queued rate with a known force, and rejects rates for which no
    /// force can arrive any more.
    fn emit_ready(&mut self, measurements: &mut Vec<Measurement>) {
        while let (Some((now_ns, sample)), Some((newest_ns, _))) = (self.rates.front(), self.rates.back()) {
            let force = match self.force_at(*now_ns) {
                Force::Known(force_m_s2) => Some(force_m_s2),
                Force::Pending if newest_ns - now_ns <= MAX_WAIT_NS => return,
                Force::Pending => {
                    self.forces.back().filter(|(t_ns, _)| t_ns.abs_diff(*now_ns) <= MAX_GAP_NS).map(|nearest| nearest.1)
                }
                Force::Missing => None,
            };
            match sample.rate_rad_s.zip(force) {
                Some((rate_rad_s, force_m_s2)) => measurements.push(Measurement {
                    time: Some(self.gyro.layout.clock.device_time(*now_ns)),
                    value: Value::Imu { rate_rad_s, force_m_s2, field_ut: sample.field_ut },
                }),
                None => self.counts.rejected += 1,
            }
            self.rates.pop_front();
            self.discard_old_forces();
        }
    }

    fn force_at(&self, now_ns: u64) -> Force {
        let after_index = self.forces.partition_point(|(t_ns, _)| *t_ns < now_ns);
        let before = after_index.checked_sub(1).and_then(|index| self.forces.get(index));
        let Some((after_ns, after)) = self.forces.get(after_index) else { return Force::Pending };
        let if_close =
            |&(t_ns, force): &(u64, [f64; 3])| (t_ns.abs_diff(now_ns) <= MAX_GAP_NS).then_some((t_ns, force));
        let force = match before {
            Some((before_ns, before)) if after_ns - before_ns <= MAX_GAP_NS => {
                let fraction = (now_ns - before_ns) as f64 / (after_ns - before_ns) as f64;
                Some([0, 1, 2].map(|axis| before[axis] + fraction * (after[axis] - before[axis])))
            }
            before => {
                let both = [before.and_then(if_close), if_close(&(*after_ns, *after))];
                both.into_iter().flatten().min_by_key(|(t_ns, _)| t_ns.abs_diff(now_ns)).map(|(_, force)| force)
            }
        };
        force.map_or(Force::Missing, Force::Known)
    }

    /// Discards the forces that are too old for the oldest queued rate.
    fn discard_old_forces(&mut self) {
        let Some((now_ns, _)) = self.rates.front() else { return };
        while self.forces.get(1).is_some_and(|(t_ns, _)| t_ns <= now_ns) {
            self.forces.pop_front();
        }
    }
}

/// Result of the search for the force at the time of a rate.
enum Force {
    Known([f64; 3]),
    /// No later force has arrived yet.
    Pending,
    /// No force is close enough in time.
    Missing,
}

/// Splits the byte stream of one device into records.
#[derive(Debug, Clone)]
struct RecordBuffer {
    layout: Layout,
    buffer: Vec<u8>,
}

impl RecordBuffer {
    fn new(layout: Layout) -> Self {
        Self { layout, buffer: Vec::new() }
    }

    fn push(&mut self, bytes: &[u8]) -> Vec<Sample> {
        self.buffer.extend_from_slice(bytes);
        let record_bytes = self.layout.record_bytes.max(1);
        let records = self.buffer.chunks_exact(record_bytes);
        let remainder = records.remainder().to_vec();
        let samples = records.map(|record| self.layout.decode(record)).collect();
        self.buffer = remainder;
        samples
    }
}
