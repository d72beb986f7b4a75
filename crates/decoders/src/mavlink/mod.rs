//! MAVLink 1 and 2 from an autopilot: its IMU and its satellite receiver.
//!
//! | message | use |
//! | --- | --- |
//! | HIGHRES_IMU | first IMU (`id` 0) only: rate and force if `fields_updated` marks all six values, and the magnetic field if marked. A magnetic field without rate and force is a separate measurement |
//! | SCALED_IMU, SCALED_IMU2, SCALED_IMU3 | mrad/s, mg, mgauss |
//! | RAW_IMU | unitless numbers, decoded only if selected and if a [`RawScale`] is set |
//! | GPS_RAW_INT | ground speed and course, see below |
//! | GLOBAL_POSITION_INT | velocity estimated by the autopilot, only if selected |
//! | ATTITUDE, ATTITUDE_QUATERNION | no measurement; [`Mavlink::attitude`] decodes them |
//! | others | counted |
//!
//! Only one system, one component and one kind of IMU message are decoded. If the settings do not
//! select them, the first sender of rate and force is chosen and remains so until it has been
//! silent for [`crate::SENDER_TIMEOUT`]. Measurements of other systems and components are counted
//! as foreign.
//!
//! Axes: vectors of the IMU are converted from (forward, right, down) to (right, forward, up), and
//! velocities from (north, east, down) to (east, north, up). No mounting is needed, because the
//! autopilot has already compensated for its own mounting.
//!
//! Time: `time_usec` counts from the start or from 1970, distinguished by its magnitude.
//! `time_boot_ms` counts from the start with 1 ms resolution.
//!
//! Vertical velocity: GPS_RAW_INT does not contain the vertical velocity. The decoder sets it to 0
//! with a standard deviation of at least [`crate::ASSUMED_VERTICAL_SD_M_S`], which suits ground
//! vehicles and boats. GLOBAL_POSITION_INT has a vertical velocity, but it is an estimate that also
//! uses the autopilot's own IMU.
//!
//! Limits: signatures are not verified. Messages unknown to the dialect `ardupilotmega` (with
//! `common`) cannot be recognised and count as skipped bytes.

pub mod frame;

use std::{ops::RangeInclusive, time::Duration};

use self::frame::{STX_V1, STX_V2, checksum, crc_extra};
use crate::{
    ASSUMED_VERTICAL_SD_M_S, DeviceTime, Measurement, Position, SenderChoice, Value,
    framed::{Format, ParseOutcome},
};

const HEADER_V1_BYTES: usize = 6;
const HEADER_V2_BYTES: usize = 10;
const MAX_PAYLOAD_BYTES: usize = 255;
const CHECKSUM_BYTES: usize = 2;
const SIGNATURE_BYTES: usize = 13;
const FLAG_SIGNED: u8 = 1;

/// Identifiers of the decoded messages.
const GPS_RAW_INT: u32 = 24;
const SCALED_IMU: u32 = 26;
const RAW_IMU: u32 = 27;
const ATTITUDE: u32 = 30;
const ATTITUDE_QUATERNION: u32 = 31;
const GLOBAL_POSITION_INT: u32 = 33;
const HIGHRES_IMU: u32 = 105;
const SCALED_IMU2: u32 = 116;
const SCALED_IMU3: u32 = 129;

/// Bits of `fields_updated` for three axes of force, rate and magnetic field.
const FORCE_UPDATED: u16 = 0b000_000_111;
const RATE_UPDATED: u16 = 0b000_111_000;
const FIELD_UPDATED: u16 = 0b111_000_000;
/// Values of `GPS_FIX_TYPE` with a position: from a 2D fix to precise point positioning.
const FIX_TYPES: RangeInclusive<u8> = 2..=8;

