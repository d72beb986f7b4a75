//! Running a stage on a script, and what can be said of two runs.

use attitude::{Quaternion, stage::Stage};

use crate::{
    script::Script,
    slot::{Fills, Slot},
};

/// Runs a stage over a script; the first tick with a bad output, and what is wrong with it.
pub(crate) fn unsound<L: Slot, S: Fills<L>>(stage: &mut S, script: &Script) -> Option<String> {
    L::inputs(script).iter().find_map(|(i, input)| {
        let flaw = L::unsound(&stage.step(input))?;
        let failure = stage.failure().map_or(String::new(), |failure| format!(", {failure}"));
        Some(format!("{}, tick {i}: {flaw}{failure}", script.name))
    })
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

/// Inclination error at each tick of a script, degrees.
pub(crate) fn errors_deg<L: Slot, S: Fills<L>>(stage: &mut S, script: &Script) -> Vec<(f64, f64)> {
    let error = |(i, input): &(usize, L::Input)| {
        let tick = &script.ticks[*i];
        (tick.t_s, inclination_deg(L::quaternion(&stage.step(input)), tick.truth.quaternion()))
    };
    L::inputs(script).iter().map(error).collect()
}

pub(crate) fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), x| (sum + x * x, count + 1.0));
    (sum / count).sqrt()
}
