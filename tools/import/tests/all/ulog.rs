//! Generated ULog files with known values.

use import::Note;

use crate::common::{
    ATTITUDE, COMBINED, Folder, Imported, Log, MAGNETOMETER, OLD_COMBINED, RECEIVER, RECEIVER_DEGREES,
};

const GYRO: [f32; 3] = [0.5, 0.25, -2.0];
const ACCEL: [f32; 3] = [1.0, 2.0, -9.75];
const MS: i64 = 1_000_000;

fn imported(log: &Log) -> Imported {
    let folder = Folder::new();
    folder.import(&[folder.file("a.ulg", &log.0)], None).unwrap()
}

/// Writes `count` samples at intervals of 1 ms, starting at 1 s.
fn combined(log: &mut Log, count: u64) {
    (0..count).for_each(|i| log.combined(1_000_000 + 1000 * i, GYRO, 0, ACCEL));
}

fn field_rows(imported: &Imported) -> Vec<(i64, [f64; 3])> {
    imported.rows.iter().filter_map(|row| Some((row.t_ns / MS, row.field_ut?))).collect()
}

fn skipped(imported: &Imported) -> Vec<(&str, u64)> {
    let notes = imported.summary.notes.iter();
    notes
        .filter_map(|note| if let Note::Skipped { what, count, .. } = note { Some((*what, *count)) } else { None })
        .collect()
}

#[test]
fn frd_ned_converted_to_rfu_enu() {
    let mut log = Log::new(&[COMBINED, MAGNETOMETER, ATTITUDE, RECEIVER]);
    combined(&mut log, 2);
    log.sample(1, 1_000_300, &[&1_000_000u64, &[0.25f32, 0.125, 0.5]]);
    let half = 0.5f32.sqrt();
    // Examples from docs/reference/conventions.md: facing east; facing north with the nose 30
    // degrees up; facing north with the right side 30 degrees down.
    log.sample(2, 1_000_000, &[&[half, 0.0, 0.0, half], &0u8]);
    let (c, s) = (15f32.to_radians().cos(), 15f32.to_radians().sin());
    log.sample(2, 1_001_000, &[&[c, 0.0, s, 0.0], &0u8]);
    log.sample(3, 1_000_500, &[&[-378_123_456i32, 1_450_000_001, 81_250], &[1.5f32, 2.5, -0.5], &3u8, &1u8]);
    log.combined(1_002_000, GYRO, 0, ACCEL);
    log.sample(2, 1_002_000, &[&[c, s, 0.0, 0.0], &0u8]);

    let imported = imported(&log);
    let row = imported.rows[0];
    assert_eq!((row.t_ns, row.rate_rad_s, row.force_m_s2), (1_000_000_000, [0.25, 0.5, 2.0], [2.0, 1.0, 9.75]));
    assert_eq!(row.field_ut, Some([12.5, 25.0, -50.0]), "converted from gauss");
    let references = imported.rows.iter().map(|row| row.reference.unwrap().quaternion);
    let [half, c, s] = [half, c, s].map(f64::from);
    for (found, expected) in references.zip([[half, 0.0, 0.0, -half], [c, s, 0.0, 0.0], [c, 0.0, s, 0.0]]) {
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-7), "{found:?} {expected:?}");
    }
    let fix = imported.fixes[0];
    assert_eq!((fix.t_ns, fix.velocity_m_s), (1_000_500_000, [2.5, 1.5, 0.5]));
    assert_eq!(fix.latitude_deg, Some(-37.812_345_6));
    let summary = imported.summary;
    assert_eq!((summary.rows, summary.field_rows, summary.reference_rows, summary.fixes), (3, 1, 3, 1));
    assert!((summary.rate_hz - 1000.0).abs() < 1e-9 && (summary.duration_s - 0.002).abs() < 1e-12);
    assert_eq!(summary.notes, []);
}