const STANDARD_GRAVITY_M_S2: f64 = 9.80665;
const UT_PER_GAUSS: f64 = 100.0;
const UT_PER_MGAUSS: f64 = 0.1;
/// Smallest `time_usec` that counts as UNIX time: 2001-09-09.
const MIN_UNIX_TIME_US: u64 = 1_000_000_000_000_000;
/// Speed or course value that means "unknown".
const UNKNOWN: u16 = u16::MAX;

/// MAVLink format, with the chosen system, component and IMU message.
#[derive(Debug, Clone, Default)]
pub struct Mavlink {
    settings: MavlinkSettings,
    choice: SenderChoice<ImuSender>,
    now: Duration,
}

/// Sender of an IMU message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct ImuSender {
    system: u8,
    component: u8,
    message: ImuMessage,
}

/// Selection of the system and the messages to decode.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct MavlinkSettings {
    /// System to decode; `None` chooses the first one that sends rate and force.
    pub system_id: Option<u8>,
    /// Message to take rate and force from; `None` chooses whichever arrives first.
    pub imu: Option<ImuMessage>,
    /// Message to take the velocity from.
    pub fix: FixMessage,
    /// Units of RAW_IMU; `None` ignores the message.
    pub raw_scale: Option<RawScale>,
}

/// Attitude that the autopilot has estimated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AttitudeEstimate {
    /// Time since the start of the autopilot.
    pub time: DeviceTime,
    /// Quaternion w, x, y, z: rotation from (forward, right, down) to (north, east, down).
    pub quaternion: [f64; 4],
    /// `true` for ATTITUDE_QUATERNION, `false` for ATTITUDE.
    pub is_quaternion: bool,
}

/// Message with rate and specific force.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImuMessage {
    /// HIGHRES_IMU.
    HighresImu,
    /// SCALED_IMU.
    ScaledImu,
    /// SCALED_IMU2.
    ScaledImu2,
    /// SCALED_IMU3.
    ScaledImu3,
    /// RAW_IMU.
    RawImu,
}

/// Message with a velocity over ground.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum FixMessage {
    /// GPS_RAW_INT: velocity measured by the receiver.
    #[default]
    GpsRawInt,
    /// GLOBAL_POSITION_INT: velocity estimated by the autopilot.
    GlobalPositionInt,
    /// No message: velocities are not decoded.
    Disabled,
}

/// Units of the numbers in RAW_IMU. ArduPilot sends mrad/s, mg and mgauss.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RawScale {
    /// Rate represented by the number 1, rad/s.
    pub rate_rad_s: f64,
    /// Specific force represented by the number 1, m/s².
    pub force_m_s2: f64,
    /// Magnetic field represented by the number 1, µT.
    pub field_ut: f64,
}

impl RawScale {
    /// Units of ArduPilot's RAW_IMU and of all scaled messages: mrad/s, mg, mgauss.
    pub const ARDUPILOT: Self =
        Self { rate_rad_s: 1e-3, force_m_s2: STANDARD_GRAVITY_M_S2 / 1000.0, field_ut: UT_PER_MGAUSS };
}

impl Mavlink {
    /// Creates a format with these settings.
    pub fn new(settings: MavlinkSettings) -> Self {
        Self { settings, ..Self::default() }
    }

    /// Decodes the attitude in a frame that [`Format::parse`] has accepted.
    ///
    /// Returns `None` for other messages, and for those of senders that are not decoded.
    pub fn attitude(&self, frame: &[u8]) -> Option<AttitudeEstimate> {
        let header = Header::parse(frame).ok()?;
        let chosen = self.choice.chosen(self.now)?;
        if (chosen.system, chosen.component) != (header.system, header.component) {
            return None;
        }
        let payload = Payload::new(frame.get(header.bytes..header.bytes + header.payload_bytes)?);
        let quaternion = match header.message {
            ATTITUDE => quaternion_of(payload.three_f32(4)),
            ATTITUDE_QUATERNION => {
                let [w, x, y] = payload.three_f32(4);
                [w, x, y, f32::from_le_bytes(payload.bytes(16)).into()]
            }
            _ => return None,
        };
        let is_quaternion = header.message == ATTITUDE_QUATERNION;
        Some(AttitudeEstimate { time: since_boot(payload.u32(0)), quaternion, is_quaternion })
    }

