//! MAVLink 1 and 2 from an autopilot: its IMU and its satellite receiver.
//!
//! | message | use |
//! | --- | --- |
//! | HIGHRES_IMU | first IMU (`id` 0) only: rate and force if `fields_updated` marks all six values, and the field if marked. A field without rate and force is a separate measurement |
//! | SCALED_IMU, SCALED_IMU2, SCALED_IMU3 | mrad/s, mg, mgauss |
//! | RAW_IMU | unitless numbers, decoded only if selected and if a [`RawScale`] is set |
//! | GPS_RAW_INT | ground speed and course, see below |
//! | GLOBAL_POSITION_INT | velocity estimated by the autopilot, only if selected |
//! | others | counted |
//!
//! Only one kind of IMU message is decoded: the selected one, or the first that arrives. Only one
//! system is decoded: the selected one, or the first that sends a usable message.
//!
//! Axes: vectors of the IMU are converted from (forward, right, down) to (right, forward, up), and
//! velocities from (north, east, down) to (east, north, up). No mounting is needed, because the
//! autopilot has already compensated for its own mounting.
//!
//! Time: `time_usec` counts from the start or from 1970, distinguished by its magnitude.
//! `time_boot_ms` counts from the start with 1 ms resolution.
//!
//! Vertical velocity: GPS_RAW_INT has none. It is set to 0 with a standard deviation of at least
//! [`crate::ASSUMED_VERTICAL_SD_M_S`], which suits ground vehicles and boats. GLOBAL_POSITION_INT
//! has a vertical velocity, but its estimate includes the autopilot's own IMU.
//!
//! Limits: signatures are not verified. Messages unknown to the dialect `ardupilotmega` (with
//! `common`) cannot be recognised and count as skipped bytes.

use mavlink::{
    MavlinkVersion, Message, MessageData, calculate_crc,
    dialects::ardupilotmega::{
        GLOBAL_POSITION_INT_DATA, GPS_RAW_INT_DATA, GpsFixType, HIGHRES_IMU_DATA, HighresImuUpdatedFlags, MavMessage,
        RAW_IMU_DATA, SCALED_IMU_DATA, SCALED_IMU2_DATA, SCALED_IMU3_DATA,
    },
};

use crate::{
    ASSUMED_VERTICAL_SD_M_S, DeviceTime, Measurement, Position, Value,
    framed::{Format, ParseOutcome},
};

const STX_V1: u8 = 0xfe;
const STX_V2: u8 = 0xfd;
const HEADER_V1_BYTES: usize = 6;
const HEADER_V2_BYTES: usize = 10;
const CHECKSUM_BYTES: usize = 2;
const SIGNATURE_BYTES: usize = 13;
const FLAG_SIGNED: u8 = 1;

const STANDARD_GRAVITY_M_S2: f64 = 9.80665;
const UT_PER_GAUSS: f64 = 100.0;
const UT_PER_MGAUSS: f64 = 0.1;
/// Smallest `time_usec` that counts as UNIX time: 2001-09-09.
const MIN_UNIX_TIME_US: u64 = 1_000_000_000_000_000;
/// Speed or course value that means "unknown".
const UNKNOWN: u16 = u16::MAX;

/// MAVLink format, with the selected system and IMU message.
#[derive(Debug, Clone, Default)]
pub struct Mavlink {
    settings: MavlinkSettings,
    system: Option<u8>,
    imu: Option<ImuMessage>,
}

