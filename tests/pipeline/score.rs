//! `plumb score`: errors as defined by BROAD, the same attitudes as `plumb up`, and error messages.
use std::{fmt::Write, fs, path::Path, process::Output};

use crate::common::{System, plumb};
use serde_json::Value;
use tempfile::TempDir;

/// Maximum mean error over the ten BROAD trials without magnetometer data, in degrees. VQF achieves
/// 0.665° (benches/README.md).
const MAX_BROAD_ERROR_DEG: f64 = 0.64;
const TRIAL: &str = "broad/07_undisturbed_fast_rotation_B.csv.gz";

/// Returns a recording of a level body at rest. Its reference is rotated by `heading_deg` about up
/// and then by `tilt_deg` about east.
///
/// Rows that must not be scored have wrong references, which would change every score.
pub(crate) fn at_rest(heading_deg: f64, tilt_deg: f64) -> String {
    let (sin, cos) = (0.5 * heading_deg).to_radians().sin_cos();
    let (tilt_sin, tilt_cos) = (0.5 * tilt_deg).to_radians().sin_cos();
    // q = tilt · heading, with both rotations in earth axes.
    let q = [tilt_cos * cos, tilt_sin * cos, -tilt_sin * sin, tilt_cos * sin];
    let mut text = String::from("t_s,gx,gy,gz,ax,ay,az,qw,qx,qy,qz,mov\n");
    for row in 0..400 {
        let (reference, mov) = match row {
            0..100 => ("0,1,0,0".to_owned(), 0),
            100..120 => ("nan,nan,nan,nan".to_owned(), 1),
            _ => (q.map(|x| x.to_string()).join(","), 1),
        };
        writeln!(text, "{}.{:02},0,0,0,0,0,9.80665,{reference},{mov}", row / 100, row % 100).unwrap();
    }
    text
}

/// Adds a magnetic field with north along the forward axis, so that the heading is known.
fn with_field(text: &str) -> String {
    let with_columns =
        |(index, line): (usize, &str)| format!("{line},{}\n", if index == 0 { "mx,my,mz" } else { "0,20,-40" });
    text.lines().enumerate().map(with_columns).collect()
}

pub(crate) fn folder_with(files: &[(&str, String)]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    files.iter().for_each(|(name, text)| fs::write(folder.path().join(name), text).unwrap());
    folder
}

pub(crate) fn score(folder: &Path, arguments: &[&str]) -> Output {
    plumb(&["score"]).current_dir(folder).args(arguments).output().unwrap()
}

/// Returns the scores as JSON.
pub(crate) fn scores(folder: &Path, arguments: &[&str]) -> Value {
    let output = score(folder, &[arguments, &["--json"]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_str(String::from_utf8(output.stdout).unwrap().lines().last().unwrap()).unwrap()
}

pub(crate) fn number(scores: &Value, pointer: &str) -> f64 {
    scores.pointer(pointer).and_then(Value::as_f64).unwrap_or_else(|| panic!("no {pointer} in {scores}"))
}

/// Asserts that `plumb score` exits with `code`, prints `messages` to standard error, and prints
/// nothing to standard output.
pub(crate) fn assert_rejected(folder: &Path, arguments: &[&str], code: i32, messages: &[&str]) {
    let output = score(folder, arguments);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(code), "{stderr}");
    assert!(output.stdout.is_empty());
    messages.iter().for_each(|words| assert!(stderr.contains(words), "no {words:?} in:\n{stderr}"));
}

#[test]
fn separate_reference_file_equals_reference_columns() {
    let complete = at_rest(3.0, 4.0);
    let columns = |indices: &[usize]| {
        let select = |line: &str| {
            let fields: Vec<_> = line.split(',').collect();
            indices.iter().map(|column| fields[*column]).collect::<Vec<_>>().join(",") + "\n"
        };
        complete.lines().map(select).collect::<String>()
    };
    let files = [
        ("complete.csv", complete.clone()),
        ("imu.csv", columns(&[0, 1, 2, 3, 4, 5, 6])),
        ("truth.csv", columns(&[0, 7, 8, 9, 10, 11])),
    ];
    let folder = folder_with(&files);
    let [complete_mean, separate_mean, imu_mean] =
        [&["complete.csv"][..], &["imu.csv", "--reference", "truth.csv"], &["imu.csv"]].map(|arguments| {
            let scores = scores(folder.path(), &[arguments, &["--mag", "off"]].concat());
            scores.pointer("/stages/0/mean").cloned().unwrap_or_else(|| panic!("no mean in {scores}"))
        });
    assert_eq!(complete_mean, separate_mean);
    assert_ne!(complete_mean, imu_mean);
    let arguments = ["imu.csv", "complete.csv", "--reference", "truth.csv"];
    assert_rejected(folder.path(), &arguments, 2, &["--reference belongs to a single recording"]);
    assert_rejected(folder.path(), &["imu.csv", "--reference", "imu.csv"], 3, &["imu.csv", "gx"]);
}

#[test]
fn errors_match_scored_reference_rows() {
    let files = [("turned.csv", at_rest(30.0, 0.0)), ("tilted.csv", at_rest(0.0, 10.0))];
    let folder = folder_with(&files.map(|(name, text)| (name, with_field(&text))));
    let scores = scores(folder.path(), &["turned.csv", "tilted.csv"]);
    let errors = |pointer: &str| {
        ["total", "heading", "inclination"].map(|error| number(&scores, &format!("/stages/0/{pointer}/{error}")))
    };
    for (pointer, expected) in
        [("trials/0", [30.0, 30.0, 0.0]), ("trials/1", [10.0, 0.0, 10.0]), ("mean", [20.0, 15.0, 5.0])]
    {
        let found = errors(pointer);
        assert!(
            found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-6),
            "{pointer}: {found:?}"
        );
    }
    assert_eq!(number(&scores, "/stages/0/trials/0/scored"), 280.0);
    assert_eq!(scores.pointer("/stages/0/fuser").unwrap(), "multiple-model");
    assert_eq!(scores.pointer("/stages/0/trials/0/name").unwrap(), "turned");
    assert!(number(&scores, "/stages/0/ns_per_update") > 0.0);
}

