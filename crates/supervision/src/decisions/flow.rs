//! Readiness, credit for the source, and shutdown.

use std::time::Duration;

use launch::{Service, TickSource};
use messages::{EventKind, State, SystemEvent};

use crate::{
    Action, Failure, Supervision,
    state::flow::{Flow, Phase},
};

/// Longest time without output once the source has ended. After that, the remaining ticks are given
/// up.
///
/// This time is long enough for a killed or hung service to be restarted.
const DRAIN_TIMEOUT: Duration = Duration::from_secs(2);
/// Value used instead of [`DRAIN_TIMEOUT`] while a service is starting and no shutdown was
/// requested.
///
/// No service takes this long to start.
const DRAIN_TIMEOUT_STARTING: Duration = Duration::from_secs(15);

/// Time without output after which missing ticks count as lost although every service runs. It is
/// added to `silence_s`. The timeout applies only if the source waits for credit.
const MISSING_TICK_TIMEOUT: Duration = Duration::from_secs(5);
/// Interval at which the source receives an extra window of credit while the output waits for a
/// missing tick. It gives subscribers time to catch up.
const EXTRA_WINDOW_INTERVAL: Duration = Duration::from_millis(100);

impl Supervision {
    /// Advances the phase and grants credit to the source.
    pub(crate) fn poll_flow(&mut self) {
        match self.flow.phase {
            Phase::Starting if self.path().all(|(_, entry)| entry.is_settled()) => self.start_flow(),
            Phase::Starting if self.flow.stop_requested && self.may_abandon_start() => self.finish(None),
            Phase::Running | Phase::Stopping => self.advance_flow(),
            Phase::Starting | Phase::Ended => {}
        }
    }

    fn start_flow(&mut self) {
        self.flow.phase = Phase::Running;
        self.flow.first_ready.get_or_insert(self.now);
        (self.flow.last_progress, self.flow.next_tick) = (self.now, self.next_tick());
        let ticks = if self.source_waits() { self.next_tick() + self.config.window_ticks } else { u64::MAX };
        self.grant(ticks);
        self.actions.push(Action::Ready);
        self.publish_event(SystemEvent::new(EventKind::READY));
    }

    /// Returns `true` if a requested shutdown need not wait for the services to start.
    ///
    /// If every service has been ready once, the ticks already received are delivered first.
    /// Waiting for them ends after [`DRAIN_TIMEOUT_STARTING`] without output.
    fn may_abandon_start(&self) -> bool {
        self.flow.first_ready.is_none() || self.now.saturating_sub(self.flow.last_progress) > DRAIN_TIMEOUT_STARTING
    }

    fn advance_flow(&mut self) {
        let next_tick = self.next_tick();
        if std::mem::replace(&mut self.flow.next_tick, next_tick) != next_tick {
            self.flow.last_progress = self.now;
        }
        let window_ticks = self.config.window_ticks;
        if self.flow.phase == Phase::Running
            && self.source_waits()
            && next_tick + window_ticks >= self.flow.granted_ticks + window_ticks / 4
        {
            self.grant(next_tick + window_ticks);
        }
        let origin = self.config.launch.tick_source().service();
        let is_time_up =
            self.config.stop_after.zip(self.flow.first_ready).is_some_and(|(limit, ready)| self.now > ready + limit);
        if (self.flow.stop_requested || is_time_up) && self.flow.phase == Phase::Running {
            self.flow.phase = Phase::Stopping;
            self.flow.last_progress = self.now;
            self.actions.push(Action::Stopping);
            self.publish_event(SystemEvent::new(EventKind::ENDING));
            self.actions.push(Action::GrantCredit { ticks: self.flow.granted_ticks, is_final: true });
        }
        let stopping = self.flow.phase == Phase::Stopping;
        let finished = self.table.entry(origin).health().is_some_and(|health| health.state == State::FINISHED);
        let is_exhausted = finished || stopping && !self.table.entry(origin).has_process();
        let starting = !stopping && self.path().any(|(_, entry)| !entry.is_settled());
        if starting {
            self.flow.last_starting = self.now;
        }
        self.grant_past_missing_ticks();
        let overdue = |since: Duration, limit: Duration| self.now.saturating_sub(since) > limit;
        let Flow { last_progress, last_starting, .. } = self.flow;
        let given_up = (stopping || is_exhausted)
            && overdue(last_progress, DRAIN_TIMEOUT)
            && (stopping || overdue(last_starting, DRAIN_TIMEOUT) || overdue(last_progress, DRAIN_TIMEOUT_STARTING));
        if is_exhausted && next_tick >= self.ticks_in() || given_up {
            self.finish(None);
        }
    }

