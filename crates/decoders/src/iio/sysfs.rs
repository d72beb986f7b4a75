//! The folder of a device in sysfs.
//!
//! Input: a folder such as `/sys/bus/iio/devices/iio:device0`, or one made like it. Output: the [`Layout`] of its records; with
//! [`prepare`] also a buffer that is switched on. Failure: an [`IioError`] that names the file.

use std::{
    fs::{self, File, OpenOptions},
    io::{Read, Write},
    path::{Path, PathBuf},
};

use super::{Channel, Clock, IioError, Layout, Vector};

/// Where devices are on a running system.
pub const ROOT: &str = "/sys/bus/iio/devices";

/// No file of a device is longer.
const FILE_MAX_BYTES: u64 = 4096;
/// Folders of a root that are looked into.
const DEVICES_MAX: usize = 1000;
/// The folder of channels since Linux 5.11, and before.
const FOLDERS: [&str; 2] = ["buffer0", "scan_elements"];
const NAMES: [&str; 3] = ["in_anglvel", "in_accel", "in_magn"];
const AXES: [&str; 3] = ["x", "y", "z"];
const TIMESTAMP: &str = "in_timestamp";
/// By how much the rows of a mounting matrix may differ from those of a rotation; drivers write few digits.
const ROTATION_TOLERANCE: f64 = 0.01;
const UNTURNED: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// The folder of the device that is called `name` in its file `name`, or whose folder is.
pub fn find(root: &Path, name: &str) -> Result<PathBuf, IioError> {
    let failed = |cause| IioError::Read { path: root.to_owned(), cause };
    let mut known = Vec::new();
    for entry in fs::read_dir(root).map_err(failed)?.take(DEVICES_MAX) {
        let folder = entry.map_err(failed)?.path();
        let Ok(called) = text(&folder.join("name")) else { continue };
        if called == name || folder.file_name().is_some_and(|folder| folder == name) {
            return Ok(folder);
        }
        known.push(called);
    }
    known.sort();
    Err(IioError::NoDevice { root: root.to_owned(), name: name.to_owned(), known })
}

/// Switches the channels of rate, force, field and time on, the time stamps to CLOCK_MONOTONIC, then the buffer, with room for
/// `records`; the sampling rate is set where one is given.
pub fn prepare(device: &Path, records: u32, rate_hz: Option<f64>) -> Result<Layout, IioError> {
    let buffer = device.join("buffer");
    let buffer = if buffer.is_dir() { buffer } else { device.join("buffer0") };
    write(&buffer.join("enable"), "0")?;
    // Not every driver can: what it has is read below.
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
    let vectors = NAMES.iter().flat_map(|name| AXES.map(|axis| format!("{name}_{axis}")));
    for name in vectors.chain([TIMESTAMP.to_owned()]) {
        let path = channels.join(format!("{name}_en"));
        if path.exists() {
            write(&path, "1")?;
        }
    }
    let layout = read(device)?;
    write(&buffer.join("length"), &records.to_string())?;
    write(&buffer.join("enable"), "1")?;
    Ok(layout)
}

/// The layout of the records of a device with those of its channels that are switched on.
pub fn read(device: &Path) -> Result<Layout, IioError> {
    let folder = channels_folder(device)?;
    let (channels, record_bytes) = channels(&folder)?;
    let find = |name: &str| channels.iter().find(|(other, _)| other == name).map(|(_, channel)| *channel);
    let vector = |name: &'static str| -> Result<Option<Vector>, IioError> {
        let [Some(x), Some(y), Some(z)] = AXES.map(|axis| find(&format!("{name}_{axis}"))) else { return Ok(None) };
        let mut vector = Vector { channels: [x, y, z], offset: [0.0; 3], scale: [1.0; 3], mount: mount(device, name)? };
        for (index, axis) in AXES.iter().enumerate() {
            let of = |what: &str| first_number(device, &[format!("{name}_{axis}_{what}"), format!("{name}_{what}")]);
            vector.offset[index] = of("offset")?.unwrap_or(0.0);
            vector.scale[index] = of("scale")?.unwrap_or(1.0);
        }
        Ok(Some(vector))
    };
    let [rate_name, force_name, field_name] = NAMES;
    let layout = Layout {
        record_bytes,
        rate: vector(rate_name)?,
        force: vector(force_name)?,
        field: vector(field_name)?,
        time: find(TIMESTAMP),
        clock: clock(device)?,
    };
    match layout {
        Layout { rate: None, force: None, .. } => Err(IioError::Missing { missing: "in_anglvel nor of in_accel" }),
        layout => Ok(layout),
    }
}

fn channels_folder(device: &Path) -> Result<PathBuf, IioError> {
    let has_channels = |folder: &PathBuf| {
        let entries = fs::read_dir(folder).into_iter().flatten().flatten();
        entries.take(DEVICES_MAX).any(|entry| entry.file_name().to_string_lossy().ends_with("_en"))
    };
    let found = FOLDERS.map(|name| device.join(name)).into_iter().find(has_channels);
    let none = || std::io::Error::new(std::io::ErrorKind::NotFound, "there are no channels of a buffer");
    found.ok_or_else(|| IioError::Read { path: device.join(FOLDERS[1]), cause: none() })
}

