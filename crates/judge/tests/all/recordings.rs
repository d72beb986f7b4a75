//! Recordings and simulations as they are, and with mistakes made on purpose.

use crate::common::{MISTAKES, each, judged, rate_hz, readings, recordings};
use ingest::source::Reading;
use judge::Mistake;
use scenario::Scenario;
use std::thread;

/// Recordings with rotation: the others cannot tell the axes.
const ROTATING: [&str; 5] = ["02_", "04_", "07_", "33_", "36_"];

#[test]
fn open_recordings_are_silent_wherever_one_begins() {
    thread::scope(|scope| {
        for path in recordings() {
            scope.spawn(move || {
                let readings = readings(&path);
                let rate_hz = rate_hz(&readings);
                let seconds = (readings[readings.len() - 1].t_ns - readings[0].t_ns) / 1_000_000_000;
                for from_s in (0..seconds).step_by(10) {
                    let begins_ns = readings[0].t_ns + from_s * 1_000_000_000;
                    let part = readings.iter().copied().filter(|reading| reading.t_ns >= begins_ns);
                    let found = judged(part, rate_hz);
                    assert!(found.is_empty(), "{} from {from_s} s: {found:#?}", path.display());
                }
            });
        }
    });
}

#[test]
fn simulations_are_silent() {
    for name in Scenario::NAMES {
        for seed in 1..=5 {
            for rate_hz in [100.0, 1000.0] {
                let scenario = Scenario::named(&format!("{name}?seed={seed}&rate_hz={rate_hz}&duration_s=60")).unwrap();
                let readings = scenario.readings().map(|(t_s, reading)| Reading {
                    t_ns: (t_s * 1e9) as i64,
                    rate_rad_s: reading.rate_rad_s.into(),
                    force_m_s2: reading.force_m_s2.into(),
                    field_ut: reading.field_ut.map(Into::into),
                    fix: None,
                    reference: None,
                });
                let found = judged(readings, rate_hz);
                assert!(found.is_empty(), "{name} {seed} {rate_hz}: {found:#?}");
            }
        }
    }
}

#[test]
fn each_mistake_is_named() {
    let mut failures = Vec::new();
    for path in recordings() {
        let file = path.file_name().unwrap().to_string_lossy().into_owned();
        if !ROTATING.iter().any(|start| file.starts_with(start)) {
            continue;
        }
        let readings = readings(&path);
        for (made, change, mistake, cause) in MISTAKES {
            let changed: Vec<_> = readings.iter().map(|reading| change(*reading)).collect();
            let rate_hz = rate_hz(&changed);
            let found = judged(changed, rate_hz);
            let named = found.iter().find(|(_, finding)| {
                finding.mistake == mistake && finding.candidates.iter().any(|candidate| candidate.cause.contains(cause))
            });
            if let Some((at_s, finding)) = named {
                println!("{file:.12} {made}: at {at_s:.0} s, {}", finding.candidates[0].cause);
            }
            if named.is_none() || found.len() > 1 {
                failures.push(format!("{file}: {made}: {found:#?}"));
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// The force without gravity, as phones call it linear or user acceleration.
fn without_gravity(reading: Reading) -> Reading {
    let Some(truth) = reading.reference else { return reading };
    let [w, x, y, z] = truth.quaternion;
    // The third row of the rotation: up in the sensor's axes.
    let up = [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)];
    let force_m_s2 = std::array::from_fn(|axis| reading.force_m_s2[axis] - 9.81 * up[axis]);
    Reading { force_m_s2, ..reading }
}

/// The mistake, the recordings on which it shows, how it is made of their readings, and what is found.
type Made = (&'static str, &'static [&'static str], fn(Vec<Reading>) -> Vec<Reading>, Mistake);

const ALL: &[&str] = &["02_", "04_", "07_", "11_", "15_", "24_", "27_", "29_", "33_", "36_"];

const MADE: [Made; 7] = [
    ("gravity removed", ALL, |all| all.into_iter().map(without_gravity).collect(), Mistake::GravityRemoved),
    (
        "readings that came twice",
        ALL,
        |all| all.into_iter().enumerate().flat_map(|(at, it)| vec![it; 1 + usize::from(at % 10 == 0)]).collect(),
        Mistake::Stamps,
    ),
    (
        "readings out of order",
        ALL,
        |mut all| {
            (10..all.len()).step_by(20).for_each(|at| all.swap(at - 1, at));
            all
        },
        Mistake::Stamps,
    ),
    (
        "a gyro with too small a range",
        &["07_"],
        |all| {
            let clipped = |x: f64| x.clamp(-2.5, 2.5);
            all.into_iter().map(|it| Reading { rate_rad_s: it.rate_rad_s.map(clipped), ..it }).collect()
        },
        Mistake::RateClipped,
    ),
    (
        "an accelerometer with too small a range",
        &["15_"],
        |all| {
            let clipped = |x: f64| x.clamp(-16.0, 16.0);
            all.into_iter().map(|it| Reading { force_m_s2: it.force_m_s2.map(clipped), ..it }).collect()
        },
        Mistake::ForceClipped,
    ),
    (
        "rates in °/s",
        ALL,
        |all| all.into_iter().map(|it| Reading { rate_rad_s: it.rate_rad_s.map(f64::to_degrees), ..it }).collect(),
        Mistake::RateUnit,
    ),
    (
        "forces in g",
        ALL,
        |all| all.into_iter().map(|it| Reading { force_m_s2: each(it.force_m_s2, 1.0 / 9.80665), ..it }).collect(),
        Mistake::ForceUnit,
    ),
];

#[test]
fn mistakes_that_need_no_rotation_are_named_on_every_recording_and_soon() {
    let mut failures = Vec::new();
    for path in recordings() {
        let file = path.file_name().unwrap().to_string_lossy().into_owned();
        let all = readings(&path);
        let rate_hz = rate_hz(&all);
        for (made, files, make, mistake) in MADE {
            if !files.iter().any(|start| file.starts_with(start)) {
                continue;
            }
            let found = judged(make(all.clone()), rate_hz);
            let named = found.iter().find(|(_, finding)| finding.mistake == mistake);
            match named {
                Some((at_s, _)) => println!("{file:.12} {made}: at {at_s:.0} s"),
                None => failures.push(format!("{file}: {made}: {found:#?}")),
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}
