//! Single axes that stand still while others live, or that end at their range.

use crate::finding::{self, Finding};

/// Samples that a standing axis needs: the least bit of a quiet sensor may stand for some hundred.
const STANDING_MIN: u64 = 500;
/// Share of the samples that changes an axis that lives: a sensor that is read twice as often as it measures still has it.
const LIVES: f64 = 0.5;
/// Samples at the end of the range, one after the other, that make a run: noise brings the largest value once, and a sensor read twice too often twice.
const RUN: u32 = 3;
/// Runs that a finding needs: one is a blow.
const RUNS_MIN: u32 = 3;

/// The axes of one sensor.
#[derive(Debug, Clone)]
pub(crate) struct Axes {
    quantity: &'static str,
    sensor: &'static str,
    /// No sensor has a range smaller than this.
    range_min: f64,
    last: Option<[f64; 3]>,
    samples: u64,
    changes: [u64; 3],
    ends: [[End; 2]; 3],
}

/// The largest or least value of an axis, and how often it came in runs while the others changed.
#[derive(Debug, Clone, Copy, Default)]
struct End {
    at: f64,
    run: u32,
    runs: u32,
}

impl Axes {
    pub(crate) fn new(quantity: &'static str, sensor: &'static str, range_min: f64) -> Self {
        let ends = [[End::default(); 2]; 3];
        Self { quantity, sensor, range_min, last: None, samples: 0, changes: [0; 3], ends }
    }

    pub(crate) fn take(&mut self, value: [f64; 3]) {
        self.samples += 1;
        let Some(last) = self.last.replace(value) else { return };
        let changed: [bool; 3] = std::array::from_fn(|axis| value[axis] != last[axis]);
        for axis in 0..3 {
            self.changes[axis] += u64::from(changed[axis]);
            let others_live = (0..3).any(|other| other != axis && changed[other]);
            let [low, high] = &mut self.ends[axis];
            low.take(-value[axis], others_live);
            high.take(value[axis], others_live);
        }
    }

    /// What is wrong with them. An axis is dead only where the body `turned`: simulated sensors stand still at rest. Of a sensor whose unit is
    /// wrong the range says nothing.
    pub(crate) fn finding(&self, turned: bool, unit_is_wrong: bool) -> Option<Finding> {
        let lives = self.changes.iter().any(|changes| *changes as f64 >= LIVES * self.samples as f64);
        let standing: Vec<_> = (0..3).filter(|axis| self.changes[*axis] == 0).collect();
        if turned && self.samples >= STANDING_MIN && !standing.is_empty() && (lives || self.last == Some([0.0; 3])) {
            return Some(finding::stuck(self.quantity, self.sensor, &standing, self.samples));
        }
        if unit_is_wrong {
            return None;
        }
        let clipped = (0..3).flat_map(|axis| self.ends[axis].map(|end| (axis, end)));
        let worst = clipped.filter(|(_, end)| end.runs >= RUNS_MIN && end.at > self.range_min);
        let (axis, end) = worst.max_by_key(|(_, end)| end.runs)?;
        Some(finding::clipped(self.quantity, self.sensor, axis, end.at, end.runs))
    }
}

impl End {
    fn take(&mut self, value: f64, others_live: bool) {
        if value > self.at {
            *self = Self { at: value, run: 1, runs: 0 };
        } else if value == self.at && others_live {
            self.run += 1;
            self.runs += u32::from(self.run == RUN);
        } else {
            self.run = 0;
        }
    }
}
