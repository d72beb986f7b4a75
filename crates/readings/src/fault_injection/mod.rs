//! Injects the faults that the launch file specifies as `[[ingest.fault]]` into readings.
//!
//! Input: readings as reported by the source.
//!
//! Output: readings as a failing sensor would report them, or `None`. The same readings and faults
//! always give bit-identical output.
//!
//! Time: that of the source since the first reading, without leaps and backward steps of its clock.
//!
//! | kind | gyro, accel | mag, gnss | all |
//! | --- | --- | --- | --- |
//! | `off` | NaN | no value | no reading |
//! | `stuck` | the last value before the fault | that value in place of each new value | each sensor as in its column |
//! | `garbage` | any value | any value in place of each new value | each sensor as in its column |
//! | `miscalibrated` | factor · value + offset | factor · value + offset | each sensor as in its column |
//! | `slow` | every n-th value, repeated in between | every n-th value | every n-th reading |
//! | `delayed` | the value one delay earlier | the value one delay earlier | each sensor as in its column |
//! | `intermittent` | NaN at random | no value at random | no reading at random |
//!
//! Faults are applied in sequence, each to the result of the previous ones, except that `delayed`
//! uses the original values of the source. Timestamps are not changed.

mod delay_line;
mod fault_rng;

use attitude::gnss::{Fix, ReceiverFix};
use launch::{Fault, FaultKind, Sensor};

use crate::source::Reading;
use {delay_line::DelayLine, fault_rng::FaultRng};

/// Longest step in ns between timestamps that counts as elapsed time. A longer step is a leap of
/// the clock.
const MAX_STEP_NS: i64 = 10_000_000_000;

/// Injector of all faults of a source.
#[derive(Debug, Clone)]
pub(crate) struct FaultInjector {
    faults: Vec<FaultState>,
    delay_line: DelayLine,
    elapsed_ns: i64,
    last_ns: Option<i64>,
    /// `true` if a fault was active since the last reading that was not dropped.
    was_active: bool,
}

/// Fault with its state.
#[derive(Debug, Clone)]
struct FaultState {
    fault: Fault,
    rng: FaultRng,
    /// Last values of the sensor before the fault. For `slow` and `delayed`, also updated during
    /// the fault.
    held: Option<Reading>,
    /// Number of values or readings since the fault started, for `slow`.
    count: u64,
    /// Index of the next reading from the delay line, for `delayed`.
    next_index: u64,
}

impl FaultInjector {
    /// Creates an injector that has not processed any readings.
    pub(crate) fn new(faults: &[Fault]) -> Self {
        let state = |fault: &Fault| {
            let seed = match fault.kind {
                FaultKind::Garbage { seed } | FaultKind::Intermittent { seed, .. } => seed,
                _ => 0,
            };
            FaultState { fault: *fault, rng: FaultRng(seed), held: None, count: 0, next_index: 0 }
        };
        Self {
            faults: faults.iter().map(state).collect(),
            delay_line: DelayLine::new(faults),
            elapsed_ns: 0,
            last_ns: None,
            was_active: false,
        }
    }

    /// Returns the reading with all active faults, or `None` if it is dropped.
    ///
    /// The second value is `true` if a fault was active for this reading or for any reading dropped
    /// immediately before it.
    pub(crate) fn inject(&mut self, reading: &Reading) -> Option<(Reading, bool)> {
        if self.faults.is_empty() {
            return Some((*reading, false));
        }
        let step_ns = reading.t_ns.saturating_sub(self.last_ns.replace(reading.t_ns).unwrap_or(reading.t_ns));
        let step_ns = if (0..=MAX_STEP_NS).contains(&step_ns) { step_ns } else { 0 };
        self.elapsed_ns = self.elapsed_ns.saturating_add(step_ns);
        self.delay_line.push(self.elapsed_ns, reading);
        let mut distorted = Some(*reading);
        for fault in &mut self.faults {
            let is_active = fault.is_active(self.elapsed_ns);
            self.was_active |= is_active;
            distorted = fault.apply(distorted, is_active, self.elapsed_ns, &self.delay_line);
        }
        self.delay_line.remove_expired(self.elapsed_ns);
        distorted.map(|reading| (reading, std::mem::take(&mut self.was_active)))
    }
}

impl FaultState {
    fn is_active(&self, elapsed_ns: i64) -> bool {
        let at_s = elapsed_ns as f64 * 1e-9;
        (self.fault.from_s..self.fault.until_s).contains(&at_s)
    }

