//! Remedies: each suggested option or launch-file line removes the issue for which it is printed.

use std::{collections::BTreeSet, fmt::Write as _, fs};

use import::{Mapping, Options, convert};
use judge::{Diagnosis, InputIssue};
use launch::Launch;
use readings::source::Reading;

use crate::common::{Change, INPUT_ERRORS, diagnose_with, readings, scaled};

/// Issues that are remedied in the wiring, the driver or the order of the rows. There is no line to
/// paste.
const WITHOUT_LINE: [InputIssue; 3] = [InputIssue::RateStuck, InputIssue::ForceStuck, InputIssue::FieldStuck];
/// Lines in the source file `diagnosis.rs` that no test pastes, because they need a file or a
/// device of the user.
const NOT_PASTED: [&str; 3] = ["--map", "--imu", "ingest.limits.{key}"];
/// Units of the recordings themselves. If a command names a wrong unit for such a recording, the
/// remedy is one of these.
const OWN_UNITS: [&str; 3] = ["rad/s", "m/s2", "s"];

/// Errors in addition to [`INPUT_ERRORS`].
const MORE_ERRORS: [(&str, Change, InputIssue, &str); 6] = [
    (
        "an accelerometer turned about z",
        |r| Reading { force_m_s2: [r.force_m_s2[1], -r.force_m_s2[0], r.force_m_s2[2]], ..r },
        InputIssue::AxesMismatch,
        "accelerometer's",
    ),
    (
        "fields in thousandths of gauss",
        |r| Reading { field_ut: r.field_ut.map(|m| scaled(m, 10.0)), ..r },
        InputIssue::FieldUnit,
        "thousandths of gauss",
    ),
    ("fields in T", |r| Reading { field_ut: r.field_ut.map(|m| scaled(m, 1e-6)), ..r }, InputIssue::FieldUnit, "in T"),
    (
        "forces in thousandths of g",
        |r| Reading { force_m_s2: scaled(r.force_m_s2, 1000.0 / 9.80665), ..r },
        InputIssue::ForceUnit,
        "thousandths of g",
    ),
    (
        "forces multiplied by g twice",
        |r| Reading { force_m_s2: scaled(r.force_m_s2, 9.80665), ..r },
        InputIssue::ForceUnit,
        "m/s² read as g",
    ),
    (
        "raw counts within the limit",
        |r| Reading { force_m_s2: scaled(r.force_m_s2, 30.0), ..r },
        InputIssue::ForceUnit,
        "a wrong scale",
    ),
];

/// Returns readings of a body that rocks about all axes, mostly upright.
fn rocking() -> Vec<Reading> {
    let reading = |row: u32| {
        let t_s = f64::from(row) * 0.01;
        // Roll, pitch and yaw, and their derivatives.
        let angle = |amplitude: f64, rad_s: f64| {
            let (sin, cos) = (rad_s * t_s).sin_cos();
            (amplitude * sin, amplitude * rad_s * cos)
        };
        let [(roll, roll_rate), (pitch, pitch_rate), (yaw, yaw_rate)] =
            [angle(0.6, 1.3), angle(0.5, 1.7), angle(0.4, 0.9)];
        let [(sr, cr), (sp, cp), (sy, cy)] = [roll, pitch, yaw].map(f64::sin_cos);
        let rate =
            [roll_rate - yaw_rate * sp, pitch_rate * cr + yaw_rate * sr * cp, yaw_rate * cr * cp - pitch_rate * sr];
        let up = [-sp, sr * cp, cr * cp];
        let north = [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr];
        // A real sensor has noise on every axis.
        let noise = |axis: usize| 1e-3 * ([31.0, 37.0, 41.0][axis] * t_s).sin();
        let with_noise = |vector: [f64; 3]| std::array::from_fn(|axis| vector[axis] + noise(axis));
        Reading {
            t_ns: i64::from(row) * 10_000_000,
            rate_rad_s: with_noise(rate),
            force_m_s2: with_noise(scaled(up, 9.81)),
            field_ut: Some(with_noise(std::array::from_fn(|axis| 20.0 * north[axis] - 44.0 * up[axis]))),
            fix: None,
            reference: None,
        }
    };
    (0..9000).map(reading).collect()
}

/// Imports the readings as CSV with these options and returns the diagnoses.
fn diagnose_import(rows: &[Reading], units: Option<&str>, frame: Option<&str>) -> Vec<Diagnosis> {
    let mut text = String::from("t_s,gx,gy,gz,ax,ay,az,mx,my,mz\n");
    for Reading { t_ns, rate_rad_s, force_m_s2, field_ut, .. } in rows {
        let numbers = [*rate_rad_s, *force_m_s2, field_ut.unwrap_or([f64::NAN; 3])].concat();
        let numbers: Vec<_> = numbers.iter().map(f64::to_string).collect();
        writeln!(text, "{},{}", *t_ns as f64 * 1e-9, numbers.join(",")).unwrap();
    }
    let folder = tempfile::tempdir().unwrap();
    let (file, out) = (folder.path().join("in.csv"), folder.path().join("out_imu.csv"));
    fs::write(&file, text).unwrap();
    let mapping = Some(Mapping::parse::<&str>(&[], units, frame).unwrap());
    convert(&[file], &Options { mapping, ..Options::default() }, &out, &mut |_| {}).unwrap();
    diagnosed(&readings(&out), &Launch::default())
}

