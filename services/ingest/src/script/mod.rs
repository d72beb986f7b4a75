//! Faults on purpose: what the launch file's `[[ingest.fault]]` do to a reading before it is looked at.
//!
//! Input: readings as the source gives them. Output: readings as a failing sensor would give them, or none. Time: the source's since the
//! first reading, without what its clock leaps or runs backward. Failure: none. The same readings and script give the same bits.
//!
//! | kind | gyro, accel | mag, gnss | all |
//! | --- | --- | --- | --- |
//! | `off` | not a number | no value | no reading |
//! | `stuck` | the last value before | the last value before, whenever there is one | each of the four |
//! | `garbage` | any value | any value, whenever there is one | each of the four |
//! | `miscalibrated` | factor · value + offset | likewise | each of the four |
//! | `slow` | every n-th value, repeated in between | every n-th value | every n-th reading |
//! | `delayed` | the value of so long ago | likewise | each of the four |
//! | `intermittent` | now and then not a number | now and then no value | now and then no reading |
//!
//! Each entry is applied to what the entries before it left, `delayed` to what the source gave. The stamp stays as it is.

mod dice;
mod past;

use attitude::gnss::Fix;
use launch::{Fault, FaultKind, Sensor};

use crate::source::{Reading, ReceiverFix};
use {dice::Dice, past::Past};

/// A longer step of the stamps is a leap of the clock, ns.
const LEAP_NS: i64 = 10_000_000_000;

/// A script on its way.
#[derive(Debug, Clone)]
pub(crate) struct Script {
    entries: Vec<Entry>,
    past: Past,
    elapsed_ns: i64,
    last_ns: Option<i64>,
    /// An entry was at work since the last reading that was told.
    at_work: bool,
}

/// An entry, and what it keeps.
#[derive(Debug, Clone)]
struct Entry {
    fault: Fault,
    dice: Dice,
    /// What the sensor last said: before the fault, or for `slow` and `delayed` in it.
    said: Option<Reading>,
    /// Values or readings of the fault, of `slow`.
    count: u64,
    /// The next of the past, of `delayed`.
    next: u64,
}

impl Script {
    /// From its begin.
    pub(crate) fn new(faults: &[Fault]) -> Self {
        let entry = |fault: &Fault| {
            let seed = match fault.kind {
                FaultKind::Garbage { seed } | FaultKind::Intermittent { seed, .. } => seed,
                _ => 0,
            };
            Entry { fault: *fault, dice: Dice(seed), said: None, count: 0, next: 0 }
        };
        Self {
            entries: faults.iter().map(entry).collect(),
            past: Past::new(faults),
            elapsed_ns: 0,
            last_ns: None,
            at_work: false,
        }
    }

    /// The reading as the script has it, and whether the script was at work on it or on one that is gone since the last.
    pub(crate) fn distort(&mut self, reading: &Reading) -> Option<(Reading, bool)> {
        if self.entries.is_empty() {
            return Some((*reading, false));
        }
        let step_ns = reading.t_ns.saturating_sub(self.last_ns.replace(reading.t_ns).unwrap_or(reading.t_ns));
        let step_ns = if (0..=LEAP_NS).contains(&step_ns) { step_ns } else { 0 };
        self.elapsed_ns = self.elapsed_ns.saturating_add(step_ns);
        self.past.push(self.elapsed_ns, reading);
        let mut told = Some(*reading);
        for entry in &mut self.entries {
            let active = entry.is_active(self.elapsed_ns);
            self.at_work |= active;
            told = entry.apply(told, active, self.elapsed_ns, &self.past);
        }
        self.past.forget(self.elapsed_ns);
        told.map(|told| (told, std::mem::take(&mut self.at_work)))
    }
}

impl Entry {
    fn is_active(&self, elapsed_ns: i64) -> bool {
        let at_s = elapsed_ns as f64 * 1e-9;
        (self.fault.from_s..self.fault.until_s).contains(&at_s)
    }

