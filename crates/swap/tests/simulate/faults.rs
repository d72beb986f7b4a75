//! Random requests and faults.

use swap::{Event, Request, SwapState};

use crate::{
    rng::Link,
    world::{SUBSCRIBERS, World},
};

/// Time from a request to its deadline, ms.
pub(crate) const REQUEST_TIMEOUT_MS: u64 = 200;
/// Maximum number of earlier attempts in a request.
pub(crate) const MAX_PREVIOUS_ATTEMPTS: u32 = 2;
/// Longest stall of the supervisor, ms.
const MAX_STALL_MS: u64 = 30;

impl World {
    /// Issues random requests.
    pub(crate) fn issue_requests(&mut self) {
        if self.rng.chance(8) {
            let id = self.requests.len() as u64 + 1;
            let shadow_only = self.rng.chance(200);
            self.requests.insert(id, (self.now_ms, shadow_only));
            let deadline_ms = if shadow_only { u64::MAX } else { self.now_ms + REQUEST_TIMEOUT_MS };
            let previous_attempts = self.rng.in_range(0, MAX_PREVIOUS_ATTEMPTS.into()) as u32;
            self.apply(Event::Request(Request {
                id,
                stage: id.to_string(),
                shadow_only,
                deadline_ms,
                previous_attempts,
            }));
        }
        if self.rng.chance(5) {
            self.apply(Event::Promote { deadline_ms: self.now_ms + REQUEST_TIMEOUT_MS });
        }
        if self.rng.chance(1) {
            self.apply(Event::Cancel);
        }
    }

    /// Injects faults other than exits: hangs, supervisor stalls, repeated decisions and subscriber
    /// restarts.
    pub(crate) fn inject_faults(&mut self) {
        let (rng, now_ms) = (&mut self.rng, self.now_ms);
        for process in &mut self.processes {
            if process.alive && rng.chance(self.scenario.hangs_per_mille) {
                let longest_ms = if rng.chance(200) { 600 } else { 150 };
                process.hung_until_ms = now_ms + rng.in_range(1, longest_ms);
                if self.verbose {
                    println!("{now_ms:5} {} hangs until {}", process.incarnation, process.hung_until_ms);
                }
            }
        }
        if rng.chance(2) {
            self.stalled_until_ms = now_ms + rng.in_range(1, MAX_STALL_MS);
        }
        if rng.chance(10) && !self.decisions.is_empty() {
            let repeated = self.decisions[rng.in_range(0, self.decisions.len() as u64 - 1) as usize];
            for process in &mut self.processes {
                process.decisions.send(now_ms, rng, repeated);
            }
        }
        let index = rng.in_range(0, SUBSCRIBERS as u64 - 1) as usize;
        if self.scenario.subscribers_restart && rng.chance(4) && self.may_restart_subscriber() {
            self.restart_subscriber(index);
        }
    }

    /// Returns `true` if a subscriber may restart without loss.
    ///
    /// A restarted subscriber finds its missing ticks only at running publishers. If both a
    /// subscriber and the slot's owner exit before the same hand-over, that is one fault more than
    /// the system tolerates.
    fn may_restart_subscriber(&self) -> bool {
        let owner = &self.processes[self.owner as usize - 1];
        !matches!(self.coordinator.state(), SwapState::Armed { .. }) || owner.alive || owner.retired
    }

    fn restart_subscriber(&mut self, index: usize) {
        self.subscribers[index].restart(self.scenario.lateness_ticks);
        for process in &mut self.processes {
            process.links[index] = Link::new(self.scenario.max_link_delay_ms, &mut self.rng);
            for packet in process.history.iter().filter(|_| process.alive) {
                process.links[index].send(self.now_ms, &mut self.rng, *packet);
            }
        }
        self.trace(|world| format!("subscriber {index} restarts at {}", world.subscribers[index].received.len()));
    }
}
