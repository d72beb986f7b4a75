//! Services of a system and their processes.

use std::time::Duration;

use control::Diagnostic;
use launch::{Restart, Service};
use messages::{Health, State};
use swap::Resume;

use super::restart_policy::{FIRST_HEALTH_TIMEOUT, RestartPolicy};
use crate::Action;

/// Minimum silence timeout for low-priority services, which may have to wait for the processor.
const AUX_SILENCE_TIMEOUT: Duration = Duration::from_secs(5);

/// Maximum number of diagnostics kept per service.
const MAX_DIAGNOSTICS: usize = 16;

/// Table of the services of a system, in the order of [`Service::ALL`].
#[derive(Debug)]
pub(crate) struct ProcessTable {
    entries: [ProcessEntry; Service::ALL.len()],
    last_incarnation: u32,
    /// Time of the last call of [`take_stall`](Self::take_stall).
    last_polled: Duration,
}

/// Service and its processes.
#[derive(Debug, Default)]
pub struct ProcessEntry {
    /// Process that owns the slot, or the only process of a service without a slot.
    pub(crate) owner: Option<Process>,
    /// Process of a candidate for the slot, of a shadow, or of a replacement for a failed owner.
    pub(crate) candidate: Option<Process>,
    /// Processes that no longer own the slot and have not exited yet.
    pub(crate) retired: Vec<Process>,
    pub(crate) policy: RestartPolicy,
    /// Time of the next restart, if one is scheduled.
    pub(crate) restart_at: Option<Duration>,
    /// Set once the service has been given up and is no longer restarted.
    pub(crate) given_up: bool,
    /// Epoch and first tick with which the next owner process starts.
    pub(crate) ownership: Option<(u32, u64)>,
    address: Option<String>,
    diagnostics: Vec<Diagnostic>,
}

/// Process of a service.
#[derive(Debug)]
pub(crate) struct Process {
    pub(crate) incarnation: u32,
    /// Process ID; 0 until the process has started.
    pub(crate) pid: u32,
    /// Set if the process publishes as soon as it has started.
    pub(crate) owns_slot: bool,
    pub(crate) started: Duration,
    /// Tick of the checkpoint that the process resumed from, if any.
    resume_tick: Option<u64>,
    /// First input tick that the process needs, if known.
    first_tick: Option<u64>,
    pub(crate) health: Option<Health>,
    /// Time of the newest health report or, before the first report, of the start. A stall of the
    /// supervisor moves this time forward by the duration of the stall.
    silent_since: Duration,
    /// Set if the deadline of the current silence has already been extended because the supervisor
    /// stalled.
    stall_credited: bool,
    /// Set once the process was requested to exit.
    terminate_sent: bool,
    /// Set if the process was killed because it did not report in time.
    pub(crate) timed_out: bool,
}

/// Exited process, by its former role.
pub(crate) enum ExitedProcess {
    /// Owner of the slot.
    Owner(Process),
    /// Candidate or retired process.
    Other(Process),
}

impl Process {
    /// Returns the next input tick that the process needs, if known.
    fn next_tick(&self) -> Option<u64> {
        self.first_tick.max(self.health.map(|health| health.next_tick))
    }
}

impl ProcessTable {
    pub(crate) fn new(now: Duration) -> Self {
        Self { entries: Default::default(), last_incarnation: 0, last_polled: now }
    }

    pub(crate) fn entry(&self, service: Service) -> &ProcessEntry {
        &self.entries[service as usize]
    }

    pub(crate) fn entry_mut(&mut self, service: Service) -> &mut ProcessEntry {
        &mut self.entries[service as usize]
    }

    /// Returns every service, including those that do not run on this host.
    pub(crate) fn entries(&self) -> impl Iterator<Item = (Service, &ProcessEntry)> {
        Service::ALL.into_iter().zip(&self.entries)
    }

