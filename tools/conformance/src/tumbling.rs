//! Tumbling through the inverted attitude: charts change, the attitude does not jump.

use attitude::Vector3;
use scenario::{Errors, Motion};

use crate::{
    report::{Check, Figure},
    run::{angle_deg, inclination_deg},
    script::Script,
    slot::{Fills, Slot},
};

const RATE_RAD_S: f64 = 4.0;
const SAMPLE_RATE_HZ: f64 = 200.0;
const DURATION_S: f64 = 20.0;
/// Steps may be longer than the body's turn by this factor.
const LONGER: f64 = 1.5;
/// Largest inclination error with exact sensors, degrees: a gradient of fixed length never rests.
const ERROR_DEG: f64 = 2.0;

pub(crate) fn checks<L: Slot, S: Fills<L>>(make: &impl Fn() -> S) -> Vec<Check> {
    let axes =
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -2.0, 3.0], [-0.3, 0.9, 0.01], [0.0, 0.0, 1.0]];
    let (mut worst_step, mut worst_error, mut switches) = ((0.0, String::new()), (0.0, String::new()), 0);
    for axis in axes {
        let rate_rad_s = Vector3::from(axis).normalize() * RATE_RAD_S;
        let name = format!("about {axis:?}");
        let script = Script::new(&name, Motion::Tumble(rate_rad_s), Errors::default(), SAMPLE_RATE_HZ, DURATION_S);
        let mut stage = make();
        let mut before = None;
        for (i, input) in L::inputs(&script) {
            let output = stage.step(&input);
            let (q, heads) = (L::quaternion(&output), L::heading(&output).is_some());
            let truth = script.ticks[i].truth;
            if let Some((q_before, truth_before)) = before {
                // The other sign of a quaternion is the same attitude, and a jump for whoever interpolates.
                let jumps = L::SIGNED && q.dot(&q_before) < 0.0;
                let step_deg = match (jumps, heads) {
                    (true, _) => 360.0,
                    (false, true) => angle_deg(q, q_before),
                    (false, false) => inclination_deg(q, q_before),
                };
                note(&mut worst_step, step_deg, &name, i);
                switches += u64::from(truth.up.chart != truth_before);
            }
            before = Some((q, truth.up.chart));
            note(&mut worst_error, inclination_deg(q, truth.quaternion()), &name, i);
        }
    }
    let limit_deg = (LONGER * RATE_RAD_S / SAMPLE_RATE_HZ).to_degrees();
    let figure = |value, limit| Figure { value: Some(value), limit, unit: "°" };
    let mut checks = vec![Check::holds(
        "tumbling leads through both charts",
        (switches < 50).then(|| format!("only {switches} changes of chart")),
    )];
    checks.push(Check::most("tumbling: longest step of the attitude", figure(worst_step.0, Some(limit_deg)), || {
        worst_step.1.clone()
    }));
    let limit = L::LEVELS.then_some(ERROR_DEG);
    checks.push(Check::most(
        "tumbling: largest inclination error with exact sensors",
        figure(worst_error.0, limit),
        || worst_error.1.clone(),
    ));
    checks
}

/// Keeps the largest value and where it was.
fn note(worst: &mut (f64, String), value: f64, name: &str, i: usize) {
    if value > worst.0 || value.is_nan() {
        *worst = (value, format!("{name}, tick {i}"));
    }
}
