//! The speed over ground that a receiver told last, and its derivative.

use crate::{gnss::Fix, numbers::Numbers};

/// The speed stands until the next fix, its derivative for one interval between fixes only: an increment of speed counts once.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Speed {
    /// V.
    speed_m_s: f64,
    /// V'.
    speed_rate_m_s2: f64,
    /// For how long it counts yet, s.
    increment_s: f64,
    since_fix_s: f64,
    seen: bool,
}

impl Speed {
    /// A fix came within so many seconds.
    pub(super) fn is_told(&self, gap_s: f64) -> bool {
        self.seen && self.since_fix_s <= gap_s
    }

    /// V, m/s.
    pub(super) fn along_m_s(&self) -> f64 {
        self.speed_m_s
    }

    /// V', m/s².
    pub(super) fn rate_m_s2(&self) -> f64 {
        if self.increment_s > 0.0 { self.speed_rate_m_s2 } else { 0.0 }
    }

    /// Time passes before a fix is looked for.
    pub(super) fn wait(&mut self, dt_s: f64) {
        self.since_fix_s += dt_s;
    }

    pub(super) fn take(&mut self, fix: &Fix, gap_s: f64) {
        let speed_m_s = fix.speed_m_s();
        if self.is_told(gap_s) && self.since_fix_s > 1e-3 {
            self.speed_rate_m_s2 = (speed_m_s - self.speed_m_s) / self.since_fix_s;
            self.increment_s = self.since_fix_s;
        }
        self.speed_m_s = speed_m_s;
        self.since_fix_s = 0.0;
        self.seen = true;
    }

    /// The tick has used the derivative over its interval.
    pub(super) fn spend(&mut self, dt_s: f64) {
        self.increment_s = (self.increment_s - dt_s).max(0.0);
    }

    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        let Self { speed_m_s, increment_s, since_fix_s, .. } = self;
        let negative = [speed_m_s, increment_s, since_fix_s].iter().any(|x| **x < 0.0);
        negative.then_some("a time or a speed below zero")
    }
}

impl Numbers for Speed {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let Self { speed_m_s, speed_rate_m_s2, increment_s, since_fix_s, seen } = self;
        [speed_m_s, speed_rate_m_s2, increment_s, since_fix_s].into_iter().for_each(|number| number.visit(visit));
        seen.visit(visit);
    }
}