    /// Decodes a message. Returns `false` if its measurement comes from a sender that is not
    /// decoded.
    fn process(&mut self, header: &Header, payload: &[u8], measurements: &mut Vec<Measurement>) -> bool {
        let Some((imu, measurement)) = self.decode(header.message, &Payload::new(payload)) else { return true };
        let chosen = self.choice.chosen(self.now);
        let is_chosen = |chosen: ImuSender| (chosen.system, chosen.component) == (header.system, header.component);
        if self.settings.system_id.is_some_and(|system| system != header.system) || !chosen.is_none_or(is_chosen) {
            return false;
        }
        if let Some(message) = imu {
            if chosen.is_some_and(|chosen| chosen.message != message) {
                return true;
            }
            // A message with only a magnetic field does not choose its sender, because the sender
            // may not send rate and force.
            if matches!(measurement.value, Value::Imu { .. }) {
                let Header { system, component, .. } = *header;
                self.choice.confirm(ImuSender { system, component, message }, self.now);
            }
        }
        measurements.push(measurement);
        true
    }

    /// Returns the measurement of a message, and its kind if it is an IMU message. Returns `None`
    /// if the settings exclude the message or it has no measurement.
    fn decode(&self, message: u32, payload: &Payload) -> Option<(Option<ImuMessage>, Measurement)> {
        let MavlinkSettings { imu: selected, fix, raw_scale, .. } = self.settings;
        let (imu, measurement) = match message {
            HIGHRES_IMU => (Some(ImuMessage::HighresImu), payload.highres()),
            SCALED_IMU => (Some(ImuMessage::ScaledImu), Some(payload.scaled())),
            SCALED_IMU2 => (Some(ImuMessage::ScaledImu2), Some(payload.scaled())),
            SCALED_IMU3 => (Some(ImuMessage::ScaledImu3), Some(payload.scaled())),
            RAW_IMU => (Some(ImuMessage::RawImu), raw_scale.and_then(|scale| payload.raw(&scale))),
            GPS_RAW_INT if fix == FixMessage::GpsRawInt => (None, payload.gps_raw()),
            GLOBAL_POSITION_INT if fix == FixMessage::GlobalPositionInt => (None, Some(payload.global_position())),
            _ => return None,
        };
        // RAW_IMU has no unit, so it is never chosen automatically.
        let is_allowed = |imu| selected.map_or(imu != ImuMessage::RawImu, |selected| selected == imu);
        imu.is_none_or(is_allowed).then_some((imu, measurement?))
    }
}

impl Format for Mavlink {
    fn parse(&mut self, bytes: &[u8], measurements: &mut Vec<Measurement>) -> ParseOutcome {
        let header = match Header::parse(bytes) {
            Ok(header) => header,
            Err(outcome) => return outcome,
        };
        let Some(frame) = bytes.get(..header.frame_bytes()) else { return ParseOutcome::Incomplete };
        let (covered, rest) = frame.split_at(header.bytes + header.payload_bytes);
        if !rest.starts_with(&checksum(&covered[1..], header.crc_extra).to_le_bytes()) {
            return ParseOutcome::Rejected;
        }
        match self.process(&header, &covered[header.bytes..], measurements) {
            true => ParseOutcome::Frame(frame.len()),
            false => ParseOutcome::Foreign(frame.len()),
        }
    }

    fn set_time(&mut self, now: Duration) {
        self.now = now;
    }
}

/// Header of a frame.
struct Header {
    bytes: usize,
    payload_bytes: usize,
    signature_bytes: usize,
    system: u8,
    component: u8,
    message: u32,
    /// CRC seed of the message.
    crc_extra: u8,
}

