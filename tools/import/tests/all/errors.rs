//! Errors report the position, the value found and what was expected.

use std::{path::PathBuf, slice::from_ref};

use import::{ImportError, Mapping, Note, Options, convert};

use crate::common::{ATTITUDE, COMBINED, Folder, Log};

const TIME: &str = "a time in s, less than 9e9 s; set another unit with --units";
const TIME_TEXT: &str = "a number, a time of day such as 13:05:00.02 or a date such as 2026-05-01T13:05:00.02Z";
const NAMES: &str = "t=t,gx=p,gy=q,gz=r,ax=u,ay=v,az=w";

fn mapping_error(maps: &[&str], units: &str, frame: &str) -> String {
    ImportError::from(Mapping::parse(maps, Some(units), Some(frame)).unwrap_err()).to_string()
}

fn import_error(folder: &Folder, paths: &[PathBuf], maps: &[&str]) -> String {
    let mapping = Mapping::parse(maps, None, None).unwrap();
    folder.message(&folder.import(paths, Some(mapping)).unwrap_err())
}

#[test]
fn mapping_invalid_rejected() {
    for (maps, expected) in [
        (
            &["gyro"][..],
            "reading --map: found \"gyro\", expected TARGET=COLUMN with TARGET one of t, gx, gy, gz, ax, ay, az, mx, my, mz, qw, qx, qy, qz, ve, vn, vu, vd, lat, lon, alt, mov",
        ),
        (
            &["gxx=a"],
            "reading --map: found \"gxx\" (did you mean \"gx\"?), expected one of t, gx, gy, gz, ax, ay, az, mx, my, mz, qw, qx, qy, qz, ve, vn, vu, vd, lat, lon, alt, mov",
        ),
        (&[NAMES, "gx=a"], "reading --map: found gx twice, expected one column for it"),
        (&["t=t,gx=p,gy=q"], "reading --map: found no gz, ax, ay, az, expected all of t, gx, gy, gz, ax, ay, az"),
        (&[NAMES, "my=a"], "reading --map: found no mx, mz, expected all of mx, my, mz"),
    ] {
        assert_eq!(mapping_error(maps, "", "rfu"), expected);
    }
    let units =
        "expected one of rad/s, mrad/s, deg/s, mdeg/s, m/s2, g, mg, uT, nT, gauss, mgauss, mT, T, s, ms, us, ns";
    assert_eq!(
        mapping_error(&[NAMES], "deg/s,degs", "rfu"),
        format!("reading --units: found \"degs\" (did you mean \"deg/s\"?), {units}")
    );
    assert_eq!(
        mapping_error(&[NAMES], "US", "rfu"),
        format!("reading --units: found \"US\" (did you mean \"us\"?), {units}")
    );
    assert_eq!(
        mapping_error(&[NAMES], "g,m/s2", "rfu"),
        "reading --units: found \"g\" and \"m/s2\", expected one unit of the force"
    );
    assert_eq!(
        mapping_error(&[NAMES], "", "ned"),
        "reading --frame: found \"ned\", expected body axes, one of rfu, flu, frd; with a reference preceded by earth axes, one of enu, nwu, ned, as in ned-frd"
    );
}

#[test]
fn unknown_column_reports_similar_and_available_names() {
    let folder = Folder::new();
    let a = folder.file("a.csv", "time,gyro_x,q,r,u,v,w\n0,0,0,0,0,0,0\n");
    let names = "t=time,gx=gyrox,gy=q,gz=r,ax=u,ay=v,az=w";
    assert_eq!(
        import_error(&folder, from_ref(&a), &[names]),
        "mapping gx: no column \"gyrox\" (did you mean \"gyro_x\"?); \
         available columns: \"time\", \"gyro_x\", \"q\", \"r\", \"u\", \"v\", \"w\""
    );
    let b = folder.file("b.csv", "time,q,u,v,w\n0,0,0,0,0\n");
    let names = names.replace("gyrox", "gyro_x");
    assert_eq!(
        import_error(&folder, &[a.clone(), b.clone()], &[&names]),
        "mapping gy: more than one column is named \"q\"; use a:q or b:q"
    );
    let names = names.replace("gy=q", "gy=b:q");
    assert_eq!(
        import_error(&folder, &[a, b], &[&names]),
        "mapping gx, gy, gz: found columns of \"a.csv\", \"b.csv\", \"a.csv\", expected all in one file"
    );
    let c = folder.file("c.csv", "t,p,p,q,r,u,v,w\n0,0,0,0,0,0,0,0\n");
    assert_eq!(
        import_error(&folder, &[c], &[NAMES]),
        "mapping gx: more than one column is named \"p\"; use different column names in the header"
    );
}

