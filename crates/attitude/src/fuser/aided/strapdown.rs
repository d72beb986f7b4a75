//! Propagation of attitude, velocity and covariance over one interval.

use super::{
    covariance::{ACCEL, ErrorState, GYRO, HEADING, INTERVAL_S, LATENCY, PropagationInterval, ROTATION, VELOCITY},
    filter::Aided,
    sums::IntervalSums,
    variance::square,
};
use crate::{EARTH_RATE_RAD_S, GRAVITY_M_S2, Matrix3, Vector3, gyro::Motion, rotation::Rotation};

/// Largest plausible component of a vehicle's specific force, m/s².
const MAX_FORCE_M_S2: f64 = 1e3;
/// Limit to which each component of the velocity is clamped, m/s.
const MAX_VELOCITY_M_S: f64 = 3e3;
/// Averaging time of the rate of turn, s.
const TURN_RATE_MEMORY_S: f64 = 1.0;
/// Acceleration assumed while the accelerometer is missing, m/s².
const ASSUMED_UNOBSERVED_ACCELERATION_M_S2: f64 = 5.0;
/// Largest attitude correction per tick that is not flagged, rad (0.05°).
const MAX_UNFLAGGED_STEP_RAD: f64 = 8.726_646e-4;
/// Random walk of the latency, s/√s.
const LATENCY_WALK_S: f64 = 1e-4;

/// Returns `true` if a vehicle can have this specific force.
pub(super) fn is_plausible_force(force_m_s2: &Vector3<f64>) -> bool {
    force_m_s2.amax() < MAX_FORCE_M_S2
}

impl Aided {
    /// Propagates the state over one gyro interval. `force_m_s2` is the specific force at its end.
    /// Returns `true` if the attitude jumps.
    pub(super) fn propagate(&mut self, motion: &Motion, force_m_s2: Option<Vector3<f64>>) -> bool {
        let dt_s = motion.dt_s;
        let bias_rotation = Rotation::from_rotation_vector(self.gyro_bias_rad_s * -dt_s);
        self.attitude = self.attitude.rotated(motion.rotation.then(bias_rotation)).attitude;
        let matrix = self.attitude.matrix();
        // Rotation of the platform in body axes: a part of the pending correction, and the earth's
        // rotation.
        let pending_rad = self.pending_rad;
        let fed_in_rad = pending_rad * (dt_s / self.settings.smoothing_s).min(1.0);
        let platform_rad = matrix * (fed_in_rad + self.earth_rate_rad_s() * dt_s);
        self.attitude = self.attitude.rotated(Rotation::from_rotation_vector(-platform_rad)).attitude;
        self.pending_rad -= fed_in_rad;
        let jumps = fed_in_rad.norm_squared() > square(MAX_UNFLAGGED_STEP_RAD);
        if !self.started || dt_s <= 0.0 {
            return jumps;
        }
        let to_reference = matrix.transpose();
        let rate_rad_s = (motion.rate_rad_s - self.gyro_bias_rad_s).map(|x| x.clamp(-1e3, 1e3));
        self.antenna_velocity_m_s = to_reference * rate_rad_s.cross(&self.settings.antenna_m());
        let up_rad_s = to_reference.row(2).transpose().dot(&rate_rad_s);
        self.turn_rate_rad_s -= (self.turn_rate_rad_s + up_rad_s) * (dt_s / TURN_RATE_MEMORY_S).min(1.0);
        let force_m_s2 = match force_m_s2 {
            Some(force_m_s2) => {
                self.sums.update_force_noise(force_m_s2, dt_s);
                let force_m_s2 = to_reference * (force_m_s2 - self.accel_bias_m_s2);
                // Levels the force as if the pending correction had been applied.
                force_m_s2 - pending_rad.cross(&force_m_s2)
            }
            None => {
                self.sums.force_outage_s += dt_s;
                Vector3::z() * GRAVITY_M_S2
            }
        };
        let velocity_m_s = self.velocity_m_s + (force_m_s2 - Vector3::z() * GRAVITY_M_S2) * dt_s;
        self.velocity_m_s = velocity_m_s.map(|x| x.clamp(-MAX_VELOCITY_M_S, MAX_VELOCITY_M_S));
        self.sums.duration_s += dt_s;
        self.sums.force_m_s += force_m_s2 * dt_s;
        self.sums.rate2_rad2_s += rate_rad_s.norm_squared() * dt_s;
        // Without the tolerance of half a millisecond, rounding could delay the propagation to the
        // next sample.
        if self.sums.duration_s > INTERVAL_S - 5e-4 {
            self.propagate_covariance(to_reference);
        }
        jumps
    }

