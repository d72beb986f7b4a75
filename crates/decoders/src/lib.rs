//! Decoders that turn the bytes of sensors and receivers into [`Measurement`]s.
//!
//! Input: bytes of a serial line, datagram or file, split at arbitrary positions.
//!
//! Output: measurements in SI units and sensor axes, with the device's timestamp if the format has
//! one.
//!
//! Time: supplied by the caller with [`Decoder::set_time`]. If a stream carries several senders,
//! the decoder uses the time to notice that one of them is silent.
//!
//! Failure: bytes that belong to no valid frame are skipped and counted. Decoding resumes at the
//! next valid frame. No input causes an error or a panic.
//!
//! A decoder is a [`Framed`] around the [`Format`] of a device, for example
//! `Framed::new(Rvc::default())`.
//!
//! | module | contents |
//! | --- | --- |
//! | [`framed`] | search for frames in an arbitrarily split byte stream |
//! | [`witmotion`] | WitMotion sensors: 0x55 frames |
//! | [`xsens`] | Xsens MTi: MTData2 |
//! | [`rvc`] | BNO08x: UART-RVC |
//! | [`lines`] | lines of numbers with named columns |
//! | [`mavlink`] | MAVLink: IMU and satellite receiver of an autopilot |
//! | [`ubx`] | u-blox: NAV-PVT |
//! | [`nmea`] | NMEA 0183: RMC, VTG |
//! | [`iio`] | Linux industrial I/O: records of a character device |
//! | [`sender_choice`] | choice of one sender among several |
#![forbid(unsafe_code)]

pub mod framed;
pub mod iio;
pub mod lines;
pub mod mavlink;
pub mod nmea;
pub mod rvc;
pub mod sender_choice;
pub mod ubx;
pub mod witmotion;
pub mod xsens;

use std::time::Duration;

pub use framed::{Format, Framed};
pub use sender_choice::{SENDER_TIMEOUT, SenderChoice};

/// Standard deviation, in m/s, assumed for a velocity without a reported vertical component. This
/// component is then set to 0.
///
/// The value covers the vertical motion of ground vehicles and boats.
pub const ASSUMED_VERTICAL_SD_M_S: f64 = 1.0;

/// Decoder of the byte stream of one device.
pub trait Decoder: Send {
    /// Decodes `bytes` and appends the completed measurements in the order of transmission.
    ///
    /// An incomplete frame is kept for the next call, up to the maximum frame size of the format.
    fn push(&mut self, bytes: &[u8], measurements: &mut Vec<Measurement>);

    /// Sets the arrival time of the bytes that follow, relative to any fixed instant.
    fn set_time(&mut self, _now: Duration) {}

    /// Returns the totals since the decoder was created.
    fn counts(&self) -> Counts;
}

/// Measurement of a device at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measurement {
    /// Timestamp of the device, or `None` if the device sends none.
    pub time: Option<DeviceTime>,
    /// Measured quantities.
    pub value: Value,
}

/// Measured quantities, in sensor axes unless a frame is named.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Value {
    /// Rate and specific force of an IMU.
    Imu {
        /// Body rate, rad/s.
        rate_rad_s: [f64; 3],
        /// Specific force, m/s².
        force_m_s2: [f64; 3],
        /// Magnetic field at the same instant in µT, if present.
        field_ut: Option<[f64; 3]>,
    },
    /// Magnetic field sent separately from rate and force, µT.
    Field([f64; 3]),
    /// Fix of a satellite receiver.
    Fix {
        /// Velocity east, north, up, m/s.
        velocity_m_s: [f64; 3],
        /// Standard deviation of each velocity component, m/s, if reported.
        sd_m_s: Option<f64>,
        /// Position of the receiver.
        position: Position,
    },
}

/// Position of a receiver. Unreported coordinates are `None`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Position {
    /// Geodetic latitude, rad, north positive.
    pub latitude_rad: Option<f64>,
    /// Longitude, rad, east positive.
    pub longitude_rad: Option<f64>,
    /// Altitude above mean sea level, m, up positive.
    pub altitude_m: Option<f64>,
}

/// Timestamp on the clock of a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DeviceTime {
    /// Counter that wraps to 0 after `period_ns`.
    Counter {
        /// Time since the last wrap, ns.
        now_ns: u64,
        /// Wrap period, ns.
        period_ns: u64,
    },
    /// Time since the device started.
    SinceBoot {
        /// Time since the start, ns.
        now_ns: u64,
    },
    /// UNIX time.
    Unix {
        /// Time since 1970-01-01 UTC, ns.
        now_ns: u64,
    },
}

/// Totals of a decoder since its creation.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Valid frames or lines, including those without a measurement.
    pub frames: u64,
    /// Frames or lines rejected because of their checksum, length or an invalid number.
    pub rejected: u64,
    /// Bytes that belong to no valid frame.
    pub skipped_bytes: u64,
    /// Valid frames with a measurement that was not used because of its sender.
    pub foreign: u64,
    /// Rejected lines with a date of which the first number may be the month or the day.
    pub ambiguous_dates: u64,
}

impl std::ops::Add for Counts {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            frames: self.frames + other.frames,
            rejected: self.rejected + other.rejected,
            skipped_bytes: self.skipped_bytes + other.skipped_bytes,
            foreign: self.foreign + other.foreign,
            ambiguous_dates: self.ambiguous_dates + other.ambiguous_dates,
        }
    }
}

impl Position {
    /// Creates a position from degrees and metres. Values out of range become `None`.
    pub(crate) fn from_degrees(latitude_deg: f64, longitude_deg: f64, altitude_m: f64) -> Self {
        let in_range = |angle_deg: f64, max_deg: f64| (angle_deg.abs() <= max_deg).then(|| angle_deg.to_radians());
        Self {
            latitude_rad: in_range(latitude_deg, 90.0),
            longitude_rad: in_range(longitude_deg, 180.0),
            altitude_m: Some(altitude_m).filter(|altitude_m| altitude_m.is_finite()),
        }
    }
}
