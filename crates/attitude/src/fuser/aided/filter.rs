//! State of the fuser stage `aided`, with its initialisation, corrections and standard deviations.

use core::f64::consts::PI;

use super::{
    aiding::Aiding,
    consistency::Consistency,
    covariance::{ACCEL, Covariance, ErrorState, GYRO, HEADING, LATENCY, ROTATION, VELOCITY},
    settings::Settings,
    standstill::StandstillDetector,
    sums::IntervalSums,
    variance::square,
    velocity_history::VelocityHistory,
};
use crate::{Vector3, course::CourseReference, fuser::bias_handover::HandedOverBias, state::Attitude};

/// Smallest horizontal part of the forward unit vector that defines a heading. It corresponds to a
/// direction 20° from the vertical.
const MIN_HORIZONTAL_FORWARD: f64 = 0.34;

/// Fuser stage `aided`: an error-state filter with the velocity of a satellite receiver.
#[derive(Debug, Clone, PartialEq)]
pub struct Aided {
    pub(super) settings: Settings,
    /// Attitude as published, without the pending correction.
    pub(super) attitude: Attitude,
    /// Pending correction: a small rotation about reference axes to be removed from the attitude,
    /// rad.
    pub(super) pending_rad: Vector3<f64>,
    pub(super) started: bool,
    pub(in crate::fuser) reference: CourseReference,
    /// Set if the heading refers to north. A heading error affects the velocity only in this case.
    pub(super) course_known: bool,
    pub(super) velocity_m_s: Vector3<f64>,
    /// Velocity of the antenna relative to the sensors, R (ω × r), in reference axes, m/s.
    pub(super) antenna_velocity_m_s: Vector3<f64>,
    pub(in crate::fuser) gyro_bias_rad_s: Vector3<f64>,
    pub(super) accel_bias_m_s2: Vector3<f64>,
    pub(super) latency_s: f64,
    pub(super) covariance: Covariance,
    pub(super) velocity_history: VelocityHistory,
    pub(super) sums: IntervalSums,
    /// Clockwise turn rate in the horizontal plane, averaged over the last second, rad/s.
    pub(super) turn_rate_rad_s: f64,
    pub(super) aiding: Aiding,
    pub(super) consistency: Consistency,
    pub(super) standstill: StandstillDetector,
    pub(super) handed_over: HandedOverBias,
    pub(super) since_field_s: f64,
}

impl Default for Aided {
    fn default() -> Self {
        Self::new(Settings::default())
    }
}

impl Aided {
    /// Creates a stage with the given settings.
    pub fn new(settings: Settings) -> Self {
        let mut stage = Self {
            settings,
            attitude: Attitude::default(),
            pending_rad: Vector3::zeros(),
            started: false,
            reference: CourseReference::Arbitrary,
            course_known: false,
            velocity_m_s: Vector3::zeros(),
            antenna_velocity_m_s: Vector3::zeros(),
            gyro_bias_rad_s: Vector3::zeros(),
            accel_bias_m_s2: Vector3::zeros(),
            latency_s: settings.latency_s,
            covariance: Covariance::from_variances(ErrorState::zeros()),
            velocity_history: VelocityHistory::default(),
            sums: IntervalSums::default(),
            turn_rate_rad_s: 0.0,
            aiding: Aiding::default(),
            consistency: Consistency::default(),
            standstill: StandstillDetector::default(),
            handed_over: HandedOverBias::default(),
            since_field_s: 0.0,
        };
        for axis in 0..3 {
            stage.covariance.reset(GYRO + axis, square(settings.gyro_bias_sd_deg_s.to_radians()));
            stage.covariance.reset(ACCEL + axis, square(settings.accel_bias_sd_m_s2));
        }
        stage.covariance.reset(LATENCY, square(settings.latency_sd_s));
        stage.covariance.reset(HEADING, square(PI));
        stage.reset_level(settings.level_sd_deg.to_radians());
        stage
    }

    /// Returns the accelerometer bias in body axes, m/s².
    pub fn accel_bias_m_s2(&self) -> Vector3<f64> {
        self.accel_bias_m_s2
    }

