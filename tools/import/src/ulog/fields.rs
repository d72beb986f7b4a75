//! Field parsers of the ULog topics, and conversion to native axes and units.

use attitude::frames::{self, Body, Earth};
use std::path::Path;

use mapping::is_rotation;
use px4_ulog::stream_parser::{DataMessage, FieldParser, ParseableFieldType};
use recording::Reference;

use super::kind::Kind;
use crate::{
    ImportError,
    row_writer::{Attitude, Sample},
    source::ReceiverFix,
};

/// Timestamp, relative to the gyro sample, that marks a missing measurement.
const INVALID_RELATIVE_TIME_US: i32 = i32::MAX;
/// Maximum number of inertial sensors in `sensors_status_imu`.
const MAX_SENSORS: usize = 4;
/// Lowest `fix_type` for which all three velocity components are available.
const MIN_FIX_TYPE: u8 = 3;

/// Time in ns and vector of a sample, in the axes forward, right, down.
type VectorSample = (i64, [f32; 3]);

type Vector<T> = [FieldParser<T>; 3];

/// Field parsers of `sensor_combined`.
pub(super) struct CombinedFields {
    time: FieldParser<u64>,
    rate: Vector<f32>,
    force: Vector<f32>,
    force_time_offset: Option<FieldParser<i32>>,
    /// Magnetic field, and its time relative to the gyro sample. Present only in logs from before
    /// 2018.
    field: Option<(Vector<f32>, FieldParser<i32>)>,
}

impl CombinedFields {
    pub(super) fn new(path: &Path, message: &DataMessage) -> Result<Self, ImportError> {
        let required_vector = |fields: [&'static str; 3]| {
            vector(message, fields).ok_or_else(|| missing_field(path, message, fields[0], "float[3]"))
        };
        let field = vector(message, ["magnetometer_ga[0]", "magnetometer_ga[1]", "magnetometer_ga[2]"]);
        Ok(Self {
            time: timestamp(path, message)?,
            rate: required_vector(["gyro_rad[0]", "gyro_rad[1]", "gyro_rad[2]"])?,
            force: required_vector(["accelerometer_m_s2[0]", "accelerometer_m_s2[1]", "accelerometer_m_s2[2]"])?,
            force_time_offset: optional(message, "accelerometer_timestamp_relative"),
            field: field.zip(optional(message, "magnetometer_timestamp_relative")),
        })
    }

    /// Returns `true` if the messages contain a magnetic field.
    pub(super) fn has_field(&self) -> bool {
        self.field.is_some()
    }

    /// Returns time and rate of a gyro sample; `None` if the time does not fit into 64-bit
    /// nanoseconds.
    pub(super) fn rate(&self, data: &[u8]) -> Option<Sample> {
        Some((time_ns(self.time.parse(data), 0)?, Body::Frd.to_native(parse_vector(&self.rate, data).map(f64::from))))
    }

    /// Returns time and force of an accelerometer sample; `None` if the time is invalid.
    pub(super) fn force(&self, data: &[u8]) -> Option<Sample> {
        let relative_us = self.force_time_offset.as_ref().map_or(0, |time| time.parse(data));
        Some((
            time_ns(self.time.parse(data), relative_us)?,
            Body::Frd.to_native(parse_vector(&self.force, data).map(f64::from)),
        ))
    }

    pub(super) fn field(&self, data: &[u8]) -> Option<VectorSample> {
        let (field, relative) = self.field.as_ref()?;
        Some((time_ns(self.time.parse(data), relative.parse(data))?, parse_vector(field, data)))
    }
}

/// Field parsers of `vehicle_magnetometer`.
pub(super) struct MagnetometerFields {
    time: SampleTime,
    field: Vector<f32>,
}

impl MagnetometerFields {
    pub(super) fn new(path: &Path, message: &DataMessage) -> Result<Self, ImportError> {
        let fields = ["magnetometer_ga[0]", "magnetometer_ga[1]", "magnetometer_ga[2]"];
        let field = vector(message, fields).ok_or_else(|| missing_field(path, message, fields[0], "float[3]"))?;
        Ok(Self { time: SampleTime::new(path, message)?, field })
    }