    /// Returns, for each service, the first input tick that a live process may still need.
    ///
    /// A candidate that needs ticks before `held_from` is ignored, because it may never have opened
    /// its topics. A replacement for a failed owner counts as an owner.
    pub(crate) fn positions(&self, held_from: u64) -> [Option<u64>; Service::ALL.len()] {
        let mut positions = [None; Service::ALL.len()];
        for (position, (service, entry)) in positions.iter_mut().zip(self.entries()) {
            if service.slot().is_none() {
                continue;
            }
            let owner = entry.owner.as_ref().and_then(Process::next_tick);
            let candidate = entry.candidate.as_ref();
            let candidate_tick = candidate
                .and_then(|candidate| candidate.next_tick().filter(|tick| candidate.owns_slot || *tick >= held_from));
            *position = owner.into_iter().chain(candidate_tick).min();
        }
        positions
    }

    /// Allocates the incarnation of a new process.
    pub(crate) fn next_incarnation(&mut self) -> u32 {
        self.last_incarnation += 1;
        self.last_incarnation
    }

    pub(crate) fn set_address(&mut self, service: &str, address: String) {
        if let Some(service) = Service::from_name(service) {
            self.entry_mut(service).address = Some(address);
        }
    }

    pub(crate) fn set_diagnostics(&mut self, service: &str, mut diagnostics: Vec<Diagnostic>) {
        if let Some(service) = Service::from_name(service) {
            diagnostics.truncate(MAX_DIAGNOSTICS);
            self.entry_mut(service).diagnostics = diagnostics;
        }
    }

    /// Records a health report. Reports from exited processes are ignored.
    ///
    /// Returns the tick of the checkpoint that an owner resumed from if this is its first report.
    pub(crate) fn on_health(&mut self, health: Health, now: Duration) -> Option<u64> {
        let entry = self.entries.get_mut(health.service as usize)?;
        let is_first = |process: &&Process| process.incarnation == health.incarnation && process.health.is_none();
        let mut resume_tick = None;
        if let Some(owner) = entry.owner.as_ref().filter(is_first) {
            entry.policy.on_first_health(now.saturating_sub(owner.started));
            resume_tick = owner.resume_tick;
        }
        for process in entry.processes_mut().filter(|process| process.incarnation == health.incarnation) {
            process.health = Some(health);
            (process.silent_since, process.stall_credited) = (now, false);
        }
        resume_tick
    }

    /// Returns `true` if the process is the candidate of the service.
    pub(crate) fn is_candidate(&self, service: u32, incarnation: u32) -> bool {
        let entry = self.entries.get(service as usize);
        entry.and_then(|entry| entry.candidate.as_ref()).is_some_and(|candidate| candidate.incarnation == incarnation)
    }

    /// Returns the service of a process that has not exited.
    pub(crate) fn service_of(&self, incarnation: u32) -> Option<Service> {
        let has = |entry: &ProcessEntry| entry.processes().any(|process| process.incarnation == incarnation);
        self.entries().find(|(_, entry)| has(entry)).map(|(service, _)| service)
    }

    /// Records the process ID of a started process.
    pub(crate) fn on_spawned(&mut self, service: Service, incarnation: u32, pid: u32) {
        let is_target = |process: &&mut Process| process.incarnation == incarnation;
        self.entry_mut(service).processes_mut().filter(is_target).for_each(|process| process.pid = pid);
    }

    /// Returns the time since the previous call. If it is long, the supervisor has stalled.
    pub(crate) fn take_stall(&mut self, now: Duration) -> Duration {
        now.saturating_sub(std::mem::replace(&mut self.last_polled, now))
    }

    /// Requests the exit of a process that does not own its slot. A second call kills the process.
    pub(crate) fn terminate(&mut self, service: Service, incarnation: u32, actions: &mut Vec<Action>) {
        let is_target = |process: &&mut Process| process.incarnation == incarnation;
        for process in self.entry_mut(service).processes_mut().filter(is_target) {
            let already_sent = std::mem::replace(&mut process.terminate_sent, true);
            actions.push(if already_sent { Action::Kill { incarnation } } else { Action::Terminate { incarnation } });
        }
    }

