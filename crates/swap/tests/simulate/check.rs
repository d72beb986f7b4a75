//! Checks of each simulated world, and of the coverage of all worlds together.

use std::{collections::BTreeMap, fmt};

use swap::{FailureReason, Report, SwapOutcome};

use crate::{faults::REQUEST_TIMEOUT_MS, world::World};

impl World {
    /// Checks a world after it has settled.
    pub(crate) fn check(&self) -> Result<(), String> {
        self.check_received_ticks()?;
        self.check_reports()?;
        self.check_remaining_process()
    }

    fn check_received_ticks(&self) -> Result<(), String> {
        for (number, subscriber) in self.subscribers.iter().enumerate() {
            if subscriber.received.len() as u64 != self.next_input {
                return Err(format!(
                    "subscriber {number} received {} of {} ticks",
                    subscriber.received.len(),
                    self.next_input
                ));
            }
            for packet in &subscriber.received {
                if self.stages.get(&packet.epoch) != Some(&packet.stage) {
                    return Err(format!(
                        "subscriber {number}: {packet:?} is not from its epoch's stage: {:?}",
                        self.stages
                    ));
                }
            }
            // Takeovers are excluded, because a stage that replaces an exited one may start before
            // or after the last tick that subscribers received.
            let is_handover =
                |report: &&Report| report.outcome == SwapOutcome::Committed && !self.replaced.contains(&report.epoch);
            for report in self.reports.iter().filter(is_handover) {
                let commit_tick = report.commit_tick.ok_or("a commitment without a tick")?;
                let is_republished = self.republished.contains(&commit_tick);
                let wrong = subscriber.received.iter().find(|packet| match packet.tick >= commit_tick {
                    true => packet.epoch < report.epoch,
                    false => packet.epoch >= report.epoch && !is_republished,
                });
                if let Some(packet) = wrong {
                    return Err(format!("subscriber {number}: {packet:?} against {report:?}"));
                }
            }
        }
        Ok(())
    }

    fn check_reports(&self) -> Result<(), String> {
        let limits = self.scenario.limits;
        let takeover_ms = limits.ready_timeout_ms + REQUEST_TIMEOUT_MS + limits.shadow_ms;
        let longest_ms = limits.ready_timeout_ms
            + 2 * limits.catch_up_timeout_ms
            + limits.shadow_ms
            + limits.commit_timeout_ms
            + takeover_ms
            + 100;
        for (id, (_, shadow_only)) in &self.requests {
            let reports: Vec<_> = self.reports.iter().filter(|report| report.id == *id).collect();
            let [report] = reports[..] else {
                return Err(format!("request {id} was reported {} times", reports.len()));
            };
            if !shadow_only && report.took_ms > longest_ms {
                return Err(format!("request {id} was reported after {} ms", report.took_ms));
            }
        }
        Ok(())
    }

    fn check_remaining_process(&self) -> Result<(), String> {
        let alive: Vec<_> = self.processes.iter().filter(|process| process.alive).collect();
        let last = self.reports.iter().rev().find(|report| report.outcome == SwapOutcome::Committed);
        let stage = last.map_or(0, |report| report.stage.parse().unwrap());
        match alive[..] {
            [process] if process.stage != stage => {
                Err(format!("stage {} owns the slot instead of stage {stage}", process.stage))
            }
            [process] if !process.gate.owns_next_tick() => Err("the owner does not publish".into()),
            [process] if Some(process.incarnation) != self.coordinator.active() => {
                Err("the coordinator has another owner".into())
            }
            [_] => Ok(()),
            _ => Err(format!("{} processes are alive instead of one", alive.len())),
        }
    }
}

/// Statistics over all worlds.
#[derive(Debug, Default)]
pub(crate) struct Statistics {
    results: BTreeMap<String, u64>,
    ticks: u64,
    restarts: u64,
    replaced: u64,
    repeated: u64,
    max_held: usize,
}

impl Statistics {
    pub(crate) fn add(&mut self, world: &World) {
        for report in &world.reports {
            let result = report.reason.as_ref().map_or("committed", name);
            *self.results.entry(result.into()).or_default() += 1;
            let is_takeover = world.replaced.contains(&report.epoch) && report.outcome == SwapOutcome::Committed;
            self.replaced += u64::from(is_takeover);
        }
        self.restarts += world.restarts;
        for subscriber in &world.subscribers {
            self.ticks += subscriber.received.len() as u64;
            self.repeated += subscriber.reorder_buffer.sequence().repeated;
            self.max_held = self.max_held.max(subscriber.max_held);
        }
    }

    /// Returns the sum of two statistics.
    pub(crate) fn merged(mut self, other: Self) -> Self {
        for (result, count) in other.results {
            *self.results.entry(result).or_default() += count;
        }
        Self {
            ticks: self.ticks + other.ticks,
            restarts: self.restarts + other.restarts,
            replaced: self.replaced + other.replaced,
            repeated: self.repeated + other.repeated,
            max_held: self.max_held.max(other.max_held),
            ..self
        }
    }

    /// Checks that each case occurred, because a case that is never simulated is not tested.
    pub(crate) fn assert_all_cases_covered(&self) {
        for case in CASES {
            assert!(
                self.results.get(case).is_some_and(|count| *count >= 10),
                "case `{case}` occurred fewer than 10 times: {self}"
            );
        }
        assert!(self.max_held > 0 && self.repeated > 0 && self.replaced > 0, "{self}");
    }
}

const CASES: [&str; 16] = [
    "committed",
    "busy",
    "active down",
    "spawn failed",
    "not ready",
    "not caught up",
    "input missed",
    "active behind",
    "invalid output",
    "candidate exited",
    "candidate missed",
    "active missed",
    "active exited",
    "no tick",
    "not confirmed",
    "cancelled",
];

fn name(reason: &FailureReason) -> &'static str {
    match reason {
        FailureReason::Busy { .. } => "busy",
        FailureReason::ActiveDown => "active down",
        FailureReason::SpawnFailed { .. } => "spawn failed",
        FailureReason::NotReady { .. } => "not ready",
        FailureReason::NotCaughtUp { .. } => "not caught up",
        FailureReason::InputMissed { .. } => "input missed",
        FailureReason::ActiveBehind { .. } => "active behind",
        FailureReason::InvalidOutput => "invalid output",
        FailureReason::CandidateExited => "candidate exited",
        FailureReason::CandidateMissed => "candidate missed",
        FailureReason::ActiveMissed => "active missed",
        FailureReason::ActiveExited => "active exited",
        FailureReason::NoTick => "no tick",
        FailureReason::NotConfirmed { .. } => "not confirmed",
        FailureReason::Cancelled => "cancelled",
    }
}

impl fmt::Display for Statistics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { ticks, restarts, replaced, repeated, max_held, .. } = self;
        writeln!(
            f,
            "{ticks} ticks received, {restarts} restarts, {replaced} takeovers, {repeated} repeated messages, at most {max_held} messages held"
        )?;
        self.results.iter().try_for_each(|(result, count)| writeln!(f, "{count:8} {result}"))
    }
}
