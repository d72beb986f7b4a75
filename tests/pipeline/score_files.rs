//! Files written by `plumb score`.
//!
//! The scores can be recomputed from the tables (`--csv`). Figures (`--plot`) have a time window
//! and a size. Ranges in `--set` yield error curves over a parameter.
use std::{collections::HashMap, fs, ops::Range, path::Path};

use serde_json::Value;

use super::score::{assert_rejected, at_rest, folder_with, number, scores};

/// Maximum size of a figure, in bytes.
const MAX_FIGURE_BYTES: usize = 300_000;

/// Returns the columns of a CSV file by name. Values that are not numbers are NaN.
fn columns(file: &Path) -> HashMap<String, Vec<f64>> {
    let text = fs::read_to_string(file).unwrap();
    let mut lines = text.lines();
    let header: Vec<_> = lines.next().unwrap().split(',').collect();
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    assert!(rows.iter().all(|row| row.len() == header.len()), "{}", header.len());
    let column = |index: usize| rows.iter().map(|row| row[index].parse().unwrap_or(f64::NAN)).collect();
    header.iter().enumerate().map(|(index, name)| ((*name).to_owned(), column(index))).collect()
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0), |(sum, count), x| (sum + x * x, count + 1));
    (sum / f64::from(count)).sqrt()
}

#[test]
fn scores_can_be_recomputed_from_table() {
    let folder = folder_with(&[]);
    let trial = "sim:s1?duration_s=20";
    let scores = scores(folder.path(), &[trial, "--fuser", "wz", "--fuser", "madgwick", "--csv", "tables"]);
    for (stage, fuser) in ["wz", "madgwick"].into_iter().enumerate() {
        let columns = columns(&folder.path().join(format!("tables/{fuser}/sim_s1_duration_s_20.csv")));
        let scored = || columns["scored"].iter().enumerate().filter(|(_, scored)| **scored == 1.0).map(|(row, _)| row);
        let error = |name: &str| rms(scored().map(|row| columns[name][row] - columns[&format!("true_{name}")][row]));
        let reported = |key: &str| number(&scores, &format!("/stages/{stage}/trials/0/{key}"));
        assert_eq!(columns["t_s"].len() as f64, reported("ticks"));
        for (column, key) in [("roll_rad", "roll"), ("pitch_rad", "pitch")] {
            assert!((error(column).to_degrees() - reported(key)).abs() < 1e-9, "{fuser} {key}");
        }
        let bias = ["x", "y", "z"].map(|axis| error(&format!("bias_{axis}_rad_s")).to_degrees());
        let length = bias.iter().map(|x| x * x).sum::<f64>().sqrt();
        assert!((length - reported("gyro_bias_deg_s")).abs() < 1e-9, "{fuser}: {bias:?}");
        assert!(columns["true_u"].iter().chain(&columns["inclination_sd_rad"]).all(|value| value.is_finite()));
        assert_eq!(columns["course_rad"].len(), columns["true_course_rad"].len());
        // The attitude from the gyro alone starts at the accelerometer's up vector and then drifts.
        // The accelerometer's error does not grow.
        let distance = |of: &str, row: usize| {
            let axis_error = |axis: &str| columns[&format!("{of}_{axis}")][row] - columns[&format!("true_{axis}")][row];
            axis_error("u").hypot(axis_error("v"))
        };
        assert_eq!(distance("gyro", 0), distance("accel", 0));
        let mean =
            |of: &str, rows: Range<usize>| rows.clone().map(|row| distance(of, row)).sum::<f64>() / rows.len() as f64;
        assert!(mean("gyro", 1800..2000) > 2.0 * mean("gyro", 1..200), "{fuser}");
        let accel = mean("accel", 1800..2000) / mean("accel", 1..200);
        assert!((0.5..2.0).contains(&accel), "{fuser}: {accel}");
    }
}

#[test]
fn table_without_reference_has_empty_truth() {
    let text = "t_s,gx,gy,gz,ax,ay,az\n0,0,0,0,0,0,9.8\n0.01,0,0,0,0,0,9.8\n".to_owned();
    let folder = folder_with(&[("plain.csv", text)]);
    scores(folder.path(), &["plain.csv", "--csv", "tables"]);
    let columns = columns(&folder.path().join("tables/plain.csv"));
    assert_eq!((columns["scored"].clone(), columns["roll_rad"].len()), (vec![0.0; 2], 2));
    assert!(columns.iter().filter(|(name, _)| name.starts_with("true_")).all(|(_, of)| of.iter().all(|x| x.is_nan())));
    assert_rejected(folder.path(), &["plain.csv", "--csv", "."], 2, &["this is the recording itself", "--csv"]);
}

