//! A velocity that is assumed: the remembered speed along the course, nothing across it, nothing upwards.
//!
//! The variances are large, and larger while the body turns: with fixed gains this is the autonomous law of platform levelling, the
//! low-pass filtered specific force less V H'. An assumed velocity must not steer the course; its gains for heading and for the
//! gyro's bias about the body's vertical are zero.

use super::{
    covariance::{Error, GYRO, GYRO_UP, HEADING, Measurement, VELOCITY},
    filter::Aided,
    standstill::{GUESSED, TOLD},
    variance::{shared, square},
};
use crate::{Vector3, fuser::input::FuserInput};

/// Time between two assumptions, s.
const INTERVAL_S: f64 = 0.2;
/// Speed over ground at which the body may stand still, m/s.
const STANDING_M_S: f64 = 0.7;
/// Standard deviation of the velocity at standstill, m/s.
const STANDING_SD_M_S: f64 = 0.1;
/// What an assumed velocity does not correct.
const CONSIDERED: [usize; 2] = [HEADING, GYRO_UP];

impl Aided {
    /// Without a fix for a while, or with one that cannot be used because the course is not known; true when it was time.
    pub(super) fn assume(&mut self) -> bool {
        let settings = self.settings;
        let interval_s = self.aiding.since_assumed_s;
        let told = self.aiding.since_fix_s < settings.gap_after_s;
        if interval_s < INTERVAL_S - 5e-4 || (told && self.course_known) {
            return false;
        }
        let Some((forward, _)) = self.forward() else { return false };
        self.aiding.since_assumed_s = 0.0;
        let (sin, cos) = libm::sincos(self.aiding.crab_rad);
        // Clockwise by the crab angle.
        let along = Vector3::new(cos * forward.x + sin * forward.y, cos * forward.y - sin * forward.x, 0.0);
        let across = Vector3::new(along.y, -along.x, 0.0);
        let turning = 1.0 + square(self.turn_rate_rad_s / settings.turn_rate_deg_s.to_radians());
        let (along_m_s, across_m_s) = (along.dot(&self.velocity_m_s), across.dot(&self.velocity_m_s));
        let (speed_m_s, along_sd_m_s) = if self.aiding.seen {
            (self.aiding.speed_m_s, settings.along_sd_m_s)
        } else {
            (0.0, settings.speed_sd_m_s)
        };
        // A heading that is not counted from north is that of the frame itself and has no error.
        let heading = if self.course_known { 1.0 } else { 0.0 };
        let mut error = Error::zeros();
        let mut assume = |residual: f64, row: &[(usize, f64)], variance: f64| {
            let measurement = Measurement { residual, row, variance, considered: &CONSIDERED };
            self.covariance.update(&mut error, settings.innovation_limit, &measurement);
        };
        assume(
            along_m_s - speed_m_s,
            &[(VELOCITY, along.x), (VELOCITY + 1, along.y), (HEADING, heading * -across_m_s)],
            shared(along_sd_m_s, settings.along_memory_s, interval_s) * turning,
        );
        assume(
            across_m_s,
            &[(VELOCITY, across.x), (VELOCITY + 1, across.y), (HEADING, heading * along_m_s)],
            shared(settings.across_sd_m_s, settings.across_memory_s, interval_s) * turning,
        );
        assume(
            self.velocity_m_s.z,
            &[(VELOCITY + 2, 1.0)],
            shared(settings.vertical_sd_m_s, settings.vertical_memory_s, interval_s),
        );
        self.correct(&error);
        true
    }

    /// At standstill the gyro reads its bias, and where no receiver tells the velocity, that is nothing; true when it was time.
    pub(super) fn rest(&mut self, input: &FuserInput, force_m_s2: Option<Vector3<f64>>) -> bool {
        let (Some(motion), Some(force_m_s2), true) = (&input.motion, force_m_s2, input.rest_credible) else {
            self.standstill.interrupt();
            return false;
        };
        let told = self.aiding.since_fix_s < self.settings.gap_after_s;
        let still = match (self.aiding.seen, told && self.aiding.speed_m_s < STANDING_M_S) {
            (true, true) => Some(&TOLD),
            (true, false) => None,
            (false, _) => Some(&GUESSED),
        };
        let rate_rad_s = motion.rate_rad_s.map(|x| x.clamp(-1e3, 1e3));
        let Some(mean_rad_s) = self.standstill.step(rate_rad_s, force_m_s2, motion.dt_s, still) else { return false };
        let mut error = Error::zeros();
        let variance = square(self.settings.standstill_sd_deg_s.to_radians());
        for axis in 0..3 {
            let residual = self.gyro_bias_rad_s[axis] - mean_rad_s[axis];
            let row = [(GYRO + axis, 1.0)];
            let measurement = Measurement { residual, row: &row, variance, considered: &[] };
            self.covariance.update(&mut error, self.settings.innovation_limit, &measurement);
        }
        if !told {
            for axis in 0..3 {
                let row = [(VELOCITY + axis, 1.0)];
                let (residual, variance) = (self.velocity_m_s[axis], square(STANDING_SD_M_S));
                let measurement = Measurement { residual, row: &row, variance, considered: &CONSIDERED };
                self.covariance.update(&mut error, self.settings.innovation_limit, &measurement);
            }
        }
        self.correct(&error);
        true
    }
}
