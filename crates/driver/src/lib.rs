//! Client library for programs that publish sensor readings and fixes to the `ingest` of a running
//! system.
//!
//! Input: measurements in SI units and sensor axes.
//!
//! Output: the topics `sensor` and `receiver` of a system whose launch file sets `[ingest] source =
//! "bus"`.
//!
//! Time: the timestamp of the measurement, in ns on a monotonic clock. [`clock_fit`] converts a
//! device's timestamps to such a clock.
//!
//! Failure: an error is returned if the system is not running or its ingest has not opened the
//! topic. The program may retry.
//!
//! ```no_run
//! let mut sensor = driver::Sensor::open("plumbline")?;
//! sensor.send(1_000_000, [0.0, 0.0, 0.1], [0.0, 0.0, 9.81], None)?;
//! # Ok::<(), driver::DriverError>(())
//! ```
#![forbid(unsafe_code)]

pub mod clock_fit;
mod error;
mod feed;

use messages::{ReceiverReading, SensorReading};

pub use bus::BusError;
pub use clock_fit::{ClockFit, Stamp};
pub use error::DriverError;

use feed::Feed;

/// Connection of an IMU, with or without a magnetometer, to a running system.
#[derive(Debug)]
pub struct Sensor(Feed<SensorReading>);

impl Sensor {
    /// Joins the system named `system`.
    ///
    /// # Errors
    ///
    /// Returns an error if the system is not running or its ingest has not opened the topic.
    pub fn open(system: &str) -> Result<Self, DriverError> {
        Feed::open(system).map(Self)
    }

    /// Publishes a reading without blocking.
    ///
    /// `t_ns` is the time of the measurement on the sensor's clock. `rate_rad_s`, `force_m_s2` and
    /// the optional `field_ut` are in sensor axes. If the system was restarted in the meantime,
    /// this call joins the new system.
    ///
    /// # Errors
    ///
    /// Returns an error if the system is not running. The reading is then discarded.
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

    /// Returns the number of readings that the topic buffers for ingest. When the topic is full,
    /// the oldest reading is overwritten.
    pub fn capacity(&self) -> usize {
        self.0.capacity()
    }
}

/// Connection of a satellite receiver to a running system.
#[derive(Debug)]
pub struct Receiver(Feed<ReceiverReading>);

impl Receiver {
    /// Joins the system named `system`.
    ///
    /// # Errors
    ///
    /// Returns an error if the system is not running or its ingest has not opened the topic.
    pub fn open(system: &str) -> Result<Self, DriverError> {
        Feed::open(system).map(Self)
    }

    /// Publishes a fix, which is combined with the sensor's next reading. `velocity_m_s` is the
    /// velocity over ground, east, north, up.
    ///
    /// # Errors
    ///
    /// Returns an error if the system is not running. The fix is then discarded.
    pub fn send(&mut self, velocity_m_s: [f64; 3], metadata: FixMetadata) -> Result<(), DriverError> {
        let or_nan = |value: Option<f64>| value.unwrap_or(f64::NAN);
        self.0.send(&ReceiverReading {
            velocity_m_s,
            velocity_sd_m_s: or_nan(metadata.sd_m_s),
            age_s: or_nan(metadata.age_s),
            latitude_rad: or_nan(metadata.latitude_rad),
            longitude_rad: or_nan(metadata.longitude_rad),
            altitude_m: or_nan(metadata.altitude_m),
        })
    }

    /// Returns the number of fixes that the topic buffers for ingest.
    pub fn capacity(&self) -> usize {
        self.0.capacity()
    }
}

/// Data of a fix in addition to the velocity. Unknown values are `None`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FixMetadata {
    /// Standard deviation of each velocity component, m/s.
    pub sd_m_s: Option<f64>,
    /// Age of the velocity when it arrives, s.
    pub age_s: Option<f64>,
    /// Geodetic latitude, rad, north positive.
    pub latitude_rad: Option<f64>,
    /// Longitude, rad, east positive.
    pub longitude_rad: Option<f64>,
    /// Altitude as reported by the receiver, m.
    pub altitude_m: Option<f64>,
}