/// Returns the warnings of a score.
fn warnings(folder: &Path, arguments: &[&str]) -> String {
    let output = score(folder, arguments);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(0), "{stderr}");
    stderr
}

#[test]
fn constant_heading_offset_is_named_with_its_remedy() {
    let files = [
        ("true.csv", with_field(&at_rest(-11.0, 0.0))),
        ("exchanged.csv", with_field(&at_rest(90.0, 0.0))),
        ("own_zero.csv", with_field(&at_rest(-60.0, 0.0))),
        ("equal.csv", with_field(&at_rest(0.0, 0.0))),
    ];
    let folder = folder_with(&files);
    let found = |file: &str| warnings(folder.path(), &[file]);
    assert!(!found("equal.csv").contains("heading-offset"));
    assert!(found("own_zero.csv").contains("a constant +60.0° (counter-clockwise)"), "{}", found("own_zero.csv"));
    assert!(found("own_zero.csv").contains("its own zero of yaw"));
    assert!(found("exchanged.csv").contains("`--frame enu-flu` or"), "{}", found("exchanged.csv"));
    let message = found("true.csv");
    assert!(message.contains("a constant +11.0° (counter-clockwise)"), "{message}");
    let remedy = message.split('`').find(|part| part.starts_with("--set ")).unwrap();
    let corrected = warnings(folder.path(), &[&["true.csv"][..], &remedy.split(' ').collect::<Vec<_>>()].concat());
    assert!(!corrected.contains("heading-offset"), "{corrected}");
}

#[test]
fn segment_with_a_single_sample_is_left_out() {
    let row = |t_s: f64| format!("{t_s},0,0,0.01,0,0,9.8\n");
    let text: String = [row(500.0)].into_iter().chain((0..200).map(|n| row(f64::from(n) * 0.01))).collect();
    let folder = folder_with(&[("restarted.csv", format!("t_s,gx,gy,gz,ax,ay,az\n{text}"))]);
    let output = score(folder.path(), &["restarted.csv", "--json"]);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(0), "{stderr}");
    assert!(stderr.contains("restarted.csv: left out segment 1, which has 1 sample"), "{stderr}");
    let scores: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(scores.pointer("/stages/0/trials").unwrap().as_array().unwrap().len(), 1, "{scores}");
}

