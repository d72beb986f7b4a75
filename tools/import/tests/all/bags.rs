//! Bags written by rosbags and the Python MCAP library, compared with rosbags.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    slice::from_ref,
};

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

/// Checks that every value equals the one read by rosbags. Rates, forces and magnetic fields must
/// be equal to the last bit.
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
    assert!(notes[0].contains("has 2 segments") && notes[0].contains("read segment 2"), "{notes:?}");
    assert!(notes[1].starts_with("split_9.mcap is damaged: byte "), "{notes:?}");

    // Only the damaged chunk is skipped.
    let mut damaged = whole.clone();
    damaged[whole.len() / 3] ^= 0x10;
    let imported = folder.import(&[folder.file("damaged.mcap", &damaged)], None).unwrap();
    assert!(imported.rows.len() < measured && imported.rows.len() > measured * 8 / 10, "{}", imported.rows.len());
    let skipped = Note::Skipped { what: "message chunks", count: 1, reason: "damaged, or too large when decompressed" };
    assert!(imported.summary.notes.contains(&skipped), "{:?}", imported.summary.notes);

    for (name, contents, expected) in [
        ("a.mcap.zstd", &b"\x28\xb5\x2f\xfd"[..], "unpack them with `zstd -d "),
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
    let data = |i| imu_message(i).iter().map(|byte| format!("{byte:02x}")).collect::<String>();
    let readable = format!(
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER AS (instr('ab', 'a')), timestamp INTEGER, \
         data BLOB);
         INSERT INTO messages(timestamp, data) VALUES (1, x'{}'), (2, x'{}');",
        data(1),
        data(2)
    );
    for stored in [
        "CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n) \
         SELECT id, 1 AS topic_id, id AS timestamp, randomblob(1000) AS data FROM n;",
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER AS (1), timestamp INTEGER, \
         data BLOB AS (zeroblob(900000000)));
         INSERT INTO messages(timestamp) VALUES (1), (2);",
        &readable,
    ] {
        let path = folder.path("a.db3");
        let _ = fs::remove_file(&path);
        let database = rusqlite::Connection::open(&path).unwrap();
        let topics = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);
                      INSERT INTO topics VALUES (1, '/imu', 'sensor_msgs/msg/Imu', 'cdr');";
        database.execute_batch(&format!("{topics}{stored}")).unwrap();
        drop(database);
        let error = folder.import(from_ref(&path), None).unwrap_err();
        assert!(error.exit_code() == 3, "{error}");
        assert_eq!(folder.names(), ["a.db3"], "no other file is created");
    }
}

/// Returns the message of a stationary IMU in CDR.
fn imu_message(i: i32) -> Vec<u8> {
    let mut data = b"\0\x01\0\0".to_vec();
    data.extend([i.to_le_bytes(), 0i32.to_le_bytes(), 4i32.to_le_bytes()].concat());
    data.extend(b"imu\0");
    let zeros = |count| vec![0.0; count];
    let numbers = [zeros(3), vec![1.0], zeros(9), zeros(3), zeros(9), vec![0.0, 0.0, 9.8], zeros(9)].concat();
    data.extend(numbers.iter().flat_map(|number: &f64| number.to_le_bytes()));
    data
}

/// Creates a database of `count` messages and applies `changes`. Each message contains its
/// position, counted from 1.
fn database(folder: &Folder, count: i32, changes: &str) -> PathBuf {
    let path = folder.path("a.db3");
    let _ = fs::remove_file(&path);
    let database = rusqlite::Connection::open(&path).unwrap();
    let tables = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);
                  CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
                  CREATE INDEX timestamp_idx ON messages (timestamp ASC);
                  INSERT INTO topics VALUES (1, '/imu', 'sensor_msgs/msg/Imu', 'cdr'), (2, '/image', 'image', 'cdr');
                  BEGIN";
    database.execute_batch(tables).unwrap();
    for i in 1..=count {
        let insert = "INSERT INTO messages VALUES (?1, 1, ?1, ?2)";
        database.execute(insert, rusqlite::params![i, imu_message(i)]).unwrap();
    }
    database.execute_batch(&format!("COMMIT; {changes}")).unwrap();
    path
}

/// Returns the number of rows, and the notes except those on missing quantities.
fn rows_and_notes(folder: &Folder, path: &Path) -> (usize, Vec<String>) {
    let imported = folder.import(&[path.to_owned()], None).unwrap();
    let notes = imported.summary.notes.iter().filter(|note| !matches!(note, Note::Missing { .. }));
    (imported.rows.len(), notes.map(ToString::to_string).collect())
}

