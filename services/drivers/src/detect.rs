//! Recognition of the device on a serial port.
//!
//! Input: the bytes of a serial port at the usual baud rates.
//!
//! Output: format, baud rate, measured rate, axes and units, or the reason why they are unknown.
//!
//! Time: at most [`MAX_PORT_TIME`] per port.
//!
//! Failure: a port that cannot be opened or sends nothing is a finding, not an error.

use std::{
    fs, io,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use decoders::{Decoder, DeviceTime, Measurement, Value};
use launch::{Format, Port, ReceiverFormat, SerialLine};

use crate::{
    format,
    port::{OpenPort, PortRead, StdinDescriptor},
    reconnecting_port::remedy,
};

/// Baud rates in the order in which they are tried, the usual ones first.
const BAUD_RATES: [u64; 7] = [115_200, 9_600, 921_600, 460_800, 57_600, 230_400, 38_400];
/// Time for which a port is read at one baud rate. It includes at least one message of a receiver,
/// because receivers send at least once per second.
const LISTENING_TIME: Duration = Duration::from_millis(1_500);
/// Maximum time spent on one port.
pub const MAX_PORT_TIME: Duration = Duration::from_millis(1_500 * BAUD_RATES.len() as u64 + 500);
/// Timeout of each read within the listening time.
const READ_TIMEOUT: Duration = Duration::from_millis(20);
/// Maximum number of bytes that are kept per baud rate.
const MAX_BYTES: usize = 1 << 20;
/// Minimum number of measurements for recognising a format. Even in a format without a checksum,
/// bytes of another format do not happen to form this many valid messages.
const MIN_MEASUREMENTS: usize = 5;
/// Minimum number of messages for recognising a receiver. One is enough, because its messages have
/// checksums.
const MIN_RECEIVER_MESSAGES: u64 = 1;
/// Maximum share of bytes that belong to no message. The limit does not apply to devices that also
/// send other messages.
const MAX_SKIPPED_SHARE: f64 = 0.2;
/// Standard gravity, m/s².
const GRAVITY_M_S2: f64 = 9.806_65;
/// Maximum relative deviation of the specific force at rest from gravity.
const GRAVITY_TOLERANCE: f64 = 0.2;
/// Usual sample rates, Hz.
const USUAL_RATES_HZ: [f64; 17] =
    [1.0, 2.0, 4.0, 5.0, 10.0, 20.0, 25.0, 40.0, 50.0, 100.0, 200.0, 250.0, 400.0, 500.0, 800.0, 1000.0, 2000.0];
/// Maximum relative deviation of a measured rate from a usual rate.
const RATE_TOLERANCE: f64 = 0.05;

/// Port and the result of listening to it.
#[derive(Debug, Clone, PartialEq)]
pub struct PortFinding {
    /// Path of the device file, in `/dev/serial/by-id` if the device is listed there.
    pub path: PathBuf,
    /// Result of listening to the port.
    pub finding: Finding,
}

/// Result of listening to a serial port.
#[derive(Debug, Clone, PartialEq)]
pub enum Finding {
    /// Sensor or receiver in a known format.
    Device(DetectedDevice),
    /// Lines of text without known columns.
    Text {
        /// One of the lines.
        line: String,
        /// Baud rate, bit/s.
        baud: u64,
    },
    /// Bytes in no known format.
    Unknown {
        /// Number of bytes received at the first baud rate.
        bytes: usize,
    },
    /// The port sent no bytes.
    Silent,
    /// The port cannot be read.
    Failed {
        /// Operating system error.
        cause: String,
        /// Suggested action.
        remedy: &'static str,
    },
}

/// Device in a known format.
#[derive(Debug, Clone, PartialEq)]
pub struct DetectedDevice {
    /// Name of the format in a launch file.
    pub format: &'static str,
    /// Baud rate, bit/s.
    pub baud: u64,
    /// Measured sample rate, Hz. `None` if there were too few measurements.
    pub rate_hz: Option<f64>,
    /// Sensors that the received measurements come from.
    pub sensors: Vec<&'static str>,
    /// Sensor axis that points up, such as "+z". `None` unless the specific force is about 1 g and
    /// mostly along one axis.
    pub up_axis: Option<&'static str>,
    /// Value for the option that selects the source or receiver on the command line.
    pub line: String,
    /// `true` for a satellite receiver.
    pub is_receiver: bool,
    /// Assumptions that the user should check.
    pub notes: Vec<String>,
}

/// Returns the serial ports of this machine, by their paths in `/dev/serial/by-id` if listed there.
///
/// Built-in ports named `ttyS` are omitted, because most of them are not connected.
pub fn serial_ports() -> Vec<PathBuf> {
    let names = |folder: &str| -> Vec<PathBuf> {
        let entries = fs::read_dir(folder).into_iter().flatten();
        entries.filter_map(|entry| Some(entry.ok()?.path())).collect()
    };
    let links: Vec<_> =
        names("/dev/serial/by-id").into_iter().filter_map(|link| Some((fs::canonicalize(&link).ok()?, link))).collect();
    let is_serial = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        ["ttyUSB", "ttyACM", "ttyAMA", "ttyTHS"].iter().any(|driver| name.starts_with(driver))
    };
    let mut ports: Vec<_> = names("/dev").into_iter().filter(is_serial).collect();
    ports.sort();
    let stable =
        |port: PathBuf| links.iter().find(|(target, _)| *target == port).map_or(port, |(_, link)| link.clone());
    ports.into_iter().map(stable).collect()
}

