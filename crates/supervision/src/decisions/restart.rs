//! Start, exit and restart of services.

use std::time::Duration;

use foreign::ForeignText;
use launch::{OnLimit, Restart, Service, Slot};
use messages::{EventKind, SystemEvent};
use swap::{FIRST_EPOCH, Resume, Role};

use crate::{
    Action, Failure, Spawn, Supervision,
    event::after_colon,
    state::{
        process::{ExitedProcess, Process},
        restart_policy::RestartVerdict,
    },
};

/// Shortest gap between two timer events that counts as a stall of the supervisor or the machine.
///
/// After a stall, the deadlines of silent services are extended by its duration.
const MIN_STALL: Duration = Duration::from_millis(100);

impl Supervision {
    /// Starts a service without a slot, or the owner of a slot. `resume` is `None` only for the
    /// first process of the service.
    pub(crate) fn spawn_owner(&mut self, service: Service, resume: Option<Resume>) {
        let incarnation = self.table.next_incarnation();
        let entry = self.table.entry_mut(service);
        let (epoch, from_tick) = entry.ownership.unwrap_or((FIRST_EPOCH, 0));
        entry.owner = Some(Process::new(incarnation, true, resume.as_ref(), self.now));
        entry.restart_at = None;
        entry.policy.restarts += u32::from(resume.is_some());
        let stage = service.slot().map(|slot| self.config.launch.stage(slot).clone());
        let role = Role::Owner { from_tick };
        self.actions.push(Action::Spawn(Box::new(Spawn { incarnation, service, stage, role, epoch, resume })));
    }

    pub(crate) fn on_spawned(&mut self, incarnation: u32, pid: u32) {
        let Some(service) = self.table.service_of(incarnation) else { return };
        self.table.on_spawned(service, incarnation, pid);
        if self.table.is_candidate(service as u32, incarnation) {
            let instance = service.slot().and_then(|slot| self.swaps.candidate_instance(slot)).cloned();
            self.publish_instance(EventKind::CANDIDATE, service, incarnation, 0, SystemEvent::NONE, instance.as_ref());
            return self.notify_slot_of(service, swap::Event::Spawned { incarnation });
        }
        self.publish_start(service, incarnation);
        let restarts = self.table.entry(service).restarts();
        if restarts > 0 {
            self.announce(format!("{service}: restarted as process {pid} (restart {restarts})"));
            self.notify_slot_of(service, swap::Event::Restarted { incarnation });
        }
    }

    /// Handles a process that could not be started.
    ///
    /// If it was the first process of a service, the system ends. Otherwise the failure counts as
    /// an exit without a health report.
    pub(crate) fn on_spawn_failed(&mut self, incarnation: u32, cause: String) {
        let Some(service) = self.table.service_of(incarnation) else { return };
        match self.table.entry_mut(service).remove_exited(incarnation) {
            Some(ExitedProcess::Other(_)) => self.notify_slot_of(service, swap::Event::SpawnFailed { cause }),
            Some(ExitedProcess::Owner(_)) if self.table.entry(service).restarts() == 0 => {
                self.finish(Some(Failure::SpawnFailed { cause }));
            }
            Some(ExitedProcess::Owner(process)) => self.on_owner_exit(service, &process, cause, ForeignText::default()),
            _ => {}
        }
    }

    pub(crate) fn on_exit(&mut self, incarnation: u32, exit_status: String, stderr: ForeignText) {
        let Some(service) = self.table.service_of(incarnation) else { return };
        // If the exit was requested, the event that caused the request has already been published.
        if !self.table.entry(service).is_terminating(incarnation) {
            self.publish_service_event(
                service,
                incarnation,
                SystemEvent::new(EventKind::ENDED).with_reason(&exit_status),
            );
        }
        match self.table.entry_mut(service).remove_exited(incarnation) {
            Some(ExitedProcess::Owner(process)) => {
                self.swaps.record_stderr(service, &stderr);
                self.notify_slot_of(service, swap::Event::Exited { incarnation });
                self.on_owner_exit(service, &process, exit_status, stderr);
            }
            Some(ExitedProcess::Other(process)) => {
                if !stderr.raw().is_empty() {
                    self.announce(format!("{service}: stderr of process {}{}", process.pid, after_colon(&stderr)));
                }
                if process.health.is_none() {
                    self.renewals.set_join_failed(true);
                }
                self.swaps.record_stderr(service, &stderr);
                self.notify_slot_of(service, swap::Event::Exited { incarnation });
            }
            None => {}
        }
    }