impl Header {
    fn parse(bytes: &[u8]) -> Result<Self, ParseOutcome> {
        let (head_bytes, signature_bytes) = match *bytes {
            [STX_V1, ..] => (HEADER_V1_BYTES, 0),
            [STX_V2, _, 0, ..] => (HEADER_V2_BYTES, 0),
            [STX_V2, _, FLAG_SIGNED, ..] => (HEADER_V2_BYTES, SIGNATURE_BYTES),
            [STX_V2] | [STX_V2, _] => return Err(ParseOutcome::Incomplete),
            _ => return Err(ParseOutcome::Skip(1)),
        };
        let Some(header) = bytes.get(..head_bytes) else { return Err(ParseOutcome::Incomplete) };
        let (system, component, message) = if head_bytes == HEADER_V1_BYTES {
            (header[3], header[4], u32::from(header[5]))
        } else {
            (header[5], header[6], u32::from_le_bytes([header[7], header[8], header[9], 0]))
        };
        // If the message is unknown, its checksum cannot be verified.
        let Some(crc_extra) = crc_extra(message) else { return Err(ParseOutcome::Skip(1)) };
        let payload_bytes = header[1].into();
        Ok(Self { bytes: head_bytes, payload_bytes, signature_bytes, system, component, message, crc_extra })
    }

    fn frame_bytes(&self) -> usize {
        self.bytes + self.payload_bytes + CHECKSUM_BYTES + self.signature_bytes
    }
}

/// Payload of a message. Bytes that were not sent read as zero: MAVLink 2 omits trailing zeros, and
/// older senders omit fields that were added later.
struct Payload([u8; MAX_PAYLOAD_BYTES]);

/// The message fields are read in the wire order of MAVLink: sorted by size, then the extension
/// fields.
impl Payload {
    fn new(bytes: &[u8]) -> Self {
        let mut padded = [0; MAX_PAYLOAD_BYTES];
        padded.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
        Self(padded)
    }

    fn bytes<const N: usize>(&self, at: usize) -> [u8; N] {
        std::array::from_fn(|index| self.0[at + index])
    }

    fn u16(&self, at: usize) -> u16 {
        u16::from_le_bytes(self.bytes(at))
    }

    fn i32(&self, at: usize) -> i32 {
        i32::from_le_bytes(self.bytes(at))
    }

    fn u32(&self, at: usize) -> u32 {
        u32::from_le_bytes(self.bytes(at))
    }

    fn u64(&self, at: usize) -> u64 {
        u64::from_le_bytes(self.bytes(at))
    }

    fn three_i16(&self, at: usize) -> [i16; 3] {
        [0, 2, 4].map(|offset| i16::from_le_bytes(self.bytes(at + offset)))
    }

    fn three_f32(&self, at: usize) -> [f64; 3] {
        [0, 4, 8].map(|offset| f32::from_le_bytes(self.bytes(at + offset)).into())
    }

    fn highres(&self) -> Option<Measurement> {
        let (updated, id) = (self.u16(60), self.0[62]);
        if id != 0 {
            return None;
        }
        let has = |fields| updated & fields == fields;
        let field_ut = has(FIELD_UPDATED).then(|| frd_to_rfu(self.three_f32(32).map(|part| part * UT_PER_GAUSS)));
        let value = if has(FORCE_UPDATED | RATE_UPDATED) {
            let (force_m_s2, rate_rad_s) = (frd_to_rfu(self.three_f32(8)), frd_to_rfu(self.three_f32(20)));
            Value::Imu { rate_rad_s, force_m_s2, field_ut }
        } else {
            Value::Field(field_ut?)
        };
        Some(Measurement { time: timestamp(self.u64(0)), value })
    }

    /// Reads SCALED_IMU, SCALED_IMU2 or SCALED_IMU3, which have the same fields.
    fn scaled(&self) -> Measurement {
        let (force, rate, field) = (self.three_i16(4), self.three_i16(10), self.three_i16(16));
        Measurement { time: Some(since_boot(self.u32(0))), value: RawScale::ARDUPILOT.imu(rate, force, field) }
    }

