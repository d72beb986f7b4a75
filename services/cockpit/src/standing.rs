//! How the system is, once a second and after each event: what its supervisor says, with rates, latencies, costs and the judge's warnings.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError, Weak},
    thread::{self, Thread},
    time::{Duration, Instant},
};

use control::ServiceStatus;
use graph::{Service, Topic};
use judge::{FieldQueue, InputCheck};
use messages::{Header, ImuSample, MagSample};
use observe::{
    hops::{self, Hops},
    process::{Cost, Processes},
};
use runtime::clock::monotonic_ns;
use wire::v1::{self, LatencyUs, ServiceStanding, SlotStages, Standing, VehicleLine, standing::State};

use crate::source::{SystemDescription, CommandTarget, SourceState};

/// Between two questions to the supervisor.
const ASK_INTERVAL: Duration = Duration::from_secs(1);
/// At least so long, however many events there are.
const MIN_ASK_INTERVAL: Duration = Duration::from_millis(100);
/// Rates, latencies and costs are measured over so long at least: of a shorter time they say nothing.
const MIN_MEASURE_INTERVAL: Duration = Duration::from_millis(500);
/// Warnings at most.
const MAX_WARNINGS: usize = 32;

/// What the supervisor said last.
#[derive(Debug, Default)]
struct Said {
    answer: Option<(SystemDescription, Vec<ServiceStatus>)>,
    vehicles: Vec<VehicleLine>,
    /// Questions that have begun.
    asked: u64,
    /// Which of them this answers.
    answered: u64,
}

/// What was measured last.
struct Figures {
    at: Instant,
    rates_hz: [Option<f64>; Service::PATH.len()],
    latencies: [Option<hops::LatencyUs>; Service::PATH.len()],
    /// From birth to attitude.
    whole: Option<hops::LatencyUs>,
    /// Of each process on this machine.
    costs: HashMap<u32, Cost>,
}

/// Watches the path, and has the supervisor asked.
pub(crate) struct Watch {
    said: Arc<Mutex<Said>>,
    asker: Thread,
    /// Questions that had begun when the last event came, until a later one is answered and told.
    overtaken: Option<u64>,
    takes_commands: bool,
    hops: Hops,
    before: [Option<Header>; Service::PATH.len()],
    processes: Processes,
    figures: Option<Figures>,
    judge: Option<(InputCheck, FieldQueue)>,
    warnings: Vec<String>,
    state: Option<SourceState>,
}

impl Watch {
    /// `has_every_tick`: what comes can be judged.
    pub(crate) fn new(desk: Arc<dyn CommandTarget>, has_every_tick: bool) -> Self {
        Self::asking(desk, has_every_tick, ASK_INTERVAL)
    }

    fn asking(desk: Arc<dyn CommandTarget>, has_every_tick: bool, interval: Duration) -> Self {
        let said = Arc::new(Mutex::<Said>::default());
        let takes_commands = desk.takes_commands();
        let told = Arc::downgrade(&said);
        let asker = thread::spawn(move || ask(&*desk, &told, interval)).thread().clone();
        Self {
            said,
            asker,
            overtaken: None,
            takes_commands,
            hops: Hops::default(),
            before: [None; Service::PATH.len()],
            processes: Processes::default(),
            figures: None,
            judge: has_every_tick.then(Default::default),
            warnings: Vec::new(),
            state: None,
        }
    }

    /// Takes a message of a topic.
    pub(crate) fn take(&mut self, topic: Topic, bytes: &[u8]) {
        if let Some(service) = Service::PATH.into_iter().find(|service| service.output() == Some(topic)) {
            // Every message of the path begins with its header.
            let header =
                bytes.get(..size_of::<Header>()).and_then(|bytes| bytemuck::try_pod_read_unaligned(bytes).ok());
            if let Some(header) = header {
                self.before[service as usize].get_or_insert(header);
                self.hops.take(service, header);
            }
        }
        if topic == Topic::Event {
            self.overtaken = Some(lock(&self.said).asked);
            self.asker.unpark();
        }
        let Some((judge, fields)) = &mut self.judge else { return };
        match topic {
            Topic::Mag => {
                if let Ok(field) = bytemuck::try_pod_read_unaligned::<MagSample>(bytes) {
                    fields.push(field);
                }
            }
            Topic::Imu => {
                if let Ok(sample) = bytemuck::try_pod_read_unaligned::<ImuSample>(bytes) {
                    let found = judge.update(&sample, fields.take(sample.header.tick).as_ref());
                    self.warnings.extend(found.iter().map(|finding| finding.to_string()));
                    self.warnings.truncate(MAX_WARNINGS);
                }
            }
            _ => {}
        }
        if self.judge.as_ref().is_some_and(|(judge, _)| judge.is_finished()) {
            self.judge = None;
        }
    }

