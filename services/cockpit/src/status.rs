//! Status of the system: supervisor responses, rates, latencies, resource usage and input warnings.
//!
//! Input: messages of the data path, and the responses of a [`CommandTarget`].
//! Output: a status message once a second and after each event.
//! Time: CLOCK_MONOTONIC.
//! Failure: if the supervisor does not respond, the services are missing from the status.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, Weak},
    thread::{self, Thread},
    time::{Duration, Instant},
};

use control::ServiceStatus;
use graph::{Service, Topic};
use judge::{FieldQueue, InputCheck};
use messages::{Header, ImuSample, MagSample};
use observe::{
    hops::{self, HopLatencies},
    process::{ProcessMonitor, ProcessUsage},
    top::rate_hz,
};
use runtime::clock::monotonic_ns;
use wire::v1::{
    LatencyUs, Recording, ServiceReport, Setting, SlotStages, SystemStatus, VehicleLine, system_status::State,
};

use crate::{
    locked::lock,
    source::{CommandTarget, SlotDescription, SourceState, SystemDescription},
};

/// Interval between queries to the supervisor.
const QUERY_INTERVAL: Duration = Duration::from_secs(1);
/// Minimum interval between queries, however frequent the events are.
const MIN_QUERY_INTERVAL: Duration = Duration::from_millis(100);
/// Minimum interval over which rates, latencies and resource usage are measured. Measurements over
/// shorter intervals are too noisy.
const MIN_MEASURE_INTERVAL: Duration = Duration::from_millis(500);
/// Maximum number of warnings.
const MAX_WARNINGS: usize = 32;

/// Result of the newest query to the supervisor.
#[derive(Debug, Default)]
struct SupervisorReport {
    reply: Option<(SystemDescription, Vec<ServiceStatus>)>,
    vehicles: Vec<VehicleLine>,
    recording: Option<Recording>,
    /// Number of queries started.
    queries_started: u64,
    /// Sequence number of the query that returned this result.
    query: u64,
}

/// Measurements over the last interval.
struct Measurements {
    measured_at: Instant,
    rates_hz: [Option<f64>; Service::PATH.len()],
    latencies: [Option<hops::LatencyUs>; Service::PATH.len()],
    /// Latency from reception at ingest to publication of the attitude.
    end_to_end: Option<hops::LatencyUs>,
    /// Resource usage of each process on this machine, by process id.
    costs: HashMap<u32, ProcessUsage>,
}

/// Measures the data path and queries the supervisor in a separate thread.
pub(crate) struct StatusMonitor {
    report: Arc<Mutex<SupervisorReport>>,
    poller: Thread,
    /// Sequence number of the newest query that was started before the last event. Its result may
    /// be outdated. `None` once the status contains the result of a later query.
    outdated_query: Option<u64>,
    accepts_commands: bool,
    hops: HopLatencies,
    previous: [Option<Header>; Service::PATH.len()],
    processes: ProcessMonitor,
    measurements: Option<Measurements>,
    judge: Option<(InputCheck, FieldQueue)>,
    warnings: Vec<String>,
    state: Option<SourceState>,
}

impl StatusMonitor {
    /// Starts monitoring. The input is checked only if `has_every_tick` is `true`.
    pub(crate) fn new(target: Arc<dyn CommandTarget>, has_every_tick: bool) -> Self {
        Self::with_interval(target, has_every_tick, QUERY_INTERVAL)
    }

    fn with_interval(target: Arc<dyn CommandTarget>, has_every_tick: bool, interval: Duration) -> Self {
        let report = Arc::new(Mutex::<SupervisorReport>::default());
        let accepts_commands = target.accepts_commands();
        let weak_report = Arc::downgrade(&report);
        let poller = thread::spawn(move || poll_supervisor(&*target, &weak_report, interval)).thread().clone();
        Self {
            report,
            poller,
            outdated_query: None,
            accepts_commands,
            hops: HopLatencies::default(),
            previous: [None; Service::PATH.len()],
            processes: ProcessMonitor::default(),
            measurements: None,
            judge: has_every_tick.then(Default::default),
            warnings: Vec::new(),
            state: None,
        }
    }

