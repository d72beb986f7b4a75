//! Course stage `track`: the gyroscopic course, corrected towards the track over ground.
//!
//! H_k = H_{k−1} + (HΓ_k − HΓ_{k−1}) − h (H_{k−1} − H_track)/T,  T = 50 s — S4, (5)
//!
//! ("S4": *Orientation algorithm for a low-grade MEMS strapdown system, tried on a Mi-8
//! helicopter*.)
//!
//! Here H is the course, HΓ the gyroscopic course, H_track the track and h the interval since the
//! previous track. In the short term the course follows the gyro, in the long term the receiver. A
//! gyro bias b about the vertical leaves an error of T b, which is 2.5° for 0.05 °/s. The stage
//! stores the difference H − HΓ instead of H. Unlike H and HΓ, which flip at the top of an
//! aerobatic loop, this difference is continuous.
//!
//! Each track is used once, at the tick of its fix, and weighted by the interval since the previous
//! track. It is compared with the course at the time at which the velocity was valid. In a gap, and
//! at ground speeds too low for a meaningful track, the course follows the gyroscopic course.
//!
//! The first track sets the course, and so does a change of the fuser's heading reference to true
//! north. In both cases the course jumps, and the jump is flagged.

use super::{
    continuity::{Continuity, GIMBAL_RAD, gyroscopic_course, wrap_course_rad},
    input::CourseInput,
    reading::{CourseReading, LastReading},
    reference::CourseReference,
};
use crate::{
    gnss::{Fix, MAX_SPEED_M_S},
    parameters::{parameters_of, settings},
    scalars::visit_fields,
    stage::{RestoreError, Stage},
    state::wrapped_rad,
};
use core::f64::consts::{PI, TAU};

settings! {
    /// Settings of `track`.
    pub struct TrackSettings {
        /// Magnetic declination, east positive. It converts a magnetic gyroscopic course to a true
        /// one; yaw and quaternion stay magnetic. 0 leaves the course magnetic.
        declination_deg: 0.0 in -180.0 .. 180.0, "°";
        /// Time constant with which the course follows the track.
        time_constant_s: 50.0 in 1.0 .. 10000.0, "s";
        /// Minimum ground speed at which the track is used.
        track_speed_m_s: 3.0 in 0.5 .. 100.0, "m/s";
        /// Maximum interval since the previous track that is used to weight a track. A longer
        /// interval counts as a gap and is reduced to this value.
        gap_s: 1.5 in 0.1 .. 60.0, "s";
        /// Assumed age of a velocity on arrival if the receiver does not report the age.
        latency_s: 0.2 in 0.0 .. 2.0, "s";
        /// Drift rate of the gyroscopic course, used for the standard deviation.
        drift_deg_s: 0.05 in 0.0 .. 10.0, "°/s";
        /// RMS angle between a vehicle's nose and its track, caused by wind and slip; used for the
        /// standard deviation.
        crab_deg: 3.0 in 0.0 .. 90.0, "°";
    }
}

/// Averaging time of the turn rate, s.
const TURN_RATE_AVERAGING_S: f64 = 0.5;
/// Limit to which a measured turn rate is clamped, rad/s. Faster changes of the course occur only
/// when it flips at the top of an aerobatic loop.
const MAX_TURN_RATE_RAD_S: f64 = 10.0;
/// Assumed standard deviation of a velocity if the receiver does not report it, m/s.
const DEFAULT_VELOCITY_SD_M_S: f64 = 0.1;

/// Course stage `track`.
///
/// The standard deviation of the course is √(σ_d² + σ_t²). The part σ_d grows at the drift rate d
/// of the gyro, and tracks reduce it with time constant T. With continuous tracks it therefore
/// settles at T d, the error of S4's equation. The part σ_t comes from the crab angle and the
/// velocity noise of the track. If the fuser itself corrects its heading, σ_d is limited to the
/// standard deviation of that heading.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackCourse {
    settings: TrackSettings,
    continuity: Continuity,
    /// Gyroscopic course HΓ of the previous tick, rad.
    gyroscopic_rad: f64,
    reference: CourseReference,
    has_previous: bool,
    /// Difference H − HΓ between the course and the gyroscopic course, rad; meaningless while the
    /// course is unknown.
    offset_rad: f64,
    is_known: bool,
    /// Clockwise turn rate H', rad/s.
    turn_rate_rad_s: f64,
    since_track_s: f64,
    drift_sd_rad: f64,
    track_sd_rad: f64,
}

impl Default for TrackCourse {
    fn default() -> Self {
        Self {
            settings: TrackSettings::default(),
            continuity: Continuity::default(),
            gyroscopic_rad: 0.0,
            reference: CourseReference::Arbitrary,
            has_previous: false,
            offset_rad: 0.0,
            is_known: false,
            turn_rate_rad_s: 0.0,
            since_track_s: 0.0,
            drift_sd_rad: PI,
            track_sd_rad: 0.0,
        }
    }
}

impl TrackCourse {
    /// Handles a change of the reference of the gyroscopic course. The first reference also counts
    /// as a change. Returns `true` if the course jumps.
    fn change_reference(&mut self, gyroscopic_rad: f64, reference: CourseReference) -> bool {
        let jumps = core::mem::replace(&mut self.has_previous, true);
        self.reference = reference;
        if reference == CourseReference::True {
            (self.offset_rad, self.is_known) = (0.0, true);
            (self.drift_sd_rad, self.track_sd_rad) = (PI, 0.0);
            return jumps;
        }
        if self.is_known {
            self.offset_rad = wrapped_rad(self.continuity.course.course_rad - gyroscopic_rad);
            return false;
        }
        jumps
    }

