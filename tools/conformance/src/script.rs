//! Scripts: simulated sensor values per tick, with the true attitude.
//!
//! Input: a motion, a sample rate and sensor errors.
//!
//! Output: ticks with gyro and accelerometer, a magnetic field at 50 Hz and a velocity over ground
//! at 5 Hz. [`crate::fault`] adds faults.
//!
//! Time: the timestamps of the ticks.

use std::sync::LazyLock;

use attitude::{Vector3, gnss::Fix, state::Attitude};
use scenario::{Motion, SensorErrors, Sensors};

/// Typical magnetic field in central Europe, µT: east, north and up components.
const FIELD_UT: Vector3<f64> = Vector3::new(0.0, 20.0, -45.0);
const FIELD_NOISE_UT: f64 = 0.5;
const FIELD_RATE_HZ: f64 = 50.0;
const FIX_RATE_HZ: f64 = 5.0;
const VELOCITY_NOISE_M_S: f64 = 0.05;
const LATITUDE_RAD: f64 = 0.97;
/// Tolerance for comparing times that are multiples of an interval, s.
pub(crate) const ROUNDING_S: f64 = 1e-9;

/// Sensor values and true attitude at one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tick {
    /// End of the interval, s.
    pub t_s: f64,
    /// Length of the interval according to the timestamps, s.
    pub dt_s: f64,
    /// Body rate at the interval's end, rad/s.
    pub rate_rad_s: Option<Vector3<f64>>,
    /// Specific force at the interval's end, m/s², body axes.
    pub force_m_s2: Option<Vector3<f64>>,
    /// Magnetic field, µT, body axes.
    pub field_ut: Option<Vector3<f64>>,
    /// Fix from the satellite receiver.
    pub fix: Option<Fix>,
    /// `true` if gyro and accelerometer are working, so that constant readings mean rest.
    pub rest_credible: bool,
    /// `true` if the gyro is working and within its range.
    pub rate_credible: bool,
    /// True attitude.
    pub truth: Attitude,
}

/// Sequence of ticks.
#[derive(Debug, Clone, PartialEq)]
pub struct Script {
    /// Description of the script, for reports.
    pub name: String,
    /// Ticks in order.
    pub ticks: Vec<Tick>,
}

/// Scenario S1 with sensor errors, long enough to recover from a fault.
pub(crate) static S1: LazyLock<Script> =
    LazyLock::new(|| Script::new("S1 at 100 Hz", Motion::S1, SensorErrors::S1, 100.0, 100.0));

/// Scripts for the validity checks, with motions or sample rates other than those of [`S1`].
pub(crate) static SHORT_SCRIPTS: LazyLock<[Script; 3]> = LazyLock::new(|| {
    let tumble = Motion::Tumble(Vector3::new(2.4, -1.6, 0.8));
    [
        Script::new("S1 at 200 Hz", Motion::S1, SensorErrors::S1, 200.0, 35.0),
        Script::new("tumbling at 100 Hz", tumble, SensorErrors::S1, 100.0, 35.0),
        Script::new("tumbling at 200 Hz", tumble, SensorErrors::S1, 200.0, 35.0),
    ]
});

impl Script {
    /// Simulates sensors with the given errors on a body that rotates in place.
    pub fn new(name: &str, motion: Motion, errors: SensorErrors, rate_hz: f64, duration_s: f64) -> Self {
        let mut sensors = Sensors::new(motion, errors, 1);
        let (mut field_noise, mut velocity_noise) = (noise(2), noise(3));
        let exact = errors == SensorErrors::default();
        let [field_noise_ut, velocity_noise_m_s] =
            [FIELD_NOISE_UT, VELOCITY_NOISE_M_S].map(|sd| if exact { 0.0 } else { sd });
        let tick = |count: u64| {
            let t_s = count as f64 / rate_hz;
            let sample = sensors.read(t_s);
            let truth = sample.truth.attitude;
            let is_due = |sensor_rate_hz: f64| count.is_multiple_of((rate_hz / sensor_rate_hz) as u64);
            let field_ut = is_due(FIELD_RATE_HZ).then(|| truth.matrix() * FIELD_UT + field_noise() * field_noise_ut);
            let fix = is_due(FIX_RATE_HZ).then(|| Fix {
                velocity_m_s: velocity_noise() * velocity_noise_m_s,
                sd_m_s: Some(VELOCITY_NOISE_M_S),
                age_s: Some(0.0),
                latitude_rad: Some(LATITUDE_RAD),
            });
            Tick {
                t_s,
                dt_s: if count == 0 { 0.0 } else { 1.0 / rate_hz },
                rate_rad_s: Some(sample.rate_rad_s),
                force_m_s2: Some(sample.force_m_s2),
                field_ut,
                fix,
                rest_credible: true,
                rate_credible: true,
                truth,
            }
        };
        Self { name: name.into(), ticks: (0..=(duration_s * rate_hz) as u64).map(tick).collect() }
    }

    /// Returns the number of ticks before the given time.
    pub(crate) fn ticks_before(&self, t_s: f64) -> usize {
        self.ticks.partition_point(|tick| tick.t_s < t_s - ROUNDING_S)
    }
}

/// Returns a generator of vectors of independent standard normal numbers, identical on every
/// machine.
pub(crate) fn noise(seed: u64) -> impl FnMut() -> Vector3<f64> {
    let mut sensors = Sensors::new(Motion::S1, SensorErrors { accel_noise_m_s2: 1.0, ..SensorErrors::default() }, seed);
    move || {
        let sample = sensors.read(0.0);
        sample.force_m_s2 - sample.truth.force_m_s2
    }
}