#[test]
fn recording_without_reference_has_attitude_but_no_score() {
    let text = "t_s,gx,gy,gz,ax,ay,az\n0,0,0,0,0,0,9.8\n0.01,0,0,0,0,0,9.8\n".to_owned();
    let folder = folder_with(&[("plain.csv", text), ("tilted.csv", at_rest(0.0, 10.0))]);
    let scores = scores(folder.path(), &["plain.csv", "tilted.csv", "--out-dir", "out"]);
    assert_eq!(scores.pointer("/stages/0/trials/0/inclination"), Some(&Value::Null));
    let mean_deg = number(&scores, "/stages/0/mean/inclination");
    assert!((mean_deg - 10.0).abs() < 1e-6, "the mean includes an unscored recording");
    assert_eq!(crate::common::attitudes(&folder.path().join("out/plain.csv")).len(), 2);
    let table = String::from_utf8(score(folder.path(), &["plain.csv"]).stdout).unwrap();
    assert!(table.contains('—'), "{table}");
}

#[test]
fn several_fusers_are_scored_in_one_run() {
    let folder = folder_with(&[("turned.csv", at_rest(30.0, 0.0))]);
    let fusers = ["turned.csv", "--fuser", "wz", "--fuser", "wz-closed", "--set", "declination_deg=0"];
    let scores = scores(folder.path(), &[&fusers[..], &["--out-dir", "out"]].concat());
    assert_eq!(scores.pointer("/stages/1/fuser").unwrap(), "wz-closed");
    assert_eq!(number(&scores, "/stages/1/settings/course.declination_deg"), 0.0);
    for fuser in ["wz", "wz-closed"] {
        assert_eq!(crate::common::attitudes(&folder.path().join("out").join(fuser).join("turned.csv")).len(), 400);
    }
}

#[test]
fn simulation_is_scored_against_its_truth() {
    let folder = tempfile::tempdir().unwrap();
    let scores = scores(folder.path(), &["sim:s1"]);
    assert!(number(&scores, "/stages/0/mean/inclination") < 0.1, "{scores}");
    assert_eq!(number(&scores, "/stages/0/trials/0/ticks"), 10_001.0);
    assert_eq!(number(&scores, "/stages/0/trials/0/scored"), 9_501.0, "scored from 5 s");
}

#[test]
fn seeds_give_mean_and_spread() {
    let folder = folder_with(&[]);
    let query = |seed: &str| format!("sim:s1?duration_s=8&seed={seed}&accel_noise_g=0.05&amplitude_deg=50");
    let each = ["3", "4", "5"].map(|seed| {
        let scores = scores(folder.path(), &[&query(seed), "--fuser", "wz", "--fuser", "vqf"]);
        [0, 1].map(|stage| number(&scores, &format!("/stages/{stage}/trials/0/inclination")))
    });
    let many = scores(folder.path(), &[&query("3..5"), "--fuser", "wz", "--fuser", "vqf"]);
    for stage in [0, 1] {
        let inclinations = each.map(|inclinations| inclinations[stage]);
        let trial = |pointer: &str| number(&many, &format!("/stages/{stage}/trials/0/{pointer}"));
        assert!((trial("inclination") - inclinations.iter().sum::<f64>() / 3.0).abs() < 1e-12);
        // The heading is unknown, so the worst seed is the one with the largest inclination error.
        let worst = inclinations.iter().copied().fold(0.0, f64::max);
        let seed = 3 + inclinations.iter().position(|inclination| *inclination == worst).unwrap();
        assert_eq!((trial("spread/worst/inclination"), trial("spread/worst_seed")), (worst, seed as f64));
        let mut sorted = inclinations;
        sorted.sort_by(f64::total_cmp);
        assert_eq!((trial("spread/quantiles/1/inclination"), trial("spread/seeds")), (sorted[1], 3.0));
        assert!(trial("spread/sd/inclination") > 0.0 && trial("scored") > 900.0);
    }
    assert_rejected(folder.path(), &["sim:s1?seed=5..3"], 2, &["expected seed=A..B with A at most B"]);
}

