//! Checks that the attitude of a tumbling body is continuous when the chart changes.

use attitude::Vector3;
use scenario::{Motion, SensorErrors};

use crate::{
    budget::Budget,
    report::{Check, Measurement},
    run::{angle_deg, inclination_deg},
    script::Script,
    slot::{SlotSpec, SlotStage},
};

const RATE_RAD_S: f64 = 4.0;
const SAMPLE_RATE_HZ: f64 = 200.0;
const DURATION_S: f64 = 20.0;
/// Minimum number of chart changes, counted over the rotations about all axes.
const MIN_CHART_CHANGES: u64 = 50;
/// Largest ratio of an attitude step to the body's rotation in one tick.
const MAX_STEP_FACTOR: f64 = 1.5;
/// Largest inclination error with exact sensors, degrees. The limit allows for the oscillation of
/// filters with a gradient step of fixed length.
const MAX_ERROR_DEG: f64 = 2.0;

pub(crate) fn checks<L: SlotSpec, S: SlotStage<L>>(make: &impl Fn() -> S, budget: &Budget<'_>) -> Vec<Check> {
    if !budget.starts("tumbling") {
        return Vec::new();
    }
    let axes =
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -2.0, 3.0], [-0.3, 0.9, 0.01], [0.0, 0.0, 1.0]];
    let (mut worst_step, mut worst_error, mut chart_changes) = ((0.0, String::new()), (0.0, String::new()), 0);
    let mut axes_run = 0;
    for axis in budget.cases(axes) {
        axes_run += 1;
        let rate_rad_s = Vector3::from(axis).normalize() * RATE_RAD_S;
        let name = format!("about {axis:?}");
        let script =
            Script::new(&name, Motion::Tumble(rate_rad_s), SensorErrors::default(), SAMPLE_RATE_HZ, DURATION_S);
        let mut stage = make();
        let mut previous = None;
        for (i, input) in L::inputs(&script) {
            let output = stage.step(&input);
            let (q, has_heading) = (L::quaternion(&output), L::heading_reference(&output).is_some());
            let truth = script.ticks[i].truth;
            if let Some((previous_q, previous_chart)) = previous {
                // The negated quaternion denotes the same attitude, but a change of sign breaks
                // interpolation. Such a change therefore counts as a step of 360°.
                let sign_jumps = L::HAS_CONTINUOUS_SIGN && q.dot(&previous_q) < 0.0;
                let step_deg = match (sign_jumps, has_heading) {
                    (true, _) => 360.0,
                    (false, true) => angle_deg(q, previous_q),
                    (false, false) => inclination_deg(q, previous_q),
                };
                keep_largest(&mut worst_step, step_deg, &name, i);
                chart_changes += u64::from(truth.up.chart != previous_chart);
            }
            previous = Some((q, truth.up.chart));
            keep_largest(&mut worst_error, inclination_deg(q, truth.quaternion()), &name, i);
        }
    }
    let min_changes = MIN_CHART_CHANGES * axes_run / axes.len() as u64;
    let limit_deg = (MAX_STEP_FACTOR * RATE_RAD_S / SAMPLE_RATE_HZ).to_degrees();
    let measurement = |value, limit| Measurement { value: Some(value), limit, unit: "°" };
    let mut checks = vec![Check::property(
        "tumbling passes through both charts",
        (chart_changes < min_changes)
            .then(|| format!("{chart_changes} chart changes, expected at least {min_changes}")),
    )];
    checks.push(Check::at_most("tumbling: largest attitude step", measurement(worst_step.0, Some(limit_deg)), || {
        worst_step.1.clone()
    }));
    let limit = L::HAS_EXACT_LEVEL.then_some(MAX_ERROR_DEG);
    checks.push(Check::at_most(
        "tumbling: largest inclination error with exact sensors",
        measurement(worst_error.0, limit),
        || worst_error.1.clone(),
    ));
    checks
}

/// Stores the value and its location if it is the largest so far or NaN.
fn keep_largest(worst: &mut (f64, String), value: f64, name: &str, tick: usize) {
    if value > worst.0 || value.is_nan() {
        *worst = (value, format!("{name}, tick {tick}"));
    }
}
