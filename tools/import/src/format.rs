//! What a file is, by its content and never by its name.

use std::{
    fmt,
    fs::{self, File},
    io::{self, Read},
    path::Path,
};

use flate2::read::MultiGzDecoder;
use recording::Reader;

use crate::{ImportError, error::opening};

/// As much of a file, and of what a gzip file holds, as is looked at.
const START_BYTES: u64 = 4096;

const GZIP: &[u8] = b"\x1f\x8b";
/// The first message of a DataFlash log is the format of formats.
const ARDUPILOT: &[u8] = &[0xa3, 0x95, 0x80];
const STARTS: [(&[u8], Format); 5] = [
    (b"ULog\x01\x12\x35", Format::Ulog),
    (b"\x89MCAP0\r\n", Format::Mcap),
    (ARDUPILOT, Format::ArduPilot),
    (b"SQLite format 3\0", Format::Sqlite),
    (b"PK\x03\x04", Format::Zip),
];

/// What every bag of ROS 2 has in its folder, and what stands in that.
const BAG: &str = "metadata.yaml";
const BAG_KEY: &[u8] = b"rosbag2_bagfile_information";

/// What a file is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Format {
    /// A recording of ours, plain or gzip.
    Recording,
    /// Other text with columns, plain or gzip.
    Csv,
    /// A log of PX4.
    Ulog,
    /// Messages of topics in one file: a flight of this system, or a log of ROS 2.
    Mcap,
    /// A folder of ROS 2 with the files of a bag.
    Bag,
    /// A DataFlash log of ArduPilot.
    ArduPilot,
    /// A database, as the file of a ROS 2 bag.
    Sqlite,
    /// An archive of files.
    Zip,
    /// gzip of something that is no text.
    Gzip,
}

impl Format {
    /// What the file at `path` is. Fails where it cannot be opened or is none of these.
    pub fn of(path: &Path) -> Result<Self, ImportError> {
        let failed = |cause| opening(path, cause);
        // Before it is opened: to open a pipe is to wait for its writer.
        let kind = fs::metadata(path).map_err(failed)?.file_type();
        if kind.is_dir() && is_bag(path) {
            return Ok(Self::Bag);
        }
        if !kind.is_file() && !kind.is_dir() {
            return Err(failed(io::Error::new(
                io::ErrorKind::NotSeekable,
                "it is a pipe or a device, and is read twice",
            )));
        }
        let mut file = File::open(path).map_err(failed)?;
        let start = start(&mut file).map_err(failed)?;
        let found = if start.starts_with(GZIP) {
            let rest = io::Cursor::new(start).chain(file);
            // What is damaged further on is found where it is read.
            match self::start(&mut MultiGzDecoder::new(rest)) {
                Ok(start) if is_text(&start) => Some(Self::Csv),
                _ => Some(Self::Gzip),
            }
        } else {
            let magic = STARTS.iter().find(|(magic, _)| start.starts_with(magic)).map(|&(_, format)| format);
            magic.or(is_text(&start).then_some(Self::Csv))
        };
        match found {
            Some(Self::Csv) if Reader::open(path).is_ok() => Ok(Self::Recording),
            Some(format) => Ok(format),
            None => Err(ImportError::Unknown { path: path.to_owned() }),
        }
    }

    /// Whether it is made of topics, of which some can be chosen.
    pub fn has_topics(self) -> bool {
        matches!(self, Self::Mcap | Self::Bag | Self::Sqlite)
    }

    /// What to do about a format that is not read; `None` of one that is.
    pub fn remedy(self) -> Option<&'static str> {
        match self {
            Self::Csv | Self::Ulog | Self::Mcap | Self::Bag | Self::Sqlite | Self::ArduPilot => None,
            Self::Recording => {
                Some("there is nothing to import; name its columns with --map to change its axes or units")
            }
            Self::Zip => Some("unpack it and name the files in it"),
            Self::Gzip => Some("unpack it (gunzip) and name the file in it"),
        }
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Recording => "a recording of this system",
            Self::Csv => "CSV",
            Self::Ulog => "ULog",
            Self::Mcap => "MCAP",
            Self::ArduPilot => "an ArduPilot log (BIN)",
            Self::Bag => "a ROS 2 bag",
            Self::Sqlite => "an SQLite database, as of a ROS 2 bag (db3)",
            Self::Zip => "a zip archive",
            Self::Gzip => "gzip of something that is no text",
        })
    }
}

/// A folder with what ROS 2 says of its bag.
fn is_bag(folder: &Path) -> bool {
    let is_there = fs::metadata(folder.join(BAG)).is_ok_and(|found| found.is_file());
    let start = || start(&mut File::open(folder.join(BAG))?);
    is_there && start().is_ok_and(|start| start.windows(BAG_KEY.len()).any(|part| part == BAG_KEY))
}

fn start(file: &mut impl Read) -> io::Result<Vec<u8>> {
    let mut start = Vec::new();
    file.take(START_BYTES).read_to_end(&mut start)?;
    Ok(start)
}

/// Bytes that people can read, in whatever code of eight bits; an empty file is none.
fn is_text(start: &[u8]) -> bool {
    let is_readable = |&byte: &u8| byte >= b' ' || matches!(byte, b'\t' | b'\r' | b'\n' | 0x0c);
    !start.is_empty() && !start.starts_with(b"\xff\xfe") && start.iter().all(is_readable)
}