    /// Returns the estimated latency of the receiver's velocity, s.
    pub fn latency_s(&self) -> f64 {
        self.latency_s
    }

    pub(in crate::fuser) fn realign(&mut self) {
        self.started = false;
        self.pending_rad = Vector3::zeros();
        self.reset_level(self.settings.level_sd_deg.to_radians());
        self.standstill.reset();
    }

    /// Resets the velocity and sets the standard deviation of the level.
    pub(super) fn reset_level(&mut self, sd_rad: f64) {
        self.reset_velocity(Vector3::zeros(), self.settings.speed_sd_m_s, self.settings.vertical_sd_m_s);
        for axis in ROTATION..HEADING {
            self.covariance.reset(axis, sd_rad * sd_rad);
        }
    }

    pub(super) fn reset_velocity(&mut self, velocity_m_s: Vector3<f64>, sd_m_s: f64, vertical_sd_m_s: f64) {
        self.velocity_m_s = velocity_m_s;
        self.velocity_history.fill(velocity_m_s + self.antenna_velocity_m_s);
        for (axis, sd_m_s) in [sd_m_s, sd_m_s, vertical_sd_m_s].into_iter().enumerate() {
            self.covariance.reset(VELOCITY + axis, sd_m_s * sd_m_s);
        }
    }

    /// Subtracts an estimated error from the state. The attitude is corrected gradually.
    pub(super) fn apply_correction(&mut self, error: &ErrorState) {
        let limited =
            |first: usize, limit: f64| Vector3::from(error.fixed_rows::<3>(first)).map(|x| x.clamp(-limit, limit));
        let velocity_m_s = limited(VELOCITY, 1e3);
        self.velocity_m_s -= velocity_m_s;
        self.velocity_history.apply_correction(velocity_m_s);
        self.pending_rad = (self.pending_rad + limited(ROTATION, 1.0)).map(|x| x.clamp(-1.0, 1.0));
        self.gyro_bias_rad_s = (self.gyro_bias_rad_s - limited(GYRO, 1.0)).map(|x| x.clamp(-1.0, 1.0));
        self.accel_bias_m_s2 = (self.accel_bias_m_s2 - limited(ACCEL, 5.0)).map(|x| x.clamp(-5.0, 5.0));
        self.latency_s = (self.latency_s + error[LATENCY]).clamp(0.0, 0.6);
    }

    /// Returns the horizontal direction and the course of the body's forward axis, with the pending
    /// correction applied.
    ///
    /// The course is in rad, clockwise from the reference axis η0. The result is `None` if the axis
    /// is too steep.
    pub(super) fn forward(&self) -> Option<(Vector3<f64>, f64)> {
        let forward = self.attitude.matrix().row(1).transpose();
        let forward = forward - self.pending_rad.cross(&forward);
        let horizontal = libm::hypot(forward.x, forward.y);
        let direction = Vector3::new(forward.x / horizontal, forward.y / horizontal, 0.0);
        (horizontal > MIN_HORIZONTAL_FORWARD).then(|| (direction, libm::atan2(forward.x, forward.y)))
    }

    /// Returns the reported standard deviation of the inclination about each horizontal axis, rad.
    pub(super) fn reported_inclination_sd_rad(&self) -> f64 {
        self.inclination_sd_rad()
            * core::f64::consts::FRAC_1_SQRT_2
            * self.consistency.sd_scale(self.settings.noise_settings())
    }

    /// Returns the reported standard deviation of the heading, rad.
    pub(super) fn reported_heading_sd_rad(&self) -> f64 {
        (self.heading_sd_rad() * self.consistency.sd_scale(self.settings.noise_settings())).min(PI)
    }

    pub(super) fn inclination_sd_rad(&self) -> f64 {
        libm::sqrt(self.covariance.variance(ROTATION) + self.covariance.variance(ROTATION + 1))
    }

    pub(super) fn heading_sd_rad(&self) -> f64 {
        if self.reference == CourseReference::Arbitrary {
            return PI;
        }
        libm::sqrt(self.covariance.variance(HEADING)).min(PI)
    }
}
