//! For whoever feeds a running system: readings of a sensor and fixes of a receiver, given to `ingest` over the bus.
//!
//! Input: measurements in SI units and the sensor's own axes. Output: the topics `sensor` and `receiver` of a system whose launch file says
//! `[ingest] source = "bus"`. Time: the measurement's, in ns on a clock that does not run backward; [`clock_fit`] makes such a time of what a
//! device tells. Failure: a system that does not run, or whose ingest has not opened the topic, is named; the program asks again.
//!
//! ```no_run
//! let mut sensor = driver::Sensor::open("plumbline")?;
//! sensor.send(1_000_000, [0.0, 0.0, 0.1], [0.0, 0.0, 9.81], None)?;
//! # Ok::<(), driver::DriverError>(())
//! ```
#![forbid(unsafe_code)]

pub mod clock_fit;
mod feed;

use std::time::Duration;

use messages::{ReceiverReading, SensorReading};

pub use bus::BusError;
pub use clock_fit::{ClockFit, Stamp};

use feed::Feed;

/// How often a feed looks whether the system is still the one that it joined.
pub(crate) const LOOK_INTERVAL: Duration = Duration::from_millis(100);

/// An IMU of a running system, with or without a magnetometer.
#[derive(Debug)]
pub struct Sensor(Feed<SensorReading>);

impl Sensor {
    /// Joins the system of this name. How much its topic holds, it says itself: [`holds`](Self::holds).
    pub fn open(system: &str) -> Result<Self, DriverError> {
        Feed::open(system).map(Self)
    }

    /// Publishes a reading; never waits. `t_ns` is when it was taken, on the sensor's clock; `rate_rad_s` and `force_m_s2` are in its axes, and
    /// so is `field_ut`, where this reading has one.
    ///
    /// Of a system that was started anew meanwhile it joins the new one. Where there is none the reading is gone, and the error says so.
    pub fn send(
        &mut self,
        t_ns: i64,
        rate_rad_s: [f64; 3],
        force_m_s2: [f64; 3],
        field_ut: Option<[f64; 3]>,
    ) -> Result<(), DriverError> {
        let field_ut = field_ut.unwrap_or([f64::NAN; 3]);
        self.0.send(&SensorReading { t_sensor_ns: t_ns, rate_rad_s, force_m_s2, field_ut })
    }

    /// Readings that the system holds until ingest takes them; of more at once the oldest are overwritten.
    pub fn holds(&self) -> usize {
        self.0.holds()
    }
}

/// A satellite receiver of a running system.
#[derive(Debug)]
pub struct Receiver(Feed<ReceiverReading>);

impl Receiver {
    /// Joins the system of this name.
    pub fn open(system: &str) -> Result<Self, DriverError> {
        Feed::open(system).map(Self)
    }

    /// Publishes a fix; it goes with the next reading of the sensor. `velocity_m_s` is over ground, east, north, up.
    pub fn send(&mut self, velocity_m_s: [f64; 3], known: Known) -> Result<(), DriverError> {
        let told = |value: Option<f64>| value.unwrap_or(f64::NAN);
        self.0.send(&ReceiverReading {
            velocity_m_s,
            velocity_sd_m_s: told(known.sd_m_s),
            age_s: told(known.age_s),
            latitude_rad: told(known.latitude_rad),
            longitude_rad: told(known.longitude_rad),
            altitude_m: told(known.altitude_m),
        })
    }

    /// Fixes that the system holds until ingest takes them.
    pub fn holds(&self) -> usize {
        self.0.holds()
    }
}

/// What a receiver knows beside the velocity.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Known {
    /// Standard deviation of each component of the velocity, m/s.
    pub sd_m_s: Option<f64>,
    /// How old the velocity is on arrival, s.
    pub age_s: Option<f64>,
    /// Geodetic latitude, rad, north positive.
    pub latitude_rad: Option<f64>,
    /// Longitude, rad, east positive.
    pub longitude_rad: Option<f64>,
    /// Altitude as the receiver gives it, m.
    pub altitude_m: Option<f64>,
}

/// Why a reading was not given to a system.
#[derive(Debug, thiserror::Error)]
pub enum DriverError {
    /// There is no such system, or it cannot be joined.
    #[error(transparent)]
    Bus(BusError),
    /// It runs, and takes no readings from the bus.
    #[error(
        "feeding the system {system:?}: its topic {topic:?} is not open; set source = \"bus\" in [ingest] of its launch file, or wait until ingest has started"
    )]
    NotTaken {
        /// The system's name.
        system: String,
        /// The topic.
        topic: &'static str,
    },
}
