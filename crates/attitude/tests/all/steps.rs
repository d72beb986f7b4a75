//! Steps of the attitude that are not the body's, on recordings: what a tick changes beyond the gyro's turn is either small or announced.
//!
//! Input: a multicopter's log (PX4), the trials of BROAD, an aerobatic flight. Output: the largest unannounced step. Time: the
//! recordings' own. Failure: without the recordings nothing is tested, and the test says so.
//!
//! It holds for stages that keep a level and correct it by what they find out. `wz-closed`, `wz-open`, `madgwick` and `vqf` follow each
//! sample of the accelerometer: what they do in a tick is in proportion to what it reads.
use std::path::{Path, PathBuf};

use attitude::{
    Vector3,
    accel::Projector,
    fuser::{Fused, Fuser, FuserInput},
    gnss::Fix,
    gyro::{Gyro, Motion, RateKind, RateSample},
    stage::Stage,
    rotation::Rotation,
};
use recording::{Reader, gnss::FixReader};

use crate::common::ulog;

/// Largest unannounced step, degrees.
const STEP_DEG: f64 = 0.05;
const FUSERS: [&str; 6] = ["wz", "multiple-model", "aided", "levelling", "levelling-unified", "levelling-pi"];

struct Sample {
    t_s: f64,
    rate_rad_s: Vector3<f64>,
    force_m_s2: Vector3<f64>,
    field_ut: Option<Vector3<f64>>,
    fix: Option<Fix>,
}

/// The file of that name; `None`, and a word on the standard error, where there are no recordings.
fn data(name: &str) -> Option<PathBuf> {
    let set = std::env::var_os("PLUMBLINE_DATA").map(PathBuf::from);
    let path =
        set.clone().unwrap_or_else(|| concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data").into()).join(name);
    let there = path.exists();
    assert!(there || set.is_none(), "no recording at {}", path.display());
    if !there {
        eprintln!("skipped: no recording at {} (PLUMBLINE_DATA names another place)", path.display());
    }
    there.then_some(path)
}

fn multicopter() -> Option<Vec<Sample>> {
    let log = std::fs::read(data("logs/px4_sample.ulg")?).unwrap();
    let sample = |sample: ulog::Sample| Sample {
        t_s: sample.t_s,
        rate_rad_s: sample.rate_rad_s,
        force_m_s2: sample.force_m_s2,
        field_ut: None,
        fix: None,
    };
    Some(ulog::samples(&log).into_iter().map(sample).collect())
}

/// A recording with the fixes of a file beside it.
fn recorded(path: &Path, mut fixes: Option<FixReader>) -> Vec<Sample> {
    let sample = |row: Result<recording::Row, _>| {
        let row = row.unwrap();
        let fix = fixes.as_mut().and_then(|fixes| fixes.latest_until(row.t_ns).unwrap());
        Sample {
            t_s: row.t_ns as f64 * 1e-9,
            rate_rad_s: row.rate_rad_s.into(),
            force_m_s2: row.force_m_s2.into(),
            field_ut: row.field_ut.map(Vector3::from),
            fix: fix.map(|fix| Fix {
                velocity_m_s: fix.velocity_m_s.into(),
                sd_m_s: None,
                age_s: None,
                latitude_rad: fix.latitude_deg.map(f64::to_radians),
            }),
        }
    };
    Reader::open(path).unwrap().map(sample).collect()
}

/// Runs a fuser; each tick's time, motion and output.
fn run(name: &str, samples: &[Sample], magnetic: bool, mut see: impl FnMut(f64, &Motion, &Fused)) {
    let (mut gyro, mut accel, mut fuser) =
        (Gyro::from_name("mobius").unwrap(), Projector::default(), Fuser::from_name(name).unwrap());
    let mut before_s = samples[0].t_s;
    for sample in samples {
        let (rate_rad_s, dt_s) = (sample.rate_rad_s, sample.t_s - before_s);
        before_s = sample.t_s;
        let motion = gyro.step(&RateSample { rate_rad_s, dt_s, kind: RateKind::Mean });
        let out = fuser.step(&FuserInput {
            motion: Some(motion),
            inclination: Some(accel.step(&sample.force_m_s2)),
            field_ut: sample.field_ut.filter(|_| magnetic),
            fix: sample.fix,
            rest_credible: true,
            rate_credible: true,
        });
        see(sample.t_s - samples[0].t_s, &motion, &out);
    }
}

/// The largest of a run, degrees, and when it was, s.
#[derive(Debug, Clone, Copy, Default)]
struct Worst {
    /// What a tick turned beyond the gyro's turn.
    correction: (f64, f64),
    /// By how much that differs from the tick before.
    change: (f64, f64),
    announced: u64,
}

fn worst(name: &str, samples: &[Sample], magnetic: bool) -> Worst {
    let (mut worst, mut before, mut correction_before) = (Worst::default(), None::<Fused>, None::<Vector3<f64>>);
    let note = |most: &mut (f64, f64), rotation: Vector3<f64>, t_s| {
        let deg = rotation.norm().to_degrees();
        *most = if deg > most.0 { (deg, t_s) } else { *most };
    };
    run(name, samples, magnetic, |t_s, motion, out| {
        let told = out.corrections.aligned;
        worst.announced += u64::from(told);
        let correction = before.filter(|_| !told).map(|before| {
            let turn = Rotation::from_rotation_vector((motion.rate_rad_s - before.bias_rad_s) * motion.dt_s);
            let expected = before.attitude.quaternion() * turn.quaternion();
            let rest = out.attitude.quaternion() * expected.conjugate();
            rest.imag() * (2.0 * rest.w.signum())
        });
        if let Some(correction) = correction {
            note(&mut worst.correction, correction, t_s);
            if let Some(earlier) = correction_before {
                note(&mut worst.change, correction - earlier, t_s);
            }
        }
        (before, correction_before) = (Some(*out), correction);
    });
    println!("{name}, field {magnetic}: {worst:.3?}");
    worst
}

#[test]
fn no_tick_of_a_multicopters_log_turns_the_attitude_unannounced() {
    let Some(samples) = multicopter() else { return };
    for name in FUSERS {
        let worst = worst(name, &samples, false);
        assert!(worst.correction.0 < STEP_DEG, "{name}: {worst:?}");
    }
}

#[test]
fn no_tick_of_broad_turns_the_attitude_unannounced() {
    let Some(folder) = data("broad") else { return };
    let mut paths: Vec<_> = folder.read_dir().unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "gz"));
    paths.sort();
    for path in paths {
        println!("{}", path.display());
        let samples = recorded(&path, None);
        for (name, magnetic) in FUSERS.map(|name| (name, false)).into_iter().chain([("wz", true), ("aided", true)]) {
            let worst = worst(name, &samples, magnetic);
            assert!(worst.correction.0 < STEP_DEG, "{name}, {}: {worst:?}", path.display());
        }
    }
}