    /// Returns `true` if attitudes can still be computed without the service. Of gyro and accel,
    /// only one is needed.
    fn is_dispensable(&self, service: Service) -> bool {
        match service.slot() {
            Some(Slot::Gyro) => !self.table.entry(Service::Accel).given_up,
            Some(Slot::Accel) => !self.table.entry(Service::Gyro).given_up,
            Some(Slot::Fuser | Slot::Course) => false,
            None => service.is_auxiliary(),
        }
    }

    /// Restarts the service, gives it up or stops the system, according to the restart rule of the
    /// launch file.
    fn on_owner_exit(&mut self, service: Service, process: &Process, exit_status: String, stderr: ForeignText) {
        let output = after_colon(&stderr);
        let rule = self.config.launch.restart;
        let on_limit = match rule.on_limit {
            _ if service.is_auxiliary() => OnLimit::Retry,
            // Nothing can continue without the source. A source that waits for attitudes would wait
            // forever if a service that they depend on were given up.
            OnLimit::Degrade if service == self.config.launch.tick_source() => OnLimit::Stop,
            OnLimit::Degrade if self.source_waits() && !self.is_dispensable(service) => OnLimit::Stop,
            on_limit => on_limit,
        };
        let rule = Restart { on_limit, ..rule };
        let entry = self.table.entry_mut(service);
        let verdict = match process.health {
            None if process.timed_out && entry.policy.restarts == 0 => entry.policy.on_failed_first_start(&rule),
            health => entry.policy.on_exit(health.map(|_| self.now.saturating_sub(process.started)), &rule),
        };
        let pid = process.pid;
        let process_label = if pid == 0 { String::new() } else { format!("process {pid} ") };
        match verdict {
            RestartVerdict::StopSystem if pid == 0 => self.finish(Some(Failure::SpawnFailed { cause: exit_status })),
            RestartVerdict::StopSystem => {
                self.finish(Some(Failure::ServiceExited { service, pid, exit_status, stderr }))
            }
            RestartVerdict::GiveUp => {
                entry.given_up = true;
                self.publish_service_event(
                    service,
                    process.incarnation,
                    SystemEvent::new(EventKind::GIVEN_UP).with_reason(&exit_status),
                );
                self.announce(format!(
                    "{service}: {process_label}{exit_status}; restart limit reached, not restarted{}{output}",
                    remedy(service)
                ));
                self.notify_slot_of(service, swap::Event::Vacated);
            }
            RestartVerdict::Restart(pause) => {
                entry.restart_at = Some(self.now + pause);
                let when =
                    if pause.is_zero() { String::new() } else { format!(", restarting in {} ms", pause.as_millis()) };
                let remedy = if entry.policy.exceeds_limit(&rule) { remedy(service) } else { String::new() };
                self.announce(format!("{service}: {process_label}{exit_status}{when}{remedy}{output}"));
            }
        }
    }

    /// Restarts every service that is due for a restart.
    pub(crate) fn restart_due(&mut self) {
        for service in Service::ALL {
            let entry = self.table.entry(service);
            if !entry.has_replacement() && entry.restart_at.is_some_and(|restart_at| self.now >= restart_at) {
                let (_, from_tick) = entry.ownership.unwrap_or((FIRST_EPOCH, 0));
                let resume = self.checkpoints.resume(service, from_tick);
                self.spawn_owner(service, Some(resume));
            }
        }
    }

    /// Extends every deadline by the duration of a stall of the supervisor.
    pub(crate) fn extend_deadlines_after_stall(&mut self) {
        let stall = self.table.take_stall(self.now);
        if stall > MIN_STALL {
            Service::ALL.into_iter().for_each(|service| self.table.entry_mut(service).extend_deadlines(stall));
            self.flow.extend_deadlines(stall);
        }
    }

    pub(crate) fn kill_silent(&mut self) {
        let rule = self.config.launch.restart;
        for service in Service::ALL {
            self.table.entry_mut(service).kill_silent(service, &rule, self.now, &mut self.actions);
        }
    }
}

/// Returns the suggested remedy for a failed service, as a suffix of a message.
fn remedy(service: Service) -> String {
    if service.slot().is_some() {
        format!("; replace its stage with `plumb swap {service} STAGE`")
    } else {
        String::new()
    }
}
