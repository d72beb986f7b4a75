//! Bags written by rosbags and the Python MCAP library, compared with rosbags.

use std::{collections::BTreeMap, fs, path::Path, slice::from_ref};

use import::{Format, Note, Options, convert};

use crate::{
    common::{Folder, Imported},
    python::python,
    scripts::run_script,
};

const NAMES: [&str; 6] = ["none", "zstd", "sqlite3", "packed", "lz4.mcap", "bare.mcap"];

/// Time and values of each message, by topic.
type Messages = BTreeMap<String, Vec<(i64, Vec<f64>)>>;

/// Creates the bags in a folder and returns the messages that rosbags reads from each.
fn bags(folder: &Path) -> BTreeMap<String, Messages> {
    let mut bags: BTreeMap<String, Messages> = BTreeMap::new();
    for words in run_script("bags.py", &[folder.as_os_str()]) {
        let numbers = words[3..].iter().map(|word| word.parse().unwrap()).collect();
        let topics = bags.entry(words[0].clone()).or_default();
        topics.entry(words[1].clone()).or_default().push((words[2].parse().unwrap(), numbers));
    }
    bags
}

fn with_topics(topics: &[&str]) -> Options {
    Options { topics: topics.iter().map(|topic| (*topic).to_owned()).collect(), ..Options::default() }
}

/// Checks that every value equals the one read by rosbags. Rates, forces and fields must be equal
/// to the last bit.
fn assert_equal(imported: &Imported, bag: &Messages, imu: &str) {
    let is_measured = |numbers: &[f64]| numbers[5] != -1.0;
    let expected: Vec<_> = bag[imu].iter().filter(|(_, numbers)| is_measured(numbers)).collect();
    assert_eq!(imported.rows.len(), expected.len());
    let mut references = 0;
    for (row, (t_ns, numbers)) in imported.rows.iter().zip(expected) {
        let [w, x, y, z, covariance, _, gx, gy, gz, ax, ay, az] = numbers[..] else { panic!("{numbers:?}") };
        assert_eq!((row.t_ns, row.rate_rad_s, row.force_m_s2), (*t_ns, [-gy, gx, gz], [-ay, ax, az]));
        if covariance == -1.0 || [w, x, y, z] == [0.0; 4] {
            // The reference of this row is interpolated.
            continue;
        }
        let reference = row.reference.unwrap();
        // Forward is the first body axis in ROS and the second one in Plumbline. Up is the third in
        // both.
        let forward = [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)];
        let up = [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)];
        let [w, x, y, z] = reference.quaternion;
        let found = [
            [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)],
            [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)],
        ];
        let expected = [forward, up];
        assert!(found.iter().flatten().zip(expected.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-12));
        references += 1;
    }
    assert!(references > 2000);
    let fields: Vec<_> = imported.rows.iter().filter_map(|row| row.field_ut).collect();
    let expected: Vec<_> = bag["/mag"].iter().map(|(_, b)| [-b[1] * 1e6, b[0] * 1e6, b[2] * 1e6]).collect();
    assert_eq!(fields, expected);
}

#[test]
fn bags_match_rosbags() {
    if python().is_none() {
        return;
    }
    let folder = Folder::new();
    let bags = bags(&folder.path(""));
    for name in NAMES {
        let path = folder.path(name);
        let Imported { summary, fixes, .. } = &folder.import(from_ref(&path), None).unwrap();
        let format = if name.ends_with(".mcap") { Format::Mcap } else { Format::Bag };
        assert_eq!((summary.format, summary.fixes, fixes.len()), (format, 0, 0), "{name}");
        let notes: Vec<_> = summary.notes.iter().map(ToString::to_string).collect();
        assert_eq!(
            notes,
            [
                "read rate and force from /imu/data; also available: /imu/raw; select with --topic",
                "skipped 30 messages of the topics read: malformed, or marked as not measured",
                "/vel may hold the velocity of a receiver; --topic /vel reads it as east, north, up",
            ],
            "{name}"
        );

        for imu in ["/imu/data", "/imu/raw"] {
            let imported = folder.import_with(from_ref(&path), &with_topics(&[imu, "/vel"])).unwrap();
            assert_equal(&imported, &bags[name], imu);
            let fixes: Vec<_> =
                imported.fixes.iter().map(|fix| (fix.t_ns, fix.velocity_m_s.to_vec(), fix.latitude_deg)).collect();
            let expected = bags[name]["/vel"].iter().zip(&bags[name]["/fix"]);
            let expected: Vec<_> =
                expected.map(|((t_ns, numbers), (_, place))| (*t_ns, numbers.clone(), Some(place[0]))).collect();
            assert_eq!((fixes.len(), &fixes), (150, &expected), "{name}");
        }
    }
    for (topics, expected) in [
        (&["/imu/date"][..], "no readable topic \"/imu/date\" (did you mean \"/imu/data\"?); available topics:"),
        (
            &["/imu/raw", "/imu/data"],
            "--topic names both \"/imu/raw\" and \"/imu/data\", expected one topic for rate and force",
        ),
        (&["/note"], "no readable topic \"/note\""),
    ] {
        let error = folder.import_with(&[folder.path("none")], &with_topics(topics)).unwrap_err();
        assert!(error.exit_code() == 2 && error.to_string().contains(expected), "{error}");
    }
}

