//! Whether the gyro tells of turns that gravity does not show.
//!
//! A turn about an axis across the force turns the force in the body's axes as far. Where the gyro says that the body spins and the force
//! stays where it is, the rates are far too large: a motion that shows no axes shows the unit yet. The force is the mean of a step, so that
//! vibration does not look like turning.

use attitude::Vector3;

use crate::finding::{self, Finding};

/// Length of a window, s: a swing of a hand has not come back within it.
const WINDOW_S: f64 = 0.5;
/// Length of a step, s: motors and propellers shake the force several times within it, and no body turns far.
const STEP_S: f64 = 0.05;
/// A sample farther apart than this says nothing of what was between, s: the slowest sensors that keep an attitude have 10 Hz.
const SAMPLE_MAX_S: f64 = 0.12;
/// The gyro's turn across the force from which a window is asked, rad: no hand and no vehicle turns so far so soon for long.
const TURN_MIN_RAD: f64 = 1.0;
/// The force may turn this share of it, and no more, for the window to speak of a wrong unit: °/s leave 1/57, with what accelerations add.
const SHOWN_MAX: f64 = 0.1;
/// Windows that a finding needs: a turned body that comes back to where it was shows less than it turned in one.
const WINDOWS_MIN: u32 = 5;
/// Their share of those that were asked: in a wrong unit nearly all, in a right one few.
const SHARE: f64 = 0.8;

/// Turns as the gyro tells them, and as the force shows them.
#[derive(Debug, Clone, Default)]
pub(crate) struct Spinning {
    dt_s: f64,
    step_s: f64,
    /// Sums of a step.
    turn_rad: Vector3<f64>,
    force: Vector3<f64>,
    /// Up when the window began.
    began: Option<Vector3<f64>>,
    across_rad: f64,
    /// The largest angle of the force from where it began.
    shown_rad: f64,
    asked: u32,
    unshown: u32,
}

impl Spinning {
    /// What came before does not go on.
    pub(crate) fn interrupt(&mut self) {
        *self = Self { asked: self.asked, unshown: self.unshown, ..Self::default() };
    }

    pub(crate) fn take(&mut self, dt_s: f64, rate_rad_s: [f64; 3], force_m_s2: [f64; 3]) {
        if !(0.0..SAMPLE_MAX_S).contains(&dt_s) {
            return self.interrupt();
        }
        self.step_s += dt_s;
        self.turn_rad += Vector3::from(rate_rad_s) * dt_s;
        self.force += Vector3::from(force_m_s2);
        if self.step_s < STEP_S {
            return;
        }
        let Some(up) = self.force.try_normalize(f64::MIN_POSITIVE) else { return self.interrupt() };
        let began = *self.began.get_or_insert(up);
        self.dt_s += self.step_s;
        self.across_rad += (self.turn_rad - up * self.turn_rad.dot(&up)).norm();
        self.shown_rad = self.shown_rad.max(began.cross(&up).norm().atan2(began.dot(&up)));
        (self.step_s, self.turn_rad, self.force) = (0.0, Vector3::zeros(), Vector3::zeros());
        if self.dt_s < WINDOW_S {
            return;
        }
        if self.across_rad > TURN_MIN_RAD {
            self.asked += 1;
            self.unshown += u32::from(self.shown_rad < SHOWN_MAX * self.across_rad);
        }
        self.interrupt();
    }

    pub(crate) fn finding(&self) -> Option<Finding> {
        let is_told = self.unshown >= WINDOWS_MIN && f64::from(self.unshown) > SHARE * f64::from(self.asked);
        is_told.then(|| finding::spinning(self.unshown, WINDOW_S))
    }
}