    pub(super) fn field(&self, data: &[u8]) -> Option<VectorSample> {
        Some((self.time.ns(data)?, parse_vector(&self.field, data)))
    }
}

/// Field parsers of `sensor_gyro`, `sensor_accel` and `sensor_mag`.
pub(super) struct VectorFields {
    time: SampleTime,
    vector: Vector<f32>,
    device: Option<FieldParser<u32>>,
}

impl VectorFields {
    /// Creates the parsers; `None` if a field is missing.
    pub(super) fn new(message: &DataMessage) -> Option<Self> {
        Some(Self {
            time: SampleTime::find(message)?,
            vector: vector(message, ["x", "y", "z"])?,
            device: optional(message, "device_id"),
        })
    }

    pub(super) fn vector(&self, data: &[u8]) -> Option<VectorSample> {
        Some((self.time.ns(data)?, parse_vector(&self.vector, data)))
    }

    pub(super) fn device(&self, data: &[u8]) -> Option<u32> {
        self.device.as_ref().map(|device| device.parse(data))
    }
}

/// Field parsers of `vehicle_imu`: angle and velocity integrated over an interval that ends at the
/// time of the message.
pub(super) struct IntegratedFields {
    time: SampleTime,
    angle: Vector<f32>,
    velocity: Vector<f32>,
    /// Lengths of the intervals of angle and velocity, µs.
    intervals: [IntervalField; 2],
    devices: [Option<FieldParser<u32>>; 2],
}

/// Length of an interval, µs. Its type depends on the version of the autopilot.
enum IntervalField {
    U16(FieldParser<u16>),
    U32(FieldParser<u32>),
}

impl IntervalField {
    fn find(message: &DataMessage, name: &str) -> Option<Self> {
        optional(message, name).map(Self::U32).or_else(|| optional(message, name).map(Self::U16))
    }

    fn s(&self, data: &[u8]) -> f64 {
        let us = match self {
            Self::U16(field) => field.parse(data).into(),
            Self::U32(field) => field.parse(data),
        };
        f64::from(us) / 1e6
    }
}

impl IntegratedFields {
    /// Creates the parsers; `None` if a field is missing.
    pub(super) fn new(message: &DataMessage) -> Option<Self> {
        let interval = |name| IntervalField::find(message, name).or_else(|| IntervalField::find(message, "dt"));
        Some(Self {
            time: SampleTime::find(message)?,
            angle: vector(message, ["delta_angle[0]", "delta_angle[1]", "delta_angle[2]"])?,
            velocity: vector(message, ["delta_velocity[0]", "delta_velocity[1]", "delta_velocity[2]"])?,
            intervals: [interval("delta_angle_dt")?, interval("delta_velocity_dt")?],
            devices: [optional(message, "gyro_device_id"), optional(message, "accel_device_id")],
        })
    }

    /// Returns the time in ns, and the mean rate in rad/s and mean force in m/s² over the interval.
    /// Returns `None` if the interval is empty.
    pub(super) fn means(&self, data: &[u8]) -> Option<(i64, [[f64; 3]; 2])> {
        let intervals_s = self.intervals.each_ref().map(|interval| interval.s(data));
        let [angle_s, velocity_s] = intervals_s;
        let mean = |fields, interval_s: f64| parse_vector(fields, data).map(|part: f32| f64::from(part) / interval_s);
        let is_valid = intervals_s.iter().all(|interval_s| *interval_s > 0.0);
        is_valid.then_some((self.time.ns(data)?, [mean(&self.angle, angle_s), mean(&self.velocity, velocity_s)]))
    }

    pub(super) fn devices(&self, data: &[u8]) -> [Option<(Kind, u32)>; 2] {
        let [rate, force] = self.devices.each_ref().map(|device| device.as_ref().map(|device| device.parse(data)));
        [rate.map(|device| (Kind::Rate, device)), force.map(|device| (Kind::Force, device))]
    }
}

