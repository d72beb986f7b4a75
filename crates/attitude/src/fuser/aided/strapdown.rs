//! Attitude, velocity and covariance over one interval.

use super::{
    covariance::{ACCEL, Error, GYRO, HEADING, INTERVAL_S, Interval, LATENCY, ROTATION, VELOCITY},
    filter::Aided,
    sums::Sums,
    variance::square,
};
use crate::{GRAVITY_M_S2, Matrix3, Vector3, gyro::Motion, turn::Turn};

/// Rate at which the earth turns, rad/s (WGS 84).
const EARTH_RATE_RAD_S: f64 = 7.292_115e-5;
/// A specific force beyond this is not that of a vehicle, m/s².
const FORCE_MAX_M_S2: f64 = 1e3;
/// A velocity beyond this is not that of a vehicle, m/s.
const VELOCITY_MAX_M_S: f64 = 3e3;
/// Memory of the rate of turn, s.
const TURN_MEMORY_S: f64 = 1.0;
/// Acceleration that may have gone unseen without an accelerometer, m/s².
const UNSEEN_M_S2: f64 = 5.0;
/// A correction of the attitude by more in a tick is announced, rad: 0.05°.
const ANNOUNCED_RAD: f64 = 8.726_646e-4;
/// Random walk of the latency, s/√s.
const LATENCY_WALK_S: f64 = 1e-4;

/// A specific force that a vehicle can have.
pub(super) fn credible(force_m_s2: &Vector3<f64>) -> bool {
    force_m_s2.amax() < FORCE_MAX_M_S2
}

impl Aided {
    /// One interval of the gyro, with the specific force at its end; true where the attitude is corrected by so much that it jumps.
    pub(super) fn advance(&mut self, motion: &Motion, force_m_s2: Option<Vector3<f64>>) -> bool {
        let dt_s = motion.dt_s;
        let bias_turn = Turn::of_rotation_vector(self.gyro_bias_rad_s * -dt_s);
        self.attitude = self.attitude.turned(motion.turn.then(bias_turn)).attitude;
        let matrix = self.attitude.matrix();
        // The platform's rate, in body axes.
        let pending_rad = self.pending_rad;
        let fed_in_rad = pending_rad * (dt_s / self.settings.smoothing_s).min(1.0);
        let platform_rad = matrix * (fed_in_rad + self.earth_rate_rad_s() * dt_s);
        self.attitude = self.attitude.turned(Turn::of_rotation_vector(-platform_rad)).attitude;
        self.pending_rad -= fed_in_rad;
        let jumps = fed_in_rad.norm_squared() > square(ANNOUNCED_RAD);
        if !self.started || dt_s <= 0.0 {
            return jumps;
        }
        let to_reference = matrix.transpose();
        let rate_rad_s = (motion.rate_rad_s - self.gyro_bias_rad_s).map(|x| x.clamp(-1e3, 1e3));
        self.antenna_m_s = to_reference * rate_rad_s.cross(&self.settings.antenna_m());
        let up_rad_s = to_reference.row(2).transpose().dot(&rate_rad_s);
        self.turn_rate_rad_s -= (self.turn_rate_rad_s + up_rad_s) * (dt_s / TURN_MEMORY_S).min(1.0);
        let force_m_s2 = match force_m_s2 {
            Some(force_m_s2) => {
                self.sums.see(force_m_s2, dt_s);
                let force_m_s2 = to_reference * (force_m_s2 - self.accel_bias_m_s2);
                // As the attitude will have it once the pending correction is in.
                force_m_s2 - pending_rad.cross(&force_m_s2)
            }
            None => {
                self.sums.unseen_s += dt_s;
                Vector3::z() * GRAVITY_M_S2
            }
        };
        let velocity_m_s = self.velocity_m_s + (force_m_s2 - Vector3::z() * GRAVITY_M_S2) * dt_s;
        self.velocity_m_s = velocity_m_s.map(|x| x.clamp(-VELOCITY_MAX_M_S, VELOCITY_MAX_M_S));
        self.sums.length_s += dt_s;
        self.sums.force_m_s += force_m_s2 * dt_s;
        self.sums.rate2_rad2_s += rate_rad_s.norm_squared() * dt_s;
        // Half a millisecond: a step is not to wait for the next sample because of the last digit of its length.
        if self.sums.length_s > INTERVAL_S - 5e-4 {
            self.advance_covariance(to_reference);
        }
        jumps
    }

    fn advance_covariance(&mut self, to_reference: Matrix3<f64>) {
        let settings = &self.settings;
        let Sums { length_s, unseen_s, force_m_s, rate2_rad2_s, spread_m2_s3, .. } = self.sums;
        let force_m_s2 = force_m_s / length_s;
        let scale2 = 10.0 * square(settings.scale_noise);
        let moved_m_s2 = force_m_s2 - Vector3::z() * GRAVITY_M_S2;
        let white = square(settings.accel_noise_m_s_sqrt_s) + spread_m2_s3;
        let velocity = white + scale2 * moved_m_s2.norm_squared();
        let rotation = square(settings.gyro_noise_deg_sqrt_s.to_radians()) + scale2 * rate2_rad2_s / length_s;
        let mut noise = Error::zeros();
        for axis in 0..3 {
            noise[VELOCITY + axis] = velocity * length_s + square(UNSEEN_M_S2) * unseen_s;
            noise[ROTATION + axis] = rotation * length_s;
            noise[GYRO + axis] = square(settings.gyro_bias_walk_deg_s_sqrt_s.to_radians()) * length_s;
            noise[ACCEL + axis] = square(settings.accel_bias_walk_m_s2_sqrt_s) * length_s;
        }
        noise[LATENCY] = square(LATENCY_WALK_S) * length_s;
        let heading_acts = self.course_known;
        self.covariance.advance(&Interval { force_m_s2, to_reference, heading_acts, dt_s: length_s, noise });
        self.covariance.hold(&self.limits());
        self.past.push(self.velocity_m_s + self.antenna_m_s, length_s);
        self.sums.begin();
    }

    /// Variances beyond which a longer wait tells nothing more, so that a day without a fix ends as an hour does.
    fn limits(&self) -> Error {
        let mut limits = Error::zeros();
        let gyro = square(10.0 * self.settings.gyro_bias_sd_deg_s.to_radians());
        let accel = square(10.0 * self.settings.accel_bias_sd_m_s2);
        for axis in 0..3 {
            limits[VELOCITY + axis] = square(VELOCITY_MAX_M_S);
            limits[ROTATION + axis] = 1.0;
            limits[GYRO + axis] = gyro;
            limits[ACCEL + axis] = accel;
        }
        limits[HEADING] = square(core::f64::consts::PI);
        limits[LATENCY] = square(self.settings.latency_sd_s.max(0.01));
        limits
    }

    /// The earth's rate where the receiver told the latitude, rad/s, reference axes; its part to the north needs the course.
    fn earth_rate_rad_s(&self) -> Vector3<f64> {
        let Some(latitude_rad) = self.aiding.latitude_rad() else { return Vector3::zeros() };
        let (sin, cos) = libm::sincos(latitude_rad);
        let north = if self.course_known { cos } else { 0.0 };
        Vector3::new(0.0, north, sin) * EARTH_RATE_RAD_S
    }
}
