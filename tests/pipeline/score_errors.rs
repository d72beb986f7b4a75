//! `plumb score`: errors of angles, course and gyro bias, drift of an arbitrary heading, and errors
//! normalised by the reported standard deviations.
use std::fmt::Write;

use serde_json::Value;

use super::score::{folder_with, number, score, scores};

/// Returns a recording at rest with a reference that rotates, as if the gyro had an unobservable
/// bias.
fn rotating_reference(deg_s: f64) -> String {
    let mut text = String::from("t_s,gx,gy,gz,ax,ay,az,qw,qx,qy,qz,mov\n");
    for row in 0..3000 {
        let t_s = f64::from(row) * 0.01;
        let (sin, cos) = (0.5 * (40.0 + deg_s * t_s)).to_radians().sin_cos();
        writeln!(text, "{t_s},0,0,0,0,0,9.80665,{cos},0,0,{sin},1").unwrap();
    }
    text
}

fn table(folder: &std::path::Path, arguments: &[&str]) -> String {
    String::from_utf8(score(folder, arguments).stdout).unwrap()
}

#[test]
fn arbitrary_heading_is_scored_by_its_drift() {
    let folder = folder_with(&[("rotating.csv", rotating_reference(-0.05))]);
    let scores = scores(folder.path(), &["rotating.csv"]);
    let trial = |key: &str| number(&scores, &format!("/stages/0/trials/0/{key}"));
    assert!((trial("drift_deg_min") - 3.0).abs() < 0.01 && (trial("drift_end_deg") - 1.5).abs() < 0.01, "{scores}");
    assert_eq!(scores.pointer("/stages/0/trials/0/heading_is_known"), Some(&Value::Bool(false)));
    for error in ["yaw", "heading", "total"] {
        assert_eq!(scores.pointer(&format!("/stages/0/trials/0/{error}")), Some(&Value::Null), "{error}: {scores}");
    }
    let table = table(folder.path(), &["rotating.csv"]);
    assert!(
        table.contains("arb.") && !table.contains("39."),
        "the offset of an arbitrary heading is printed:\n{table}"
    );
    assert!(table.contains("drift +3.000°/min") && table.contains("+1.50° at the end"), "{table}");
}

#[test]
fn missing_rates_are_reported() {
    let without_rate = rotating_reference(0.0).replace(",0,0,0,0,0,9.80665", ",nan,nan,nan,0,0,9.80665");
    let folder = folder_with(&[("still.csv", without_rate), ("ambiguous.csv", "t,a,b,c\n0,1,2,3\n1,1,2,3\n".into())]);
    let stderr = String::from_utf8(score(folder.path(), &["still.csv"]).stderr).unwrap();
    assert!(stderr.contains("3000 of 3000 samples have no valid angular rate"), "{stderr}");
    // A header that needs --map has the same exit code in all commands.
    for command in ["score", "info"] {
        let output = crate::common::plumb(&[command, "ambiguous.csv"]).current_dir(folder.path()).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{command}: {}", String::from_utf8_lossy(&output.stderr));
    }
}

#[test]
fn search_from_best_value_keeps_it() {
    let folder = folder_with(&[]);
    let search = ["sim:s1", "--fuser", "wz-closed", "--tune", "time_constant_s=1..2"];
    let scores = scores(folder.path(), &search);
    assert_eq!(scores.pointer("/tuned/0/best/value"), scores.pointer("/tuned/0/before/value"), "{scores}");
    let mut tried: Vec<_> = scores
        .pointer("/tuned/0/curve")
        .unwrap()
        .as_array()
        .unwrap()
        .iter()
        .map(|point| point["value"].as_f64().unwrap())
        .collect();
    let count = tried.len();
    tried.dedup();
    assert_eq!(tried.len(), count, "a value was tried twice: {tried:?}");
}

#[test]
fn scored_course_is_that_of_course_stage() {
    let folder = folder_with(&[]);
    let flight = ["sim:cruise?duration_s=240&gyro_bias_deg_s=0.3", "--mag", "off", "--fuser", "levelling"];
    let scores_with = |course: &str| scores(folder.path(), &[&flight[..], &["--course", course]].concat());
    let (angles, track) = (scores_with("angles"), scores_with("track"));
    assert_eq!(
        angles.pointer("/stages/0/trials/0/course"),
        Some(&Value::Null),
        "a course error without a course reference"
    );
    let course = number(&track, "/stages/0/trials/0/course");
    assert!((3.0..20.0).contains(&course), "S4 predicts at most T b = 15°: {course}");
    for key in ["roll", "pitch", "inclination", "drift_deg_min", "gyro_bias_deg_s"] {
        let [a, b] = [&angles, &track].map(|scores| number(scores, &format!("/stages/0/trials/0/{key}")));
        assert_eq!(a, b, "{key} depends on the course stage");
    }
    assert!(number(&track, "/stages/0/normalised/course/samples") > 1e4);
    assert_eq!(track.pointer("/stages/0/normalised/heading"), Some(&Value::Null));
}

#[test]
fn missing_bias_estimate_counts_as_full_error() {
    let folder = folder_with(&[]);
    let trial = ["sim:s1?duration_s=60&gyro_bias_deg_s=0.2", "--fuser", "madgwick", "--fuser", "wz"];
    let scores = scores(folder.path(), &trial);
    let [madgwick, wz] = [0, 1].map(|stage| number(&scores, &format!("/stages/{stage}/trials/0/gyro_bias_deg_s")));
    assert!((madgwick - 0.2 * 3f64.sqrt()).abs() < 1e-9 && wz < 0.3 * madgwick, "{madgwick}, {wz}");
    let inclination = number(&scores, "/stages/1/trials/0/inclination");
    let axes = ["roll", "pitch"].map(|axis| number(&scores, &format!("/stages/1/trials/0/{axis}")));
    assert!(axes.iter().all(|axis| *axis < 1.2 * inclination) && axes[0].hypot(axes[1]) > inclination, "{axes:?}");
    let table = table(folder.path(), &[&trial[..], &["--all-errors"]].concat());
    for words in ["bias, °/s", "drift, °/min", "error / reported SD / ideal", &format!("{madgwick:.4}")] {
        assert!(table.contains(words), "no {words:?} in:\n{table}");
    }
}

#[test]
fn seeds_give_spread_and_worst_of_every_error() {
    let folder = folder_with(&[]);
    let query = |seed: &str| format!("sim:s1?duration_s=10&seed={seed}&accel_noise_g=0.05");
    let each = [3, 4, 5].map(|seed: u64| {
        let scores = scores(folder.path(), &[&query(&seed.to_string())]);
        (seed, number(&scores, "/stages/0/trials/0/pitch"), number(&scores, "/stages/0/normalised/inclination/samples"))
    });
    let many = scores(folder.path(), &[&query("3..5")]);
    let trial = |key: &str| number(&many, &format!("/stages/0/trials/0/{key}"));
    let mean = each.iter().map(|(_, pitch, _)| pitch).sum::<f64>() / 3.0;
    assert!((trial("pitch") - mean).abs() < 1e-12 && trial("spread/sd/pitch") > 0.0);
    let worst = each.iter().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
    assert_eq!(trial("spread/worst_seed_by_error/pitch"), worst.0 as f64);
    let samples = each.iter().map(|(_, _, samples)| samples).sum::<f64>();
    assert_eq!(trial("normalised/inclination/samples"), samples, "total of all seeds");
}
