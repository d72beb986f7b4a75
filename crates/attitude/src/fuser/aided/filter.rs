//! The state of the fuser stage `aided`: its beginning, its correction, its standard deviations.

use core::f64::consts::PI;

use super::{
    aiding::Aiding,
    consistency::Consistency,
    covariance::{ACCEL, Covariance, Error, GYRO, HEADING, LATENCY, ROTATION, VELOCITY},
    past::Past,
    settings::Settings,
    standstill::Standstill,
    sums::Sums,
    variance::square,
};
use crate::{Vector3, course::Reference, fuser::carried::Carried, state::Attitude};

/// Below this a heading has no meaning, horizontal part of the forward axis: 20° from the vertical.
const FORWARD_MIN: f64 = 0.34;

/// The fuser stage `aided`.
#[derive(Debug, Clone, PartialEq)]
pub struct Aided {
    pub(super) settings: Settings,
    /// As published: the correction that is pending is not in it.
    pub(super) attitude: Attitude,
    /// A small rotation about reference axes to be taken off the attitude, rad.
    pub(super) pending_rad: Vector3<f64>,
    pub(super) started: bool,
    pub(super) reference: Reference,
    /// Heading counts from north, so that it acts on the velocity.
    pub(super) course_known: bool,
    pub(super) velocity_m_s: Vector3<f64>,
    /// Of the antenna against the sensors, R (ω × r), m/s, reference axes.
    pub(super) antenna_m_s: Vector3<f64>,
    pub(super) gyro_bias_rad_s: Vector3<f64>,
    pub(super) accel_bias_m_s2: Vector3<f64>,
    pub(super) latency_s: f64,
    pub(super) covariance: Covariance,
    pub(super) past: Past,
    pub(super) sums: Sums,
    /// Level rate of turn, rad/s, clockwise, of the last second.
    pub(super) turn_rate_rad_s: f64,
    pub(super) aiding: Aiding,
    pub(super) consistency: Consistency,
    pub(super) standstill: Standstill,
    pub(super) carried: Carried,
    pub(super) since_field_s: f64,
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
            antenna_m_s: Vector3::zeros(),
            gyro_bias_rad_s: Vector3::zeros(),
            accel_bias_m_s2: Vector3::zeros(),
            latency_s: settings.latency_s,
            covariance: Covariance::of_variances(Error::zeros()),
            past: Past::default(),
            sums: Sums::default(),
            turn_rate_rad_s: 0.0,
            aiding: Aiding::default(),
            consistency: Consistency::default(),
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

    pub(in crate::fuser) fn realign(&mut self) {
        self.started = false;
        self.pending_rad = Vector3::zeros();
        self.begin_level(self.settings.level_sd_deg.to_radians());
        self.standstill.interrupt();
    }

    /// Level and velocity begin anew, with this standard deviation of the level.
    pub(super) fn begin_level(&mut self, sd_rad: f64) {
        self.begin_velocity(Vector3::zeros(), self.settings.speed_sd_m_s, self.settings.vertical_sd_m_s);
        for axis in ROTATION..HEADING {
            self.covariance.begin(axis, sd_rad * sd_rad);
        }
    }

    pub(super) fn begin_velocity(&mut self, velocity_m_s: Vector3<f64>, sd_m_s: f64, vertical_sd_m_s: f64) {
        self.velocity_m_s = velocity_m_s;
        self.past.begin(velocity_m_s + self.antenna_m_s);
        for (axis, sd_m_s) in [sd_m_s, sd_m_s, vertical_sd_m_s].into_iter().enumerate() {
            self.covariance.begin(VELOCITY + axis, sd_m_s * sd_m_s);
        }
    }

    /// Takes the estimated error off the state; off the attitude by and by.
    pub(super) fn correct(&mut self, error: &Error) {
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
    pub(super) fn forward(&self) -> Option<(Vector3<f64>, f64)> {
        let forward = self.attitude.matrix().row(1).transpose();
        let forward = forward - self.pending_rad.cross(&forward);
        let level = libm::hypot(forward.x, forward.y);
        let direction = Vector3::new(forward.x / level, forward.y / level, 0.0);
        (level > FORWARD_MIN).then(|| (direction, libm::atan2(forward.x, forward.y)))
    }

    /// About each horizontal axis, as it is told.
    pub(super) fn told_inclination_sd_rad(&self) -> f64 {
        self.inclination_sd_rad() * core::f64::consts::FRAC_1_SQRT_2 * self.consistency.scale(self.settings.noises())
    }

    /// As it is told.
    pub(super) fn told_heading_sd_rad(&self) -> f64 {
        (self.heading_sd_rad() * self.consistency.scale(self.settings.noises())).min(PI)
    }

    pub(super) fn inclination_sd_rad(&self) -> f64 {
        libm::sqrt(self.covariance.variance(ROTATION) + self.covariance.variance(ROTATION + 1))
    }

    pub(super) fn heading_sd_rad(&self) -> f64 {
        if self.reference == Reference::Arbitrary {
            return PI;
        }
        libm::sqrt(self.covariance.variance(HEADING)).min(PI)
    }
}
