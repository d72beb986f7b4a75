//! Where the fields of a topic are, and what they say.

use attitude::frames::{self, Body, Earth};
use std::path::Path;

use mapping::is_rotation;
use px4_ulog::stream_parser::{DataMessage, FieldParser, ParseableFieldType};
use recording::Reference;

use crate::{ImportError, force_aligner::Sample, row_writer::Attitude, source::Fixed};

/// A relative time that is none.
const NO_TIME: i32 = i32::MAX;
/// Least kind of fix whose velocity has all three components.
const FIX_3D: u8 = 3;

/// The field at a time, forward, right, down.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Field {
    pub(crate) t_ns: i64,
    pub(crate) field_ga: [f32; 3],
}

/// The attitude at a time, forward, right, down to north, east, down.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Turned {
    pub(crate) t_ns: i64,
    quaternion: [f32; 4],
    resets: u8,
}

impl Turned {
    pub(crate) fn attitude(&self) -> Attitude {
        let quaternion = frames::quaternion_to_native(Earth::Ned, Body::Frd, self.quaternion.map(f64::from));
        Attitude { t_ns: self.t_ns, reference: Reference { quaternion, scored: true }, reset_counter: Some(self.resets) }
    }
}

type Three<T> = [FieldParser<T>; 3];

/// `sensor_combined`.
pub(super) struct Combined {
    time: FieldParser<u64>,
    rate: Three<f32>,
    force: Three<f32>,
    force_time: Option<FieldParser<i32>>,
    /// Only in logs of before 2018.
    field: Option<(Three<f32>, FieldParser<i32>)>,
}

impl Combined {
    pub(super) fn of(path: &Path, message: &DataMessage) -> Result<Self, ImportError> {
        let need = |fields: [&'static str; 3]| {
            three(message, fields).ok_or_else(|| missing(path, message, fields[0], "float[3]"))
        };
        let field = three(message, ["magnetometer_ga[0]", "magnetometer_ga[1]", "magnetometer_ga[2]"]);
        Ok(Self {
            time: time(path, message)?,
            rate: need(["gyro_rad[0]", "gyro_rad[1]", "gyro_rad[2]"])?,
            force: need(["accelerometer_m_s2[0]", "accelerometer_m_s2[1]", "accelerometer_m_s2[2]"])?,
            force_time: optional(message, "accelerometer_timestamp_relative"),
            field: field.zip(optional(message, "magnetometer_timestamp_relative")),
        })
    }

    /// Time and rate of the gyro; `None` of a time that 64 bits of nanoseconds cannot hold.
    pub(super) fn rate(&self, data: &[u8]) -> Option<Sample> {
        Some((ns(self.time.parse(data), 0)?, Body::Frd.to_native(parse(&self.rate, data).map(f64::from))))
    }

    /// Time and force of the accelerometer, where the log has it.
    pub(super) fn force(&self, data: &[u8]) -> Option<Sample> {
        let relative_us = self.force_time.as_ref().map_or(0, |time| time.parse(data));
        Some((ns(self.time.parse(data), relative_us)?, Body::Frd.to_native(parse(&self.force, data).map(f64::from))))
    }

    pub(super) fn field(&self, data: &[u8]) -> Option<Field> {
        let (field, relative) = self.field.as_ref()?;
        Some(Field { t_ns: ns(self.time.parse(data), relative.parse(data))?, field_ga: parse(field, data) })
    }
}

/// `vehicle_magnetometer`.
pub(super) struct Magnetometer {
    time: Sampled,
    field: Three<f32>,
}

impl Magnetometer {
    pub(super) fn of(path: &Path, message: &DataMessage) -> Result<Self, ImportError> {
        let fields = ["magnetometer_ga[0]", "magnetometer_ga[1]", "magnetometer_ga[2]"];
        let field = three(message, fields).ok_or_else(|| missing(path, message, fields[0], "float[3]"))?;
        Ok(Self { time: Sampled::of(path, message)?, field })
    }

    pub(super) fn field(&self, data: &[u8]) -> Option<Field> {
        Some(Field { t_ns: self.time.ns(data)?, field_ga: parse(&self.field, data) })
    }
}

/// `vehicle_attitude`.
pub(super) struct AttitudeFields {
    time: Sampled,
    quaternion: [FieldParser<f32>; 4],
    resets: Option<FieldParser<u8>>,
}

impl AttitudeFields {
    pub(super) fn of(path: &Path, message: &DataMessage) -> Result<Self, ImportError> {
        let part = |name| need(path, message, name, "float[4]");
        let quaternion = [part("q[0]")?, part("q[1]")?, part("q[2]")?, part("q[3]")?];
        Ok(Self { time: Sampled::of(path, message)?, quaternion, resets: optional(message, "quat_reset_counter") })
    }

    /// `None` of a quaternion that is no rotation.
    pub(super) fn attitude(&self, data: &[u8]) -> Option<Turned> {
        let quaternion = [0, 1, 2, 3].map(|part: usize| self.quaternion[part].parse(data));
        let resets = self.resets.as_ref().map_or(0, |resets| resets.parse(data));
        let is_rotation = is_rotation(quaternion.map(f64::from));
        Some(Turned { t_ns: self.time.ns(data)?, quaternion, resets }).filter(|_| is_rotation)
    }
}