/// At 50 Hz, in aerobatics, the levelling alone leans by more in a tick, but from tick to tick by nearly the same. That is so of `wz`; the
/// others change by as much as they are known to.
#[test]
fn no_tick_of_an_aerobatic_flight_turns_the_attitude_unannounced() {
    let Some(path) = data("flights/apm_plane_log2_imu.csv.gz") else { return };
    let fixes = FixReader::open(&data("flights/apm_plane_log2_gnss.csv").unwrap()).unwrap();
    let samples = recorded(&path, Some(fixes));
    for (name, magnetic) in FUSERS.map(|name| (name, false)).into_iter().chain([("wz", true), ("aided", true)]) {
        let worst = worst(name, &samples, magnetic);
        let limit_deg = match name {
            "wz" | "aided" | "multiple-model" => 2.0 * STEP_DEG,
            "levelling-pi" => 0.5,
            // The level of `levelling`, and a step of the complex course.
            "levelling-unified" => 1.0,
            _ => 0.9,
        };
        assert!(worst.change.0 < limit_deg, "{name}: {worst:?}");
    }
}

/// Rest is found at 8.05 s, after a movement that left the bias wrong by 0.16 °/s.
#[test]
fn the_bias_at_rest_does_not_take_the_level_from_the_mean_accelerometer() {
    const REST_S: core::ops::Range<f64> = 7.0..9.0;
    let Some(samples) = multicopter() else { return };
    let resting = samples.iter().filter(|sample| REST_S.contains(&(sample.t_s - samples[0].t_s)));
    let mean = resting.fold(Vector3::zeros(), |sum, sample| sum + sample.force_m_s2).normalize();
    let (mut found_s, mut before_deg, mut largest_deg) = (None, 0.0, 0f64);
    run("wz", &samples, false, |t_s, _, out| {
        let off_deg = out.attitude.horizontal(mean).norm_sqr().sqrt().to_degrees();
        if out.corrections.rest && found_s.is_none() {
            found_s = Some(t_s);
        }
        match found_s {
            None => before_deg = off_deg,
            Some(_) if t_s < 12.0 => largest_deg = largest_deg.max(off_deg),
            Some(_) => {}
        }
    });
    println!("at rest from {found_s:?} s; off by {before_deg:.3}° before, {largest_deg:.3}° at most after");
    assert!(found_s.is_some_and(|found_s| (8.0..8.1).contains(&found_s)), "{found_s:?}");
    assert!(largest_deg < before_deg + 0.01, "{before_deg}° before, {largest_deg}° after");
}
