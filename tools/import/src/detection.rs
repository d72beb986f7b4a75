//! Detection of a file's format by its content. The file name is ignored.

use std::{
    fs::{self, File},
    io::{self, Read},
    path::Path,
};

use flate2::read::MultiGzDecoder;
use recording::Reader;

use crate::{
    error::{ImportError, open_error},
    format::Format,
};

/// Number of bytes inspected at the start of a file. In a gzip file, the same number of bytes is
/// also inspected after decompression.
const PREFIX_BYTES: u64 = 4096;

const GZIP_MAGIC: &[u8] = b"\x1f\x8b";
/// First bytes of a DataFlash log, which starts with the FMT message that describes FMT messages.
const ARDUPILOT_MAGIC: &[u8] = &[0xa3, 0x95, 0x80];
const MAGIC_NUMBERS: [(&[u8], Format); 5] = [
    (b"ULog\x01\x12\x35", Format::Ulog),
    (b"\x89MCAP0\r\n", Format::Mcap),
    (ARDUPILOT_MAGIC, Format::ArduPilot),
    (b"SQLite format 3\0", Format::Sqlite),
    (b"PK\x03\x04", Format::Zip),
];

/// File present in every ROS 2 bag folder. It contains [`BAG_METADATA_KEY`].
const BAG_METADATA_FILE: &str = "metadata.yaml";
const BAG_METADATA_KEY: &[u8] = b"rosbag2_bagfile_information";

impl Format {
    /// Detects the format of the file or folder at `path`.
    ///
    /// # Errors
    ///
    /// Returns [`ImportError::Open`] if the file cannot be read or is a pipe or a device, and
    /// [`ImportError::UnknownFormat`] if no format matches.
    pub fn detect(path: &Path) -> Result<Self, ImportError> {
        let failed = |cause| open_error(path, cause);
        // The file type is checked before opening, because opening a pipe blocks until it has a
        // writer.
        let file_type = fs::metadata(path).map_err(failed)?.file_type();
        if file_type.is_dir() && is_bag(path) {
            return Ok(Self::Bag);
        }
        if !file_type.is_file() && !file_type.is_dir() {
            return Err(failed(io::Error::new(io::ErrorKind::NotSeekable, "pipes and devices cannot be read twice")));
        }
        let mut file = File::open(path).map_err(failed)?;
        let start = read_prefix(&mut file).map_err(failed)?;
        let found = if start.starts_with(GZIP_MAGIC) {
            let rest = io::Cursor::new(start).chain(file);
            // Only the prefix is decompressed here. Damage after the prefix is reported by the
            // reader.
            match self::read_prefix(&mut MultiGzDecoder::new(rest)) {
                Ok(start) if is_text(&start) => Some(Self::Csv),
                _ => Some(Self::Gzip),
            }
        } else {
            let magic = MAGIC_NUMBERS.iter().find(|(magic, _)| start.starts_with(magic)).map(|&(_, format)| format);
            magic.or(is_text(&start).then_some(Self::Csv))
        };
        match found {
            Some(Self::Csv) if Reader::open(path).is_ok() => Ok(Self::Recording),
            Some(format) => Ok(format),
            None => Err(ImportError::UnknownFormat { path: path.to_owned() }),
        }
    }

    /// Returns the remedy for a format that is not supported; `None` for a supported format.
    pub fn remedy(self) -> Option<&'static str> {
        match self {
            Self::Csv | Self::Ulog | Self::Mcap | Self::Bag | Self::Sqlite | Self::ArduPilot => None,
            Self::Recording => Some("no import is needed; to change its axes or units, map its columns with --map"),
            Self::Zip => Some("unpack it and import the files in it"),
            Self::Gzip => Some("unpack it (gunzip) and import the file in it"),
        }
    }
}

/// Returns `true` if the folder contains the metadata of a ROS 2 bag.
fn is_bag(folder: &Path) -> bool {
    let has_metadata = fs::metadata(folder.join(BAG_METADATA_FILE)).is_ok_and(|found| found.is_file());
    let start = || read_prefix(&mut File::open(folder.join(BAG_METADATA_FILE))?);
    has_metadata
        && start().is_ok_and(|start| start.windows(BAG_METADATA_KEY.len()).any(|part| part == BAG_METADATA_KEY))
}

fn read_prefix(file: &mut impl Read) -> io::Result<Vec<u8>> {
    let mut start = Vec::new();
    file.take(PREFIX_BYTES).read_to_end(&mut start)?;
    Ok(start)
}

/// Returns `true` for non-empty text in an 8-bit encoding. UTF-16 is not text.
fn is_text(start: &[u8]) -> bool {
    let is_readable = |&byte: &u8| byte >= b' ' || matches!(byte, b'\t' | b'\r' | b'\n' | 0x0c);
    !start.is_empty() && !start.starts_with(b"\xff\xfe") && start.iter().all(is_readable)
}
