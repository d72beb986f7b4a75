//! Readings of recordings, their diagnoses, and artificial input errors.

use std::path::{Path, PathBuf};

use judge::{Diagnosis, InputCheck, InputIssue};
use launch::{GyroSamples, Launch};
use readings::{conditioner::Conditioner, source::Reading};
use recording::Reader;

pub(crate) fn data() -> PathBuf {
    std::env::var_os("PLUMBLINE_DATA")
        .map_or_else(|| concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data").into(), PathBuf::from)
}

/// Returns the available recordings. Prints a note if the list is empty.
pub(crate) fn recordings() -> Vec<PathBuf> {
    let mut all: Vec<_> = ["broad", "flights"]
        .iter()
        .filter_map(|folder| std::fs::read_dir(data().join(folder)).ok())
        .flatten()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|ending| ending == "gz"))
        .collect();
    all.sort();
    if all.is_empty() {
        eprintln!("skipped: no recordings; set PLUMBLINE_DATA");
    }
    all
}

pub(crate) fn readings(path: &Path) -> Vec<Reading> {
    let rows = Reader::open(path).unwrap().map(Result::unwrap);
    rows.map(|row| Reading {
        t_ns: row.t_ns,
        rate_rad_s: row.rate_rad_s,
        force_m_s2: row.force_m_s2,
        field_ut: row.field_ut,
        fix: None,
        reference: row.reference,
    })
    .collect()
}

pub(crate) fn rate_hz(readings: &[Reading]) -> f64 {
    let span_ns = readings[readings.len() - 1].t_ns - readings[0].t_ns;
    (readings.len() - 1) as f64 * 1e9 / span_ns as f64
}

/// Returns the diagnoses, each with the sample time in seconds at which it was made.
pub(crate) fn diagnose(readings: impl IntoIterator<Item = Reading>, rate_hz: f64) -> Vec<(f64, Diagnosis)> {
    diagnose_with(readings, rate_hz, &Launch::default())
}

/// Returns the diagnoses of [`diagnose`] with the settings of a launch file.
pub(crate) fn diagnose_with(
    readings: impl IntoIterator<Item = Reading>,
    rate_hz: f64,
    launch: &Launch,
) -> Vec<(f64, Diagnosis)> {
    let mut conditioner = Conditioner::new(&launch.ingest, rate_hz, GyroSamples::Means).unwrap();
    let mut check = InputCheck::default();
    let (mut found, mut first_ns, mut now_s) = (Vec::new(), None, 0.0);
    for reading in readings {
        let Some(sample) = conditioner.condition(&reading) else { continue };
        let t_ns = sample.imu.header.t_end_ns;
        now_s = (t_ns - *first_ns.get_or_insert(t_ns)) as f64 * 1e-9;
        found.extend(check.update(&sample.imu, sample.mag.as_ref()).into_iter().map(|diagnosis| (now_s, diagnosis)));
    }
    found.extend(check.finish().into_iter().map(|diagnosis| (now_s, diagnosis)));
    found
}

/// Input error applied to each reading.
pub(crate) type Change = fn(Reading) -> Reading;

