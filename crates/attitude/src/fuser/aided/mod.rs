//! The fuser `aided`: an error-state filter with the velocity of a satellite receiver.
//!
//! The levelled specific force, less gravity, is integrated to a velocity; what it misses of the receiver's velocity tells tilt,
//! heading and the biases of gyro and accelerometer. Heading needs no magnetometer as soon as the body speeds up, slows down or
//! turns: the acceleration is told twice, in body axes and against north. Without a fix for a while an assumed velocity with a large
//! variance takes its place: the remembered speed along the course, nothing across it, nothing upwards. Nothing is switched over,
//! the covariance carries on how much each is to be trusted.
//!
//! The state is (w, z), the velocity v, the biases b and s, the receiver's latency L and the covariance of their errors. Corrections
//! of the attitude are fed in over [`smoothing_s`](Settings::smoothing_s), as the rate w_c of a platform that is levelled.
//!
//! Heading counts from true north once the track over ground was seen at more than 5 m/s. The first heading is that of the track: a
//! body that begins to move sideways or backwards gets a wrong one. Until a velocity is told only gravity levels: a lasting turn then
//! reveals the speed, lasting straight acceleration does not. Curvature of the earth and Coriolis acceleration, 0.04° at 50 m/s, are
//! left out.
//!
//! | file | what it does |
//! | --- | --- |
//! | `stage` | the order of a step, and what is in the snapshot |
//! | `strapdown` | attitude, velocity and covariance over one interval |
//! | `fixes` | a velocity that was told; the first course |
//! | `assumed` | a velocity that is assumed |
//! | `standstill` | the gyro bias at rest |
//! | `magnetic` | the heading of the magnetic field |
//! | `past` | velocities of the last second |
//! | `covariance` | the covariance and the gain of a measurement |

mod assumed;
mod covariance;
mod fixes;
mod magnetic;
mod past;
mod settings;
mod stage;
mod standstill;
mod strapdown;

pub use settings::Settings;

use core::f64::consts::PI;

use super::{Corrections, carried::Carried};
use crate::{Vector3, course::Reference, state::Attitude};
use covariance::{ACCEL, Covariance, Error, GYRO, HEADING, LATENCY, ROTATION, VELOCITY};
use {fixes::Aiding, past::Past, standstill::Standstill, strapdown::Sums};

/// Time between two steps of the covariance, s.
const INTERVAL_S: f64 = 0.05;
/// Below this a heading has no meaning, horizontal part of the forward axis: 20° from the vertical.
const FORWARD_MIN: f64 = 0.34;

/// The fuser stage `aided`.
#[derive(Debug, Clone, PartialEq)]
pub struct Aided {
    settings: Settings,
    /// As published: the correction that is pending is not in it.
    attitude: Attitude,
    /// A small rotation about reference axes to be taken off the attitude, rad.
    pending_rad: Vector3<f64>,
    started: bool,
    reference: Reference,
    /// Heading counts from north, so that it acts on the velocity.
    course_known: bool,
    velocity_m_s: Vector3<f64>,
    gyro_bias_rad_s: Vector3<f64>,
    accel_bias_m_s2: Vector3<f64>,
    latency_s: f64,
    covariance: Covariance,
    past: Past,
    sums: Sums,
    /// Level rate of turn, rad/s, clockwise, of the last second.
    turn_rate_rad_s: f64,
    aiding: Aiding,
    standstill: Standstill,
    carried: Carried,
    since_field_s: f64,
}

impl Default for Aided {
    fn default() -> Self {
        Self::new(Settings::default())
    }
}

impl Aided {
    /// A stage with these settings.
    pub fn new(settings: Settings) -> Self {
        let mut stage = Self {
            settings,
            attitude: Attitude::default(),
            pending_rad: Vector3::zeros(),
            started: false,
            reference: Reference::Arbitrary,
            course_known: false,
            velocity_m_s: Vector3::zeros(),
            gyro_bias_rad_s: Vector3::zeros(),
            accel_bias_m_s2: Vector3::zeros(),
            latency_s: settings.latency_s,
            covariance: Covariance::of_variances(Error::zeros()),
            past: Past::default(),
            sums: Sums::default(),
            turn_rate_rad_s: 0.0,
            aiding: Aiding::default(),
            standstill: Standstill::default(),
            carried: Carried::default(),
            since_field_s: 0.0,
        };
        for axis in 0..3 {
            stage.covariance.begin(GYRO + axis, square(settings.gyro_bias_sd_deg_s.to_radians()));
            stage.covariance.begin(ACCEL + axis, square(settings.accel_bias_sd_m_s2));
        }
        stage.covariance.begin(LATENCY, square(settings.latency_sd_s));
        stage.covariance.begin(HEADING, square(PI));
        stage.begin_level(settings.level_sd_deg.to_radians());
        stage
    }

