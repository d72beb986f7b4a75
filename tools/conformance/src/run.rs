//! Functions that run a stage on a script and compare such runs.

use std::marker::PhantomData;

use attitude::{Quaternion, stage::Stage};

use crate::{
    script::Script,
    slot::{SlotSpec, SlotStage},
};

/// Runs a stage on a script and describes the first invalid output, if any.
pub(crate) fn first_invalid_output<L: SlotSpec, S: SlotStage<L>>(stage: &mut S, script: &Script) -> Option<String> {
    L::inputs(script)
        .iter()
        .find_map(|(i, input)| describe_invalid_output::<L, S>(&stage.step(input), stage, &script.name, *i))
}

/// Describes why an output is invalid, or returns `None` if it is valid.
pub(crate) fn describe_invalid_output<L: SlotSpec, S: SlotStage<L>>(
    output: &L::Output,
    stage: &S,
    script: &str,
    tick: usize,
) -> Option<String> {
    let error = L::output_error(output)?;
    let failure = stage.failure().map_or(String::new(), |failure| format!(", {failure}"));
    Some(format!("{script}, tick {tick}: {error}{failure}"))
}

/// Stage that has processed the first ticks of a script. Its run can be continued with any script
/// that starts with the same ticks.
///
/// A copy of an external stage is another process with the same state. Data that a program keeps
/// outside its state would be missing in the copy. The repeatability checks detect such data.
pub(crate) struct PrefixRun<L: SlotSpec, S> {
    stage: S,
    /// Number of inputs processed.
    input_count: usize,
    /// Description of the first invalid output.
    invalid_output: Option<String>,
    slot: PhantomData<L>,
}

/// Result of a run that resumes after the ticks of a [`PrefixRun`].
pub(crate) struct RunOutcome<S> {
    pub(crate) stage: S,
    /// Time in seconds and inclination error in degrees at each tick up to the first invalid
    /// output.
    pub(crate) errors_deg: Vec<(f64, f64)>,
    /// Description of the first invalid output, which may be from the ticks of the [`PrefixRun`].
    pub(crate) invalid_output: Option<String>,
}

impl<L: SlotSpec, S: SlotStage<L>> PrefixRun<L, S> {
    /// Runs `stage` on the first `ticks` ticks of a script.
    pub(crate) fn new(mut stage: S, script: &Script, ticks: usize) -> Self {
        let inputs = L::inputs(script);
        let input_count = inputs.partition_point(|(i, _)| *i < ticks);
        let mut invalid_output_of = |(i, input): &(usize, L::Input)| {
            describe_invalid_output::<L, S>(&stage.step(input), &stage, &script.name, *i)
        };
        let invalid_output = inputs[..input_count].iter().find_map(&mut invalid_output_of);
        Self { stage, input_count, invalid_output, slot: PhantomData }
    }

    /// Runs a copy of the stage on the rest of `script`, which must start with the ticks that the
    /// stage has already processed.
    pub(crate) fn resume(&self, script: &Script) -> RunOutcome<S> {
        let (mut stage, mut invalid_output, mut errors_deg) =
            (self.stage.clone(), self.invalid_output.clone(), Vec::new());
        for (i, input) in &L::inputs(script)[self.input_count..] {
            if invalid_output.is_some() {
                break;
            }
            let (tick, output) = (&script.ticks[*i], stage.step(input));
            errors_deg.push((tick.t_s, inclination_deg(L::quaternion(&output), tick.truth.quaternion())));
            invalid_output = describe_invalid_output::<L, S>(&output, &stage, &script.name, *i);
        }
        RunOutcome { stage, errors_deg, invalid_output }
    }
}

/// Returns the FNV-1a hash of an output's bits.
pub(crate) fn output_hash<L: SlotSpec>(output: &L::Output) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325u64;
    L::visit_numbers(output, &mut |_, value| hash = (hash ^ value.to_bits()).wrapping_mul(0x100_0000_01b3));
    hash
}

/// Runs two stages on the same inputs and returns the first tick at which their outputs are not
/// bit-identical.
pub(crate) fn first_difference<L: SlotSpec, S: SlotStage<L>>(
    one: &mut S,
    other: &mut S,
    inputs: &[(usize, L::Input)],
) -> Option<usize> {
    let mut differs = |input| output_hash::<L>(&one.step(input)) != output_hash::<L>(&other.step(input));
    inputs.iter().find(|(_, input)| differs(input)).map(|(i, _)| *i)
}

/// Returns the bits of a stage's state.
pub(crate) fn state_bits(stage: &(impl Stage + Clone)) -> Vec<u64> {
    let snapshot = stage.snapshot();
    snapshot.values[..snapshot.len].iter().map(|value| value.to_bits()).collect()
}

/// Returns the rotation angle between two attitudes, degrees.
pub(crate) fn angle_deg(one: Quaternion<f64>, other: Quaternion<f64>) -> f64 {
    let d = one.conjugate() * other;
    (2.0 * d.imag().norm().atan2(d.w.abs())).to_degrees()
}

/// Returns the angle between the up vectors of two attitudes, degrees (Laidig 2021).
pub(crate) fn inclination_deg(one: Quaternion<f64>, other: Quaternion<f64>) -> f64 {
    let e = one * other.conjugate();
    (2.0 * e.i.hypot(e.j).atan2(e.w.hypot(e.k))).to_degrees()
}

pub(crate) fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), x| (sum + x * x, count + 1.0));
    (sum / count).sqrt()
}
