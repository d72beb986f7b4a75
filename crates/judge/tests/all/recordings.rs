//! Recordings and simulations, unchanged and with artificial errors.

use crate::common::{INPUT_ERRORS, diagnose, rate_hz, readings, recordings, scaled};
use judge::InputIssue;
use readings::source::Reading;
use scenario::Scenario;
use std::thread;

/// Prefixes of the recordings with rotation. The other recordings do not reveal errors in the axes.
const ROTATING_RECORDINGS: [&str; 5] = ["02_", "04_", "07_", "33_", "36_"];

#[recorded::test]
fn open_recordings_have_no_diagnosis_from_any_start() {
    thread::scope(|scope| {
        for path in recordings() {
            scope.spawn(move || {
                let readings = readings(&path);
                let rate_hz = rate_hz(&readings);
                let seconds = (readings[readings.len() - 1].t_ns - readings[0].t_ns) / 1_000_000_000;
                for from_s in (0..seconds).step_by(10) {
                    let start_ns = readings[0].t_ns + from_s * 1_000_000_000;
                    let rest = readings.iter().copied().filter(|reading| reading.t_ns >= start_ns);
                    let found = diagnose(rest, rate_hz);
                    assert!(found.is_empty(), "{} from {from_s} s: {found:#?}", path.display());
                }
            });
        }
    });
}

#[test]
fn simulations_have_no_diagnosis() {
    for name in Scenario::NAMES {
        for seed in 1..=5 {
            for rate_hz in [100.0, 1000.0] {
                let scenario = Scenario::parse(&format!("{name}?seed={seed}&rate_hz={rate_hz}&duration_s=60")).unwrap();
                let readings = scenario.readings().map(|(t_s, reading)| Reading {
                    t_ns: (t_s * 1e9) as i64,
                    rate_rad_s: reading.rate_rad_s.into(),
                    force_m_s2: reading.force_m_s2.into(),
                    field_ut: reading.field_ut.map(Into::into),
                    fix: None,
                    reference: None,
                });
                let found = diagnose(readings, rate_hz);
                assert!(found.is_empty(), "{name} {seed} {rate_hz}: {found:#?}");
            }
        }
    }
}

#[recorded::test]
fn each_input_error_is_diagnosed() {
    let mut failures = Vec::new();
    for path in recordings() {
        let file = path.file_name().unwrap().to_string_lossy().into_owned();
        if !ROTATING_RECORDINGS.iter().any(|start| file.starts_with(start)) {
            continue;
        }
        let readings = readings(&path);
        for (name, change, issue, cause) in INPUT_ERRORS {
            let changed: Vec<_> = readings.iter().map(|reading| change(*reading)).collect();
            let rate_hz = rate_hz(&changed);
            let found = diagnose(changed, rate_hz);
            let diagnosed = found.iter().find(|(_, diagnosis)| {
                diagnosis.issue == issue && diagnosis.causes.iter().any(|possible| possible.cause.contains(cause))
            });
            if let Some((at_s, diagnosis)) = diagnosed {
                println!("{file:.12} {name}: at {at_s:.0} s, {}", diagnosis.causes[0].cause);
            }
            if diagnosed.is_none() || found.len() > 1 {
                failures.push(format!("{file}: {name}: {found:#?}"));
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// Removes gravity from the force. The result is the "linear" or "user" acceleration that phones
/// report.
fn without_gravity(reading: Reading) -> Reading {
    let Some(truth) = reading.reference else { return reading };
    let [w, x, y, z] = truth.quaternion;
    // Third row of the rotation matrix: the up direction in sensor axes.
    let up = [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)];
    let force_m_s2 = std::array::from_fn(|axis| reading.force_m_s2[axis] - 9.81 * up[axis]);
    Reading { force_m_s2, ..reading }
}

/// Input error: its name, the recordings that reveal it, its effect on the readings, and the
/// expected issue.
type InputError = (&'static str, &'static [&'static str], fn(Vec<Reading>) -> Vec<Reading>, InputIssue);

const ALL_RECORDINGS: &[&str] = &["02_", "04_", "07_", "11_", "15_", "24_", "27_", "29_", "33_", "36_"];

const INPUT_ERRORS_BY_RECORDING: [InputError; 7] = [
    (
        "gravity removed",
        ALL_RECORDINGS,
        |all| all.into_iter().map(without_gravity).collect(),
        InputIssue::GravityRemoved,
    ),
    (
        "readings that came twice",
        ALL_RECORDINGS,
        |all| all.into_iter().enumerate().flat_map(|(at, it)| vec![it; 1 + usize::from(at % 10 == 0)]).collect(),
        InputIssue::Timestamps,
    ),
    (
        "readings out of order",
        ALL_RECORDINGS,
        |mut all| {
            (10..all.len()).step_by(20).for_each(|at| all.swap(at - 1, at));
            all
        },
        InputIssue::Timestamps,
    ),
    (
        "a gyro with too small a range",
        &["07_"],
        |all| {
            let clipped = |x: f64| x.clamp(-2.5, 2.5);
            all.into_iter().map(|it| Reading { rate_rad_s: it.rate_rad_s.map(clipped), ..it }).collect()
        },
        InputIssue::RateClipped,
    ),
    (
        "an accelerometer with too small a range",
        &["15_"],
        |all| {
            let clipped = |x: f64| x.clamp(-16.0, 16.0);
            all.into_iter().map(|it| Reading { force_m_s2: it.force_m_s2.map(clipped), ..it }).collect()
        },
        InputIssue::ForceClipped,
    ),
    (
        "rates in °/s",
        ALL_RECORDINGS,
        |all| all.into_iter().map(|it| Reading { rate_rad_s: it.rate_rad_s.map(f64::to_degrees), ..it }).collect(),
        InputIssue::RateUnit,
    ),
    (
        "forces in g",
        ALL_RECORDINGS,
        |all| all.into_iter().map(|it| Reading { force_m_s2: scaled(it.force_m_s2, 1.0 / 9.80665), ..it }).collect(),
        InputIssue::ForceUnit,
    ),
];

#[recorded::test]
fn errors_visible_at_rest_are_diagnosed_in_every_recording() {
    let mut failures = Vec::new();
    for path in recordings() {
        let file = path.file_name().unwrap().to_string_lossy().into_owned();
        let all = readings(&path);
        let rate_hz = rate_hz(&all);
        for (name, files, apply, issue) in INPUT_ERRORS_BY_RECORDING {
            if !files.iter().any(|start| file.starts_with(start)) {
                continue;
            }
            let found = diagnose(apply(all.clone()), rate_hz);
            let diagnosed = found.iter().find(|(_, diagnosis)| diagnosis.issue == issue);
            match diagnosed {
                Some((at_s, _)) => println!("{file:.12} {name}: at {at_s:.0} s"),
                None => failures.push(format!("{file}: {name}: {found:#?}")),
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}