    /// Grants another window of credit although ticks are missing from the output.
    ///
    /// This is necessary because subscribers give up a lost tick only once later ticks are far
    /// enough ahead of it.
    fn grant_past_missing_ticks(&mut self) {
        if self.flow.phase != Phase::Running || !self.source_waits() {
            return;
        }
        let Flow { granted_ticks, last_progress, last_starting, last_extra_window, .. } = self.flow;
        let timeout = MISSING_TICK_TIMEOUT + Duration::from_secs_f64(self.config.launch.restart.silence_s);
        let overdue = self.now.saturating_sub(last_progress.max(last_starting)) > timeout;
        let is_credit_used = self.published.iter().any(|next_tick| *next_tick >= granted_ticks);
        if overdue && is_credit_used && self.now.saturating_sub(last_extra_window) >= EXTRA_WINDOW_INTERVAL {
            self.flow.last_extra_window = self.now;
            self.grant(granted_ticks + self.config.window_ticks);
        }
    }

    /// Returns the oldest tick that is guaranteed to stay in the topics until it is read.
    ///
    /// If the source waits for credit, this guarantee holds even after it has published every tick
    /// for which credit was granted, and another window. A process that starts now may read its
    /// first message only then. Otherwise messages older than half of the buffer may be overwritten
    /// before they are read.
    pub(crate) fn held_from(&self) -> u64 {
        let buffer_ticks = self.config.buffer_ticks;
        let newest = self.published.iter().max().copied().unwrap_or(0);
        if self.source_waits() {
            (newest.max(self.flow.granted_ticks) + self.config.window_ticks).saturating_sub(buffer_ticks)
        } else {
            newest.saturating_sub(buffer_ticks / 2)
        }
    }

    /// Returns `true` while the source has credit, including during shutdown.
    pub fn is_running(&self) -> bool {
        self.flow.is_running()
    }

    /// Returns `true` if the source waits until attitudes are collected.
    pub fn waits_for_output(&self) -> bool {
        self.source_waits() && self.flow.is_running()
    }

    /// Returns the number of readings rejected at the source.
    pub fn rejected(&self) -> u64 {
        self.table.entry(self.config.launch.tick_source().service()).health().map_or(0, |health| health.refused)
    }

    /// Returns the number of datagrams and readings that were lost before ingest numbered them.
    pub fn lost_readings(&self) -> u64 {
        let lost = |service| self.table.entry(service).health().map_or(0, |health| health.lost);
        match self.config.launch.tick_source() {
            TickSource::Ingest => lost(Service::Ingest) + lost(Service::Drivers),
            TickSource::Gateway => 0,
        }
    }

    /// Returns `true` if the source waits for credit, either in lockstep or because it imports
    /// ticks.
    ///
    /// An import has to wait, because after a link outage it holds more ticks than a topic buffers.
    pub(crate) fn source_waits(&self) -> bool {
        self.config.lockstep || self.config.launch.tick_source() == TickSource::Gateway
    }

    fn grant(&mut self, ticks: u64) {
        self.flow.granted_ticks = ticks;
        self.actions.push(Action::GrantCredit { ticks, is_final: false });
    }

    /// Ends the system. Requests in progress are answered first.
    pub(crate) fn finish(&mut self, failure: Option<Failure>) {
        self.abort_requests("the system is shutting down");
        self.flow.phase = Phase::Ended;
        let reason = failure.as_ref().map_or(String::new(), Failure::to_string);
        self.publish_event(
            SystemEvent { tick: self.next_tick(), ..SystemEvent::new(EventKind::FINISHED) }.with_reason(&reason),
        );
        self.actions.push(Action::Finish(failure));
    }

    /// Returns the next tick to be output.
    pub fn next_tick(&self) -> u64 {
        self.local_next_tick().unwrap_or(self.output.next_tick)
    }

