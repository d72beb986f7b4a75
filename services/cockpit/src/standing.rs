//! How the system is, once a second: what its supervisor says, with rates, latencies, costs and the judge's warnings.

use std::{
    sync::{Arc, Mutex, PoisonError, Weak},
    thread,
    time::Duration,
};

use control::ServiceStatus;
use graph::{Service, Topic};
use judge::{Fields, Judge};
use messages::{Header, ImuSample, MagSample};
use observe::{hops::Hops, process::Processes};
use runtime::clock::monotonic_ns;
use wire::v1::{self, LatencyUs, ServiceStanding, SlotStages, Standing, VehicleLine, standing::State};

use crate::source::{Description, Desk, SourceState};

/// Between two questions to the supervisor.
const ASK_INTERVAL: Duration = Duration::from_secs(1);
/// Warnings at most.
const WARNINGS_MAX: usize = 32;

/// What the supervisor said last.
#[derive(Debug, Default)]
struct Said {
    answer: Option<(Description, Vec<ServiceStatus>)>,
    vehicles: Vec<VehicleLine>,
}

/// Watches the path, and has the supervisor asked.
pub(crate) struct Watch {
    said: Arc<Mutex<Said>>,
    takes_commands: bool,
    hops: Hops,
    before: [Option<Header>; Service::PATH.len()],
    processes: Processes,
    judge: Option<(Judge, Fields)>,
    warnings: Vec<String>,
    state: Option<SourceState>,
}

impl Watch {
    /// `has_every_tick`: what comes can be judged.
    pub(crate) fn new(desk: Arc<dyn Desk>, has_every_tick: bool) -> Self {
        let said = Arc::new(Mutex::<Said>::default());
        let takes_commands = desk.takes_commands();
        let told = Arc::downgrade(&said);
        thread::spawn(move || ask(&*desk, &told));
        Self {
            said,
            takes_commands,
            hops: Hops::default(),
            before: [None; Service::PATH.len()],
            processes: Processes::default(),
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
        let Some((judge, fields)) = &mut self.judge else { return };
        match topic {
            Topic::Mag => {
                if let Ok(field) = bytemuck::try_pod_read_unaligned::<MagSample>(bytes) {
                    fields.push(field);
                }
            }
            Topic::Imu => {
                if let Ok(sample) = bytemuck::try_pod_read_unaligned::<ImuSample>(bytes) {
                    let found = judge.take(&sample, fields.of(sample.header.tick).as_ref());
                    self.warnings.extend(found.iter().map(|finding| finding.to_string()));
                    self.warnings.truncate(WARNINGS_MAX);
                }
            }
            _ => {}
        }
        if self.judge.as_ref().is_some_and(|(judge, _)| judge.is_ended()) {
            self.judge = None;
        }
    }

    /// The source's state has changed since the last standing.
    pub(crate) fn is_another(&self, state: &SourceState) -> bool {
        self.state.as_ref() != Some(state)
    }

    /// How it is since the last time.
    pub(crate) fn standing(&mut self, state: SourceState) -> Standing {
        self.hops.settle();
        let (latencies, whole) = self.hops.report();
        let (answer, vehicles) = {
            let said = self.said.lock().unwrap_or_else(PoisonError::into_inner);
            (said.answer.clone(), said.vehicles.clone())
        };
        let (description, statuses) = answer.filter(|_| state == SourceState::Live).unwrap_or_default();
        let now_ns = monotonic_ns();
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
            at: None,
            troubles: Vec::new(),
        });
        let services = statuses.into_iter().chain(supervisor).map(|status| {
            let service = Service::named(&status.service).filter(|service| !service.is_beside());
            let is_here = description.supervisor_pid.is_some();
            let cost = status.pid.filter(|_| is_here).and_then(|pid| self.processes.look(pid, now_ns));
            ServiceStanding {
                rate_hz: service.and_then(|service| rate_hz(self.before[service as usize], self.hops.newest(service))),
                latency_us: service.and_then(|service| latencies[service as usize]).map(latency),
                cpu_percent: cost.and_then(|cost| cost.cpu_percent),
                resident_mib: cost.map(|cost| cost.resident_mib),
                status: Some(form(status)),
            }
        });
        let services = services.collect();
        self.before = Service::PATH.map(|service| self.hops.newest(service));
        let (told, why) = match &state {
            SourceState::Connecting(why) => (State::Connecting, why.clone()),
            SourceState::Unchosen => (State::Unchosen, String::new()),
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
            latency_us: whole.map(latency),
            slots: description.slots.into_iter().map(|(slot, stages)| SlotStages { slot, stages }).collect(),
            takes_commands: self.takes_commands,
            warnings: self.warnings.clone(),
            vehicles,
            ..Standing::default()
        }
    }
}

/// Asks until nobody wants to know.
fn ask(desk: &dyn Desk, told: &Weak<Mutex<Said>>) {
    while let Some(said) = told.upgrade() {
        let answer = desk.description().and_then(|description| Ok((description, desk.services()?)));
        *said.lock().unwrap_or_else(PoisonError::into_inner) = Said { answer: answer.ok(), vehicles: desk.vehicles() };
        drop(said);
        thread::sleep(ASK_INTERVAL);
    }
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
    let ServiceStatus { service, stage, state, pid, restarts, incarnation, epoch, ticks, lost, at: _, troubles } =
        status;
    let trouble = |control::Trouble { kind, found, remedy }| v1::Trouble { kind, found, remedy };
    let troubles = troubles.into_iter().map(trouble).collect();
    // Where a service is reached is of no use here: that of the cockpit holds the token.
    let (at, stage, pid) = (String::new(), stage.unwrap_or_default(), pid.unwrap_or_default());
    v1::ServiceStatus { service, stage, state, pid, restarts, incarnation, epoch, ticks, lost, at, troubles }
}
