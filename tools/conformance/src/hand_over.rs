//! Checks that a stage continues from the common state of any other stage of the slot.

use crate::{
    budget::Budget,
    report::{Check, Measurement},
    run::{angle_deg, describe_invalid_output, inclination_deg, rms},
    script::S1,
    slot::{SlotSpec, SlotStage},
};

/// Number of inputs before the hand-over.
const HAND_OVER_INPUT: usize = 4000;
/// Index of the first tick at which the receiving stage has settled.
const SETTLED_INPUT: usize = 8000;
/// Largest difference between the attitudes of the two stages on the first tick after the
/// hand-over, degrees.
const MAX_JUMP_DEG: f64 = 0.5;
/// Largest ratio of the receiving stage's error to its error without a hand-over.
const MAX_ERROR_FACTOR: f64 = 1.5;
/// Allowance added to the error limit, degrees.
const ERROR_MARGIN_DEG: f64 = 0.05;

pub(crate) fn checks<L: SlotSpec, S: SlotStage<L>>(make: &impl Fn() -> S, budget: &Budget<'_>) -> Vec<Check> {
    if !budget.starts("hand-over") {
        return Vec::new();
    }
    let own = make().name();
    let others = || {
        L::SLOT.stages().iter().filter(move |name| **name != own).filter_map(|name| Some((*name, L::from_name(name)?)))
    };
    let mut checks = Vec::new();
    let inputs = L::inputs(&S1);
    let mut donor = make();
    step_all::<L, S>(&mut donor, &inputs[..HAND_OVER_INPUT]);
    for (name, other) in budget.cases(others()) {
        let rmse_deg = undisturbed_rmse_deg::<L, L::BuiltIn>(other.clone(), &inputs);
        checks.extend(check_hand_over::<L, S, L::BuiltIn>(
            &donor,
            &other,
            &inputs,
            rmse_deg,
            &format!("hand-over to {name}"),
        ));
    }
    let rmse_deg = undisturbed_rmse_deg::<L, S>(make(), &inputs);
    for (name, mut other) in budget.cases(others()) {
        step_all::<L, L::BuiltIn>(&mut other, &inputs[..HAND_OVER_INPUT]);
        checks.extend(check_hand_over::<L, L::BuiltIn, S>(
            &other,
            &make(),
            &inputs,
            rmse_deg,
            &format!("hand-over from {name}"),
        ));
    }
    checks.extend(check_hand_over::<L, S, S>(&donor, &make(), &inputs, rmse_deg, "hand-over to itself"));
    checks
}

fn step_all<L: SlotSpec, S: SlotStage<L>>(stage: &mut S, inputs: &[(usize, L::Input)]) {
    inputs.iter().for_each(|(_, input)| {
        stage.step(input);
    });
}

/// Returns the inclination RMSE in degrees of a stage that processes all inputs without a
/// hand-over. The settling time is not included. Returns 0 if stages of the slot need not report
/// the exact inclination.
fn undisturbed_rmse_deg<L: SlotSpec, S: SlotStage<L>>(mut stage: S, inputs: &[(usize, L::Input)]) -> f64 {
    if L::HAS_EXACT_LEVEL { run_to_end::<L, S>(&mut stage, inputs, "without hand-over").rmse_deg } else { 0.0 }
}

/// Checks a hand-over from `donor` to the new stage `receiver`. The donor must have processed all
/// inputs before [`HAND_OVER_INPUT`].
fn check_hand_over<L: SlotSpec, G: SlotStage<L>, R: SlotStage<L>>(
    donor: &G,
    receiver: &R,
    inputs: &[(usize, L::Input)],
    undisturbed_rmse_deg: f64,
    name: &str,
) -> Vec<Check> {
    let (mut donor, mut receiver) = (donor.clone(), receiver.clone());
    if let Err(error) = receiver.adopt(&donor.common()) {
        return vec![Check::property(name, Some(error.to_string()))];
    }
    let (_, next) = &inputs[HAND_OVER_INPUT];
    let (expected, actual) = (donor.step(next), receiver.clone().step(next));
    // If only the receiving stage has a north reference, it re-initialises the heading. In that
    // case, only the inclinations are compared.
    let heading = L::heading_reference(&expected).filter(|reference| L::heading_reference(&actual) == Some(*reference));
    let angle = if heading.is_some() { angle_deg } else { inclination_deg };
    let (expected, actual) = (L::quaternion(&expected), L::quaternion(&actual));
    let jump = Measurement { value: Some(angle(expected, actual)), limit: Some(MAX_JUMP_DEG), unit: "°" };
    let jump = Check::at_most(format!("{name}: the attitude is continuous"), jump, || {
        format!("inclination: {:.3}°", inclination_deg(expected, actual))
    });
    let result = run_to_end::<L, R>(&mut receiver, &inputs[HAND_OVER_INPUT..], name);
    let valid = Check::property(format!("{name}: outputs are valid"), result.invalid_output);
    let mut checks = vec![jump, valid];
    if L::HAS_EXACT_LEVEL {
        let rmse = Measurement {
            value: Some(result.rmse_deg),
            limit: Some(MAX_ERROR_FACTOR * undisturbed_rmse_deg + ERROR_MARGIN_DEG),
            unit: "°",
        };
        checks.push(Check::at_most(format!("{name}: inclination RMSE afterwards"), rmse, || {
            format!("without hand-over {undisturbed_rmse_deg:.3}°")
        }));
    }
    checks
}

/// Result of a run to the end of the script.
struct RunResult {
    /// Inclination RMSE from [`SETTLED_INPUT`] on, degrees.
    rmse_deg: f64,
    /// First invalid output.
    invalid_output: Option<String>,
}

fn run_to_end<L: SlotSpec, S: SlotStage<L>>(stage: &mut S, inputs: &[(usize, L::Input)], name: &str) -> RunResult {
    let (mut errors_deg, mut invalid_output) = (Vec::new(), None);
    for (i, input) in inputs {
        let output = stage.step(input);
        invalid_output = invalid_output.or_else(|| describe_invalid_output::<L, S>(&output, stage, name, *i));
        if *i >= SETTLED_INPUT {
            errors_deg.push(inclination_deg(L::quaternion(&output), S1.ticks[*i].truth.quaternion()));
        }
    }
    RunResult { rmse_deg: rms(errors_deg.into_iter()), invalid_output }
}
