//! Writes rows and fixes and reads them back; checks the permissions of the files.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::{fs, os::unix::fs::PermissionsExt, path::Path};

use proptest::prelude::*;
use recording::{
    Layout, Reader, RecordingError, Reference, Row, Writer,
    gnss::{self, Fix, FixReader},
};

const ROW: Row =
    Row { t_ns: 0, rate_rad_s: [0.0; 3], force_m_s2: [0.0, 0.0, 9.80665], field_ut: None, reference: None };
const END_NS: i64 = 9_000_000_000_000_000_000;

fn write(path: &Path, layout: Layout, rows: &[Row]) {
    let mut writer = Writer::create(path, layout).unwrap();
    rows.iter().for_each(|row| writer.write(row).unwrap());
    writer.finish().unwrap();
}

fn read(path: &Path) -> Vec<Row> {
    Reader::open(path).unwrap().map(Result::unwrap).collect()
}

/// Returns the bit patterns of all numbers, with the same pattern for every NaN.
fn bits(row: &Row) -> (i64, Vec<u64>, Option<bool>) {
    let parts = row.rate_rad_s.iter().chain(&row.force_m_s2).chain(row.field_ut.iter().flatten());
    let parts = parts.chain(row.reference.iter().flat_map(|reference| &reference.quaternion));
    let bits = parts.map(|part| if part.is_nan() { f64::NAN.to_bits() } else { part.to_bits() });
    (row.t_ns, bits.collect(), row.reference.map(|reference| reference.scored))
}

fn vector() -> impl Strategy<Value = [f64; 3]> {
    proptest::array::uniform3(prop_oneof![any::<f64>(), -20.0..20.0, any::<f32>().prop_map(f64::from)])
}

fn row() -> impl Strategy<Value = Row> {
    let number = vector().prop_map(|parts| parts.map(|part| if part.is_nan() { f64::NEG_INFINITY } else { part }));
    let unit = proptest::array::uniform4(-1.0..1.0f64).prop_filter_map("too short to normalise", |parts| {
        let length = parts.iter().map(|part| part * part).sum::<f64>().sqrt();
        (length > 0.01).then(|| parts.map(|part| part / length))
    });
    let reference = (unit, any::<bool>()).prop_map(|(quaternion, scored)| Reference { quaternion, scored });
    let time = prop_oneof![(1 - END_NS)..END_NS, 0..1_000_000_000_000i64];
    (time, vector(), vector(), proptest::option::of(number), proptest::option::of(reference)).prop_map(
        |(t_ns, rate_rad_s, force_m_s2, field_ut, reference)| Row { t_ns, rate_rad_s, force_m_s2, field_ut, reference },
    )
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn written_rows_are_read_back_bit_exact(rows in prop::collection::vec(row(), 1..20), gzip: bool) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(if gzip { "a_imu.csv.gz" } else { "a_imu.csv" });
        write(&path, Layout { field: true, reference: true }, &rows);
        prop_assert_eq!(fs::read(&path).unwrap().starts_with(b"\x1f\x8b"), gzip);
        let read: Vec<_> = read(&path).iter().map(bits).collect();
        prop_assert_eq!(read, rows.iter().map(bits).collect::<Vec<_>>());
    }
}

#[test]
fn writer_writes_only_columns_of_layout() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.csv");
    for (field, reference, header) in [
        (false, false, "t_s,gx,gy,gz,ax,ay,az"),
        (true, false, "t_s,gx,gy,gz,ax,ay,az,mx,my,mz"),
        (false, true, "t_s,gx,gy,gz,ax,ay,az,qw,qx,qy,qz,mov"),
    ] {
        write(&path, Layout { field, reference }, &[ROW]);
        assert_eq!(fs::read_to_string(&path).unwrap().lines().next(), Some(header));
        assert_eq!(read(&path), [ROW]);
    }
}

#[test]
fn unrepresentable_row_is_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.csv");
    for (row, expected) in [
        (Row { field_ut: Some([1.0; 3]), ..ROW }, "found a magnetic field, expected none: the layout has no columns"),
        (
            Row { t_ns: END_NS, ..ROW },
            "found the time 9000000000000000000 ns, expected a finite time in seconds within ±9e9",
        ),
    ] {
        let mut writer = Writer::create(&path, Layout::default()).unwrap();
        let error = writer.write(&row).unwrap_err().to_string();
        assert!(error.starts_with(&format!("writing {}: row 1: {expected}", path.display())), "{error}");
    }
}

#[test]
fn file_is_private_and_replaced_atomically() {
    let folder = tempfile::tempdir().unwrap();
    let [path, foreign] = ["a.csv", "others"].map(|name| folder.path().join(name));
    fs::write(&foreign, "unchanged").unwrap();
    for link in [path.clone(), folder.path().join("a.csv.new")] {
        std::os::unix::fs::symlink(&foreign, link).unwrap();
    }
    let mut writer = Writer::create(&path, Layout::default()).unwrap();
    writer.write(&ROW).unwrap();
    drop(writer);
    assert!(fs::symlink_metadata(&path).unwrap().is_symlink(), "an unfinished writer leaves the target unchanged");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2, "an unfinished writer removes its temporary file");
    write(&path, Layout::default(), &[ROW]);
    let metadata = fs::symlink_metadata(&path).unwrap();
    assert!(metadata.is_file() && metadata.permissions().mode() & 0o7777 == 0o600, "{metadata:?}");
    assert_eq!(fs::read_to_string(&foreign).unwrap(), "unchanged");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2, "a finished writer leaves no temporary file");
    let error = Writer::create(folder.path(), Layout::default()).err().unwrap();
    assert!(matches!(error, RecordingError::Write { .. }), "{error}");
}

#[test]
fn written_fixes_are_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("a_imu.csv.gz");
    let path = gnss::path_for(&recording).unwrap();
    assert_eq!((path.file_name().unwrap(), gnss::path_for(Path::new("a.csv"))), ("a_gnss.csv".as_ref(), None));
    let fix = |t_ns, velocity_m_s, [latitude_deg, longitude_deg, altitude_m]: [Option<f64>; 3]| Fix {
        t_ns,
        velocity_m_s,
        latitude_deg,
        longitude_deg,
        altitude_m,
    };
    let fixes = [
        fix(1, [0.1, -2.0, 1e-7], [Some(-37.812_345_6), Some(145.0), None]),
        fix(2_500_000_000, [f64::INFINITY, 0.0, 3.0], [None, None, Some(-3.5)]),
    ];
    let mut writer = gnss::Writer::create(&path).unwrap();
    fixes.iter().for_each(|fix| writer.write(fix).unwrap());
    writer.finish().unwrap();
    assert_eq!(gnss::find_for(&recording), Some(path.clone()));
    let mut read = FixReader::open(&path).unwrap();
    assert_eq!(fixes.map(|fix| read.latest_until(fix.t_ns).unwrap()), fixes.map(Some));
}