/// Listens to a port at the usual baud rates until a format is recognised.
pub fn detect(path: &Path) -> PortFinding {
    let finding = listen_at_all_rates(path);
    PortFinding { path: path.into(), finding }
}

fn listen_at_all_rates(path: &Path) -> Finding {
    let mut fallback = None;
    for baud in BAUD_RATES {
        let port = Port::Serial { path: path.into(), line: SerialLine { baud } };
        let chunks = match listen(&port) {
            Ok(chunks) => chunks,
            Err(error) => return Finding::Failed { cause: error.to_string(), remedy: remedy(&port, &error) },
        };
        let bytes: usize = chunks.iter().map(|(_, bytes)| bytes.len()).sum();
        if bytes == 0 {
            // A device that sends anything yields bytes at any baud rate, so no other baud rate is
            // tried.
            return fallback.unwrap_or(Finding::Silent);
        }
        if let Some(device) = recognise(path, baud, &chunks) {
            return Finding::Device(device);
        }
        let found = text_line(&chunks).map(|line| Finding::Text { line, baud });
        if found.is_some() && !matches!(fallback, Some(Finding::Text { .. })) {
            fallback = found;
        }
        fallback.get_or_insert(Finding::Unknown { bytes });
    }
    fallback.unwrap_or(Finding::Silent)
}

/// Bytes with the time of their arrival.
type Chunk = (Duration, Vec<u8>);

fn listen(port: &Port) -> io::Result<Vec<Chunk>> {
    let mut open = OpenPort::open(port, StdinDescriptor::Own)?;
    let (start, mut buffer) = (Instant::now(), [0; 4096]);
    let (mut chunks, mut total) = (Vec::new(), 0);
    while start.elapsed() < LISTENING_TIME && total < MAX_BYTES {
        match open.read(&mut buffer, READ_TIMEOUT)? {
            PortRead::Bytes { count, .. } => {
                total += count;
                chunks.push((start.elapsed(), buffer.get(..count).unwrap_or_default().to_vec()));
            }
            PortRead::NoData => {}
            PortRead::End => break,
        }
    }
    Ok(chunks)
}