    /// Removes all processes after they were killed for a bus renewal. Restart counters are kept.
    pub(crate) fn clear_processes(&mut self) {
        for entry in &mut self.entries {
            (entry.owner, entry.candidate) = (None, None);
            entry.retired.clear();
            (entry.restart_at, entry.ownership, entry.address) = (None, None, None);
            entry.diagnostics.clear();
        }
    }
}

impl ProcessEntry {
    fn processes(&self) -> impl Iterator<Item = &Process> {
        self.owner.iter().chain(&self.candidate).chain(&self.retired)
    }

    fn processes_mut(&mut self) -> impl Iterator<Item = &mut Process> {
        self.owner.iter_mut().chain(&mut self.candidate).chain(&mut self.retired)
    }

    /// Returns `true` if the process was requested to exit.
    pub(crate) fn is_terminating(&self, incarnation: u32) -> bool {
        self.processes().any(|process| process.incarnation == incarnation && process.terminate_sent)
    }

    /// Returns the newest health report of the owner.
    pub fn health(&self) -> Option<&Health> {
        self.owner.as_ref()?.health.as_ref()
    }

    /// Returns the newest health report of the candidate.
    pub(crate) fn candidate_health(&self) -> Option<&Health> {
        self.candidate.as_ref()?.health.as_ref()
    }

    /// Returns the process ID of the owner; `None` if no process runs.
    pub fn pid(&self) -> Option<u32> {
        self.owner.as_ref().map(|process| process.pid).filter(|pid| *pid != 0)
    }

    /// Returns the incarnation of the owner; 0 if no process runs.
    pub fn incarnation(&self) -> u32 {
        self.owner.as_ref().map_or(0, |process| process.incarnation)
    }

    /// Returns the number of restarts.
    pub fn restarts(&self) -> u32 {
        self.policy.restarts
    }

    /// Returns the address at which the service can be reached, if reported.
    pub(crate) fn address(&self) -> Option<&str> {
        self.address.as_deref()
    }

    /// Returns the problems with the input of the service.
    pub(crate) fn diagnostics(&self) -> &[Diagnostic] {
        &self.diagnostics
    }

