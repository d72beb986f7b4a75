//! Antenna velocities of the last second, for comparison with a fix that arrives late.

use super::covariance::INTERVAL_S;
use crate::{Vector3, scalars::Scalars};

/// Number of velocities kept. At intervals of [`INTERVAL_S`] they cover 1.2 s.
const COUNT: usize = 24;

#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Entry {
    velocity_m_s: Vector3<f64>,
    /// Time since the previous entry, s.
    interval_s: f64,
}

/// Antenna velocities, newest first.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct VelocityHistory([Entry; COUNT]);

impl VelocityHistory {
    /// Adds an antenna velocity. `interval_s` is the time since the previous velocity.
    pub(super) fn push(&mut self, velocity_m_s: Vector3<f64>, interval_s: f64) {
        self.0.rotate_right(1);
        self.0[0] = Entry { velocity_m_s, interval_s };
    }

    /// Subtracts a velocity correction from all stored velocities.
    pub(super) fn apply_correction(&mut self, correction_m_s: Vector3<f64>) {
        self.0.iter_mut().for_each(|entry| entry.velocity_m_s -= correction_m_s);
    }

    /// Fills the history with a constant velocity.
    pub(super) fn fill(&mut self, velocity_m_s: Vector3<f64>) {
        self.0 = [Entry { velocity_m_s, interval_s: INTERVAL_S }; COUNT];
    }

    /// Returns the velocity and the acceleration `age_s` ago, by linear interpolation.
    ///
    /// `now_m_s` is the current velocity. `since_last_s` is the age of the newest entry.
    pub(super) fn interpolate(
        &self,
        age_s: f64,
        now_m_s: Vector3<f64>,
        since_last_s: f64,
    ) -> (Vector3<f64>, Vector3<f64>) {
        let mut newer = (now_m_s, 0.0);
        let mut older_age_s = since_last_s;
        let last = COUNT - 1;
        for (i, entry) in self.0.iter().enumerate() {
            let interval_s = older_age_s - newer.1;
            if (older_age_s >= age_s && interval_s > 1e-6) || i == last {
                let slope_m_s2 = (newer.0 - entry.velocity_m_s) / interval_s.max(1e-6);
                return (newer.0 - slope_m_s2 * (age_s.min(older_age_s) - newer.1), slope_m_s2);
            }
            newer = (entry.velocity_m_s, older_age_s);
            older_age_s += entry.interval_s;
        }
        (now_m_s, Vector3::zeros())
    }
}

impl Scalars for VelocityHistory {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        for entry in &mut self.0 {
            entry.velocity_m_s.visit(visit);
            entry.interval_s.visit(visit);
        }
    }
}
