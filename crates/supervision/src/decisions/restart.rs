//! Start, exit and restart of services.

use std::time::Duration;

use foreign::ForeignText;
use launch::{OnLimit, Restart, Service, Slot};
use messages::{EventKind, Health, SystemEvent};
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

/// Minimum time that a restarted external stage is given to start, as a share of `buffer_s`.
///
/// An interpreter starts several times slower on a busy machine. Killing the stage earlier gains
/// nothing, because the topics still hold its inputs, and the remainder of `buffer_s` suffices for
/// a further start.
const EXTERNAL_START_SHARE: f64 = 0.75;

/// Suggested `buffer_s` relative to the buffer time that the restart would have needed.
const BUFFER_MARGIN: f64 = 1.25;

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
            OnLimit::Degrade if service == self.config.launch.tick_source().service() => OnLimit::Stop,
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
        let launch = &self.config.launch;
        let rule = launch.restart;
        for service in Service::ALL {
            let is_external = service.slot().is_some_and(|slot| launch.external_stage(slot).is_some());
            let min_start_s = if is_external { EXTERNAL_START_SHARE * launch.buffer_s } else { 0.0 };
            let min_start = Duration::from_secs_f64(rule.silence_s.max(min_start_s));
            self.table.entry_mut(service).kill_silent(service, &rule, min_start, self.now, &mut self.actions);
        }
    }

    /// Records a health report. If the restart of an owner took longer than the topics hold
    /// messages, announces how many ticks were lost.
    pub(crate) fn on_health(&mut self, health: Health) {
        let Some(resume_tick) = self.table.on_health(health, self.now) else { return };
        let Some(service) = Service::ALL.get(health.service as usize) else { return };
        let behind = self.published.iter().max().map_or(0, |newest| newest.saturating_sub(resume_tick));
        let lost = behind.saturating_sub(self.config.buffer_ticks);
        if lost == 0 || self.source_waits() || service.slot().is_none() {
            return;
        }
        let buffer_s = self.config.launch.buffer_s;
        let needed_s = (BUFFER_MARGIN * behind as f64 / self.config.rate_hz).ceil();
        let remedy = if needed_s <= launch::max_buffer_s(self.config.rate_hz) {
            format!("; if a restart can take as long again, set buffer_s = {needed_s}")
        } else {
            String::new()
        };
        self.announce(format!(
            "{service}: its restart took longer than the topics hold messages (buffer_s = {buffer_s}): about {} lost{remedy}",
            launch::pluralize(lost, "tick")
        ));
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

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;
    use launch::Launch;
    use messages::{Checkpoint, State};

    use super::*;
    use crate::{Config, Event};

    /// Live system with an external stage in the slot fuser.
    fn supervision(rate_hz: f64) -> Supervision {
        let text = "[fuser]\nstage = \"own\"\n[stages.own]\nslot = \"fuser\"\ncommand = [\"python3\", \"own.py\"]\n";
        let config = Config {
            launch: Launch::parse("launch.toml", text).unwrap(),
            rate_hz,
            lockstep: false,
            window_ticks: 20,
            buffer_ticks: 200,
            stop_after: None,
            validate: |_, _| Ok(()),
        };
        Supervision::new(config, Duration::ZERO)
    }

    fn health(service: Service, incarnation: u32) -> Event {
        let (state, service) = (State::RUNNING, service as u32);
        Event::Health(Health { service, incarnation, state, ..Health::zeroed() })
    }

    /// Starts the system and restarts its fuser from tick 100, when tick 150 is the newest. Returns
    /// the incarnation of the fuser's new process.
    fn restart_fuser(supervision: &mut Supervision, now: Duration) -> u32 {
        let spawned = |actions: Vec<Action>| {
            let spawn = |action| if let Action::Spawn(spawn) = action { Some(*spawn) } else { None };
            actions.into_iter().filter_map(spawn).map(|spawn| (spawn.service, spawn.incarnation)).collect::<Vec<_>>()
        };
        let mut fuser = 0;
        for (service, incarnation) in spawned(supervision.handle(now, Event::Timer)) {
            supervision.handle(now, Event::Spawned { incarnation, pid: incarnation });
            supervision.handle(now, health(service, incarnation));
            fuser = if service == Service::Fuser { incarnation } else { fuser };
        }
        let service = Service::Fuser as u32;
        let mut checkpoint = Checkpoint { service, incarnation: fuser, next_tick: 100, ..Checkpoint::zeroed() };
        checkpoint.checksum = checkpoint.compute_checksum();
        supervision.handle(now, Event::Checkpoint(Box::new(checkpoint)));
        supervision.handle(now, Event::Published { service: Service::Ingest, next_tick: 150 });
        let (exit_status, stderr) = (String::from("exited with code 1"), ForeignText::default());
        supervision.handle(now, Event::Exited { incarnation: fuser, exit_status, stderr });
        let (_, incarnation) = spawned(supervision.handle(now, Event::Timer))[0];
        supervision.handle(now, Event::Spawned { incarnation, pid: incarnation });
        incarnation
    }

    fn announced(actions: Vec<Action>) -> String {
        let line = |action| if let Action::Announce(line) = action { Some(line) } else { None };
        actions.into_iter().filter_map(line).collect::<Vec<_>>().join("\n")
    }

    #[test]
    fn restart_later_than_the_buffer_reports_loss_and_remedy() {
        for (rate_hz, newest, expected) in [
            (100.0, 300, ""),
            (100.0, 400, "about 100 ticks lost; if a restart can take as long again, set buffer_s = 4"),
            (100.0, 9000, "about 8700 ticks lost"),
            // At this rate, a topic cannot hold messages for more than 16.4 s.
            (4000.0, 80_000, "about 79700 ticks lost"),
        ] {
            let mut supervision = supervision(rate_hz);
            let incarnation = restart_fuser(&mut supervision, Duration::ZERO);
            supervision.handle(Duration::ZERO, Event::Published { service: Service::Ingest, next_tick: newest });
            let line = announced(supervision.handle(Duration::ZERO, health(Service::Fuser, incarnation)));
            assert!(line.ends_with(expected) && line.is_empty() == expected.is_empty(), "{newest}: {line}");
        }
    }

    #[test]
    fn restarted_program_may_start_while_its_inputs_are_held() {
        let mut supervision = supervision(100.0);
        restart_fuser(&mut supervision, Duration::ZERO);
        let mut killed_after_ms = None;
        for ms in (0..4000).step_by(10) {
            let actions = supervision.handle(Duration::from_millis(ms), Event::Timer);
            let starts = announced(actions).contains("has not opened its topics");
            killed_after_ms = killed_after_ms.or(starts.then_some(ms));
        }
        assert_eq!(killed_after_ms, Some(1510), "three quarters of buffer_s");
    }
}