/// Field parsers of `sensors_status_imu`: the device number of each sensor, and its health.
pub(super) struct HealthFields(Vec<(Kind, FieldParser<u32>, FieldParser<bool>)>);

impl HealthFields {
    /// Creates the parsers; `None` if the message describes no sensor.
    pub(super) fn new(message: &DataMessage) -> Option<Self> {
        let sensors =
            (0..MAX_SENSORS).flat_map(|number| [(Kind::Rate, "gyro", number), (Kind::Force, "accel", number)]);
        let fields = sensors.filter_map(|(kind, name, number)| {
            let device = optional(message, &format!("{name}_device_ids[{number}]"))?;
            Some((kind, device, optional(message, &format!("{name}_healthy[{number}]"))?))
        });
        let fields: Vec<_> = fields.collect();
        (!fields.is_empty()).then_some(Self(fields))
    }

    /// Returns the health of each sensor by its kind and device number.
    pub(super) fn health(&self, data: &[u8]) -> Vec<((Kind, u32), bool)> {
        let health = self.0.iter().map(|(kind, device, healthy)| ((*kind, device.parse(data)), healthy.parse(data)));
        health.filter(|((_, device), _)| *device != 0).collect()
    }
}

/// Field parsers of `vehicle_attitude`.
pub(super) struct AttitudeFields {
    time: SampleTime,
    quaternion: [FieldParser<f32>; 4],
    reset_counter: Option<FieldParser<u8>>,
}

impl AttitudeFields {
    pub(super) fn new(path: &Path, message: &DataMessage) -> Result<Self, ImportError> {
        let part = |name| required(path, message, name, "float[4]");
        let quaternion = [part("q[0]")?, part("q[1]")?, part("q[2]")?, part("q[3]")?];
        Ok(Self {
            time: SampleTime::new(path, message)?,
            quaternion,
            reset_counter: optional(message, "quat_reset_counter"),
        })
    }

    /// Returns the attitude; `None` if the quaternion is not a rotation or the time is out of
    /// range.
    pub(super) fn attitude(&self, data: &[u8]) -> Option<Attitude> {
        let quaternion = [0, 1, 2, 3].map(|part: usize| self.quaternion[part].parse(data));
        let reset_counter = self.reset_counter.as_ref().map_or(0, |resets| resets.parse(data));
        let quaternion = quaternion.map(f64::from);
        let native = || frames::quaternion_to_native(Earth::Ned, Body::Frd, quaternion);
        let quaternion = is_rotation(quaternion).then(native)?;
        let reference = Reference { quaternion, scored: true };
        Some(Attitude { t_ns: self.time.ns(data)?, reference, reset_counter: Some(reset_counter) })
    }
}

/// Field parsers of `vehicle_gps_position` or `sensor_gps`.
pub(super) struct ReceiverFields {
    time: FieldParser<u64>,
    north: FieldParser<f32>,
    east: FieldParser<f32>,
    down: FieldParser<f32>,
    is_valid: Option<FieldParser<bool>>,
    fix_type: Option<FieldParser<u8>>,
    position: PositionFields,
}

/// Parsers for the fields with latitude, longitude and altitude.
enum PositionFields {
    /// Degrees and m, since PX4 1.14.
    Degrees(Vector<f64>),
    /// 1e-7 degrees and mm, before PX4 1.14.
    Scaled(Vector<i32>),
    None,
}

impl ReceiverFields {
    pub(super) fn new(path: &Path, message: &DataMessage) -> Result<Self, ImportError> {
        let degrees = vector(message, ["latitude_deg", "longitude_deg", "altitude_msl_m"]).map(PositionFields::Degrees);
        let scaled = || vector(message, ["lat", "lon", "alt"]).map(PositionFields::Scaled);
        Ok(Self {
            time: timestamp(path, message)?,
            north: required(path, message, "vel_n_m_s", "float")?,
            east: required(path, message, "vel_e_m_s", "float")?,
            down: required(path, message, "vel_d_m_s", "float")?,
            is_valid: optional(message, "vel_ned_valid"),
            fix_type: optional(message, "fix_type"),
            position: degrees.or_else(scaled).unwrap_or(PositionFields::None),
        })
    }

