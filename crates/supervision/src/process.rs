//! The services of a system and the processes that are, or are to be, one of them.

use std::time::Duration;

use launch::{Restart, Service};
use messages::{Health, State};

use crate::{
    Action, Resume, Trouble,
    restart_policy::{FIRST_HEALTH_LIMIT, RestartPolicy},
};

/// A service that can wait and says nothing for so long is killed: it may have to wait for the machine.
const SILENCE_BESIDE: Duration = Duration::from_secs(5);

/// Of a service at once.
const TROUBLES_MAX: usize = 16;

/// The services of a system, in the order of [`Service::ALL`].
#[derive(Debug)]
pub struct ProcessTable {
    entries: [ProcessEntry; Service::ALL.len()],
    /// Incarnations given out.
    incarnations: u32,
    /// When time was told last.
    polled: Duration,
}

/// A service and its processes.
#[derive(Debug, Default)]
pub struct ProcessEntry {
    /// The one that owns the slot.
    pub(crate) process: Option<Process>,
    /// A stage that is to take over.
    pub(crate) candidate: Option<Process>,
    /// Those that do not own the slot any more and have not ended.
    pub(crate) retired: Vec<Process>,
    pub(crate) policy: RestartPolicy,
    /// When it is started again.
    pub(crate) due: Option<Duration>,
    /// It is not started again.
    pub(crate) away: bool,
    /// The decision that its next process begins under, and the first tick that it publishes.
    pub(crate) ownership: Option<(u32, u64)>,
    at: Option<String>,
    troubles: Vec<Trouble>,
}

/// One process.
#[derive(Debug)]
pub(crate) struct Process {
    pub(crate) incarnation: u32,
    /// 0 until it was started.
    pub(crate) pid: u32,
    /// It publishes from its start on.
    pub(crate) owns: bool,
    pub(crate) since: Duration,
    /// The tick that it goes on with, where it goes on from a checkpoint.
    resumes_at: Option<u64>,
    /// The first tick whose inputs it takes, where it is told that.
    first_tick: Option<u64>,
    pub(crate) health: Option<Health>,
    /// When it said that; before its first health, when it was started.
    quiet_since: Duration,
    /// Its silence since then has been forgiven once.
    forgiven: bool,
    /// It was asked to end.
    asked: bool,
    /// It was killed because it said nothing.
    pub(crate) given_up: bool,
}

/// Which of a service's processes has ended.
pub(crate) enum Ended {
    /// The one that owned the slot.
    Owner(Process),
    /// One beside it.
    Other(Process),
}

impl Process {
    /// The tick whose inputs it takes next, as far as it is known.
    fn next_tick(&self) -> Option<u64> {
        self.first_tick.max(self.health.map(|health| health.next_tick))
    }
}

impl ProcessTable {
    pub(crate) fn new(now: Duration) -> Self {
        Self { entries: Default::default(), incarnations: 0, polled: now }
    }

    pub(crate) fn entry(&self, service: Service) -> &ProcessEntry {
        &self.entries[service as usize]
    }

    pub(crate) fn entry_mut(&mut self, service: Service) -> &mut ProcessEntry {
        &mut self.entries[service as usize]
    }

    /// Every service, whether or not it runs here.
    pub(crate) fn entries(&self) -> impl Iterator<Item = (Service, &ProcessEntry)> {
        Service::ALL.into_iter().zip(&self.entries)
    }

    /// The first tick whose inputs a living process of each slot may still take, as far as it is known. For a candidate before
    /// `held_from` nobody goes back: it may never have opened its topics. One that begins in the place of an owner that has ended is an owner
    /// like any other.
    pub(crate) fn positions(&self, held_from: u64) -> [Option<u64>; Service::ALL.len()] {
        let mut positions = [None; Service::ALL.len()];
        for (position, (service, entry)) in positions.iter_mut().zip(self.entries()) {
            if !service.is_slot() {
                continue;
            }
            let owner = entry.process.as_ref().and_then(Process::next_tick);
            let candidate = entry.candidate.as_ref();
            let looked_after = candidate
                .and_then(|candidate| candidate.next_tick().filter(|tick| candidate.owns || *tick >= held_from));
            *position = owner.into_iter().chain(looked_after).min();
        }
        positions
    }

    /// The number of the next process.
    pub(crate) fn next_incarnation(&mut self) -> u32 {
        self.incarnations += 1;
        self.incarnations
    }

    /// A service has said where it can be reached.
    pub(crate) fn found(&mut self, service: &str, at: String) {
        if let Some(service) = Service::named(service) {
            self.entry_mut(service).at = Some(at);
        }
    }

    /// A service has said what is wrong with what it reads.
    pub(crate) fn has_troubles(&mut self, service: &str, mut troubles: Vec<Trouble>) {
        if let Some(service) = Service::named(service) {
            troubles.truncate(TROUBLES_MAX);
            self.entry_mut(service).troubles = troubles;
        }
    }