    /// What is left of a reading; none stays none.
    fn apply(&mut self, told: Option<Reading>, active: bool, elapsed_ns: i64, past: &Past) -> Option<Reading> {
        let sensor = self.fault.sensor;
        if let FaultKind::Delayed { delay_s } = self.fault.kind {
            // The past is read along all the time, so that it is there when it is wanted.
            let earlier = self.earlier(elapsed_ns - (delay_s * 1e9) as i64, past);
            return told.map(|told| if active { replaced(told, sensor, &earlier) } else { told });
        }
        let told = told?;
        if !active {
            self.keep(&told);
            return Some(told);
        }
        match self.fault.kind {
            FaultKind::Off => absent(told, sensor),
            FaultKind::Stuck => {
                let said = self.said.get_or_insert(told);
                (said.field_ut, said.fix) = (said.field_ut.or(told.field_ut), said.fix.or(told.fix));
                let held = Reading { field_ut: told.field_ut.and(said.field_ut), fix: told.fix.and(said.fix), ..*said };
                Some(replaced(told, sensor, &held))
            }
            FaultKind::Garbage { .. } => {
                let garbage = self.dice.garbage(&told);
                Some(replaced(told, sensor, &garbage))
            }
            FaultKind::Miscalibrated { factor, offset } => Some(replaced(told, sensor, &wrong(told, factor, offset))),
            FaultKind::Slow { every } => self.every_nth(told, every),
            FaultKind::Intermittent { share, .. } => {
                if self.dice.unit() < share {
                    Some(told)
                } else {
                    absent(told, sensor)
                }
            }
            FaultKind::Delayed { .. } => Some(told),
        }
    }

    /// Keeps what the sensor said; a field and a fix until there is another.
    fn keep(&mut self, told: &Reading) {
        let (field_ut, fix) = self.said.map_or((None, None), |said| (said.field_ut, said.fix));
        self.said = Some(Reading { field_ut: told.field_ut.or(field_ut), fix: told.fix.or(fix), ..*told });
    }

    fn every_nth(&mut self, told: Reading, every: u64) -> Option<Reading> {
        let sensor = self.fault.sensor;
        let counts = match sensor {
            Sensor::Mag => told.field_ut.is_some(),
            Sensor::Gnss => told.fix.is_some(),
            Sensor::Gyro | Sensor::Accel | Sensor::All => true,
        };
        let is_nth = counts && self.count.is_multiple_of(every);
        self.count += u64::from(counts);
        match sensor {
            Sensor::All => is_nth.then_some(told),
            Sensor::Mag | Sensor::Gnss => {
                if is_nth {
                    Some(told)
                } else {
                    absent(told, sensor)
                }
            }
            Sensor::Gyro | Sensor::Accel => {
                if is_nth {
                    self.said = Some(told);
                }
                Some(self.said.map_or(told, |said| replaced(told, sensor, &said)))
            }
        }
    }

    /// What the source said until a time: the latest rate and force, and what came of the rest since it was last asked.
    fn earlier(&mut self, until_ns: i64, past: &Past) -> Reading {
        let (readings, next) = past.since(self.next);
        self.next = next;
        let mut latest = self.said.or(past.first).map(|said| Reading { field_ut: None, fix: None, ..said });
        for (_, reading) in readings.take_while(|(at_ns, _)| *at_ns <= until_ns) {
            let (field_ut, fix) = latest.map_or((None, None), |latest| (latest.field_ut, latest.fix));
            latest = Some(Reading { field_ut: reading.field_ut.or(field_ut), fix: reading.fix.or(fix), ..*reading });
            self.next += 1;
        }
        self.said = latest;
        latest.unwrap_or(NOTHING)
    }
}

/// A reading of nothing.
const NOTHING: Reading = Reading {
    t_ns: 0,
    rate_rad_s: [f64::NAN; 3],
    force_m_s2: [f64::NAN; 3],
    field_ut: None,
    fix: None,
    reference: None,
};

/// The reading with the sensor's values from another one.
fn replaced(reading: Reading, sensor: Sensor, by: &Reading) -> Reading {
    match sensor {
        Sensor::Gyro => Reading { rate_rad_s: by.rate_rad_s, ..reading },
        Sensor::Accel => Reading { force_m_s2: by.force_m_s2, ..reading },
        Sensor::Mag => Reading { field_ut: by.field_ut, ..reading },
        Sensor::Gnss => Reading { fix: by.fix, ..reading },
        Sensor::All => Reading { t_ns: reading.t_ns, reference: reading.reference, ..*by },
    }
}

/// The reading without the sensor.
fn absent(reading: Reading, sensor: Sensor) -> Option<Reading> {
    (sensor != Sensor::All).then(|| replaced(reading, sensor, &NOTHING))
}

fn wrong(reading: Reading, factor: f64, offset: [f64; 3]) -> Reading {
    let wrong = |value: [f64; 3]| std::array::from_fn(|axis| factor * value[axis] + offset[axis]);
    Reading {
        rate_rad_s: wrong(reading.rate_rad_s),
        force_m_s2: wrong(reading.force_m_s2),
        field_ut: reading.field_ut.map(wrong),
        fix: reading.fix.map(|received| {
            let velocity_m_s = wrong(received.fix.velocity_m_s.into()).into();
            ReceiverFix { fix: Fix { velocity_m_s, ..received.fix }, ..received }
        }),
        ..reading
    }
}
