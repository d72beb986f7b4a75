//! `plumb score --report`, `--tune` and `--launch`: a self-contained page that shows the scores, a
//! search for the best parameter value, and the calibration of a launch file.
use std::{
    fs,
    os::unix::fs::{PermissionsExt, symlink},
    path::Path,
};

use roxmltree::{Document, Node, ParsingOptions};
use serde_json::Value;

use super::score::{assert_rejected, at_rest, folder_with, number, score, scores};
use crate::common::{attitudes, data};

/// Returns a recording with no reference, and with a gyro bias that the stages estimate
/// differently.
fn without_reference() -> String {
    let row = |i: i32| {
        let t_s = f64::from(i) * 0.01;
        let (sin, cos) = (0.4 * t_s).sin_cos();
        format!("{t_s},{},0.02,0,0,{},{}\n", 0.02 + 0.1 * cos, 3.0 * sin, 9.3 * cos.abs().max(0.5))
    };
    "t_s,gx,gy,gz,ax,ay,az\n".to_owned() + &(0..3000).map(row).collect::<String>()
}

fn page(path: &Path) -> String {
    let mode = fs::metadata(path).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o644, "others cannot read the page");
    fs::read_to_string(path).unwrap()
}

fn parsed(page: &str) -> Document<'_> {
    Document::parse_with_options(page, ParsingOptions { allow_dtd: true, ..ParsingOptions::default() }).unwrap()
}

/// Asserts that the page is self-contained: no external resources, scripts or forms.
fn assert_self_contained(page: &str) {
    let document = parsed(page);
    for node in document.descendants() {
        let name = node.tag_name().name();
        assert!(!["script", "img", "link", "iframe", "object", "embed", "base", "form"].contains(&name), "{name}");
        let loading = ["src", "href", "action", "srcset", "data", "poster"];
        assert!(
            node.attributes()
                .all(|attribute| !loading.contains(&attribute.name()) && !attribute.name().starts_with("on")),
            "{node:?}"
        );
    }
    for word in ["://", "@import", "url(h", "url(/", "url(\""] {
        assert!(!page.contains(word), "{word}");
    }
    let policy = document.descendants().find(|node| node.attribute("http-equiv") == Some("Content-Security-Policy"));
    assert!(policy.is_some_and(|policy| policy.attribute("content").unwrap().starts_with("default-src 'none'")));
}

fn texts<'d>(document: &'d Document<'_>, element: &str) -> Vec<&'d str> {
    document.descendants().filter(|node| node.has_tag_name(element)).filter_map(|node| node.text()).collect()
}

