//! Filter updates with the velocity of the satellite receiver, and initialisation of the course.

use super::{
    covariance::{ACCEL, ErrorState, HEADING, LATENCY, Measurement, ROTATION, VELOCITY},
    filter::Aided,
    variance::{correlated_variance, square},
};
use crate::{GRAVITY_M_S2, Vector3, course::CourseReference, fuser::fused::Corrections, gnss::Fix, state::wrapped_rad};

/// Largest standard deviation of the initial course due to wind, rad. Above it, the linearisation
/// does not hold.
const MAX_WIND_COURSE_SD_RAD: f64 = 0.8;
/// Speed at which a body counts as moving, m/s.
const MIN_MOVING_SPEED_M_S: f64 = 1.5;
/// Time for which the track must be usable before it sets the course, s.
const MIN_TRACK_DURATION_S: f64 = 0.35;
/// Largest plausible component of a satellite velocity, m/s.
const MAX_VELOCITY_M_S: f64 = 2e3;
/// Smallest standard deviation accepted from a receiver, m/s.
const MIN_SD_M_S: f64 = 0.02;

impl Aided {
    /// Updates the filter with a fix. If the course is unknown, a fix at sufficient speed
    /// initialises the course.
    pub(super) fn on_fix(&mut self, fix: &Fix, corrections: &mut Corrections) {
        if fix.velocity_m_s.amax() > MAX_VELOCITY_M_S {
            return;
        }
        if let Some(latitude_rad) = fix.latitude_rad.filter(|rad| libm::fabs(*rad) < 1.6) {
            (self.aiding.latitude_rad, self.aiding.has_latitude) = (latitude_rad, true);
        }
        let interval_s = self.aiding.since_fix_s.clamp(0.05, 1.0);
        let was_lost = self.aiding.since_fix_s > self.settings.fix_timeout_s;
        let speed_m_s = fix.speed_m_s();
        self.aiding.since_fix_s = 0.0;
        self.aiding.speed_m_s = speed_m_s;
        self.aiding.has_velocity = true;
        if self.course_known || speed_m_s < MIN_MOVING_SPEED_M_S {
            self.update_velocity(fix, interval_s);
            self.aiding.since_assumed_s = 0.0;
            corrections.velocity = true;
        }
        if speed_m_s > self.settings.track_speed_m_s && !self.course_known {
            self.aiding.track_duration_s = if was_lost { 0.0 } else { self.aiding.track_duration_s + interval_s };
            if self.aiding.track_duration_s > MIN_TRACK_DURATION_S {
                self.start_course(fix);
                corrections.velocity = true;
                corrections.aligned = true;
            }
        }
        if let Some((_, course_rad)) = self.forward().filter(|_| speed_m_s > self.settings.track_speed_m_s) {
            self.aiding.crab_rad = if self.course_known { wrapped_rad(fix.track_rad() - course_rad) } else { 0.0 };
        }
    }

    /// Updates the filter with the velocity of a fix and, with a small weight, with its track.
    ///
    /// The measured velocity is that of the antenna at the time of measurement, v + R (ω × r). Here
    /// v is the velocity of the sensors, R the rotation from body to reference axes, ω the body
    /// rate and r the position of the antenna relative to the sensors. Since that time, the
    /// velocity error has changed because of the errors of tilt and accelerometer bias. The
    /// measurement model therefore includes these errors.
    fn update_velocity(&mut self, fix: &Fix, interval_s: f64) {
        let (settings, mut error) = (self.settings, ErrorState::zeros());
        let age_s = fix.age_s.filter(|age_s| (0.0..=1.0).contains(age_s));
        let delay_s = age_s.unwrap_or(self.latency_s);
        let (velocity_m_s, slope_m_s2) = self.velocity_history.interpolate(
            delay_s,
            self.velocity_m_s + self.antenna_velocity_m_s,
            self.sums.duration_s,
        );
        let sd_m_s =
            fix.sd_m_s.filter(|sd| (0.0..1e6).contains(sd)).map_or(settings.velocity_sd_m_s, |sd| sd.max(MIN_SD_M_S));
        let (limit, variance) = (settings.innovation_limit, sd_m_s * sd_m_s);
        let force_m_s2 = slope_m_s2 + Vector3::z() * GRAVITY_M_S2;
        let tilt_coupling = force_m_s2.cross_matrix() * delay_s;
        let bias_coupling = self.attitude.matrix().transpose() * delay_s;
        let (heading_factor, latency_factor) =
            (f64::from(u8::from(self.course_known)), if age_s.is_some() { 0.0 } else { 1.0 });
        let innovations = [0, 1, 2].map(|axis| {
            let (tilt, bias) = (tilt_coupling.row(axis), bias_coupling.row(axis));
            let row = [
                (VELOCITY + axis, 1.0),
                (ROTATION, tilt[0]),
                (ROTATION + 1, tilt[1]),
                (HEADING, tilt[2] * heading_factor),
                (ACCEL, bias[0]),
                (ACCEL + 1, bias[1]),
                (ACCEL + 2, bias[2]),
                (LATENCY, slope_m_s2[axis] * latency_factor),
            ];
            let residual = velocity_m_s[axis] - fix.velocity_m_s[axis];
            self.covariance.update(&mut error, limit, &Measurement { residual, row: &row, variance, considered: &[] })
        });
        self.consistency.record(innovations, interval_s);
        let speed_m_s = fix.speed_m_s();
        if let Some((_, course_rad)) =
            self.forward().filter(|_| self.course_known && speed_m_s > self.settings.track_speed_m_s)
        {
            let residual = wrapped_rad(course_rad - fix.track_rad() - self.turn_rate_rad_s * delay_s);
            let variance = correlated_variance(settings.wind_m_s / speed_m_s, settings.wind_memory_s, interval_s);
            let row = [(HEADING, -1.0)];
            self.covariance.update(&mut error, limit, &Measurement { residual, row: &row, variance, considered: &[] });
        }
        self.apply_correction(&error);
    }

    /// Sets the velocity to that of the receiver. Unless the heading already refers to true north,
    /// also sets the heading to the track. Level and biases are kept.
    fn start_course(&mut self, fix: &Fix) {
        let Some((_, course_rad)) = self.forward() else { return };
        if self.reference != CourseReference::True {
            let track_rad = fix.track_rad() + self.turn_rate_rad_s * self.latency_s;
            let rotation_rad = wrapped_rad(course_rad - track_rad);
            self.attitude.z_rad = wrapped_rad(self.attitude.z_rad + rotation_rad);
            let (sin, cos) = libm::sincos(rotation_rad);
            let pending_rad = self.pending_rad;
            self.pending_rad = Vector3::new(
                cos * pending_rad.x - sin * pending_rad.y,
                sin * pending_rad.x + cos * pending_rad.y,
                pending_rad.z,
            );
            let wind = square((self.settings.wind_m_s / fix.speed_m_s()).min(MAX_WIND_COURSE_SD_RAD));
            self.covariance.reset(HEADING, square(self.settings.course_sd_deg.to_radians()) + wind);
            self.reference = CourseReference::True;
        }
        self.course_known = true;
        let sd_m_s = self.settings.velocity_sd_m_s.max(1.0);
        self.reset_velocity(fix.velocity_m_s - self.antenna_velocity_m_s, sd_m_s, sd_m_s);
    }
}
