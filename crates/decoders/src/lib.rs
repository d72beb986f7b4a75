//! What sensors and receivers send, as readings: bytes of a serial line, a datagram or a file become [`Measurement`]s.
//!
//! Input: bytes as they arrive, cut anywhere. Output: measurements in SI units and the sensor's own axes, with the device's own time
//! where it tells one. Time: none; whoever has the bytes knows when they came. Failure: bytes that are no frame of the format are
//! skipped and counted, never an error and never a panic; the next good frame is found again.
//!
//! A decoder is [`Framed`] with the [`Format`] of a device in it, as `Framed::new(Rvc::default())`.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`framed`] | frames in bytes that are cut anywhere and may be anything |
//! | [`witmotion`] | WitMotion: frames of 0x55 |
//! | [`xsens`] | Xsens MTi: MTData2 |
//! | [`rvc`] | BNO08x: UART-RVC |
//! | [`lines`] | lines of numbers with named columns |
//! | [`mavlink`] | MAVLink: the IMU and the receiver of an autopilot |
//! | [`ubx`] | u-blox: NAV-PVT |
//! | [`nmea`] | NMEA 0183: RMC, VTG |
//! | [`iio`] | Linux industrial I/O: records of a character device |
#![forbid(unsafe_code)]

pub mod framed;
pub mod iio;
pub mod lines;
pub mod mavlink;
pub mod nmea;
pub mod rvc;
pub mod ubx;
pub mod witmotion;
pub mod xsens;

pub use framed::{Format, Framed};

/// Standard deviation of a velocity whose vertical part is not told and given as 0, m/s: the vertical motion of what moves on ground
/// and water.
pub const VERTICAL_SD_M_S: f64 = 1.0;

/// Turns the bytes of one device into measurements.
pub trait Decoder: Send {
    /// Takes the next bytes and adds what is complete to `found`, in the order in which it was sent. What is left of a frame that has
    /// not ended is kept, as much as one frame of the format has at most.
    fn push(&mut self, bytes: &[u8], found: &mut Vec<Measurement>);

    /// What it has seen so far.
    fn counts(&self) -> Counts;
}

/// What a device measured at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measurement {
    /// When, if the device says so.
    pub time: Option<DeviceTime>,
    /// What.
    pub value: Value,
}

/// What was measured, in sensor axes unless a frame is named.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Value {
    /// Both of an IMU.
    Imu {
        /// Body rate, rad/s.
        rate_rad_s: [f64; 3],
        /// Specific force, m/s².
        force_m_s2: [f64; 3],
        /// Magnetic field, µT, where the same instant has one.
        field_ut: Option<[f64; 3]>,
    },
    /// A magnetometer that speaks for itself, µT.
    Field([f64; 3]),
    /// A satellite receiver.
    Fix {
        /// Velocity east, north, up, m/s.
        velocity_m_s: [f64; 3],
        /// Its standard deviation per axis, m/s, where it is told.
        sd_m_s: Option<f64>,
        /// Where the receiver is.
        place: Place,
    },
}

/// Where a receiver is, as far as it tells.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Place {
    /// Geodetic latitude, rad, north positive.
    pub latitude_rad: Option<f64>,
    /// Longitude, rad, east positive.
    pub longitude_rad: Option<f64>,
    /// Altitude above the sea, m, upwards.
    pub altitude_m: Option<f64>,
}

/// A time as a device tells it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DeviceTime {
    /// A counter that begins again at `period_ns`, ns since it did.
    Counter {
        /// The count, ns.
        now_ns: u64,
        /// After which it begins again, ns.
        period_ns: u64,
    },
    /// Since the device started, ns.
    SinceBoot {
        /// ns.
        now_ns: u64,
    },
    /// Since 1970, ns.
    Unix {
        /// ns.
        now_ns: u64,
    },
}

/// What a decoder has seen so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Whole frames or lines of which something was made, or that tell nothing of use.
    pub frames: u64,
    /// Frames or lines that looked like one and were refused: checksum, length, a number that is none.
    pub refused: u64,
    /// Bytes that belong to no frame.
    pub skipped_bytes: u64,
}

impl std::ops::Add for Counts {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            frames: self.frames + other.frames,
            refused: self.refused + other.refused,
            skipped_bytes: self.skipped_bytes + other.skipped_bytes,
        }
    }
}

impl Place {
    /// Of degrees and metres; what cannot be is not told.
    pub(crate) fn of(latitude_deg: f64, longitude_deg: f64, altitude_m: f64) -> Self {
        let within = |angle_deg: f64, most_deg: f64| (angle_deg.abs() <= most_deg).then(|| angle_deg.to_radians());
        Self {
            latitude_rad: within(latitude_deg, 90.0),
            longitude_rad: within(longitude_deg, 180.0),
            altitude_m: Some(altitude_m).filter(|altitude_m| altitude_m.is_finite()),
        }
    }
}
