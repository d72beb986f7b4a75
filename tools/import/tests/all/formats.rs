//! Files are known by what is in them.

use std::io::Write;

use flate2::{Compression, write::GzEncoder};
use import::Format;

use crate::common::{COMBINED, Folder, Log};

const OURS: &str = "t_s,gx,gy,gz,ax,ay,az\n0,0,0,0,0,0,9.8\n";

fn gzip(contents: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(contents).unwrap();
    encoder.finish().unwrap()
}

#[test]
fn a_format_is_known_by_content_under_any_name() {
    let folder = Folder::new();
    for (contents, format, remedy) in [
        (OURS.into(), Format::Recording, "it is a recording of this system; there is nothing to import"),
        (gzip(OURS.as_bytes()), Format::Recording, "it is a recording of this system; there is nothing to import"),
        (b"time,x,y,z\n0,1,2,3\n".into(), Format::Csv, "nothing says what its columns are; name them with --map"),
        (gzip(b"time;x;y;z\n0;1;2;3\n"), Format::Csv, "there are \"time\", \"x\", \"y\", \"z\""),
        (Log::of(&[COMBINED]).0, Format::Ulog, "found no sample of rate and force"),
        (b"\x89MCAP0\r\n\x01".into(), Format::Mcap, "found no sample of rate and force (a.csv is not whole: byte 8"),
        (
            vec![0xa3, 0x95, 0x80, 0x80, 0x59],
            Format::ArduPilot,
            "found no sample of rate and force, expected IMU with GyrX and AccX",
        ),
        (b"SQLite format 3\0\x10\0".into(), Format::Sqlite, "found no sample of rate and force"),
        (b"PK\x03\x04\x14\0".into(), Format::Zip, "a zip archive; unpack it"),
        (gzip(&Log::of(&[COMBINED]).0), Format::Gzip, "gzip of something that is no text; unpack it (gunzip)"),
    ] {
        for name in ["a.csv", "a.ulg", "a"] {
            let path = folder.file(name, &contents);
            assert_eq!(Format::of(&path).unwrap(), format, "{name}");
            let said = folder.said(&folder.import(&[path], None).unwrap_err());
            let expected = remedy.replace("a.csv", name);
            assert!(said.contains(&expected), "{format:?}: {said}");
        }
    }
    for contents in [&b""[..], b"\x00\x01\x02", b"\xff\xfet\0,\0"] {
        let error = Format::of(&folder.file("a.csv", contents)).unwrap_err();
        assert_eq!(
            folder.said(&error),
            "recognising a.csv: found no known format, expected ULog, MCAP, a ROS 2 bag, an ArduPilot log or CSV; text must be UTF-8 (save it as \"CSV UTF-8\")"
        );
    }
    let pipe = folder.path("pipe");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let error = Format::of(&pipe).unwrap_err();
    assert_eq!(
        folder.said(&error),
        "opening pipe: it is a pipe or a device, and is read twice; check that the file can be read"
    );
    let error = Format::of(&folder.path("none")).unwrap_err();
    assert_eq!(folder.said(&error), "opening none: No such file or directory (os error 2); check the path");
}
