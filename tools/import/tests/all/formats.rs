//! Format detection by content.

use std::io::Write;

use flate2::{Compression, write::GzEncoder};
use import::Format;

use crate::common::{COMBINED, Folder, Log};

const RECORDING: &str = "t_s,gx,gy,gz,ax,ay,az\n0,0,0,0,0,0,9.8\n";

fn gzip(contents: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(contents).unwrap();
    encoder.finish().unwrap()
}

#[test]
fn format_detected_by_content_under_any_name() {
    let folder = Folder::new();
    for (contents, format, remedy) in [
        (RECORDING.into(), Format::Recording, "found Plumbline recording; no import is needed"),
        (gzip(RECORDING.as_bytes()), Format::Recording, "found Plumbline recording; no import is needed"),
        (b"time,x,y,z\n0,1,2,3\n".into(), Format::Csv, "its columns is unknown; map them with --map"),
        (gzip(b"time;x;y;z\n0;1;2;3\n"), Format::Csv, "available columns: \"time\", \"x\", \"y\", \"z\""),
        (Log::new(&[COMBINED]).0, Format::Ulog, "found no sample of rate and force"),
        (b"\x89MCAP0\r\n\x01".into(), Format::Mcap, "found no sample of rate and force (a.csv is damaged: byte 8"),
        (
            vec![0xa3, 0x95, 0x80, 0x80, 0x59],
            Format::ArduPilot,
            "found no sample of rate and force, expected IMU with GyrX and AccX",
        ),
        (b"SQLite format 3\0\x10\0".into(), Format::Sqlite, "found no sample of rate and force"),
        (b"PK\x03\x04\x14\0".into(), Format::Zip, "zip archive; unpack it"),
        (gzip(&Log::new(&[COMBINED]).0), Format::Gzip, "gzip file without text; unpack it (gunzip)"),
    ] {
        for name in ["a.csv", "a.ulg", "a"] {
            let path = folder.file(name, &contents);
            assert_eq!(Format::detect(&path).unwrap(), format, "{name}");
            let message = folder.message(&folder.import(&[path], None).unwrap_err());
            let expected = remedy.replace("a.csv", name);
            assert!(message.contains(&expected), "{format:?}: {message}");
        }
    }
    for contents in [&b""[..], b"\x00\x01\x02", b"\xff\xfet\0,\0"] {
        let error = Format::detect(&folder.file("a.csv", contents)).unwrap_err();
        let message = folder.message(&error);
        assert!(message.starts_with("importing a.csv: unknown format, expected ULog"), "{message}");
        assert!(message.contains("save text as \"CSV UTF-8\""), "{message}");
    }
    let pipe = folder.path("pipe");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let error = Format::detect(&pipe).unwrap_err();
    assert_eq!(
        folder.message(&error),
        "opening pipe: pipes and devices cannot be read twice; check that the file is readable"
    );
    let error = Format::detect(&folder.path("none")).unwrap_err();
    assert_eq!(folder.message(&error), "opening none: No such file or directory (os error 2); check the path");
}