#[test]
fn bag_of_several_files_joined_and_damage_reported() {
    if python().is_none() {
        return;
    }
    let folder = Folder::new();
    let bags = bags(&folder.path(""));
    // A split bag: a truncated file, a complete file, and the metadata.
    let split = folder.path("split");
    fs::create_dir(&split).unwrap();
    fs::copy(folder.path("none/metadata.yaml"), split.join("metadata.yaml")).unwrap();
    let whole = fs::read(folder.path("lz4.mcap")).unwrap();
    fs::write(split.join("split_10.mcap"), &whole).unwrap();
    fs::write(split.join("split_9.mcap"), &whole[..whole.len() / 2]).unwrap();
    let imported = folder.import(from_ref(&split), None).unwrap();
    let measured = bags["lz4.mcap"]["/imu/data"].iter().filter(|(_, numbers)| numbers[5] != -1.0).count();
    assert_eq!(imported.rows.len(), measured, "repeated messages are skipped");
    let notes: Vec<_> = imported.summary.notes.iter().map(ToString::to_string).collect();
    assert!(notes[0].starts_with("split_9.mcap is damaged: byte "), "{notes:?}");
    assert!(notes.iter().any(|note| note.contains("timestamps do not increase")), "{notes:?}");

    // Only the damaged chunk is skipped.
    let mut damaged = whole.clone();
    damaged[whole.len() / 3] ^= 0x10;
    let imported = folder.import(&[folder.file("damaged.mcap", &damaged)], None).unwrap();
    assert!(imported.rows.len() < measured && imported.rows.len() > measured * 8 / 10, "{}", imported.rows.len());
    let skipped = Note::Skipped { what: "message chunks", count: 1, reason: "damaged" };
    assert!(imported.summary.notes.contains(&skipped), "{:?}", imported.summary.notes);

    for (name, contents, expected) in [
        ("a.mcap.zstd", &b"\x28\xb5\x2f\xfd"[..], "unpack them with zstd -d"),
        ("b.txt", b"nothing", "a .mcap or .db3 file next to metadata.yaml"),
    ] {
        let bag = folder.path(&format!("of_{name}"));
        fs::create_dir(&bag).unwrap();
        fs::copy(folder.path("none/metadata.yaml"), bag.join("metadata.yaml")).unwrap();
        fs::write(bag.join(name), contents).unwrap();
        let error = folder.import(&[bag], None).unwrap_err();
        assert!(error.to_string().contains(expected), "{error}");
    }
}

#[test]
fn database_with_views_or_generated_columns_rejected() {
    let folder = Folder::new();
    for endless in [
        "CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n) \
         SELECT id, 1 AS topic_id, id AS timestamp, randomblob(1000) AS data FROM n;",
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER AS (1), timestamp INTEGER, \
         data BLOB AS (zeroblob(900000000)));
         INSERT INTO messages(timestamp) VALUES (1), (2);",
    ] {
        let path = folder.path("a.db3");
        let _ = fs::remove_file(&path);
        let database = rusqlite::Connection::open(&path).unwrap();
        let topics = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);
                      INSERT INTO topics VALUES (1, '/imu', 'sensor_msgs/msg/Imu', 'cdr');";
        database.execute_batch(&format!("{topics}{endless}")).unwrap();
        drop(database);
        let error = folder.import(from_ref(&path), None).unwrap_err();
        assert!(error.exit_code() == 3, "{error}");
        assert_eq!(folder.names(), ["a.db3"], "no other file is created");
    }
}

#[test]
fn bag_progress_increases_to_total() {
    if python().is_none() {
        return;
    }
    let folder = Folder::new();
    bags(&folder.path(""));
    for name in NAMES {
        let mut reports = Vec::new();
        let out = folder.path("out.csv");
        convert(&[folder.path(name)], &Options::default(), &out, &mut |progress| reports.push(progress)).unwrap();
        assert!(
            reports.len() > 5 && reports.windows(2).all(|pair| pair[0].done_bytes <= pair[1].done_bytes),
            "{reports:?}"
        );
        assert_eq!(reports.last().unwrap().done_bytes, reports.last().unwrap().total_bytes);
    }
}