    /// Corrects the course with a track. Returns `true` for the first track, which sets the course.
    fn apply_track(&mut self, fix: &Fix, gyroscopic_rad: f64) -> bool {
        let settings = &self.settings;
        let age_s = fix.age_s.unwrap_or(settings.latency_s).clamp(0.0, 2.0);
        let sd_m_s = fix.sd_m_s.filter(|sd| *sd >= 0.0).unwrap_or(DEFAULT_VELOCITY_SD_M_S);
        let past_rad = gyroscopic_rad - self.turn_rate_rad_s * age_s;
        let measured_offset_rad = wrapped_rad(fix.track_rad() - past_rad);
        self.track_sd_rad = libm::hypot(settings.crab_deg.to_radians(), libm::atan2(sd_m_s, fix.speed_m_s()));
        let interval_s = self.since_track_s.min(settings.gap_s);
        self.since_track_s = 0.0;
        if !self.is_known {
            (self.offset_rad, self.is_known, self.drift_sd_rad) = (measured_offset_rad, true, 0.0);
            return true;
        }
        let gain = -libm::expm1(-interval_s / settings.time_constant_s);
        self.offset_rad = wrapped_rad(self.offset_rad + wrapped_rad(measured_offset_rad - self.offset_rad) * gain);
        self.drift_sd_rad -= self.drift_sd_rad * gain;
        false
    }

    fn sd_rad(&self) -> f64 {
        libm::hypot(self.drift_sd_rad, self.track_sd_rad).min(PI)
    }
}

impl Stage for TrackCourse {
    type Input = CourseInput;
    type Output = CourseReading;
    type Common = LastReading;

    fn name(&self) -> &'static str {
        "track"
    }

    parameters_of!(TrackSettings in settings);

    fn step(&mut self, input: &CourseInput) -> CourseReading {
        let angles = input.attitude.angles();
        let mut course = gyroscopic_course(input, angles.yaw_rad, self.settings.declination_deg);
        let gyroscopic_rad = course.course_rad;
        let mut aligned = false;
        if !self.has_previous || course.reference != self.reference {
            aligned = self.change_reference(gyroscopic_rad, course.reference);
        } else if input.dt_s > 0.0 {
            let rate_rad_s = wrapped_rad(gyroscopic_rad - self.gyroscopic_rad) / input.dt_s;
            let rate_rad_s = rate_rad_s.clamp(-MAX_TURN_RATE_RAD_S, MAX_TURN_RATE_RAD_S);
            self.turn_rate_rad_s += (rate_rad_s - self.turn_rate_rad_s) * (input.dt_s / TURN_RATE_AVERAGING_S).min(1.0);
        }
        self.gyroscopic_rad = gyroscopic_rad;
        let dt_s = if input.dt_s.is_finite() { input.dt_s.clamp(0.0, 1.0) } else { 0.0 };
        self.since_track_s += dt_s;
        self.drift_sd_rad = (self.drift_sd_rad + self.settings.drift_deg_s.to_radians() * dt_s).min(PI);
        if course.reference != CourseReference::Arbitrary {
            self.drift_sd_rad = self.drift_sd_rad.min(course.sd_rad);
        }
        let nose_is_level = libm::fabs(angles.pitch_rad) < GIMBAL_RAD;
        let is_usable = |fix: &&Fix| (self.settings.track_speed_m_s..MAX_SPEED_M_S).contains(&fix.speed_m_s());
        if let Some(fix) = input.fix.and_then(Fix::finite).as_ref().filter(is_usable).filter(|_| nose_is_level) {
            aligned |= self.apply_track(fix, gyroscopic_rad);
        }
        if self.is_known {
            course.course_rad = wrap_course_rad(gyroscopic_rad + self.offset_rad);
            course.reference = CourseReference::True;
            course.sd_rad = self.sd_rad();
        }
        self.continuity.next_reading(input, angles, course, self.settings.declination_deg, aligned)
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        visit_fields!(self, visit:
            continuity, gyroscopic_rad, reference, has_previous, offset_rad, is_known, turn_rate_rad_s, since_track_s,
            drift_sd_rad, track_sd_rad; without settings
        );
    }

    fn validation_error(&self) -> Option<&'static str> {
        let negative = self.since_track_s < 0.0 || self.drift_sd_rad < 0.0 || self.track_sd_rad < 0.0;
        let out_of_range = libm::fabs(self.offset_rad) > 4.0
            || !(0.0..TAU).contains(&self.gyroscopic_rad)
            || libm::fabs(self.turn_rate_rad_s) > MAX_TURN_RATE_RAD_S;
        self.continuity
            .validation_error()
            .or(negative.then_some("a negative time or standard deviation"))
            .or(out_of_range.then_some("an angle or a turn rate out of range"))
    }

    fn common(&self) -> LastReading {
        self.continuity.last()
    }

    /// Continues the last course if it refers to true north. Otherwise the next track sets the
    /// course.
    fn adopt(&mut self, last: &LastReading) -> Result<(), RestoreError> {
        let continuity = Continuity::from_last(last)?;
        *self = Self { settings: self.settings, continuity, ..Self::default() };
        if let Some(course) = last.course.filter(|course| course.reference == CourseReference::True) {
            self.is_known = true;
            self.drift_sd_rad = course.sd_rad;
        }
        Ok(())
    }
}
