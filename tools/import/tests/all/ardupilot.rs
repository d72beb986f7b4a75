//! ArduPilot logs, compared with pymavlink.

use std::collections::BTreeMap;

use import::{Format, Note};

use crate::{
    common::{Bytes, Folder, log},
    python::python,
    scripts::run_script,
};

/// Writer of a DataFlash log.
#[derive(Clone, Default)]
pub(crate) struct DataFlashLog(pub(crate) Vec<u8>);

impl DataFlashLog {
    pub(crate) fn message(&mut self, kind: u8, fields: &[&dyn Bytes]) {
        self.0.extend([0xa3, 0x95, kind]);
        fields.iter().for_each(|field| self.0.extend(field.bytes()));
    }

    pub(crate) fn add_format(&mut self, kind: u8, name: &str, letters: &str, labels: &str) {
        let size = |letter| match letter {
            b'b' | b'B' => 1,
            b'c' | b'C' | b'H' => 2,
            b'f' | b'e' | b'L' | b'I' => 4,
            b'Q' => 8,
            b'Z' => 64,
            b'N' => 16,
            b'n' => 4,
            _ => panic!("{letter}"),
        };
        let length: u8 = 3 + letters.bytes().map(size).sum::<u8>();
        let padded = |text: &str, length: usize| {
            let mut bytes = text.as_bytes().to_vec();
            bytes.resize(length, 0);
            bytes
        };
        self.0.extend([0xa3, 0x95, 0x80, kind, length]);
        self.0.extend([padded(name, 4), padded(letters, 16), padded(labels, 64)].concat());
    }
}

const IMU: u8 = 1;
const MAG: u8 = 2;
const GPS: u8 = 3;
const XKQ: u8 = 4;
const ATT: u8 = 5;
const MSG: u8 = 6;