/// Selection of system and messages. Unset parts are selected automatically.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct MavlinkSettings {
    /// System to decode; `None` selects the first one that sends a usable message.
    pub system_id: Option<u8>,
    /// Message to take rate and force from; `None` selects whichever arrives first.
    pub imu: Option<ImuMessage>,
    /// Message to take the velocity from.
    pub fix: FixMessage,
    /// Units of RAW_IMU; `None` ignores the message.
    pub raw_scale: Option<RawScale>,
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
    /// Rate unit, rad/s.
    pub rate_rad_s: f64,
    /// Force unit, m/s².
    pub force_m_s2: f64,
    /// Field unit, µT.
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
        Self { settings, system: settings.system_id, imu: settings.imu }
    }

    fn process(&mut self, header: &Header, payload: &[u8], measurements: &mut Vec<Measurement>) {
        if self.system.is_some_and(|system| system != header.system) {
            return;
        }
        let measurement = match header.message {
            HIGHRES_IMU_DATA::ID => self.accept_imu(ImuMessage::HighresImu, || highres(&decode(header, payload)?)),
            SCALED_IMU_DATA::ID => self.accept_imu(ImuMessage::ScaledImu, || scaled(&decode(header, payload)?)),
            SCALED_IMU2_DATA::ID => self.accept_imu(ImuMessage::ScaledImu2, || scaled2(&decode(header, payload)?)),
            SCALED_IMU3_DATA::ID => self.accept_imu(ImuMessage::ScaledImu3, || scaled3(&decode(header, payload)?)),
            RAW_IMU_DATA::ID => self
                .settings
                .raw_scale
                .and_then(|scale| self.accept_imu(ImuMessage::RawImu, || raw(&decode(header, payload)?, &scale))),
            GPS_RAW_INT_DATA::ID if self.settings.fix == FixMessage::GpsRawInt => {
                decode(header, payload).and_then(|message| gps_raw(&message))
            }
            GLOBAL_POSITION_INT_DATA::ID if self.settings.fix == FixMessage::GlobalPositionInt => {
                decode(header, payload).and_then(|message| global_position(&message))
            }
            _ => None,
        };
        if measurement.is_some() {
            self.system = Some(header.system);
        }
        measurements.extend(measurement);
    }

    /// Decodes a message of `kind` if that kind is selected. If none is selected, the first kind
    /// that yields a measurement becomes selected.
    fn accept_imu(
        &mut self,
        kind: ImuMessage,
        measurement: impl FnOnce() -> Option<Measurement>,
    ) -> Option<Measurement> {
        // RAW_IMU has no unit, so it is never selected automatically.
        let is_selected = match self.imu {
            Some(selected) => selected == kind,
            None => kind != ImuMessage::RawImu,
        };
        let measurement = is_selected.then(measurement)??;
        self.imu = Some(kind);
        Some(measurement)
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
        let checksum = calculate_crc(&covered[1..], header.extra_crc);
        if !rest.starts_with(&checksum.to_le_bytes()) {
            return ParseOutcome::Rejected;
        }
        self.process(&header, &covered[header.bytes..], measurements);
        ParseOutcome::Frame(frame.len())
    }
}

/// Header of a frame.
struct Header {
    version: MavlinkVersion,
    bytes: usize,
    payload_bytes: usize,
    signature_bytes: usize,
    system: u8,
    message: u32,
    /// CRC seed derived from the definition of the message.
    extra_crc: u8,
}

impl Header {
    fn parse(bytes: &[u8]) -> Result<Self, ParseOutcome> {
        let (version, head_bytes, signature_bytes) = match *bytes {
            [STX_V1, ..] => (MavlinkVersion::V1, HEADER_V1_BYTES, 0),
            [STX_V2, _, 0, ..] => (MavlinkVersion::V2, HEADER_V2_BYTES, 0),
            [STX_V2, _, FLAG_SIGNED, ..] => (MavlinkVersion::V2, HEADER_V2_BYTES, SIGNATURE_BYTES),
            [STX_V2] | [STX_V2, _] => return Err(ParseOutcome::Incomplete),
            _ => return Err(ParseOutcome::Skip(1)),
        };
        let Some(header) = bytes.get(..head_bytes) else { return Err(ParseOutcome::Incomplete) };
        let (system, message) = match version {
            MavlinkVersion::V1 => (header[3], u32::from(header[5])),
            MavlinkVersion::V2 => (header[5], u32::from_le_bytes([header[7], header[8], header[9], 0])),
        };
        // If the message is unknown, its checksum cannot be verified.
        if MavMessage::default_message_from_id(message).is_none() {
            return Err(ParseOutcome::Skip(1));
        }
        Ok(Self {
            version,
            bytes: head_bytes,
            payload_bytes: header[1].into(),
            signature_bytes,
            system,
            message,
            extra_crc: MavMessage::extra_crc(message),
        })
    }

    fn frame_bytes(&self) -> usize {
        self.bytes + self.payload_bytes + CHECKSUM_BYTES + self.signature_bytes
    }
}

fn decode<D: MessageData>(header: &Header, payload: &[u8]) -> Option<D> {
    D::deser(header.version, payload).ok()
}

