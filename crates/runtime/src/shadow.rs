//! A candidate beside the stage that owns the slot: how far apart they are.
//!
//! Input: what the candidate computes, and what the owner publishes. Output: the difference of their attitudes, a few times a second.
//! Time: when it is said, the clock; what is compared, the same tick of both. Failure: a tick that only one of them has is left out.

use std::collections::VecDeque;

use attitude::{Quaternion, metrics::AttitudeError};
use bus::{Publisher, Subscriber};
use messages::{Difference, Header, Ticked};

use crate::{RuntimeError, ServiceContext, clock::monotonic_ns, comparable::Comparable, service_config::BUFFER_BESIDE};

/// How often the difference is said.
const INTERVAL_NS: u64 = 100_000_000;
/// Ticks that wait for the other's.
const WAITING_MAX: usize = 4096;

/// Compares a candidate with the owner.
pub(crate) struct Shadowing<O: Ticked + Comparable> {
    owner: Subscriber<O>,
    said: Publisher<Difference>,
    waiting: VecDeque<(u64, Quaternion<f64>)>,
    sums: Sums,
    message: Difference,
    said_at_ns: u64,
}

#[derive(Default)]
struct Sums {
    /// Angle, inclination, heading, rad.
    sum: [f64; 3],
    square: [f64; 3],
    max: [f64; 3],
}

impl<O: Ticked + Comparable> Shadowing<O> {
    pub(crate) fn begin(context: &ServiceContext) -> Result<Self, RuntimeError> {
        let message = Difference {
            service: context.service as u32,
            incarnation: context.config.incarnation,
            ..bytemuck::Zeroable::zeroed()
        };
        Ok(Self {
            owner: context.bus.late_subscriber(context.config.buffer_ticks())?,
            said: context.bus.publisher(BUFFER_BESIDE)?,
            waiting: VecDeque::new(),
            sums: Sums::default(),
            message,
            said_at_ns: 0,
        })
    }

    /// The candidate has computed a tick.
    pub(crate) fn computed(&mut self, output: &O) {
        let Some(attitude) = output.attitude() else { return };
        if self.waiting.len() == WAITING_MAX {
            self.waiting.pop_front();
        }
        self.waiting.push_back((output.header().tick, attitude));
    }

    /// Compares what both have, and says it from time to time.
    pub(crate) fn compare(&mut self) -> Result<(), RuntimeError> {
        let Self { owner, waiting, sums, message, .. } = self;
        owner.drain(WAITING_MAX, |theirs| {
            let Header { tick, incarnation, .. } = *theirs.header();
            while waiting.pop_front_if(|(waiting, _)| *waiting < tick).is_some() {}
            let ours = waiting.pop_front_if(|(waiting, _)| *waiting == tick);
            if let (Some((_, ours)), Some(theirs), true) = (ours, theirs.attitude(), incarnation != message.incarnation)
            {
                sums.add(AttitudeError::between(ours, theirs), message);
                (message.tick, message.turn) = (tick, turn(theirs, ours));
            }
        })?;
        let now_ns = monotonic_ns();
        if message.ticks > 0 && now_ns.saturating_sub(self.said_at_ns) > INTERVAL_NS {
            self.said_at_ns = now_ns;
            self.said.send(message)?;
        }
        Ok(())
    }
}

impl Sums {
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

/// The turn of the body from one attitude to another, w x y z, in its own axes.
fn turn(from: Quaternion<f64>, to: Quaternion<f64>) -> [f64; 4] {
    let turn = from.conjugate() * to;
    [turn.w, turn.i, turn.j, turn.k]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whoever_is_turned_by_the_difference_lies_as_the_candidate() {
        let (owner, candidate) = (Quaternion::new(0.1, -0.5, 0.7, 0.5), Quaternion::new(0.7, 0.5, -0.5, 0.1));
        let [w, x, y, z] = turn(owner, candidate);
        assert!((owner * Quaternion::new(w, x, y, z) - candidate).norm() < 1e-15);
    }
}
