//! What is not a number is missing: one guard for every fuser.
//!
//! Input: what a stage is offered. Output: the same with finite numbers only. Time: an interval that is not finite or below zero is
//! none. Failure: none.

use super::input::FuserInput;
use crate::{Vector3, accel::Inclination, gnss::Fix, gyro::Motion, turn::Turn};

impl FuserInput {
    /// The input itself where all its numbers are finite, else what is left of it without the others, kept in `room`.
    #[inline]
    pub fn finite<'a>(&'a self, room: &'a mut Option<Self>) -> &'a Self {
        if self.is_finite() { self } else { room.insert(self.without_others()) }
    }

    #[inline]
    fn is_finite(&self) -> bool {
        self.motion
            .as_ref()
            .is_none_or(|motion| motion_is_finite(motion) && motion.dt_s >= 0.0 && motion.dt_s.is_finite())
            && self.inclination.as_ref().is_none_or(inclination_is_finite)
            && self.field_ut.as_ref().is_none_or(vector_is_finite)
            && self.fix.is_none_or(|fix| fix.finite() == Some(fix))
    }

    #[cold]
    fn without_others(&self) -> Self {
        let in_time = |motion: Motion| {
            let in_time = motion.dt_s >= 0.0 && motion.dt_s.is_finite();
            if in_time { motion } else { Motion { turn: Turn::NONE, dt_s: 0.0, ..motion } }
        };
        Self {
            motion: self.motion.filter(motion_is_finite).map(in_time),
            inclination: self.inclination.filter(inclination_is_finite),
            field_ut: self.field_ut.filter(vector_is_finite),
            fix: self.fix.and_then(Fix::finite),
            ..*self
        }
    }
}

/// Zero times a finite number is zero, and nothing else is.
#[inline]
fn vector_is_finite(vector: &Vector3<f64>) -> bool {
    vector.x * 0.0 + vector.y * 0.0 + vector.z * 0.0 == 0.0
}

#[inline]
fn motion_is_finite(motion: &Motion) -> bool {
    let Turn { p, s } = motion.turn;
    (p.re * 0.0 + p.im * 0.0) + (s.re * 0.0 + s.im * 0.0) == 0.0 && vector_is_finite(&motion.rate_rad_s)
}

#[inline]
fn inclination_is_finite(inclination: &Inclination) -> bool {
    let w = inclination.up.w;
    w.re * 0.0 + w.im * 0.0 + inclination.norm_m_s2 * 0.0 + inclination.trust * 0.0 == 0.0
        && vector_is_finite(&inclination.force_m_s2)
}