/// The import must report a wrong column name in a recording in the same way as the recording
/// reader.
#[test]
fn misspelt_recording_column_reported_with_suggestion() {
    let folder = Folder::new();
    for (header, message) in [
        ("t_s,gx,gy,gzz,ax,ay,az", "line 1, column 4: found \"gzz\", expected a known column; did you mean \"gz\"?"),
        ("ts,gx,gy,gz,ax,ay,az", "line 1, column 1: found \"ts\", expected a known column; did you mean \"t_s\"?"),
        ("t_s,gx,gy,gy,ax,ay,az", "line 1, column 4 (gy): found a duplicate name, expected it in column 3 only"),
        ("t_s,gx,gy,gz,ax,ay,qw", "line 1: found no column az, expected all of t_s, gx, gy, gz, ax, ay, az"),
    ] {
        let path = folder.file("a.csv", format!("{header}\n0,1,2,3,4,5,6\n"));
        for mapping in [None, Some(Mapping::parse::<&str>(&[], Some("deg/s"), None).unwrap())] {
            let error = folder.import(from_ref(&path), mapping).unwrap_err();
            let expected = format!("reading the recording a.csv: {message}");
            assert_eq!((folder.message(&error), error.exit_code()), (expected, 3), "{header}");
        }
    }
    // The columns of another program need a mapping, even if one resembles a known name.
    let path = folder.file("b.csv", "a,gx\n1,2\n");
    let error = folder.import(from_ref(&path), None).unwrap_err();
    assert!(matches!(error, ImportError::MappingRequired { .. }), "{error}");
}

#[test]
fn invalid_value_reported_with_position() {
    let folder = Folder::new();
    let header = "t;p;q;r;u;v;w\n";
    let good = "0;1.5;2;3;4;5;6\n";
    for (row, position, found, expected) in [
        ("1;1;2;x;4;5;6\n", "line 2, column 4 (r)", "\"x\"", "a number"),
        ("1;1,234.5;2;3;4;5;6\n", "line 2, column 2 (p)", "\"1,234.5\"", "a number"),
        ("2026-11-23 10;1;2;3;4;5;6\n", "line 2, column 1 (t)", "\"2026-11-23 10\"", TIME_TEXT),
        ("1700000000000;1;2;3;4;5;6\n", "line 2, column 1 (t)", "\"1700000000000\"", TIME),
        ("noon;1;2;3;4;5;6\n", "line 2, column 1 (t)", "\"noon\"", TIME_TEXT),
        (";1;2;3;4;5;6\n", "line 2, column 1 (t)", "\"\"", TIME_TEXT),
        ("1;1;2\n", "line 2, column 4 (r)", "3 fields", "7 as in the header"),
        ("1;1;2;3;4;5;6;7\n", "line 2, column 8", "8 fields", "7 as in the header"),
    ] {
        let path = folder.file("a.csv", format!("{header}{row}"));
        let message = import_error(&folder, &[path], &[NAMES]);
        assert_eq!(message, format!("reading a.csv: {position}: found {found}, expected {expected}"));
        // If another row is valid, only the malformed one is lost.
        let path = folder.file("a.csv", format!("{header}{good}{row}{row}"));
        let imported = folder.import(&[path], Some(Mapping::parse(&[NAMES], None, None).unwrap())).unwrap();
        let note = Note::MalformedRows { count: 2, line: 3, found: found.into(), expected: expected.into() };
        assert!(imported.summary.notes.contains(&note), "{:?}", imported.summary.notes);
        assert_eq!((imported.rows.len(), imported.summary.source_rows), (1, 3));
        assert!(imported.summary.warning().is_some_and(|warning| warning.contains("used only 1 of 3 rows")));
    }
    for (mark, other) in [("1.5", "1,5"), ("1,5", "1.5")] {
        let path = folder.file("a.csv", format!("{header}0;{mark};2;3;4;5;6\n1;{other};2;3;4;5;6\n"));
        let imported = folder.import(&[path], Some(Mapping::parse(&[NAMES], None, None).unwrap())).unwrap();
        assert_eq!(imported.rows.len(), 1, "all numbers have one decimal mark");
    }
    std::fs::remove_file(folder.path("out_imu.csv")).unwrap();
    let path = folder.file("a.csv", header);
    assert_eq!(
        import_error(&folder, &[path], &[NAMES]),
        "reading a.csv: line 2: found the end of the file, expected a row"
    );
    let path = folder.file("a.csv", [header.as_bytes(), b"0;\xb5;0;0;0;0;0\n"].concat());
    assert_eq!(
        import_error(&folder, &[path], &[NAMES]),
        "reading a.csv: line 2: found \"0;\u{fffd};0;0;0;0;0\\n\", expected UTF-8 text"
    );
    let path = folder.file("a.csv", [header.as_bytes(), &[b'0'; 1 << 17]].concat());
    assert_eq!(
        import_error(&folder, &[path], &[NAMES]),
        "reading a.csv: line 2: found a line of more than 65536 bytes, expected a readable line"
    );
    let path = folder.file("a.csv", format!("{header}0;;;;1;1;1\n9;1;1;1;;;\n"));
    assert_eq!(
        import_error(&folder, &[path], &[NAMES]),
        "importing a.csv: found no sample of rate and force (1 rate samples have no force sample nearby), \
         expected numbers in the mapped columns, with times of one clock"
    );
    assert_eq!(folder.names(), ["a.csv"], "no file remains");
}

