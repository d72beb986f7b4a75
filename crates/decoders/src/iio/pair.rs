//! A chip that is two devices: the records of its gyro and of its accelerometer.
//!
//! Input: bytes of either character device, as they come. Output: a measurement for each record of the gyro, with the force on the line
//! between the two records of the accelerometer around it, as far as they are close; else with the one that is. Time: the stamp of the
//! gyro's record; both devices have one clock. A record of the gyro waits for the force behind it, [`WAIT_MAX_NS`] of the gyro's time
//! at most. Failure: a rate without a force is counted as refused; where a clock steps back, both begin anew.

use std::collections::VecDeque;

use super::{IioError, Layout, records::Sample};
use crate::{Counts, Measurement, Value};

/// How much later records of the gyro may come before one goes without the force behind it, ns.
pub const WAIT_MAX_NS: u64 = 200_000_000;
/// From a rate to a force that is used for it, and between two forces with a rate between them, at most, ns.
pub const GAP_MAX_NS: u64 = 100_000_000;
/// Of records that wait, of each device.
const RECORDS_MAX: usize = 8192;

/// Both devices.
#[derive(Debug, Clone)]
pub struct Pair {
    gyro: Records,
    accel: Records,
    rates: VecDeque<(u64, Sample)>,
    forces: VecDeque<(u64, [f64; 3])>,
    counts: Counts,
}

impl Pair {
    /// Of these layouts: the gyro's has a rate, the accelerometer's a force, both a time.
    pub fn new(gyro: Layout, accel: Layout) -> Result<Self, IioError> {
        let missing = |missing| Err(IioError::Missing { missing });
        match (&gyro, &accel) {
            (Layout { rate: None, .. }, _) => missing("in_anglvel"),
            (_, Layout { force: None, .. }) => missing("in_accel"),
            (Layout { time: None, .. }, _) | (_, Layout { time: None, .. }) => missing("in_timestamp"),
            _ if gyro.clock != accel.clock => Err(IioError::Clocks { gyro: gyro.clock, accel: accel.clock }),
            _ => Ok(Self {
                gyro: Records::new(gyro),
                accel: Records::new(accel),
                rates: VecDeque::new(),
                forces: VecDeque::new(),
                counts: Counts::default(),
            }),
        }
    }

    /// Takes the next bytes of the gyro, and adds what is complete.
    pub fn push_gyro(&mut self, bytes: &[u8], found: &mut Vec<Measurement>) {
        for sample in self.gyro.push(bytes) {
            self.counts.frames += 1;
            let Some(now_ns) = sample.now_ns else {
                self.counts.refused += 1;
                continue;
            };
            let last_ns = self.rates.back().map(|(last_ns, _)| *last_ns);
            if !self.is_later(now_ns, last_ns) {
                continue;
            }
            if self.rates.len() == RECORDS_MAX {
                self.rates.pop_front();
                self.counts.refused += 1;
            }
            self.rates.push_back((now_ns, sample));
            self.settle(found);
        }
    }

    /// Takes the next bytes of the accelerometer, and adds what is complete.
    pub fn push_accel(&mut self, bytes: &[u8], found: &mut Vec<Measurement>) {
        for sample in self.accel.push(bytes) {
            self.counts.frames += 1;
            let (Some(now_ns), Some(force_m_s2)) = (sample.now_ns, sample.force_m_s2) else {
                self.counts.refused += 1;
                continue;
            };
            let last_ns = self.forces.back().map(|(last_ns, _)| *last_ns);
            if !self.is_later(now_ns, last_ns) {
                continue;
            }
            if self.forces.len() == RECORDS_MAX {
                self.forces.pop_front();
            }
            self.forces.push_back((now_ns, force_m_s2));
            self.settle(found);
        }
    }

    /// What both have sent so far.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Whether a record is to be used: not if it has the time of the one before it. One before that begins anew.
    fn is_later(&mut self, now_ns: u64, last_ns: Option<u64>) -> bool {
        let Some(last_ns) = last_ns.filter(|last_ns| now_ns <= *last_ns) else { return true };
        if now_ns == last_ns {
            self.counts.refused += 1;
            return false;
        }
        self.counts.refused += self.rates.len() as u64;
        self.rates.clear();
        self.forces.clear();
        true
    }

    /// Hands the rates over whose force is known, or does not come.
    fn settle(&mut self, found: &mut Vec<Measurement>) {
        while let (Some((now_ns, sample)), Some((newest_ns, _))) = (self.rates.front(), self.rates.back()) {
            let force = match self.force_at(*now_ns) {
                Force::Here(force_m_s2) => Some(force_m_s2),
                Force::Behind if newest_ns - now_ns <= WAIT_MAX_NS => return,
                Force::Behind => {
                    self.forces.back().filter(|(t_ns, _)| t_ns.abs_diff(*now_ns) <= GAP_MAX_NS).map(|near| near.1)
                }
                Force::Nowhere => None,
            };
            match sample.rate_rad_s.zip(force) {
                Some((rate_rad_s, force_m_s2)) => found.push(Measurement {
                    time: Some(self.gyro.layout.clock.time(*now_ns)),
                    value: Value::Imu { rate_rad_s, force_m_s2, field_ut: sample.field_ut },
                }),
                None => self.counts.refused += 1,
            }
            self.rates.pop_front();
            self.forget();
        }
    }

    fn force_at(&self, now_ns: u64) -> Force {
        let behind = self.forces.partition_point(|(t_ns, _)| *t_ns < now_ns);
        let before = behind.checked_sub(1).and_then(|before| self.forces.get(before));
        let Some((after_ns, after)) = self.forces.get(behind) else { return Force::Behind };
        let near = |&(t_ns, force): &(u64, [f64; 3])| (t_ns.abs_diff(now_ns) <= GAP_MAX_NS).then_some((t_ns, force));
        let force = match before {
            Some((before_ns, before)) if after_ns - before_ns <= GAP_MAX_NS => {
                let part = (now_ns - before_ns) as f64 / (after_ns - before_ns) as f64;
                Some([0, 1, 2].map(|axis| before[axis] + part * (after[axis] - before[axis])))
            }
            before => {
                let both = [before.and_then(near), near(&(*after_ns, *after))];
                both.into_iter().flatten().min_by_key(|(t_ns, _)| t_ns.abs_diff(now_ns)).map(|(_, force)| force)
            }
        };
        force.map_or(Force::Nowhere, Force::Here)
    }

    /// Forces before the last one that is not after the rate to come are for none.
    fn forget(&mut self) {
        let Some((now_ns, _)) = self.rates.front() else { return };
        while self.forces.get(1).is_some_and(|(t_ns, _)| t_ns <= now_ns) {
            self.forces.pop_front();
        }
    }
}

enum Force {
    Here([f64; 3]),
    /// No force after the rate has come yet.
    Behind,
    /// None is close.
    Nowhere,
}

/// The bytes of one device.
#[derive(Debug, Clone)]
struct Records {
    layout: Layout,
    kept: Vec<u8>,
}

impl Records {
    fn new(layout: Layout) -> Self {
        Self { layout, kept: Vec::new() }
    }

    fn push(&mut self, bytes: &[u8]) -> Vec<Sample> {
        self.kept.extend_from_slice(bytes);
        let size = self.layout.record_bytes.max(1);
        let records = self.kept.chunks_exact(size);
        let rest = records.remainder().to_vec();
        let samples = records.map(|record| self.layout.sample(record)).collect();
        self.kept = rest;
        samples
    }
}
