//! Access to the folder of a device in sysfs.
//!
//! Input: a folder such as `/sys/bus/iio/devices/iio:device0`, or one with the same structure.
//!
//! Output: the [`Layout`] of its records. [`prepare`] also enables the buffer.
//!
//! Failure: an [`IioError`] that names the file.

use std::{
    fs::{self, File, OpenOptions},
    io::{Read, Write},
    path::{Path, PathBuf},
};

use super::{Channel, Clock, IioError, Layout, Vector};

/// Maximum number of bytes read from a file.
const MAX_FILE_BYTES: u64 = 4096;
/// Maximum number of folder entries that are examined.
const MAX_ENTRIES: usize = 1000;
/// Channel folders. The first has existed since Linux 5.11; the second also exists in earlier
/// versions.
const CHANNEL_FOLDERS: [&str; 2] = ["buffer0", "scan_elements"];
const QUANTITIES: [&str; 3] = ["in_anglvel", "in_accel", "in_magn"];
const AXES: [&str; 3] = ["x", "y", "z"];
const TIMESTAMP: &str = "in_timestamp";
/// Maximum deviation of a mounting matrix from a rotation. It is large, because drivers print the
/// matrix with few digits.
const ROTATION_TOLERANCE: f64 = 0.01;
const IDENTITY: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// Returns the folder of the device with this name, which is the content of its file `name` or the
/// name of the folder itself.
///
/// # Errors
///
/// Returns an error if `root` cannot be read or contains no such device.
pub fn find(root: &Path, name: &str) -> Result<PathBuf, IioError> {
    let failed = |cause| IioError::Read { path: root.to_owned(), cause };
    let mut available = Vec::new();
    for entry in fs::read_dir(root).map_err(failed)?.take(MAX_ENTRIES) {
        let folder = entry.map_err(failed)?.path();
        let Ok(device_name) = read_text(&folder.join("name")) else { continue };
        if device_name == name || folder.file_name().is_some_and(|folder| folder == name) {
            return Ok(folder);
        }
        available.push(device_name);
    }
    available.sort();
    Err(IioError::NoDevice { root: root.to_owned(), name: name.to_owned(), available })
}

/// Configures a device and enables its buffer.
///
/// Enables the channels of rate, force, magnetic field and time, sets the timestamps to
/// CLOCK_MONOTONIC if possible, sets the sampling rate to `rate_hz` if given, and enables the
/// buffer with room for `buffer_records` records.
///
/// # Errors
///
/// Returns an error if a file cannot be read or written, or is malformed. The error names the file.
pub fn prepare(device: &Path, buffer_records: u32, rate_hz: Option<f64>) -> Result<Layout, IioError> {
    let buffer = device.join("buffer");
    let buffer = if buffer.is_dir() { buffer } else { device.join("buffer0") };
    write(&buffer.join("enable"), "0")?;
    // A driver may keep its previous clock, so the clock in effect is read back below.
    let clock = device.join("current_timestamp_clock");
    if clock.exists() {
        write(&clock, "monotonic")?;
    }
    if let Some(rate_hz) = rate_hz {
        let files = ["sampling_frequency", "in_anglvel_sampling_frequency", "in_accel_sampling_frequency"];
        let files: Vec<_> = files.map(|name| device.join(name)).into_iter().filter(|path| path.exists()).collect();
        let first = files.first().cloned().unwrap_or_else(|| device.join("sampling_frequency"));
        for path in files.iter().chain(files.is_empty().then_some(&first)) {
            write(path, &rate_hz.to_string())?;
        }
    }
    let channels = channels_folder(device)?;
    let vectors = QUANTITIES.iter().flat_map(|name| AXES.map(|axis| format!("{name}_{axis}")));
    for name in vectors.chain([TIMESTAMP.to_owned()]) {
        let path = channels.join(format!("{name}_en"));
        if path.exists() {
            write(&path, "1")?;
        }
    }
    let layout = read(device)?;
    write(&buffer.join("length"), &buffer_records.to_string())?;
    write(&buffer.join("enable"), "1")?;
    Ok(layout)
}