    /// Takes what a service says of itself; the last words of the dead are left out.
    pub(crate) fn on_health(&mut self, health: Health, now: Duration) {
        let Some(entry) = self.entries.get_mut(health.service as usize) else { return };
        let is_first = |process: &&Process| process.incarnation == health.incarnation && process.health.is_none();
        if let Some(owner) = entry.process.as_ref().filter(is_first) {
            entry.policy.on_first_health(now.saturating_sub(owner.since));
        }
        for process in entry.processes_mut().filter(|process| process.incarnation == health.incarnation) {
            process.health = Some(health);
            (process.quiet_since, process.forgiven) = (now, false);
        }
    }

    /// Whether this process is to take over.
    pub(crate) fn is_candidate(&self, service: u32, incarnation: u32) -> bool {
        let entry = self.entries.get(service as usize);
        entry.and_then(|entry| entry.candidate.as_ref()).is_some_and(|candidate| candidate.incarnation == incarnation)
    }

    /// The service of this process.
    pub(crate) fn service_of(&self, incarnation: u32) -> Option<Service> {
        let has = |entry: &ProcessEntry| entry.processes().any(|process| process.incarnation == incarnation);
        self.entries().find(|(_, entry)| has(entry)).map(|(service, _)| service)
    }

    /// Notes a process's number.
    pub(crate) fn on_spawned(&mut self, service: Service, incarnation: u32, pid: u32) {
        let its = |process: &&mut Process| process.incarnation == incarnation;
        self.entry_mut(service).processes_mut().filter(its).for_each(|process| process.pid = pid);
    }

    /// How long nobody looked at anything, since this was asked last.
    pub(crate) fn stood_still(&mut self, now: Duration) -> Duration {
        now.saturating_sub(std::mem::replace(&mut self.polled, now))
    }

    /// Ends a process that does not own its slot; one that does not go is killed when it is asked again.
    pub(crate) fn dismiss(&mut self, service: Service, incarnation: u32, actions: &mut Vec<Action>) {
        let its = |process: &&mut Process| process.incarnation == incarnation;
        for process in self.entry_mut(service).processes_mut().filter(its) {
            let asked = std::mem::replace(&mut process.asked, true);
            actions.push(if asked { Action::Kill { incarnation } } else { Action::Terminate { incarnation } });
        }
    }

    /// Every process was killed: the bus is no more. What is known of the services stays.
    pub(crate) fn leave_bus(&mut self) {
        for entry in &mut self.entries {
            (entry.process, entry.candidate) = (None, None);
            entry.retired.clear();
            (entry.due, entry.ownership, entry.at) = (None, None, None);
            entry.troubles.clear();
        }
    }
}

impl ProcessEntry {
    fn processes(&self) -> impl Iterator<Item = &Process> {
        self.process.iter().chain(&self.candidate).chain(&self.retired)
    }

    fn processes_mut(&mut self) -> impl Iterator<Item = &mut Process> {
        self.process.iter_mut().chain(&mut self.candidate).chain(&mut self.retired)
    }

    /// A process that was told to end.
    pub(crate) fn was_asked(&self, incarnation: u32) -> bool {
        self.processes().any(|process| process.incarnation == incarnation && process.asked)
    }

    /// What the owner of the slot said last.
    pub fn health(&self) -> Option<&Health> {
        self.process.as_ref()?.health.as_ref()
    }

    /// What the candidate said last.
    pub(crate) fn candidate_health(&self) -> Option<&Health> {
        self.candidate.as_ref()?.health.as_ref()
    }

    /// The process that owns the slot, where there is one.
    pub fn pid(&self) -> Option<u32> {
        self.process.as_ref().map(|process| process.pid).filter(|pid| *pid != 0)
    }

    /// The incarnation that owns the slot; 0 where there is none.
    pub fn incarnation(&self) -> u32 {
        self.process.as_ref().map_or(0, |process| process.incarnation)
    }

    /// Times it was started again.
    pub fn restarts(&self) -> u32 {
        self.policy.restarts
    }

    /// Where it can be reached.
    pub(crate) fn address(&self) -> Option<&str> {
        self.at.as_deref()
    }

    /// What is wrong with what it reads.
    pub(crate) fn troubles(&self) -> &[Trouble] {
        &self.troubles
    }

