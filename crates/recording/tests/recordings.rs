//! Reads valid, unusual, malformed and real recordings.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use flate2::{Compression, write::GzEncoder};
use recording::{Reader, Row, Survey, survey};
use std::{
    io::Write,
    path::{Path, PathBuf},
};
use tempfile::TempDir;

const HEADER: &str = "t_s,gx,gy,gz,ax,ay,az\n";
const PLAIN: &str = "t_s,gx,gy,gz,ax,ay,az,qw,qx,qy,qz,mov\n\
    0.0000,0.1,0.2,0.3,0.4,0.5,9.8,2,0,0,0,1\n\
    0.0035,nan,inf,-inf,1e-3,-0,+9.8,nan,nan,nan,nan,1\n\
    0.0070,0,0,0,0,0,9.8,0.6,0,-0.8,0,0\n";

fn file(name: &str, contents: &[u8]) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, contents).unwrap();
    (folder, path)
}

fn gzip(contents: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(contents).unwrap();
    encoder.finish().unwrap()
}

fn zstd(text: &str) -> Vec<u8> {
    zstd::encode_all(text.as_bytes(), 0).unwrap()
}

fn rows(contents: &[u8]) -> Vec<Row> {
    let (_folder, path) = file("flight.csv", contents);
    Reader::open(&path).unwrap().map(Result::unwrap).collect()
}

/// Returns the error of [`survey`], with the folder removed from the path.
fn error(contents: &[u8]) -> String {
    let (folder, path) = file("flight.csv", contents);
    let message = survey(&path).unwrap_err().to_string();
    message.replace(&format!("{}/", folder.path().display()), "")
}

/// Returns the error message of [`survey`] without its prefix.
fn malformed(contents: &[u8]) -> String {
    error(contents).strip_prefix("reading the recording flight.csv: ").unwrap().to_owned()
}

fn with_header(rows: &str) -> Vec<u8> {
    format!("{HEADER}{rows}").into_bytes()
}

#[test]
fn row_holds_values_of_its_line() {
    let rows = rows(PLAIN.as_bytes());
    assert_eq!(rows.len(), 3);
    assert_eq!((rows[0].rate_rad_s, rows[0].force_m_s2), ([0.1, 0.2, 0.3], [0.4, 0.5, 9.8]));
    let reference = rows[0].reference.unwrap();
    assert_eq!((reference.quaternion, reference.scored), ([1.0, 0.0, 0.0, 0.0], true));
    assert_eq!(rows[1].t_ns, 3_500_000);
    assert!(rows[1].rate_rad_s[0].is_nan() && rows[1].rate_rad_s[1..] == [f64::INFINITY, f64::NEG_INFINITY]);
    assert_eq!(rows[1].reference, None);
    let reference = rows[2].reference.unwrap();
    assert_eq!((reference.quaternion, reference.scored), ([0.6, 0.0, -0.8, 0.0], false));
}

#[test]
fn zero_or_infinite_quaternion_gives_no_reference() {
    let rows = rows(
        b"t_s,gx,gy,gz,ax,ay,az,qw,qx,qy,qz\n0,0,0,0,0,0,0,0,0,0,0\n1,0,0,0,0,0,0,inf,0,0,0\n2,0,0,0,0,0,0,1,0,0,0",
    );
    assert_eq!(rows.iter().map(|row| row.reference.map(|it| it.scored)).collect::<Vec<_>>(), [None, None, Some(true)]);
}

#[test]
fn field_with_nan_component_is_none() {
    let rows = rows(
        b"t_s,gx,gy,gz,ax,ay,az,mx,my,mz\n0,0,0,0,0,0,0,1,-2.5,3e1\n1,0,0,0,0,0,0,nan,nan,nan\n2,0,0,0,0,0,0,1,nan,3\n",
    );
    assert_eq!(rows.iter().map(|row| row.field_ut).collect::<Vec<_>>(), [Some([1.0, -2.5, 30.0]), None, None]);
}

#[test]
fn reader_accepts_blanks_quotes_crlf_bom_and_column_order() {
    let input =
        b"\xef\xbb\xbf\"az\" , qw,ay,ax,gz,gy,gx,t_s,qx,qy,qz\r\n\r\n 9.8,0 ,5 ,\t4,\" 3 \",2,1,0.5 ,0,0,0\r\n \r\n9.8,0,5,4,3,2,1,1.5,0,0,0";
    let row = Row {
        t_ns: 500_000_000,
        rate_rad_s: [1.0, 2.0, 3.0],
        force_m_s2: [4.0, 5.0, 9.8],
        field_ut: None,
        reference: None,
    };
    assert_eq!(rows(input), [row, Row { t_ns: 1_500_000_000, ..row }]);
}