/// The channels that are switched on, by name, and the bytes of a record. Each is at a multiple of its own size, and so is a record at
/// one of its largest.
fn channels(folder: &Path) -> Result<(Vec<(String, Channel)>, usize), IioError> {
    let failed = |cause| IioError::Read { path: folder.to_owned(), cause };
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).map_err(failed)?.take(DEVICES_MAX) {
        let file = entry.map_err(failed)?.file_name();
        let Some(name) = file.to_str().and_then(|file| file.strip_suffix("_en")) else { continue };
        if text(&folder.join(&file))? != "1" {
            continue;
        }
        let path = folder.join(format!("{name}_index"));
        let said = text(&path)?;
        let index: u32 = said.parse().map_err(|_| malformed(&path, &said, "a whole number"))?;
        let path = folder.join(format!("{name}_type"));
        let said = text(&path)?;
        let (channel, size) = kind(&said).ok_or_else(|| malformed(&path, &said, "such as le:s16/16>>0"))?;
        found.push((index, size, name.to_owned(), channel));
    }
    found.sort_by_key(|(index, ..)| *index);
    let (mut at, mut largest) = (0usize, 1);
    let mut placed = Vec::with_capacity(found.len());
    for (_, size, name, channel) in found {
        at = at.next_multiple_of(size);
        placed.push((name, Channel { at, ..channel }));
        at += size;
        largest = largest.max(size);
    }
    Ok((placed, at.next_multiple_of(largest)))
}

/// `[be|le]:[s|u]BITS/STORED[XREPEAT]>>SHIFT`, and the bytes it takes with its repetitions.
fn kind(text: &str) -> Option<(Channel, usize)> {
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
    let is_sound = matches!(stored, 8 | 16 | 32 | 64) && bits >= 1 && (1..=64).contains(&repeat);
    if !is_sound || bits.checked_add(shift)? > stored {
        return None;
    }
    let bytes = usize::try_from(stored / 8).ok()?;
    Some((Channel { at: 0, bytes, bits, shift, is_signed, is_big_endian }, bytes * repeat))
}

fn clock(device: &Path) -> Result<Clock, IioError> {
    let path = device.join("current_timestamp_clock");
    // Drivers from before there was a choice.
    if !path.exists() {
        return Ok(Clock::Realtime);
    }
    let said = text(&path)?;
    match said.as_str() {
        "monotonic" | "monotonic_raw" | "monotonic_coarse" => Ok(Clock::Monotonic),
        "boottime" => Ok(Clock::Boottime),
        "realtime" | "realtime_coarse" | "tai" => Ok(Clock::Realtime),
        _ => Err(malformed(&path, &said, "monotonic, boottime, realtime or one of their kind")),
    }
}

/// `a, b, c; d, e, f; g, h, i`: of the quantity, else of the device, else none.
fn mount(device: &Path, name: &str) -> Result<[[f64; 3]; 3], IioError> {
    let files = [format!("{name}_mount_matrix"), "in_mount_matrix".to_owned(), "mount_matrix".to_owned()];
    let Some(path) = files.map(|file| device.join(file)).into_iter().find(|path| path.exists()) else {
        return Ok(UNTURNED);
    };
    let said = text(&path)?;
    let rows = three(said.split(';')).and_then(|rows| {
        let [a, b, c] = rows.map(|row| three(row.split(',').map(|number| number.trim().parse::<f64>().ok())));
        let whole = |row: Option<[Option<f64>; 3]>| row.and_then(|[x, y, z]| Some([x?, y?, z?]));
        Some([whole(a)?, whole(b)?, whole(c)?])
    });
    let rows = rows.filter(is_rotation);
    rows.ok_or_else(|| malformed(&path, &said, "a rotation: three rows of length 1, right-angled and right-handed"))
}

fn three<T>(mut parts: impl Iterator<Item = T>) -> Option<[T; 3]> {
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

/// Of the first file that is there.
fn first_number(device: &Path, names: &[String]) -> Result<Option<f64>, IioError> {
    let Some(path) = names.iter().map(|name| device.join(name)).find(|path| path.exists()) else { return Ok(None) };
    let said = text(&path)?;
    let number = said.parse().ok().filter(|number: &f64| number.is_finite());
    number.map(Some).ok_or_else(|| malformed(&path, &said, "a number"))
}

/// Without the blanks around.
fn text(path: &Path) -> Result<String, IioError> {
    let mut bytes = Vec::new();
    let read = File::open(path).and_then(|file| file.take(FILE_MAX_BYTES).read_to_end(&mut bytes));
    read.map_err(|cause| IioError::Read { path: path.to_owned(), cause })?;
    Ok(String::from_utf8_lossy(&bytes).trim().to_owned())
}

/// Into a file that is there: in a folder that is no device's, none is made.
fn write(path: &Path, found: &str) -> Result<(), IioError> {
    let file = OpenOptions::new().write(true).truncate(true).open(path);
    let written = file.and_then(|mut file| file.write_all(found.as_bytes()));
    written.map_err(|cause| IioError::Write { path: path.to_owned(), found: found.to_owned(), cause })
}

fn malformed(path: &Path, found: &str, expected: &'static str) -> IioError {
    IioError::Malformed { path: path.to_owned(), found: found.chars().take(40).collect(), expected }
}
