//! Standstill: gyro and accelerometer keep to their own mean, and the receiver, where there is one, tells no speed.

use crate::{Vector3, numbers::Numbers};

/// Time constant of the means and of the spreads about them, s.
const MEAN_S: f64 = 1.0;
/// How long it must have been still, s.
const STILL_S: f64 = 2.0;
/// Time between two findings, s.
const INTERVAL_S: f64 = 0.5;

/// What counts as still.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Stillness {
    /// Spread of the rate, rad/s rms.
    rate_rad_s: f64,
    /// Spread of the specific force, m/s² rms.
    force_m_s2: f64,
    /// Mean rate that can be a bias, rad/s.
    mean_rad_s: f64,
}

/// Where the receiver tells no speed: 0.8 °/s, 0.15 m/s². A tighter spread takes an idling engine for motion.
pub(super) const TOLD: Stillness = Stillness { rate_rad_s: 0.013_962_634, force_m_s2: 0.15, mean_rad_s: 0.087_266_463 };
/// Where there is no receiver: 0.3 °/s, 0.08 m/s², and no more than 1 °/s, because a steady turn in still air looks the same.
pub(super) const GUESSED: Stillness =
    Stillness { rate_rad_s: 0.005_235_988, force_m_s2: 0.08, mean_rad_s: 0.017_453_293 };

/// Finds standstill, and the mean rate during it.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Standstill {
    rate_rad_s: Vector3<f64>,
    force_m_s2: Vector3<f64>,
    rate_spread2: f64,
    force_spread2: f64,
    begun: bool,
    still_s: f64,
    since_s: f64,
}

impl Standstill {
    /// One sample; the mean rate, rad/s, each half second of standstill.
    pub(super) fn step(
        &mut self,
        rate_rad_s: Vector3<f64>,
        force_m_s2: Vector3<f64>,
        dt_s: f64,
        still: Option<&Stillness>,
    ) -> Option<Vector3<f64>> {
        if !self.begun {
            *self = Self { rate_rad_s, force_m_s2, begun: true, ..Self::default() };
        }
        let gain = (dt_s / MEAN_S).min(1.0);
        self.rate_rad_s += (rate_rad_s - self.rate_rad_s) * gain;
        self.force_m_s2 += (force_m_s2 - self.force_m_s2) * gain;
        self.rate_spread2 += ((rate_rad_s - self.rate_rad_s).norm_squared() - self.rate_spread2) * gain;
        self.force_spread2 += ((force_m_s2 - self.force_m_s2).norm_squared() - self.force_spread2) * gain;
        let quiet = still.is_some_and(|still| {
            self.rate_spread2 < still.rate_rad_s * still.rate_rad_s
                && self.force_spread2 < still.force_m_s2 * still.force_m_s2
                && self.rate_rad_s.amax() < still.mean_rad_s
        });
        if !quiet {
            self.still_s = 0.0;
            return None;
        }
        self.still_s = (self.still_s + dt_s).min(1e3);
        self.since_s += dt_s;
        if self.still_s < STILL_S || self.since_s < INTERVAL_S {
            return None;
        }
        self.since_s = 0.0;
        Some(self.rate_rad_s)
    }

    /// The sensors cannot be believed; it starts anew.
    pub(super) fn interrupt(&mut self) {
        *self = Self::default();
    }
}

impl Numbers for Standstill {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.rate_rad_s.visit(visit);
        self.force_m_s2.visit(visit);
        self.begun.visit(visit);
        [&mut self.rate_spread2, &mut self.force_spread2, &mut self.still_s, &mut self.since_s]
            .into_iter()
            .for_each(|number| number.visit(visit));
    }
}