    /// Returns the state in one word. A running service is "silent" if its last health report is
    /// older than `silence`.
    pub fn state(&self, now: Duration, silence: Duration) -> &'static str {
        match (&self.owner, self.health()) {
            _ if self.given_up => "failed",
            (None, _) => "backoff",
            (Some(_), None) => "starting",
            (Some(process), Some(_)) if now.saturating_sub(process.silent_since) > silence => "silent",
            (Some(_), Some(health)) => State::name(health.state),
        }
    }

    /// Returns the tick of the checkpoint that the owner resumed from, if any.
    pub(crate) fn resume_tick(&self) -> Option<u64> {
        self.owner.as_ref()?.resume_tick
    }

    /// Returns `true` if the service has opened its topics or will not be started again.
    pub(crate) fn is_settled(&self) -> bool {
        self.given_up || self.health().is_some() || self.has_replacement() && self.candidate_health().is_some()
    }

    /// Returns `true` if the owner's process has not opened its topics yet.
    pub(crate) fn is_starting(&self) -> bool {
        self.owner.as_ref().is_some_and(|process| process.health.is_none())
    }

    /// Returns `true` if a candidate's process has not opened its topics yet.
    pub(crate) fn has_starting_candidate(&self) -> bool {
        self.candidate.as_ref().is_some_and(|candidate| candidate.health.is_none())
    }

    /// Returns `true` if another stage is replacing the failed owner.
    pub(crate) fn has_replacement(&self) -> bool {
        self.candidate.as_ref().is_some_and(|candidate| candidate.owns_slot)
    }

    /// Returns `true` if an owner process exists.
    pub(crate) fn has_process(&self) -> bool {
        self.owner.is_some()
    }

    /// Removes an exited process from the entry.
    pub(crate) fn remove_exited(&mut self, incarnation: u32) -> Option<ExitedProcess> {
        let is_target = |process: &mut Process| process.incarnation == incarnation;
        if let Some(process) = self.owner.take_if(is_target) {
            self.address = None;
            self.diagnostics.clear();
            return Some(ExitedProcess::Owner(process));
        }
        let candidate = self.candidate.take_if(is_target);
        candidate.or_else(|| self.retired.extract_if(.., is_target).next()).map(ExitedProcess::Other)
    }

    /// Extends the deadline of each silent process by the duration of a stall of the supervisor.
    ///
    /// Each silence is extended only once. Otherwise a hung process would never time out on an
    /// overloaded machine, on which the supervisor is late repeatedly.
    pub(crate) fn extend_deadlines(&mut self, stall: Duration) {
        let processes = self.owner.iter_mut().chain(&mut self.candidate);
        for process in processes.filter(|process| !process.stall_credited) {
            process.silent_since += stall;
            process.stall_credited = true;
        }
    }

    /// Kills processes that have exceeded their health timeout. `min_start` is the minimum timeout
    /// for the first report after a restart.
    pub(crate) fn kill_silent(
        &mut self,
        service: Service,
        rule: &Restart,
        min_start: Duration,
        now: Duration,
        actions: &mut Vec<Action>,
    ) {
        // Until its first health report, a candidate is subject to the deadline of its swap
        // instead.
        let candidate = self.candidate.as_mut().filter(|candidate| candidate.health.is_some());
        let first_timeout =
            if service.is_low_priority() { FIRST_HEALTH_TIMEOUT } else { self.policy.first_health_timeout(min_start) };
        for process in self.owner.iter_mut().chain(candidate) {
            let (timeout, what) = match &process.health {
                Some(_) => {
                    let limit = Duration::from_secs_f64(rule.silence_s);
                    (
                        if service.is_low_priority() { limit.max(AUX_SILENCE_TIMEOUT) } else { limit },
                        "reported no health",
                    )
                }
                None => (first_timeout, "not opened its topics"),
            };
            let silence = now.saturating_sub(process.silent_since);
            if silence > timeout && !std::mem::replace(&mut process.timed_out, true) {
                let ms = silence.as_millis();
                actions.push(Action::Announce(format!("{service}: process {} has {what} for {ms} ms", process.pid)));
                actions.push(Action::Kill { incarnation: process.incarnation });
            }
        }
    }
}

impl Process {
    pub(crate) fn new(incarnation: u32, owns_slot: bool, resume: Option<&Resume>, now: Duration) -> Self {
        let resume_tick = resume.and_then(Resume::checkpoint).map(|checkpoint| checkpoint.next_tick);
        let starts_fresh = matches!(resume, Some(Resume::Fresh));
        Self {
            incarnation,
            pid: 0,
            owns_slot,
            started: now,
            resume_tick,
            first_tick: resume_tick.or(starts_fresh.then_some(0)),
            health: None,
            silent_since: now,
            stall_credited: false,
            terminate_sent: false,
            timed_out: false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fresh_start_requires_inputs_from_tick_0() {
        let mut table = ProcessTable::new(Duration::ZERO);
        for (resume, position) in [(None, None), (Some(Resume::Fresh), Some(0))] {
            let process = Process::new(1, true, resume.as_ref(), Duration::ZERO);
            table.entry_mut(Service::Fuser).owner = Some(process);
            assert_eq!(table.positions(0)[Service::Fuser as usize], position);
        }
    }

    #[test]
    fn candidate_far_behind_is_ignored_unless_it_owns_the_slot() {
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
