//! MAVLink 1 and 2 from an autopilot: its IMU and its satellite receiver.
//!
//! | message | what is made of it |
//! | --- | --- |
//! | HIGHRES_IMU | rate and force, if `fields_updated` says that all six were measured; the field where it says so of it, else by itself; of the first IMU (`id` 0) |
//! | SCALED_IMU, SCALED_IMU2, SCALED_IMU3 | mrad/s, mg, mgauss |
//! | RAW_IMU | numbers without a unit: read only if it is named and [`RawScale`] says what they stand for |
//! | GPS_RAW_INT | ground speed and course; see below |
//! | GLOBAL_POSITION_INT | velocity as the autopilot estimates it; only if it is named |
//! | others | counted |
//!
//! One kind of IMU message is read: the one that is named, else the first that comes. One system is heard: the one that is named, else
//! the first from which something of use comes. Axes: MAVLink's forward, right, down are turned to right, forward, up, and its north,
//! east, down to east, north, up. So no mounting is needed: the autopilot has taken its own out.
//!
//! Time: `time_usec` counts from the start or from 1970, which its size tells; `time_boot_ms` from the start, in steps of 1 ms.
//! GPS_RAW_INT has no vertical velocity: it is given as 0 with a standard deviation of [`crate::VERTICAL_SD_M_S`] or more, which suits
//! what moves on ground and water. GLOBAL_POSITION_INT has one, but is made with the autopilot's own IMU.
//!
//! Limits: signatures are not checked; messages that the dialect `ardupilotmega` (with `common`) does not know cannot be told from
//! other bytes, and count as those.

use mavlink::{
    MavlinkVersion, Message, MessageData, calculate_crc,
    dialects::ardupilotmega::{
        GLOBAL_POSITION_INT_DATA, GPS_RAW_INT_DATA, GpsFixType, HIGHRES_IMU_DATA, HighresImuUpdatedFlags, MavMessage,
        RAW_IMU_DATA, SCALED_IMU_DATA, SCALED_IMU2_DATA, SCALED_IMU3_DATA,
    },
};

use crate::{
    DeviceTime, Measurement, Place, VERTICAL_SD_M_S, Value,
    framed::{Format, Seen},
};

const BEGIN_1: u8 = 0xfe;
const BEGIN_2: u8 = 0xfd;
const HEAD_1_BYTES: usize = 6;
const HEAD_2_BYTES: usize = 10;
const CHECKSUM_BYTES: usize = 2;
const SIGNATURE_BYTES: usize = 13;
const SIGNED: u8 = 1;

const STANDARD_GRAVITY_M_S2: f64 = 9.80665;
const UT_PER_GAUSS: f64 = 100.0;
const UT_PER_MGAUSS: f64 = 0.1;
/// `time_usec` from here on counts from 1970: 2001-09-09.
const UNIX_FROM_US: u64 = 1_000_000_000_000_000;
/// A speed or a course that is not known.
const UNKNOWN: u16 = u16::MAX;

/// What is read of a system, and which.
#[derive(Debug, Clone, Default)]
pub struct Mavlink {
    settings: Settings,
    system: Option<u8>,
    imu: Option<ImuMessage>,
}

/// What is named; what is not, is found.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Settings {
    /// The system to hear; the first from which something of use comes where none is named.
    pub system: Option<u8>,
    /// The message to read rate and force of; the first that comes where none is named.
    pub imu: Option<ImuMessage>,
    /// The message to read the velocity of.
    pub fix: FixMessage,
    /// What the numbers of RAW_IMU stand for.
    pub raw: Option<RawScale>,
}

/// A message with rate and force.
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

/// A message with a velocity over ground.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum FixMessage {
    /// GPS_RAW_INT: as the receiver says it.
    #[default]
    GpsRawInt,
    /// GLOBAL_POSITION_INT: as the autopilot estimates it.
    GlobalPositionInt,
    /// None of them.
    Nothing,
}

/// What one unit of each number of RAW_IMU stands for; ArduPilot sends mrad/s, mg and mgauss.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RawScale {
    /// Of the rate, rad/s.
    pub rate_rad_s: f64,
    /// Of the force, m/s².
    pub force_m_s2: f64,
    /// Of the field, µT.
    pub field_ut: f64,
}

impl RawScale {
    /// mrad/s, mg, mgauss: as ArduPilot sends RAW_IMU, and everybody the scaled messages.
    pub const ARDUPILOT: Self =
        Self { rate_rad_s: 1e-3, force_m_s2: STANDARD_GRAVITY_M_S2 / 1000.0, field_ut: UT_PER_MGAUSS };
}

impl Mavlink {
    /// What `settings` say.
    pub fn new(settings: Settings) -> Self {
        Self { settings, system: settings.system, imu: settings.imu }
    }