    /// Adds a message of `topic`. An event triggers a query to the supervisor.
    pub(crate) fn push(&mut self, topic: Topic, bytes: &[u8]) {
        if let Some(service) = Service::PATH.into_iter().find(|service| service.output() == Some(topic)) {
            // Every message of the data path starts with its header.
            let header =
                bytes.get(..size_of::<Header>()).and_then(|bytes| bytemuck::try_pod_read_unaligned(bytes).ok());
            if let Some(header) = header {
                self.previous[service as usize].get_or_insert(header);
                self.hops.record(service, header);
            }
        }
        if topic == Topic::Event {
            self.outdated_query = Some(lock(&self.report).queries_started);
            self.poller.unpark();
        }
        let Some((judge, fields)) = &mut self.judge else { return };
        if topic == Topic::Mag
            && let Ok(field) = bytemuck::try_pod_read_unaligned::<MagSample>(bytes)
        {
            fields.push(field);
        }
        if topic == Topic::Imu
            && let Ok(sample) = bytemuck::try_pod_read_unaligned::<ImuSample>(bytes)
        {
            let found = judge.update(&sample, fields.take(sample.header.tick).as_ref());
            self.warnings.extend(found.iter().map(|finding| finding.to_string()));
            self.warnings.truncate(MAX_WARNINGS);
        }
        if self.judge.as_ref().is_some_and(|(judge, _)| judge.is_finished()) {
            self.judge = None;
        }
    }

    /// Returns `true` if the source's state has changed since the last status, or if a query that
    /// was started after the last event has completed.
    pub(crate) fn has_changed(&self, state: &SourceState) -> bool {
        let is_newer = |outdated| lock(&self.report).query > outdated;
        self.is_new_state(state) || self.outdated_query.is_some_and(is_newer)
    }

    fn is_new_state(&self, state: &SourceState) -> bool {
        self.state.as_ref() != Some(state)
    }

    /// Returns the current status. Its measurements cover the time since the previous measurements.
    pub(crate) fn status(&mut self, state: SourceState) -> SystemStatus {
        let (reply, vehicles, recording) = {
            let report = lock(&self.report);
            self.outdated_query = self.outdated_query.filter(|outdated| report.query <= *outdated);
            (report.reply.clone(), report.vehicles.clone(), report.recording.clone())
        };
        let (description, statuses) = reply.filter(|_| state == SourceState::Live).unwrap_or_default();
        let supervisor = description.supervisor_pid.map(|pid| ServiceStatus {
            service: "supervisor".into(),
            state: "running".into(),
            pid: Some(pid),
            ..ServiceStatus::default()
        });
        let statuses: Vec<_> = statuses.into_iter().chain(supervisor).collect();
        let is_local = description.supervisor_pid.is_some();
        let is_due = |measurements: &Measurements| {
            measurements.measured_at.elapsed() >= MIN_MEASURE_INTERVAL || self.is_new_state(&state)
        };
        if self.measurements.as_ref().is_none_or(is_due) {
            self.measurements =
                Some(self.measure(statuses.iter().filter_map(|status| status.pid.filter(|_| is_local))));
        }
        let measurements = self.measurements.as_ref();
        let services = statuses.into_iter().map(|status| {
            let service = Service::from_name(status.service.raw()).filter(|service| !service.is_auxiliary());
            let path_measurements = measurements.zip(service);
            let usage = measurements.zip(status.pid).and_then(|(measurements, pid)| measurements.costs.get(&pid));
            ServiceReport {
                rate_hz: path_measurements.and_then(|(measurements, service)| measurements.rates_hz[service as usize]),
                latency_us: path_measurements
                    .and_then(|(measurements, service)| measurements.latencies[service as usize])
                    .map(latency),
                cpu_percent: usage.and_then(|usage| usage.cpu_percent),
                resident_mib: usage.map(|cost| cost.resident_mib),
                // The address of the cockpit contains the operator's token and must not reach the
                // viewers.
                status: Some(ServiceStatus { address: None, ..status }.into()),
            }
        });
        let services = services.collect();
        let latency_us = measurements.and_then(|measurements| measurements.end_to_end).map(latency);
        let (wire_state, reason) = match &state {
            SourceState::Connecting(reason) => (State::Connecting, reason.clone()),
            SourceState::Unselected => (State::Unselected, String::new()),
            SourceState::Live => (State::Live, String::new()),
            SourceState::Ended(reason) => (State::Ended, reason.clone()),
        };
        self.state = Some(state);
        SystemStatus {
            state: wire_state.into(),
            reason,
            system: description.system,
            source: description.source,
            rate_hz: description.rate_hz,
            version: env!("CARGO_PKG_VERSION").into(),
            services,
            latency_us,
            slots: description.slots.into_iter().map(slot_stages).collect(),
            accepts_commands: self.accepts_commands,
            warnings: self.warnings.clone(),
            vehicles,
            recording,
            ..SystemStatus::default()
        }
    }

    /// Measures the data path and the processes over the interval since the previous call.
    fn measure(&mut self, pids: impl Iterator<Item = u32>) -> Measurements {
        self.hops.process_pending();
        let (latencies, end_to_end) = self.hops.take_latencies();
        let now_ns = monotonic_ns();
        let newest = Service::PATH.map(|service| self.hops.newest(service));
        let previous = std::mem::replace(&mut self.previous, newest);
        Measurements {
            measured_at: Instant::now(),
            rates_hz: std::array::from_fn(|at| rate_hz(previous[at], newest[at])),
            latencies,
            end_to_end,
            costs: pids.filter_map(|pid| Some((pid, self.processes.sample(pid, now_ns)?))).collect(),
        }
    }
}