/// Returns the curves in each chart, recognised by their colours.
fn lines_of(document: &Document<'_>) -> Vec<Vec<&'static str>> {
    let charts =
        document.descendants().filter(|node| node.has_tag_name("figure") && node.attribute("aria-label").is_some());
    let lines = |chart: Node<'_, '_>| {
        let colors: Vec<_> = chart
            .descendants()
            .filter(|node| node.has_tag_name("polyline"))
            .filter_map(|node| node.attribute("stroke"))
            .collect();
        let curves = [("#1A1A1A", "reference"), ("#0072B2", "stage0"), ("#CC79A7", "stage1")];
        curves.into_iter().filter(|(color, _)| colors.contains(color)).map(|(_, name)| name).collect()
    };
    charts.map(lines).collect()
}

#[test]
fn report_shows_stages_reference_and_scored_errors() {
    let folder = tempfile::tempdir().unwrap();
    let trial = "sim:s1?duration_s=20&rate_hz=100";
    let scores = scores(folder.path(), &[trial, "--fuser", "wz", "--fuser", "vqf", "--report", "out.html"]);
    let page = page(&folder.path().join("out.html"));
    assert_self_contained(&page);
    let document = parsed(&page);
    assert_eq!(texts(&document, "h2"), ["Errors", trial, "Settings"]);
    let titles = texts(&document, "h3");
    let [wz, vqf] = [0, 1].map(|stage| number(&scores, &format!("/stages/{stage}/mean/inclination")));
    assert_eq!(titles[0], format!("inclination error, RMS over scored samples: wz {wz:.3}°, vqf {vqf:.3}°"));
    assert_eq!(titles[1..], ["roll", "pitch", "yaw"], "charts of heading or total error without a known heading");
    let both = ["stage0", "stage1"];
    let all = ["reference", "stage0", "stage1"];
    let lines = lines_of(&document);
    assert!(lines[0] == both && lines[1..].iter().all(|lines| *lines == all), "{lines:?}");
    assert_eq!(lines.len(), 4);
    let advice = scores.pointer("/recommendation/text").and_then(Value::as_str).unwrap();
    assert!(advice.starts_with("best by inclination error: wz"), "{advice}");
    assert!(texts(&document, "p").contains(&advice), "{page}");
}

#[test]
fn recommended_launch_file_is_valid() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["sim:s1?duration_s=20&rate_hz=100", "--fuser", "madgwick", "--tune", "beta_rad_s=0.005..0.5"];
    let scores = scores(folder.path(), &arguments);
    let launch = scores.pointer("/recommendation/launch").and_then(Value::as_str).unwrap();
    fs::write(folder.path().join("chosen.toml"), launch).unwrap();
    let again = super::score::scores(folder.path(), &[arguments[0], "--launch", "chosen.toml"]);
    assert_eq!(again.pointer("/stages/0/fuser").unwrap(), "madgwick");
    assert_eq!(again.pointer("/stages/0/mean"), scores.pointer("/stages/0/mean"));
}

#[test]
fn report_without_reference_shows_stage_differences() {
    let folder = folder_with(&[("plain.csv", without_reference()), ("turned.csv", at_rest(30.0, 0.0))]);
    let arguments = ["plain.csv", "--fuser", "wz", "--fuser", "madgwick", "--report", "out.html"];
    let scores = scores(folder.path(), &arguments);
    let difference_deg = number(&scores, "/differences/0/inclination");
    assert!(difference_deg > 0.01, "{scores}");
    let page = page(&folder.path().join("out.html"));
    assert_self_contained(&page);
    let document = parsed(&page);
    let title = format!("inclination difference from the first stage, RMS: madgwick {difference_deg:.3}°");
    assert!(texts(&document, "h3").contains(&title.as_str()), "{:?}", texts(&document, "h3"));
    let lines = lines_of(&document);
    assert_eq!(lines[0], ["stage1"]);
    assert_eq!(lines[3], ["stage0", "stage1"]);
    let text = String::from_utf8(score(folder.path(), &arguments).stdout).unwrap();
    assert!(text.contains("no reference, so no ranking") && text.contains("madgwick differs from wz"), "{text}");
    assert_rejected(
        folder.path(),
        &["plain.csv", "--fuser", "madgwick", "--tune", "beta_rad_s=0..1"],
        2,
        &["reference"],
    );
}

#[recorded::test]
fn report_of_real_recording_ranks_by_total_error() {
    let Some(data) = data() else { return };
    let folder = tempfile::tempdir().unwrap();
    let trial = data.join("broad/07_undisturbed_fast_rotation_B.csv.gz");
    let arguments = [trial.to_str().unwrap(), "--fuser", "wz", "--fuser", "vqf", "--report", "out.html"];
    let scores = scores(folder.path(), &arguments);
    let page = page(&folder.path().join("out.html"));
    assert_self_contained(&page);
    assert!(page.len() < 1 << 20, "{} bytes", page.len());
    let document = parsed(&page);
    let titles = texts(&document, "h3");
    for (at, error) in ["inclination", "heading", "total"].into_iter().enumerate() {
        let [wz, vqf] = [0, 1].map(|stage| number(&scores, &format!("/stages/{stage}/mean/{error}")));
        assert_eq!(titles[at], format!("{error} error, RMS over scored samples: wz {wz:.3}°, vqf {vqf:.3}°"));
    }
    let both = ["stage0", "stage1"];
    assert!(lines_of(&document)[..3].iter().all(|lines| *lines == both));
    // With a magnetometer the heading is known, so the total error ranks the stages.
    let advice = scores.pointer("/recommendation/text").and_then(Value::as_str).unwrap();
    assert!(advice.contains("total error"), "{advice}");
}

