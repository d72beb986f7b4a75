//! Logs with random changes, and random bytes: no reader panics or returns more rows than the file
//! contains.

use std::path::PathBuf;

use import::Mapping;
use proptest::{collection::vec, prelude::*, sample::Index, test_runner::TestCaseResult};
use serde::Serialize;

use crate::{
    ardupilot::dataflash_log,
    common::{ATTITUDE, COMBINED, Folder, Log, MAGNETOMETER, RECEIVER},
};

/// Edge values for lengths and indices.
const EDGE_BYTES: [u8; 6] = [0x00, 0x01, 0x7f, 0x80, 0xfe, 0xff];

#[derive(Serialize)]
struct Imu {
    stamp: (i32, u32),
    frame_id: &'static str,
    orientation: [f64; 4],
    orientation_covariance: [f64; 9],
    rate: [f64; 3],
    rate_covariance: [f64; 9],
    force: [f64; 3],
    force_covariance: [f64; 9],
}

fn imu(row: u32) -> Vec<u8> {
    let imu = Imu {
        stamp: (1, row * 1_000_000),
        frame_id: "imu",
        orientation: [0.0, 0.0, 0.0, 1.0],
        orientation_covariance: [0.0; 9],
        rate: [0.1; 3],
        rate_covariance: [0.0; 9],
        force: [0.0, 0.0, 9.8],
        force_covariance: [0.0; 9],
    };
    let message = cdr_encoding::to_vec::<_, byteorder::LittleEndian>(&imu).unwrap();
    [&[0, 1, 0, 0][..], &message].concat()
}

const ROWS: u32 = 40;

fn mcap(compression: Option<mcap::Compression>) -> Vec<u8> {
    let mut file = std::io::Cursor::new(Vec::new());
    let options = mcap::WriteOptions::new().compression(compression).chunk_size(Some(2000));
    let mut writer = options.create(&mut file).unwrap();
    let schema = writer.add_schema("sensor_msgs/msg/Imu", "ros2msg", b"").unwrap();
    let channel = writer.add_channel(schema, "/imu", "cdr", &Default::default()).unwrap();
    for row in 0..ROWS {
        let header = mcap::records::MessageHeader { channel_id: channel, sequence: row, log_time: 1, publish_time: 1 };
        writer.write_to_known_channel(&header, &imu(row)).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    file.into_inner()
}

fn database() -> Vec<u8> {
    let folder = Folder::new();
    let path = folder.path("a.db3");
    let database = rusqlite::Connection::open(&path).unwrap();
    let tables = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, \
                  serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);
                  CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data BLOB NOT NULL);
                  INSERT INTO topics VALUES (1, '/imu', 'sensor_msgs/msg/Imu', 'cdr', '');";
    database.execute_batch(tables).unwrap();
    for row in 0..ROWS {
        database.execute("INSERT INTO messages VALUES (NULL, 1, ?1, ?2)", (row, imu(row))).unwrap();
    }
    drop(database);
    std::fs::read(path).unwrap()
}

fn ulog() -> Vec<u8> {
    let mut log = Log::new(&[COMBINED, MAGNETOMETER, ATTITUDE, RECEIVER]);
    for row in 0..u64::from(ROWS) {
        let t_us = 1_000_000 + 1000 * row;
        log.combined(t_us, [0.0; 3], 0, [0.0, 0.0, -9.8]);
        log.sample(1, t_us, &[&t_us, &[0.2f32, 0.0, 0.4]]);
        log.sample(2, t_us, &[&[1.0f32, 0.0, 0.0, 0.0], &0u8]);
        log.sample(3, t_us, &[&[0i32; 3], &[1.0f32; 3], &3u8, &1u8]);
    }
    log.0
}

fn table() -> Vec<u8> {
    let rows: String = (0..ROWS).map(|row| format!("{row},0.1,-2e-3,0.3,0.4,0.5,9.8\n")).collect();
    format!("t,p,q,r,u,v,w\n{rows}").into()
}

/// Checks that an import returns at most `rows` rows or reports invalid input.
fn check(contents: &[u8], rows: u64, columns: Option<&str>) -> TestCaseResult {
    let folder = Folder::new();
    let path: PathBuf = folder.file("a", contents);
    let mapping = columns.map(|columns| Mapping::parse(&[columns], Some("ms"), None).unwrap());
    match folder.import(&[path], mapping) {
        Ok(imported) => prop_assert!(imported.summary.rows <= rows, "{:?}", imported.summary),
        // A mapped column that is missing because the header is damaged is reported as a
        // command-line error.
        Err(error) => {
            let is_input_error = error.exit_code() == 3 || columns.is_some() && error.exit_code() == 2;
            prop_assert!(is_input_error && !error.to_string().is_empty(), "{error}");
        }
    }
    Ok(())
}

fn mutations() -> impl Strategy<Value = (Vec<(Index, u8)>, Index, bool)> {
    let byte = prop_oneof![any::<u8>(), prop::sample::select(&EDGE_BYTES[..])];
    (vec((any::<Index>(), byte), 1..8), any::<Index>(), any::<bool>())
}

fn mutated(original: &[u8], (bytes, end, is_cut): (Vec<(Index, u8)>, Index, bool)) -> Vec<u8> {
    let mut contents = original.to_vec();
    for (index, byte) in bytes {
        let index = index.index(contents.len());
        contents[index] = byte;
    }
    if is_cut {
        contents.truncate(end.index(original.len()));
    }
    contents
}

fn run(original: &[u8], rows: u32, columns: Option<&str>) {
    let mut runner = proptest::test_runner::TestRunner::new(ProptestConfig {
        cases: 500,
        failure_persistence: None,
        ..ProptestConfig::default()
    });
    check(original, rows.into(), columns).unwrap();
    runner.run(&mutations(), |mutations| check(&mutated(original, mutations), rows.into(), columns)).unwrap();
    let start = original[..16].to_vec();
    let noise = vec(any::<u8>(), 0..3000);
    runner.run(&noise, |noise| check(&[&start[..], &noise].concat(), u64::MAX, columns)).unwrap();
}

#[test]
fn mutated_mcap_read_or_rejected() {
    for compression in [None, Some(mcap::Compression::Lz4), Some(mcap::Compression::Zstd)] {
        run(&mcap(compression), ROWS, None);
    }
}

#[test]
fn mutated_database_read_or_rejected() {
    run(&database(), ROWS, None);
}

/// The log has no checksum, so a changed type or instance can turn any message into a row. The
/// number of rows is therefore limited only by the length of the log in bytes.
#[test]
fn mutated_ardupilot_log_read_or_rejected() {
    let log = dataflash_log(ROWS).0;
    run(&log, log.len() as u32, None);
}

#[test]
fn mutated_ulog_read_or_rejected() {
    run(&ulog(), ROWS, None);
}

/// A changed byte can split a line into two rows. The limit therefore exceeds the number of rows in
/// the unchanged file.
#[test]
fn mutated_csv_read_or_rejected() {
    run(&table(), ROWS + 8, Some("t=t,gx=p,gy=q,gz=r,ax=u,ay=v,az=w"));
}