/// Format to try.
struct Candidate {
    name: &'static str,
    decoder: Box<dyn Decoder>,
    is_receiver: bool,
    /// `true` if the stream normally contains other messages too. Their bytes count as skipped.
    is_shared: bool,
}

fn candidates() -> Vec<Candidate> {
    let formats = [
        Format::WitMotion(launch::WitMotion::default()),
        Format::Xsens(launch::Xsens { field_unit_ut: 0.0 }),
        Format::Rvc,
        Format::Mavlink(launch::Autopilot::default()),
        Format::Csv(launch::Columns::default()),
        Format::Protobuf,
    ];
    let sensors = formats.iter().filter_map(|format| {
        let is_shared = matches!(format, Format::Mavlink(_));
        let decoder = format::decoder(format).ok()?;
        Some(Candidate { name: format.name(), decoder, is_receiver: false, is_shared })
    });
    let receivers = [ReceiverFormat::Ubx, ReceiverFormat::Nmea].map(|format| Candidate {
        name: format.name(),
        decoder: format::receiver_decoder(format),
        is_receiver: true,
        is_shared: true,
    });
    sensors.chain(receivers).collect()
}

/// Returns the device, in the format that fits most of the bytes, or `None` if no format fits.
fn recognise(path: &Path, baud: u64, chunks: &[Chunk]) -> Option<DetectedDevice> {
    let total: usize = chunks.iter().map(|(_, bytes)| bytes.len()).sum();
    let results = candidates().into_iter().filter_map(|candidate| {
        let Candidate { name, decoder, is_receiver, is_shared } = candidate;
        let starts_with_line = name == "csv";
        let (measurements, skipped, frames) = decode(decoder, chunks, starts_with_line);
        let share = skipped as f64 / total as f64;
        let required = measurements.iter().filter(|(_, found)| matches!(found.value, Value::Imu { .. })).count();
        let is_found = if is_receiver { frames >= MIN_RECEIVER_MESSAGES } else { required >= MIN_MEASUREMENTS };
        let is_plausible = is_shared || share <= MAX_SKIPPED_SHARE;
        (is_found && is_plausible).then_some((share, name, is_receiver, measurements))
    });
    // The share of skipped bytes can be large, because an autopilot or receiver also sends other
    // messages. It is therefore only used to select among the formats found.
    let (_, name, is_receiver, measurements) = results.min_by(|a, b| a.0.total_cmp(&b.0))?;
    Some(describe(path, baud, name, is_receiver, &measurements))
}

/// Decodes bytes. Returns the measurements with their arrival times, the number of bytes that
/// belong to no message, and the number of messages.
fn decode(
    mut decoder: Box<dyn Decoder>,
    chunks: &[Chunk],
    skips_line: bool,
) -> (Vec<(Duration, Measurement)>, u64, u64) {
    let (mut timed, mut found, mut is_line_start) = (Vec::new(), Vec::new(), !skips_line);
    for (arrival, bytes) in chunks {
        let mut bytes = &bytes[..];
        if !is_line_start {
            let Some(end) = bytes.iter().position(|byte| *byte == b'\n') else { continue };
            (bytes, is_line_start) = (bytes.get(end + 1..).unwrap_or_default(), true);
        }
        decoder.set_time(*arrival);
        decoder.push(bytes, &mut found);
        timed.extend(found.drain(..).map(|measurement| (*arrival, measurement)));
    }
    let counts = decoder.counts();
    (timed, counts.skipped_bytes, counts.frames)
}