#[test]
fn figures_are_small_and_labelled() {
    let folder = tempfile::tempdir().unwrap();
    scores(folder.path(), &["sim:s1?duration_s=20", "--plot", "figures"]);
    for (name, labels) in [
        ("uvz", &["time, s", "z, °", "accelerometer", "gyro, open loop", "reference", "fused"][..]),
        ("v", &["time, s", "accelerometer", "gyro, open loop", "fused"]),
        ("angles", &["yaw ψ, °", "pitch ϑ, °", "roll γ, °"]),
        ("sphere", &["w = u + jv in the plane", "upside down, w = ∞"]),
        ("error", &["inclination, °"]),
    ] {
        let file = folder.path().join(format!("figures/sim_s1_duration_s_20.{name}.svg"));
        let text = fs::read_to_string(&file).unwrap();
        assert!(text.starts_with("<svg") && text.trim_end().ends_with("</svg>") && text.len() <= 300_000, "{name}");
        labels.iter().for_each(|words| assert!(text.contains(words), "no {words:?} in {name}"));
        assert!(name != "error" || !text.contains("total, °"), "a total error imu_mean a known heading");
    }
    scores(folder.path(), &["sim:s3", "--plot", "known"]);
    let text = fs::read_to_string(folder.path().join("known/sim_s3.error.svg")).unwrap();
    ["inclination, °", "heading, °", "total, °"].iter().for_each(|words| assert!(text.contains(words), "{words}"));
}

#[test]
fn invalid_arguments_are_rejected_with_alternatives() {
    let folder =
        folder_with(&[("a.csv", at_rest(0.0, 0.0)), ("bad.csv", "t_s,gx,gz,ax,ay,az\n0,0,0,0,0,9.8\n".into())]);
    fs::create_dir(folder.path().join("b")).unwrap();
    fs::copy(folder.path().join("a.csv"), folder.path().join("b/a.csv")).unwrap();
    let assert_error =
        |arguments: &[&str], code, messages: &[&str]| assert_rejected(folder.path(), arguments, code, messages);
    assert_error(&["a.csv", "--fuser", "wz-opne"], 2, &["no stage named `wz-opne`", "did you mean `wz-open`?", "vqf"]);
    assert_error(&["a.csv", "--fuser", "wz", "--fuser", "wz"], 2, &["fuser `wz` is given twice"]);
    assert_error(&["a.csv", "--set", "declination=3"], 2, &["did you mean `declination_deg`?", "-180 to 180 °"]);
    assert_error(&["a.csv", "--set", "declination_deg=333"], 2, &["expected -180 to 180 °, found 333"]);
    assert_error(&["a.csv", "--set", "declination_deg"], 2, &["expected key=value"]);
    assert_error(
        &["a.csv", "--set", "bogus.beta=1"],
        2,
        &["no selected stage has a parameter `bogus.beta`", "fuser.hard_iron_sd_ut of multiple-model"],
    );
    let twice = ["a.csv", "--set", "declination_deg=1", "--set", "course.declination_deg=2"];
    assert_error(&twice, 2, &["course.declination_deg is set twice", "keep one"]);
    assert_error(&["sim:s1?seed=2&rate_hz=50&seed=3"], 2, &["`seed` is set twice"]);
    assert_error(&["a.csv", "b/a.csv"], 2, &["two trials are named `a`"]);
    assert_error(&["sim:s9"], 2, &["unknown scenario `s9`", "cruise"]);
    assert_error(&["a.csv", "--out-dir", "."], 2, &["this is the recording itself"]);
    assert_error(&["a.csv", "none.csv"], 3, &["opening the recording none.csv", "check the path"]);
    assert_error(&["bad.csv"], 3, &["bad.csv: line 1: found no column gy"]);
    assert_error(&["a.csv", "--gnss", "bad.csv"], 3, &["bad.csv: line 1, column 2: found \"gx\""]);
    assert_error(&["a.csv", "sim:s1", "--gnss", "fixes.csv"], 2, &["fixes.csv belongs to one recording", "2 trials"]);
    assert_error(&["a.csv", "--out-dir", "a.csv"], 1, &["writing a.csv"]);
    assert_error(&[], 2, &["<FILE>"]);
    assert_eq!(fs::read_to_string(folder.path().join("a.csv")).unwrap(), at_rest(0.0, 0.0));
}

#[test]
fn stages_are_listed_as_text_and_json() {
    let list = |arguments: &[&str]| String::from_utf8(plumb(arguments).output().unwrap().stdout).unwrap();
    let text = list(&["stage", "list"]);
    assert!(
        text.contains("  multiple-model (default)\n    parts: wz + aided\n")
            && text.contains("-180 to 180 °, default 0"),
        "{text}"
    );
    let json: Value = serde_json::from_str(&list(&["stage", "list", "--json"])).unwrap();
    let names: Vec<_> = (0..4).map(|slot| json.pointer(&format!("/slots/{slot}/slot")).unwrap().clone()).collect();
    assert_eq!(names, ["gyro", "accel", "fuser", "course"]);
}

