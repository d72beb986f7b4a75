//! From the start of the first service to the end of the last: readiness, credit for the source, the end.

use std::time::Duration;

use launch::Service;
use messages::{EventKind, State, SystemEvent};

use crate::{Action, Failure, Supervision};

/// After the source's end, how long nothing may come before the rest is given up as lost: a service that was killed or has frozen is back by
/// then.
const DRAIN_LIMIT: Duration = Duration::from_secs(2);
/// The same where a service is on its way back and nobody has asked for the end: longer than any start may take.
const DRAIN_LIMIT_STARTING: Duration = Duration::from_secs(15);

/// Where the source waits for the output and every service runs, how much longer than a silent service is borne nothing may come before
/// what is missing is taken to be lost for good.
const MISSING_LIMIT: Duration = Duration::from_secs(5);
/// From one window that is granted then to the next: whoever reads can follow.
const WINDOW_PAUSE: Duration = Duration::from_millis(100);

/// How far the system is.
#[derive(Debug)]
pub(crate) struct Flow {
    phase: Phase,
    end_asked: bool,
    /// When every service was ready first.
    ready: Option<Duration>,
    granted_ticks: u64,
    next_tick: u64,
    /// When a tick came last.
    progressed: Duration,
    /// When a service was on its way back last.
    starting: Duration,
    /// When a window was granted last although nothing had come.
    widened: Duration,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// A service has not opened its topics yet: what would be published now could be missed.
    Starting,
    Running,
    /// The source publishes nothing new.
    Stopping,
    Ended,
}

impl Flow {
    pub(crate) fn new(now: Duration) -> Self {
        let (phase, end_asked, ready) = (Phase::Starting, false, None);
        let (granted_ticks, next_tick) = (0, 0);
        Self { phase, end_asked, ready, granted_ticks, next_tick, progressed: now, starting: now, widened: now }
    }

    pub(crate) fn ask_to_end(&mut self) {
        self.end_asked = true;
    }

    /// Every service has been ready, and the source has credit.
    pub(crate) fn is_running(&self) -> bool {
        matches!(self.phase, Phase::Running | Phase::Stopping)
    }

    pub(crate) fn has_ended(&self) -> bool {
        self.phase == Phase::Ended
    }

    /// The services start on another bus.
    pub(crate) fn start_again(&mut self) {
        self.phase = Phase::Starting;
    }

    /// A time in which nothing could come.
    pub(crate) fn forgive(&mut self, stood_still: Duration) {
        self.progressed += stood_still;
    }
}

impl Supervision {
    /// Sees whether the services are ready, the source has credit, or the end is reached.
    pub(crate) fn poll_flow(&mut self) {
        match self.flow.phase {
            Phase::Starting if self.path().all(|(_, entry)| entry.is_settled()) => self.begin(),
            Phase::Starting if self.flow.end_asked && self.is_start_given_up() => self.finish(None),
            Phase::Running | Phase::Stopping => self.flow_on(),
            Phase::Starting | Phase::Ended => {}
        }
    }

    fn begin(&mut self) {
        self.flow.phase = Phase::Running;
        self.flow.ready.get_or_insert(self.now);
        (self.flow.progressed, self.flow.next_tick) = (self.now, self.next_tick());
        let ticks = if self.waits() { self.next_tick() + self.config.window_ticks } else { u64::MAX };
        self.grant(ticks);
        self.actions.push(Action::Ready);
        self.tell(SystemEvent::new(EventKind::READY));
    }

    /// Whoever asks for the end of a system that has not begun does not wait for it; one that has goes on to the end of what came in.
    fn is_start_given_up(&self) -> bool {
        self.flow.ready.is_none() || self.now.saturating_sub(self.flow.progressed) > DRAIN_LIMIT_STARTING
    }

    fn flow_on(&mut self) {
        let next_tick = self.next_tick();
        if std::mem::replace(&mut self.flow.next_tick, next_tick) != next_tick {
            self.flow.progressed = self.now;
        }
        let window_ticks = self.config.window_ticks;
        if self.flow.phase == Phase::Running
            && self.waits()
            && next_tick + window_ticks >= self.flow.granted_ticks + window_ticks / 4
        {
            self.grant(next_tick + window_ticks);
        }
        let origin = self.config.launch.origin();
        let over = self.config.stop_after.zip(self.flow.ready).is_some_and(|(limit, ready)| self.now > ready + limit);
        if (self.flow.end_asked || over) && self.flow.phase == Phase::Running {
            self.flow.phase = Phase::Stopping;
            self.flow.progressed = self.now;
            self.actions.push(Action::Stopping);
            self.tell(SystemEvent::new(EventKind::ENDING));
            self.actions.push(Action::GrantCredit { ticks: self.flow.granted_ticks, ends: true });
        }
        let stopping = self.flow.phase == Phase::Stopping;
        let finished = self.table.entry(origin).health().is_some_and(|health| health.state == State::FINISHED);
        let dry = finished || stopping && !self.table.entry(origin).has_process();
        let starting = !stopping && self.path().any(|(_, entry)| !entry.is_settled());
        if starting {
            self.flow.starting = self.now;
        }
        self.grant_past_missing();
        let overdue = |since: Duration, limit: Duration| self.now.saturating_sub(since) > limit;
        let Flow { progressed, starting, .. } = self.flow;
        let given_up = (stopping || dry)
            && overdue(progressed, DRAIN_LIMIT)
            && (stopping || overdue(starting, DRAIN_LIMIT) || overdue(progressed, DRAIN_LIMIT_STARTING));
        if dry && next_tick >= self.ticks_in() || given_up {
            self.finish(None);
        }
    }

