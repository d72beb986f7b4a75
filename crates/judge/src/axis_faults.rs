//! Detection of axes that are stuck while others change, or that are clipped at the limit of their
//! range.

use crate::diagnosis::{self, Diagnosis};

/// Minimum number of samples before an axis counts as stuck. The lowest bit of a quiet sensor can
/// stay constant for a few hundred samples.
const MIN_STUCK_SAMPLES: u64 = 500;
/// Minimum share of samples in which the value of an active axis changes. A sensor read at twice
/// its sample rate still reaches this share.
const ACTIVE_SHARE: f64 = 0.5;
/// Number of consecutive samples at the extreme value that count as a run. Noise reaches the
/// extreme in only one sample, or in two if the sensor is read at twice its rate.
const RUN_LENGTH: u32 = 3;
/// Minimum number of runs at the extreme value for a diagnosis. A shock causes only one.
const MIN_RUNS: u32 = 3;

/// Monitor of the three axes of one sensor.
#[derive(Debug, Clone)]
pub(crate) struct AxisMonitor {
    quantity: &'static str,
    sensor: &'static str,
    /// Smallest measuring range of any sensor of this kind, in the unit of the samples.
    min_range: f64,
    last: Option<[f64; 3]>,
    samples: u64,
    changes: [u64; 3],
    extremes: [[Extreme; 2]; 3],
}

/// Extreme value of an axis in one direction, and the runs of samples at this value while other
/// axes changed.
#[derive(Debug, Clone, Copy, Default)]
struct Extreme {
    limit: f64,
    run: u32,
    runs: u32,
}

impl AxisMonitor {
    pub(crate) fn new(quantity: &'static str, sensor: &'static str, min_range: f64) -> Self {
        let extremes = [[Extreme::default(); 2]; 3];
        Self { quantity, sensor, min_range, last: None, samples: 0, changes: [0; 3], extremes }
    }

    pub(crate) fn push(&mut self, value: [f64; 3]) {
        self.samples += 1;
        let Some(last) = self.last.replace(value) else { return };
        let changed: [bool; 3] = std::array::from_fn(|axis| value[axis] != last[axis]);
        for axis in 0..3 {
            self.changes[axis] += u64::from(changed[axis]);
            let others_changed = (0..3).any(|other| other != axis && changed[other]);
            let [low, high] = &mut self.extremes[axis];
            low.push(-value[axis], others_changed);
            high.push(value[axis], others_changed);
        }
    }

    /// Returns the diagnosis of a stuck or clipped axis, if any.
    ///
    /// An axis counts as stuck only if the body has rotated, because simulated sensors are constant
    /// at rest. If the unit is wrong, clipping is not checked, because the range is unknown.
    pub(crate) fn diagnose(&self, has_rotated: bool, unit_is_wrong: bool) -> Option<Diagnosis> {
        let is_active = self.changes.iter().any(|changes| *changes as f64 >= ACTIVE_SHARE * self.samples as f64);
        let stuck_axes: Vec<_> = (0..3).filter(|axis| self.changes[*axis] == 0).collect();
        if has_rotated
            && self.samples >= MIN_STUCK_SAMPLES
            && !stuck_axes.is_empty()
            && (is_active || self.last == Some([0.0; 3]))
        {
            return Some(diagnosis::stuck(self.quantity, self.sensor, &stuck_axes, self.samples));
        }
        if unit_is_wrong {
            return None;
        }
        let clipped = (0..3).flat_map(|axis| self.extremes[axis].map(|extreme| (axis, extreme)));
        let worst = clipped.filter(|(_, extreme)| extreme.runs >= MIN_RUNS && extreme.limit > self.min_range);
        let (axis, extreme) = worst.max_by_key(|(_, extreme)| extreme.runs)?;
        Some(diagnosis::clipped(self.quantity, self.sensor, axis, extreme.limit, extreme.runs))
    }
}

/// Detection of a magnetometer that always reports the same magnetic field.
#[derive(Debug, Clone, Default)]
pub(crate) struct FieldMonitor {
    fields: u64,
    samples_since_field: u64,
}

impl FieldMonitor {
    /// Adds a sample. `has_field` is `true` if the sample has a magnetic field that differs from
    /// the previous one.
    pub(crate) fn push(&mut self, has_field: bool) {
        self.fields += u64::from(has_field);
        self.samples_since_field = if has_field { 0 } else { self.samples_since_field + 1 };
    }

    /// Returns the diagnosis of a stuck magnetometer if the magnetic field never changed although
    /// the body has rotated.
    pub(crate) fn diagnose(&self, has_rotated: bool) -> Option<Diagnosis> {
        let is_dead = has_rotated && self.fields == 1 && self.samples_since_field >= MIN_STUCK_SAMPLES;
        is_dead.then(|| diagnosis::stuck("field", "magnetometer", &[0, 1, 2], self.samples_since_field))
    }
}

impl Extreme {
    fn push(&mut self, value: f64, others_changed: bool) {
        if value > self.limit {
            *self = Self { limit: value, run: 1, runs: 0 };
        } else if value == self.limit && others_changed {
            self.run += 1;
            self.runs += u32::from(self.run == RUN_LENGTH);
        } else {
            self.run = 0;
        }
    }
}