/// Returns the layout of a device's records, which contain the enabled channels.
///
/// # Errors
///
/// Returns an error that names the malformed file, or the missing channels if neither a rate nor a
/// force is enabled.
pub fn read(device: &Path) -> Result<Layout, IioError> {
    let folder = channels_folder(device)?;
    let (channels, record_bytes) = channels(&folder)?;
    let find = |name: &str| channels.iter().find(|(other, _)| other == name).map(|(_, channel)| *channel);
    let vector = |name: &'static str| -> Result<Option<Vector>, IioError> {
        let [Some(x), Some(y), Some(z)] = AXES.map(|axis| find(&format!("{name}_{axis}"))) else { return Ok(None) };
        let mut vector = Vector {
            channels: [x, y, z],
            offset: [0.0; 3],
            scale: [1.0; 3],
            mount_matrix: mount_matrix(device, name)?,
        };
        for (index, axis) in AXES.iter().enumerate() {
            let read_number =
                |what: &str| first_number(device, &[format!("{name}_{axis}_{what}"), format!("{name}_{what}")]);
            vector.offset[index] = read_number("offset")?.unwrap_or(0.0);
            vector.scale[index] = read_number("scale")?.unwrap_or(1.0);
        }
        Ok(Some(vector))
    };
    let [rate_name, force_name, field_name] = QUANTITIES;
    let layout = Layout {
        record_bytes,
        rate: vector(rate_name)?,
        force: vector(force_name)?,
        field: vector(field_name)?,
        time: find(TIMESTAMP),
        clock: clock(device)?,
    };
    match layout {
        Layout { rate: None, force: None, .. } => Err(IioError::MissingChannels { missing: "in_anglvel or in_accel" }),
        layout => Ok(layout),
    }
}

fn channels_folder(device: &Path) -> Result<PathBuf, IioError> {
    let has_channels = |folder: &PathBuf| {
        let entries = fs::read_dir(folder).into_iter().flatten().flatten();
        entries.take(MAX_ENTRIES).any(|entry| entry.file_name().to_string_lossy().ends_with("_en"))
    };
    let found = CHANNEL_FOLDERS.map(|name| device.join(name)).into_iter().find(has_channels);
    let not_found = || std::io::Error::new(std::io::ErrorKind::NotFound, "the device has no buffer channels");
    found.ok_or_else(|| IioError::Read { path: device.join(CHANNEL_FOLDERS[1]), cause: not_found() })
}

/// Returns the enabled channels with their names, and the size of a record in bytes.
///
/// Each channel is aligned to its own size. The record is aligned to the size of its largest
/// channel.
fn channels(folder: &Path) -> Result<(Vec<(String, Channel)>, usize), IioError> {
    let failed = |cause| IioError::Read { path: folder.to_owned(), cause };
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).map_err(failed)?.take(MAX_ENTRIES) {
        let file = entry.map_err(failed)?.file_name();
        let Some(name) = file.to_str().and_then(|file| file.strip_suffix("_en")) else { continue };
        if read_text(&folder.join(&file))? != "1" {
            continue;
        }
        let path = folder.join(format!("{name}_index"));
        let text = read_text(&path)?;
        let index: u32 = text.parse().map_err(|_| malformed(&path, &text, "a whole number"))?;
        let path = folder.join(format!("{name}_type"));
        let text = read_text(&path)?;
        let (channel, size) =
            parse_channel_type(&text).ok_or_else(|| malformed(&path, &text, "such as le:s16/16>>0"))?;
        found.push((index, size, name.to_owned(), channel));
    }
    found.sort_by_key(|(index, ..)| *index);
    let (mut byte_offset, mut largest) = (0usize, 1);
    let mut placed = Vec::with_capacity(found.len());
    for (_, size, name, channel) in found {
        byte_offset = byte_offset.next_multiple_of(size);
        placed.push((name, Channel { byte_offset, ..channel }));
        byte_offset += size;
        largest = largest.max(size);
    }
    Ok((placed, byte_offset.next_multiple_of(largest)))
}

/// Parses `[be|le]:[s|u]BITS/STORED[XREPEAT]>>SHIFT`. Returns the channel and its total size in
/// bytes, including repetitions.
fn parse_channel_type(text: &str) -> Option<(Channel, usize)> {
    let (order, rest) = text.split_once(':')?;
    let is_big_endian = match order {
        "be" => true,
        "le" => false,
        _ => return None,
    };
    let is_signed = match rest.chars().next()? {
        's' => true,
        'u' => false,
        _ => return None,
    };
    let (bits, rest) = rest.get(1..)?.split_once('/')?;
    let (stored, shift) = rest.split_once(">>").unwrap_or((rest, "0"));
    let (stored, repeat) = stored.split_once('X').unwrap_or((stored, "1"));
    let (bits, stored, shift): (u32, u32, u32) = (bits.parse().ok()?, stored.parse().ok()?, shift.parse().ok()?);
    let repeat: usize = repeat.parse().ok()?;
    let is_valid = matches!(stored, 8 | 16 | 32 | 64) && bits >= 1 && (1..=64).contains(&repeat);
    if !is_valid || bits.checked_add(shift)? > stored {
        return None;
    }
    let bytes = usize::try_from(stored / 8).ok()?;
    Some((Channel { byte_offset: 0, storage_bytes: bytes, bits, shift, is_signed, is_big_endian }, bytes * repeat))
}