    /// A tick that is lost for good is given up by its readers once later ones are far enough ahead of it: the source may then go on
    /// although nothing comes out.
    fn grant_past_missing(&mut self) {
        if self.flow.phase != Phase::Running || !self.waits() {
            return;
        }
        let Flow { granted_ticks, progressed, starting, widened, .. } = self.flow;
        let limit = MISSING_LIMIT + Duration::from_secs_f64(self.config.launch.restart.silence_s);
        let overdue = self.now.saturating_sub(progressed.max(starting)) > limit;
        let used_up = self.published.iter().any(|next_tick| *next_tick >= granted_ticks);
        if overdue && used_up && self.now.saturating_sub(widened) >= WINDOW_PAUSE {
            self.flow.widened = self.now;
            self.grant(granted_ticks + self.config.window_ticks);
        }
    }

    /// From which tick on the topics hold every one until it is read: where the source waits, all that it has credit for; else what lies
    /// further back than half of what they hold may be overwritten before it is read.
    pub(crate) fn held_from(&self) -> u64 {
        let buffer_ticks = self.config.buffer_ticks;
        let newest = self.published.iter().max().copied().unwrap_or(0);
        if self.waits() {
            newest.max(self.flow.granted_ticks).saturating_sub(buffer_ticks)
        } else {
            newest.saturating_sub(buffer_ticks / 2)
        }
    }

    /// Every service has been ready, and the end is not reached.
    pub fn is_running(&self) -> bool {
        self.flow.is_running()
    }

    /// The source waits until attitudes have been taken.
    pub fn waits_for_output(&self) -> bool {
        self.waits() && self.flow.is_running()
    }

    /// Readings refused at the source.
    pub fn refused(&self) -> u64 {
        self.table.entry(self.config.launch.origin()).health().map_or(0, |health| health.refused)
    }

    /// After a cut an import has more to give than a topic holds.
    pub(crate) fn waits(&self) -> bool {
        self.config.lockstep || self.config.launch.origin() == Service::Gateway
    }

    fn grant(&mut self, ticks: u64) {
        self.flow.granted_ticks = ticks;
        self.actions.push(Action::GrantCredit { ticks, ends: false });
    }

    /// The end, whatever it is; every request that waits is answered first.
    pub(crate) fn finish(&mut self, failure: Option<Failure>) {
        self.abort_requests("the system ends");
        self.flow.phase = Phase::Ended;
        let why = failure.as_ref().map_or(String::new(), Failure::to_string);
        self.tell(SystemEvent { tick: self.next_tick(), ..SystemEvent::new(EventKind::FINISHED) }.with_why(&why));
        self.actions.push(Action::Finish(failure));
    }

    /// The tick that comes out next.
    pub fn next_tick(&self) -> u64 {
        self.published_elsewhere().unwrap_or(self.output.next_tick)
    }

    /// How far every slot here has published, if the attitude is made on another host.
    pub fn published_elsewhere(&self) -> Option<u64> {
        let path = || self.path().map(|(service, _)| service).filter(|service| !service.is_beside());
        let has_attitude = path().any(|service| service == Service::Course);
        (!has_attitude).then(|| path().map(|service| self.published[service as usize]).min()).flatten()
    }

    /// Ticks that have come in.
    pub fn ticks_in(&self) -> u64 {
        match self.config.launch.origin() {
            // What ingest has published counts, whether or not it lives to say so.
            Service::Ingest => self.published[Service::Ingest as usize],
            origin => self.table.entry(origin).health().map_or(0, |health| health.ticks),
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

    /// A system in lockstep.
    fn config(window_ticks: u64) -> Config {
        Config {
            launch: Launch::default(),
            rate_hz: 100.0,
            lockstep: true,
            window_ticks,
            buffer_ticks: 200,
            stop_after: None,
            validate: |_, _| Ok(()),
        }
    }

    /// The credit that the source of a system in lockstep has after each second, while `next_tick` is all that comes out.
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
            let (how, stderr) = (String::from("was ended by signal 9"), String::new());
            let exited = |incarnation| Event::Exited { incarnation, how: how.clone(), stderr: stderr.clone() };
            events.extend(killed.drain(..).map(exited));
            events.push(Event::Published { service: Service::Ingest, next_tick: credit });
            events.push(Event::Output(OutputProgress { next_tick, ..OutputProgress::default() }));
            events.push(Event::Time);
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
    fn where_nothing_comes_although_every_service_runs_the_source_goes_on_so_that_what_is_missing_is_given_up() {
        let credits = credits(20, 7, None);
        assert_eq!(credits[..5], [27; 5]);
        assert!(credits[9] > 27 + 20 * 30, "{credits:?}");
    }

    #[test]
    fn where_the_source_waits_the_topics_hold_all_that_it_has_credit_for() {
        for (lockstep, held_from) in [(true, 300 + 20 - 200), (false, 320 - 100)] {
            let config = Config { lockstep, ..config(20) };
            let mut supervision = Supervision::new(config, Duration::ZERO);
            supervision.flow.granted_ticks = if lockstep { 320 } else { u64::MAX };
            let published = if lockstep { 301 } else { 320 };
            supervision.handle(Duration::ZERO, Event::Published { service: Service::Ingest, next_tick: published });
            assert_eq!(supervision.held_from(), held_from, "{lockstep}");
        }
    }

    #[test]
    fn while_a_service_is_away_nothing_is_given_up() {
        assert_eq!(credits(20, 7, Some(Service::Fuser)), [27; 10]);
    }
}