    fn raw(&self, scale: &RawScale) -> Option<Measurement> {
        let (force, rate, field, id) = (self.three_i16(8), self.three_i16(14), self.three_i16(20), self.0[26]);
        (id == 0).then(|| Measurement { time: timestamp(self.u64(0)), value: scale.imu(rate, force, field) })
    }

    fn gps_raw(&self) -> Option<Measurement> {
        let (speed, course, fix_type) = (self.u16(24), self.u16(26), self.0[28]);
        if !FIX_TYPES.contains(&fix_type) || speed == UNKNOWN || course == UNKNOWN {
            return None;
        }
        let (speed_m_s, (east, north)) = (f64::from(speed) / 100.0, (f64::from(course) / 100.0).to_radians().sin_cos());
        let sd_m_s = (f64::from(self.u32(42)) / 1000.0).max(ASSUMED_VERTICAL_SD_M_S);
        let value = Value::Fix {
            velocity_m_s: [speed_m_s * east, speed_m_s * north, 0.0],
            sd_m_s: Some(sd_m_s),
            position: position(self.i32(8), self.i32(12), self.i32(16)),
        };
        Some(Measurement { time: timestamp(self.u64(0)), value })
    }

    fn global_position(&self) -> Measurement {
        let [north, east, down] = self.three_i16(20).map(|part| f64::from(part) / 100.0);
        let value = Value::Fix {
            velocity_m_s: [east, north, -down],
            sd_m_s: None,
            position: position(self.i32(4), self.i32(8), self.i32(12)),
        };
        Measurement { time: Some(since_boot(self.u32(0))), value }
    }
}

impl RawScale {
    /// Converts raw numbers. A magnetic field of zero indicates that there is no magnetometer.
    fn imu(&self, rate: [i16; 3], force: [i16; 3], field: [i16; 3]) -> Value {
        let in_units_of = |unit: f64| move |part: i16| f64::from(part) * unit;
        Value::Imu {
            rate_rad_s: frd_to_rfu(rate.map(in_units_of(self.rate_rad_s))),
            force_m_s2: frd_to_rfu(force.map(in_units_of(self.force_m_s2))),
            field_ut: (field != [0; 3]).then(|| frd_to_rfu(field.map(in_units_of(self.field_ut)))),
        }
    }
}

/// Converts roll, pitch and yaw in rad to a quaternion w, x, y, z.
fn quaternion_of(angles_rad: [f64; 3]) -> [f64; 4] {
    let [(sr, cr), (sp, cp), (sy, cy)] = angles_rad.map(|angle_rad| (angle_rad / 2.0).sin_cos());
    [cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy]
}

/// Converts (forward, right, down) to (right, forward, up).
fn frd_to_rfu([forward, right, down]: [f64; 3]) -> [f64; 3] {
    [right, forward, -down]
}

/// Creates a position from latitude and longitude in 1e-7° and altitude in mm.
fn position(latitude: i32, longitude: i32, altitude_mm: i32) -> Position {
    let degrees = |angle: i32| f64::from(angle) / 1e7;
    Position::from_degrees(degrees(latitude), degrees(longitude), f64::from(altitude_mm) / 1000.0)
}

fn since_boot(ms: u32) -> DeviceTime {
    DeviceTime::SinceBoot { now_ns: u64::from(ms) * 1_000_000 }
}

/// Returns the timestamp given by `time_usec`, or `None` for 0, which means that the device has no
/// clock.
fn timestamp(us: u64) -> Option<DeviceTime> {
    let now_ns = us.checked_mul(1000).filter(|ns| *ns > 0)?;
    Some(if us >= MIN_UNIX_TIME_US { DeviceTime::Unix { now_ns } } else { DeviceTime::SinceBoot { now_ns } })
}