    /// The source's state has changed since the last standing, or what an event has changed is known.
    pub(crate) fn is_another(&self, state: &SourceState) -> bool {
        let is_answered = |overtaken| lock(&self.said).answered > overtaken;
        self.is_new(state) || self.overtaken.is_some_and(is_answered)
    }

    fn is_new(&self, state: &SourceState) -> bool {
        self.state.as_ref() != Some(state)
    }

    /// How it is since the last time.
    pub(crate) fn standing(&mut self, state: SourceState) -> Standing {
        let (answer, vehicles) = {
            let said = lock(&self.said);
            self.overtaken = self.overtaken.filter(|overtaken| said.answered <= *overtaken);
            (said.answer.clone(), said.vehicles.clone())
        };
        let (description, statuses) = answer.filter(|_| state == SourceState::Live).unwrap_or_default();
        let supervisor = description.supervisor_pid.map(|pid| ServiceStatus {
            service: "supervisor".into(),
            stage: None,
            state: "running".into(),
            pid: Some(pid),
            restarts: 0,
            incarnation: 0,
            epoch: 0,
            ticks: 0,
            lost: 0,
            address: None,
            diagnostics: Vec::new(),
        });
        let statuses: Vec<_> = statuses.into_iter().chain(supervisor).collect();
        let is_here = description.supervisor_pid.is_some();
        let is_due = |figures: &Figures| figures.at.elapsed() >= MIN_MEASURE_INTERVAL || self.is_new(&state);
        if self.figures.as_ref().is_none_or(is_due) {
            self.figures = Some(self.measured(statuses.iter().filter_map(|status| status.pid.filter(|_| is_here))));
        }
        let figures = self.figures.as_ref();
        let services = statuses.into_iter().map(|status| {
            let service = Service::from_name(&status.service).filter(|service| !service.is_auxiliary());
            let of_path = figures.zip(service);
            let cost = figures.zip(status.pid).and_then(|(figures, pid)| figures.costs.get(&pid));
            ServiceStanding {
                rate_hz: of_path.and_then(|(figures, service)| figures.rates_hz[service as usize]),
                latency_us: of_path.and_then(|(figures, service)| figures.latencies[service as usize]).map(latency),
                cpu_percent: cost.and_then(|cost| cost.cpu_percent),
                resident_mib: cost.map(|cost| cost.resident_mib),
                status: Some(form(status)),
            }
        });
        let services = services.collect();
        let latency_us = figures.and_then(|figures| figures.whole).map(latency);
        let (told, why) = match &state {
            SourceState::Connecting(why) => (State::Connecting, why.clone()),
            SourceState::Unselected => (State::Unchosen, String::new()),
            SourceState::Live => (State::Live, String::new()),
            SourceState::Ended(why) => (State::Ended, why.clone()),
        };
        self.state = Some(state);
        Standing {
            state: told.into(),
            why,
            system: description.system,
            source: description.source,
            rate_hz: description.rate_hz,
            version: env!("CARGO_PKG_VERSION").into(),
            services,
            latency_us,
            slots: description.slots.into_iter().map(|(slot, stages)| SlotStages { slot, stages }).collect(),
            takes_commands: self.takes_commands,
            warnings: self.warnings.clone(),
            vehicles,
            ..Standing::default()
        }
    }

    /// Measures, since the last time, the path and these processes.
    fn measured(&mut self, pids: impl Iterator<Item = u32>) -> Figures {
        self.hops.settle();
        let (latencies, whole) = self.hops.report();
        let now_ns = monotonic_ns();
        let newest = Service::PATH.map(|service| self.hops.newest(service));
        let before = std::mem::replace(&mut self.before, newest);
        Figures {
            at: Instant::now(),
            rates_hz: std::array::from_fn(|at| rate_hz(before[at], newest[at])),
            latencies,
            whole,
            costs: pids.filter_map(|pid| Some((pid, self.processes.look(pid, now_ns)?))).collect(),
        }
    }
}

/// Asks until nobody wants to know.
fn ask(desk: &dyn CommandTarget, told: &Weak<Mutex<Said>>, interval: Duration) {
    while let Some(said) = told.upgrade() {
        let question = {
            let mut said = lock(&said);
            said.asked += 1;
            said.asked
        };
        let answer = desk.description().and_then(|description| Ok((description, desk.services()?))).ok();
        let vehicles = desk.vehicles();
        {
            let mut said = lock(&said);
            (said.answer, said.vehicles, said.answered) = (answer, vehicles, question);
        }
        drop(said);
        thread::sleep(MIN_ASK_INTERVAL);
        thread::park_timeout(interval.saturating_sub(MIN_ASK_INTERVAL));
    }
}