/// Queries the supervisor until the monitor is dropped.
fn poll_supervisor(target: &dyn CommandTarget, weak_report: &Weak<Mutex<SupervisorReport>>, interval: Duration) {
    while let Some(report) = weak_report.upgrade() {
        let query = {
            let mut report = lock(&report);
            report.queries_started += 1;
            report.queries_started
        };
        let reply = target.description().and_then(|description| Ok((description, target.services()?))).ok();
        let (vehicles, recording) = (target.vehicles(), target.recording());
        {
            let mut report = lock(&report);
            *report = SupervisorReport { reply, vehicles, recording, query, ..*report };
        }
        drop(report);
        thread::sleep(MIN_QUERY_INTERVAL);
        thread::park_timeout(interval.saturating_sub(MIN_QUERY_INTERVAL));
    }
}

fn slot_stages(SlotDescription { slot, stages, set }: SlotDescription) -> SlotStages {
    let is_set_known = set.is_some();
    let set = set.into_iter().flatten().map(|(name, value)| Setting { name, value }).collect();
    SlotStages { slot, stages, set, is_set_known }
}

fn latency(latency: observe::hops::LatencyUs) -> LatencyUs {
    LatencyUs { p50: latency.p50, p99: latency.p99, max: latency.max }
}

#[cfg(test)]
mod tests {
    use control::{SwapReport, SwapRequest};

    use super::*;

    /// Supervisor that reports a new epoch of the fuser at each query.
    #[derive(Default)]
    struct CountingSupervisor {
        queries: Mutex<u64>,
    }

    impl CommandTarget for CountingSupervisor {
        fn description(&self) -> Result<SystemDescription, String> {
            Ok(SystemDescription::default())
        }

        fn services(&self) -> Result<Vec<ServiceStatus>, String> {
            let mut queries = self.queries.lock().unwrap();
            *queries += 1;
            let status = format!(
                r#"{{"service":"fuser","state":"running","restarts":0,"incarnation":0,"epoch":{queries},"ticks":0,"lost":0,"stage":null,"pid":null,"address":null,"diagnostics":[]}}"#
            );
            Ok(vec![serde_json::from_str(&status).unwrap()])
        }

        fn accepts_commands(&self) -> bool {
            true
        }

        fn swap(&self, _request: SwapRequest) -> Result<SwapReport, String> {
            unreachable!("the tests request no swap")
        }

        fn cancel_shadow(&self, _slot: &str) -> Result<(), String> {
            unreachable!("the tests cancel no shadow")
        }
    }

    #[test]
    fn event_triggers_query_without_waiting() {
        let hour = Duration::from_secs(3600);
        let mut monitor = StatusMonitor::with_interval(Arc::new(CountingSupervisor::default()), false, hour);
        let until = |monitor: &mut StatusMonitor, condition: &dyn Fn(&mut StatusMonitor) -> bool| {
            let end = Instant::now() + Duration::from_secs(30);
            while !condition(monitor) {
                assert!(Instant::now() < end);
                thread::sleep(Duration::from_millis(5));
            }
        };
        let epoch = |monitor: &mut StatusMonitor| {
            monitor.status(SourceState::Live).services.first()?.status.as_ref().map(|status| status.epoch)
        };
        until(&mut monitor, &|monitor| epoch(monitor) == Some(1));
        assert!(!monitor.has_changed(&SourceState::Live));
        monitor.push(Topic::Event, &[]);
        until(&mut monitor, &|monitor| monitor.has_changed(&SourceState::Live));
        assert_eq!(epoch(&mut monitor), Some(2));
        assert!(!monitor.has_changed(&SourceState::Live), "the status is up to date");
    }

    #[test]
    fn status_within_minimum_interval_keeps_measurements() {
        let mut monitor =
            StatusMonitor::with_interval(Arc::new(CountingSupervisor::default()), false, Duration::from_secs(3600));
        let end = Instant::now() + Duration::from_secs(30);
        while lock(&monitor.report).query == 0 {
            assert!(Instant::now() < end);
            thread::sleep(Duration::from_millis(5));
        }
        for (tick, t_sent_ns) in [(0, 0), (10, 1_000_000_000)] {
            let header = Header { tick, t_sent_ns, ..bytemuck::Zeroable::zeroed() };
            monitor.push(Service::Fuser.output().unwrap(), bytemuck::bytes_of(&header));
        }
        let rates = [(); 2].map(|()| monitor.status(SourceState::Live).services[0].rate_hz);
        assert_eq!(rates, [Some(10.0); 2]);
    }
}
