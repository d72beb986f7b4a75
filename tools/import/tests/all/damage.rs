//! Truncated and damaged logs: the part before the damage is read, the damage is reported, and
//! nothing panics.

use import::{Format, ImportError, Note};

use crate::common::{ATTITUDE, COMBINED, Folder, Log, MAGNETOMETER, RECEIVER, log};

fn complete_log() -> Log {
    let mut log = Log::new(&[COMBINED, MAGNETOMETER, ATTITUDE, RECEIVER]);
    for i in 0..4u64 {
        let t_us = 1_000_000 + 1000 * i;
        log.combined(t_us, [0.0; 3], 0, [0.0, 0.0, -9.8]);
        log.sample(1, t_us, &[&t_us, &[0.2f32, 0.0, 0.4]]);
        log.sample(2, t_us, &[&[1.0f32, 0.0, 0.0, 0.0], &0u8]);
        log.sample(3, t_us, &[&[0i32; 3], &[1.0f32; 3], &3u8, &1u8]);
    }
    log
}

/// Imports the first `length` bytes. Returns the number of rows, and `true` if damage is reported.
fn import_prefix(folder: &Folder, log: &[u8], length: usize) -> Result<(u64, bool), ImportError> {
    let path = folder.file("cut.ulg", &log[..length]);
    let summary = folder.import(&[path], None)?.summary;
    let is_damaged = summary.notes.iter().any(|note| matches!(note, Note::Damage { .. }));
    Ok((summary.rows, is_damaged))
}

#[test]
fn log_cut_at_any_byte_keeps_earlier_rows() {
    let (folder, log) = (Folder::new(), complete_log().0);
    let whole = log.len();
    let mut before = 0;
    for length in 0..whole {
        match import_prefix(&folder, &log, length) {
            Ok((rows, _)) => {
                assert!((before..=4).contains(&rows), "{length}: {rows}");
                before = rows;
            }
            Err(error) => {
                assert!(before == 0, "{length}: {error}");
                assert!(!error.to_string().is_empty() && error.exit_code() == 3, "{length}: {error}");
            }
        }
        let _ = std::fs::remove_file(folder.path("out_gnss.csv"));
    }
    assert_eq!(before, 4);
    assert_eq!(import_prefix(&folder, &log, whole - 1).unwrap(), (4, true));
    assert_eq!(import_prefix(&folder, &log, whole).unwrap(), (4, false));
}

#[test]
fn text_cut_within_a_row_is_reported() {
    let folder = Folder::new();
    let text = "t_s,gx,gy,gz,ax,ay,az\n0.00,0.125,0,0,0,0,9.806\n0.01,0.25,0,0,0,0,9.807\n0.02,0,0,0,0,0,9.80665\n";
    for length in text.find("0.01").unwrap()..=text.len() {
        let summary = folder.import(&[folder.file("cut.csv", &text[..length])], None).unwrap().summary;
        let is_loss = |note: &Note| matches!(note, Note::UnendedRow { .. } | Note::MalformedRows { .. });
        let is_reported = summary.notes.iter().any(is_loss);
        assert_eq!(is_reported, !text[..length].ends_with('\n'), "{length}: {:?}", summary.notes);
    }
    // A complete row needs no line end.
    let summary = folder.import(&[folder.file("cut.csv", text.trim_end())], None).unwrap().summary;
    assert!(summary.rows == 3 && summary.notes.contains(&Note::UnendedRow { line: 4 }), "{summary:?}");
}

#[test]
fn log_with_any_byte_damaged_does_not_panic() {
    let (folder, log) = (Folder::new(), complete_log().0);
    for index in 0..log.len() {
        for flipped in [0x01, 0x82] {
            let mut damaged = log.clone();
            damaged[index] ^= flipped;
            // Success and error are both acceptable, depending on the changed byte.
            let _ = folder.import(&[folder.file("damaged.ulg", &damaged)], None);
            let _ = std::fs::remove_file(folder.path("out_gnss.csv"));
        }
    }
}

#[test]
fn messages_that_panic_the_parser_are_filtered() {
    let folder = Folder::new();
    let mut log = Log::new(&[COMBINED]);
    log.combined(1_000_000, [0.0; 3], 0, [0.0, 0.0, -9.8]);
    for (kind, content, is_damage) in [
        (b'A', &b"\x00\x01"[..], true),
        (b'D', b"\x00", true),
        (b'D', b"\x00\x00\x00", true),
        (b'P', b"", false),
        (b'P', b"\xffint32_t x", false),
        (b'F', b"huge:next[32767] x;", false),
        (b'\0', b"", true),
    ] {
        let mut log = log.clone();
        log.message(kind, content);
        log.combined(1_001_000, [0.0; 3], 0, [0.0, 0.0, -9.8]);
        let summary = folder.import(&[folder.file("a.ulg", &log.0)], None).unwrap().summary;
        assert_eq!(summary.rows, 2, "{kind} {content:?}");
        let skipped = summary.notes.iter().any(
            |note| matches!(note, Note::Skipped { what: "bytes", count, .. } if *count == 3 + content.len() as u64),
        );
        assert_eq!(skipped, is_damage, "{kind} {content:?}: {:?}", summary.notes);
    }
}