#[test]
fn incompatible_files_and_options_rejected() {
    let folder = Folder::new();
    let mut log = Log::new(&[COMBINED, ATTITUDE]);
    log.combined(1, [0.0; 3], 0, [0.0, 0.0, -9.8]);
    let log = folder.file("a.ulg", log.0);
    let csv = folder.file("a.csv", "t,p\n0,0\n");
    let error = |paths: &[PathBuf], mapping| folder.message(&folder.import(paths, mapping).unwrap_err());
    let mapping = || Some(Mapping::parse(&[NAMES], None, None).unwrap());
    assert_eq!(error(&[], None), "importing: no input file; name at least one");
    assert_eq!(
        error(&[log.clone(), csv], None),
        "importing a.ulg: ULog cannot be combined with other files, found 2; import each file separately"
    );
    assert_eq!(
        error(from_ref(&log), mapping()),
        "importing a.ulg: ULog defines its own columns; leave out --map, --units and --frame"
    );
    let into = |out: &str| convert(from_ref(&log), &Options::default(), &folder.path(out), &mut |_| {});
    let error = into("a.ulg").unwrap_err();
    assert_eq!(folder.message(&error), "writing a.ulg: the output is also an input; choose another name");
    let interrupted = folder.file("a.csv.new", Log::new(&[COMBINED]).0);
    let error = convert(from_ref(&interrupted), &Options::default(), &folder.path("a.csv"), &mut |_| {}).unwrap_err();
    assert_eq!(folder.message(&error), "writing a.csv.new: the output is also an input; choose another name");
    std::fs::remove_file(interrupted).unwrap();
    assert!(matches!(into("no/such/folder_imu.csv"), Err(ImportError::Recording(_))));
    folder.file("b_gnss.csv", "t_s,ve,vn,vu\n0,0,0,0\n");
    let message = folder.message(&into("b_imu.csv").unwrap_err());
    assert!(
        message.starts_with("writing b_imu.csv: no fixes were imported, but b_gnss.csv would be read"),
        "{message}"
    );
    assert_eq!(folder.names(), ["a.csv", "a.ulg", "b_gnss.csv"], "no file remains");
}

/// Text with a terminal escape and a forged line.
const HOSTILE: &str = "a\x1b[2J\nforged";
const ESCAPED: &str = r"a\u{1b}[2J\nforged";

/// Returns a `sensor_msgs/msg/Imu` in CDR, at rest.
fn imu(t_ns: u32) -> Vec<u8> {
    let mut message = vec![0, 1, 0, 0];
    for word in [1, t_ns, 4, u32::from_le_bytes(*b"imu\0")] {
        message.extend(word.to_le_bytes());
    }
    let mut numbers = [0.0_f64; 37];
    (numbers[3], numbers[27]) = (1.0, 9.8);
    message.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
    message
}

#[test]
fn hostile_topic_names_are_escaped_in_notes_and_errors() {
    let folder = Folder::new();
    let path = folder.path("bag.mcap");
    let mut writer = mcap::Writer::new(std::fs::File::create(&path).unwrap()).unwrap();
    let schema = writer.add_schema("sensor_msgs/msg/Imu", "ros2msg", b"").unwrap();
    for name in ["/a", "/b"] {
        let channel = writer.add_channel(schema, &format!("{name}{HOSTILE}"), "cdr", &Default::default()).unwrap();
        for tick in 0..10 {
            let header =
                mcap::records::MessageHeader { channel_id: channel, sequence: 0, log_time: 0, publish_time: 0 };
            writer.write_to_known_channel(&header, &imu(tick * 10_000_000)).unwrap();
        }
    }
    writer.finish().unwrap();
    let imported = folder.import(from_ref(&path), None).unwrap();
    let notes = imported.summary.notes.iter().map(ToString::to_string).collect::<Vec<_>>();
    let expected = format!("read rate and force from /a{ESCAPED}; also available: /b{ESCAPED}; select with --topic");
    assert!(notes.contains(&expected), "{notes:?}");
}

#[test]
fn hostile_file_and_column_names_are_escaped_in_errors() {
    let folder = Folder::new();
    // A file with other control characters is not recognised as CSV.
    let a = folder.file(&format!("{HOSTILE}.csv"), "time,p\u{9b}2J\u{202e}q,q,r,u,v,w\n0,0,0,0,0,0,0\n");
    let b = folder.file("b.csv", "time,p\u{9b}2J\u{202e}q\n0,0\n");
    let files = [a, b];
    let names = "t=time,gx=p\u{9b}2J\u{202e}q,gy=q,gz=r,ax=u,ay=v,az=w";
    let mut errors = vec![import_error(&folder, &files, &[names])];
    assert!(errors[0].contains(r"b:p\u{9b}2J\u{202e}q"), "{errors:?}");
    errors.push(import_error(&folder, &[folder.file("c.csv", "time,p\u{9b}2J\u{202e}q,r\n0,0\n\n0\n")], &[names]));
    errors.push(import_error(&folder, &[folder.path(HOSTILE)], &[names]));
    assert!(errors[2].contains(ESCAPED), "{errors:?}");
    assert!(errors.iter().all(|error| !error.contains(char::is_control)), "{errors:?}");
}
