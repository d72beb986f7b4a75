//! Golden traces: what a stage gave when its mathematics was last looked at.
//!
//! Input: a stage. Output: a table of its outputs on S1's scenario with its errors, a magnetic field and velocities. Time: 30 s at
//! 100 Hz, a row each second. Failure: a trace that is another tells the first number that is.

use attitude::stage::Stage;

use crate::{
    script::{S1, Script},
    slot::{AccelSlot, CourseSlot, FuserSlot, GyroSlot, Slot},
};

const TICKS: usize = 3001;
const EVERY: usize = 100;
/// Numbers that differ by no more than this are the same.
const SAME: f64 = 1e-9;

/// The trace of the stage of that name as CSV; `None` when there is none.
pub fn trace(slot: &str, name: &str) -> Option<String> {
    match slot {
        GyroSlot::NAME => trace_of::<GyroSlot>(name),
        AccelSlot::NAME => trace_of::<AccelSlot>(name),
        FuserSlot::NAME => trace_of::<FuserSlot>(name),
        CourseSlot::NAME => trace_of::<CourseSlot>(name),
        _ => None,
    }
}

fn trace_of<L: Slot>(name: &str) -> Option<String> {
    let mut stage = L::named(name)?;
    let script = Script { name: name.into(), ticks: S1.ticks[..TICKS].to_vec() };
    let (mut header, mut rows) = (String::from("t_s"), String::new());
    for (i, input) in L::inputs(&script) {
        let output = stage.step(&input);
        if i % EVERY == 0 {
            let first = rows.is_empty();
            rows += &format!("{}", script.ticks[i].t_s);
            L::visit(&output, &mut |name, value| {
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

/// Where a trace is not the golden one; numbers are compared to 1e-9.
pub fn difference(now: &str, golden: &str) -> Option<String> {
    let (mut now, mut golden) = (now.lines(), golden.lines());
    let header = now.next().unwrap_or_default();
    if golden.next() != Some(header) {
        return Some("other columns".into());
    }
    loop {
        let (now, row) = match (now.next(), golden.next()) {
            (None, None) => return None,
            (Some(now), Some(row)) => (now, row),
            _ => return Some("another number of rows".into()),
        };
        for ((column, now), golden) in header.split(',').zip(now.split(',')).zip(row.split(',')) {
            let same = match (now.parse::<f64>(), golden.parse::<f64>()) {
                (Ok(now), Ok(golden)) => (now - golden).abs() <= SAME * golden.abs().max(1.0),
                _ => false,
            };
            if !same {
                return Some(format!("{column} is {now}, was {golden} in the row {row}"));
            }
        }
    }
}
