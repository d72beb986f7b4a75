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
        (b"PK\x03\x04\x14\0".into(), Format::Zip, "zip archive; unpack it with `unzip "),
        (b"PK\x03\x04\x14\0[Content_Types].xml".into(), Format::Spreadsheet, "spreadsheet; convert it with `python3"),
        (gzip(&Log::new(&[COMBINED]).0), Format::Gzip, "gzip file without text; unpack it with `gunzip "),
        (b"#ROSBAG V2.0\n".into(), Format::Ros1Bag, "ROS 1 bag; convert it with `rosbags-convert --src "),
        (b"H Product:Blackbox flight data".into(), Format::Blackbox, "blackbox log; convert it with `blackbox_decode"),
        (
            b"ArduCopter\n\nFMT, 128, 89, FMT, BBnNZ, Type\nIMU, 1, 2\n".into(),
            Format::ArduPilotText,
            "text form of an ArduPilot log; use the .BIN",
        ),
        (
            b"FMT,64,89,FMT,BBnNZ,Type,Length\nIMU,1,2\n".into(),
            Format::ArduPilotText,
            "text form of an ArduPilot log; use the .BIN",
        ),
        ([&[0xff; 64][..], b"H Product:Blackbox flight data\n"].concat(), Format::Blackbox, "blackbox log; convert"),
        (b"MATLAB 5.0 MAT-file, Platform".into(), Format::Matlab, "MATLAB file; write its matrix as CSV"),
        (b"\x93NUMPY\x01\0".into(), Format::Numpy, "NumPy array; convert it with `python3"),
        (b"[{\"t\": 0, \"gx\": 1}]\n".into(), Format::Json, "JSON; convert it with `python3"),
        (b"{\"t\": 0, \"gx\": 1}\n{\"t\": 1}\n".into(), Format::Json, "JSON; convert it with `python3"),
        (b"\xfa\xff\x36\x05\x10\x20".into(), Format::Xsens, "read it with `plumb up --source 'stdin?format=xsens&"),
        (
            b"\x55\x51\0\0\0\0\0\0\0\0\xa6\x55\x52\0\0\0\0\0\0\0\0\xa7".into(),
            Format::WitMotion,
            "read it with `plumb up --source 'stdin?format=witmotion&",
        ),
        (b"\xb5\x62\x01\x07\x5c\0".into(), Format::Receiver, "a satellite receiver; it has no rate and force"),
        (b"$GNRMC,,V,,,,,,,,,,N*4D\r\n".into(), Format::Receiver, "a satellite receiver; it has no rate and force"),
        (b"\xff\xfet\0,\0".into(), Format::Utf16Le, "text in UTF-16; convert it with `iconv -f UTF-16LE "),
        (b"t\0,\0x\0,\0y\0,\0z\0\n\0".into(), Format::Utf16Le, "text in UTF-16"),
        (b"\0t\0,\0x\0,\0y\0,\0z\0\n".into(), Format::Utf16Be, "convert it with `iconv -f UTF-16BE "),
        (b"\xff\xfe\0\0t\0\0\0".into(), Format::Utf32, "text in UTF-32; convert it with `iconv -f UTF-32 "),
        (b"PAR1\x15\x04".into(), Format::Parquet, "Parquet file; convert it with `python3"),
        ([&[b'a'; 257][..], b"ustar\0"].concat(), Format::Tar, "tar archive; unpack it with `tar xf"),
        (b"7z\xbc\xaf\x27\x1c\0\x04".into(), Format::SevenZip, "7z archive; unpack it with `7z x"),
        (b"\x28\xb5\x2f\xfd\x24".into(), Format::Zstd, "zstd file without text; unpack it with `zstd -d"),
    ] {
        for name in ["a.csv", "a.ulg", "a"] {
            let path = folder.file(name, &contents);
            assert_eq!(Format::detect(&path).unwrap(), format, "{name}");
            let message = folder.message(&folder.import(&[path], None).unwrap_err());
            let expected = remedy.replace("a.csv", name);
            assert!(message.contains(&expected), "{format:?}: {message}");
        }
    }
    let recordings = [RECORDING.into(), gzip(RECORDING.as_bytes())];
    for contents in recordings {
        let path = folder.file("a.bin", contents);
        assert_eq!(Format::detect(&path).unwrap(), Format::Recording);
        assert_eq!(folder.import(&[path], None).unwrap().rows.len(), 1);
    }
    let bag = folder.path("bag");
    std::fs::create_dir(&bag).unwrap();
    std::fs::write(bag.join("bag_0.db3"), "").unwrap();
    let message = folder.message(&folder.import(&[bag], None).unwrap_err());
    assert!(message.contains("without metadata.yaml; restore it with `ros2 bag reindex "), "{message}");
    let error = Format::detect(&folder.file("a.csv", b"\x00\x01\x02")).unwrap_err();
    let message = folder.message(&error);
    assert!(message.starts_with("importing a.csv: unknown format, expected ULog"), "{message}");
    assert!(message.contains("save text as \"CSV UTF-8\""), "{message}");
    let error = Format::detect(&folder.file("a.csv", b"")).unwrap_err();
    assert_eq!(
        (folder.message(&error).as_str(), error.exit_code()),
        ("reading the recording a.csv: line 1: found the end of the file, expected the header line", 3)
    );
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