    /// Returns the fix; `None` if it is not a 3D fix, its velocity is invalid, or its time is out
    /// of range.
    pub(super) fn fix(&self, data: &[u8]) -> Option<ReceiverFix> {
        let is_valid = self.is_valid.as_ref().is_none_or(|is_valid| is_valid.parse(data));
        let is_3d = self.fix_type.as_ref().is_none_or(|kind| kind.parse(data) >= MIN_FIX_TYPE);
        let ned = [&self.north, &self.east, &self.down].map(|part| f64::from(part.parse(data)));
        if !is_valid || !is_3d || !ned.iter().all(|part| part.is_finite()) {
            return None;
        }
        let [latitude_deg, longitude_deg, altitude_m] = match &self.position {
            PositionFields::Degrees(fields) => parse_vector(fields, data),
            PositionFields::Scaled(fields) => {
                let [latitude, longitude, altitude] = parse_vector(fields, data).map(f64::from);
                [latitude / 1e7, longitude / 1e7, altitude / 1e3]
            }
            PositionFields::None => [f64::NAN; 3],
        };
        let t_ns = time_ns(self.time.parse(data), 0)?;
        Some(ReceiverFix { t_ns, velocity_m_s: Earth::Ned.to_native(ned), latitude_deg, longitude_deg, altitude_m })
    }
}

/// Time of a measurement. Old logs contain only its publication time.
struct SampleTime {
    published: FieldParser<u64>,
    sampled: Option<FieldParser<u64>>,
}

impl SampleTime {
    fn new(path: &Path, message: &DataMessage) -> Result<Self, ImportError> {
        Ok(Self { published: timestamp(path, message)?, sampled: optional(message, "timestamp_sample") })
    }

    fn find(message: &DataMessage) -> Option<Self> {
        Some(Self { published: optional(message, "timestamp")?, sampled: optional(message, "timestamp_sample") })
    }

    fn ns(&self, data: &[u8]) -> Option<i64> {
        let sampled = self.sampled.as_ref().map(|sampled| sampled.parse(data)).filter(|&us| us != 0);
        time_ns(sampled.unwrap_or_else(|| self.published.parse(data)), 0)
    }
}

fn time_ns(us: u64, relative_us: i32) -> Option<i64> {
    if relative_us == INVALID_RELATIVE_TIME_US {
        return None;
    }
    let us = i64::try_from(us).ok()?.checked_add(relative_us.into())?;
    // Times in a recording are below this limit.
    us.checked_mul(1000).filter(|&t_ns| t_ns < 9_000_000_000_000_000_000)
}

fn parse_vector<T: ParseableFieldType>(fields: &Vector<T>, data: &[u8]) -> [T; 3] {
    [0, 1, 2].map(|part: usize| fields[part].parse(data))
}

fn timestamp(path: &Path, message: &DataMessage) -> Result<FieldParser<u64>, ImportError> {
    required(path, message, "timestamp", "uint64_t")
}

fn required<T: ParseableFieldType>(
    path: &Path,
    message: &DataMessage,
    field: &'static str,
    expected: &'static str,
) -> Result<FieldParser<T>, ImportError> {
    optional(message, field).ok_or_else(|| missing_field(path, message, field, expected))
}

fn optional<T: ParseableFieldType>(message: &DataMessage, field: &str) -> Option<FieldParser<T>> {
    message.flattened_format.get_field_parser(field).ok()
}

fn vector<T: ParseableFieldType>(message: &DataMessage, [x, y, z]: [&str; 3]) -> Option<Vector<T>> {
    Some([optional(message, x)?, optional(message, y)?, optional(message, z)?])
}

fn missing_field(path: &Path, message: &DataMessage, field: &'static str, expected: &'static str) -> ImportError {
    let format = message.flattened_format;
    let known = format.field_iter().map(|field| field.flattened_field_name.as_str().into()).collect();
    ImportError::MissingField { path: path.to_owned(), topic: format.message_name().into(), field, expected, known }
}
