//! The same inputs give the same bits, also over a snapshot: what a stage depends on is in its state.

use crate::{
    fault::{BEGIN_S, CATALOGUE},
    report::Check,
    run::parting,
    script::{S1, SHORT, Script},
    slot::{Fills, Slot},
};

/// Ticks compared after a snapshot.
const AFTER: usize = 500;

pub(crate) fn checks<L: Slot, S: Fills<L>>(make: &impl Fn() -> S) -> Vec<Check> {
    let twice = SHORT.iter().find_map(|script| {
        let tick = parting::<L, S>(&mut make(), &mut make(), &L::inputs(script))?;
        Some(format!("{}, tick {tick}", script.name))
    });
    let quiet = [0, 1, 7, 99, 500, 1013].iter().find_map(|at| resumed::<L, S>(make, &S1, *at));
    let tumbling = [3, 250, 777].iter().find_map(|at| resumed::<L, S>(make, &SHORT[1], *at));
    let in_faults = CATALOGUE.iter().find_map(|fault| {
        let script = fault.put_in(&S1);
        let middle_s = BEGIN_S + 0.5 * fault.duration_s;
        resumed::<L, S>(make, &script, script.ticks_before(middle_s))
    });
    vec![
        Check::holds("two runs give the same bits", twice),
        Check::holds("a run goes on from a snapshot bit for bit", quiet.or(tumbling)),
        Check::holds("a run goes on from a snapshot taken during a fault bit for bit", in_faults),
    ]
}

/// Runs on, beside a fresh stage that takes over a snapshot after `at` inputs; where they part.
pub(crate) fn resumed<L: Slot, S: Fills<L>>(make: &impl Fn() -> S, script: &Script, at: usize) -> Option<String> {
    let inputs = L::inputs(script);
    let (before, after) = inputs.split_at(at.min(inputs.len()));
    let mut stage = make();
    before.iter().for_each(|(_, input)| {
        stage.step(input);
    });
    let mut fresh = make();
    if let Err(refusal) = fresh.restore(&stage.snapshot()) {
        return Some(format!("{}, snapshot after {at} inputs: its own record is refused: {refusal}", script.name));
    }
    let tick = parting::<L, S>(&mut stage, &mut fresh, &after[..after.len().min(AFTER)])?;
    Some(format!("{}, snapshot after {at} inputs: parts at tick {tick}", script.name))
}