#[test]
fn comments_are_skipped_and_unended_line_is_found() {
    let text = format!("# walk\n{HEADER}% rest\n0,0,0,0,0,0,9.8\n1,0,0,0,0,0,9.80\n");
    for (length, unended_line) in [(text.len(), None), (text.len() - 1, Some(5)), (text.len() - 2, Some(5))] {
        for contents in [text.as_bytes()[..length].to_vec(), gzip(&text.as_bytes()[..length]), zstd(&text[..length])] {
            let (_folder, path) = file("flight.csv", &contents);
            let mut reader = Reader::open(&path).unwrap();
            assert_eq!((reader.by_ref().map(Result::unwrap).count(), reader.unended_line()), (2, unended_line));
        }
    }
}

#[test]
fn gzip_is_detected_by_magic_and_may_have_members() {
    let (first, second) = PLAIN.as_bytes().split_at(70);
    let members = [gzip(first), gzip(b""), gzip(second)].concat();
    let plain = format!("{:?}", rows(PLAIN.as_bytes()));
    assert_eq!(format!("{:?}", rows(&gzip(PLAIN.as_bytes()))), plain);
    assert_eq!(format!("{:?}", rows(&members)), plain);
    let (_folder, path) = file("plain.csv.gz", PLAIN.as_bytes());
    assert_eq!(format!("{:?}", Reader::open(&path).unwrap().map(Result::unwrap).collect::<Vec<_>>()), plain);
}

#[test]
fn survey_rate_is_inverse_of_median_interval() {
    let (_folder, path) = file(
        "flight.csv",
        format!(
            "{HEADER}{}",
            ["10", "10.01", "10.02", "10.02", "10.03", "12"].map(|t_s| format!("{t_s},0,0,0,0,0,0\n")).concat()
        )
        .as_bytes(),
    );
    assert_eq!(survey(&path).unwrap(), Survey { rows: 6, rate_hz: 100.0, has_reference: false });
}

#[test]
fn survey_rate_counts_samples_of_coarse_stamps() {
    let stamps = ["1.00", "1.00", "1.01", "1.01", "1.01", "1.02", "1.02", "1.03", "1.03"];
    let rows: String = stamps.iter().enumerate().map(|(row, t_s)| format!("{t_s},0,0,0,0,0,{row}\n")).collect();
    let (_folder, path) = file("flight.csv", format!("{HEADER}{rows}").as_bytes());
    let rate_hz = survey(&path).unwrap().rate_hz;
    assert!((rate_hz - 800.0 / 3.0).abs() < 1e-9, "{rate_hz}");
}

#[test]
fn reader_ends_after_first_error() {
    let (_folder, path) =
        file("flight.csv", format!("{HEADER}0,0,0,0,0,0,0\nx,0,0,0,0,0,0\n1,0,0,0,0,0,0\n").as_bytes());
    let kinds: Vec<_> = Reader::open(&path).unwrap().map(|row| row.is_ok()).collect();
    assert_eq!(kinds, [true, false]);
}

#[test]
fn open_error_names_file_and_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let (absent, directory) = (folder.path().join("absent.csv"), folder.path().display());
    let message = |path: &Path| Reader::open(path).err().unwrap().to_string();
    assert_eq!(
        message(&absent),
        format!("opening the recording {directory}/absent.csv: No such file or directory (os error 2); check the path")
    );
    assert_eq!(
        message(folder.path()),
        format!("opening the recording {directory}: Is a directory (os error 21); give the path of a file in it")
    );
}

#[test]
fn parse_error_names_file_position_and_expected_value() {
    assert_eq!(
        error(&with_header("0,0,0,0,9.8o1,0,0\n")),
        "reading the recording flight.csv: line 2, column 5 (ax): found \"9.8o1\", expected a number"
    );
}

#[test]
fn malformed_values_are_reported_with_position() {
    for (rows, message) in [
        ("0,0,0,0,0,0,0\r\n\r\n1,,0,0,0,0,0\r\n", "line 4, column 2 (gx): found \"\", expected a number"),
        ("0,0,0,0,0,0,0\n\n1,0,0,0,0,0,\"0", "line 4, column 7 (az): found \"\\\"0\", expected a number"),
        ("nan,0,0,0,0,0,0\n", "line 2, column 1 (t_s): found \"nan\", expected a finite time in seconds within ±9e9"),
        ("9e9,0,0,0,0,0,0\n", "line 2, column 1 (t_s): found \"9e9\", expected a finite time in seconds within ±9e9"),
    ] {
        assert_eq!(malformed(&with_header(rows)), message);
    }
    assert_eq!(
        malformed(b"mov,t_s,gx,gy,gz,ax,ay,az\n2,0,0,0,0,0,0,0\n"),
        "line 2, column 1 (mov): found \"2\", expected 0 or 1"
    );
}

#[test]
fn rows_of_wrong_length_are_rejected() {
    for (rows, message) in [
        ("0,0,0,0,0,0\n", "line 2, column 7 (az): found 6 fields, expected 7 as in the header"),
        ("0,0,0,0,0,0,0,0\n", "line 2, column 8: found 8 fields, expected 7 as in the header"),
    ] {
        assert_eq!(malformed(&with_header(rows)), message);
    }
}

