//! What is not a state of a stage is refused, with a reason, and leaves the stage as it was.

use attitude::stage::{RestoreError, Snapshot};

use crate::{
    report::Check,
    run::{parting, state_bits, unsound},
    script::{S1, Script},
    slot::{Fills, Slot},
};

/// Inputs before the record is made: the estimate has left its first values.
const BEFORE: usize = 1500;

pub(crate) fn checks<L: Slot, S: Fills<L>>(make: &impl Fn() -> S) -> Vec<Check> {
    let inputs = L::inputs(&S1);
    let mut stage = make();
    inputs[..BEFORE].iter().for_each(|(_, input)| {
        stage.step(input);
    });
    let judge = Judge { make, stage, after: &inputs[BEFORE..BEFORE + 100], marker: core::marker::PhantomData };
    let good = judge.stage.snapshot();
    let bits = (0..good.len).find_map(|index| {
        [0, 31, 51, 62, 63].into_iter().find_map(|bit| {
            let mut record = good;
            record.values[index] = f64::from_bits(record.values[index].to_bits() ^ (1 << bit));
            let refused = |why: &RestoreError| matches!(why, RestoreError::Corrupt | RestoreError::NotFinite { .. });
            judge.refused(&record, refused, || format!("bit {bit} of value {index}"))
        })
    });
    let short = Snapshot { len: good.len - 1, ..good };
    let long = Snapshot { len: good.len + 1, ..good };
    let of_another_length = |why: &RestoreError| matches!(why, RestoreError::OtherLength { .. });
    let truncated = [short, long].iter().find_map(|record| {
        judge.refused(&summed(*record), of_another_length, || format!("a record of {} values", record.len))
    });
    let alien = Snapshot { stage: "no-such-stage", ..good };
    let alien = judge.refused(&alien, |why| matches!(why, RestoreError::OtherStage { .. }), || "its name".into());
    let not_finite = (0..good.len).find_map(|index| {
        [f64::NAN, f64::INFINITY].into_iter().find_map(|x| {
            let refused = |why: &RestoreError| matches!(why, RestoreError::NotFinite { index: at } if *at == index);
            judge.refused(&with(good, index, x), refused, || format!("{x} as value {index}"))
        })
    });
    let any = |_: &RestoreError| true;
    let no_state = [1e9, -1e9].into_iter().find_map(|x| {
        let record = (0..good.len).fold(good, |record, index| with(record, index, x));
        judge.refused(&record, any, || format!("{x:e} as every value"))
    });
    let impossible = (0..good.len).find_map(|index| {
        let value = good.values[index];
        [0.0, -value, -1.0, 1e3, 1e9, -1e9]
            .into_iter()
            .find_map(|x| judge.bearable(&with(good, index, x)).map(|how| format!("{x:e} as value {index}: {how}")))
    });
    let garbage = L::garbage().into_iter().find_map(|(what, common)| {
        let mut stage = judge.stage.clone();
        let verdict = stage.adopt(&common);
        judge.unchanged(stage, verdict.is_err()).map(|how| format!("{what}: {how}"))
    });
    vec![
        Check::holds("a record with a flipped bit is refused", bits),
        Check::holds("a record of another length is refused", truncated),
        Check::holds("a record of another stage is refused", alien),
        Check::holds("a record that is not finite is refused", not_finite),
        Check::holds("a record of numbers that are no state is refused", no_state),
        Check::holds("a record with one impossible number is refused or does no harm", impossible),
        Check::holds("an estimate that is none is not taken over", garbage),
    ]
}

struct Judge<'a, L: Slot, S, M> {
    make: &'a M,
    stage: S,
    after: &'a [(usize, L::Input)],
    marker: core::marker::PhantomData<L>,
}

impl<L: Slot, S: Fills<L>, M: Fn() -> S> Judge<'_, L, S, M> {
    /// What is wrong unless the record is refused for the right reason and nothing changes.
    fn refused(
        &self,
        record: &Snapshot,
        right: impl Fn(&RestoreError) -> bool,
        what: impl Fn() -> String,
    ) -> Option<String> {
        let mut stage = self.stage.clone();
        let verdict = stage.restore(record);
        if let Some(why) = verdict.err().filter(|why| !right(why)) {
            return Some(format!("{}: refused for another reason: {why}", what()));
        }
        self.unchanged(stage, verdict.is_err()).map(|how| format!("{}: {how}", what()))
    }

    /// What is wrong unless a stage that refused is as it was, to the bit, also in what it does later.
    fn unchanged(&self, mut stage: S, refused: bool) -> Option<String> {
        if !refused {
            return Some("taken over".into());
        }
        if state_bits(&stage) != state_bits(&self.stage) {
            return Some("refused, and the state changed".into());
        }
        let tick = parting::<L, S>(&mut stage, &mut self.stage.clone(), self.after)?;
        Some(format!("refused, and the output differs at tick {tick}"))
    }

    /// What is wrong when a record is taken over and then leads to outputs that are none.
    fn bearable(&self, record: &Snapshot) -> Option<String> {
        let mut stage = self.stage.clone();
        if stage.restore(record).is_err() {
            return self.unchanged(stage, true);
        }
        let rest = Script { name: "taken over".into(), ticks: S1.ticks[BEFORE..BEFORE + 200].to_vec() };
        unsound::<L, S>(&mut stage, &rest).or_else(|| {
            let refusal = (self.make)().adopt(&stage.common()).err()?;
            Some(format!("taken over, and what it hands over is refused: {refusal}"))
        })
    }
}

fn with(mut record: Snapshot, index: usize, value: f64) -> Snapshot {
    record.values[index] = value;
    summed(record)
}

/// The record with the checksum that belongs to its values.
fn summed(mut record: Snapshot) -> Snapshot {
    record.checksum = record.compute_checksum();
    record
}