    /// Applies the fault to a reading. A dropped reading stays dropped.
    fn apply(
        &mut self,
        reading: Option<Reading>,
        is_active: bool,
        elapsed_ns: i64,
        delay_line: &DelayLine,
    ) -> Option<Reading> {
        let sensor = self.fault.sensor;
        if let FaultKind::Delayed { delay_s } = self.fault.kind {
            // The delay line is also read while the fault is inactive, so that the state is current
            // when the fault starts.
            let delayed = self.delayed(elapsed_ns - (delay_s * 1e9) as i64, delay_line);
            return reading
                .map(|reading| if is_active { with_sensor_from(reading, sensor, &delayed) } else { reading });
        }
        let reading = reading?;
        if !is_active {
            self.hold(&reading);
            return Some(reading);
        }
        match self.fault.kind {
            FaultKind::Off => without_sensor(reading, sensor),
            FaultKind::Stuck => {
                let held = self.held.get_or_insert(reading);
                (held.field_ut, held.fix) = (held.field_ut.or(reading.field_ut), held.fix.or(reading.fix));
                let (field_ut, fix) = (reading.field_ut.and(held.field_ut), reading.fix.and(held.fix));
                let stuck = Reading { field_ut, fix, ..*held };
                Some(with_sensor_from(reading, sensor, &stuck))
            }
            FaultKind::Garbage { .. } => {
                let garbage = self.rng.garbage(&reading);
                Some(with_sensor_from(reading, sensor, &garbage))
            }
            FaultKind::Miscalibrated { factor, offset } => {
                Some(with_sensor_from(reading, sensor, &miscalibrated(reading, factor, offset)))
            }
            FaultKind::Slow { every } => self.every_nth(reading, every),
            FaultKind::Intermittent { share, .. } => {
                if self.rng.unit() < share {
                    Some(reading)
                } else {
                    without_sensor(reading, sensor)
                }
            }
            FaultKind::Delayed { .. } => Some(reading),
        }
    }

    /// Stores the values of the sensor. A magnetic field or fix is kept until a new one arrives.
    fn hold(&mut self, reading: &Reading) {
        let (field_ut, fix) = self.held.map_or((None, None), |held| (held.field_ut, held.fix));
        self.held = Some(Reading { field_ut: reading.field_ut.or(field_ut), fix: reading.fix.or(fix), ..*reading });
    }

    fn every_nth(&mut self, reading: Reading, every: u64) -> Option<Reading> {
        let sensor = self.fault.sensor;
        let counts = match sensor {
            Sensor::Mag => reading.field_ut.is_some(),
            Sensor::Gnss => reading.fix.is_some(),
            Sensor::Gyro | Sensor::Accel | Sensor::All => true,
        };
        let is_nth = counts && self.count.is_multiple_of(every);
        self.count += u64::from(counts);
        match sensor {
            Sensor::All => is_nth.then_some(reading),
            Sensor::Mag | Sensor::Gnss => {
                if is_nth {
                    Some(reading)
                } else {
                    without_sensor(reading, sensor)
                }
            }
            Sensor::Gyro | Sensor::Accel => {
                if is_nth {
                    self.held = Some(reading);
                }
                Some(self.held.map_or(reading, |held| with_sensor_from(reading, sensor, &held)))
            }
        }
    }

    /// Returns the reading at `until_ns`. It has the newest rate and force, and the newest magnetic
    /// field and fix since the last call.
    fn delayed(&mut self, until_ns: i64, delay_line: &DelayLine) -> Reading {
        let (readings, next) = delay_line.since(self.next_index);
        self.next_index = next;
        let mut latest = self.held.or(delay_line.first).map(|held| Reading { field_ut: None, fix: None, ..held });
        for (_, reading) in readings.take_while(|(at_ns, _)| *at_ns <= until_ns) {
            let (field_ut, fix) = latest.map_or((None, None), |latest| (latest.field_ut, latest.fix));
            latest = Some(Reading { field_ut: reading.field_ut.or(field_ut), fix: reading.fix.or(fix), ..*reading });
            self.next_index += 1;
        }
        self.held = latest;
        latest.unwrap_or(EMPTY_READING)
    }
}

/// Reading without values.
const EMPTY_READING: Reading = Reading {
    t_ns: 0,
    rate_rad_s: [f64::NAN; 3],
    force_m_s2: [f64::NAN; 3],
    field_ut: None,
    fix: None,
    reference: None,
};

/// Returns `reading` with the values of one sensor, or of all sensors, taken from `other`.
fn with_sensor_from(reading: Reading, sensor: Sensor, other: &Reading) -> Reading {
    match sensor {
        Sensor::Gyro => Reading { rate_rad_s: other.rate_rad_s, ..reading },
        Sensor::Accel => Reading { force_m_s2: other.force_m_s2, ..reading },
        Sensor::Mag => Reading { field_ut: other.field_ut, ..reading },
        Sensor::Gnss => Reading { fix: other.fix, ..reading },
        Sensor::All => Reading { t_ns: reading.t_ns, reference: reading.reference, ..*other },
    }
}

/// Returns the reading without the values of one sensor, or `None` for [`Sensor::All`].
fn without_sensor(reading: Reading, sensor: Sensor) -> Option<Reading> {
    (sensor != Sensor::All).then(|| with_sensor_from(reading, sensor, &EMPTY_READING))
}

fn miscalibrated(reading: Reading, factor: f64, offset: [f64; 3]) -> Reading {
    let distort = |value: [f64; 3]| std::array::from_fn(|axis| factor * value[axis] + offset[axis]);
    Reading {
        rate_rad_s: distort(reading.rate_rad_s),
        force_m_s2: distort(reading.force_m_s2),
        field_ut: reading.field_ut.map(distort),
        fix: reading.fix.map(|received| {
            let velocity_m_s = distort(received.fix.velocity_m_s.into()).into();
            ReceiverFix { fix: Fix { velocity_m_s, ..received.fix }, ..received }
        }),
        ..reading
    }
}
