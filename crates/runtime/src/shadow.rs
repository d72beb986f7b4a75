//! Comparison of a candidate with the owner of its slot.
//!
//! - Input: the outputs of the candidate and of the owner.
//! - Output: the difference of their attitudes, a few times per second.
//! - Time: a clock determines when the difference is published. Only outputs of the same tick are
//!   compared.
//! - Failure: a tick for which either output is missing is skipped.

use std::collections::VecDeque;

use attitude::{Quaternion, metrics::AttitudeError};
use bus::{Publisher, Subscriber};
use messages::{Difference, Header, Ticked};

use crate::{
    RuntimeError, ServiceContext, clock::monotonic_ns, comparable::Comparable, service_config::CONTROL_BUFFER,
};

/// Interval between two published differences.
const INTERVAL_NS: u64 = 100_000_000;
/// Maximum number of candidate outputs that wait for the owner's output of the same tick.
const MAX_PENDING: usize = 4096;

/// Comparison of a candidate with the owner of its slot.
pub(crate) struct ShadowComparison<O: Ticked + Comparable> {
    owner: Subscriber<O>,
    publisher: Publisher<Difference>,
    pending: VecDeque<(u64, Quaternion<f64>)>,
    sums: ErrorSums,
    message: Difference,
    last_published_ns: u64,
}

#[derive(Default)]
struct ErrorSums {
    /// Sums of the differences in total angle, inclination and heading, rad. `square` and `max`
    /// have the same order.
    sum: [f64; 3],
    square: [f64; 3],
    max: [f64; 3],
}

impl<O: Ticked + Comparable> ShadowComparison<O> {
    pub(crate) fn new(context: &ServiceContext) -> Result<Self, RuntimeError> {
        let message = Difference {
            service: context.service as u32,
            incarnation: context.config.incarnation,
            ..bytemuck::Zeroable::zeroed()
        };
        Ok(Self {
            owner: context.bus.late_subscriber(context.config.buffer_ticks())?,
            publisher: context.bus.publisher(CONTROL_BUFFER)?,
            pending: VecDeque::new(),
            sums: ErrorSums::default(),
            message,
            last_published_ns: 0,
        })
    }

    /// Queues an output of the candidate.
    pub(crate) fn record(&mut self, output: &O) {
        let Some(attitude) = output.attitude() else { return };
        if self.pending.len() == MAX_PENDING {
            self.pending.pop_front();
        }
        self.pending.push_back((output.header().tick, attitude));
    }

    /// Compares the outputs of each tick for which both exist, and publishes the difference when it
    /// is due.
    pub(crate) fn compare(&mut self) -> Result<(), RuntimeError> {
        let Self { owner, pending, sums, message, .. } = self;
        owner.drain(MAX_PENDING, |output| {
            let Header { tick, incarnation, .. } = *output.header();
            while pending.pop_front_if(|(pending_tick, _)| *pending_tick < tick).is_some() {}
            let candidate = pending.pop_front_if(|(pending_tick, _)| *pending_tick == tick);
            if let (Some((_, candidate)), Some(owner), true) =
                (candidate, output.attitude(), incarnation != message.incarnation)
            {
                sums.add(AttitudeError::between(candidate, owner), message);
                (message.tick, message.rotation) = (tick, rotation_between(owner, candidate));
            }
        })?;
        let now_ns = monotonic_ns();
        if message.ticks > 0 && now_ns.saturating_sub(self.last_published_ns) > INTERVAL_NS {
            self.last_published_ns = now_ns;
            self.publisher.send(message)?;
        }
        Ok(())
    }
}

impl ErrorSums {
    fn add(&mut self, error: AttitudeError, message: &mut Difference) {
        let now = [error.total_deg, error.inclination_deg, error.heading_deg].map(|deg| deg.to_radians().abs());
        message.ticks += 1;
        let share = 1.0 / message.ticks as f64;
        for (i, now) in now.into_iter().enumerate() {
            self.sum[i] += now;
            self.square[i] += now * now;
            self.max[i] = self.max[i].max(now);
        }
        message.now_rad = now;
        message.mean_rad = self.sum.map(|sum| sum * share);
        message.rms_rad = self.square.map(|square| (square * share).sqrt());
        message.max_rad = self.max;
    }
}

/// Returns the rotation between two attitudes as a quaternion (w, x, y, z), in body axes.
fn rotation_between(from: Quaternion<f64>, to: Quaternion<f64>) -> [f64; 4] {
    let rotation = from.conjugate() * to;
    [rotation.w, rotation.i, rotation.j, rotation.k]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotation_between_maps_owner_to_candidate() {
        let (owner, candidate) = (Quaternion::new(0.1, -0.5, 0.7, 0.5), Quaternion::new(0.7, 0.5, -0.5, 0.1));
        let [w, x, y, z] = rotation_between(owner, candidate);
        assert!((owner * Quaternion::new(w, x, y, z) - candidate).norm() < 1e-15);
    }
}
