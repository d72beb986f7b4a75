//! Detects that a body at rest is back at its previous rest site.
//!
//! Input: those intervals of a rest that passed the gate of the heading filter.
//!
//! Output: once per rest, whether the rest site is the previous one.
//!
//! Time: counted in intervals.
//!
//! Failure: another site with the same field strength, dip and tilt of the body is mistaken for the
//! previous one if its magnetic field points within a few degrees of the expected direction.
//!
//! A body that returns to its previous site in the same orientation measures the same field:
//! strength, dip and up vector agree. Any rotation of the horizontal field since then is drift of
//! the gyro heading. The field p at the previous site is part of the filter's state. This module
//! decides whether that field is observed again.

use crate::{Vector3, scalars::scalars};

/// Number of intervals at rest before the decision.
const MIN_INTERVALS: f64 = 10.0;
/// Repeatability (standard deviation) of the horizontal magnetic field at a site, µT.
const HORIZONTAL_SD_UT: f64 = 0.2;
/// Repeatability (standard deviation) of the vertical magnetic field at a site, µT.
const VERTICAL_SD_UT: f64 = 0.25;
/// Repeatability (standard deviation) of each component of the up vector in body axes at a site.
const UP_SD: f64 = 0.01;
/// Largest normalised squared distance between two signatures of the same site.
const MAX_DISTANCE2: f64 = 9.0;

/// Mean magnetic field and up vector during a rest.
#[derive(Debug, Clone, Copy, PartialEq)]
struct SiteSignature {
    horizontal_ut: f64,
    vertical_ut: f64,
    up: Vector3<f64>,
    intervals: f64,
}

/// The previous rest site and the current one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct RestSite {
    last: SiteSignature,
    current: SiteSignature,
    decided: bool,
}

/// Result of comparing the current rest with the previous site.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SiteMatch {
    /// The rest is too short for a decision.
    Undecided,
    /// The body is back at the previous site. Returned once per rest.
    Revisited,
    /// The body is at another site, or its return was reported earlier in this rest. The caller
    /// stores the magnetic field of the site, to recognise the site later.
    Current,
}

impl Default for RestSite {
    fn default() -> Self {
        let empty = SiteSignature { horizontal_ut: 0.0, vertical_ut: 0.0, up: Vector3::zeros(), intervals: 0.0 };
        Self { last: empty, current: empty, decided: false }
    }
}

impl RestSite {
    /// Returns the number of intervals of the current rest.
    pub(super) fn intervals(&self) -> f64 {
        self.current.intervals
    }

    /// Ends the current rest at the start of a movement. If the rest was long enough for a
    /// decision, its site becomes the previous one.
    pub(super) fn end_rest(&mut self) {
        if self.decided {
            *self = Self { last: self.current, ..Self::default() };
        } else {
            self.current = Self::default().current;
        }
    }

    /// Processes an interval at rest.
    ///
    /// The first argument is the magnetic field in reference axes with the hard iron removed, µT.
    /// The second is the up vector in body axes.
    pub(super) fn observe(&mut self, [across, along, vertical_ut]: [f64; 3], up: [f64; 3]) -> SiteMatch {
        let current = &mut self.current;
        current.intervals += 1.0;
        let weight = current.intervals.recip();
        current.horizontal_ut += (libm::hypot(across, along) - current.horizontal_ut) * weight;
        current.vertical_ut += (vertical_ut - current.vertical_ut) * weight;
        current.up += (Vector3::from(up) - current.up) * weight;
        if current.intervals < MIN_INTERVALS {
            return SiteMatch::Undecided;
        }
        let first = !core::mem::replace(&mut self.decided, true);
        if first && self.last.intervals > 0.0 && self.current.distance2(&self.last) < MAX_DISTANCE2 {
            SiteMatch::Revisited
        } else {
            SiteMatch::Current
        }
    }

    /// Returns the reason why the state is invalid, or `None` if it is valid.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        (self.last.intervals < 0.0 || self.current.intervals < 0.0).then_some("a number of intervals below zero")
    }
}

impl SiteSignature {
    fn distance2(&self, other: &Self) -> f64 {
        let square = |difference: f64, sd: f64| (difference / sd) * (difference / sd);
        square(self.horizontal_ut - other.horizontal_ut, HORIZONTAL_SD_UT)
            + square(self.vertical_ut - other.vertical_ut, VERTICAL_SD_UT)
            + (self.up - other.up).norm_squared() / (UP_SD * UP_SD)
    }
}

scalars!(SiteSignature: horizontal_ut, vertical_ut, intervals, up);
scalars!(RestSite: last, current, decided);