fn highres(message: &HIGHRES_IMU_DATA) -> Option<Measurement> {
    use HighresImuUpdatedFlags as Updated;
    let force =
        Updated::HIGHRES_IMU_UPDATED_XACC | Updated::HIGHRES_IMU_UPDATED_YACC | Updated::HIGHRES_IMU_UPDATED_ZACC;
    let rate =
        Updated::HIGHRES_IMU_UPDATED_XGYRO | Updated::HIGHRES_IMU_UPDATED_YGYRO | Updated::HIGHRES_IMU_UPDATED_ZGYRO;
    let field =
        Updated::HIGHRES_IMU_UPDATED_XMAG | Updated::HIGHRES_IMU_UPDATED_YMAG | Updated::HIGHRES_IMU_UPDATED_ZMAG;
    if message.id != 0 {
        return None;
    }
    let gauss = [message.xmag, message.ymag, message.zmag];
    let field_ut =
        message.fields_updated.contains(field).then(|| frd_to_rfu(gauss.map(|part| f64::from(part) * UT_PER_GAUSS)));
    let value = if message.fields_updated.contains(force | rate) {
        let rate_rad_s = frd_to_rfu([message.xgyro, message.ygyro, message.zgyro].map(f64::from));
        let force_m_s2 = frd_to_rfu([message.xacc, message.yacc, message.zacc].map(f64::from));
        Value::Imu { rate_rad_s, force_m_s2, field_ut }
    } else {
        Value::Field(field_ut?)
    };
    Some(Measurement { time: timestamp(message.time_usec), value })
}

macro_rules! scaled {
    ($($name:ident of $message:ident),*) => { $(
        fn $name(message: &$message) -> Option<Measurement> {
            let time = Some(since_boot(message.time_boot_ms));
            let field = [message.xmag, message.ymag, message.zmag];
            let (rate, force) = ([message.xgyro, message.ygyro, message.zgyro], [message.xacc, message.yacc, message.zacc]);
            Some(Measurement { time, value: RawScale::ARDUPILOT.imu(rate, force, field) })
        }
    )* };
}

scaled!(scaled of SCALED_IMU_DATA, scaled2 of SCALED_IMU2_DATA, scaled3 of SCALED_IMU3_DATA);

fn raw(message: &RAW_IMU_DATA, scale: &RawScale) -> Option<Measurement> {
    if message.id != 0 {
        return None;
    }
    let field = [message.xmag, message.ymag, message.zmag];
    let (rate, force) = ([message.xgyro, message.ygyro, message.zgyro], [message.xacc, message.yacc, message.zacc]);
    Some(Measurement { time: timestamp(message.time_usec), value: scale.imu(rate, force, field) })
}

impl RawScale {
    /// Converts raw numbers. A field of zero indicates that there is no magnetometer.
    fn imu(&self, rate: [i16; 3], force: [i16; 3], field: [i16; 3]) -> Value {
        let in_units_of = |unit: f64| move |part: i16| f64::from(part) * unit;
        Value::Imu {
            rate_rad_s: frd_to_rfu(rate.map(in_units_of(self.rate_rad_s))),
            force_m_s2: frd_to_rfu(force.map(in_units_of(self.force_m_s2))),
            field_ut: (field != [0; 3]).then(|| frd_to_rfu(field.map(in_units_of(self.field_ut)))),
        }
    }
}

/// Converts (forward, right, down) to (right, forward, up).
fn frd_to_rfu([forward, right, down]: [f64; 3]) -> [f64; 3] {
    [right, forward, -down]
}

fn gps_raw(message: &GPS_RAW_INT_DATA) -> Option<Measurement> {
    if matches!(message.fix_type, GpsFixType::GPS_FIX_TYPE_NO_GPS | GpsFixType::GPS_FIX_TYPE_NO_FIX)
        || message.vel == UNKNOWN
        || message.cog == UNKNOWN
    {
        return None;
    }
    let (speed_m_s, (east, north)) =
        (f64::from(message.vel) / 100.0, (f64::from(message.cog) / 100.0).to_radians().sin_cos());
    let sd_m_s = (f64::from(message.vel_acc) / 1000.0).max(ASSUMED_VERTICAL_SD_M_S);
    let value = Value::Fix {
        velocity_m_s: [speed_m_s * east, speed_m_s * north, 0.0],
        sd_m_s: Some(sd_m_s),
        position: position(message.lat, message.lon, message.alt),
    };
    Some(Measurement { time: timestamp(message.time_usec), value })
}

fn global_position(message: &GLOBAL_POSITION_INT_DATA) -> Option<Measurement> {
    let [north, east, down] = [message.vx, message.vy, message.vz].map(|part| f64::from(part) / 100.0);
    let value = Value::Fix {
        velocity_m_s: [east, north, -down],
        sd_m_s: None,
        position: position(message.lat, message.lon, message.alt),
    };
    Some(Measurement { time: Some(since_boot(message.time_boot_ms)), value })
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