#[test]
fn report_replaces_link_but_never_recording() {
    let folder = folder_with(&[("turned.csv", at_rest(30.0, 0.0)), ("precious.txt", "mine".into())]);
    symlink(folder.path().join("precious.txt"), folder.path().join("out.html")).unwrap();
    scores(folder.path(), &["turned.csv", "--report", "out.html"]);
    assert_eq!(fs::read_to_string(folder.path().join("precious.txt")).unwrap(), "mine");
    assert!(!fs::symlink_metadata(folder.path().join("out.html")).unwrap().is_symlink());
    assert_self_contained(&page(&folder.path().join("out.html")));
    let messages = ["turned.csv", "this is the recording itself", "--report"];
    assert_rejected(folder.path(), &["turned.csv", "--report", "turned.csv"], 2, &messages);
    assert_eq!(fs::read_to_string(folder.path().join("turned.csv")).unwrap(), at_rest(30.0, 0.0));
    let missing_folder = ["turned.csv", "--report", "missing_folder/out.html"];
    assert_rejected(folder.path(), &missing_folder, 1, &["missing_folder/out.html"]);
}

#[test]
fn recording_name_is_escaped_in_report() {
    let folder = folder_with(&[("<b onload='x'>&.csv", at_rest(30.0, 0.0))]);
    scores(folder.path(), &["<b onload='x'>&.csv", "--report", "out.html"]);
    let page = page(&folder.path().join("out.html"));
    assert_self_contained(&page);
    assert!(texts(&parsed(&page), "h2").contains(&"<b onload='x'>&"));
}

#[test]
fn search_finds_value_with_lowest_error() {
    let folder = tempfile::tempdir().unwrap();
    let trial = ["sim:s1?duration_s=30&rate_hz=100", "--fuser", "madgwick"];
    let tuned =
        scores(folder.path(), &[&trial[..], &["--tune", "beta_rad_s=0.001..1", "--report", "out.html"]].concat());
    let best = number(&tuned, "/tuned/0/best/value");
    let least = number(&tuned, "/tuned/0/best/error_deg");
    assert_eq!(tuned.pointer("/tuned/0/setting").unwrap(), "fuser.beta_rad_s");
    assert_eq!(tuned.pointer("/tuned/0/at_range_end").unwrap(), false);
    let error_at = |value: f64| {
        let scores = scores(folder.path(), &[&trial[..], &["--set", &format!("beta_rad_s={value}")]].concat());
        number(&scores, "/stages/0/mean/inclination")
    };
    assert!((error_at(best) - least).abs() < 1e-9, "the reported error of the best value differs from its score");
    assert_eq!(number(&tuned, "/stages/0/mean/inclination"), error_at(best), "the scores do not use the best value");
    assert!((number(&tuned, "/tuned/0/before/error_deg") - error_at(0.08)).abs() < 1e-9);
    for value in [0.001, 0.003, 0.01, 0.0125, 0.0135, 0.017, 0.02, 0.03, 0.08, 0.2, 1.0] {
        assert!(error_at(value) >= least * 0.995, "{value} is better than {best}: {} < {least}", error_at(value));
    }
    let page = page(&folder.path().join("out.html"));
    let document = parsed(&page);
    let points = document.descendants().filter(|node| node.has_tag_name("circle")).count();
    assert_eq!(points, tuned.pointer("/tuned/0/curve").and_then(Value::as_array).unwrap().len());
    assert!(points > 20 && texts(&document, "h2").contains(&"fuser.beta_rad_s of madgwick"));
}

