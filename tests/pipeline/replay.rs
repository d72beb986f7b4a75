//! Real recordings: accuracy against a camera reference, and identical bytes from every kind of
//! run.
use std::{
    f64::consts::FRAC_1_SQRT_2,
    fs::{self, File},
    io::Read,
    path::{Path, PathBuf},
};

use crate::common::{Run, System, assert_valid_attitudes, attitudes, inclination_deg, rms};
use attitude::Quaternion;
use flate2::read::MultiGzDecoder;

/// Maximum mean error over the ten BROAD trials, in degrees. VQF achieves 0.665° without
/// magnetometer data (benches/README.md).
const MAX_BROAD_ERROR_DEG: f64 = 0.64;
const TRIAL: &str = "07_undisturbed_fast_rotation_B.csv.gz";

/// Replays at full speed to `out.csv` and asserts that the output is complete.
fn replay(system: &System, file: &Path, arguments: &[&str]) -> Run {
    let out = system.path("out.csv");
    let paths = ["--replay", file.to_str().unwrap(), "--out", out.to_str().unwrap(), "--speed", "max"];
    let run = system.run(&[&paths, arguments].concat());
    run.assert_complete();
    run
}

fn unpack(file: &Path) -> String {
    let mut text = String::new();
    MultiGzDecoder::new(File::open(file).unwrap()).read_to_string(&mut text).unwrap();
    text
}

/// Returns the reference of each row, or `None` if it is missing or not scored.
fn scored_references(text: &str) -> Vec<Option<[f64; 4]>> {
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let index = |name: &str| header.iter().position(|column| *column == name).unwrap();
    let (q, mov) = (["qw", "qx", "qy", "qz"].map(index), index("mov"));
    lines
        .map(|line| {
            let fields: Vec<f64> = line.split(',').map(|field| field.parse().unwrap()).collect();
            let q = q.map(|index| fields[index]);
            let length = q.iter().map(|x| x * x).sum::<f64>().sqrt();
            (fields[mov] == 1.0 && length.is_finite()).then(|| q.map(|x| x / length))
        })
        .collect()
}

fn broad(data: &Path) -> Vec<PathBuf> {
    let mut trials: Vec<_> = fs::read_dir(data.join("broad")).unwrap().map(|entry| entry.unwrap().path()).collect();
    trials.retain(|path| path.to_str().unwrap().ends_with(".csv.gz"));
    trials.sort();
    trials
}

#[recorded::test]
fn broad_mean_inclination_is_below_limit() {
    let Some(data) = crate::common::data() else { return };
    let system = System::new("");
    let mut rmses_deg = Vec::new();
    println!("| trial | inclination RMSE, ° | largest, ° |\n| --- | --- | --- |");
    for trial in broad(&data) {
        let run = replay(&system, &trial, &["--in-process"]);
        let rmse_deg = run.number("/error_deg/inclination_rmse");
        let name = trial.file_name().unwrap().to_string_lossy().replace(".csv.gz", "");
        println!("| {name} | {rmse_deg:.3} | {:.3} |", run.number("/error_deg/inclination_max"));
        rmses_deg.push(rmse_deg);
    }
    assert_eq!(rmses_deg.len(), 10);
    let mean_deg = rmses_deg.iter().sum::<f64>() / rmses_deg.len() as f64;
    println!("| mean | {mean_deg:.3} | |");
    assert!(mean_deg <= MAX_BROAD_ERROR_DEG, "{mean_deg}°");
}

#[recorded::test]
fn recording_gives_same_bytes_packed_or_plain() {
    let Some(data) = crate::common::data() else { return };
    let packed = data.join("broad").join(TRIAL);
    let system = System::new("");
    let plain = system.path("plain.csv");
    fs::write(&plain, unpack(&packed)).unwrap();
    let run = replay(&system, &packed, &[]);
    let bytes = fs::read(system.path("out.csv")).unwrap();
    for (file, mode) in [(&packed, &["--in-process"][..]), (&plain, &["--in-process"]), (&plain, &[])] {
        let other = replay(&system, file, mode);
        assert_eq!(other.line("digest"), run.line("digest"), "{} {mode:?}", file.display());
        assert!(fs::read(system.path("out.csv")).unwrap() == bytes, "{} {mode:?}: the files differ", file.display());
    }
}

