//! Measurements from fixes: velocity increments and the track.

use super::{
    delay_matching::{DelayMatchedIntegral, MAX_AGE_S},
    settings::PiSettings,
};
use crate::{Complex, gnss::Fix, scalars::scalars};

/// Speed below which the direction of a velocity, and thus the azimuth, is irrelevant, m/s.
const SLOW_SPEED_M_S: f64 = 0.7;
/// Minimum cosine of the angle between two tracks that confirm each other (30°).
const MIN_TRACK_COSINE: f64 = 0.866;

/// Velocity increment between the validity times of two fixes, measured in two ways.
///
/// One measurement comes from the specific force, the other from the velocities of the fixes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct MatchedIncrement {
    /// Integral of the force in platform axes, m/s.
    pub(super) by_force_m_s: Complex<f64>,
    /// Difference between the velocities of the fixes, as east + j north, m/s.
    pub(super) by_fixes_m_s: Complex<f64>,
    /// Time between the validity times of the two fixes, s.
    pub(super) span_s: f64,
}

/// Track over ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Track {
    /// Direction as a complex number east + j north of modulus 1.
    pub(super) direction: Complex<f64>,
    /// Age of the track on arrival, s.
    pub(super) age_s: f64,
    /// Set if the previous fix had a track, too, and the two tracks agree.
    pub(super) is_confirmed: bool,
}

/// State of the aiding by fixes: the last fix and the velocity increment since it.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Aiding {
    matched: DelayMatchedIntegral,
    /// Velocity reported by the last fix, as east + j north, m/s.
    velocity_m_s: Complex<f64>,
    /// Set if the force has been integrated without interruption since the validity time of the
    /// last fix.
    is_increment_complete: bool,
    since_fix_s: f64,
    has_fix: bool,
}

impl Aiding {
    /// Returns the speed over ground at the last fix, m/s; `None` before the first fix.
    pub(super) fn speed_m_s(&self) -> Option<f64> {
        self.has_fix.then(|| libm::sqrt(self.velocity_m_s.norm_sqr()))
    }

    /// Returns the time since the last fix, s; 0 before the first fix.
    pub(super) fn since_fix_s(&self) -> f64 {
        if self.has_fix { self.since_fix_s } else { 0.0 }
    }

    /// Returns `true` if the last fix is at most `gap_s` old.
    pub(super) fn is_recent(&self, gap_s: f64) -> bool {
        self.has_fix && self.since_fix_s <= gap_s
    }

    pub(super) fn advance(&mut self, dt_s: f64) {
        self.since_fix_s += dt_s;
    }

    /// Adds a sample of the force, in platform axes, to the velocity increment.
    pub(super) fn push_force(&mut self, force_m_s2: Complex<f64>, dt_s: f64) {
        if dt_s > 0.0 {
            self.matched.push(force_m_s2, dt_s);
        }
    }

    /// Discards the velocity increment, because force samples are missing or the platform axes have
    /// changed. The next fix starts a new increment.
    pub(super) fn interrupt(&mut self) {
        self.matched = DelayMatchedIntegral::default();
        self.is_increment_complete = false;
    }

    /// Processes a fix. Returns the velocity increment since the previous fix and the track, if
    /// usable.
    ///
    /// There is no increment if the previous fix is too old. While the azimuth is unknown, there is
    /// an increment only if the velocities of both fixes are nearly zero, because their direction
    /// is then irrelevant.
    pub(super) fn process_fix(
        &mut self,
        fix: &Fix,
        azimuth_known: bool,
        settings: &PiSettings,
    ) -> (Option<MatchedIncrement>, Option<Track>) {
        let age_s = fix.age_s.unwrap_or(settings.latency_s).clamp(0.0, MAX_AGE_S);
        let velocity_m_s = Complex::new(fix.velocity_m_s.x, fix.velocity_m_s.y);
        let recent = self.is_recent(settings.gap_s);
        let previous_m_s = core::mem::replace(&mut self.velocity_m_s, velocity_m_s);
        let increment = self.matched.take_increment(age_s);
        let is_complete =
            core::mem::replace(&mut self.is_increment_complete, self.matched.since_fix_s() > age_s - 1e-6);
        (self.since_fix_s, self.has_fix) = (0.0, true);

        let (speed_m_s, previous_speed_m_s) =
            (libm::sqrt(velocity_m_s.norm_sqr()), libm::sqrt(previous_m_s.norm_sqr()));
        let axes_valid = azimuth_known || speed_m_s.max(previous_speed_m_s) < SLOW_SPEED_M_S;
        let span_s = increment.span_s;
        let usable = is_complete && recent && axes_valid && (1e-3..=2.0 * settings.gap_s).contains(&span_s);
        let by_fixes_m_s = velocity_m_s - previous_m_s;
        let matched = usable.then_some(MatchedIncrement { by_force_m_s: increment.velocity_m_s, by_fixes_m_s, span_s });

        let along = (velocity_m_s * previous_m_s.conj()).re;
        let is_confirmed = recent
            && previous_speed_m_s >= settings.track_speed_m_s
            && along > MIN_TRACK_COSINE * speed_m_s * previous_speed_m_s;
        let is_moving = speed_m_s >= settings.track_speed_m_s;
        (matched, is_moving.then(|| Track { direction: velocity_m_s / speed_m_s, age_s, is_confirmed }))
    }

    pub(super) fn validation_error(&self) -> Option<&'static str> {
        self.matched.validation_error().or((self.since_fix_s < 0.0).then_some("a negative time"))
    }
}

scalars!(Aiding: matched, velocity_m_s, is_increment_complete, since_fix_s, has_fix);