fn lock(said: &Mutex<Said>) -> MutexGuard<'_, Said> {
    said.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Ticks per second of the senders' clock.
fn rate_hz(before: Option<Header>, now: Option<Header>) -> Option<f64> {
    let (before, now) = before.zip(now)?;
    let seconds = now.t_sent_ns.checked_sub(before.t_sent_ns)? as f64 * 1e-9;
    if now.tick <= before.tick {
        return Some(0.0);
    }
    Some((now.tick - before.tick) as f64 / seconds).filter(|rate_hz| rate_hz.is_finite())
}

fn latency(of: observe::hops::LatencyUs) -> LatencyUs {
    LatencyUs { p50: of.p50, p99: of.p99, max: of.max }
}

fn form(status: ServiceStatus) -> v1::ServiceStatus {
    let ServiceStatus { service, stage, state, pid, restarts, incarnation, epoch, ticks, lost, address: _, diagnostics: troubles } =
        status;
    let trouble = |control::Diagnostic { kind, found, remedy }| v1::Trouble { kind, found, remedy };
    let troubles = troubles.into_iter().map(trouble).collect();
    // Where a service is reached is of no use here: that of the cockpit holds the token.
    let (at, stage, pid) = (String::new(), stage.unwrap_or_default(), pid.unwrap_or_default());
    v1::ServiceStatus { service, stage, state, pid, restarts, incarnation, epoch, ticks, lost, at, troubles }
}

#[cfg(test)]
mod tests {
    use control::{SwapReport, SwapRequest};

    use super::*;

    /// A supervisor whose every decision is another one.
    #[derive(Default)]
    struct Busy {
        decisions: Mutex<u64>,
    }

    impl CommandTarget for Busy {
        fn description(&self) -> Result<SystemDescription, String> {
            Ok(SystemDescription::default())
        }

        fn services(&self) -> Result<Vec<ServiceStatus>, String> {
            let mut decisions = self.decisions.lock().unwrap();
            *decisions += 1;
            let status = format!(
                r#"{{"service":"fuser","state":"running","restarts":0,"incarnation":0,"epoch":{decisions},"ticks":0,"lost":0,"stage":null,"pid":null,"address":null,"diagnostics":[]}}"#
            );
            Ok(vec![serde_json::from_str(&status).unwrap()])
        }

        fn takes_commands(&self) -> bool {
            true
        }

        fn swap(&self, _request: SwapRequest) -> Result<SwapReport, String> {
            unreachable!("nobody swaps")
        }

        fn cancel_shadow(&self, _slot: &str) -> Result<(), String> {
            unreachable!("nobody cancels")
        }
    }

    #[test]
    fn what_an_event_has_changed_is_told_without_waiting_for_the_next_second() {
        let hour = Duration::from_secs(3600);
        let mut watch = Watch::asking(Arc::new(Busy::default()), false, hour);
        let until = |watch: &mut Watch, what: &dyn Fn(&mut Watch) -> bool| {
            let end = Instant::now() + Duration::from_secs(30);
            while !what(watch) {
                assert!(Instant::now() < end);
                thread::sleep(Duration::from_millis(5));
            }
        };
        let epoch = |watch: &mut Watch| {
            watch.standing(SourceState::Live).services.first()?.status.as_ref().map(|status| status.epoch)
        };
        until(&mut watch, &|watch| epoch(watch) == Some(1));
        assert!(!watch.is_another(&SourceState::Live));
        watch.take(Topic::Event, &[]);
        until(&mut watch, &|watch| watch.is_another(&SourceState::Live));
        assert_eq!(epoch(&mut watch), Some(2));
        assert!(!watch.is_another(&SourceState::Live), "it has been told");
    }

    #[test]
    fn a_standing_that_follows_soon_has_the_figures_of_the_one_before() {
        let mut watch = Watch::asking(Arc::new(Busy::default()), false, Duration::from_secs(3600));
        let end = Instant::now() + Duration::from_secs(30);
        while lock(&watch.said).answered == 0 {
            assert!(Instant::now() < end);
            thread::sleep(Duration::from_millis(5));
        }
        for (tick, t_sent_ns) in [(0, 0), (10, 1_000_000_000)] {
            let header = Header { tick, t_sent_ns, ..bytemuck::Zeroable::zeroed() };
            watch.take(Service::Fuser.output().unwrap(), bytemuck::bytes_of(&header));
        }
        let rates = [(); 2].map(|()| watch.standing(SourceState::Live).services[0].rate_hz);
        assert_eq!(rates, [Some(10.0); 2]);
    }
}