/// Converts a recording, including its reference, as if the sensor had the axes forward, right,
/// down.
fn to_frd_sensor(text: &str) -> String {
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let indices = |names: [&str; 3]| names.map(|name| header.iter().position(|column| *column == name));
    let vectors = [["gx", "gy", "gz"], ["ax", "ay", "az"], ["mx", "my", "mz"]].map(indices);
    let quaternion = ["qw", "qx", "qy", "qz"].map(|name| header.iter().position(|column| *column == name).unwrap());
    // The mounting is a half turn about the bisector of the first two axes.
    let mounting = Quaternion::new(0.0, FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0);
    let rotated = lines.map(|line| {
        let mut fields: Vec<String> = line.split(',').map(str::to_owned).collect();
        let number = |fields: &[String], index: usize| fields[index].parse::<f64>().unwrap();
        for [x, y, z] in vectors {
            let [x, y, z] = [x, y, z].map(Option::unwrap);
            fields.swap(x, y);
            fields[z] = (-number(&fields, z)).to_string();
        }
        let [w, i, j, k] = quaternion.map(|index| number(&fields, index));
        let sensor = Quaternion::new(w, i, j, k) * mounting;
        for (index, part) in quaternion.into_iter().zip([sensor.w, sensor.i, sensor.j, sensor.k]) {
            fields[index] = part.to_string();
        }
        fields.join(",") + "\n"
    });
    header.join(",") + "\n" + &rotated.collect::<String>()
}

#[recorded::test]
fn mounting_rotates_reference_with_sensors() {
    let Some(data) = crate::common::data() else { return };
    let trial = data.join("broad").join(TRIAL);
    let system = System::new("[ingest.mounting]\naxes = \"frd\"");
    let rotated = system.path("rotated.csv");
    fs::write(&rotated, to_frd_sensor(&unpack(&trial))).unwrap();
    let run = replay(&system, &rotated, &["--in-process", "--for", "60s"]);
    let plain = replay(&System::new(""), &trial, &["--in-process", "--for", "60s"]);
    for error in ["/error_deg/inclination_rmse", "/error_deg/inclination_max"] {
        let [rotated_deg, plain_deg] = [&run, &plain].map(|run| run.number(error));
        assert!((rotated_deg - plain_deg).abs() < 1e-9, "{error}: {rotated_deg} and {plain_deg}");
    }
}

#[recorded::test]
fn reported_error_matches_written_attitudes() {
    let Some(data) = crate::common::data() else { return };
    let trial = data.join("broad").join(TRIAL);
    let system = System::new("");
    let run = replay(&system, &trial, &[]);
    let references = scored_references(&unpack(&trial));
    let attitudes = attitudes(&system.path("out.csv"));
    assert_eq!(run.number("/ticks_out"), references.len() as f64);
    assert_eq!(attitudes.len(), references.len());
    assert_valid_attitudes(&attitudes);
    let errors_deg: Vec<f64> = attitudes
        .iter()
        .zip(&references)
        .filter_map(|((_, q), reference)| Some(inclination_deg(*q, (*reference)?)))
        .collect();
    let largest_deg = errors_deg.iter().copied().fold(0.0, f64::max);
    let rmse_deg = rms(errors_deg);
    assert!((run.number("/error_deg/inclination_rmse") - rmse_deg).abs() < 1e-6, "{rmse_deg}: {}", run.stderr);
    assert!((run.number("/error_deg/inclination_max") - largest_deg).abs() < 1e-6, "{largest_deg}: {}", run.stderr);
}

#[recorded::test]
fn real_flight_gives_valid_attitudes() {
    let Some(data) = crate::common::data() else { return };
    let flight = data.join("flights/apm_plane_log2_imu.csv.gz");
    let system = System::new("");
    let run = replay(&system, &flight, &[]);
    let attitudes = attitudes(&system.path("out.csv"));
    assert_valid_attitudes(&attitudes);
    assert_eq!(attitudes.len(), scored_references(&unpack(&flight)).len());
    println!("{}", run.stderr);
}