    fn take(&mut self, head: &Head, payload: &[u8], found: &mut Vec<Measurement>) {
        if self.system.is_some_and(|system| system != head.system) {
            return;
        }
        let measured = match head.message {
            HIGHRES_IMU_DATA::ID => self.of_imu(ImuMessage::HighresImu, || highres(&read(head, payload)?)),
            SCALED_IMU_DATA::ID => self.of_imu(ImuMessage::ScaledImu, || scaled(&read(head, payload)?)),
            SCALED_IMU2_DATA::ID => self.of_imu(ImuMessage::ScaledImu2, || scaled2(&read(head, payload)?)),
            SCALED_IMU3_DATA::ID => self.of_imu(ImuMessage::ScaledImu3, || scaled3(&read(head, payload)?)),
            RAW_IMU_DATA::ID => self
                .settings
                .raw
                .and_then(|scale| self.of_imu(ImuMessage::RawImu, || raw(&read(head, payload)?, &scale))),
            GPS_RAW_INT_DATA::ID if self.settings.fix == FixMessage::GpsRawInt => {
                read(head, payload).and_then(|said| receiver(&said))
            }
            GLOBAL_POSITION_INT_DATA::ID if self.settings.fix == FixMessage::GlobalPositionInt => {
                read(head, payload).and_then(|said| estimate(&said))
            }
            _ => None,
        };
        if measured.is_some() {
            self.system = Some(head.system);
        }
        found.extend(measured);
    }

    /// What a message of this kind says, if it is the kind to read.
    fn of_imu(&mut self, kind: ImuMessage, measured: impl FnOnce() -> Option<Measurement>) -> Option<Measurement> {
        // RAW_IMU is read only where it is named.
        let is_wanted = match self.imu {
            Some(wanted) => wanted == kind,
            None => kind != ImuMessage::RawImu,
        };
        let measured = is_wanted.then(measured)??;
        self.imu = Some(kind);
        Some(measured)
    }
}

impl Format for Mavlink {
    fn look(&mut self, bytes: &[u8], found: &mut Vec<Measurement>) -> Seen {
        let head = match Head::of(bytes) {
            Ok(head) => head,
            Err(seen) => return seen,
        };
        let Some(frame) = bytes.get(..head.frame_bytes()) else { return Seen::More };
        let (covered, rest) = frame.split_at(head.bytes + head.payload_bytes);
        let checksum = calculate_crc(&covered[1..], head.extra);
        if !rest.starts_with(&checksum.to_le_bytes()) {
            return Seen::Refused;
        }
        self.take(&head, &covered[head.bytes..], found);
        Seen::Frame(frame.len())
    }
}

/// The beginning of a frame.
struct Head {
    version: MavlinkVersion,
    bytes: usize,
    payload_bytes: usize,
    signature_bytes: usize,
    system: u8,
    message: u32,
    /// What the checksum has beside the bytes: a sum of the message's definition.
    extra: u8,
}

impl Head {
    fn of(bytes: &[u8]) -> Result<Self, Seen> {
        let (version, head_bytes, signature_bytes) = match *bytes {
            [BEGIN_1, ..] => (MavlinkVersion::V1, HEAD_1_BYTES, 0),
            [BEGIN_2, _, 0, ..] => (MavlinkVersion::V2, HEAD_2_BYTES, 0),
            [BEGIN_2, _, SIGNED, ..] => (MavlinkVersion::V2, HEAD_2_BYTES, SIGNATURE_BYTES),
            [BEGIN_2] | [BEGIN_2, _] => return Err(Seen::More),
            _ => return Err(Seen::Nothing(1)),
        };
        let Some(head) = bytes.get(..head_bytes) else { return Err(Seen::More) };
        let (system, message) = match version {
            MavlinkVersion::V1 => (head[3], u32::from(head[5])),
            MavlinkVersion::V2 => (head[5], u32::from_le_bytes([head[7], head[8], head[9], 0])),
        };
        // Another message than any that is known.
        if MavMessage::default_message_from_id(message).is_none() {
            return Err(Seen::Nothing(1));
        }
        Ok(Self {
            version,
            bytes: head_bytes,
            payload_bytes: head[1].into(),
            signature_bytes,
            system,
            message,
            extra: MavMessage::extra_crc(message),
        })
    }

    fn frame_bytes(&self) -> usize {
        self.bytes + self.payload_bytes + CHECKSUM_BYTES + self.signature_bytes
    }
}

fn read<D: MessageData>(head: &Head, payload: &[u8]) -> Option<D> {
    D::deser(head.version, payload).ok()
}

