//! Simulates a satellite receiver with delayed fixes.

use attitude::{Vector3, gnss::Fix};

use super::errors::Receiver;
use crate::{
    motion::Body,
    random::{RandomStream, StreamId},
};

#[derive(Debug, Clone)]
pub(super) struct SimulatedReceiver {
    receiver: Receiver,
    noise: RandomStream,
    /// Number of fixes due so far, including those that were omitted because there was no coverage.
    count: u64,
}

impl SimulatedReceiver {
    pub(super) fn new(receiver: Receiver, seed: u64) -> Self {
        Self { receiver, noise: RandomStream::new(seed, StreamId::Fix), count: 0 }
    }

    /// Returns the newest fix that arrived by `t_s` and was not returned before.
    pub(super) fn poll(&mut self, body: &mut Body, t_s: f64) -> Option<Fix> {
        let Receiver { interval_s, latency_s, noise_m_s, antenna_m, coverage, latitude_rad } = self.receiver;
        let mut fix = None;
        // The tolerance allows for rounding, so that a fix that is due exactly at the time of a
        // sample arrives with that sample.
        while self.count as f64 * interval_s + latency_s <= t_s + 1e-9 {
            let measured_s = self.count as f64 * interval_s;
            let noise = self.noise.normals() * noise_m_s;
            self.count += 1;
            fix = coverage.covers(measured_s + latency_s).then(|| Fix {
                velocity_m_s: antenna_velocity_m_s(body, antenna_m, measured_s) + noise,
                sd_m_s: None,
                age_s: None,
                latitude_rad,
            });
        }
        fix
    }
}

/// Returns the velocity of the antenna over ground, m/s.
///
/// The velocity is v + Aᵀ (ω × r), with v the velocity of the sensors, A the matrix from reference
/// to body axes, ω the body rate and r the position of the antenna relative to the sensors.
fn antenna_velocity_m_s(body: &mut Body, antenna_m: Vector3<f64>, t_s: f64) -> Vector3<f64> {
    let velocity_m_s = body.velocity_m_s(t_s);
    let truth = body.at(t_s);
    velocity_m_s + truth.attitude.matrix().transpose() * truth.rate_rad_s.cross(&antenna_m)
}