#[test]
fn stages_and_reference_share_one_figure() {
    let folder = folder_with(&[]);
    scores(folder.path(), &["sim:s1?duration_s=20", "--fuser", "wz", "--fuser", "vqf", "--plot", "figures"]);
    let text = |name: &str| fs::read_to_string(folder.path().join("figures").join(name)).unwrap();
    for (name, labels) in [
        ("angles", &["wz", "vqf", "reference", "yaw ψ, °", "course H, °"][..]),
        ("signed", &["wz", "vqf", "roll γ, °", "arbitrary yaw"]),
        ("error", &["wz", "vqf", "inclination, °"]),
        ("bias", &["wz", "vqf", "reference", "ζ, °/s"]),
        ("bias-error", &["wz", "vqf", "ξ, °/s"]),
        ("uvz", &["wz", "vqf", "reference", "z, °"]),
    ] {
        let svg = text(&format!("sim_s1_duration_s_20.{name}.svg"));
        labels.iter().for_each(|words| assert!(svg.contains(words), "no {words:?} in {name}"));
        assert!(svg.len() <= MAX_FIGURE_BYTES, "{name}: {} bytes", svg.len());
        // The first line is solid. The second one is dashed, so it consists of many pieces in one
        // colour.
        let pieces = |color: &str| svg.matches(&format!("stroke=\"{color}\"")).count();
        assert!(pieces("#CC79A7") > 3 * pieces("#0072B2"), "{name}: {} {}", pieces("#CC79A7"), pieces("#0072B2"));
    }
    for own in ["wz", "vqf"] {
        assert!(text(&format!("{own}/sim_s1_duration_s_20.v.svg")).contains("gyro, open loop"));
    }
}

#[test]
fn figures_of_long_trials_are_small() {
    let folder = folder_with(&[]);
    let stages = ["--fuser", "aided", "--fuser", "wz", "--plot", "figures"];
    scores(folder.path(), &[&["sim:cruise?duration_s=120"], &stages[..]].concat());
    let figures = folder.path().join("figures");
    let folders = [figures.clone(), figures.join("aided"), figures.join("wz")];
    let files = folders.iter().flat_map(|folder| fs::read_dir(folder).unwrap()).map(|entry| entry.unwrap().path());
    let svgs: Vec<_> = files.filter(|path| path.extension().is_some_and(|end| end == "svg")).collect();
    assert_eq!(svgs.len(), 22);
    for path in svgs {
        let bytes = fs::metadata(&path).unwrap().len();
        assert!(bytes <= MAX_FIGURE_BYTES as u64, "{}: {bytes} bytes", path.display());
    }
}

#[test]
fn figures_have_requested_window_and_size() {
    let folder = folder_with(&[]);
    let trial = ["sim:s1?duration_s=20", "--plot", "figures", "--from", "8", "--to", "11.5", "--size", "640x480"];
    scores(folder.path(), &trial);
    let svg = fs::read_to_string(folder.path().join("figures/sim_s1_duration_s_20.v.svg")).unwrap();
    assert!(svg.starts_with("<svg width=\"640\" height=\"480\""), "{}", &svg[..80]);
    let ticks: Vec<_> = ["8", "10", "11", "7", "12", "20"].map(|tick| svg.contains(&format!("\n{tick}\n"))).into();
    assert_eq!(ticks, [true, true, true, false, false, false]);
    let rejected = |more: &[&str], message: &str| {
        assert_rejected(folder.path(), &[&["sim:s1"], more].concat(), 2, &[message]);
    };
    rejected(&["--plot", "figures", "--from", "5", "--to", "5"], "--to must be later than --from");
    rejected(&["--plot", "figures", "--size", "640"], "expected WIDTHxHEIGHT");
    rejected(&["--plot", "figures", "--size", "300x200"], "from 480x320 to 8000x8000");
    rejected(&["--plot", "figures", "--from", "500"], "the trial ends at 100.000 s; change --from or --to");
    rejected(&["--from", "5"], "--plot");
}

#[test]
fn parameter_range_gives_curve_and_keeps_scores() {
    let folder = folder_with(&[]);
    let trial = ["sim:s1?duration_s=20", "--fuser", "madgwick"];
    let range = ["--set", "fuser.beta_rad_s=0.01..0.5", "--plot", "figures"];
    let swept = scores(folder.path(), &[&trial[..], &range].concat());
    let curve = swept.pointer("/swept/0/curve").and_then(Value::as_array).unwrap();
    let field = |point: &Value, key: &str| point.get(key).and_then(Value::as_f64).unwrap();
    assert_eq!(curve.len(), 26, "expected 25 values over the range and the value before");
    let [first, last] = [&curve[0], &curve[25]].map(|point| field(point, "value"));
    assert_eq!((first, last), (0.01, 0.5));
    let least = curve.iter().map(|point| field(point, "inclination")).fold(f64::INFINITY, f64::min);
    assert_eq!(number(&swept, "/swept/0/best/error_deg"), least);
    let last_scores = scores(folder.path(), &[&trial[..], &["--set", &format!("beta_rad_s={last}")]].concat());
    assert!((number(&last_scores, "/stages/0/mean/roll") - field(&curve[25], "roll")).abs() < 1e-9);
    let unchanged = scores(folder.path(), &trial);
    assert_eq!(unchanged.pointer("/stages/0/mean"), swept.pointer("/stages/0/mean"), "the range changed the scores");
    let svg = fs::read_to_string(folder.path().join("figures/sweep.fuser.beta_rad_s.svg")).unwrap();
    for words in ["fuser.beta_rad_s, rad/s", "inclination error, °", "madgwick"] {
        assert!(svg.contains(words), "no {words:?}");
    }
    let plain = folder_with(&[("a.csv", at_rest(0.0, 0.0))]);
    assert_rejected(plain.path(), &["a.csv", "--set", "declination_deg=5..400"], 2, &["expected -180 to 180 °"]);
    assert_rejected(plain.path(), &["a.csv", "--set", "declination_deg=5..1"], 2, &["with a below b"]);
}
