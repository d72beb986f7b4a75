//! A velocity that was told: the measurement of a fix, and the first course.

use super::{
    covariance::{ACCEL, Error, HEADING, LATENCY, Measurement, ROTATION, VELOCITY},
    filter::Aided,
    variance::{shared, square},
};
use crate::{GRAVITY_M_S2, Vector3, course::Reference, fuser::fused::Corrections, gnss::Fix, state::wrapped_rad};

/// Largest standard deviation of the first course because of the wind, rad: beyond it nothing is small any more.
const FIRST_COURSE_SD_RAD: f64 = 0.8;
/// Speed from which a velocity is not that of standstill, m/s.
const MOVING_M_S: f64 = 1.5;
/// Time between the two fixes that make a course, s.
const COURSE_AFTER_S: f64 = 0.35;
/// A velocity beyond this is not believed, m/s.
const VELOCITY_MAX_M_S: f64 = 2e3;
/// Least standard deviation that a receiver is believed, m/s.
const SD_MIN_M_S: f64 = 0.02;

impl Aided {
    /// One fix.
    pub(super) fn on_fix(&mut self, fix: &Fix, corrections: &mut Corrections) {
        if fix.velocity_m_s.amax() > VELOCITY_MAX_M_S {
            return;
        }
        if let Some(latitude_rad) = fix.latitude_rad.filter(|rad| libm::fabs(*rad) < 1.6) {
            (self.aiding.latitude_rad, self.aiding.latitude_told) = (latitude_rad, true);
        }
        let interval_s = self.aiding.since_fix_s.clamp(0.05, 1.0);
        let lost = self.aiding.since_fix_s > self.settings.gap_after_s;
        let speed_m_s = fix.speed_m_s();
        self.aiding.since_fix_s = 0.0;
        self.aiding.speed_m_s = speed_m_s;
        self.aiding.seen = true;
        if self.course_known || speed_m_s < MOVING_M_S {
            self.measure(fix, interval_s);
            self.aiding.since_assumed_s = 0.0;
            corrections.velocity = true;
        }
        if speed_m_s > self.settings.track_speed_m_s && !self.course_known {
            self.aiding.tracked_s = if lost { 0.0 } else { self.aiding.tracked_s + interval_s };
            if self.aiding.tracked_s > COURSE_AFTER_S {
                self.begin_course(fix);
                corrections.velocity = true;
                corrections.aligned = true;
            }
        }
        if let Some((_, course_rad)) = self.forward().filter(|_| speed_m_s > self.settings.track_speed_m_s) {
            self.aiding.crab_rad = if self.course_known { wrapped_rad(fix.track_rad() - course_rad) } else { 0.0 };
        }
    }

    /// Each axis of the antenna's velocity v + R (ω × r), as it was when the receiver measured it, and the track, very weakly. The
    /// error of the velocity was then another one by what tilt and accelerometer bias did to it since.
    fn measure(&mut self, fix: &Fix, interval_s: f64) {
        let (settings, mut error) = (self.settings, Error::zeros());
        let age_s = fix.age_s.filter(|age_s| (0.0..=1.0).contains(age_s));
        let late_s = age_s.unwrap_or(self.latency_s);
        let (velocity_m_s, slope_m_s2) = self.past.at(late_s, self.velocity_m_s + self.antenna_m_s, self.sums.length_s);
        let sd_m_s =
            fix.sd_m_s.filter(|sd| (0.0..1e6).contains(sd)).map_or(settings.velocity_sd_m_s, |sd| sd.max(SD_MIN_M_S));
        let (limit, variance) = (settings.innovation_limit, sd_m_s * sd_m_s);
        let force_m_s2 = slope_m_s2 + Vector3::z() * GRAVITY_M_S2;
        let tilting = force_m_s2.cross_matrix() * late_s;
        let biasing = self.attitude.matrix().transpose() * late_s;
        let (heading, slope) = (f64::from(u8::from(self.course_known)), if age_s.is_some() { 0.0 } else { 1.0 });
        let innovations = [0, 1, 2].map(|axis| {
            let (tilt, bias) = (tilting.row(axis), biasing.row(axis));
            let row = [
                (VELOCITY + axis, 1.0),
                (ROTATION, tilt[0]),
                (ROTATION + 1, tilt[1]),
                (HEADING, tilt[2] * heading),
                (ACCEL, bias[0]),
                (ACCEL + 1, bias[1]),
                (ACCEL + 2, bias[2]),
                (LATENCY, slope_m_s2[axis] * slope),
            ];
            let residual = velocity_m_s[axis] - fix.velocity_m_s[axis];
            self.covariance.update(&mut error, limit, &Measurement { residual, row: &row, variance, considered: &[] })
        });
        self.consistency.see(innovations, interval_s);
        let speed_m_s = fix.speed_m_s();
        if let Some((_, course_rad)) =
            self.forward().filter(|_| self.course_known && speed_m_s > self.settings.track_speed_m_s)
        {
            let residual = wrapped_rad(course_rad - fix.track_rad() - self.turn_rate_rad_s * late_s);
            let variance = shared(settings.wind_m_s / speed_m_s, settings.wind_memory_s, interval_s);
            let row = [(HEADING, -1.0)];
            self.covariance.update(&mut error, limit, &Measurement { residual, row: &row, variance, considered: &[] });
        }
        self.correct(&error);
    }

    /// The velocity becomes the receiver's, the heading that of the track unless it counts from north; level and biases stay.
    fn begin_course(&mut self, fix: &Fix) {
        let Some((_, course_rad)) = self.forward() else { return };
        if self.reference != Reference::True {
            let track_rad = fix.track_rad() + self.turn_rate_rad_s * self.latency_s;
            let turn_rad = wrapped_rad(course_rad - track_rad);
            self.attitude.z_rad = wrapped_rad(self.attitude.z_rad + turn_rad);
            let (sin, cos) = libm::sincos(turn_rad);
            let before = self.pending_rad;
            self.pending_rad = Vector3::new(cos * before.x - sin * before.y, sin * before.x + cos * before.y, before.z);
            let wind = square((self.settings.wind_m_s / fix.speed_m_s()).min(FIRST_COURSE_SD_RAD));
            self.covariance.begin(HEADING, square(self.settings.course_sd_deg.to_radians()) + wind);
            self.reference = Reference::True;
        }
        self.course_known = true;
        let sd_m_s = self.settings.velocity_sd_m_s.max(1.0);
        self.begin_velocity(fix.velocity_m_s - self.antenna_m_s, sd_m_s, sd_m_s);
    }
}
