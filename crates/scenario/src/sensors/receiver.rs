//! The fixes of a satellite receiver, which arrive late.

use attitude::{Vector3, gnss::Fix};

use super::errors::Receiver;
use crate::{
    motion::Body,
    noise::{Noise, Use},
};

#[derive(Debug, Clone)]
pub(super) struct Fixes {
    receiver: Receiver,
    noise: Noise,
    /// Fixes that have arrived, those outside the coverage too.
    count: u64,
}

impl Fixes {
    pub(super) fn new(receiver: Receiver, seed: u64) -> Self {
        Self { receiver, noise: Noise::new(seed, Use::Fix), count: 0 }
    }

    /// The last fix that arrived until `t_s` and was not asked for before.
    pub(super) fn arrived(&mut self, body: &mut Body, t_s: f64) -> Option<Fix> {
        let Receiver { interval_s, latency_s, noise_m_s, antenna_m, coverage, latitude_rad } = self.receiver;
        let mut fix = None;
        // A fix that arrives with a sample must not miss it by the last digit of its time.
        while self.count as f64 * interval_s + latency_s <= t_s + 1e-9 {
            let of_s = self.count as f64 * interval_s;
            let noise = self.noise.normals() * noise_m_s;
            self.count += 1;
            fix = coverage.covers(of_s + latency_s).then(|| Fix {
                velocity_m_s: antenna_velocity_m_s(body, antenna_m, of_s) + noise,
                sd_m_s: None,
                age_s: None,
                latitude_rad,
            });
        }
        fix
    }
}

/// Of a point of the body, over ground, m/s: v + Aᵀ (ω × r).
fn antenna_velocity_m_s(body: &mut Body, antenna_m: Vector3<f64>, t_s: f64) -> Vector3<f64> {
    let velocity_m_s = body.velocity_m_s(t_s);
    let truth = body.at(t_s);
    velocity_m_s + truth.attitude.matrix().transpose() * truth.rate_rad_s.cross(&antenna_m)
}
