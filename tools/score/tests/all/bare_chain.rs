//! The program and the bare stages of the crate `attitude` have the same errors on a recording.
//!
//! The program checks the readings, numbers them, and joins the messages of its slots. On a
//! recording without faults, none of this may change the attitude.
//!
//! Input: `samples/broad.csv.gz`, and recordings in `$PLUMBLINE_DATA` or `../shared/data`.

use std::{
    fmt::Write,
    path::{Path, PathBuf},
};

use attitude::{
    Quaternion, Vector3,
    accel::Accelerometer,
    fuser::{Fuser, FuserInput},
    gyro::{Gyro, RateKind, RateSample},
    magnetometer::RepeatFilter,
    metrics::{Accuracy, AttitudeError},
    stage::Stage,
};
use recording::{Reader, Row};
use score::{Request, stages::StageSelection, table::Scores};

/// Stages to compare: the default stage, the main stage that it combines, and a published filter.
const FUSERS: [&str; 3] = ["multiple-model", "wz", "vqf"];
/// Recordings in the data folder, one per sensor.
const RECORDINGS: [&str; 4] = [
    "broad/33_disturbed_attached_magnet_2cm.csv.gz",
    "tumvi/room1.csv.gz",
    "phones/nexus5_calm_swinging.csv.gz",
    "phones/iphone5_calm_ar.csv.gz",
];
/// Largest accepted difference of an error, degrees.
const MAX_DIFFERENCE_DEG: f64 = 1e-9;

/// Returns the RMSE of the bare stages on a recording.
fn bare_errors(fuser: &str, path: &Path) -> AttitudeError {
    let mut gyro = Gyro::from_name("mobius").unwrap();
    let mut accel = Accelerometer::default();
    let mut fuser = Fuser::from_name(fuser).unwrap();
    let (mut repeat_filter, mut previous_ns, mut accuracy) = (RepeatFilter::default(), None, Accuracy::default());
    for row in Reader::open(path).unwrap() {
        let row = row.unwrap();
        let dt_s = (row.t_ns - previous_ns.replace(row.t_ns).unwrap_or(row.t_ns)) as f64 * 1e-9;
        let rate = RateSample { rate_rad_s: row.rate_rad_s.into(), dt_s, kind: RateKind::Mean };
        let fused = fuser.step(&FuserInput {
            motion: Some(gyro.step(&rate)),
            inclination: Some(accel.step(&row.force_m_s2.into())),
            field_ut: repeat_filter.new_sample(row.field_ut.map(Vector3::from)),
            fix: None,
            rest_credible: true,
            rate_credible: true,
        });
        if let Some(reference) = row.reference.filter(|reference| reference.scored) {
            let [w, x, y, z] = reference.quaternion;
            accuracy.add(AttitudeError::between(fused.attitude.quaternion(), Quaternion::new(w, x, y, z)));
        }
    }
    accuracy.rmse().unwrap()
}

/// Returns the errors of the program on recordings, per fuser and recording.
fn program_errors(fusers: &[&str], paths: &[PathBuf]) -> Scores {
    let request = Request {
        files: paths.iter().map(|path| path.to_str().unwrap().to_owned()).collect(),
        files_with_axes: vec![],
        selection: StageSelection {
            fusers: fusers.iter().map(ToString::to_string).collect(),
            ..StageSelection::default()
        },
        ..Request::default()
    };
    score::run(&request, &mut |_, _| {}).unwrap()
}

/// Asserts that the program and the bare stages have the same errors on every recording.
fn assert_equal_errors(paths: &[PathBuf]) {
    for stage in &program_errors(&FUSERS, paths).stages {
        for (path, trial) in paths.iter().zip(&stage.trials) {
            let AttitudeError { total_deg, heading_deg, inclination_deg } = bare_errors(&stage.fuser, path);
            let pairs = [
                (trial.error.attitude.total, total_deg),
                (trial.error.attitude.heading, heading_deg),
                (trial.error.attitude.inclination, inclination_deg),
            ];
            println!("{} {}: {pairs:.4?}", trial.name, stage.fuser);
            for (found_deg, bare_deg) in pairs {
                // If the heading is unknown, the program reports neither a heading error nor a
                // total error, so there is nothing to compare.
                let difference_deg = found_deg.map_or(0.0, |found_deg| (found_deg - bare_deg).abs());
                assert!(difference_deg <= MAX_DIFFERENCE_DEG, "{} {}: {pairs:?}", trial.name, stage.fuser);
            }
            assert!(trial.error.attitude.inclination.is_some());
        }
    }
}

fn sample() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../samples/broad.csv.gz")
}

#[test]
fn sample_recording_has_the_errors_of_bare_stages() {
    assert_equal_errors(&[sample()]);
}

/// A clock with a resolution of 20 ms gives several samples the same stamp. If each sample were
/// given an interval of 20 ms, the rotations would be too large, and the error would exceed 20°.
#[test]
fn coarse_stamps_do_not_stretch_time() {
    let mut text = String::from("t_s,gx,gy,gz,ax,ay,az,qw,qx,qy,qz,mov\n");
    for row in Reader::open(&sample()).unwrap() {
        let Row { t_ns, rate_rad_s, force_m_s2, reference, .. } = row.unwrap();
        let t_s = (t_ns / 20_000_000) as f64 * 0.02;
        let (quaternion, scored) =
            reference.map_or(([f64::NAN; 4], false), |reference| (reference.quaternion, reference.scored));
        let numbers = [&rate_rad_s[..], &force_m_s2, &quaternion].concat();
        let numbers = numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
        writeln!(text, "{t_s:.2},{numbers},{}", u8::from(scored)).unwrap();
    }
    let folder = tempfile::tempdir().unwrap();
    let coarse = folder.path().join("coarse.csv");
    std::fs::write(&coarse, text).unwrap();
    let scores = program_errors(&["multiple-model"], &[sample(), coarse]);
    let [exact_deg, coarse_deg] =
        [0, 1].map(|trial| scores.stages[0].trials[trial].error.attitude.inclination.unwrap());
    println!("inclination with exact stamps {exact_deg:.3}°, with coarse ones {coarse_deg:.3}°");
    assert!(coarse_deg < exact_deg + 4.0);
}

#[recorded::test]
fn open_recordings_have_the_errors_of_bare_stages() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = std::env::var_os("PLUMBLINE_DATA").map_or_else(|| here.join("../../../shared/data"), PathBuf::from);
    let paths = RECORDINGS.map(|name| folder.join(name));
    if let Some(missing) = paths.iter().find(|path| !path.exists()) {
        assert!(std::env::var_os("PLUMBLINE_DATA").is_none(), "no recording at {}", missing.display());
        eprintln!("skipped: no recording at {}; set PLUMBLINE_DATA to the folder of the recordings", missing.display());
        return;
    }
    assert_equal_errors(&paths);
}