fn describe(
    path: &Path,
    baud: u64,
    format: &'static str,
    is_receiver: bool,
    measurements: &[(Duration, Measurement)],
) -> DetectedDevice {
    let of_kind = |(_, found): &&(Duration, Measurement)| match found.value {
        Value::Imu { .. } => !is_receiver,
        Value::Fix { .. } => is_receiver,
        Value::Field(_) => false,
    };
    let required: Vec<_> = measurements.iter().filter(of_kind).collect();
    let rate_hz = rate_hz(&required);
    let path = path.to_string_lossy();
    let has = |test: fn(&Value) -> bool| measurements.iter().any(|(_, found)| test(&found.value));
    let mut sensors = Vec::new();
    if has(|value| matches!(value, Value::Imu { .. })) {
        sensors.extend(["gyro", "accelerometer"]);
    }
    if has(|value| matches!(value, Value::Field(_) | Value::Imu { field_ut: Some(_), .. })) {
        sensors.push("magnetometer");
    }
    if is_receiver || has(|value| matches!(value, Value::Fix { .. })) {
        sensors.push("satellite receiver");
    }
    let mut keys = vec![format!("format={format}")];
    if baud != SerialLine::default().baud || format == "rvc" {
        keys.push(format!("baud={baud}"));
    }
    let (mut notes, mut force) = (Vec::new(), mean_force(&required));
    if format == "csv" {
        let units = Units::guess(&required, force.map(norm));
        if let Some(units) = units {
            keys.push(units.keys(has(|value| matches!(value, Value::Imu { field_ut: Some(_), .. }))));
            notes.push(units.note());
            force = force.map(|force| force.map(|part| part * units.force_m_s2));
        }
    }
    if !is_receiver && let Some(rate_hz) = rate_hz {
        keys.push(format!("rate_hz={}", usual_rate_hz(rate_hz)));
    }
    let (kind, prefix) = if format == "mavlink" { ("mavlink:serial", 1) } else { ("serial", 0) };
    let keys = keys.get(prefix..).unwrap_or_default().join("&");
    let line = if keys.is_empty() { format!("{kind}:{path}") } else { format!("{kind}:{path}?{keys}") };
    DetectedDevice { format, baud, rate_hz, sensors, up_axis: force.and_then(up_axis), line, is_receiver, notes }
}

/// Returns the rate of the measurements according to their arrival times, Hz.
fn rate_hz(measurements: &[&(Duration, Measurement)]) -> Option<f64> {
    let (first, last) = (measurements.first()?.0, measurements.last()?.0);
    // Several measurements may arrive together. Those with the first arrival time mark the start of
    // the interval and are not counted.
    let counted = measurements.iter().filter(|(arrival, _)| *arrival > first).count();
    let seconds = (last - first).as_secs_f64();
    (counted >= MIN_MEASUREMENTS && seconds > 0.0).then(|| counted as f64 / seconds)
}

/// Returns the usual rate near the measured one, or else the measured rate rounded to whole hertz.
fn usual_rate_hz(measured_hz: f64) -> f64 {
    let usual = USUAL_RATES_HZ.into_iter().find(|usual_hz| (measured_hz / usual_hz - 1.0).abs() < RATE_TOLERANCE);
    usual.unwrap_or_else(|| measured_hz.round().max(1.0))
}

fn mean_force(measurements: &[&(Duration, Measurement)]) -> Option<[f64; 3]> {
    let mut sum = [0.0; 3];
    let mut count = 0.0;
    for (_, found) in measurements {
        if let Value::Imu { force_m_s2, .. } = found.value
            && force_m_s2.iter().all(|part| part.is_finite())
        {
            sum.iter_mut().zip(force_m_s2).for_each(|(sum, part)| *sum += part);
            count += 1.0;
        }
    }
    (count > 0.0).then(|| sum.map(|part| part / count))
}

fn norm(vector: [f64; 3]) -> f64 {
    vector.iter().map(|part| part * part).sum::<f64>().sqrt()
}

/// Returns the axis that points up, if the force is about 1 g and mostly along one axis.
fn up_axis(force_m_s2: [f64; 3]) -> Option<&'static str> {
    let length = norm(force_m_s2);
    if (length / GRAVITY_M_S2 - 1.0).abs() > GRAVITY_TOLERANCE {
        return None;
    }
    let axes = ["+x", "+y", "+z", "-x", "-y", "-z"];
    let parts = force_m_s2.into_iter().chain(force_m_s2.map(|part| -part));
    axes.into_iter().zip(parts).find(|(_, part)| *part > 0.8 * length).map(|(axis, _)| axis)
}