    /// The accelerometer bias, m/s², body axes.
    pub fn accel_bias_m_s2(&self) -> Vector3<f64> {
        self.accel_bias_m_s2
    }

    /// How late the receiver's velocity is found to arrive, s.
    pub fn latency_s(&self) -> f64 {
        self.latency_s
    }

    pub(super) fn realign(&mut self) {
        self.started = false;
        self.pending_rad = Vector3::zeros();
        self.begin_level(self.settings.level_sd_deg.to_radians());
        self.standstill.interrupt();
    }

    /// Level and velocity begin anew, with this standard deviation of the level.
    fn begin_level(&mut self, sd_rad: f64) {
        self.begin_velocity(Vector3::zeros(), self.settings.speed_sd_m_s, self.settings.vertical_sd_m_s);
        for axis in ROTATION..HEADING {
            self.covariance.begin(axis, sd_rad * sd_rad);
        }
    }

    fn begin_velocity(&mut self, velocity_m_s: Vector3<f64>, sd_m_s: f64, vertical_sd_m_s: f64) {
        self.velocity_m_s = velocity_m_s;
        self.past.begin(velocity_m_s);
        for (axis, sd_m_s) in [sd_m_s, sd_m_s, vertical_sd_m_s].into_iter().enumerate() {
            self.covariance.begin(VELOCITY + axis, sd_m_s * sd_m_s);
        }
    }

    /// Takes the estimated error off the state; off the attitude by and by.
    fn correct(&mut self, error: &Error) {
        let part =
            |first: usize, limit: f64| Vector3::from(error.fixed_rows::<3>(first)).map(|x| x.clamp(-limit, limit));
        let velocity_m_s = part(VELOCITY, 1e3);
        self.velocity_m_s -= velocity_m_s;
        self.past.subtract(velocity_m_s);
        self.pending_rad = (self.pending_rad + part(ROTATION, 1.0)).map(|x| x.clamp(-1.0, 1.0));
        self.gyro_bias_rad_s = (self.gyro_bias_rad_s - part(GYRO, 1.0)).map(|x| x.clamp(-1.0, 1.0));
        self.accel_bias_m_s2 = (self.accel_bias_m_s2 - part(ACCEL, 5.0)).map(|x| x.clamp(-5.0, 5.0));
        self.latency_s = (self.latency_s + error[LATENCY]).clamp(0.0, 0.6);
    }

    /// Direction and course (rad, clockwise from η0) of the body's forward axis, level; of the corrected attitude.
    fn forward(&self) -> Option<(Vector3<f64>, f64)> {
        let forward = self.attitude.matrix().row(1).transpose();
        let forward = forward - self.pending_rad.cross(&forward);
        let level = libm::hypot(forward.x, forward.y);
        let direction = Vector3::new(forward.x / level, forward.y / level, 0.0);
        (level > FORWARD_MIN).then(|| (direction, libm::atan2(forward.x, forward.y)))
    }

    fn inclination_sd_rad(&self) -> f64 {
        libm::sqrt(self.covariance.variance(ROTATION) + self.covariance.variance(ROTATION + 1))
    }

    fn heading_sd_rad(&self) -> f64 {
        if self.reference == Reference::Arbitrary {
            return PI;
        }
        libm::sqrt(self.covariance.variance(HEADING)).min(PI)
    }
}

fn square(x: f64) -> f64 {
    x * x
}

/// The variance of one of many measurements of which those within `memory_s` share their error.
fn shared(sd: f64, memory_s: f64, interval_s: f64) -> f64 {
    sd * sd * 2.0 * memory_s / interval_s.max(1e-3)
}
