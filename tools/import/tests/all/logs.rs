//! Logs made here, of which every value is known.

use import::Note;

use crate::common::{ATTITUDE, COMBINED, Folder, Imported, Log, MAGNETOMETER, NEW_RECEIVER, OLD_COMBINED, RECEIVER};

const GYRO: [f32; 3] = [0.5, 0.25, -2.0];
const ACCEL: [f32; 3] = [1.0, 2.0, -9.75];
const MS: i64 = 1_000_000;

fn imported(log: &Log) -> Imported {
    let folder = Folder::new();
    folder.import(&[folder.file("a.ulg", &log.0)], None).unwrap()
}

/// Samples each ms from 1 s on.
fn combined(log: &mut Log, count: u64) {
    (0..count).for_each(|i| log.combined(1_000_000 + 1000 * i, GYRO, 0, ACCEL));
}

fn field_rows(imported: &Imported) -> Vec<(i64, [f64; 3])> {
    imported.rows.iter().filter_map(|row| Some((row.t_ns / MS, row.field_ut?))).collect()
}

fn left_out(imported: &Imported) -> Vec<(&str, u64)> {
    let notes = imported.summary.notes.iter();
    notes
        .filter_map(|note| if let Note::LeftOut { what, count, .. } = note { Some((*what, *count)) } else { None })
        .collect()
}

