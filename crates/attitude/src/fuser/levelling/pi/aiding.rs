//! What fixes say: increments of velocity, and the track.

use super::{
    matched::{AGE_MAX_S, Matched},
    settings::PiSettings,
};
use crate::{Complex, gnss::Fix, numbers::Numbers};

/// Speed below which the axes of a velocity do not matter, m/s.
const SLOW_M_S: f64 = 0.7;
/// Two tracks that differ by less are a course, as the cosine: 30°.
const SAME_TRACK: f64 = 0.866;

/// An increment of velocity between the moments at which two fixes were valid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Both {
    /// The integral of the force, platform, m/s.
    pub(super) by_force_m_s: Complex<f64>,
    /// The difference of the fixes, east + j north, m/s.
    pub(super) by_fixes_m_s: Complex<f64>,
    /// s
    pub(super) span_s: f64,
}

/// A track over ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Track {
    /// East + j north, of unit length.
    pub(super) direction: Complex<f64>,
    /// How old it is, s.
    pub(super) age_s: f64,
    /// There was another just before, and the two agree.
    pub(super) sure: bool,
}

/// Follows the fixes.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Aiding {
    matched: Matched,
    /// East + j north, m/s.
    velocity_m_s: Complex<f64>,
    /// The increment since that velocity is known from its beginning.
    whole: bool,
    since_fix_s: f64,
    seen: bool,
}

impl Aiding {
    /// Speed over ground at the last fix, m/s; `None` before the first.
    pub(super) fn speed_m_s(&self) -> Option<f64> {
        self.seen.then(|| libm::sqrt(self.velocity_m_s.norm_sqr()))
    }

    /// Time since the last fix, s; 0 before the first.
    pub(super) fn since_fix_s(&self) -> f64 {
        if self.seen { self.since_fix_s } else { 0.0 }
    }

    /// The last fix is recent.
    pub(super) fn is_recent(&self, gap_s: f64) -> bool {
        self.seen && self.since_fix_s <= gap_s
    }

    pub(super) fn pass(&mut self, dt_s: f64) {
        self.since_fix_s += dt_s;
    }

    /// One sample of the force in the platform.
    pub(super) fn push(&mut self, force_m_s2: Complex<f64>, dt_s: f64) {
        if dt_s > 0.0 {
            self.matched.push(force_m_s2, dt_s);
        }
    }

    /// The integral of the force has a hole, or its axes have turned: the increment begins anew with the next fix.
    pub(super) fn interrupt(&mut self) {
        self.matched = Matched::default();
        self.whole = false;
    }

    /// Takes a fix. An increment over a gap is lost; without a known azimuth one counts only where there is next to no velocity.
    pub(super) fn take(
        &mut self,
        fix: &Fix,
        azimuth_known: bool,
        settings: &PiSettings,
    ) -> (Option<Both>, Option<Track>) {
        let age_s = fix.age_s.unwrap_or(settings.latency_s).clamp(0.0, AGE_MAX_S);
        let velocity_m_s = Complex::new(fix.velocity_m_s.x, fix.velocity_m_s.y);
        let recent = self.is_recent(settings.gap_s);
        let before_m_s = core::mem::replace(&mut self.velocity_m_s, velocity_m_s);
        let increment = self.matched.take(age_s);
        let whole = core::mem::replace(&mut self.whole, self.matched.since_s() > age_s - 1e-6);
        (self.since_fix_s, self.seen) = (0.0, true);

        let (speed_m_s, speed_before_m_s) = (libm::sqrt(velocity_m_s.norm_sqr()), libm::sqrt(before_m_s.norm_sqr()));
        let in_axes = azimuth_known || speed_m_s.max(speed_before_m_s) < SLOW_M_S;
        let span_s = increment.span_s;
        let usable = whole && recent && in_axes && (1e-3..=2.0 * settings.gap_s).contains(&span_s);
        let by_fixes_m_s = velocity_m_s - before_m_s;
        let both = usable.then_some(Both { by_force_m_s: increment.velocity_m_s, by_fixes_m_s, span_s });

        let along = (velocity_m_s * before_m_s.conj()).re;
        let sure =
            recent && speed_before_m_s >= settings.track_speed_m_s && along > SAME_TRACK * speed_m_s * speed_before_m_s;
        let moves = speed_m_s >= settings.track_speed_m_s;
        (both, moves.then(|| Track { direction: velocity_m_s / speed_m_s, age_s, sure }))
    }

    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        self.matched.flaw().or((self.since_fix_s < 0.0).then_some("a time below zero"))
    }
}

impl Numbers for Aiding {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.matched.visit(visit);
        self.velocity_m_s.visit(visit);
        self.whole.visit(visit);
        self.since_fix_s.visit(visit);
        self.seen.visit(visit);
    }
}
