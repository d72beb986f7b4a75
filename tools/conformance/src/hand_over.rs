//! Another stage of the slot goes on where one was.

use crate::{
    report::{Check, Figure},
    run::{angle_deg, inclination_deg, rms, unsound},
    script::{S1, Script},
    slot::{Fills, Slot},
};

/// Inputs before the hand-over, and those after which the receiver has settled.
const BEFORE: usize = 4000;
const SETTLED: usize = 8000;
/// Most that the attitude may differ at the tick after the hand-over, degrees.
const JUMP_DEG: f64 = 0.5;
/// The receiver's later error may be above its own by this factor, and this much.
const WORSE: f64 = 1.5;
const WORSE_DEG: f64 = 0.05;

pub(crate) fn checks<L: Slot, S: Fills<L>>(make: &impl Fn() -> S) -> Vec<Check> {
    let own = make().name();
    let others = || L::NAMES.iter().filter(move |name| **name != own).filter_map(|name| Some((*name, L::named(name)?)));
    let mut checks = Vec::new();
    for (name, other) in others() {
        checks.extend(hand_over::<L, S, L::Own>(&make(), &other, &format!("hand-over to {name}")));
    }
    for (name, other) in others() {
        checks.extend(hand_over::<L, L::Own, S>(&other, &make(), &format!("hand-over from {name}")));
    }
    checks.extend(hand_over::<L, S, S>(&make(), &make(), "hand-over to itself"));
    checks
}

fn hand_over<L: Slot, G: Fills<L>, R: Fills<L>>(giver: &G, receiver: &R, what: &str) -> Vec<Check> {
    let (mut giver, mut receiver, mut alone) = (giver.clone(), receiver.clone(), receiver.clone());
    let inputs = L::inputs(&S1);
    inputs[..BEFORE].iter().for_each(|(_, input)| {
        giver.step(input);
    });
    if let Err(refusal) = receiver.adopt(&giver.common()) {
        return vec![Check::holds(what, Some(refusal.to_string()))];
    }
    let (_, next) = &inputs[BEFORE];
    let (given, taken) = (giver.step(next), receiver.clone().step(next));
    // A receiver that knows north where the giver did not sets the heading anew.
    let heading = L::heading(&given).filter(|reference| L::heading(&taken) == Some(*reference));
    let angle = if heading.is_some() { angle_deg } else { inclination_deg };
    let (given, taken) = (L::quaternion(&given), L::quaternion(&taken));
    let jump = Figure { value: Some(angle(given, taken)), limit: Some(JUMP_DEG), unit: "°" };
    let jump = Check::most(format!("{what}: the attitude goes on"), jump, || {
        format!("{:.3}° of it inclination", inclination_deg(given, taken))
    });
    let rest = Script { name: what.into(), ticks: S1.ticks[BEFORE..].to_vec() };
    let failed_at = unsound::<L, R>(&mut receiver.clone(), &rest);
    let sound = Check::holds(format!("{what}: outputs are finite and rotations"), failed_at);
    let mut checks = vec![jump, sound];
    if L::LEVELS {
        let own = rms(alone_errors::<L, R>(&mut alone, &inputs, 0));
        let later = rms(alone_errors::<L, R>(&mut receiver, &inputs, BEFORE));
        let figure = Figure { value: Some(later), limit: Some(WORSE * own + WORSE_DEG), unit: "°" };
        checks.push(Check::most(format!("{what}: later inclination RMSE"), figure, || format!("alone {own:.3}°")));
    }
    checks
}

/// Inclination errors from [`SETTLED`] on of a stage that begins with the input `from`, degrees.
fn alone_errors<L: Slot, S: Fills<L>>(
    stage: &mut S,
    inputs: &[(usize, L::Input)],
    from: usize,
) -> impl Iterator<Item = f64> {
    inputs[from..]
        .iter()
        .map(|(i, input)| {
            let truth = S1.ticks[*i].truth.quaternion();
            (*i, inclination_deg(L::quaternion(&stage.step(input)), truth))
        })
        .filter(|(i, _)| *i >= SETTLED)
        .map(|(_, error_deg)| error_deg)
}