#[test]
fn rows_lost_from_database_are_counted() {
    let folder = Folder::new();
    let missing = "skipped 3 messages: missing from the numbered rows of the database";
    for (changes, rows, expected) in [
        ("", 20, None),
        ("INSERT INTO messages VALUES (21, 2, 21, zeroblob(100000))", 20, None),
        ("DELETE FROM messages WHERE id IN (1, 7, 8)", 17, Some(missing)),
        (
            "UPDATE messages SET topic_id = 77 WHERE id = 5",
            19,
            Some("skipped 1 messages: their topic is not in the database"),
        ),
        (
            "UPDATE messages SET topic_id = 'x' WHERE id = 5",
            19,
            Some("skipped 1 messages: their topic is not in the database"),
        ),
        (
            "UPDATE messages SET data = 5 WHERE id = 5; UPDATE messages SET data = zeroblob(70000) WHERE id = 9",
            18,
            Some("skipped 2 messages of the topics read: they are empty or longer than 64 KiB"),
        ),
    ] {
        let found = rows_and_notes(&folder, &database(&folder, 20, changes));
        assert_eq!(found, (rows, expected.map(str::to_owned).into_iter().collect()), "{changes}");
    }
}

#[test]
fn database_whose_row_numbers_go_back_ends() {
    let folder = Folder::new();
    let path = database(&folder, 2000, "");
    let mut bytes = fs::read(&path).unwrap();
    // In a table's inner page, each cell is the number of a leaf page and its largest row number.
    // Pointing every cell to the first leaf makes the rows repeat.
    let page_bytes = usize::from(u16::from_be_bytes([bytes[16], bytes[17]]));
    let is_inner = |page: &&mut [u8]| page[0] == 5;
    let cell_at = |page: &[u8], i: usize| usize::from(u16::from_be_bytes([page[12 + 2 * i], page[13 + 2 * i]]));
    let mut changed = 0;
    for page in bytes.chunks_mut(page_bytes).skip(1).filter(is_inner) {
        let first = page[cell_at(page, 0)..][..4].to_vec();
        for i in 1..usize::from(u16::from_be_bytes([page[3], page[4]])) {
            let at = cell_at(page, i);
            page[at..at + 4].copy_from_slice(&first);
            changed += 1;
        }
    }
    assert!(changed > 10);
    fs::write(&path, bytes).unwrap();
    let (rows, notes) = rows_and_notes(&folder, &path);
    assert!((1..2000).contains(&rows) && notes[0].starts_with("a.db3 is damaged: row "), "{rows} {notes:?}");
}

#[test]
fn damaged_database_costs_the_damaged_rows_only() {
    let folder = Folder::new();
    // This many rows need two levels of inner pages. The second level is at the end of the file.
    let path = database(&folder, 6000, "");
    let bytes = fs::read(&path).unwrap();
    let (length, page) = (bytes.len(), usize::from(u16::from_be_bytes([bytes[16], bytes[17]])));
    let zeroed = |from: usize, to: usize| [&bytes[..from], &vec![0; to - from], &bytes[to..]].concat();
    let middle = length / 2 / page * page;
    for (what, contents, expected) in [
        ("cut", bytes[..length * 3 / 4].to_vec(), 4000..6000),
        ("cut inside a page", bytes[..length * 3 / 4 + 77].to_vec(), 4000..6000),
        ("zeros at the end", zeroed(length * 3 / 4, length), 4000..6000),
        ("a page of zeros", zeroed(middle, middle + page), 5900..6000),
        ("zeros across pages", zeroed(middle + 100, middle + 8 * page), 5800..6000),
    ] {
        let (rows, notes) = rows_and_notes(&folder, &folder.file("b.db3", contents));
        assert!(expected.contains(&rows), "{what}: {rows} {notes:?}");
        assert!(notes.iter().any(|note| note.starts_with("b.db3 is damaged")), "{what}: {notes:?}");
    }
}

#[test]
fn row_with_damaged_number_costs_no_other_row() {
    let folder = Folder::new();
    let path = database(&folder, 100, "");
    // A cell of a table's leaf page consists of the length of the row, its number and its content.
    let content = imu_message(50);
    for (number, name) in [(0u8, "too small"), (0x7f, "too large")] {
        let mut bytes = fs::read(&path).unwrap();
        let at = bytes.windows(content.len()).position(|window| window == content).unwrap();
        // Between the number and the data are seven bytes of the record's header, and the
        // timestamp.
        let number_at = (at - 16..at).find(|index| bytes[*index] == 50 && bytes[index + 1] < 10).unwrap();
        bytes[number_at] = number;
        let changed = folder.file("changed.db3", bytes);
        let (rows, notes) = rows_and_notes(&folder, &changed);
        let stray = "skipped 1 messages: their row numbers do not increase or are beyond the last row".to_owned();
        assert!(rows == 99 && notes.contains(&stray), "{name}: {rows} {notes:?}");
    }
}

#[test]
fn message_larger_than_limit_when_decompressed_rejected() {
    let folder = Folder::new();
    let path = database(&folder, 20, "");
    let large = [imu_message(21), vec![0; 1 << 20]].concat();
    let compressed = zstd::encode_all(&large[..], 3).unwrap();
    let insert = "INSERT INTO messages VALUES (21, 1, 21, ?1)";
    rusqlite::Connection::open(&path).unwrap().execute(insert, [compressed]).unwrap();
    let rejected = "skipped 1 messages of the topics read: malformed, or marked as not measured";
    assert_eq!(rows_and_notes(&folder, &path), (20, vec![rejected.to_owned()]));
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
