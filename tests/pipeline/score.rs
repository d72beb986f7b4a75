//! `plumb score`: errors as BROAD defines them, the same attitudes as the running system, and what it says when it cannot.
use std::{fmt::Write, fs, path::Path, process::Output};

use crate::common::{System, plumb};
use serde_json::Value;
use tempfile::TempDir;

/// Mean over the ten trials of BROAD, degrees, gyro and accelerometer alone; VQF: 0.665° (benches/README.md).
const BROAD_LIMIT_DEG: f64 = 0.64;
const TRIAL: &str = "broad/07_undisturbed_fast_rotation_B.csv.gz";

/// A body at rest and level, whose reference is turned by `heading_deg` and tilted by `tilt_deg` about east; rows that do not
/// count have references that would spoil any score.
pub(crate) fn at_rest(heading_deg: f64, tilt_deg: f64) -> String {
    let (sin, cos) = (0.5 * heading_deg).to_radians().sin_cos();
    let (tilt_sin, tilt_cos) = (0.5 * tilt_deg).to_radians().sin_cos();
    // q = tilt * heading, both in earth axes.
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

/// The same beside a magnetometer that points north along the body's forward axis, so that the heading is known.
fn with_field(text: &str) -> String {
    let more = |(at, line): (usize, &str)| format!("{line},{}\n", if at == 0 { "mx,my,mz" } else { "0,20,-40" });
    text.lines().enumerate().map(more).collect()
}

pub(crate) fn folder_with(files: &[(&str, String)]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    files.iter().for_each(|(name, text)| fs::write(folder.path().join(name), text).unwrap());
    folder
}

pub(crate) fn score(folder: &Path, arguments: &[&str]) -> Output {
    plumb(&["score"]).current_dir(folder).args(arguments).output().unwrap()
}

/// The last line of standard output.
pub(crate) fn scores(folder: &Path, arguments: &[&str]) -> Value {
    let output = score(folder, &[arguments, &["--json"]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_str(String::from_utf8(output.stdout).unwrap().lines().last().unwrap()).unwrap()
}

pub(crate) fn number(scores: &Value, pointer: &str) -> f64 {
    scores.pointer(pointer).and_then(Value::as_f64).unwrap_or_else(|| panic!("no {pointer} in {scores}"))
}

/// It ended with this code and said each of these on standard error, and nothing for scripts.
pub(crate) fn assert_refused(folder: &Path, arguments: &[&str], code: i32, said: &[&str]) {
    let output = score(folder, arguments);
    let people = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(code), "{people}");
    assert!(output.stdout.is_empty());
    said.iter().for_each(|words| assert!(people.contains(words), "no {words:?} in:\n{people}"));
}

#[test]
fn a_reference_in_a_file_of_its_own_counts_as_one_in_the_recording() {
    let whole = at_rest(3.0, 4.0);
    let columns = |wanted: &[usize]| {
        let picked = |line: &str| {
            let fields: Vec<_> = line.split(',').collect();
            wanted.iter().map(|column| fields[*column]).collect::<Vec<_>>().join(",") + "\n"
        };
        whole.lines().map(picked).collect::<String>()
    };
    let files = [
        ("whole.csv", whole.clone()),
        ("imu.csv", columns(&[0, 1, 2, 3, 4, 5, 6])),
        ("truth.csv", columns(&[0, 7, 8, 9, 10, 11])),
    ];
    let folder = folder_with(&files);
    let [of_whole, apart, without] =
        [&["whole.csv"][..], &["imu.csv", "--reference", "truth.csv"], &["imu.csv"]].map(|arguments| {
            let scores = scores(folder.path(), &[arguments, &["--mag", "off"]].concat());
            scores.pointer("/stages/0/mean").cloned().unwrap_or_else(|| panic!("no mean in {scores}"))
        });
    assert_eq!(of_whole, apart);
    assert_ne!(of_whole, without);
    let refused = ["imu.csv", "whole.csv", "--reference", "truth.csv"];
    assert_refused(folder.path(), &refused, 2, &["--reference belongs to a single recording"]);
    assert_refused(folder.path(), &["imu.csv", "--reference", "imu.csv"], 3, &["imu.csv", "gx"]);
}

#[test]
fn the_errors_are_those_of_the_reference_where_it_counts() {
    let files = [("turned.csv", at_rest(30.0, 0.0)), ("tilted.csv", at_rest(0.0, 10.0))];
    let folder = folder_with(&files.map(|(name, text)| (name, with_field(&text))));
    let scores = scores(folder.path(), &["turned.csv", "tilted.csv"]);
    let errors = |place: &str| {
        ["total", "heading", "inclination"].map(|error| number(&scores, &format!("/stages/0/{place}/{error}")))
    };
    for (place, expected) in
        [("trials/0", [30.0, 30.0, 0.0]), ("trials/1", [10.0, 0.0, 10.0]), ("mean", [20.0, 15.0, 5.0])]
    {
        let found = errors(place);
        assert!(
            found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-6),
            "{place}: {found:?}"
        );
    }
    assert_eq!(number(&scores, "/stages/0/trials/0/scored"), 280.0);
    assert_eq!(scores.pointer("/stages/0/fuser").unwrap(), "multiple-model");
    assert_eq!(scores.pointer("/stages/0/trials/0/name").unwrap(), "turned");
    assert!(number(&scores, "/stages/0/ns_per_update") > 0.0);
}

#[test]
fn a_recording_without_a_reference_has_no_score_and_still_an_attitude() {
    let text = "t_s,gx,gy,gz,ax,ay,az\n0,0,0,0,0,0,9.8\n0.01,0,0,0,0,0,9.8\n".to_owned();
    let folder = folder_with(&[("plain.csv", text), ("tilted.csv", at_rest(0.0, 10.0))]);
    let scores = scores(folder.path(), &["plain.csv", "tilted.csv", "--out", "out"]);
    assert_eq!(scores.pointer("/stages/0/trials/0/inclination"), Some(&Value::Null));
    let mean_deg = number(&scores, "/stages/0/mean/inclination");
    assert!((mean_deg - 10.0).abs() < 1e-6, "the mean is of those that have a score");
    assert_eq!(crate::common::attitudes(&folder.path().join("out/plain.csv")).len(), 2);
    let table = String::from_utf8(score(folder.path(), &["plain.csv"]).stdout).unwrap();
    assert!(table.contains('—'), "{table}");
}

#[test]
fn several_fusers_stand_side_by_side() {
    let folder = folder_with(&[("turned.csv", at_rest(30.0, 0.0))]);
    let fusers = ["turned.csv", "--fuser", "wz", "--fuser", "wz-closed", "--set", "declination_deg=0"];
    let scores = scores(folder.path(), &[&fusers[..], &["--out", "out"]].concat());
    assert_eq!(scores.pointer("/stages/1/fuser").unwrap(), "wz-closed");
    assert_eq!(number(&scores, "/stages/1/settings/course.declination_deg"), 0.0);
    for fuser in ["wz", "wz-closed"] {
        assert_eq!(crate::common::attitudes(&folder.path().join("out").join(fuser).join("turned.csv")).len(), 400);
    }
}

#[test]
fn a_simulation_is_scored_against_its_own_truth() {
    let folder = tempfile::tempdir().unwrap();
    let scores = scores(folder.path(), &["sim:s1"]);
    assert!(number(&scores, "/stages/0/mean/inclination") < 0.1, "{scores}");
    assert_eq!(number(&scores, "/stages/0/trials/0/ticks"), 10_001.0);
    assert_eq!(number(&scores, "/stages/0/trials/0/scored"), 9_501.0, "scored from 5 s");
}

#[test]
fn many_seeds_give_the_mean_and_the_spread_of_each_by_itself() {
    let folder = folder_with(&[]);
    let query = |seed: &str| format!("sim:s1?duration_s=8&seed={seed}&accel_noise_g=0.05&amplitude_deg=50");
    let each = ["3", "4", "5"].map(|seed| {
        let scores = scores(folder.path(), &[&query(seed), "--fuser", "wz", "--fuser", "vqf"]);
        [0, 1].map(|stage| number(&scores, &format!("/stages/{stage}/trials/0/inclination")))
    });
    let many = scores(folder.path(), &[&query("3..5"), "--fuser", "wz", "--fuser", "vqf"]);
    for stage in [0, 1] {
        let of_each = each.map(|inclinations| inclinations[stage]);
        let trial = |pointer: &str| number(&many, &format!("/stages/{stage}/trials/0/{pointer}"));
        assert!((trial("inclination") - of_each.iter().sum::<f64>() / 3.0).abs() < 1e-12);
        // No heading is known, so that the worst is that of the inclination.
        let worst = of_each.iter().copied().fold(0.0, f64::max);
        let seed = 3 + of_each.iter().position(|inclination| *inclination == worst).unwrap();
        assert_eq!((trial("spread/worst/inclination"), trial("spread/worst_seed")), (worst, seed as f64));
        let mut sorted = of_each;
        sorted.sort_by(f64::total_cmp);
        assert_eq!((trial("spread/quantiles/1/inclination"), trial("spread/seeds")), (sorted[1], 3.0));
        assert!(trial("spread/sd/inclination") > 0.0 && trial("scored") > 900.0);
    }
    assert_refused(folder.path(), &["sim:s1?seed=5..3"], 2, &["expected seed=A..B with A at most B"]);
}

#[test]
fn figures_are_small_and_say_what_they_show() {
    let folder = tempfile::tempdir().unwrap();
    scores(folder.path(), &["sim:s1?duration_s=20", "--plot", "figures"]);
    for (name, said) in [
        ("uvz", &["time, s", "z, °", "accelerometer", "gyro, open loop", "reference", "fused"][..]),
        ("v", &["time, s", "accelerometer", "gyro, open loop", "fused"]),
        ("angles", &["yaw ψ, °", "pitch ϑ, °", "roll γ, °"]),
        ("sphere", &["w = u + jv in the plane", "upside down, w = ∞"]),
        ("error", &["inclination, °"]),
    ] {
        let file = folder.path().join(format!("figures/sim_s1_duration_s_20.{name}.svg"));
        let text = fs::read_to_string(&file).unwrap();
        assert!(text.starts_with("<svg") && text.trim_end().ends_with("</svg>") && text.len() < 500_000, "{name}");
        said.iter().for_each(|words| assert!(text.contains(words), "no {words:?} in {name}"));
        assert!(name != "error" || !text.contains("total, °"), "no heading is known");
    }
    scores(folder.path(), &["sim:s3", "--plot", "known"]);
    let text = fs::read_to_string(folder.path().join("known/sim_s3.error.svg")).unwrap();
    ["inclination, °", "heading, °", "total, °"].iter().for_each(|words| assert!(text.contains(words), "{words}"));
}

#[test]
fn what_there_is_not_is_said_with_what_there_is() {
    let folder = folder_with(&[("a.csv", at_rest(0.0, 0.0)), ("bad.csv", "t_s,gx\n".into())]);
    fs::create_dir(folder.path().join("b")).unwrap();
    fs::copy(folder.path().join("a.csv"), folder.path().join("b/a.csv")).unwrap();
    let refused = |arguments: &[&str], code, said: &[&str]| assert_refused(folder.path(), arguments, code, said);
    refused(&["a.csv", "--fuser", "wz-opne"], 2, &["no fuser stage named `wz-opne`", "did you mean `wz-open`?", "vqf"]);
    refused(&["a.csv", "--fuser", "wz", "--fuser", "wz"], 2, &["fuser `wz` is given twice"]);
    refused(&["a.csv", "--set", "declination=3"], 2, &["did you mean `declination_deg`?", "-180 to 180 °"]);
    refused(&["a.csv", "--set", "declination_deg=333"], 2, &["expected -180 to 180 °, found 333"]);
    refused(&["a.csv", "--set", "declination_deg"], 2, &["expected key=value"]);
    refused(
        &["a.csv", "--set", "bogus.beta=1"],
        2,
        &["no selected stage has a parameter `bogus.beta`", "fuser.hard_iron_sd_ut of multiple-model"],
    );
    let twice = ["a.csv", "--set", "declination_deg=1", "--set", "course.declination_deg=2"];
    refused(&twice, 2, &["course.declination_deg is set twice", "keep one"]);
    refused(&["sim:s1?seed=2&rate_hz=50&seed=3"], 2, &["`seed` is set twice"]);
    refused(&["a.csv", "b/a.csv"], 2, &["two trials are named `a`"]);
    refused(&["sim:s9"], 2, &["unknown scenario `s9`", "cruise"]);
    refused(&["a.csv", "--out", "."], 2, &["this is the recording itself"]);
    refused(&["a.csv", "none.csv"], 3, &["opening the recording none.csv", "check the path"]);
    refused(&["bad.csv"], 3, &["reading the recording bad.csv: line 1: found no column gy"]);
    refused(&["a.csv", "--gnss", "bad.csv"], 3, &["bad.csv: line 1, column 2: found \"gx\""]);
    refused(&["a.csv", "sim:s1", "--gnss", "fixes.csv"], 2, &["fixes.csv belongs to one recording", "2 trials"]);
    refused(&["a.csv", "--out", "a.csv"], 1, &["writing a.csv"]);
    refused(&[], 2, &["<FILE>"]);
    assert_eq!(fs::read_to_string(folder.path().join("a.csv")).unwrap(), at_rest(0.0, 0.0));
}

#[test]
fn the_stages_are_listed_for_people_and_for_scripts() {
    let listed = |arguments: &[&str]| String::from_utf8(plumb(arguments).output().unwrap().stdout).unwrap();
    let people = listed(&["stage", "list"]);
    assert!(
        people.contains("  multiple-model (default)\n    parts: wz + aided\n")
            && people.contains("-180 to 180 °, default 0"),
        "{people}"
    );
    let json: Value = serde_json::from_str(&listed(&["stage", "list", "--json"])).unwrap();
    let names: Vec<_> = (0..4).map(|slot| json.pointer(&format!("/slots/{slot}/slot")).unwrap().clone()).collect();
    assert_eq!(names, ["gyro", "accel", "fuser", "course"]);
}

#[test]
fn a_stage_is_held_against_the_kit_by_name() {
    let output = plumb(&["stage", "test", "--slot", "gyro", "mobius", "--json"]).output().unwrap();
    assert_eq!(output.status.code(), Some(0));
    let reports: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(reports.pointer("/0/stage"), Some(&Value::from("mobius")));
    assert!(reports.pointer("/0/checks/10/passed").is_some_and(|passed| passed == true));
    for unknown in [&["stage", "test", "mobious"][..], &["stage", "test", "--slot", "fuser", "mobius"]] {
        assert_eq!(plumb(unknown).output().unwrap().status.code(), Some(2));
    }
}

#[test]
fn what_is_written_is_what_the_running_system_writes() {
    let Some(data) = crate::common::data() else { return };
    let trial = data.join(TRIAL);
    let system = System::new("");
    let (up, out) = (system.path("up.csv"), system.path("out"));
    let (trial, up_text) = (trial.to_str().unwrap(), up.to_str().unwrap());
    system.run(&["--replay", trial, "--in-process", "--speed", "max", "--out", up_text]).assert_whole();
    scores(system.folder.path(), &[trial, "--out", out.to_str().unwrap()]);
    let written = out.join("07_undisturbed_fast_rotation_B.csv");
    assert!(fs::read(written).unwrap() == fs::read(up).unwrap(), "the files differ");
}

#[test]
fn broad_is_met_within_0_64_degrees_by_gyro_and_accelerometer_alone() {
    let Some(data) = crate::common::data() else { return };
    let mut trials: Vec<_> = fs::read_dir(data.join("broad")).unwrap().map(|entry| entry.unwrap().path()).collect();
    trials.sort();
    let trials: Vec<&str> = trials.iter().map(|path| path.to_str().unwrap()).collect();
    let folder = tempfile::tempdir().unwrap();
    let scores = scores(folder.path(), &[&trials[..], &["--mag", "off"]].concat());
    assert_eq!(scores.pointer("/stages/0/trials").unwrap().as_array().unwrap().len(), 10);
    let mean_deg = number(&scores, "/stages/0/mean/inclination");
    println!("mean inclination RMSE {mean_deg:.3}°");
    assert!(mean_deg <= BROAD_LIMIT_DEG, "{mean_deg}°");
}

#[test]
fn what_is_wrong_with_the_input_is_told_before_the_table_and_nothing_of_what_is_right() {
    let in_g = |text: String| text.replace("9.80665", "1.0");
    let doubled = |text: String| text.lines().flat_map(|line| [line, "\n", line, "\n"]).skip(2).collect::<String>();
    let right = at_rest(0.0, 0.0);
    let folder =
        folder_with(&[("right.csv", right.clone()), ("g.csv", in_g(right.clone())), ("twice.csv", doubled(right))]);
    let said = |file: &str| String::from_utf8(score(folder.path(), &[file]).stderr).unwrap();
    assert!(said("sim:s1?duration_s=2").contains("the simulation ends before scoring starts"));
    assert!(!said("right.csv").contains("warning"), "{}", said("right.csv"));
    for (file, words) in [
        ("g.csv", ["warning: g: force-unit", "--units g", "ingest.calibration.accel.scale = [9.80665"]),
        ("twice.csv", ["warning: twice: 400 readings rejected", "timestamps equal to the previous one: 400", "twice: timestamps"]),
    ] {
        words.iter().for_each(|words| assert!(said(file).contains(words), "no {words:?} in:\n{}", said(file)));
    }
}