/// Units of numeric lines, derived from the magnitude of gravity and the time steps.
struct Units {
    time: &'static str,
    force: &'static str,
    /// Size of the unit of force, m/s².
    force_m_s2: f64,
    rate: &'static str,
}

impl Units {
    /// Returns the units if they are not SI units.
    fn guess(measurements: &[&(Duration, Measurement)], force: Option<f64>) -> Option<Self> {
        let is_near = |unit_m_s2: f64| {
            force.is_some_and(|force| (force * unit_m_s2 / GRAVITY_M_S2 - 1.0).abs() < GRAVITY_TOLERANCE)
        };
        let forces = [("g", GRAVITY_M_S2), ("mg", GRAVITY_M_S2 / 1000.0)];
        let found = forces.into_iter().find(|(_, unit_m_s2)| is_near(*unit_m_s2));
        let (force, force_m_s2) = found.unwrap_or(("m/s2", 1.0));
        let time = time_unit(measurements);
        // Devices that report the force in g usually report the rate in °/s.
        let rate = if found.is_some() { "deg/s" } else { "rad/s" };
        (found.is_some() || time != "s").then_some(Self { time, force, force_m_s2, rate })
    }

    fn keys(&self, has_field: bool) -> String {
        let Self { time, force, rate, .. } = self;
        let field = if has_field { (",mx,my,mz", ",uT") } else { ("", "") };
        format!("columns=t,gx,gy,gz,ax,ay,az{}&units={time},{rate},{force}{}", field.0, field.1)
    }

    fn note(&self) -> String {
        let Self { time, force, rate, .. } = self;
        format!("units derived from gravity and time: {time}, {rate}, {force}; check rate by turning the sensor by 90°")
    }
}

/// Returns the unit of the timestamps in lines of text.
///
/// The timestamps, which are read as seconds, are compared with the arrival times.
fn time_unit(measurements: &[&(Duration, Measurement)]) -> &'static str {
    let at_s = |time: DeviceTime| {
        let (DeviceTime::Counter { now_ns, .. } | DeviceTime::SinceBoot { now_ns } | DeviceTime::Unix { now_ns }) =
            time;
        now_ns as f64 * 1e-9
    };
    let times: Vec<_> =
        measurements.iter().filter_map(|(arrival, found)| Some((arrival.as_secs_f64(), at_s(found.time?)))).collect();
    let (Some(first), Some(last)) = (times.first(), times.last()) else { return "s" };
    let ratio = (last.1 - first.1) / (last.0 - first.0);
    [("ms", 1e3), ("us", 1e6)]
        .into_iter()
        .find(|(_, scale)| (0.5..2.0).contains(&(ratio / scale)))
        .map_or("s", |(unit, _)| unit)
}