    /// Returns the first tick that some local slot has not published yet. Returns `None` if the
    /// attitude is computed on this host.
    pub fn local_next_tick(&self) -> Option<u64> {
        let path = || self.path().map(|(service, _)| service).filter(|service| !service.is_auxiliary());
        let has_attitude = path().any(|service| service == Service::Course);
        (!has_attitude).then(|| path().map(|service| self.published[service as usize]).min()).flatten()
    }

    /// Returns the number of ticks received from the source.
    pub fn ticks_in(&self) -> u64 {
        match self.config.launch.tick_source() {
            // The next tick of the topic is up to date even if ingest has exited without reporting
            // its health.
            TickSource::Ingest => self.published[Service::Ingest as usize],
            TickSource::Gateway => self.table.entry(Service::Gateway).health().map_or(0, |health| health.ticks),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use launch::Launch;
    use messages::Health;

    use crate::{Config, Event, OutputProgress};

    /// Configuration of a system in lockstep.
    fn config(window_ticks: u64) -> Config {
        Config {
            launch: Launch { services: Service::PATH.into(), ..Launch::default() },
            rate_hz: 100.0,
            lockstep: true,
            window_ticks,
            buffer_ticks: 200,
            stop_after: None,
            validate: |_, _| Ok(()),
        }
    }

    /// Returns the credit granted to a source in lockstep after each second. The output is stuck at
    /// `next_tick`.
    ///
    /// The service `silent` reports no health after 100 ms.
    fn credits(window_ticks: u64, next_tick: u64, silent: Option<Service>) -> Vec<u64> {
        let mut supervision = Supervision::new(config(window_ticks), Duration::ZERO);
        let (mut credit, mut credits) = (0, Vec::new());
        let (mut incarnations, mut killed) = (Vec::new(), Vec::new());
        for tick in 0..1000 {
            let now = Duration::from_millis(10 * tick);
            let healths = incarnations.iter().filter(|(_, service)| tick < 10 || Some(*service) != silent);
            let health = |(incarnation, service): &(u32, Service)| {
                let (state, service) = (State::RUNNING, *service as u32);
                Event::Health(Health { service, incarnation: *incarnation, state, ..Health::zeroed() })
            };
            let mut events: Vec<_> = healths.map(health).collect();
            let (status, stderr) = (String::from("was killed by signal 9"), foreign::ForeignText::default());
            let exited =
                |incarnation| Event::Exited { incarnation, exit_status: status.clone(), stderr: stderr.clone() };
            events.extend(killed.drain(..).map(exited));
            events.push(Event::Published { service: Service::Ingest, next_tick: credit });
            events.push(Event::Output(OutputProgress { next_tick, ..OutputProgress::default() }));
            events.push(Event::Timer);
            for event in events {
                for action in supervision.handle(now, event) {
                    match action {
                        Action::Spawn(spawn) => incarnations.push((spawn.incarnation, spawn.service)),
                        Action::GrantCredit { ticks, .. } => credit = ticks,
                        Action::Kill { incarnation } => killed.push(incarnation),
                        _ => {}
                    }
                }
            }
            if tick % 100 == 99 {
                credits.push(credit);
            }
        }
        credits
    }

    #[test]
    fn credit_grows_past_missing_ticks_while_all_services_run() {
        let credits = credits(20, 7, None);
        assert_eq!(credits[..5], [27; 5]);
        assert!(credits[9] > 27 + 20 * 30, "{credits:?}");
    }

    #[test]
    fn held_from_covers_the_next_window_in_lockstep() {
        for (lockstep, held_from) in [(true, 300 + 20 + 20 - 200), (false, 320 - 100)] {
            let config = Config { lockstep, ..config(20) };
            let mut supervision = Supervision::new(config, Duration::ZERO);
            supervision.flow.granted_ticks = if lockstep { 320 } else { u64::MAX };
            let published = if lockstep { 301 } else { 320 };
            supervision.handle(Duration::ZERO, Event::Published { service: Service::Ingest, next_tick: published });
            assert_eq!(supervision.held_from(), held_from, "{lockstep}");
        }
    }

    #[test]
    fn credit_stays_while_a_service_is_silent() {
        assert_eq!(credits(20, 7, Some(Service::Fuser)), [27; 10]);
    }
}