/// Returns a log with `rows` samples at 400 Hz.
pub(crate) fn dataflash_log(rows: u32) -> DataFlashLog {
    let mut log = DataFlashLog::default();
    log.add_format(0x80, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns");
    log.add_format(IMU, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ");
    log.add_format(MAG, "MAG", "QBffff", "TimeUS,I,MagX,MagY,MagZ,Oth");
    log.add_format(GPS, "GPS", "QBBIHLLefff", "TimeUS,I,Status,GMS,GWk,Lat,Lng,Alt,Spd,GCrs,VZ");
    log.add_format(XKQ, "XKQ", "QBffff", "TimeUS,C,Q1,Q2,Q3,Q4");
    log.add_format(ATT, "ATT", "QccC", "TimeUS,Roll,Pitch,Yaw");
    log.add_format(MSG, "MSG", "QZ", "TimeUS,Message");
    for row in 0..rows {
        let t_us = 60_000_000 + 2500 * u64::from(row);
        let angle = row as f32 / 1000.0;
        for instance in [1u8, 0] {
            log.message(IMU, &[&t_us, &instance, &[0.1 + angle, -angle, f32::from(instance)], &[angle, 0.2f32, -9.8]]);
        }
        if row % 20 == 7 {
            log.message(MAG, &[&(t_us + 100), &0u8, &[200.0 + angle, -50.5, 433.3], &0f32]);
        }
        if row % 4 == 1 {
            let (sin, cos) = (angle / 2.0).sin_cos();
            log.message(XKQ, &[&t_us, &0u8, &[cos, 0.6 * sin, 0.0, 0.8 * sin]]);
            log.message(XKQ, &[&t_us, &1u8, &[1f32, 0.0, 0.0, 0.0]]);
            log.message(ATT, &[&t_us, &1000i16.to_le_bytes(), &500i16.to_le_bytes(), &9000u16.to_le_bytes()]);
        }
        if row % 80 == 5 {
            let status = if row < 400 { 1u8 } else { 4 };
            let position = [480_000_001i32, 110_000_002, 51_234];
            let (ms, week) = ((row * 5 / 2).to_le_bytes(), 2300u16.to_le_bytes());
            log.message(GPS, &[&t_us, &0u8, &status, &ms, &week, &position, &[12.5f32, 90.0 + angle, -1.5]]);
        }
        if row % 500 == 3 {
            let mut text = b"\xa3\x95\x01 looks like another".to_vec();
            text.resize(64, 0);
            log.message(MSG, &[&t_us, &<[u8; 64]>::try_from(text).unwrap()]);
        }
    }
    log
}

#[test]
fn ardupilot_log_matches_pymavlink() {
    if python().is_none() {
        return;
    }
    let folder = Folder::new();
    let path = folder.file("log.bin", dataflash_log(4000).0);
    let imported = folder.import(std::slice::from_ref(&path), None).unwrap();
    assert_eq!((imported.summary.format, imported.rows.len()), (Format::ArduPilot, 4000));
    let notes: Vec<_> = imported.summary.notes.iter().map(ToString::to_string).collect();
    assert_eq!(
        notes,
        [
            "read instance 0 of IMU; skipped 4000 samples of other instances",
            "skipped 5 fixes: no 3D fix, or not a number",
            "read instance 0 of XKQ; skipped 1000 samples of other instances",
        ]
    );

    let mut messages: BTreeMap<String, Vec<(i64, Vec<f64>)>> = BTreeMap::new();
    for words in run_script("ardupilot.py", &[path.as_os_str()]) {
        let numbers: Vec<f64> = words[2..].iter().map(|word| word.parse().unwrap()).collect();
        let t_ns = words[1].parse::<i64>().unwrap() * 1000;
        // Only messages of the first sensor or estimator are compared.
        if words[0] == "ATT" || numbers[0] == 0.0 {
            messages.entry(words[0].clone()).or_default().push((t_ns, numbers));
        }
    }
    let rows = imported.rows.iter().map(|row| (row.t_ns, row.rate_rad_s, row.force_m_s2));
    let expected = messages["IMU"].iter().map(|(t_ns, n)| (*t_ns, [n[2], n[1], -n[3]], [n[5], n[4], -n[6]]));
    assert!(rows.eq(expected));
    let fields = imported.rows.iter().filter_map(|row| row.field_ut);
    let expected = messages["MAG"].iter().map(|(_, n)| [n[2] * 0.1, n[1] * 0.1, -n[3] * 0.1]);
    assert!(fields.eq(expected));
    let attitudes: BTreeMap<_, _> = messages["XKQ"].iter().map(|(t_ns, n)| (*t_ns, n)).collect();
    let mut compared = 0;
    for row in &imported.rows {
        if let Some(n) = attitudes.get(&row.t_ns) {
            let found = row.reference.unwrap().quaternion;
            assert!(found.iter().zip([n[1], n[3], n[2], -n[4]]).all(|(a, b)| (a - b).abs() < 1e-6));
            compared += 1;
        }
    }
    assert_eq!(compared, 1000);
    let fixes = messages["GPS"].iter().filter(|(_, n)| n[1] >= 3.0);
    assert_eq!(imported.fixes.len(), 45);
    for (fix, (t_ns, n)) in imported.fixes.iter().zip(fixes) {
        let (east, north) = n[3].to_radians().sin_cos();
        assert_eq!((fix.t_ns, fix.velocity_m_s), (*t_ns, [n[2] * east, n[2] * north, -n[4]]));
        assert_eq!(fix.latitude_deg, Some(n[5]));
    }
}

#[recorded::test]
fn logs_of_reports_match_pymavlink() {
    for name in ["old_gps_clock.bin", "slow_attitude.bin"] {
        let (Some(logs), Some(_)) = (log(""), python()) else { return };
        let path = logs.join("../reports").join(name);
        let imported = Folder::new().import(std::slice::from_ref(&path), None).unwrap();
        let words = run_script("ardupilot.py", &[path.as_os_str()]);
        let messages = |kind: &str| {
            let of_kind = words.iter().filter(move |words| words[0] == kind);
            let numbers = of_kind.map(|words| words[1..].iter().map(|word| word.parse().unwrap()).collect());
            numbers.collect::<Vec<Vec<f64>>>()
        };
        let rows = imported.rows.iter().map(|row| (row.t_ns as f64, row.rate_rad_s, row.force_m_s2));
        let expected = messages("IMU");
        let expected = expected.iter().map(|n| (n[0] * 1000.0, [n[3], n[2], -n[4]], [n[6], n[5], -n[7]]));
        assert!(rows.len() == 700 && rows.eq(expected), "{name}");
        let fields = imported.rows.iter().filter_map(|row| row.field_ut);
        let expected = messages("MAG");
        assert!(expected.len() == 140 && fields.eq(expected.iter().map(|n| [n[3] * 0.1, n[2] * 0.1, -n[4] * 0.1])));
        let fixes = imported.fixes.iter().map(|fix| (fix.velocity_m_s, fix.latitude_deg));
        let expected = messages("GPS");
        assert_eq!(fixes.len(), 70);
        assert!(fixes.eq(expected.iter().map(|n| {
            let (east, north) = n[4].to_radians().sin_cos();
            ([n[3] * east, n[3] * north, -n[5]], Some(n[6]))
        })));
    }
}

/// The attitude is roll 10°, pitch 5°, heading east.
#[test]
fn reference_from_angles_without_quaternion() {
    let folder = Folder::new();
    let mut log = DataFlashLog::default();
    log.add_format(IMU, "IMU", "Iffffff", "TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ");
    log.add_format(ATT, "ATT", "IccC", "TimeMS,Roll,Pitch,Yaw");
    log.message(IMU, &[&1000u32.to_le_bytes(), &[0f32; 3], &[0f32, 0.0, -9.8]]);
    log.message(ATT, &[&1000u32.to_le_bytes(), &1000i16.to_le_bytes(), &500i16.to_le_bytes(), &9000u16.to_le_bytes()]);
    let imported = folder.import(&[folder.file("log.bin", log.0)], None).unwrap();
    let row = imported.rows[0];
    assert_eq!(row.t_ns, 1_000_000_000);
    let [w, x, y, z] = row.reference.unwrap().quaternion;
    let forward = [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)];
    let right = [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)];
    let (pitch, roll) = (5f64.to_radians(), 10f64.to_radians());
    for (found, expected) in [(forward[0], pitch.cos()), (forward[1], 0.0), (forward[2], pitch.sin())]
        .into_iter()
        .chain([(right[2], -roll.sin() * pitch.cos())])
    {
        assert!((found - expected).abs() < 1e-9, "{forward:?} {right:?}");
    }
}

#[test]
fn damaged_bytes_skipped_and_reported() {
    let folder = Folder::new();
    let whole = dataflash_log(400);
    let mut damaged = whole.clone();
    let middle = damaged.0.len() / 2;
    damaged.0[middle..middle + 300].fill(0xa3);
    damaged.0.extend([0u8; 100]);
    let imported = folder.import(&[folder.file("log.bin", &damaged.0)], None).unwrap();
    let missing = 400 - imported.rows.len();
    assert!((3..12).contains(&missing), "{missing}");
    let skipped = imported.summary.notes.iter().find_map(|note| match note {
        Note::Skipped { what: "bytes", count, .. } => Some(*count),
        _ => None,
    });
    assert!((400..600).contains(&skipped.unwrap()), "{skipped:?}");
    let read: Vec<_> = folder.import(&[folder.file("whole.bin", &whole.0)], None).unwrap().rows;
    let same = imported
        .rows
        .iter()
        .filter(|row| read.iter().any(|other| (other.rate_rad_s, other.force_m_s2) == (row.rate_rad_s, row.force_m_s2)))
        .count();
    assert_eq!(same, imported.rows.len(), "every row is in the undamaged log");
}