#[test]
fn log_continues_after_damaged_part() {
    let folder = Folder::new();
    let mut random = 7u64;
    let mut noise: Vec<u8> = Vec::new();
    for _ in 0..200_000 {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        noise.push(random.to_be_bytes()[0]);
    }
    let zeros = vec![0; 200_000];
    for damage in [&noise[..1], &noise[..300], &noise, &zeros] {
        let mut log = complete_log();
        log.0.extend_from_slice(damage);
        for i in 4..9u64 {
            log.combined(1_000_000 + 1000 * i, [0.0; 3], 0, [0.0, 0.0, -9.8]);
        }
        let summary = folder.import(&[folder.file("a.ulg", &log.0)], None).unwrap().summary;
        let notes: Vec<_> = summary.notes.iter().map(ToString::to_string).collect();
        assert_eq!(summary.rows, 9, "{} bytes: {notes:?}", damage.len());
        let count = damage.len();
        assert_eq!(notes, [format!("skipped {count} bytes: not a message, or damaged")]);
    }
}

#[test]
fn samples_with_impossible_time_are_counted() {
    let folder = Folder::new();
    let mut log = complete_log();
    log.combined(u64::MAX / 2, [0.0; 3], 0, [0.0, 0.0, -9.8]);
    let summary = folder.import(&[folder.file("a.ulg", &log.0)], None).unwrap().summary;
    let reason = "the time is out of range";
    assert_eq!(summary.notes, [Note::Skipped { what: "sensor_combined samples", count: 1, reason }]);
}

#[test]
fn messages_changed_by_damage_are_counted() {
    let folder = Folder::new();
    for (kind, content) in [
        (b'D', &[7, 0, 1, 2, 3][..]),
        (b'F', b"late:uint8_t x;"),
        (b'E', b"unknown"),
        (b'L', b"\x00\x01 no level"),
        (b'S', b"12345678"),
        (b'I', b"\xffx"),
        (b'Q', b"\x01"),
    ] {
        let mut log = complete_log();
        log.message(b'L', b"6\0\0\0\0\0\0\0\0text");
        log.message(b'S', &[0x2f, 0x73, 0x13, 0x20, 0x25, 0x0c, 0xbb, 0x12]);
        log.message(b'P', b"\x09int32_t x\0\0\0\0");
        let notes = |log: &Log| folder.import(&[folder.file("a.ulg", &log.0)], None).unwrap().summary.notes;
        assert_eq!(notes(&log), []);
        log.message(kind, content);
        let reason = "damaged: unknown type or topic, or invalid content";
        assert_eq!(notes(&log), [Note::Skipped { what: "messages", count: 1, reason }], "{}", char::from(kind));
    }
}

#[test]
fn nested_formats_of_other_topics_cost_nothing() {
    let folder = Folder::new();
    let nested: Vec<_> = (0..5000).map(|i| format!("n{i}:n{}[9] x;n{}[9] y;", i + 1, i + 1)).collect();
    let mut topics: Vec<_> = nested.iter().map(String::as_str).collect();
    topics.push("n5000:");
    topics.insert(0, COMBINED);
    let mut log = Log::new(&topics);
    log.combined(1_000_000, [0.0; 3], 0, [0.0, 0.0, -9.8]);
    assert_eq!(folder.import(&[folder.file("a.ulg", &log.0)], None).unwrap().summary.rows, 1);
}

#[recorded::test]
fn real_log_cut_anywhere_keeps_earlier_rows() {
    let Some(path) = log("px4_small.ulg") else { return };
    let (folder, log) = (Folder::new(), std::fs::read(path).unwrap());
    let mut before = 0;
    for length in (0..log.len()).step_by(1000).chain([log.len()]) {
        let rows = import_prefix(&folder, &log, length).map_or(0, |(rows, _)| rows);
        assert!(rows >= before, "{length}: {rows} after {before}");
        before = rows;
        let _ = std::fs::remove_file(folder.path("out_gnss.csv"));
    }
    assert_eq!(before, 1298);
}

#[recorded::test]
fn longer_log_cut_at_some_bytes_keeps_earlier_rows() {
    let Some(path) = log("px4_sample.ulg") else { return };
    let (folder, log) = (Folder::new(), std::fs::read(path).unwrap());
    let mut before = 0;
    let starts = (0..40_000).step_by(1000);
    for length in starts.chain((40_000..log.len()).step_by(333_000)) {
        let rows = import_prefix(&folder, &log, length).map_or(0, |(rows, _)| rows);
        assert!(rows >= before, "{length}: {rows} after {before}");
        before = rows;
    }
    assert!(before > 15_000, "{before}");
}

#[test]
fn log_without_samples_rejected() {
    let folder = Folder::new();
    for (log, expected) in [
        (
            Log::new(&[]),
            "importing a.ulg: found no sample of rate and force, expected the topic sensor_combined, vehicle_imu, or sensor_gyro and sensor_accel",
        ),
        (
            Log::new(&["sensor_combined:uint64_t timestamp;float[2] gyro_rad;"]),
            "importing a.ulg: found no sample of rate and force, expected the topic sensor_combined, vehicle_imu, or sensor_gyro and sensor_accel",
        ),
        (
            Log(b"ULog\x01\x12\x35".to_vec()),
            "reading a.ulg: byte 0: found the end of the file within a message before any data; copy the file again",
        ),
    ] {
        let path = folder.file("a.ulg", &log.0);
        assert_eq!(Format::detect(&path).unwrap(), Format::Ulog);
        assert_eq!(folder.message(&folder.import(&[path], None).unwrap_err()), expected);
    }
    let mut log = Log::new(&["sensor_combined:uint64_t timestamp;float[2] gyro_rad;"]);
    log.sample(0, 1, &[&[0.0f32; 2]]);
    assert_eq!(
        folder.message(&folder.import(&[folder.file("a.ulg", &log.0)], None).unwrap_err()),
        "reading a.ulg: topic sensor_combined: no field gyro_rad[0] of type float[3]; \
         available fields: \"timestamp\", \"gyro_rad[0]\", \"gyro_rad[1]\""
    );
    assert_eq!(folder.names(), ["a.ulg"], "no file remains");
}