/// Input errors. Each entry contains the name of the error, its effect on a reading, the expected
/// issue, and a part of the text of an expected cause.
pub(crate) const INPUT_ERRORS: [(&str, Change, InputIssue, &str); 19] = [
    (
        "rates in °/s",
        |r| Reading { rate_rad_s: r.rate_rad_s.map(f64::to_degrees), ..r },
        InputIssue::RateUnit,
        "rates in °/s",
    ),
    (
        "rates converted twice",
        |r| Reading { rate_rad_s: r.rate_rad_s.map(f64::to_radians), ..r },
        InputIssue::RateUnit,
        "read as °/s",
    ),
    (
        "forces in g",
        |r| Reading { force_m_s2: scaled(r.force_m_s2, 1.0 / 9.80665), ..r },
        InputIssue::ForceUnit,
        "forces in g",
    ),
    ("times in ms", |r| Reading { t_ns: r.t_ns * 1000, ..r }, InputIssue::TimeUnit, "times in ms"),
    ("times in µs", |r| Reading { t_ns: r.t_ns * 1_000_000, ..r }, InputIssue::TimeUnit, "times in µs"),
    (
        "fields in gauss",
        |r| Reading { field_ut: r.field_ut.map(|m| scaled(m, 0.01)), ..r },
        InputIssue::FieldUnit,
        "gauss",
    ),
    ("fields in nT", |r| Reading { field_ut: r.field_ut.map(|m| scaled(m, 1000.0)), ..r }, InputIssue::FieldUnit, "nT"),
    ("fields in mT", |r| Reading { field_ut: r.field_ut.map(|m| scaled(m, 0.001)), ..r }, InputIssue::FieldUnit, "mT"),
    (
        "a negated accelerometer",
        |r| Reading { force_m_s2: scaled(r.force_m_s2, -1.0), ..r },
        InputIssue::UpsideDown,
        "",
    ),
    (
        "axes forward, right, down",
        |r| Reading {
            rate_rad_s: frd(r.rate_rad_s),
            force_m_s2: frd(r.force_m_s2),
            field_ut: r.field_ut.map(frd),
            ..r
        },
        InputIssue::UpsideDown,
        "",
    ),
    (
        "a sensor mounted upside down",
        |r| Reading {
            rate_rad_s: rolled(r.rate_rad_s),
            force_m_s2: rolled(r.force_m_s2),
            field_ut: r.field_ut.map(rolled),
            ..r
        },
        InputIssue::UpsideDown,
        "mounted upside down",
    ),
    (
        "left-handed axes",
        |r| Reading {
            rate_rad_s: mirrored(r.rate_rad_s),
            force_m_s2: mirrored(r.force_m_s2),
            field_ut: r.field_ut.map(mirrored),
            ..r
        },
        InputIssue::AxesMismatch,
        "left-handed",
    ),
    ("a negated gyro", |r| Reading { rate_rad_s: scaled(r.rate_rad_s, -1.0), ..r }, InputIssue::AxesMismatch, ""),
    (
        "an axis of the gyro negated",
        |r| Reading { rate_rad_s: mirrored(r.rate_rad_s), ..r },
        InputIssue::AxesMismatch,
        "the gyro's x, −y, z",
    ),
    (
        "axes of the gyro exchanged",
        |r| Reading { rate_rad_s: [r.rate_rad_s[1], r.rate_rad_s[0], r.rate_rad_s[2]], ..r },
        InputIssue::AxesMismatch,
        "the gyro's y, x, z",
    ),
    (
        "an axis stuck",
        |r| Reading { rate_rad_s: [r.rate_rad_s[0], 0.01, r.rate_rad_s[2]], ..r },
        InputIssue::RateStuck,
        "",
    ),
    (
        "an axis of the force stuck",
        |r| Reading { force_m_s2: [r.force_m_s2[0], r.force_m_s2[1], 9.8], ..r },
        InputIssue::ForceStuck,
        "",
    ),
    (
        "an axis of the field stuck",
        |r| Reading { field_ut: r.field_ut.map(|[x, y, _]| [x, y, -44.0]), ..r },
        InputIssue::FieldStuck,
        "",
    ),
    (
        "a dead magnetometer",
        |r| Reading { field_ut: r.field_ut.map(|_| [10.0, 20.0, -44.0]), ..r },
        InputIssue::FieldStuck,
        "",
    ),
];

pub(crate) fn scaled(vector: [f64; 3], factor: f64) -> [f64; 3] {
    vector.map(|x| x * factor)
}

fn frd([x, y, z]: [f64; 3]) -> [f64; 3] {
    [y, x, -z]
}

fn mirrored([x, y, z]: [f64; 3]) -> [f64; 3] {
    [x, -y, z]
}

fn rolled([x, y, z]: [f64; 3]) -> [f64; 3] {
    [x, -y, -z]
}
