//! Tests on recordings that the attitude does not jump unless the body moves. At each tick, a fuser
//! may correct the rotation measured by the gyro only by a small step, or by a step that it flags.
//!
//! Input: log of a multicopter (PX4), trials of BROAD, an aerobatic flight.
//!
//! Output: largest step without a flag.
//!
//! Failure: without the recordings the tests are skipped with a message.
//!
//! The limit on the step applies to stages that keep a level and correct it gradually. `wz-closed`,
//! `wz-open`, `madgwick` and `vqf` follow each accelerometer sample, so their step is proportional
//! to the difference between the sample and the estimate.
use std::path::{Path, PathBuf};

use attitude::{
    Vector3,
    accel::Accelerometer,
    fuser::{Fused, Fuser, FuserInput},
    gnss::Fix,
    gyro::{Gyro, Motion, RateKind, RateSample},
    rotation::Rotation,
    stage::Stage,
};
use recording::{Reader, gnss::FixReader};

use crate::common::ulog;

/// Largest accepted step without a flag, degrees.
const MAX_STEP_DEG: f64 = 0.05;
const FUSERS: [&str; 6] = ["wz", "multiple-model", "aided", "levelling", "levelling-unified", "levelling-pi"];

struct Sample {
    t_s: f64,
    rate_rad_s: Vector3<f64>,
    force_m_s2: Vector3<f64>,
    field_ut: Option<Vector3<f64>>,
    fix: Option<Fix>,
}

/// Returns the path of a recording.
///
/// Returns `None` and prints a message to standard error if the recording is missing.
fn data(name: &str) -> Option<PathBuf> {
    let data_folder = std::env::var_os("PLUMBLINE_DATA").map(PathBuf::from);
    let path = data_folder
        .clone()
        .unwrap_or_else(|| concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data").into())
        .join(name);
    let exists = path.exists();
    assert!(exists || data_folder.is_none(), "no recording at {}", path.display());
    if !exists {
        eprintln!("skipped: no recording at {}; set PLUMBLINE_DATA to the folder of the recordings", path.display());
    }
    exists.then_some(path)
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

/// Reads a recording together with the fixes from the accompanying file.
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

/// Runs a fuser and passes time (s), motion and output of each tick to `observe`.
fn run(name: &str, samples: &[Sample], magnetic: bool, mut observe: impl FnMut(f64, &Motion, &Fused)) {
    let (mut gyro, mut accel, mut fuser) =
        (Gyro::from_name("mobius").unwrap(), Accelerometer::default(), Fuser::from_name(name).unwrap());
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
        observe(sample.t_s - samples[0].t_s, &motion, &out);
    }
}

/// Largest values of a run in degrees, each with the time in seconds at which it occurred.
#[derive(Debug, Clone, Copy, Default)]
struct Worst {
    /// Rotation in a tick in excess of the rotation measured by the gyro.
    correction: (f64, f64),
    /// Change of the correction between consecutive ticks.
    change: (f64, f64),
    announced: u64,
}

fn worst(name: &str, samples: &[Sample], magnetic: bool) -> Worst {
    let (mut worst, mut before, mut correction_before) = (Worst::default(), None::<Fused>, None::<Vector3<f64>>);
    let note = |max: &mut (f64, f64), rotation: Vector3<f64>, t_s| {
        let deg = rotation.norm().to_degrees();
        *max = if deg > max.0 { (deg, t_s) } else { *max };
    };
    run(name, samples, magnetic, |t_s, motion, out| {
        let announced = out.corrections.aligned;
        worst.announced += u64::from(announced);
        let correction = before.filter(|_| !announced).map(|before| {
            let rotation = Rotation::from_rotation_vector((motion.rate_rad_s - before.bias_rad_s) * motion.dt_s);
            let expected = before.attitude.quaternion() * rotation.quaternion();
            let difference = out.attitude.quaternion() * expected.conjugate();
            difference.imag() * (2.0 * difference.w.signum())
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
fn multicopter_log_has_no_unannounced_step() {
    let Some(samples) = multicopter() else { return };
    for name in FUSERS {
        let worst = worst(name, &samples, false);
        assert!(worst.correction.0 < MAX_STEP_DEG, "{name}: {worst:?}");
    }
}

#[recorded::test]
fn broad_trials_have_no_unannounced_step() {
    let Some(folder) = data("broad") else { return };
    let mut paths: Vec<_> = folder.read_dir().unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "gz"));
    paths.sort();
    for path in paths {
        println!("{}", path.display());
        let samples = recorded(&path, None);
        for (name, magnetic) in FUSERS.map(|name| (name, false)).into_iter().chain([("wz", true), ("aided", true)]) {
            let worst = worst(name, &samples, magnetic);
            assert!(worst.correction.0 < MAX_STEP_DEG, "{name}, {}: {worst:?}", path.display());
        }
    }
}

/// At 50 Hz in aerobatics, the level correction exceeds `MAX_STEP_DEG` in one tick, but changes
/// little between ticks. Therefore, the change of the correction is limited instead: for `wz`,
/// `aided` and `multiple-model` to twice `MAX_STEP_DEG`, and for the others to a limit that their
/// known steps do not exceed.
#[recorded::test]
fn aerobatic_flight_has_no_unannounced_step() {
    let Some(path) = data("flights/apm_plane_log2_imu.csv.gz") else { return };
    let fixes = FixReader::open(&data("flights/apm_plane_log2_gnss.csv").unwrap()).unwrap();
    let samples = recorded(&path, Some(fixes));
    for (name, magnetic) in FUSERS.map(|name| (name, false)).into_iter().chain([("wz", true), ("aided", true)]) {
        let worst = worst(name, &samples, magnetic);
        let limit_deg = match name {
            "wz" | "aided" | "multiple-model" => 2.0 * MAX_STEP_DEG,
            "levelling-pi" => 0.5,
            // The limit of 0.9° for the level, as for `levelling`, plus an allowance for a step of
            // the complex course.
            "levelling-unified" => 1.0,
            _ => 0.9,
        };
        assert!(worst.change.0 < limit_deg, "{name}: {worst:?}");
    }
}

/// The body comes to rest after a movement. The fuser detects the rest at 8.05 s.
#[test]
fn bias_found_at_rest_does_not_disturb_level() {
    const REST_S: core::ops::Range<f64> = 7.0..9.0;
    let Some(samples) = multicopter() else { return };
    let resting = samples.iter().filter(|sample| REST_S.contains(&(sample.t_s - samples[0].t_s)));
    let mean = resting.fold(Vector3::zeros(), |sum, sample| sum + sample.force_m_s2).normalize();
    let (mut found_s, mut before_deg, mut largest_deg) = (None, 0.0, 0f64);
    run("wz", &samples, false, |t_s, _, out| {
        let error_deg = out.attitude.horizontal(mean).norm_sqr().sqrt().to_degrees();
        if out.corrections.rest && found_s.is_none() && t_s > REST_S.start {
            found_s = Some(t_s);
        }
        match found_s {
            None => before_deg = error_deg,
            Some(_) if t_s < 12.0 => largest_deg = largest_deg.max(error_deg),
            Some(_) => {}
        }
    });
    println!("at rest from {found_s:?} s; level error {before_deg:.3}° before, at most {largest_deg:.3}° after");
    assert!(found_s.is_some_and(|found_s| (8.0..8.1).contains(&found_s)), "{found_s:?}");
    assert!(largest_deg < before_deg + 0.01, "{before_deg}° before, {largest_deg}° after");
}
