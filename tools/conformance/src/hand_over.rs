//! Another stage of the slot goes on where one was.

use crate::{
    report::{Check, Figure},
    run::{angle_deg, inclination_deg, rms, unsound_at},
    script::S1,
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
    let inputs = L::inputs(&S1);
    let mut giver = make();
    step_all::<L, S>(&mut giver, &inputs[..BEFORE]);
    for (name, other) in others() {
        let alone_deg = alone_deg::<L, L::Own>(other.clone(), &inputs);
        checks.extend(hand_over::<L, S, L::Own>(&giver, &other, &inputs, alone_deg, &format!("hand-over to {name}")));
    }
    let alone_deg = alone_deg::<L, S>(make(), &inputs);
    for (name, mut other) in others() {
        step_all::<L, L::Own>(&mut other, &inputs[..BEFORE]);
        checks.extend(hand_over::<L, L::Own, S>(
            &other,
            &make(),
            &inputs,
            alone_deg,
            &format!("hand-over from {name}"),
        ));
    }
    checks.extend(hand_over::<L, S, S>(&giver, &make(), &inputs, alone_deg, "hand-over to itself"));
    checks
}

fn step_all<L: Slot, S: Fills<L>>(stage: &mut S, inputs: &[(usize, L::Input)]) {
    inputs.iter().for_each(|(_, input)| {
        stage.step(input);
    });
}

/// The later error of a stage that has had every input, where its level counts.
fn alone_deg<L: Slot, S: Fills<L>>(mut stage: S, inputs: &[(usize, L::Input)]) -> f64 {
    if L::LEVELS { later::<L, S>(&mut stage, inputs, "alone").rmse_deg } else { 0.0 }
}

/// The giver has had the inputs before; the receiver, fresh, has this error later when it is alone.
fn hand_over<L: Slot, G: Fills<L>, R: Fills<L>>(
    giver: &G,
    receiver: &R,
    inputs: &[(usize, L::Input)],
    alone_deg: f64,
    what: &str,
) -> Vec<Check> {
    let (mut giver, mut receiver) = (giver.clone(), receiver.clone());
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
    let later = later::<L, R>(&mut receiver, &inputs[BEFORE..], what);
    let sound = Check::holds(format!("{what}: outputs are finite and rotations"), later.flaw);
    let mut checks = vec![jump, sound];
    if L::LEVELS {
        let figure = Figure { value: Some(later.rmse_deg), limit: Some(WORSE * alone_deg + WORSE_DEG), unit: "°" };
        checks
            .push(Check::most(format!("{what}: later inclination RMSE"), figure, || format!("alone {alone_deg:.3}°")));
    }
    checks
}

/// What a stage did with the inputs up to the script's end.
struct Later {
    /// Inclination from [`SETTLED`] on, degrees.
    rmse_deg: f64,
    /// The first bad output.
    flaw: Option<String>,
}

fn later<L: Slot, S: Fills<L>>(stage: &mut S, inputs: &[(usize, L::Input)], what: &str) -> Later {
    let (mut errors_deg, mut flaw) = (Vec::new(), None);
    for (i, input) in inputs {
        let output = stage.step(input);
        flaw = flaw.or_else(|| unsound_at::<L, S>(&output, stage, what, *i));
        if *i >= SETTLED {
            errors_deg.push(inclination_deg(L::quaternion(&output), S1.ticks[*i].truth.quaternion()));
        }
    }
    Later { rmse_deg: rms(errors_deg.into_iter()), flaw }
}