#[test]
fn fixes_of_old_and_new_logs_read_unless_invalid() {
    let folder = Folder::new();
    for (format, position) in [
        (RECEIVER, &[123_456_789i32, -20_000_000, 81_250] as &dyn crate::common::Bytes),
        (RECEIVER_DEGREES, &[12.3456789f64, -2.0, 81.25]),
    ] {
        let mut log = Log::new(&[COMBINED, format]);
        combined(&mut log, 2);
        for (i, kind, valid) in [(0u64, 3u8, 1u8), (1, 2, 1), (2, 3, 0), (3, 4, 1)] {
            log.sample(1, 1_000_000 + 1000 * i, &[position, &[1.0f32, 2.0, 3.0], &kind, &valid]);
        }
        let imported = folder.import(&[folder.file("a.ulg", &log.0)], None).unwrap();
        assert_eq!(imported.fixes.iter().map(|fix| fix.t_ns / MS).collect::<Vec<_>>(), [1000, 1003], "{format}");
        assert_eq!(imported.fixes[0].latitude_deg, Some(12.3456789));
        let text = std::fs::read_to_string(folder.path("out_gnss.csv")).unwrap();
        assert_eq!(text.lines().nth(1), Some("1,2,1,-3,12.3456789,-2,81.25"));
        assert_eq!(skipped(&imported), [("fixes", 2)]);
    }
}

#[test]
fn field_sample_written_to_nearest_row_only() {
    let mut log = Log::new(&[COMBINED, MAGNETOMETER]);
    combined(&mut log, 10);
    // The first sample is nearest to row 2. The second sample is nearest to row 4, although it was
    // published at the time of row 6. The third sample is far after the last row.
    for (sampled_us, published_us) in [(1_001_400u64, 1_001_400), (1_002_600, 1_005_000), (1_200_000, 1_200_000)] {
        log.sample(1, published_us, &[&sampled_us, &[1.0f32, 0.0, 0.0]]);
    }
    let imported = imported(&log);
    assert_eq!(field_rows(&imported), [(1001, [0.0, 100.0, 0.0]), (1003, [0.0, 100.0, 0.0])]);
    assert_eq!(skipped(&imported), [("field samples", 1)]);
}

#[test]
fn old_log_field_in_sensor_combined_not_repeated() {
    let mut log = Log::new(&[OLD_COMBINED]);
    for (i, relative_us, field_ga) in
        [(0u64, i32::MAX, 9.0f32), (1, -400, 1.0), (2, -1400, 1.0), (3, -2400, 1.0), (4, -300, 2.0)]
    {
        log.sample(0, 1_000_000 + 1000 * i, &[&GYRO, &0i32, &ACCEL, &relative_us, &[field_ga, 0.0, 0.0]]);
    }
    let imported = imported(&log);
    assert_eq!(field_rows(&imported), [(1001, [0.0, 100.0, 0.0]), (1004, [0.0, 200.0, 0.0])]);
    assert_eq!(skipped(&imported), [], "a repeated sample is not counted as skipped");
}

#[test]
fn force_interpolated_at_time_of_rate() {
    let mut log = Log::new(&[COMBINED]);
    // The accelerometer lags by 1 ms and has half the sampling rate of the gyro. The force grows by
    // 1 m/s² per ms.
    for (i, relative_us) in [(0u64, -1000), (2, -3000), (4, -1000), (6, -3000), (8, -1000), (10, i32::MAX)] {
        let t_ms = i as f64 + f64::from(relative_us) / 1000.0;
        log.combined(1_000_000 + 1000 * i, GYRO, relative_us, [t_ms as f32, 0.0, 0.0]);
    }
    let imported = imported(&log);
    let force: Vec<_> = imported.rows.iter().map(|row| (row.t_ns / MS - 1000, row.force_m_s2[1])).collect();
    assert_eq!(force, [(0, 0.0), (2, 2.0), (4, 4.0), (6, 6.0), (8, 7.0), (10, 7.0)], "the last force is held");
}

