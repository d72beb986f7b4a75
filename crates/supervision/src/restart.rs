//! Services that are started, end, and are started again.

use std::time::Duration;

use launch::{OnLimit, Restart, Service};
use messages::{EventKind, SystemEvent};
use swap::{FIRST_EPOCH, Role};

use crate::{
    Action, Failure, Resume, Spawn, Supervision,
    process::{Ended, Process},
    restart_policy::Verdict,
};

/// When the supervisor itself did not run for so long, nobody's silence in that time counts: the machine stood still, or was taken away.
const STANDSTILL: Duration = Duration::from_millis(100);

impl Supervision {
    /// Starts the owner of a slot, or a service that has none; from `resume` where it is not its first process.
    pub(crate) fn spawn_owner(&mut self, service: Service, resume: Option<Resume>) {
        let incarnation = self.table.next_incarnation();
        let entry = self.table.entry_mut(service);
        let (epoch, from_tick) = entry.ownership.unwrap_or((FIRST_EPOCH, 0));
        entry.process = Some(Process::new(incarnation, true, resume.as_ref(), self.now));
        entry.due = None;
        entry.policy.restarts += u32::from(resume.is_some());
        let stage = self.config.launch.slot(service).cloned();
        let role = Role::Owner { from_tick };
        self.actions.push(Action::Spawn(Box::new(Spawn { incarnation, service, stage, role, epoch, resume })));
    }

    pub(crate) fn on_spawned(&mut self, incarnation: u32, pid: u32) {
        let Some(service) = self.table.service_of(incarnation) else { return };
        self.table.on_spawned(service, incarnation, pid);
        if self.table.is_candidate(service as u32, incarnation) {
            let beside = self.swaps.beside(service).cloned();
            self.tell_filling(EventKind::CANDIDATE, service, incarnation, 0, SystemEvent::NONE, beside.as_ref());
            return self.notify_slot(service, swap::Event::Spawned { incarnation });
        }
        self.tell_start(service, incarnation);
        let restarts = self.table.entry(service).restarts();
        if restarts > 0 {
            self.announce(format!("{service}: process {pid} goes on, restart {restarts}"));
            self.notify_slot(service, swap::Event::Restarted { incarnation });
        }
    }

    /// A first process that cannot be started ends the system; a later one is one more that never said anything.
    pub(crate) fn on_spawn_failed(&mut self, incarnation: u32, cause: String) {
        let Some(service) = self.table.service_of(incarnation) else { return };
        match self.table.entry_mut(service).take_ended(incarnation) {
            Some(Ended::Other(_)) => self.notify_slot(service, swap::Event::SpawnFailed { cause }),
            Some(Ended::Owner(_)) if self.table.entry(service).restarts() == 0 => {
                self.finish(Some(Failure::NotStarted { cause }));
            }
            Some(Ended::Owner(process)) => self.on_owner_exit(service, &process, cause, String::new()),
            _ => {}
        }
    }

    pub(crate) fn on_exit(&mut self, incarnation: u32, how: String, stderr: String) {
        let Some(service) = self.table.service_of(incarnation) else { return };
        // Of one that was asked to go, what it made room for has been told.
        if !self.table.entry(service).was_asked(incarnation) {
            self.tell_of(service, incarnation, SystemEvent::new(EventKind::ENDED).with_why(&how));
        }
        match self.table.entry_mut(service).take_ended(incarnation) {
            Some(Ended::Owner(process)) => {
                self.swaps.note_last_words(service, &stderr);
                self.notify_slot(service, swap::Event::Died { incarnation });
                self.on_owner_exit(service, &process, how, stderr);
            }
            Some(Ended::Other(process)) => {
                if !stderr.is_empty() {
                    self.announce(format!("{service}: process {} said:\n{stderr}", process.pid));
                }
                if process.health.is_none() {
                    self.renewals.set_unjoined(true);
                }
                self.swaps.note_last_words(service, &stderr);
                self.notify_slot(service, swap::Event::Died { incarnation });
            }
            None => {}
        }
    }

