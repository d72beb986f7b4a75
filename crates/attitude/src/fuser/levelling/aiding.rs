//! What fixes say to `levelling-pi`: increments of velocity, and the track.

use super::{
    integral::PiSettings,
    matched::{AGE_MAX_S, Matched},
};
use crate::{Complex, gnss::Fix, stage::Numbers};

/// Speed below which the axes of a velocity do not matter, m/s.
const SLOW_M_S: f64 = 0.7;
/// Largest part of an increment that levelling is to explain, m/s and m/s²: an outlier keeps a bounded pull.
const UNEXPLAINED_M_S: f64 = 0.5;
const UNEXPLAINED_M_S2: f64 = 2.0;
/// Two tracks that differ by less are a course, as the cosine: 30°.
const SAME_TRACK: f64 = 0.866;

/// What one fix says.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Word {
    /// Increment of velocity that the force has and the fixes have not, platform, m/s, and over which time, s.
    pub(super) unexplained: Option<(Complex<f64>, f64)>,
    /// Direction of the track, east + j north, and how old it is, s.
    pub(super) track: Option<(Complex<f64>, f64)>,
    /// The course is to be set to the track.
    pub(super) first: bool,
}

/// Follows the fixes.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Aiding {
    matched: Matched,
    /// East + j north, m/s.
    velocity_m_s: Complex<f64>,
    /// The increment since that velocity is known from its beginning.
    primed: bool,
    pub(super) since_fix_s: f64,
    pub(super) seen: bool,
    /// The platform's axes are east and north.
    pub(super) course_known: bool,
}

impl Aiding {
    /// The last fix is recent.
    pub(super) fn is_aided(&self, gap_s: f64) -> bool {
        self.seen && self.since_fix_s <= gap_s
    }

    /// Speed over ground at the last fix, m/s; 0 before the first.
    pub(super) fn speed_m_s(&self) -> f64 {
        libm::sqrt(self.velocity_m_s.norm_sqr())
    }

    /// One sample of the force in the platform; none over an interval too long for one force.
    pub(super) fn push(&mut self, force_m_s2: Complex<f64>, dt_s: f64) {
        if dt_s > 0.0 {
            self.matched.push(force_m_s2, dt_s);
        }
    }

    /// The integral of the force has a hole, or its axes have turned: the increment begins anew with the next fix.
    pub(super) fn interrupt(&mut self) {
        self.matched = Matched::default();
        self.primed = false;
    }

    /// Takes a fix.
    pub(super) fn take(&mut self, fix: &Fix, settings: &PiSettings) -> Word {
        let age_s = fix.age_s.unwrap_or(settings.latency_s).clamp(0.0, AGE_MAX_S);
        let velocity_m_s = Complex::new(fix.velocity_m_s.x, fix.velocity_m_s.y);
        let before_m_s = core::mem::replace(&mut self.velocity_m_s, velocity_m_s);
        let recent = self.is_aided(settings.gap_s);
        let increment = self.matched.take(age_s);
        let whole = core::mem::replace(&mut self.primed, self.matched.since_s() > age_s - 1e-6);
        self.since_fix_s = 0.0;
        self.seen = true;

        let (speed_m_s, speed_before_m_s) = (libm::sqrt(velocity_m_s.norm_sqr()), libm::sqrt(before_m_s.norm_sqr()));
        let slow = speed_m_s.max(speed_before_m_s) < SLOW_M_S;
        let usable = whole && recent && increment.span_s > 1e-3 && (self.course_known || slow);
        let unexplained_m_s = increment.velocity_m_s - (velocity_m_s - before_m_s);
        let unexplained =
            usable.then(|| (shortened(unexplained_m_s, increment.span_s), increment.span_s.min(settings.gap_s)));

        let moving = speed_m_s >= settings.track_speed_m_s;
        let along = velocity_m_s.re * before_m_s.re + velocity_m_s.im * before_m_s.im;
        let same = speed_before_m_s >= settings.track_speed_m_s && along > SAME_TRACK * speed_m_s * speed_before_m_s;
        let first = !self.course_known && recent && moving && same;
        let track = (moving && (self.course_known || first)).then(|| (velocity_m_s / speed_m_s, age_s));
        if first {
            self.course_known = true;
            self.interrupt();
        }
        Word { unexplained, track, first }
    }

    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        self.matched.flaw().or((self.since_fix_s < 0.0).then_some("a time below zero"))
    }
}

fn shortened(unexplained_m_s: Complex<f64>, span_s: f64) -> Complex<f64> {
    let (size, limit) = (libm::sqrt(unexplained_m_s.norm_sqr()), UNEXPLAINED_M_S + UNEXPLAINED_M_S2 * span_s);
    if size > limit { unexplained_m_s * (limit / size) } else { unexplained_m_s }
}

impl Numbers for Aiding {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.matched.visit(visit);
        self.velocity_m_s.visit(visit);
        self.primed.visit(visit);
        self.since_fix_s.visit(visit);
        self.seen.visit(visit);
        self.course_known.visit(visit);
    }
}
