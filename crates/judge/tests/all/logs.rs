//! Logs from PX4 and from a real flight, unchanged and with errors that are visible in their
//! motion.
//!
//! Errors of the gyro's axes are visible only while the direction of gravity changes in body axes.
//! Rest and the coordinated turns of an aeroplane do not show them.

use crate::common::{INPUT_ERRORS, data, diagnose, rate_hz, readings};
use judge::InputIssue;
use readings::source::Reading;

/// Names of the errors that are visible in any motion.
const ALWAYS_VISIBLE: [&str; 9] = [
    "forces in g",
    "times in ms",
    "times in µs",
    "fields in gauss",
    "fields in nT",
    "fields in mT",
    "a negated accelerometer",
    "axes forward, right, down",
    "a sensor mounted upside down",
];

/// Logs. Each entry contains the file, the tenth of the log at which reading starts (counted from
/// 0), and the errors that are visible in addition to [`ALWAYS_VISIBLE`].
const LOGS: [(&str, usize, &[&str]); 3] = [
    // This log covers a few seconds in flight and some time on the ground.
    ("logs/px4_sample.ulg", 0, &["rates in °/s"]),
    // This log is seven seconds long.
    ("logs/px4_small.ulg", 0, &[]),
    // The flight begins after seven tenths of the log.
    ("flights/apm_plane_log2_imu.csv.gz", 7, &["rates in °/s", "an axis stuck"]),
];

/// Returns the readings of a log, or `None` if the file does not exist.
fn log(name: &str) -> Option<Vec<Reading>> {
    let path = data().join(name);
    if !path.is_file() {
        eprintln!("skipped: no {}; set PLUMBLINE_DATA", path.display());
        return None;
    }
    let folder = tempfile::tempdir().unwrap();
    let imported = folder.path().join("log_imu.csv");
    if name.ends_with(".ulg") {
        import::convert(&[path], &import::Options::default(), &imported, &mut |_| {}).unwrap();
        return Some(readings(&imported));
    }
    Some(readings(&path))
}

/// Returns the readings from the given tenth of the log on, counted from 0.
fn from_tenth(readings: &[Reading], tenth: usize) -> &[Reading] {
    &readings[readings.len() * tenth / 10..]
}

#[recorded::test]
fn logs_have_no_diagnosis_from_any_start() {
    for (name, ..) in LOGS {
        let Some(all) = log(name) else { continue };
        for tenth in 0..10 {
            let found = diagnose(from_tenth(&all, tenth).to_vec(), rate_hz(&all));
            assert!(found.is_empty(), "{name} from {tenth}/10: {found:#?}");
        }
    }
}

#[recorded::test]
fn errors_visible_in_the_motion_are_diagnosed() {
    let mut failures = Vec::new();
    for (name, tenth, visible) in LOGS {
        let Some(all) = log(name) else { continue };
        let is_visible = |error: &&str| ALWAYS_VISIBLE.contains(error) || visible.contains(error);
        for (error, change, issue, cause) in INPUT_ERRORS.into_iter().filter(|(error, ..)| is_visible(error)) {
            let changed: Vec<_> = from_tenth(&all, tenth).iter().map(|reading| change(*reading)).collect();
            let rate_hz = rate_hz(&changed);
            let found = diagnose(changed, rate_hz);
            let diagnosed = found.iter().find(|(_, diagnosis)| {
                diagnosis.issue == issue && diagnosis.causes.iter().any(|possible| possible.cause.contains(cause))
            });
            match diagnosed {
                Some((at_s, diagnosis)) => println!("{name} {error}: at {at_s:.0} s, {}", diagnosis.causes[0].cause),
                None => failures.push(format!("{name}: {error}: {found:#?}")),
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[recorded::test]
fn unordered_timestamps_and_small_range_are_diagnosed() {
    let every = |all: &[Reading], step: usize| (step..all.len()).step_by(step).collect::<Vec<_>>();
    for (name, tenth, _) in LOGS {
        let Some(all) = log(name) else { continue };
        let all = from_tenth(&all, tenth);
        let mut swapped = all.to_vec();
        every(all, 20).into_iter().for_each(|at| swapped.swap(at - 1, at));
        let twice = all.iter().enumerate().flat_map(|(at, it)| vec![*it; 1 + usize::from(at % 10 == 0)]).collect();
        for (error, readings) in [("out of order", swapped), ("twice", twice)] {
            let found = diagnose(readings, rate_hz(all));
            assert!(found.iter().any(|(_, it)| it.issue == InputIssue::Timestamps), "{name} {error}: {found:#?}");
        }
    }
    let Some(flight) = log("flights/apm_plane_log2_imu.csv.gz") else { return };
    let clipped = |it: &Reading| Reading { force_m_s2: it.force_m_s2.map(|x| x.clamp(-16.0, 16.0)), ..*it };
    let found = diagnose(from_tenth(&flight, 7).iter().map(clipped), rate_hz(&flight));
    assert!(found.iter().any(|(_, it)| it.issue == InputIssue::ForceClipped), "{found:#?}");
}
