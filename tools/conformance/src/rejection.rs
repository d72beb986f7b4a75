//! Checks that a stage rejects invalid states with the correct reason and then stays unchanged.

use attitude::stage::{RestoreError, Snapshot};

use crate::{
    budget::Budget,
    report::Check,
    run::{first_difference, first_invalid_output, state_bits},
    script::{S1, Script},
    slot::{SlotSpec, SlotStage},
};

/// Number of inputs before the snapshot. The estimate has left its initial values by then.
const SNAPSHOT_INPUT: usize = 1500;

pub(crate) fn checks<L: SlotSpec, S: SlotStage<L>>(make: &impl Fn() -> S, budget: &Budget<'_>) -> Vec<Check> {
    if !budget.starts("rejection of snapshots") {
        return Vec::new();
    }
    let inputs = L::inputs(&S1);
    let mut stage = make();
    inputs[..SNAPSHOT_INPUT].iter().for_each(|(_, input)| {
        stage.step(input);
    });
    let check = RejectionCheck {
        make,
        stage,
        later_inputs: &inputs[SNAPSHOT_INPUT..SNAPSHOT_INPUT + 100],
        marker: core::marker::PhantomData,
    };
    let snapshot = check.stage.snapshot();
    let bits = budget.cases(0..snapshot.len).find_map(|index| {
        [0, 31, 51, 62, 63].into_iter().find_map(|bit| {
            let mut damaged = snapshot;
            damaged.values[index] = f64::from_bits(damaged.values[index].to_bits() ^ (1 << bit));
            let is_expected =
                |error: &RestoreError| matches!(error, RestoreError::Corrupt | RestoreError::NotFinite { .. });
            check.rejection_error(&damaged, is_expected, || format!("bit {bit} of value {index}"))
        })
    });
    let short = Snapshot { len: snapshot.len - 1, ..snapshot };
    let long = Snapshot { len: snapshot.len + 1, ..snapshot };
    let is_expected = |error: &RestoreError| matches!(error, RestoreError::OtherLength { .. });
    let length = [short, long].iter().find_map(|changed| {
        check.rejection_error(&with_checksum(*changed), is_expected, || format!("{} values", changed.len))
    });
    let other_stage = Snapshot { stage: "no-such-stage", ..snapshot };
    let name = check.rejection_error(
        &other_stage,
        |error| matches!(error, RestoreError::OtherStage { .. }),
        || "the name".into(),
    );
    let non_finite = budget.cases(0..snapshot.len).find_map(|index| {
        [f64::NAN, f64::INFINITY].into_iter().find_map(|x| {
            let is_expected =
                |error: &RestoreError| matches!(error, RestoreError::NotFinite { index: found } if *found == index);
            check.rejection_error(&with_value(snapshot, index, x), is_expected, || format!("{x} as value {index}"))
        })
    });
    let any = |_: &RestoreError| true;
    let out_of_range = [1e9, -1e9].into_iter().find_map(|x| {
        let changed = (0..snapshot.len).fold(snapshot, |changed, index| with_value(changed, index, x));
        check.rejection_error(&changed, any, || format!("{x:e} as every value"))
    });
    let single_value = budget.cases(0..snapshot.len).find_map(|index| {
        let value = snapshot.values[index];
        [0.0, -value, -1.0, 1e3, 1e9, -1e9].into_iter().find_map(|x| {
            check.harm(&with_value(snapshot, index, x)).map(|harm| format!("{x:e} as value {index}: {harm}"))
        })
    });
    let common = budget.cases(L::invalid_common_states()).find_map(|(name, common)| {
        let mut stage = check.stage.clone();
        let result = stage.adopt(&common);
        check.unchanged_error(stage, result.is_err()).map(|error| format!("{name}: {error}"))
    });
    vec![
        Check::property("a snapshot with a flipped bit is rejected", bits),
        Check::property("a snapshot of another length is rejected", length),
        Check::property("a snapshot of another stage is rejected", name),
        Check::property("a snapshot with a non-finite value is rejected", non_finite),
        Check::property("a snapshot of out-of-range values is rejected", out_of_range),
        Check::property("a snapshot with one altered value is rejected or harmless", single_value),
        Check::property("an invalid common state is rejected", common),
    ]
}

/// Stage after [`SNAPSHOT_INPUT`] inputs, and the inputs that follow.
struct RejectionCheck<'a, L: SlotSpec, S, M> {
    make: &'a M,
    stage: S,
    later_inputs: &'a [(usize, L::Input)],
    marker: core::marker::PhantomData<L>,
}

impl<L: SlotSpec, S: SlotStage<L>, M: Fn() -> S> RejectionCheck<'_, L, S, M> {
    /// Returns an error unless the stage rejects the snapshot with the expected error and stays
    /// unchanged.
    fn rejection_error(
        &self,
        snapshot: &Snapshot,
        is_expected: impl Fn(&RestoreError) -> bool,
        name: impl Fn() -> String,
    ) -> Option<String> {
        let mut stage = self.stage.clone();
        let result = stage.restore(snapshot);
        if let Some(error) = result.err().filter(|error| !is_expected(error)) {
            return Some(format!("{}: rejected for the wrong reason: {error}", name()));
        }
        self.unchanged_error(stage, result.is_err()).map(|error| format!("{}: {error}", name()))
    }

    /// Returns an error unless the stage has rejected a state and is unchanged.
    ///
    /// The state and the later outputs of the stage must be bit-identical to those of `self.stage`.
    fn unchanged_error(&self, mut stage: S, rejected: bool) -> Option<String> {
        if !rejected {
            return Some("accepted".into());
        }
        if state_bits(&stage) != state_bits(&self.stage) {
            return Some("rejected, but the state changed".into());
        }
        let tick = first_difference::<L, S>(&mut stage, &mut self.stage.clone(), self.later_inputs)?;
        Some(format!("rejected, but the output differs at tick {tick}"))
    }

    /// Returns an error if a snapshot harms the stage.
    ///
    /// The stage must either accept the snapshot and then yield valid outputs and a valid common
    /// state, or reject it and stay unchanged.
    fn harm(&self, snapshot: &Snapshot) -> Option<String> {
        let mut stage = self.stage.clone();
        if stage.restore(snapshot).is_err() {
            return self.unchanged_error(stage, true);
        }
        let rest = Script {
            name: "after the snapshot".into(),
            ticks: S1.ticks[SNAPSHOT_INPUT..SNAPSHOT_INPUT + 200].to_vec(),
        };
        first_invalid_output::<L, S>(&mut stage, &rest).or_else(|| {
            let error = (self.make)().adopt(&stage.common()).err()?;
            Some(format!("accepted, but its common state is rejected: {error}"))
        })
    }
}

fn with_value(mut snapshot: Snapshot, index: usize, value: f64) -> Snapshot {
    snapshot.values[index] = value;
    with_checksum(snapshot)
}

/// Sets the checksum of a snapshot to that of its contents.
fn with_checksum(mut snapshot: Snapshot) -> Snapshot {
    snapshot.checksum = snapshot.compute_checksum();
    snapshot
}
