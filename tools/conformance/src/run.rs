//! Running a stage on a script, and what can be said of two runs.

use std::marker::PhantomData;

use attitude::{Quaternion, stage::Stage};

use crate::{
    script::Script,
    slot::{Fills, Slot},
};

/// Runs a stage over a script; the first tick with a bad output, and what is wrong with it.
pub(crate) fn unsound<L: Slot, S: Fills<L>>(stage: &mut S, script: &Script) -> Option<String> {
    L::inputs(script).iter().find_map(|(i, input)| unsound_at::<L, S>(&stage.step(input), stage, &script.name, *i))
}

/// What is wrong with the output of a tick.
pub(crate) fn unsound_at<L: Slot, S: Fills<L>>(
    output: &L::Output,
    stage: &S,
    script: &str,
    i: usize,
) -> Option<String> {
    let flaw = L::unsound(output)?;
    let failure = stage.failure().map_or(String::new(), |failure| format!(", {failure}"));
    Some(format!("{script}, tick {i}: {flaw}{failure}"))
}

/// A stage that has run over the first ticks of a script: what differs only later begins here. Of a program that is another process with
/// the same state; what a program keeps beside its state is found by `repetition`.
pub(crate) struct Begun<L: Slot, S> {
    stage: S,
    /// Inputs of those ticks.
    inputs: usize,
    /// What was wrong in them.
    flaw: Option<String>,
    slot: PhantomData<L>,
}

/// What a stage did from there on.
pub(crate) struct Outcome<S> {
    pub(crate) stage: S,
    /// Inclination error at each time, s and degrees, up to the first bad output.
    pub(crate) errors_deg: Vec<(f64, f64)>,
    /// What was wrong first.
    pub(crate) flaw: Option<String>,
}

impl<L: Slot, S: Fills<L>> Begun<L, S> {
    /// Runs over that many ticks.
    pub(crate) fn new(mut stage: S, script: &Script, ticks: usize) -> Self {
        let inputs = L::inputs(script);
        let first = inputs.partition_point(|(i, _)| *i < ticks);
        let mut step =
            |(i, input): &(usize, L::Input)| unsound_at::<L, S>(&stage.step(input), &stage, &script.name, *i);
        let flaw = inputs[..first].iter().find_map(&mut step);
        Self { stage, inputs: first, flaw, slot: PhantomData }
    }

    /// A copy goes on with the rest of a script that begins with the same ticks.
    pub(crate) fn on(&self, script: &Script) -> Outcome<S> {
        let (mut stage, mut flaw, mut errors_deg) = (self.stage.clone(), self.flaw.clone(), Vec::new());
        for (i, input) in &L::inputs(script)[self.inputs..] {
            if flaw.is_some() {
                break;
            }
            let (tick, output) = (&script.ticks[*i], stage.step(input));
            errors_deg.push((tick.t_s, inclination_deg(L::quaternion(&output), tick.truth.quaternion())));
            flaw = unsound_at::<L, S>(&output, &stage, &script.name, *i);
        }
        Outcome { stage, errors_deg, flaw }
    }
}

/// A number that tells one output's bits from another's: FNV-1a.
pub(crate) fn print<L: Slot>(output: &L::Output) -> u64 {
    let mut print = 0xcbf2_9ce4_8422_2325u64;
    L::visit(output, &mut |_, value| print = (print ^ value.to_bits()).wrapping_mul(0x100_0000_01b3));
    print
}

/// Runs both; the first tick at which their outputs differ in a bit.
pub(crate) fn parting<L: Slot, S: Fills<L>>(one: &mut S, other: &mut S, inputs: &[(usize, L::Input)]) -> Option<usize> {
    let parts = |input| print::<L>(&one.step(input)) != print::<L>(&other.step(input));
    let mut parts = parts;
    inputs.iter().find(|(_, input)| parts(input)).map(|(i, _)| *i)
}

/// The bits of a stage's state.
pub(crate) fn state_bits(stage: &(impl Stage + Clone)) -> Vec<u64> {
    let record = stage.snapshot();
    record.values[..record.len].iter().map(|value| value.to_bits()).collect()
}

/// The whole angle between two attitudes, degrees.
pub(crate) fn angle_deg(one: Quaternion<f64>, other: Quaternion<f64>) -> f64 {
    let d = one.conjugate() * other;
    (2.0 * d.imag().norm().atan2(d.w.abs())).to_degrees()
}

/// The angle between the up vectors of two attitudes, degrees (Laidig 2021).
pub(crate) fn inclination_deg(one: Quaternion<f64>, other: Quaternion<f64>) -> f64 {
    let e = one * other.conjugate();
    (2.0 * e.i.hypot(e.j).atan2(e.w.hypot(e.k))).to_degrees()
}

pub(crate) fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), x| (sum + x * x, count + 1.0));
    (sum / count).sqrt()
}