/// `vehicle_gps_position` or `sensor_gps`.
pub(super) struct Receiver {
    time: FieldParser<u64>,
    north: FieldParser<f32>,
    east: FieldParser<f32>,
    down: FieldParser<f32>,
    is_valid: Option<FieldParser<bool>>,
    kind: Option<FieldParser<u8>>,
    position: Position,
}

/// Latitude, longitude, altitude.
enum Position {
    /// From PX4 1.14 on: degrees, m.
    Degrees(Three<f64>),
    /// Before that: 1e-7 degrees, mm.
    Scaled(Three<i32>),
    None,
}

impl Receiver {
    pub(super) fn of(path: &Path, message: &DataMessage) -> Result<Self, ImportError> {
        let degrees = three(message, ["latitude_deg", "longitude_deg", "altitude_msl_m"]).map(Position::Degrees);
        let scaled = || three(message, ["lat", "lon", "alt"]).map(Position::Scaled);
        Ok(Self {
            time: time(path, message)?,
            north: need(path, message, "vel_n_m_s", "float")?,
            east: need(path, message, "vel_e_m_s", "float")?,
            down: need(path, message, "vel_d_m_s", "float")?,
            is_valid: optional(message, "vel_ned_valid"),
            kind: optional(message, "fix_type"),
            position: degrees.or_else(scaled).unwrap_or(Position::None),
        })
    }

    /// `None` where the receiver has no fix in three dimensions, or calls its velocity invalid.
    pub(super) fn fix(&self, data: &[u8]) -> Option<Fixed> {
        let is_valid = self.is_valid.as_ref().is_none_or(|is_valid| is_valid.parse(data));
        let is_3d = self.kind.as_ref().is_none_or(|kind| kind.parse(data) >= FIX_3D);
        let ned = [&self.north, &self.east, &self.down].map(|part| f64::from(part.parse(data)));
        if !is_valid || !is_3d || !ned.iter().all(|part| part.is_finite()) {
            return None;
        }
        let [latitude_deg, longitude_deg, altitude_m] = match &self.position {
            Position::Degrees(fields) => parse(fields, data),
            Position::Scaled(fields) => {
                let [latitude, longitude, altitude] = parse(fields, data).map(f64::from);
                [latitude / 1e7, longitude / 1e7, altitude / 1e3]
            }
            Position::None => [f64::NAN; 3],
        };
        let t_ns = ns(self.time.parse(data), 0)?;
        Some(Fixed { t_ns, velocity_m_s: Earth::Ned.to_native(ned), latitude_deg, longitude_deg, altitude_m })
    }
}

/// When something was measured: newer logs say so, older ones only when it was published.
struct Sampled {
    published: FieldParser<u64>,
    sampled: Option<FieldParser<u64>>,
}

impl Sampled {
    fn of(path: &Path, message: &DataMessage) -> Result<Self, ImportError> {
        Ok(Self { published: time(path, message)?, sampled: optional(message, "timestamp_sample") })
    }

    fn ns(&self, data: &[u8]) -> Option<i64> {
        let sampled = self.sampled.as_ref().map(|sampled| sampled.parse(data)).filter(|&us| us != 0);
        ns(sampled.unwrap_or_else(|| self.published.parse(data)), 0)
    }
}

fn ns(us: u64, relative_us: i32) -> Option<i64> {
    if relative_us == NO_TIME {
        return None;
    }
    let us = i64::try_from(us).ok()?.checked_add(relative_us.into())?;
    // What no recording can hold.
    us.checked_mul(1000).filter(|&t_ns| t_ns < 9_000_000_000_000_000_000)
}

fn parse<T: ParseableFieldType>(fields: &Three<T>, data: &[u8]) -> [T; 3] {
    [0, 1, 2].map(|part: usize| fields[part].parse(data))
}

fn time(path: &Path, message: &DataMessage) -> Result<FieldParser<u64>, ImportError> {
    need(path, message, "timestamp", "uint64_t")
}

fn need<T: ParseableFieldType>(
    path: &Path,
    message: &DataMessage,
    field: &'static str,
    expected: &'static str,
) -> Result<FieldParser<T>, ImportError> {
    optional(message, field).ok_or_else(|| missing(path, message, field, expected))
}

fn optional<T: ParseableFieldType>(message: &DataMessage, field: &str) -> Option<FieldParser<T>> {
    message.flattened_format.get_field_parser(field).ok()
}

fn three<T: ParseableFieldType>(message: &DataMessage, [x, y, z]: [&str; 3]) -> Option<Three<T>> {
    Some([optional(message, x)?, optional(message, y)?, optional(message, z)?])
}

fn missing(path: &Path, message: &DataMessage, field: &'static str, expected: &'static str) -> ImportError {
    let format = message.flattened_format;
    let known = format.field_iter().map(|field| field.flattened_field_name.clone()).collect();
    ImportError::NoField { path: path.to_owned(), topic: format.message_name().to_owned(), field, expected, known }
}
