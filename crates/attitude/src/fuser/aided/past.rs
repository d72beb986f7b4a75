//! The antenna's velocity of the last second, against which a fix that arrives late is held.

use super::covariance::INTERVAL_S;
use crate::{Vector3, numbers::Numbers};

/// Velocities kept; with those of [`INTERVAL_S`] between them they reach back 1.2 s.
const COUNT: usize = 24;

#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Entry {
    velocity_m_s: Vector3<f64>,
    /// Since the one before it.
    length_s: f64,
}

/// Velocities, the newest first.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Past([Entry; COUNT]);

impl Past {
    /// One velocity more, `length_s` after the last one.
    pub(super) fn push(&mut self, velocity_m_s: Vector3<f64>, length_s: f64) {
        self.0.rotate_right(1);
        self.0[0] = Entry { velocity_m_s, length_s };
    }

    /// A correction, of all of them.
    pub(super) fn subtract(&mut self, correction_m_s: Vector3<f64>) {
        self.0.iter_mut().for_each(|entry| entry.velocity_m_s -= correction_m_s);
    }

    /// As if the velocity had always been this.
    pub(super) fn begin(&mut self, velocity_m_s: Vector3<f64>) {
        self.0 = [Entry { velocity_m_s, length_s: INTERVAL_S }; COUNT];
    }

    /// Velocity and acceleration `age_s` ago, by a straight line between two; the last one was kept `since_s` ago.
    pub(super) fn at(&self, age_s: f64, now_m_s: Vector3<f64>, since_s: f64) -> (Vector3<f64>, Vector3<f64>) {
        let mut newer = (now_m_s, 0.0);
        let mut older_age_s = since_s;
        let last = COUNT - 1;
        for (i, entry) in self.0.iter().enumerate() {
            let length_s = older_age_s - newer.1;
            if (older_age_s >= age_s && length_s > 1e-6) || i == last {
                let slope_m_s2 = (newer.0 - entry.velocity_m_s) / length_s.max(1e-6);
                return (newer.0 - slope_m_s2 * (age_s.min(older_age_s) - newer.1), slope_m_s2);
            }
            newer = (entry.velocity_m_s, older_age_s);
            older_age_s += entry.length_s;
        }
        (now_m_s, Vector3::zeros())
    }
}

impl Numbers for Past {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        for entry in &mut self.0 {
            entry.velocity_m_s.visit(visit);
            entry.length_s.visit(visit);
        }
    }
}
