//! `plumb score --estimate`: attitudes of other programs are scored, plotted and reported like
//! those of a stage.
use std::{fs, path::Path};

use serde_json::Value;

use super::score::{assert_rejected, folder_with, number, score, scores};

/// Simulation with a magnetometer, so that the heading is known.
const TRIAL: &str = "sim:s3?duration_s=20&rate_hz=100";
/// Simulation without a magnetometer.
const WITHOUT_NORTH: &str = "sim:s1?duration_s=20&rate_hz=100";

/// Writes the attitudes of a stage to `mine.csv`.
fn write_estimate(folder: &Path, trial: &str) {
    scores(folder, &[trial, "--fuser", "vqf", "--out-dir", "out"]);
    let written = fs::read_dir(folder.join("out")).unwrap().next().unwrap().unwrap().path();
    fs::rename(written, folder.join("mine.csv")).unwrap();
}

fn without_details(trial: &Value) -> Value {
    let mut errors = trial.clone();
    for key in ["ns_per_update", "normalised", "course", "gyro_bias_deg_s", "name"] {
        errors.as_object_mut().unwrap().remove(key);
    }
    errors
}

#[test]
fn estimate_has_the_errors_of_the_stage_that_wrote_it() {
    for (trial, more) in [(TRIAL, &[][..]), (WITHOUT_NORTH, &["--arbitrary-heading", "mine"])] {
        let folder = folder_with(&[]);
        write_estimate(folder.path(), trial);
        let arguments = [&[trial, "--fuser", "vqf", "--estimate", "mine=mine.csv"], more].concat();
        let scores = scores(folder.path(), &arguments);
        assert_eq!(scores.pointer("/stages/1/fuser"), Some(&Value::from("mine")));
        assert_eq!(scores.pointer("/stages/1/gyro"), Some(&Value::Null));
        let [stage, estimate] = [0, 1].map(|stage| scores.pointer(&format!("/stages/{stage}/trials/0")).unwrap());
        assert_eq!(without_details(stage), without_details(estimate), "{trial}");
        assert!(number(&scores, "/stages/1/trials/0/inclination") > 0.0);
        assert_eq!(estimate["ns_per_update"], Value::Null);
        assert!(estimate["normalised"].as_object().unwrap().values().all(Value::is_null), "{estimate}");
    }
}

#[test]
fn estimate_is_in_table_figures_and_report() {
    let folder = folder_with(&[]);
    write_estimate(folder.path(), TRIAL);
    // The file has the columns of another program.
    let text = fs::read_to_string(folder.path().join("mine.csv")).unwrap();
    fs::write(folder.path().join("mine.csv"), text.replacen("t_s,", "Time;", 1).replace(',', ";")).unwrap();
    let outputs = ["--csv", "tables", "--plot", "figures", "--report", "report.html", "--out-dir", "attitudes"];
    let arguments = [&[TRIAL, "--estimate", "mine=mine.csv"][..], &outputs].concat();
    let output = score(folder.path(), &arguments);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let stdout = String::from_utf8(output.stdout).unwrap();
    assert!(stdout.contains(" mine ") && stdout.contains("best by total error: "), "{stdout}");
    let stem = "sim_s3_duration_s_20_rate_hz_100";
    let text = |path: &str| fs::read_to_string(folder.path().join(path)).unwrap();
    for figure in ["angles", "error", "signed"] {
        let svg = text(&format!("figures/{stem}.{figure}.svg"));
        ["multiple-model", "mine", "reference"]
            .iter()
            .for_each(|name| assert!(figure != "angles" && *name == "reference" || svg.contains(name), "{name}"));
    }
    assert!(text(&format!("figures/mine/{stem}.uvz.svg")).contains("fused"));
    assert_eq!(text(&format!("tables/mine/{stem}.csv")).lines().count(), 2002);
    let page = text("report.html");
    assert!(page.contains("<td>mine</td><td>–</td><td>–</td><td>–</td>"), "{page}");
    assert!(folder.path().join("attitudes/multiple-model").exists() && !folder.path().join("attitudes/mine").exists());
}

#[test]
fn partial_estimate_is_scored_with_a_warning() {
    let folder = folder_with(&[]);
    write_estimate(folder.path(), TRIAL);
    let text = fs::read_to_string(folder.path().join("mine.csv")).unwrap();
    let half: String = text.lines().take(1501).map(|line| format!("{line}\n")).collect();
    fs::write(folder.path().join("half.csv"), half).unwrap();
    let on_other_clock = text.lines().map(|line| if line.starts_with('t') { line.into() } else { format!("9{line}") });
    let on_other_clock: Vec<String> = on_other_clock.collect();
    fs::write(folder.path().join("late.csv"), on_other_clock[..500].join("\n") + "\n").unwrap();
    let stderr = |file: &str| {
        let output = score(folder.path(), &[TRIAL, "--fuser", "vqf", "--estimate", &format!("mine={file}")]);
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stderr).unwrap()
    };
    assert!(!stderr("mine.csv").contains("estimate"), "{}", stderr("mine.csv"));
    let half = stderr("half.csv");
    assert!(half.contains("warning") && half.contains("estimate `mine` has an attitude at "), "{half}");
    let late = stderr("late.csv");
    assert!(late.contains("has no attitude at any of the scored samples; check that its t_s is the clock"), "{late}");
}

#[test]
fn invalid_estimates_are_rejected_with_remedy() {
    let folder = folder_with(&[("a.csv", "t_s,qw,qx,qy,qz\n0,1,0,0,0\n".into()), ("bad.csv", "t_s,qw\n0,1\n".into())]);
    let rejected = |arguments: &[&str], code: i32, messages: &[&str]| {
        assert_rejected(folder.path(), &[&["sim:s1?duration_s=2"], arguments].concat(), code, messages);
    };
    rejected(&["--estimate", "a.csv"], 2, &["expected NAME=FILE"]);
    rejected(&["--estimate", "wz=a.csv", "--fuser", "wz"], 2, &["estimate `wz` has the name of a fuser"]);
    rejected(&["--estimate", "a=a.csv", "--estimate", "a=a.csv"], 2, &["estimate `a` has the name"]);
    rejected(&["--estimate", "../a=a.csv"], 2, &["contains a slash"]);
    rejected(&["--estimate", "a\u{1b}[31m=a.csv"], 2, &["estimate \"a\\u{1b}[31m\": the name", "control character"]);
    rejected(&["--estimate", "a=none.csv"], 3, &["none.csv"]);
    rejected(&["--estimate", "a=bad.csv"], 3, &["bad.csv: line 1"]);
    rejected(&["sim:s3", "--estimate", "a=a.csv"], 2, &["estimate `a` belongs to one recording", "2 trials"]);
    let misspelt = ["--estimate", "mine=a.csv", "--arbitrary-heading", "mien"];
    rejected(&misspelt, 2, &["unknown estimate `mien`; did you mean `mine`?"]);
}