    /// Attitudes come out without it: of gyro and accel one is enough.
    fn is_dispensable(&self, service: Service) -> bool {
        match service {
            Service::Gyro => !self.table.entry(Service::Accel).away,
            Service::Accel => !self.table.entry(Service::Gyro).away,
            Service::Ingest | Service::Fuser | Service::Course => false,
            Service::Gateway | Service::Drivers | Service::Cockpit => true,
        }
    }

    /// What becomes of a service whose process has ended, by the rule of the launch file.
    fn on_owner_exit(&mut self, service: Service, process: &Process, how: String, stderr: String) {
        let stderr = if stderr.is_empty() { stderr } else { format!(":\n{stderr}") };
        let rule = self.config.launch.restart;
        let on_limit = match rule.on_limit {
            _ if service.is_beside() => OnLimit::Hold,
            // Without a source there is nothing to go on with, and one that waits for the attitude would wait for ever.
            OnLimit::Degrade if service == self.config.launch.origin() => OnLimit::Stop,
            OnLimit::Degrade if self.waits() && !self.is_dispensable(service) => OnLimit::Stop,
            on_limit => on_limit,
        };
        let rule = Restart { on_limit, ..rule };
        let entry = self.table.entry_mut(service);
        let verdict = match process.health {
            None if process.given_up && entry.policy.restarts == 0 => entry.policy.never_began(&rule),
            health => entry.policy.on_exit(health.map(|_| self.now.saturating_sub(process.since)), &rule),
        };
        let pid = process.pid;
        let who = if pid == 0 { String::new() } else { format!("process {pid} ") };
        match verdict {
            Verdict::Stop if pid == 0 => self.finish(Some(Failure::NotStarted { cause: how })),
            Verdict::Stop => self.finish(Some(Failure::ServiceEnded { service, pid, how, stderr })),
            Verdict::Away => {
                entry.away = true;
                self.tell_of(service, process.incarnation, SystemEvent::new(EventKind::GIVEN_UP).with_why(&how));
                self.announce(format!(
                    "{service}: {who}{how}; it has failed and stays away{}{stderr}",
                    remedy(service)
                ));
                self.notify_slot(service, swap::Event::Vacated);
            }
            Verdict::Again(pause) => {
                entry.due = Some(self.now + pause);
                let when = if pause.is_zero() { String::new() } else { format!(", again in {} ms", pause.as_millis()) };
                let remedy = if entry.policy.has_failed(&rule) { remedy(service) } else { String::new() };
                self.announce(format!("{service}: {who}{how}{when}{remedy}{stderr}"));
            }
        }
    }

    /// Starts again whose time has come.
    pub(crate) fn restart_due(&mut self) {
        for service in Service::ALL {
            let entry = self.table.entry(service);
            if !entry.is_replaced() && entry.due.is_some_and(|due| self.now >= due) {
                let (_, from_tick) = entry.ownership.unwrap_or((FIRST_EPOCH, 0));
                let resume = self.checkpoints.resume(service, from_tick);
                self.spawn_owner(service, Some(resume));
            }
        }
    }

    /// A time in which the supervisor did not run is nobody's silence.
    pub(crate) fn forgive_standstill(&mut self) {
        let stood_still = self.table.stood_still(self.now);
        if stood_still > STANDSTILL {
            Service::ALL.into_iter().for_each(|service| self.table.entry_mut(service).forgive(stood_still));
            self.flow.forgive(stood_still);
        }
    }

    pub(crate) fn kill_silent(&mut self) {
        let rule = self.config.launch.restart;
        for service in Service::ALL {
            self.table.entry_mut(service).kill_silent(service, &rule, self.now, &mut self.actions);
        }
    }
}

/// What can be done about a service that has failed.
fn remedy(service: Service) -> String {
    let is_slot = Service::SLOTS.contains(&service);
    if is_slot { format!("; `plumb swap {service} STAGE` puts another stage in its place") } else { String::new() }
}
