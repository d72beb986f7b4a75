//! Scripts: what the sensors of a body give, tick by tick, and the truth.
//!
//! Input: a motion, a sample rate, a seed. Output: ticks with every sensor, a magnetic field at 50 Hz and a velocity over ground at
//! 5 Hz. Time: the ticks' own. Failure: none; what is wrong with the sensors is put in by [`crate::fault`].

use std::sync::LazyLock;

use attitude::{Vector3, gnss::Fix, state::Attitude};
use scenario::{Errors, Motion, Sensors};

/// The magnetic field of central Europe, µT, east, north, up.
const FIELD_UT: Vector3<f64> = Vector3::new(0.0, 20.0, -45.0);
const FIELD_NOISE_UT: f64 = 0.5;
const FIELD_RATE_HZ: f64 = 50.0;
const FIX_RATE_HZ: f64 = 5.0;
const VELOCITY_NOISE_M_S: f64 = 0.05;
const LATITUDE_RAD: f64 = 0.97;
/// Of times that are multiples of an interval.
pub(crate) const ROUNDING_S: f64 = 1e-9;

/// What the sensors give at one tick, and the truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tick {
    /// Time of the interval's end, s.
    pub t_s: f64,
    /// Length of the interval, s, as the stamps say.
    pub dt_s: f64,
    /// Body rate at the interval's end, rad/s.
    pub rate_rad_s: Option<Vector3<f64>>,
    /// Specific force at the interval's end, m/s², body axes.
    pub force_m_s2: Option<Vector3<f64>>,
    /// Magnetic field, µT, body axes.
    pub field_ut: Option<Vector3<f64>>,
    /// Of the satellite receiver.
    pub fix: Option<Fix>,
    /// Gyro and accelerometer are alive.
    pub rest_credible: bool,
    /// The gyro is alive and within its range.
    pub rate_credible: bool,
    /// The true attitude.
    pub truth: Attitude,
}

/// Ticks in the order in which they come.
#[derive(Debug, Clone, PartialEq)]
pub struct Script {
    /// What it is, for people.
    pub name: String,
    /// All of them.
    pub ticks: Vec<Tick>,
}

/// The reference motion with its errors, long enough to recover in.
pub(crate) static S1: LazyLock<Script> =
    LazyLock::new(|| Script::new("S1 at 100 Hz", Motion::S1, Errors::S1, 100.0, 100.0));

/// Motions and sample rates on which a stage has to stay sound.
pub(crate) static SHORT: LazyLock<[Script; 3]> = LazyLock::new(|| {
    let tumble = Motion::Tumble(Vector3::new(2.4, -1.6, 0.8));
    [
        Script::new("S1 at 200 Hz", Motion::S1, Errors::S1, 200.0, 35.0),
        Script::new("tumbling at 100 Hz", tumble, Errors::S1, 100.0, 35.0),
        Script::new("tumbling at 200 Hz", tumble, Errors::S1, 200.0, 35.0),
    ]
});

impl Script {
    /// Sensors with these errors on a body in this motion, which turns in place.
    pub fn new(name: &str, motion: Motion, errors: Errors, rate_hz: f64, duration_s: f64) -> Self {
        let mut sensors = Sensors::new(motion, errors, 1);
        let (mut field_noise, mut velocity_noise) = (noise(2), noise(3));
        let exact = errors == Errors::default();
        let [field_noise_ut, velocity_noise_m_s] =
            [FIELD_NOISE_UT, VELOCITY_NOISE_M_S].map(|sd| if exact { 0.0 } else { sd });
        let tick = |count: u64| {
            let t_s = count as f64 / rate_hz;
            let reading = sensors.read(t_s);
            let truth = reading.truth.attitude;
            let due = |every_hz: f64| count.is_multiple_of((rate_hz / every_hz) as u64);
            let field_ut = due(FIELD_RATE_HZ).then(|| truth.matrix() * FIELD_UT + field_noise() * field_noise_ut);
            let fix = due(FIX_RATE_HZ).then(|| Fix {
                velocity_m_s: velocity_noise() * velocity_noise_m_s,
                sd_m_s: Some(VELOCITY_NOISE_M_S),
                age_s: Some(0.0),
                latitude_rad: Some(LATITUDE_RAD),
            });
            Tick {
                t_s,
                dt_s: if count == 0 { 0.0 } else { 1.0 / rate_hz },
                rate_rad_s: Some(reading.rate_rad_s),
                force_m_s2: Some(reading.force_m_s2),
                field_ut,
                fix,
                rest_credible: true,
                rate_credible: true,
                truth,
            }
        };
        Self { name: name.into(), ticks: (0..=(duration_s * rate_hz) as u64).map(tick).collect() }
    }

    /// Ticks before this time.
    pub(crate) fn ticks_before(&self, t_s: f64) -> usize {
        self.ticks.partition_point(|tick| tick.t_s < t_s - ROUNDING_S)
    }
}

/// Normal deviates of unit variance, three at a time, the same on every machine.
pub(crate) fn noise(seed: u64) -> impl FnMut() -> Vector3<f64> {
    let mut sensors = Sensors::new(Motion::S1, Errors { accel_noise_m_s2: 1.0, ..Errors::default() }, seed);
    move || {
        let reading = sensors.read(0.0);
        reading.force_m_s2 - reading.truth.force_m_s2
    }
}