#[test]
fn search_reports_end_of_range_and_invalid_ranges() {
    let folder = tempfile::tempdir().unwrap();
    let trial = "sim:s1?duration_s=20&rate_hz=100";
    let scores = scores(folder.path(), &[trial, "--fuser", "madgwick", "--tune", "fuser.beta_rad_s=0.5..1"]);
    assert_eq!(number(&scores, "/tuned/0/best/value"), 0.08, "the initial value is not a candidate");
    let scores = super::score::scores(
        folder.path(),
        &[trial, "--fuser", "madgwick", "--set", "beta_rad_s=0.9", "--tune", "beta_rad_s=0.5..1"],
    );
    assert_eq!(number(&scores, "/tuned/0/best/value"), 0.5);
    let advice = scores.pointer("/recommendation/text").and_then(Value::as_str).unwrap();
    assert!(advice.contains("at the end of the range: extend the range"), "{advice}");
    for (range, message) in [
        ("beta_rad_s=0..11", "expected 0 to 10 rad/s, found 11"),
        ("beta=0..1", "did you mean `beta_rad_s`?"),
        ("beta_rad_s=1..0", "with a below b"),
    ] {
        assert_rejected(folder.path(), &[trial, "--fuser", "madgwick", "--tune", range], 2, &[message]);
    }
}

#[test]
fn launch_file_calibration_and_mounting_are_applied() {
    // The sensor unit is mounted upside down with its axes forward-right-down. Its accelerometer
    // has a bias of 1 m/s² along the forward axis.
    let level = "0,0.7071067811865476,0.7071067811865476,0";
    let row = |i: i32| format!("{},0,0,0,1,0,-9.80665,{level},1\n", f64::from(i) * 0.01);
    let text = "t_s,gx,gy,gz,ax,ay,az,qw,qx,qy,qz,mov\n".to_owned() + &(0..500).map(row).collect::<String>();
    let launch = "[ingest.mounting]\naxes = \"frd\"\n[ingest.calibration.accel]\nbias = [1.0, 0.0, 0.0]\n[fuser]\nstage = \"madgwick\"\n[fuser.set]\nbeta_rad_s = 0.5\n";
    let folder = folder_with(&[("unit.csv", text), ("my.toml", launch.into())]);
    let plain = scores(folder.path(), &["unit.csv"]);
    let tilt_deg = 1f64.atan2(9.80665).to_degrees();
    assert!((number(&plain, "/stages/0/mean/inclination") - tilt_deg).abs() < 0.1, "{plain}");
    let launched =
        scores(folder.path(), &["unit.csv", "--launch", "my.toml", "--out-dir", "out", "--report", "out.html"]);
    assert!(number(&launched, "/stages/0/mean/inclination") < 1e-3, "{launched}");
    let [.., (_, [w, x, y, _])] = &attitudes(&folder.path().join("out/unit.csv"))[..] else { panic!("no attitude") };
    assert!(w.abs() > 0.999 && x.hypot(*y) < 1e-3, "the mounting is not applied");
    assert_eq!(launched.pointer("/stages/0/fuser").unwrap(), "madgwick");
    assert_eq!(number(&launched, "/stages/0/settings/fuser.beta_rad_s"), 0.5);
    let page = page(&folder.path().join("out.html"));
    assert_self_contained(&page);
    let cells = parsed(&page).descendants().filter_map(|node| Some(node.text()?.to_owned())).collect::<Vec<_>>();
    assert!(cells.iter().any(|cell| cell.contains("bias [1.0, 0.0, 0.0]")), "{cells:?}");
    assert!(cells.contains(&"[[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]".to_owned()), "{cells:?}");
    // Settings in the launch file apply only to the stage for which they are given.
    let other = scores(folder.path(), &["unit.csv", "--launch", "my.toml", "--fuser", "wz"]);
    assert_eq!(other.pointer("/stages/0/settings").unwrap(), &serde_json::json!({}));
    assert!(number(&other, "/stages/0/mean/inclination") < 1e-3, "{other}");
}
