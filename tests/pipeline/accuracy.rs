//! Tests of `benches/accuracy`: the comparison with published filters, and the conversion of the
//! BROAD data set.
use std::{
    path::Path,
    process::{Command, Output},
};

use serde_json::Value;

use super::score::{folder_with, number, scores};
use crate::common::python::python;

/// Largest accepted difference in degrees between the errors of the Python package vqf and of the
/// stage `vqf`. Package and stage assume different sampling times.
const MAX_VQF_DIFFERENCE_DEG: f64 = 0.01;
const METRICS: [&str; 3] = ["total", "heading", "inclination"];

fn run(python: &Path, script: &str, arguments: &[&str]) -> Output {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut command = Command::new(python);
    command.arg("-B").arg(root.join("benches/accuracy").join(script)).args(arguments).current_dir(root);
    command.env("PYTHONUTF8", "1").output().unwrap()
}

fn compare(python: &Path, arguments: &[&str]) -> Output {
    run(python, "compare.py", &[&["--plumb", env!("CARGO_BIN_EXE_plumb"), "--jobs", "2"], arguments].concat())
}

#[test]
fn package_vqf_has_the_errors_of_the_stage_vqf() {
    let Some(python) = python() else { return };
    let output = compare(python, &["--json", "samples/broad.csv.gz"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    for metric in METRICS {
        let [package_deg, stage_deg] =
            ["VQF", "vqf"].map(|name| number(&found, &format!("/errors/{name}/broad/{metric}")));
        println!("{metric}: package {package_deg:.4}°, stage {stage_deg:.4}°");
        assert!((package_deg - stage_deg).abs() < MAX_VQF_DIFFERENCE_DEG && stage_deg > 1.0);
    }
    for peer in ["Madgwick", "Mahony (BROAD)", "EKF", "Fusion"] {
        let heading_deg = number(&found, &format!("/errors/{peer}/broad/heading"));
        assert!(heading_deg < 10.0, "{peer}: {heading_deg}°, is its earth frame wrong?");
    }
}

#[test]
fn comparison_imports_and_lists_better_peers() {
    let Some(python) = python() else { return };
    // The foreign recording has rates in degrees per second, and no magnetometer.
    let sample = std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("samples/broad.csv.gz")).unwrap();
    let mut text = String::new();
    std::io::Read::read_to_string(&mut flate2::read::MultiGzDecoder::new(&sample[..]), &mut text).unwrap();
    let mut foreign = String::from("t,wx,wy,wz,ax,ay,az,qw,qx,qy,qz\n");
    for line in text.lines().skip(1) {
        let fields: Vec<_> = line.split(',').collect();
        let rates: Vec<_> =
            fields[1..4].iter().map(|rate| rate.parse::<f64>().unwrap().to_degrees().to_string()).collect();
        foreign +=
            &format!("{},{},{},{}\n", fields[0], rates.join(","), fields[4..7].join(","), fields[10..14].join(","));
    }
    let folder = folder_with(&[("foreign.csv", foreign)]);
    let path = folder.path().join("foreign.csv");
    let map = "t=t,gx=wx,gy=wy,gz=wz,ax=ax,ay=ay,az=az,qw=qw,qx=qx,qy=qy,qz=qz";
    let output = compare(
        python,
        &[
            "--fuser",
            "wz-open",
            "--set",
            "mine",
            path.to_str().unwrap(),
            "--",
            "--map",
            map,
            "--units",
            "deg/s",
            "--frame",
            "enu-rfu",
        ],
    );
    let table = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    for words in ["| **mine** |", "| foreign | – / – / ", "- foreign: inclination "] {
        assert!(table.contains(words), "no {words:?} in {table}");
    }
}

#[test]
fn unusable_recording_is_rejected_with_remedy() {
    let Some(python) = python() else { return };
    let without_reference = "t_s,gx,gy,gz,ax,ay,az\n0,0,0,0,0,0,9.8\n0.01,0,0,0,0,0,9.8\n".to_owned();
    let folder = folder_with(&[("bare.csv", without_reference)]);
    let path = folder.path().join("bare.csv");
    for (arguments, message) in [
        (&[path.to_str().unwrap()][..], "bare.csv: no sample with mov = 1 has a reference attitude"),
        (&[], "no recordings; name files, or use --set NAME FILE"),
        (&["none.csv"], "none.csv"),
    ] {
        let output = compare(python, arguments);
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(2) && stderr.contains(message), "no {message:?} in {stderr}");
    }
}

/// Writes an HDF5 file with the layout of BROAD and the samples of a recording.
const WRITE_TRIAL: &str = "
import sys
import h5py
import numpy as np
samples = np.loadtxt(sys.argv[1], delimiter=',', skiprows=1)
with h5py.File(sys.argv[2], 'w') as file:
    file.attrs['sampling_rate'] = 1 / (samples[1, 0] - samples[0, 0])
    for name, columns in {'imu_gyr': (1, 4), 'imu_acc': (4, 7), 'imu_mag': (7, 10), 'opt_quat': (10, 14)}.items():
        file[name] = samples[:, slice(*columns)]
    file['movement'] = samples[:, 14] == 1
";

#[test]
fn converted_trial_has_the_errors_of_the_recording() {
    let Some(python) = python() else { return };
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("samples/broad.csv.gz");
    let folder = folder_with(&[("text.hdf5", "not HDF5".into())]);
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let trial = path("01_trial.hdf5");
    let written = Command::new(python).args(["-c", WRITE_TRIAL, sample.to_str().unwrap(), &trial]).output().unwrap();
    assert!(written.status.success(), "{}", String::from_utf8_lossy(&written.stderr));
    let converted = run(python, "broad.py", &[&trial, "--out", &path("out")]);
    assert!(converted.status.success(), "{}", String::from_utf8_lossy(&converted.stderr));
    let errors = scores(folder.path(), &["out/01_trial.csv.gz", sample.to_str().unwrap()]);
    for metric in METRICS {
        let [converted_deg, original_deg] =
            [0, 1].map(|trial| number(&errors, &format!("/stages/0/trials/{trial}/{metric}")));
        assert!((converted_deg - original_deg).abs() < 1e-6 && original_deg > 0.5, "{metric}: {converted_deg}°");
    }
    for (file, message) in
        [(trial, "delete it, or set another folder"), (path("text.hdf5"), "expected an HDF5 file of BROAD")]
    {
        let rejected = run(python, "broad.py", &[&file, "--out", &path("out")]);
        let stderr = String::from_utf8(rejected.stderr).unwrap();
        assert!(rejected.status.code() == Some(2) && stderr.contains(message), "no {message:?} in {stderr}");
    }
}