fn highres(said: &HIGHRES_IMU_DATA) -> Option<Measurement> {
    use HighresImuUpdatedFlags as Updated;
    let force =
        Updated::HIGHRES_IMU_UPDATED_XACC | Updated::HIGHRES_IMU_UPDATED_YACC | Updated::HIGHRES_IMU_UPDATED_ZACC;
    let rate =
        Updated::HIGHRES_IMU_UPDATED_XGYRO | Updated::HIGHRES_IMU_UPDATED_YGYRO | Updated::HIGHRES_IMU_UPDATED_ZGYRO;
    let field =
        Updated::HIGHRES_IMU_UPDATED_XMAG | Updated::HIGHRES_IMU_UPDATED_YMAG | Updated::HIGHRES_IMU_UPDATED_ZMAG;
    if said.id != 0 {
        return None;
    }
    let gauss = [said.xmag, said.ymag, said.zmag];
    let field_ut =
        said.fields_updated.contains(field).then(|| turned(gauss.map(|part| f64::from(part) * UT_PER_GAUSS)));
    let value = if said.fields_updated.contains(force | rate) {
        let rate_rad_s = turned([said.xgyro, said.ygyro, said.zgyro].map(f64::from));
        let force_m_s2 = turned([said.xacc, said.yacc, said.zacc].map(f64::from));
        Value::Imu { rate_rad_s, force_m_s2, field_ut }
    } else {
        Value::Field(field_ut?)
    };
    Some(Measurement { time: time_of_us(said.time_usec), value })
}

macro_rules! scaled {
    ($($name:ident of $message:ident),*) => { $(
        fn $name(said: &$message) -> Option<Measurement> {
            let time = Some(since_boot(said.time_boot_ms));
            let field = [said.xmag, said.ymag, said.zmag];
            let (rate, force) = ([said.xgyro, said.ygyro, said.zgyro], [said.xacc, said.yacc, said.zacc]);
            Some(Measurement { time, value: RawScale::ARDUPILOT.imu(rate, force, field) })
        }
    )* };
}

scaled!(scaled of SCALED_IMU_DATA, scaled2 of SCALED_IMU2_DATA, scaled3 of SCALED_IMU3_DATA);

fn raw(said: &RAW_IMU_DATA, scale: &RawScale) -> Option<Measurement> {
    if said.id != 0 {
        return None;
    }
    let field = [said.xmag, said.ymag, said.zmag];
    let (rate, force) = ([said.xgyro, said.ygyro, said.zgyro], [said.xacc, said.yacc, said.zacc]);
    Some(Measurement { time: time_of_us(said.time_usec), value: scale.imu(rate, force, field) })
}

impl RawScale {
    /// A field of nothing is none: the earth has one everywhere.
    fn imu(&self, rate: [i16; 3], force: [i16; 3], field: [i16; 3]) -> Value {
        let of = |unit: f64| move |part: i16| f64::from(part) * unit;
        Value::Imu {
            rate_rad_s: turned(rate.map(of(self.rate_rad_s))),
            force_m_s2: turned(force.map(of(self.force_m_s2))),
            field_ut: (field != [0; 3]).then(|| turned(field.map(of(self.field_ut)))),
        }
    }
}

/// Of forward, right, down to right, forward, up.
fn turned([forward, right, down]: [f64; 3]) -> [f64; 3] {
    [right, forward, -down]
}

fn receiver(said: &GPS_RAW_INT_DATA) -> Option<Measurement> {
    if matches!(said.fix_type, GpsFixType::GPS_FIX_TYPE_NO_GPS | GpsFixType::GPS_FIX_TYPE_NO_FIX)
        || said.vel == UNKNOWN
        || said.cog == UNKNOWN
    {
        return None;
    }
    let (speed_m_s, (east, north)) =
        (f64::from(said.vel) / 100.0, (f64::from(said.cog) / 100.0).to_radians().sin_cos());
    let sd_m_s = (f64::from(said.vel_acc) / 1000.0).max(VERTICAL_SD_M_S);
    let value = Value::Fix {
        velocity_m_s: [speed_m_s * east, speed_m_s * north, 0.0],
        sd_m_s: Some(sd_m_s),
        place: place(said.lat, said.lon, said.alt),
    };
    Some(Measurement { time: time_of_us(said.time_usec), value })
}

fn estimate(said: &GLOBAL_POSITION_INT_DATA) -> Option<Measurement> {
    let [north, east, down] = [said.vx, said.vy, said.vz].map(|part| f64::from(part) / 100.0);
    let value =
        Value::Fix { velocity_m_s: [east, north, -down], sd_m_s: None, place: place(said.lat, said.lon, said.alt) };
    Some(Measurement { time: Some(since_boot(said.time_boot_ms)), value })
}

/// Of units of 1e-7° and of mm.
fn place(latitude: i32, longitude: i32, altitude_mm: i32) -> Place {
    let degrees = |angle: i32| f64::from(angle) / 1e7;
    Place::of(degrees(latitude), degrees(longitude), f64::from(altitude_mm) / 1000.0)
}

fn since_boot(ms: u32) -> DeviceTime {
    DeviceTime::SinceBoot { now_ns: u64::from(ms) * 1_000_000 }
}

/// `None` of nothing, which says that there is no clock.
fn time_of_us(us: u64) -> Option<DeviceTime> {
    let now_ns = us.checked_mul(1000).filter(|ns| *ns > 0)?;
    Some(if us >= UNIX_FROM_US { DeviceTime::Unix { now_ns } } else { DeviceTime::SinceBoot { now_ns } })
}