#[test]
fn invalid_headers_are_rejected() {
    for (header, message) in [
        (
            "t_s,gx,gy,gz,ax,ay,az,Mov",
            "line 1, column 8: found \"Mov\", expected a known column; did you mean \"mov\"?",
        ),
        ("t_s,gxx,gy,gz,ax,ay,az", "line 1, column 2: found \"gxx\", expected a known column; did you mean \"gx\"?"),
        (
            "t_s,gx,gy,gz,ax,ay,az,baro",
            "line 1, column 8: found \"baro\", expected one of \
             t_s, gx, gy, gz, ax, ay, az, qw, qx, qy, qz, mov, mx, my, mz; \
             name another logger's columns with --map, as --map t=COLUMN,gx=COLUMN,…",
        ),
        ("t_s,gx,gy,gz,ax,ay,az,gx", "line 1, column 8 (gx): found a duplicate name, expected it in column 2 only"),
        ("t_s,gx,gy,ax,ay", "line 1: found no column gz, az, expected all of t_s, gx, gy, gz, ax, ay, az"),
        ("t_s,gx,gy,gz,ax,ay,az,mx,mz", "line 1: found no column my, expected all of mx, my, mz"),
        ("t_s,gx,gy,gz,ax,ay,az,qw,qx", "line 1: found no column qy, qz, expected all of qw, qx, qy, qz"),
    ] {
        assert_eq!(malformed(header.as_bytes()), message);
    }
}

#[test]
fn files_without_rows_or_intervals_are_rejected() {
    for contents in [&b""[..], b"\n\r\n", &gzip(b"")] {
        let message = "line 1: found the end of the file, expected the header line";
        assert_eq!(malformed(contents), message);
    }
    assert_eq!(malformed(HEADER.as_bytes()), "line 2: found the end of the file, expected a row");
    for (rows, count) in [("1,0,0,0,0,0,0\n", 1), ("1,0,0,0,0,0,0\n1.0,0,0,0,0,0,0\n", 2)] {
        let message = format!(
            "reading the recording flight.csv: found no time interval in {count} row(s), \
             expected increasing times (t_s)"
        );
        assert_eq!(error(&with_header(rows)), message);
    }
}

#[test]
fn truncated_or_corrupt_gzip_is_rejected() {
    let complete = gzip(PLAIN.as_bytes());
    for length in 2..complete.len() {
        let message = error(&complete[..length]);
        assert!(message.contains("found the end of the file inside the compressed data"), "{length}: {message}");
    }
    assert_eq!(
        malformed(&complete[..complete.len() - 1]),
        "line 5: found the end of the file inside the compressed data, expected the rest of it; copy the file again"
    );
    let mut damaged = complete;
    let checksum = damaged.len() - 8;
    damaged[checksum] ^= 1;
    assert_eq!(
        malformed(&damaged),
        "line 5: cannot read the line: corrupt gzip stream does not have a matching checksum"
    );
}

#[test]
fn invalid_utf8_is_rejected_with_its_line() {
    for (contents, message) in [
        (&b"t_s,g\xff\n"[..], "line 1: found \"t_s,g\u{fffd}\", expected UTF-8 text"),
        (
            b"t_s,gx,gy,gz,ax,ay,az\n0,0,0,0,9.\xff8,0,0\n",
            "line 2: found \"0,0,0,0,9.\u{fffd}8,0,0\", expected UTF-8 text",
        ),
        (
            b"t_s,gx,gy,gz,ax,ay,az,mov\n0,0,0,0,0,0,0,\xc3\n",
            "line 2: found \"0,0,0,0,0,0,0,\u{fffd}\", expected UTF-8 text",
        ),
    ] {
        assert_eq!(malformed(contents), message);
    }
}

#[test]
fn endless_line_is_rejected_at_length_limit() {
    assert_eq!(
        malformed(&[HEADER.as_bytes(), &vec![b'0'; 1 << 20]].concat()),
        "line 2: cannot read the line: longer than 65536 bytes"
    );
}

fn data() -> Option<PathBuf> {
    let folder = std::env::var_os("PLUMBLINE_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"), PathBuf::from);
    if folder.is_dir() {
        return Some(folder);
    }
    println!("skipped: no data at {}", folder.display());
    None
}

#[recorded::test]
fn broad_trial_is_read_completely() {
    let Some(data) = data() else { return };
    let survey = survey(&data.join("broad/02_undisturbed_slow_rotation_B.csv.gz")).unwrap();
    assert_eq!((survey.rows, survey.has_reference), (53_240, true));
    assert!((survey.rate_hz - 1.0 / 0.0035).abs() < 1e-9, "{survey:?}");
}

#[recorded::test]
fn flight_is_read_completely() {
    let Some(data) = data() else { return };
    let survey = survey(&data.join("flights/apm_plane_log2_imu.csv.gz")).unwrap();
    assert_eq!((survey.rows, survey.has_reference), (30_649, true));
    assert!((survey.rate_hz - 50.0).abs() < 1e-9, "{survey:?}");
}