    /// What it does, in a word, where one that says nothing for `silence` is silent.
    pub fn state(&self, now: Duration, silence: Duration) -> &'static str {
        match (&self.process, self.health()) {
            _ if self.away => "failed",
            (None, _) => "backoff",
            (Some(_), None) => "starting",
            (Some(process), Some(_)) if now.saturating_sub(process.quiet_since) > silence => "silent",
            (Some(_), Some(health)) => State::name(health.state),
        }
    }

    /// The tick that its owner went on with, where it went on from a checkpoint.
    pub(crate) fn resumes_at(&self) -> Option<u64> {
        self.process.as_ref()?.resumes_at
    }

    /// It has opened its topics, or will not any more.
    pub(crate) fn is_settled(&self) -> bool {
        self.away || self.health().is_some() || self.is_replaced() && self.candidate_health().is_some()
    }

    /// Its owner has a process that has not opened its topics yet.
    pub(crate) fn is_starting(&self) -> bool {
        self.process.as_ref().is_some_and(|process| process.health.is_none())
    }

    /// A process beside it, which is to take over, has not opened its topics yet.
    pub(crate) fn has_starting_candidate(&self) -> bool {
        self.candidate.as_ref().is_some_and(|candidate| candidate.health.is_none())
    }

    /// Another stage begins in the place of the owner that has ended.
    pub(crate) fn is_replaced(&self) -> bool {
        self.candidate.as_ref().is_some_and(|candidate| candidate.owns)
    }

    /// It has one that owns its slot.
    pub(crate) fn has_process(&self) -> bool {
        self.process.is_some()
    }

    /// Takes a process that has ended out of the table.
    pub(crate) fn take_ended(&mut self, incarnation: u32) -> Option<Ended> {
        let its = |process: &mut Process| process.incarnation == incarnation;
        if let Some(process) = self.process.take_if(its) {
            self.at = None;
            self.troubles.clear();
            return Some(Ended::Owner(process));
        }
        let candidate = self.candidate.take_if(its);
        candidate.or_else(|| self.retired.extract_if(.., its).next()).map(Ended::Other)
    }

    /// A time in which nobody could say anything. Of a process that still says nothing only the first one is forgiven: on a machine with
    /// too much to do the supervisor is late again and again.
    pub(crate) fn forgive(&mut self, stood_still: Duration) {
        let processes = self.process.iter_mut().chain(&mut self.candidate);
        for process in processes.filter(|process| !process.forgiven) {
            process.quiet_since += stood_still;
            process.forgiven = true;
        }
    }

    /// Kills who says nothing any more.
    pub(crate) fn kill_silent(&mut self, service: Service, rule: &Restart, now: Duration, actions: &mut Vec<Action>) {
        // Until a candidate has begun to work, its swap has a deadline for it.
        let candidate = self.candidate.as_mut().filter(|candidate| candidate.health.is_some());
        let first_limit = if service.can_wait() { FIRST_HEALTH_LIMIT } else { self.policy.first_health_limit(rule) };
        for process in self.process.iter_mut().chain(candidate) {
            let (limit, what) = match &process.health {
                Some(_) => {
                    let limit = Duration::from_secs_f64(rule.silence_s);
                    (if service.can_wait() { limit.max(SILENCE_BESIDE) } else { limit }, "said nothing")
                }
                None => (first_limit, "not opened its topics"),
            };
            let silent = now.saturating_sub(process.quiet_since);
            if silent > limit && !std::mem::replace(&mut process.given_up, true) {
                let ms = silent.as_millis();
                actions.push(Action::Announce(format!("{service}: process {} has {what} for {ms} ms", process.pid)));
                actions.push(Action::Kill { incarnation: process.incarnation });
            }
        }
    }
}

impl Process {
    pub(crate) fn new(incarnation: u32, owns: bool, resume: Option<&Resume>, now: Duration) -> Self {
        let resumes_at = match resume {
            Some(Resume::Checkpoint(checkpoint)) => Some(checkpoint.next_tick),
            Some(Resume::Fresh | Resume::Source { .. }) | None => None,
        };
        let begins_again = matches!(resume, Some(Resume::Fresh));
        Self {
            incarnation,
            pid: 0,
            owns,
            since: now,
            resumes_at,
            first_tick: resumes_at.or(begins_again.then_some(0)),
            health: None,
            quiet_since: now,
            forgiven: false,
            asked: false,
            given_up: false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_that_begins_again_with_the_first_tick_needs_its_inputs_from_there_on() {
        let mut table = ProcessTable::new(Duration::ZERO);
        for (resume, position) in [(None, None), (Some(Resume::Fresh), Some(0))] {
            let process = Process::new(1, true, resume.as_ref(), Duration::ZERO);
            table.entry_mut(Service::Fuser).process = Some(process);
            assert_eq!(table.positions(0)[Service::Fuser as usize], position);
        }
    }

    #[test]
    fn nobody_goes_back_for_a_candidate_that_is_far_behind_but_for_one_that_owns_the_slot() {
        let checkpoint = messages::Checkpoint { next_tick: 10, ..bytemuck::Zeroable::zeroed() };
        let resume = Resume::Checkpoint(Box::new(checkpoint));
        for (owns, held_from, position) in [(false, 10, Some(10)), (false, 11, None), (true, 11, Some(10))] {
            let mut table = ProcessTable::new(Duration::ZERO);
            let candidate = Process::new(1, owns, Some(&resume), Duration::ZERO);
            table.entry_mut(Service::Fuser).candidate = Some(candidate);
            assert_eq!(table.positions(held_from)[Service::Fuser as usize], position, "{owns} {held_from}");
        }
    }
}