#[test]
fn stage_test_runs_conformance_checks_by_name() {
    let output = plumb(&["stage", "test", "--slot", "gyro", "mobius", "--json"]).output().unwrap();
    assert_eq!(output.status.code(), Some(0));
    let reports: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(reports.pointer("/reports/0/stage"), Some(&Value::from("mobius")));
    assert!(reports.pointer("/reports/0/checks/10/passed").is_some_and(|passed| passed == true));
    for (unknown, message) in [
        (&["stage", "test", "mobious"][..], "unknown stage `mobious`; did you mean `mobius`? expected one of mobius,"),
        (&["stage", "test", "--slot", "fuser", "mobius"], "the stage `mobius` belongs to the slot `gyro`, not `fuser`"),
        (&["stage", "test", "--slot", "fuser", "vfq"], "did you mean `vqf`? stages of the slot `fuser`: "),
        (&["stage", "test", "--slot", "fusr"], "unknown slot `fusr`; did you mean `fuser`? expected one of gyro,"),
        (&["score", "sim:cruse"], "unknown scenario `cruse`; did you mean `cruise`? expected one of s1,"),
        (&["score", "sim:s1", "--fuser", "vfq"], "did you mean `vqf`? stages of the slot `fuser`: "),
        (&["service", "gyr"], "unknown service `gyr`; did you mean `gyro`? expected one of "),
    ] {
        let output = plumb(unknown).output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && stderr.contains(message), "{unknown:?}: {stderr}");
    }
}

#[recorded::test]
fn score_writes_same_attitudes_as_up() {
    let Some(data) = crate::common::data() else { return };
    let trial = data.join(TRIAL);
    let system = System::new("");
    let (up, out) = (system.path("up.csv"), system.path("out"));
    let (trial, up_text) = (trial.to_str().unwrap(), up.to_str().unwrap());
    system.run(&["--replay", trial, "--in-process", "--speed", "max", "--out", up_text]).assert_complete();
    scores(system.folder.path(), &[trial, "--out-dir", out.to_str().unwrap()]);
    let written = out.join("07_undisturbed_fast_rotation_B.csv");
    assert!(fs::read(written).unwrap() == fs::read(up).unwrap(), "the files differ");
}

#[recorded::test]
fn broad_inclination_without_magnetometer_is_below_limit() {
    let Some(data) = crate::common::data() else { return };
    let mut trials: Vec<_> = fs::read_dir(data.join("broad")).unwrap().map(|entry| entry.unwrap().path()).collect();
    trials.sort();
    let trials: Vec<&str> = trials.iter().map(|path| path.to_str().unwrap()).collect();
    let folder = tempfile::tempdir().unwrap();
    let scores = scores(folder.path(), &[&trials[..], &["--mag", "off"]].concat());
    assert_eq!(scores.pointer("/stages/0/trials").unwrap().as_array().unwrap().len(), 10);
    let mean_deg = number(&scores, "/stages/0/mean/inclination");
    println!("mean inclination RMSE {mean_deg:.3}°");
    assert!(mean_deg <= MAX_BROAD_ERROR_DEG, "{mean_deg}°");
}

#[test]
fn input_warnings_are_printed_for_faulty_files_only() {
    let convert_to_g = |text: String| text.replace("9.80665", "1.0");
    let duplicate_rows =
        |text: String| text.lines().flat_map(|line| [line, "\n", line, "\n"]).skip(2).collect::<String>();
    let valid = at_rest(0.0, 0.0);
    let folder = folder_with(&[
        ("valid.csv", valid.clone()),
        ("g.csv", convert_to_g(valid.clone())),
        ("twice.csv", duplicate_rows(valid)),
    ]);
    let stderr = |file: &str| String::from_utf8(score(folder.path(), &[file]).stderr).unwrap();
    assert!(stderr("sim:s1?duration_s=2").contains("the simulation ends before scoring starts"));
    assert!(!stderr("valid.csv").contains("warning"), "{}", stderr("valid.csv"));
    for (file, words) in [
        ("g.csv", ["warning: g: force-unit", "--units g", "ingest.calibration.accel.scale = [9.80665"]),
        (
            "twice.csv",
            ["warning: twice: 400 readings rejected", "timestamps equal to the previous one: 400", "twice: timestamps"],
        ),
    ] {
        words.iter().for_each(|words| assert!(stderr(file).contains(words), "no {words:?} in:\n{}", stderr(file)));
    }
}
