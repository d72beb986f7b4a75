//! Logs of PX4 and a real flight, as they are and with the mistakes that their motion shows.
//!
//! Which axis of the gyro is which shows where gravity turns in the body: not at rest, and not in the coordinated turns of an aeroplane.

use crate::common::{MISTAKES, data, judged, rate_hz, readings};
use ingest::source::Reading;
use judge::Mistake;

/// What is wrong whatever the motion.
const ALWAYS: [&str; 9] = [
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

/// A log, from which of its tenths on, and what is named beside that.
const LOGS: [(&str, usize, &[&str]); 3] = [
    // Some seconds of flight, then on the ground.
    ("logs/px4_sample.ulg", 0, &["rates in °/s"]),
    // Seven seconds.
    ("logs/px4_small.ulg", 0, &[]),
    // From the flight on.
    ("flights/apm_plane_log2_imu.csv.gz", 7, &["rates in °/s", "an axis stuck"]),
];

/// The readings of a log; none where there is no such file.
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

/// From that tenth on.
fn from(readings: &[Reading], tenth: usize) -> &[Reading] {
    &readings[readings.len() * tenth / 10..]
}

#[test]
fn logs_are_silent_wherever_one_begins() {
    for (name, ..) in LOGS {
        let Some(all) = log(name) else { continue };
        for tenth in 0..10 {
            let found = judged(from(&all, tenth).to_vec(), rate_hz(&all));
            assert!(found.is_empty(), "{name} from {tenth}/10: {found:#?}");
        }
    }
}

#[test]
fn mistakes_that_the_motion_shows_are_named() {
    let mut failures = Vec::new();
    for (name, tenth, beside) in LOGS {
        let Some(all) = log(name) else { continue };
        let shown = |made: &&str| ALWAYS.contains(made) || beside.contains(made);
        for (made, change, mistake, cause) in MISTAKES.into_iter().filter(|(made, ..)| shown(made)) {
            let changed: Vec<_> = from(&all, tenth).iter().map(|reading| change(*reading)).collect();
            let rate_hz = rate_hz(&changed);
            let found = judged(changed, rate_hz);
            let named = found.iter().find(|(_, finding)| {
                finding.mistake == mistake && finding.candidates.iter().any(|candidate| candidate.cause.contains(cause))
            });
            match named {
                Some((at_s, finding)) => println!("{name} {made}: at {at_s:.0} s, {}", finding.candidates[0].cause),
                None => failures.push(format!("{name}: {made}: {found:#?}")),
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
fn stamps_in_disorder_and_a_range_that_is_too_small_are_named() {
    let every = |all: &[Reading], step: usize| (step..all.len()).step_by(step).collect::<Vec<_>>();
    for (name, tenth, _) in LOGS {
        let Some(all) = log(name) else { continue };
        let all = from(&all, tenth);
        let mut swapped = all.to_vec();
        every(all, 20).into_iter().for_each(|at| swapped.swap(at - 1, at));
        let twice = all.iter().enumerate().flat_map(|(at, it)| vec![*it; 1 + usize::from(at % 10 == 0)]).collect();
        for (made, readings) in [("out of order", swapped), ("twice", twice)] {
            let found = judged(readings, rate_hz(all));
            assert!(found.iter().any(|(_, it)| it.mistake == Mistake::Stamps), "{name} {made}: {found:#?}");
        }
    }
    let Some(flight) = log("flights/apm_plane_log2_imu.csv.gz") else { return };
    let clipped = |it: &Reading| Reading { force_m_s2: it.force_m_s2.map(|x| x.clamp(-16.0, 16.0)), ..*it };
    let found = judged(from(&flight, 7).iter().map(clipped), rate_hz(&flight));
    assert!(found.iter().any(|(_, it)| it.mistake == Mistake::ForceClipped), "{found:#?}");
}
