//! Detection of a file's format by its content. The file name is ignored.

use std::{
    fs::{self, File},
    io::{self, Read},
    path::Path,
};

use recording::{Reader, Unpacked};

use crate::{
    error::{ImportError, open_error},
    format::Format,
};

/// Number of bytes inspected at the start of a file. Of a gzip or zstd file, the same number of
/// decompressed bytes is inspected as well.
const PREFIX_BYTES: u64 = 4096;

/// First bytes of a DataFlash log, which starts with the FMT message that describes FMT messages.
const ARDUPILOT_MAGIC: &[u8] = &[0xa3, 0x95, 0x80];
const MAGIC_NUMBERS: [(&[u8], Format); 20] = [
    (b"ULog\x01\x12\x35", Format::Ulog),
    (b"\x89MCAP0\r\n", Format::Mcap),
    (ARDUPILOT_MAGIC, Format::ArduPilot),
    (b"SQLite format 3\0", Format::Sqlite),
    (b"#ROSBAG V", Format::Ros1Bag),
    (b"PAR1", Format::Parquet),
    (b"\x89HDF\r\n", Format::Hdf5),
    (b"MATLAB 5.0 MAT-file", Format::Matlab),
    (b"\x93NUMPY", Format::Numpy),
    (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", Format::Spreadsheet),
    (b"PK\x03\x04", Format::Zip),
    (b"7z\xbc\xaf\x27\x1c", Format::SevenZip),
    (b"Rar!\x1a\x07", Format::Rar),
    (b"\x1f\x8b", Format::Gzip),
    (b"\x28\xb5\x2f\xfd", Format::Zstd),
    (b"\xfd7zXZ\0", Format::Xz),
    (b"BZh", Format::Bzip2),
    (b"\x04\x22\x4d\x18", Format::Lz4),
    (b"\xb5\x62", Format::Receiver),
    (b"\xfa\xff", Format::Xsens),
];
/// Names of the first files in the zip archive of an Excel or LibreOffice spreadsheet.
const SPREADSHEET_ENTRIES: [&[u8]; 4] =
    [b"[Content_Types].xml", b"xl/", b"_rels/.rels", b"mimetypeapplication/vnd.oasis.opendocument.spreadsheet"];
/// Offset and bytes of the tar signature.
const TAR_MAGIC: (usize, &[u8]) = (257, b"ustar");
/// Signature of a Betaflight log. It may follow bytes from erased flash memory.
const BLACKBOX_MARK: &[u8] = b"H Product:Blackbox";
/// Start of a format definition in the text form of an ArduPilot log.
const ARDUPILOT_TEXT_FORMAT: &[u8] = b"FMT";
/// Byte order marks. The mark of UTF-32 begins with that of UTF-16 and is therefore listed first.
const BYTE_ORDER_MARKS: [(&[u8], Format); 4] = [
    (b"\xff\xfe\0\0", Format::Utf32),
    (b"\0\0\xfe\xff", Format::Utf32),
    (b"\xff\xfe", Format::Utf16Le),
    (b"\xfe\xff", Format::Utf16Be),
];
/// First bytes of MAVLink messages, versions 1 and 2.
const MAVLINK_MAGIC: [u8; 2] = [0xfe, 0xfd];
const WITMOTION_FRAME_BYTES: usize = 11;
/// Length of the arrival time before each message in a telemetry log, bytes.
const TLOG_STAMP_BYTES: usize = 8;
/// Plausible arrival times, µs since 1970: 2001 to 2100.
const TLOG_TIMES_US: std::ops::Range<u64> = 1_000_000_000_000_000..4_102_444_800_000_000;

/// File present in every ROS 2 bag folder. It contains [`BAG_METADATA_KEY`].
const BAG_METADATA_FILE: &str = "metadata.yaml";
/// Maximum number of entries of a folder that are inspected.
const MAX_ENTRIES: usize = 10_000;
const BAG_METADATA_KEY: &[u8] = b"rosbag2_bagfile_information";

impl Format {
    /// Detects the format of the file or folder at `path`.
    ///
    /// # Errors
    ///
    /// Returns [`ImportError::Open`] if the file cannot be read or is a pipe or a device,
    /// [`ImportError::Recording`] if it is empty, and [`ImportError::UnknownFormat`] if no format
    /// matches.
    pub fn detect(path: &Path) -> Result<Self, ImportError> {
        let failed = |cause| open_error(path, cause);
        // The file type is checked before opening, because opening a pipe blocks until it has a
        // writer.
        let file_type = fs::metadata(path).map_err(failed)?.file_type();
        if file_type.is_dir() && is_bag(path) {
            return Ok(Self::Bag);
        }
        if file_type.is_dir() && has_bag_files(path) {
            return Ok(Self::BagWithoutMetadata);
        }
        if !file_type.is_file() && !file_type.is_dir() {
            return Err(failed(io::Error::new(io::ErrorKind::NotSeekable, "pipes and devices cannot be read twice")));
        }
        let mut file = File::open(path).map_err(failed)?;
        let start = read_prefix(&mut file).map_err(failed)?;
        if let (true, Err(error)) = (start.is_empty(), Reader::open(path)) {
            return Err(error.into());
        }
        // Only the prefix is decompressed here. Damage after the prefix is reported by the reader.
        let mut unpack = || read_prefix(&mut Unpacked::new(start.chain(&mut file))?);
        let found = match detect_by_start(&start) {
            Some(Self::Gzip | Self::Zstd) if unpack().is_ok_and(|text| is_text(&text)) => Some(Self::Csv),
            found => found,
        };
        match found {
            Some(Self::Csv) if Reader::open(path).is_ok() => Ok(Self::Recording),
            Some(format) => Ok(format),
            None => Err(ImportError::UnknownFormat { path: path.to_owned() }),
        }
    }
}

/// Detects the format of an uncompressed file by its first bytes.
fn detect_by_start(start: &[u8]) -> Option<Format> {
    let contains = |part: &[u8]| start.windows(part.len()).any(|window| window == part);
    let magic = MAGIC_NUMBERS.iter().find(|(magic, _)| start.starts_with(magic)).map(|&(_, format)| format);
    let (tar_offset, tar_magic) = TAR_MAGIC;
    match magic {
        Some(Format::Zip) if SPREADSHEET_ENTRIES.iter().any(|entry| contains(entry)) => Some(Format::Spreadsheet),
        Some(format) => Some(format),
        None if start.get(tar_offset..).is_some_and(|rest| rest.starts_with(tar_magic)) => Some(Format::Tar),
        None if wide_text(start).is_some() => wide_text(start),
        None if is_tlog(start) => Some(Format::Tlog),
        None if is_witmotion(start) => Some(Format::WitMotion),
        None if is_nmea(start) => Some(Format::Receiver),
        None if contains(BLACKBOX_MARK) => Some(Format::Blackbox),
        None if start.split(|byte| *byte == b'\n').any(is_ardupilot_format) => Some(Format::ArduPilotText),
        None if is_json(start) => Some(Format::Json),
        None => is_text(start).then_some(Format::Csv),
    }
}

/// Returns `true` for a line such as `FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns`.
fn is_ardupilot_format(line: &[u8]) -> bool {
    let mut fields = line.split(|byte| *byte == b',').map(<[u8]>::trim_ascii);
    let mut is_next =
        |test: fn(&u8) -> bool| fields.next().is_some_and(|field| !field.is_empty() && field.iter().all(test));
    let is_name = |byte: &u8| byte.is_ascii_uppercase() || byte.is_ascii_digit();
    line.trim_ascii_start().starts_with(ARDUPILOT_TEXT_FORMAT)
        && is_next(u8::is_ascii_uppercase)
        && is_next(u8::is_ascii_digit)
        && is_next(u8::is_ascii_digit)
        && is_next(is_name)
        && is_next(u8::is_ascii_alphabetic)
}

/// Returns `true` for a JSON object or array.
fn is_json(start: &[u8]) -> bool {
    let text = start.trim_ascii_start();
    let inner = text.get(1..).map(<[u8]>::trim_ascii_start).and_then(<[u8]>::first);
    match text.first() {
        Some(b'{') => inner == Some(&b'"'),
        Some(b'[') => matches!(inner, Some(b'{' | b'[')),
        _ => false,
    }
}

/// Returns the encoding of text in UTF-16 or UTF-32. In UTF-16 without a byte order mark, every
/// other byte is zero.
fn wide_text(start: &[u8]) -> Option<Format> {
    if let Some((_, format)) = BYTE_ORDER_MARKS.iter().find(|(mark, _)| start.starts_with(mark)) {
        return Some(*format);
    }
    let zeros = |parity: usize| start.iter().skip(parity).step_by(2).filter(|byte| **byte == 0).count();
    let half = start.len() / 2;
    match [zeros(0), zeros(1)] {
        _ if half < 8 => None,
        [0, odd] if odd == half => Some(Format::Utf16Le),
        [even, 0] if even == half => Some(Format::Utf16Be),
        _ => None,
    }
}

/// Returns `true` if the first two frames of a WitMotion sensor have valid checksums.
fn is_witmotion(start: &[u8]) -> bool {
    let is_frame = |frame: &[u8]| match frame {
        [covered @ .., sum] => {
            covered.starts_with(b"\x55") && covered.iter().fold(0u8, |sum, byte| sum.wrapping_add(*byte)) == *sum
        }
        [] => false,
    };
    let mut frames = start.chunks_exact(WITMOTION_FRAME_BYTES).take(2);
    frames.len() == 2 && frames.all(is_frame)
}

/// Returns `true` for NMEA 0183 sentences.
fn is_nmea(start: &[u8]) -> bool {
    let sentence = start.split(|byte| *byte == b'\n').next().unwrap_or_default().trim_ascii();
    let is_name = |name: &[u8]| name.len() == 5 && name.iter().all(u8::is_ascii_uppercase);
    sentence.strip_prefix(b"$").is_some_and(|rest| rest.get(..5).is_some_and(is_name) && rest.get(5) == Some(&b','))
}

/// Returns `true` if an arrival time is followed by the start of a MAVLink message.
fn is_tlog(start: &[u8]) -> bool {
    let stamp = start.first_chunk().map(|stamp| u64::from_be_bytes(*stamp));
    let has_magic = start.get(TLOG_STAMP_BYTES).is_some_and(|byte| MAVLINK_MAGIC.contains(byte));
    has_magic && stamp.is_some_and(|stamp| TLOG_TIMES_US.contains(&stamp))
}

/// Returns `true` if the folder contains a file of a ROS 2 bag.
fn has_bag_files(folder: &Path) -> bool {
    let is_bag_file = |path: &Path| path.extension().is_some_and(|end| end == "mcap" || end == "db3");
    let mut entries = fs::read_dir(folder).into_iter().flatten().take(MAX_ENTRIES).flatten();
    entries.any(|entry| is_bag_file(&entry.path()))
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

/// Returns `true` for text in an 8-bit encoding. Rows may be damaged, so only the first two lines
/// must be text.
fn is_text(start: &[u8]) -> bool {
    let is_readable = |byte: &u8| *byte >= b' ' || matches!(byte, b'\t' | b'\r' | b'\n' | 0x0c);
    let mut lines = start.split(|byte| *byte == b'\n').take(2);
    !start.is_empty() && lines.all(|line| line.iter().all(is_readable))
}
