//! Checks that equal inputs yield bit-identical outputs, even after a restore from a snapshot.

use crate::{
    budget::Budget,
    fault::{CATALOGUE, FAULT_START_S},
    report::Check,
    run::first_difference,
    script::{S1, SHORT_SCRIPTS, Script},
    slot::{SlotSpec, SlotStage},
};

/// Maximum number of inputs after a snapshot for which the outputs are compared.
const COMPARED_INPUTS: usize = 500;

pub(crate) fn checks<L: SlotSpec, S: SlotStage<L>>(make: &impl Fn() -> S, budget: &Budget<'_>) -> Vec<Check> {
    let mut checks = Vec::new();
    budget.check_property(&mut checks, "two runs are bit-identical", || {
        budget.cases(&*SHORT_SCRIPTS).find_map(|script| {
            let tick = first_difference::<L, S>(&mut make(), &mut make(), &L::inputs(script))?;
            Some(format!("{}, tick {tick}", script.name))
        })
    });
    budget.check_property(&mut checks, "a restored run is bit-identical", || {
        let in_s1 = [0, 1, 7, 99, 500, 1013].map(|at| (&*S1, at));
        let tumbling = [3, 250, 777].map(|at| (&SHORT_SCRIPTS[1], at));
        let mut snapshots = budget.cases(in_s1.into_iter().chain(tumbling));
        snapshots.find_map(|(script, at)| restored_run_difference::<L, S>(make, script, at))
    });
    budget.check_property(&mut checks, "a run restored during a fault is bit-identical", || {
        budget.cases(CATALOGUE).find_map(|fault| {
            let script = fault.apply(&S1);
            let middle_s = FAULT_START_S + 0.5 * fault.duration_s;
            restored_run_difference::<L, S>(make, &script, script.ticks_before(middle_s))
        })
    });
    checks
}

/// Compares a stage with a copy restored from a snapshot after `at` inputs, and returns the first
/// difference.
pub(crate) fn restored_run_difference<L: SlotSpec, S: SlotStage<L>>(
    make: &impl Fn() -> S,
    script: &Script,
    at: usize,
) -> Option<String> {
    let inputs = L::inputs(script);
    let (before, after) = inputs.split_at(at.min(inputs.len()));
    let mut stage = make();
    before.iter().for_each(|(_, input)| {
        stage.step(input);
    });
    let mut restored = make();
    if let Err(error) = restored.restore(&stage.snapshot()) {
        return Some(format!("{}, snapshot after {at} inputs: the snapshot is rejected: {error}", script.name));
    }
    let tick = first_difference::<L, S>(&mut stage, &mut restored, &after[..after.len().min(COMPARED_INPUTS)])?;
    Some(format!("{}, snapshot after {at} inputs: differs at tick {tick}", script.name))
}