    fn propagate_covariance(&mut self, to_reference: Matrix3<f64>) {
        let settings = &self.settings;
        let IntervalSums { duration_s, force_outage_s, force_m_s, rate2_rad2_s, force_noise_m2_s3, .. } = self.sums;
        let force_m_s2 = force_m_s / duration_s;
        let scale2 = 10.0 * square(settings.scale_noise);
        let acceleration_m_s2 = force_m_s2 - Vector3::z() * GRAVITY_M_S2;
        let white = square(settings.accel_noise_m_s_sqrt_s) + force_noise_m2_s3;
        let velocity = white + scale2 * acceleration_m_s2.norm_squared();
        let rotation = square(settings.gyro_noise_deg_sqrt_s.to_radians()) + scale2 * rate2_rad2_s / duration_s;
        let mut noise = ErrorState::zeros();
        for axis in 0..3 {
            noise[VELOCITY + axis] =
                velocity * duration_s + square(ASSUMED_UNOBSERVED_ACCELERATION_M_S2) * force_outage_s;
            noise[ROTATION + axis] = rotation * duration_s;
            noise[GYRO + axis] = square(settings.gyro_bias_walk_deg_s_sqrt_s.to_radians()) * duration_s;
            noise[ACCEL + axis] = square(settings.accel_bias_walk_m_s2_sqrt_s) * duration_s;
        }
        noise[LATENCY] = square(LATENCY_WALK_S) * duration_s;
        let heading_acts = self.course_known;
        self.covariance.propagate(&PropagationInterval {
            force_m_s2,
            to_reference,
            heading_acts,
            dt_s: duration_s,
            noise,
        });
        self.covariance.limit_variances(&self.variance_limits());
        self.velocity_history.push(self.velocity_m_s + self.antenna_velocity_m_s, duration_s);
        self.sums.reset();
    }

    /// Returns the upper limits of the variances, which bound their growth in a long gap.
    fn variance_limits(&self) -> ErrorState {
        let mut limits = ErrorState::zeros();
        let gyro = square(10.0 * self.settings.gyro_bias_sd_deg_s.to_radians());
        let accel = square(10.0 * self.settings.accel_bias_sd_m_s2);
        for axis in 0..3 {
            limits[VELOCITY + axis] = square(MAX_VELOCITY_M_S);
            limits[ROTATION + axis] = 1.0;
            limits[GYRO + axis] = gyro;
            limits[ACCEL + axis] = accel;
        }
        limits[HEADING] = square(core::f64::consts::PI);
        limits[LATENCY] = square(self.settings.latency_sd_s.max(0.01));
        limits
    }

    /// Returns the earth's rate in reference axes, rad/s; zero if the latitude is unknown. The
    /// north component is zero while the course is unknown.
    fn earth_rate_rad_s(&self) -> Vector3<f64> {
        let Some(latitude_rad) = self.aiding.latitude_rad() else { return Vector3::zeros() };
        let (sin, cos) = libm::sincos(latitude_rad);
        let north = if self.course_known { cos } else { 0.0 };
        Vector3::new(0.0, north, sin) * EARTH_RATE_RAD_S
    }
}
