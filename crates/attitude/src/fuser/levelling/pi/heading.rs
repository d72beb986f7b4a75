//! The azimuth of the platform, by the track over ground and by the direction of accelerations.
//!
//! The track is where the vehicle goes, which in wind is not where it points: it draws the azimuth over T = 50 s, as S4's (5), and the
//! bias about the vertical over 4 T. An acceleration is the same vector in the force and in the velocity, wind or not: in a turn
//! the angle between the two is the error of the azimuth. Once turns have told it, the track draws at half that rate.

use super::settings::PiSettings;
use crate::{Complex, fuser::low_pass::low_pass_gain, numbers::Numbers, state::arg};
use core::f64::consts::PI;

/// Acceleration from which its direction counts for more than the noise of the velocity, m/s².
const CLEAR_M_S2: f64 = 1.0;
/// Largest error of the azimuth that one increment shows, rad.
const ASTRAY_MAX_RAD: f64 = 0.3;
/// Accelerated for so long, the vehicle has told its course by turns, s.
const TURNED_S: f64 = 40.0;
/// Wind across the track that is usual, m/s.
const CRAB_M_S: f64 = 6.0;

/// What the azimuth and the bias about the vertical are to be less.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Steer {
    /// rad, counter-clockwise
    pub(super) turn_rad: f64,
    /// Of the estimate, rad/s, about the vertical: a gyro that reads too much has turned the azimuth too far.
    pub(super) bias_rad_s: f64,
}

/// What is known of the azimuth.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Heading {
    /// The platform's axes are east and north.
    pub(super) known: bool,
    /// Standard deviation less that of the crab angle; π while it is unknown.
    drift_sd_rad: f64,
    /// Time for which accelerations have told the course, s, up to [`TURNED_S`].
    turned_s: f64,
}

impl Default for Heading {
    fn default() -> Self {
        Self { known: false, drift_sd_rad: PI, turned_s: 0.0 }
    }
}

impl Heading {
    /// Known from elsewhere.
    pub(super) fn of(sd_rad: f64) -> Self {
        Self { known: true, drift_sd_rad: sd_rad.min(PI), turned_s: 0.0 }
    }

    /// The azimuth drifts by what is not known of the bias.
    pub(super) fn pass(&mut self, bias_sd_rad_s: f64, dt_s: f64) {
        self.drift_sd_rad = (self.drift_sd_rad + bias_sd_rad_s * dt_s).min(PI);
    }

    /// The first track: the azimuth is set to it.
    pub(super) fn set(&mut self, forward: Complex<f64>, track: Complex<f64>) -> Steer {
        *self = Self::of(0.0);
        Steer { turn_rad: arg(forward * track.conj()), bias_rad_s: 0.0 }
    }

    /// A track that counts for `span_s`; forward in the platform at the moment at which it was valid.
    pub(super) fn by_track(
        &mut self,
        forward: Complex<f64>,
        track: Complex<f64>,
        span_s: f64,
        settings: &PiSettings,
    ) -> Steer {
        let PiSettings { track_time_constant_s, turned_track_time_constant_s, .. } = *settings;
        let slower_s = turned_track_time_constant_s - track_time_constant_s;
        let time_constant_s = track_time_constant_s + slower_s * self.turned_s / TURNED_S;
        let gain = low_pass_gain(span_s, time_constant_s);
        self.drift_sd_rad -= self.drift_sd_rad * gain;
        let astray_rad = arg(forward * track.conj());
        let share_per_s2 = 0.25 / (time_constant_s * time_constant_s);
        Steer { turn_rad: astray_rad * gain, bias_rad_s: astray_rad * share_per_s2 * span_s }
    }

    /// An increment of velocity as the force has it and as the fixes have it, platform, m/s, over `span_s`.
    pub(super) fn by_acceleration(
        &mut self,
        by_force_m_s: Complex<f64>,
        by_fixes_m_s: Complex<f64>,
        span_s: f64,
        settings: &PiSettings,
    ) -> Steer {
        let (size2, clear) = (by_force_m_s.norm_sqr(), CLEAR_M_S2 * span_s);
        let all = size2 + clear * clear;
        let cross = (by_fixes_m_s.conj() * by_force_m_s).im;
        let astray_rad = if all > 0.0 { (cross / all).clamp(-ASTRAY_MAX_RAD, ASTRAY_MAX_RAD) } else { 0.0 };
        if size2 > clear * clear {
            self.turned_s = (self.turned_s + span_s).min(TURNED_S);
        }
        let time_constant_s = settings.turn_time_constant_s;
        let share_per_s2 = 0.25 / (time_constant_s * settings.track_time_constant_s);
        Steer {
            turn_rad: astray_rad * low_pass_gain(span_s, time_constant_s),
            bias_rad_s: astray_rad * share_per_s2 * span_s,
        }
    }

    /// Standard deviation at a speed: the drift, and a crab angle in a usual wind, of which turns leave half.
    pub(super) fn sd_rad(&self, speed_m_s: f64) -> f64 {
        if !self.known {
            return PI;
        }
        let crab_rad = libm::atan2(CRAB_M_S, speed_m_s) * (1.0 - 0.5 * self.turned_s / TURNED_S);
        libm::hypot(self.drift_sd_rad, crab_rad).min(PI)
    }

    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        let beyond = self.drift_sd_rad < 0.0 || !(0.0..=TURNED_S).contains(&self.turned_s);
        beyond.then_some("a standard deviation below zero or a time out of its range")
    }
}

impl Numbers for Heading {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.known.visit(visit);
        self.drift_sd_rad.visit(visit);
        self.turned_s.visit(visit);
    }
}
