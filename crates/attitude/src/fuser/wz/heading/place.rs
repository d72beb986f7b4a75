//! The place where the body rested last, and whether it rests there again.
//!
//! A body that comes back to where it rested, in the position it had there, reads the same field: strength, dip and up are alike, and what
//! the horizontal field has turned by since is the drift of the gyro's heading. That field, p, is a state of the filter; here is
//! decided whether it is seen again. Input: the intervals of a rest that passed the gate. Output: once a rest, that it is the place of
//! before, or another. Time: the number of intervals. Failure: a place of the same strength, dip and position elsewhere is
//! taken for it if its field points within some degrees of what is expected.

use crate::{Vector3, numbers::Numbers};

/// Intervals of a rest before it is decided.
const INTERVALS: f64 = 10.0;
/// How well the field of a place repeats, horizontal and vertical, µT, and up in body axes.
const HORIZONTAL_SD_UT: f64 = 0.2;
const VERTICAL_SD_UT: f64 = 0.25;
const UP_SD: f64 = 0.01;
/// Square of the largest distance of a place from itself, in standard deviations.
const APART2_MAX: f64 = 9.0;

/// What a place looks like to the body: means over a rest.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Look {
    horizontal_ut: f64,
    vertical_ut: f64,
    up: Vector3<f64>,
    intervals: f64,
}

/// The last place, and this one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct KnownPlace {
    last: Look,
    this: Look,
    decided: bool,
}

/// What an interval at rest is for the filter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Seen {
    /// Not yet known.
    Nothing,
    /// The place of before, now.
    Again,
    /// The place to know again.
    Place,
}

impl Default for KnownPlace {
    fn default() -> Self {
        let none = Look { horizontal_ut: 0.0, vertical_ut: 0.0, up: Vector3::zeros(), intervals: 0.0 };
        Self { last: none, this: none, decided: false }
    }
}

impl KnownPlace {
    /// A movement: what comes after is another rest.
    pub(super) fn leave(&mut self) {
        if self.decided {
            *self = Self { last: self.this, ..Self::default() };
        } else {
            self.this = Self::default().this;
        }
    }

    /// An interval at rest with this field, µT, reference axes, hard iron off, and up in body axes.
    pub(super) fn observe(&mut self, [across, along, vertical_ut]: [f64; 3], up: [f64; 3]) -> Seen {
        let this = &mut self.this;
        this.intervals += 1.0;
        let share = this.intervals.recip();
        this.horizontal_ut += (libm::hypot(across, along) - this.horizontal_ut) * share;
        this.vertical_ut += (vertical_ut - this.vertical_ut) * share;
        this.up += (Vector3::from(up) - this.up) * share;
        if this.intervals < INTERVALS {
            return Seen::Nothing;
        }
        let first = !core::mem::replace(&mut self.decided, true);
        if first && self.last.intervals > 0.0 && self.this.apart2(&self.last) < APART2_MAX {
            Seen::Again
        } else {
            Seen::Place
        }
    }

    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        (self.last.intervals < 0.0 || self.this.intervals < 0.0).then_some("a rest of less than no intervals")
    }
}

impl Look {
    fn apart2(&self, other: &Self) -> f64 {
        let square = |apart: f64, sd: f64| (apart / sd) * (apart / sd);
        square(self.horizontal_ut - other.horizontal_ut, HORIZONTAL_SD_UT)
            + square(self.vertical_ut - other.vertical_ut, VERTICAL_SD_UT)
            + (self.up - other.up).norm_squared() / (UP_SD * UP_SD)
    }
}

impl Numbers for KnownPlace {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        for Look { horizontal_ut, vertical_ut, up, intervals } in [&mut self.last, &mut self.this] {
            [horizontal_ut, vertical_ut, intervals].into_iter().for_each(&mut *visit);
            up.visit(visit);
        }
        self.decided.visit(visit);
    }
}
