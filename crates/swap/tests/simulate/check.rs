//! What must hold in every world, and what has to have been seen in all of them together.

use std::{collections::BTreeMap, fmt};

use swap::{Outcome, Reason, Report};

use crate::{faults::PATIENCE_MS, world::World};

impl World {
    /// Everything has settled.
    pub(crate) fn check(&self) -> Result<(), String> {
        self.readers_got_each_tick_from_its_owner()?;
        self.requests_were_answered()?;
        self.one_process_is_left()
    }

    fn readers_got_each_tick_from_its_owner(&self) -> Result<(), String> {
        for (number, reader) in self.readers.iter().enumerate() {
            if reader.got.len() as u64 != self.next_input {
                return Err(format!("reader {number} got {} of {} ticks", reader.got.len(), self.next_input));
            }
            for packet in &reader.got {
                if self.stages.get(&packet.epoch) != Some(&packet.stage) {
                    return Err(format!(
                        "reader {number}: {packet:?} is not from its epoch's stage: {:?}",
                        self.stages
                    ));
                }
            }
            // Where one began in the place of another that had ended, readers may have had more or less of that one.
            let handed_over =
                |report: &&Report| report.outcome == Outcome::Committed && !self.replaced.contains(&report.epoch);
            for report in self.answers.iter().filter(handed_over) {
                let commit_tick = report.commit_tick.ok_or("a commitment without a tick")?;
                let again = self.made_again.contains(&commit_tick);
                let wrong = reader.got.iter().find(|packet| match packet.tick >= commit_tick {
                    true => packet.epoch < report.epoch,
                    false => packet.epoch >= report.epoch && !again,
                });
                if let Some(packet) = wrong {
                    return Err(format!("reader {number}: {packet:?} against {report:?}"));
                }
            }
        }
        Ok(())
    }

    fn requests_were_answered(&self) -> Result<(), String> {
        let limits = self.nature.limits;
        let alone_ms = limits.ready_ms + PATIENCE_MS + limits.shadow_ms;
        let longest_ms =
            limits.ready_ms + 2 * limits.caught_up_ms + limits.shadow_ms + limits.commit_ms + alone_ms + 100;
        for (id, (_, shadow_only)) in &self.asked {
            let answers: Vec<_> = self.answers.iter().filter(|report| report.id == *id).collect();
            let [report] = answers[..] else {
                return Err(format!("request {id} was answered {} times", answers.len()));
            };
            if !shadow_only && report.took_ms > longest_ms {
                return Err(format!("request {id} was answered after {} ms", report.took_ms));
            }
        }
        Ok(())
    }

    fn one_process_is_left(&self) -> Result<(), String> {
        let alive: Vec<_> = self.processes.iter().filter(|process| process.alive).collect();
        let last = self.answers.iter().rev().find(|report| report.outcome == Outcome::Committed);
        let stage = last.map_or(0, |report| report.stage.parse().unwrap());
        match alive[..] {
            [process] if process.stage != stage => Err(format!("stage {} has the slot, not {stage}", process.stage)),
            [process] if !process.gate.publishes() => Err("the owner does not publish".into()),
            [process] if Some(process.incarnation) != self.coordinator.active() => Err("the owner is another".into()),
            [_] => Ok(()),
            _ => Err(format!("{} processes are left", alive.len())),
        }
    }
}

/// What happened in all worlds.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    ended: BTreeMap<String, u64>,
    ticks: u64,
    restarts: u64,
    replaced: u64,
    repeated: u64,
    held_max: usize,
}

impl Tally {
    pub(crate) fn add(&mut self, world: &World) {
        for report in &world.answers {
            let why = report.reason.as_ref().map_or("committed", name);
            *self.ended.entry(why.into()).or_default() += 1;
            let alone = world.replaced.contains(&report.epoch) && report.outcome == Outcome::Committed;
            self.replaced += u64::from(alone);
        }
        self.restarts += world.restarts;
        for reader in &world.readers {
            self.ticks += reader.got.len() as u64;
            self.repeated += reader.reorder_buffer.sequence().repeated;
            self.held_max = self.held_max.max(reader.held_max);
        }
    }

    /// This and what was met in other worlds.
    pub(crate) fn with(mut self, other: Self) -> Self {
        for (why, times) in other.ended {
            *self.ended.entry(why).or_default() += times;
        }
        Self {
            ticks: self.ticks + other.ticks,
            restarts: self.restarts + other.restarts,
            replaced: self.replaced + other.replaced,
            repeated: self.repeated + other.repeated,
            held_max: self.held_max.max(other.held_max),
            ..self
        }
    }

    /// A simulation that never meets a case proves nothing about it.
    pub(crate) fn everything_was_seen(&self) {
        for case in CASES {
            assert!(self.ended.get(case).is_some_and(|times| *times >= 10), "`{case}` was hardly met: {self}");
        }
        assert!(self.held_max > 0 && self.repeated > 0 && self.replaced > 0, "{self}");
    }
}

const CASES: [&str; 15] = [
    "committed",
    "busy",
    "active down",
    "spawn failed",
    "not ready",
    "not caught up",
    "active behind",
    "flawed",
    "candidate died",
    "candidate missed",
    "active missed",
    "active died",
    "no tick",
    "not confirmed",
    "cancelled",
];

fn name(reason: &Reason) -> &'static str {
    match reason {
        Reason::Busy { .. } => "busy",
        Reason::ActiveDown => "active down",
        Reason::SpawnFailed { .. } => "spawn failed",
        Reason::NotReady { .. } => "not ready",
        Reason::NotCaughtUp { .. } => "not caught up",
        Reason::ActiveBehind { .. } => "active behind",
        Reason::Flawed => "flawed",
        Reason::CandidateDied => "candidate died",
        Reason::CandidateMissed => "candidate missed",
        Reason::ActiveMissed => "active missed",
        Reason::ActiveDied => "active died",
        Reason::NoTick => "no tick",
        Reason::NotConfirmed { .. } => "not confirmed",
        Reason::Cancelled => "cancelled",
    }
}

impl fmt::Display for Tally {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { ticks, restarts, replaced, repeated, held_max, .. } = self;
        writeln!(
            f,
            "{ticks} ticks read, {restarts} restarts, {replaced} replaced; left out: {repeated} repeated; held at most {held_max}"
        )?;
        self.ended.iter().try_for_each(|(why, times)| writeln!(f, "{times:8} {why}"))
    }
}
