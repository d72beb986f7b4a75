//! Golden traces: the outputs of each stage, recorded when its mathematics was last reviewed.
//!
//! Input: a stage.
//!
//! Output: a table of the stage's outputs on scenario S1 with sensor errors, magnetic field and
//! velocities.
//!
//! Time: 30 s at 100 Hz, one row per second.
//!
//! Failure: the first number that differs is reported.

use attitude::stage::Stage;
use launch::Slot;

use crate::{
    script::{S1, Script},
    slot::{AccelSlot, CourseSlot, FuserSlot, GyroSlot, SlotSpec},
};

const TICK_COUNT: usize = 3001;
const ROW_INTERVAL_TICKS: usize = 100;
/// Tolerance: relative for numbers above 1, absolute for smaller numbers.
const TOLERANCE: f64 = 1e-9;

/// Returns the trace of a stage as CSV, or `None` for an unknown name.
pub fn trace(slot: Slot, name: &str) -> Option<String> {
    match slot {
        Slot::Gyro => trace_stage::<GyroSlot>(name),
        Slot::Accel => trace_stage::<AccelSlot>(name),
        Slot::Fuser => trace_stage::<FuserSlot>(name),
        Slot::Course => trace_stage::<CourseSlot>(name),
    }
}

fn trace_stage<L: SlotSpec>(name: &str) -> Option<String> {
    let mut stage = L::from_name(name)?;
    let script = Script { name: name.into(), ticks: S1.ticks[..TICK_COUNT].to_vec() };
    let (mut header, mut rows) = (String::from("t_s"), String::new());
    for (i, input) in L::inputs(&script) {
        let output = stage.step(&input);
        if i % ROW_INTERVAL_TICKS == 0 {
            let first = rows.is_empty();
            rows += &format!("{}", script.ticks[i].t_s);
            L::visit_numbers(&output, &mut |name, value| {
                rows += &format!(",{value}");
                if first {
                    header += &format!(",{name}");
                }
            });
            rows.push('\n');
        }
    }
    Some(format!("{header}\n{rows}"))
}

/// Returns the first difference between a trace and the golden trace, or `None` if they agree to
/// 1e-9.
pub fn difference(actual: &str, golden: &str) -> Option<String> {
    let (mut actual, mut golden) = (actual.lines(), golden.lines());
    let header = actual.next().unwrap_or_default();
    if golden.next() != Some(header) {
        return Some("the columns differ".into());
    }
    loop {
        let (actual, row) = match (actual.next(), golden.next()) {
            (None, None) => return None,
            (Some(actual), Some(row)) => (actual, row),
            _ => return Some("the number of rows differs".into()),
        };
        for ((column, actual), golden) in header.split(',').zip(actual.split(',')).zip(row.split(',')) {
            let same = match (actual.parse::<f64>(), golden.parse::<f64>()) {
                (Ok(actual), Ok(golden)) => (actual - golden).abs() <= TOLERANCE * golden.abs().max(1.0),
                _ => false,
            };
            if !same {
                return Some(format!("{column}: found {actual}, expected {golden}, in row {row}"));
            }
        }
    }
}
