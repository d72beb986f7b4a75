//! The course stage `track`: the gyroscopic course, drawn to the track over ground.
//!
//! H_k = H_{k−1} + (HΓ_k − HΓ_{k−1}) − h (H_{k−1} − H_track)/T,  T = 50 s                         S4, (5)
//!
//! ("S4": *Orientation algorithm for a low-grade MEMS strapdown system, tried on a Mi-8 helicopter*.) Short turns are the gyro's, the
//! long run is the receiver's. A gyro bias b about the vertical leaves an error of T b: 2.5° for 0.05 °/s. What is kept is the
//! difference H − HΓ, to which the first line is the same equation, and which a loop over the top does not disturb.
//!
//! A track counts once, at the tick of its fix and for the interval since the one before, held against the course at the moment at
//! which it was valid. In a gap, and below a ground speed at which a track means nothing, the course is the gyroscopic one.
//!
//! The first track sets the course; so does a fuser whose heading becomes true. Both are jumps, and told.

use super::{
    continuity::{Continuity, GIMBAL_RAD, course_of_rad, gyroscopic},
    input::CourseInput,
    reading::{LastReading, Reading},
    reference::Reference,
};
use crate::{
    gnss::Fix,
    numbers::Numbers,
    parameters::{Parameter, ParameterError, Parameters, settings},
    stage::{RestoreError, Stage},
    state::wrapped_rad,
};
use core::f64::consts::{PI, TAU};

settings! {
    /// Settings of `track`.
    pub struct TrackSettings {
        /// Magnetic declination, east positive: with it a magnetic gyroscopic course becomes a true one; yaw and quaternion stay magnetic. 0 leaves it magnetic.
        declination_deg: 0.0 in -180.0 .. 180.0, "°";
        /// Time constant at which the course follows the track.
        time_constant_s: 50.0 in 1.0 .. 10000.0, "s";
        /// Ground speed below which a track says nothing about the course.
        track_speed_m_s: 3.0 in 0.5 .. 100.0, "m/s";
        /// Time for which one track counts at most; a longer one between two tracks is a gap.
        gap_s: 1.5 in 0.1 .. 60.0, "s";
        /// How old a velocity is on arrival where the receiver does not tell.
        latency_s: 0.2 in 0.0 .. 2.0, "s";
        /// How fast the gyroscopic course drifts, for the standard deviation.
        drift_deg_s: 0.05 in 0.0 .. 10.0, "°/s";
        /// How far a vehicle's nose is from its track, RMS: wind and slip, for the standard deviation.
        crab_deg: 3.0 in 0.0 .. 90.0, "°";
    }
}

/// Time over which the turn rate is averaged, s.
const TURN_MEAN_S: f64 = 0.5;
/// A course that turns faster does so over the top, where it flips, rad/s.
const TURN_LIMIT_RAD_S: f64 = 10.0;
/// Standard deviation of a receiver's velocity where it tells none, m/s.
const VELOCITY_SD_M_S: f64 = 0.1;
/// A speed beyond this is no vehicle's, m/s.
const SPEED_LIMIT_M_S: f64 = 3000.0;

/// The course stage `track`.
///
/// Its standard deviation is √(σ_d² + σ_t²): σ_d of the drift grows by the gyro's drift d as long as there is no track and decays
/// by σ_d/T with one, so that it settles at T d, the error of S4's equation; σ_t is the crab angle and the noise of the track. Where the fuser
/// itself corrects its heading, σ_d is at most that heading's.
#[derive(Debug, Clone, PartialEq)]
pub struct OfTrack {
    settings: TrackSettings,
    continuity: Continuity,
    /// HΓ of the tick before, rad, and what it was counted from.
    gyroscopic_rad: f64,
    reference: Reference,
    /// There was a tick before.
    followed: bool,
    /// H − HΓ, rad; means nothing while the course is unknown.
    offset_rad: f64,
    known: bool,
    /// H', rad/s, clockwise.
    turn_rate_rad_s: f64,
    since_track_s: f64,
    drift_sd_rad: f64,
    track_sd_rad: f64,
}

impl Default for OfTrack {
    fn default() -> Self {
        Self {
            settings: TrackSettings::default(),
            continuity: Continuity::default(),
            gyroscopic_rad: 0.0,
            reference: Reference::Arbitrary,
            followed: false,
            offset_rad: 0.0,
            known: false,
            turn_rate_rad_s: 0.0,
            since_track_s: 0.0,
            drift_sd_rad: PI,
            track_sd_rad: 0.0,
        }
    }
}

impl OfTrack {
    /// The gyroscopic course is counted from elsewhere than before; true when the course jumps with it.
    fn rebase(&mut self, gyroscopic_rad: f64, reference: Reference) -> bool {
        let told = core::mem::replace(&mut self.followed, true);
        self.reference = reference;
        if reference == Reference::True {
            (self.offset_rad, self.known) = (0.0, true);
            (self.drift_sd_rad, self.track_sd_rad) = (PI, 0.0);
            return told;
        }
        if self.known {
            self.offset_rad = wrapped_rad(self.continuity.bearing.course_rad - gyroscopic_rad);
            return false;
        }
        told
    }