#[test]
fn reference_interpolated_only_between_close_samples() {
    let mut log = Log::new(&[COMBINED, ATTITUDE]);
    combined(&mut log, 200);
    let facing = |deg: f32| [(deg / 2.0).to_radians().cos(), 0.0, 0.0, (deg / 2.0).to_radians().sin()];
    for (t_ms, deg, resets, sign) in
        [(10u64, 0.0f32, 0u8, 1.0f32), (20, 10.0, 0, -1.0), (30, 90.0, 1, 1.0), (110, 90.0, 1, 1.0)]
    {
        log.sample(1, 1_000_000 + 1000 * t_ms, &[&facing(deg).map(|part| sign * part), &resets]);
    }
    let imported = imported(&log);
    let references: Vec<_> = imported
        .rows
        .iter()
        .filter_map(|row| {
            let [w, _, _, z] = row.reference?.quaternion;
            Some((row.t_ns / MS - 1000, (2.0 * (-z / w).atan().to_degrees() * 1e3).round() / 1e3))
        })
        .collect();
    let even = (0..=10).map(|i| (10 + i, i as f64));
    assert_eq!(
        references,
        even.chain((30..=110).map(|i| (i, 90.0))).collect::<Vec<_>>(),
        "no reference across a reset; across a gap only without a rotation"
    );
    assert_eq!(imported.summary.reference_rows, 92);
}

#[test]
fn first_instance_read_and_others_reported() {
    let mut log = Log::new(&[COMBINED, MAGNETOMETER]);
    log.subscribe(2, 1, "vehicle_magnetometer");
    log.sample(2, 1_000_000, &[&0u64, &[9.0f32, 0.0, 0.0]]);
    combined(&mut log, 5);
    log.sample(1, 1_000_000, &[&0u64, &[1.0f32, 0.0, 0.0]]);
    log.sample(2, 1_002_000, &[&0u64, &[9.0f32, 0.0, 0.0]]);
    let imported = imported(&log);
    assert_eq!(field_rows(&imported), [(1000, [0.0, 100.0, 0.0])]);
    let others = Note::OtherInstances { topic: "vehicle_magnetometer", read: 0, others: 2 };
    assert!(imported.summary.notes.contains(&others), "{:?}", imported.summary.notes);
}

#[test]
fn non_increasing_times_skipped() {
    let mut log = Log::new(&[COMBINED]);
    for t_us in [1_000_000u64, 1_001_000, 1_001_000, 1_000_500, 1_002_000, u64::MAX] {
        log.combined(t_us, GYRO, 0, ACCEL);
    }
    let imported = imported(&log);
    assert_eq!(imported.rows.iter().map(|row| row.t_ns / MS).collect::<Vec<_>>(), [1000, 1001, 1002]);
    assert_eq!(skipped(&imported), [("sensor_combined samples", 1), ("rate samples", 2), ("force samples", 1)]);
}

#[test]
fn missing_and_implausible_data_reported() {
    let mut log = Log::new(&[COMBINED]);
    (0..3).for_each(|i| log.combined(1000 * i, GYRO, 0, [0.0, 0.0, -1.0]));
    log.message(b'O', &25u16.to_le_bytes());
    let notes: Vec<_> = imported(&log).summary.notes.iter().map(ToString::to_string).collect();
    assert_eq!(
        notes,
        [
            "mean force 1.00 m/s², expected about 9.8; check its unit and that it includes gravity",
            "no reference attitude (vehicle_attitude)",
            "no receiver velocity (vehicle_gps_position, sensor_gps)",
            "log dropouts: 1, 25 ms in total; samples in them are missing",
            "no magnetic field: the course is not relative to north",
        ]
    );
}

#[test]
fn data_appended_after_crash_read() {
    let mut whole = Log::new(&[COMBINED]);
    combined(&mut whole, 4);
    let mut log = whole.clone();
    log.0.truncate(whole.0.len() - 7);
    let offset = log.0.len() as u64;
    // The offsets of appended sections are the last three numbers of the first message.
    log.0[16 + 3 + 16..][..8].copy_from_slice(&offset.to_le_bytes());
    log.0[16 + 3 + 8] = 1;
    log.combined(1_010_000, GYRO, 0, ACCEL);
    let imported = imported(&log);
    assert_eq!(imported.rows.iter().map(|row| row.t_ns / MS).collect::<Vec<_>>(), [1000, 1001, 1002, 1010]);
    assert!(!imported.summary.notes.iter().any(|note| matches!(note, Note::Damage { .. })));
}