#[test]
fn forward_right_down_is_made_right_forward_up_and_ned_enu() {
    let mut log = Log::of(&[COMBINED, MAGNETOMETER, ATTITUDE, RECEIVER]);
    combined(&mut log, 2);
    log.data(1, 1_000_300, &[&1_000_000u64, &[0.25f32, 0.125, 0.5]]);
    let half = 0.5f32.sqrt();
    // Facing east; then, north with the nose up by 30 degrees and with the right side down by as much: of the page of conventions.
    log.data(2, 1_000_000, &[&[half, 0.0, 0.0, half], &0u8]);
    let (c, s) = (15f32.to_radians().cos(), 15f32.to_radians().sin());
    log.data(2, 1_001_000, &[&[c, 0.0, s, 0.0], &0u8]);
    log.data(3, 1_000_500, &[&[-378_123_456i32, 1_450_000_001, 81_250], &[1.5f32, 2.5, -0.5], &3u8, &1u8]);
    log.combined(1_002_000, GYRO, 0, ACCEL);
    log.data(2, 1_002_000, &[&[c, s, 0.0, 0.0], &0u8]);

    let imported = imported(&log);
    let row = imported.rows[0];
    assert_eq!((row.t_ns, row.rate_rad_s, row.force_m_s2), (1_000_000_000, [0.25, 0.5, 2.0], [2.0, 1.0, 9.75]));
    assert_eq!(row.field_ut, Some([12.5, 25.0, -50.0]), "from gauss");
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
fn a_fix_of_any_age_is_read_and_one_without_velocity_is_none() {
    let folder = Folder::new();
    for (format, position) in [
        (RECEIVER, &[123_456_789i32, -20_000_000, 81_250] as &dyn crate::common::Bytes),
        (NEW_RECEIVER, &[12.3456789f64, -2.0, 81.25]),
    ] {
        let mut log = Log::of(&[COMBINED, format]);
        combined(&mut log, 2);
        for (i, kind, valid) in [(0u64, 3u8, 1u8), (1, 2, 1), (2, 3, 0), (3, 4, 1)] {
            log.data(1, 1_000_000 + 1000 * i, &[position, &[1.0f32, 2.0, 3.0], &kind, &valid]);
        }
        let imported = folder.import(&[folder.file("a.ulg", &log.0)], None).unwrap();
        assert_eq!(imported.fixes.iter().map(|fix| fix.t_ns / MS).collect::<Vec<_>>(), [1000, 1003], "{format}");
        assert_eq!(imported.fixes[0].latitude_deg, Some(12.3456789));
        let text = std::fs::read_to_string(folder.path("out_gnss.csv")).unwrap();
        assert_eq!(text.lines().nth(1), Some("1,2,1,-3,12.3456789,-2,81.25"));
        assert_eq!(left_out(&imported), [("fixes", 2)]);
    }
}

#[test]
fn a_sample_of_the_field_is_at_the_row_of_its_time_and_only_there() {
    let mut log = Log::of(&[COMBINED, MAGNETOMETER]);
    combined(&mut log, 10);
    // Nearer to the 2nd row, nearer to the 4th though published at the 6th, far behind the last.
    for (sampled_us, published_us) in [(1_001_400u64, 1_001_400), (1_002_600, 1_005_000), (1_200_000, 1_200_000)] {
        log.data(1, published_us, &[&sampled_us, &[1.0f32, 0.0, 0.0]]);
    }
    let imported = imported(&log);
    assert_eq!(field_rows(&imported), [(1001, [0.0, 100.0, 0.0]), (1003, [0.0, 100.0, 0.0])]);
    assert_eq!(left_out(&imported), [("samples of the field", 1)]);
}

#[test]
fn an_old_log_has_the_field_in_sensor_combined_and_repeats_it() {
    let mut log = Log::of(&[OLD_COMBINED]);
    for (i, relative_us, field_ga) in
        [(0u64, i32::MAX, 9.0f32), (1, -400, 1.0), (2, -1400, 1.0), (3, -2400, 1.0), (4, -300, 2.0)]
    {
        log.data(0, 1_000_000 + 1000 * i, &[&GYRO, &0i32, &ACCEL, &relative_us, &[field_ga, 0.0, 0.0]]);
    }
    let imported = imported(&log);
    assert_eq!(field_rows(&imported), [(1001, [0.0, 100.0, 0.0]), (1004, [0.0, 200.0, 0.0])]);
    assert_eq!(left_out(&imported), [], "one that was never taken is not left out");
}

#[test]
fn the_force_is_that_at_the_time_of_the_rate() {
    let mut log = Log::of(&[COMBINED]);
    // The accelerometer runs 1 ms behind, at half the rate of the gyro; the force grows by 1 m/s² each ms.
    for (i, relative_us) in [(0u64, -1000), (2, -3000), (4, -1000), (6, -3000), (8, -1000), (10, i32::MAX)] {
        let t_ms = i as f64 + f64::from(relative_us) / 1000.0;
        log.combined(1_000_000 + 1000 * i, GYRO, relative_us, [t_ms as f32, 0.0, 0.0]);
    }
    let imported = imported(&log);
    let force: Vec<_> = imported.rows.iter().map(|row| (row.t_ns / MS - 1000, row.force_m_s2[1])).collect();
    assert_eq!(
        force,
        [(0, 0.0), (2, 2.0), (4, 4.0), (6, 6.0), (8, 7.0), (10, 7.0)],
        "the last is held, for it is the last"
    );
}

#[test]
fn between_two_references_that_are_close_there_is_one_and_else_none() {
    let mut log = Log::of(&[COMBINED, ATTITUDE]);
    combined(&mut log, 200);
    let facing = |deg: f32| [(deg / 2.0).to_radians().cos(), 0.0, 0.0, (deg / 2.0).to_radians().sin()];
    for (t_ms, deg, resets, sign) in
        [(10u64, 0.0f32, 0u8, 1.0f32), (20, 10.0, 0, -1.0), (30, 90.0, 1, 1.0), (110, 90.0, 1, 1.0)]
    {
        log.data(1, 1_000_000 + 1000 * t_ms, &[&facing(deg).map(|part| sign * part), &resets]);
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
    assert_eq!(references, even.chain([(30, 90.0), (110, 90.0)]).collect::<Vec<_>>(), "none across a reset or a gap");
    assert_eq!(imported.summary.reference_rows, 13);
}

#[test]
fn the_first_instance_is_read_and_the_others_are_told() {
    let mut log = Log::of(&[COMBINED, MAGNETOMETER]);
    log.add(2, 1, "vehicle_magnetometer");
    log.data(2, 1_000_000, &[&0u64, &[9.0f32, 0.0, 0.0]]);
    combined(&mut log, 5);
    log.data(1, 1_000_000, &[&0u64, &[1.0f32, 0.0, 0.0]]);
    log.data(2, 1_002_000, &[&0u64, &[9.0f32, 0.0, 0.0]]);
    let imported = imported(&log);
    assert_eq!(field_rows(&imported), [(1000, [0.0, 100.0, 0.0])]);
    let others = Note::OtherInstances { topic: "vehicle_magnetometer", read: 0, others: 2 };
    assert!(imported.summary.notes.contains(&others), "{:?}", imported.summary.notes);
}

#[test]
fn times_that_do_not_grow_are_left_out() {
    let mut log = Log::of(&[COMBINED]);
    for t_us in [1_000_000u64, 1_001_000, 1_001_000, 1_000_500, 1_002_000, u64::MAX] {
        log.combined(t_us, GYRO, 0, ACCEL);
    }
    let imported = imported(&log);
    assert_eq!(imported.rows.iter().map(|row| row.t_ns / MS).collect::<Vec<_>>(), [1000, 1001, 1002]);
    assert_eq!(left_out(&imported), [("samples of the rate", 2), ("samples of the force", 1)]);
}

#[test]
fn what_a_log_lacks_is_told() {
    let mut log = Log::of(&[COMBINED]);
    (0..3).for_each(|i| log.combined(1000 * i, GYRO, 0, [0.0, 0.0, -1.0]));
    log.message(b'O', &25u16.to_le_bytes());
    let notes: Vec<_> = imported(&log).summary.notes.iter().map(ToString::to_string).collect();
    assert_eq!(
        notes,
        [
            "the mean force is 1.00 m/s², not near 9.8: check its unit, and that gravity is in it",
            "there is no reference attitude (vehicle_attitude)",
            "there is no velocity of a receiver (vehicle_gps_position, sensor_gps)",
            "dropouts of the log: 1, 25 ms in all; what was measured then is not in it",
            "there is no magnetic field: the course has no north",
        ]
    );
}

#[test]
fn what_was_appended_after_a_crash_is_read() {
    let mut whole = Log::of(&[COMBINED]);
    combined(&mut whole, 4);
    let mut log = whole.clone();
    log.0.truncate(whole.0.len() - 7);
    let offset = log.0.len() as u64;
    // The offsets are the last three numbers of the first message.
    log.0[16 + 3 + 16..][..8].copy_from_slice(&offset.to_le_bytes());
    log.0[16 + 3 + 8] = 1;
    log.combined(1_010_000, GYRO, 0, ACCEL);
    let imported = imported(&log);
    assert_eq!(imported.rows.iter().map(|row| row.t_ns / MS).collect::<Vec<_>>(), [1000, 1001, 1002, 1010]);
    assert!(!imported.summary.notes.iter().any(|note| matches!(note, Note::Damage { .. })));
}