/// Returns a line of text, if almost all bytes are text.
fn text_line(chunks: &[Chunk]) -> Option<String> {
    let bytes: Vec<u8> = chunks.iter().flat_map(|(_, bytes)| bytes.iter().copied()).collect();
    let is_text = |byte: &&u8| byte.is_ascii_graphic() || byte.is_ascii_whitespace();
    if bytes.iter().filter(is_text).count() * 100 < bytes.len() * 95 {
        return None;
    }
    let lines: Vec<_> = bytes.split(|byte| *byte == b'\n').collect();
    // The first and the last line may be incomplete.
    let line = lines.get(1..lines.len().saturating_sub(1))?.iter().rev().find(|line| line.len() > 1)?;
    Some(String::from_utf8_lossy(line.get(..line.len().min(100))?).trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns chunks of `per_chunk` messages, which arrive at 50 Hz for 1.5 s.
    fn chunks(message: impl Fn(u32) -> Vec<u8>, per_chunk: u32) -> Vec<Chunk> {
        (0..75u32)
            .map(|n| {
                let bytes = (0..per_chunk).flat_map(|m| message(n * per_chunk + m)).collect();
                (Duration::from_millis(u64::from(n) * 20), bytes)
            })
            .collect()
    }

    fn recognised(message: impl Fn(u32) -> Vec<u8>) -> Option<DetectedDevice> {
        recognise(Path::new("/dev/ttyUSB0"), 115_200, &chunks(message, 2))
    }

    fn rvc(n: u32) -> Vec<u8> {
        let mut frame = vec![0xaa, 0xaa, n as u8, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xd5, 3, 0, 0, 0];
        let sum = frame.iter().skip(2).fold(0u8, |sum, byte| sum.wrapping_add(*byte));
        frame.push(sum);
        frame
    }

    #[test]
    fn lines_in_other_units_are_recognised_with_keys() {
        let device = recognised(|n| format!("{},0.1,0.2,-0.1,0.01,-0.99,0.02\n", 5000 + n * 10).into_bytes()).unwrap();
        let expected = "serial:/dev/ttyUSB0?format=csv&columns=t,gx,gy,gz,ax,ay,az&units=ms,deg/s,g&rate_hz=100";
        assert_eq!((device.line.as_str(), device.up_axis), (expected, Some("-y")));
        assert_eq!(device.sensors, ["gyro", "accelerometer"]);
        let mut launch = launch::Launch::default();
        launch.set_source(&device.line).unwrap();
        let si = recognised(|n| format!("{},0,0,0,0,0,9.8,20,0,-40\n", f64::from(n) * 0.01).into_bytes()).unwrap();
        assert_eq!(si.line, "serial:/dev/ttyUSB0?format=csv&rate_hz=100");
        assert_eq!(si.sensors, ["gyro", "accelerometer", "magnetometer"]);
    }

    #[test]
    fn frames_are_recognised_after_a_partial_one() {
        let device = recognised(rvc).unwrap();
        assert_eq!((device.format, device.up_axis), ("rvc", Some("+z")));
        let mut bytes = chunks(rvc, 2);
        bytes[0].1.drain(..7);
        let device = recognise(Path::new("/dev/imu"), 115_200, &bytes).unwrap();
        assert_eq!(device.line, "serial:/dev/imu?format=rvc&baud=115200&rate_hz=100");
    }

    #[test]
    fn receiver_is_recognised_without_fix() {
        let device =
            recognised(|n| if n % 50 == 0 { b"$GPRMC,,V,,,,,,,,,,N*53\r\n".to_vec() } else { Vec::new() }).unwrap();
        assert_eq!((device.format, device.is_receiver), ("nmea", true));
        assert_eq!(device.line, "serial:/dev/ttyUSB0?format=nmea");
    }

    #[test]
    fn noise_is_not_recognised_as_a_device() {
        for seed in 0..200u32 {
            let mut state = seed.wrapping_mul(2_654_435_761).wrapping_add(1);
            let noise = chunks(|_| Vec::new(), 1).into_iter().map(|(arrival, _)| {
                let byte = |_| {
                    state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    (state >> 24) as u8
                };
                (arrival, (0..230).map(byte).collect())
            });
            let noise: Vec<_> = noise.collect();
            assert_eq!(recognise(Path::new("/dev/ttyUSB0"), 9600, &noise), None, "seed {seed}");
        }
    }

    #[test]
    fn unknown_lines_are_shown() {
        let lines = chunks(|n| format!("roll {n} pitch 7\r\n").into_bytes(), 2);
        assert_eq!(recognise(Path::new("/dev/ttyUSB0"), 9600, &lines), None);
        assert_eq!(text_line(&lines).as_deref(), Some("roll 149 pitch 7"));
    }
}