fn clock(device: &Path) -> Result<Clock, IioError> {
    let path = device.join("current_timestamp_clock");
    // Older drivers lack this file and always use CLOCK_REALTIME.
    if !path.exists() {
        return Ok(Clock::Realtime);
    }
    let text = read_text(&path)?;
    match text.as_str() {
        "monotonic" | "monotonic_raw" | "monotonic_coarse" => Ok(Clock::Monotonic),
        "boottime" => Ok(Clock::Boottime),
        "realtime" | "realtime_coarse" | "tai" => Ok(Clock::Realtime),
        _ => Err(malformed(&path, &text, "monotonic, boottime, realtime or a variant of these")),
    }
}

/// Reads the mounting matrix, or returns the identity if the device has none.
///
/// The format is `a, b, c; d, e, f; g, h, i`. The matrix of the quantity has priority over that of
/// the device.
fn mount_matrix(device: &Path, name: &str) -> Result<[[f64; 3]; 3], IioError> {
    let files = [format!("{name}_mount_matrix"), "in_mount_matrix".to_owned(), "mount_matrix".to_owned()];
    let Some(path) = files.map(|file| device.join(file)).into_iter().find(|path| path.exists()) else {
        return Ok(IDENTITY);
    };
    let text = read_text(&path)?;
    let rows = exactly_three(text.split(';')).and_then(|rows| {
        let [a, b, c] = rows.map(|row| exactly_three(row.split(',').map(|number| number.trim().parse::<f64>().ok())));
        let all_valid = |row: Option<[Option<f64>; 3]>| row.and_then(|[x, y, z]| Some([x?, y?, z?]));
        Some([all_valid(a)?, all_valid(b)?, all_valid(c)?])
    });
    let rows = rows.filter(is_rotation);
    rows.ok_or_else(|| malformed(&path, &text, "a rotation: three rows of length 1, orthogonal and right-handed"))
}

fn exactly_three<T>(mut parts: impl Iterator<Item = T>) -> Option<[T; 3]> {
    let found = [parts.next()?, parts.next()?, parts.next()?];
    parts.next().is_none().then_some(found)
}

fn is_rotation(&[a, b, c]: &[[f64; 3]; 3]) -> bool {
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let cross = [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]];
    let is_near = |found: f64, expected: f64| (found - expected).abs() <= ROTATION_TOLERANCE;
    [dot(a, a), dot(b, b), dot(c, c), dot(a, cross)].into_iter().all(|found| is_near(found, 1.0))
        && [dot(a, b), dot(b, c), dot(c, a)].into_iter().all(|found| is_near(found, 0.0))
}

/// Reads the number from the first of the files `names` that exists. Returns `None` if none exists.
fn first_number(device: &Path, names: &[String]) -> Result<Option<f64>, IioError> {
    let Some(path) = names.iter().map(|name| device.join(name)).find(|path| path.exists()) else { return Ok(None) };
    let text = read_text(&path)?;
    let number = text.parse().ok().filter(|number: &f64| number.is_finite());
    number.map(Some).ok_or_else(|| malformed(&path, &text, "a number"))
}

/// Reads a file and removes surrounding white space.
fn read_text(path: &Path) -> Result<String, IioError> {
    let mut bytes = Vec::new();
    let read = File::open(path).and_then(|file| file.take(MAX_FILE_BYTES).read_to_end(&mut bytes));
    read.map_err(|cause| IioError::Read { path: path.to_owned(), cause })?;
    Ok(String::from_utf8_lossy(&bytes).trim().to_owned())
}

/// Writes an existing file. Files are never created, so a wrong folder is not modified.
fn write(path: &Path, value: &str) -> Result<(), IioError> {
    let file = OpenOptions::new().write(true).truncate(true).open(path);
    let written = file.and_then(|mut file| file.write_all(value.as_bytes()));
    written.map_err(|cause| IioError::Write { path: path.to_owned(), value: value.to_owned(), cause })
}

fn malformed(path: &Path, found: &str, expected: &'static str) -> IioError {
    IioError::Malformed { path: path.to_owned(), found: found.chars().take(40).collect(), expected }
}