fn diagnosed(rows: &[Reading], launch: &Launch) -> Vec<Diagnosis> {
    diagnose_with(rows.iter().copied(), crate::common::rate_hz(rows), launch)
        .into_iter()
        .map(|(_, found)| found)
        .collect()
}

/// Returns the lines of a remedy that a user would paste.
fn lines(remedy: &str) -> impl Iterator<Item = &str> {
    let is_line = |part: &&str| part.starts_with("--") || part.starts_with("ingest.") && part.contains('=');
    remedy.split('`').skip(1).step_by(2).filter(is_line)
}

/// Returns the option or key of a line.
fn key(line: &str) -> &str {
    line.split([' ', '=']).next().unwrap_or_default()
}

fn is_cured(line: &str, issue: InputIssue, original: &[Reading], changed: &[Reading]) -> bool {
    let found = match line.split_once(' ') {
        Some(("--units", unit)) if OWN_UNITS.contains(&unit) => diagnose_import(original, Some(unit), None),
        Some(("--units", unit)) => diagnose_import(changed, Some(unit), None),
        Some(("--frame", frame)) => diagnose_import(changed, None, Some(frame)),
        _ => diagnosed(changed, &Launch::parse("launch.toml", line).unwrap()),
    };
    found.iter().all(|found| found.issue != issue)
}

#[test]
fn each_line_to_paste_removes_its_issue() {
    let original = rocking();
    let mut pasted = BTreeSet::new();
    let mut failures = Vec::new();
    for (name, change, issue, cause) in INPUT_ERRORS.into_iter().chain(MORE_ERRORS) {
        if WITHOUT_LINE.contains(&issue) {
            continue;
        }
        let changed: Vec<_> = original.iter().map(|reading| change(*reading)).collect();
        let found = diagnosed(&changed, &Launch::default());
        let Some(diagnosis) = found.iter().find(|found| found.issue == issue) else {
            failures.push(format!("{name}: {found:?}"));
            continue;
        };
        let of_cause = diagnosis.causes.iter().filter(|possible| possible.cause.contains(cause));
        let lines: Vec<_> = of_cause.flat_map(|possible| lines(&possible.remedy)).collect();
        let cured: Vec<_> = lines.iter().map(|line| is_cured(line, issue, &original, &changed)).collect();
        // If the cause is not known, one of the suggested causes must be right. The remedy for
        // left-handed axes depends on the mirrored axis and has no line.
        let is_right = if cause.is_empty() { cured.contains(&true) } else { !cured.contains(&false) };
        let has_lines = !lines.is_empty() || cause == "left-handed";
        if !is_right || !has_lines {
            failures.push(format!("{name}: {lines:?}: {cured:?}"));
        }
        pasted.extend(lines.iter().map(|line| key(line).to_owned()));
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    // With a higher limit, raw counts are accepted, and the next remedy is their scale.
    let counts: Vec<_> = original.iter().map(|r| Reading { force_m_s2: scaled(r.force_m_s2, 2048.0), ..*r }).collect();
    let found = diagnosed(&counts, &Launch::default());
    let limit = found.iter().flat_map(|found| &found.causes).flat_map(|cause| lines(&cause.remedy)).next().unwrap();
    let found = diagnosed(&counts, &Launch::parse("launch.toml", limit).unwrap());
    let scale = found.iter().flat_map(|found| &found.causes).flat_map(|cause| lines(&cause.remedy)).next().unwrap();
    let both = Launch::parse("launch.toml", &format!("{limit}\n{scale}")).unwrap();
    assert_eq!(diagnosed(&counts, &both), [], "{limit} {scale}");
    pasted.extend([limit, scale].map(|line| key(line).to_owned()));
    // Every line in the source file must be pasted above, so a new line needs a new error.
    let source = include_str!("../../src/diagnosis.rs");
    for line in
        source.split('`').filter(|part| part.starts_with("--") || part.starts_with("ingest.") && part.contains('='))
    {
        let key = key(line);
        let (start, end) =
            key.split_once('{').map_or((key, ""), |(start, rest)| (start, rest.rsplit('}').next().unwrap_or("")));
        let is_pasted = pasted.iter().any(|pasted| pasted.starts_with(start) && pasted.ends_with(end));
        assert!(is_pasted || NOT_PASTED.contains(&key), "{key} is not pasted: {pasted:?}");
    }
}