    /// A track; true when it is the first, which sets the course.
    fn follow(&mut self, fix: &Fix, gyroscopic_rad: f64) -> bool {
        let settings = &self.settings;
        let age_s = fix.age_s.unwrap_or(settings.latency_s).clamp(0.0, 2.0);
        let sd_m_s = fix.sd_m_s.filter(|sd| *sd >= 0.0).unwrap_or(VELOCITY_SD_M_S);
        let then_rad = gyroscopic_rad - self.turn_rate_rad_s * age_s;
        let seen_rad = wrapped_rad(fix.track_rad() - then_rad);
        self.track_sd_rad = libm::hypot(settings.crab_deg.to_radians(), libm::atan2(sd_m_s, fix.speed_m_s()));
        let interval_s = self.since_track_s.min(settings.gap_s);
        self.since_track_s = 0.0;
        if !self.known {
            (self.offset_rad, self.known, self.drift_sd_rad) = (seen_rad, true, 0.0);
            return true;
        }
        let gain = -libm::expm1(-interval_s / settings.time_constant_s);
        self.offset_rad = wrapped_rad(self.offset_rad + wrapped_rad(seen_rad - self.offset_rad) * gain);
        self.drift_sd_rad -= self.drift_sd_rad * gain;
        false
    }

    fn sd_rad(&self) -> f64 {
        libm::hypot(self.drift_sd_rad, self.track_sd_rad).min(PI)
    }
}

impl Stage for OfTrack {
    type Input = CourseInput;
    type Output = Reading;
    type Common = LastReading;

    fn name(&self) -> &'static str {
        "track"
    }

    fn parameters(&self) -> &'static [Parameter] {
        TrackSettings::TABLE
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        self.settings.set(name, value)
    }

    fn step(&mut self, input: &CourseInput) -> Reading {
        let angles = input.attitude.angles();
        let mut bearing = gyroscopic(input, angles.yaw_rad, self.settings.declination_deg);
        let gyroscopic_rad = bearing.course_rad;
        let mut aligned = false;
        if !self.followed || bearing.reference != self.reference {
            aligned = self.rebase(gyroscopic_rad, bearing.reference);
        } else if input.dt_s > 0.0 {
            let rate_rad_s = wrapped_rad(gyroscopic_rad - self.gyroscopic_rad) / input.dt_s;
            let rate_rad_s = rate_rad_s.clamp(-TURN_LIMIT_RAD_S, TURN_LIMIT_RAD_S);
            self.turn_rate_rad_s += (rate_rad_s - self.turn_rate_rad_s) * (input.dt_s / TURN_MEAN_S).min(1.0);
        }
        self.gyroscopic_rad = gyroscopic_rad;
        let dt_s = if input.dt_s.is_finite() { input.dt_s.clamp(0.0, 1.0) } else { 0.0 };
        self.since_track_s += dt_s;
        self.drift_sd_rad = (self.drift_sd_rad + self.settings.drift_deg_s.to_radians() * dt_s).min(PI);
        if bearing.reference != Reference::Arbitrary {
            self.drift_sd_rad = self.drift_sd_rad.min(bearing.sd_rad);
        }
        let level_enough = libm::fabs(angles.pitch_rad) < GIMBAL_RAD;
        let tells = |fix: &&Fix| (self.settings.track_speed_m_s..SPEED_LIMIT_M_S).contains(&fix.speed_m_s());
        if let Some(fix) = input.fix.and_then(Fix::finite).as_ref().filter(tells).filter(|_| level_enough) {
            aligned |= self.follow(fix, gyroscopic_rad);
        }
        if self.known {
            bearing.course_rad = course_of_rad(gyroscopic_rad + self.offset_rad);
            bearing.reference = Reference::True;
            bearing.sd_rad = self.sd_rad();
        }
        self.continuity.read(input, angles, bearing, self.settings.declination_deg, aligned)
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.continuity.visit(visit);
        self.gyroscopic_rad.visit(visit);
        self.reference.visit(visit);
        self.followed.visit(visit);
        self.offset_rad.visit(visit);
        self.known.visit(visit);
        self.turn_rate_rad_s.visit(visit);
        self.since_track_s.visit(visit);
        self.drift_sd_rad.visit(visit);
        self.track_sd_rad.visit(visit);
    }

    fn flaw(&self) -> Option<&'static str> {
        let negative = self.since_track_s < 0.0 || self.drift_sd_rad < 0.0 || self.track_sd_rad < 0.0;
        let wound = libm::fabs(self.offset_rad) > 4.0
            || !(0.0..TAU).contains(&self.gyroscopic_rad)
            || libm::fabs(self.turn_rate_rad_s) > TURN_LIMIT_RAD_S;
        self.continuity
            .flaw()
            .or(negative.then_some("a time or a standard deviation below zero"))
            .or(wound.then_some("an angle of more than a turn, or a rate that no course has"))
    }

    fn common(&self) -> LastReading {
        self.continuity.last()
    }

    /// A true course goes on; any other begins anew with the next track.
    fn adopt(&mut self, last: &LastReading) -> Result<(), RestoreError> {
        let continuity = Continuity::of(last)?;
        *self = Self { settings: self.settings, continuity, ..Self::default() };
        if let Some(bearing) = last.bearing.filter(|bearing| bearing.reference == Reference::True) {
            self.known = true;
            self.drift_sd_rad = bearing.sd_rad;
        }
        Ok(())
    }
}
