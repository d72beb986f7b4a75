//! Live state, rate, latency and resource usage of the services.

use bus::{BusError, Observer, Tap};
use control::ServiceStatus;
use foreign::ForeignText;
use graph::Topic;
use launch::Service;
use messages::{AttitudeOutput, EventKind, Header, SystemEvent};
use runtime::clock::monotonic_ns;
use serde::Serialize;

use crate::{
    hops::{HopLatencies, LatencyUs},
    process::ProcessMonitor,
};

/// Monitors the data path of a running system.
#[derive(Debug)]
pub struct SystemMonitor {
    /// Taps in reverse path order. An output is read before the inputs of its service, so the
    /// inputs of every output that was read are available too.
    taps: Vec<(Service, Tap)>,
    events: Tap,
    hops: HopLatencies,
    attitude: Option<AttitudeOutput>,
    finished_event: Option<SystemEvent>,
    processes: ProcessMonitor,
    /// Header of each service's newest output at the last snapshot. Until the first snapshot, it is
    /// the header of the service's first output.
    previous: [Option<Header>; Service::PATH.len()],
    owner_pid: u32,
}

/// State of a system at one time.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SystemSnapshot {
    /// Name of the system.
    pub system: String,
    /// Newest tick with an attitude.
    pub tick: Option<u64>,
    /// Latency from the reception of a sample to the publication of its attitude, since the last
    /// snapshot.
    pub latency_us: Option<LatencyUs>,
    /// Services and the supervisor.
    pub services: Vec<ServiceRow>,
}

/// State of a service or the supervisor.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ServiceRow {
    /// Name of the service, or `supervisor`.
    pub service: ForeignText,
    /// Stage in the service's slot.
    pub stage: Option<ForeignText>,
    /// Name of the service's state, as reported by the supervisor.
    pub state: ForeignText,
    /// Process ID, if any.
    pub pid: Option<u32>,
    /// Ticks published per second since the last snapshot.
    pub rate_hz: Option<f64>,
    /// Latency from the last input to the output, since the last snapshot.
    pub latency_us: Option<LatencyUs>,
    /// Ticks that never reached the service.
    pub lost: u64,
    /// Number of restarts.
    pub restarts: u32,
    /// Epoch of the ownership decision that the service follows.
    pub epoch: u32,
    /// CPU time since the last snapshot as a share of one core, %.
    pub cpu_percent: Option<f64>,
    /// Resident memory, MiB.
    pub resident_mib: Option<f64>,
}

impl SystemMonitor {
    /// Opens the topics. CPU usage is measured from this call on.
    ///
    /// # Errors
    ///
    /// Returns an error if a topic cannot be opened.
    pub fn new(observer: &Observer, statuses: &[ServiceStatus]) -> Result<Self, BusError> {
        let (mut processes, owner_pid) = (ProcessMonitor::default(), observer.owner_pid());
        for pid in statuses.iter().filter_map(|status| status.pid).chain([owner_pid]) {
            processes.sample(pid, monotonic_ns());
        }
        let outputs = Service::PATH.into_iter().rev().filter_map(|service| Some((service, service.output()?)));
        let taps = outputs.map(|(service, topic)| Ok((service, observer.tap(topic)?)));
        Ok(Self {
            taps: taps.collect::<Result<_, BusError>>()?,
            events: observer.tap(Topic::Event)?,
            hops: HopLatencies::default(),
            attitude: None,
            finished_event: None,
            processes,
            previous: [None; Service::PATH.len()],
            owner_pid,
        })
    }

    /// Reads new messages. Call this several times per second; otherwise the observer misses
    /// messages.
    ///
    /// # Errors
    ///
    /// Returns an error if a topic cannot be read.
    pub fn poll(&mut self) -> Result<(), BusError> {
        for (service, tap) in &self.taps {
            tap.drain(&mut |bytes| {
                // Every message of the data path starts with its header.
                let header = bytes.get(..size_of::<Header>());
                if let Some(header) = header.and_then(|header| bytemuck::try_pod_read_unaligned(header).ok()) {
                    self.previous[*service as usize].get_or_insert(header);
                    self.hops.record(*service, header);
                }
                if *service == Service::Course {
                    self.attitude = bytemuck::try_pod_read_unaligned(bytes).ok().or(self.attitude);
                }
            })?;
        }
        self.events.drain(&mut |bytes| {
            let event = bytemuck::try_pod_read_unaligned(bytes).ok();
            self.finished_event =
                event.filter(|event: &SystemEvent| event.kind == EventKind::FINISHED).or(self.finished_event);
        })?;
        self.hops.process_pending();
        Ok(())
    }

    /// Returns the newest attitude, in the native frame.
    pub fn attitude(&self) -> Option<&AttitudeOutput> {
        self.attitude.as_ref()
    }

    /// Returns the reason why the system ended, or `None` until its supervisor reports the end.
    pub fn end_reason(&self) -> Option<&str> {
        self.finished_event
            .as_ref()
            .map(|event| if event.reason().is_empty() { "it ended normally" } else { event.reason() })
    }

    /// Returns the state of the system, combined with the supervisor's service status. Rates and
    /// latencies cover the time since the last snapshot.
    pub fn snapshot(&mut self, system: &str, statuses: &[ServiceStatus]) -> SystemSnapshot {
        let (latencies, end_to_end) = self.hops.take_latencies();
        let now_ns = monotonic_ns();
        let mut services: Vec<_> = statuses
            .iter()
            .map(|status| {
                let service = Service::from_name(status.service.raw()).filter(|service| !service.is_auxiliary());
                let usage = status.pid.and_then(|pid| self.processes.sample(pid, now_ns));
                ServiceRow {
                    service: status.service.clone(),
                    stage: status.stage.clone(),
                    state: status.state.clone(),
                    pid: status.pid,
                    rate_hz: service
                        .and_then(|service| rate_hz(self.previous[service as usize], self.hops.newest(service))),
                    latency_us: service.and_then(|service| latencies[service as usize]),
                    lost: status.lost,
                    restarts: status.restarts,
                    epoch: status.epoch,
                    cpu_percent: usage.and_then(|cost| cost.cpu_percent),
                    resident_mib: usage.map(|cost| cost.resident_mib),
                }
            })
            .collect();
        services.push(self.supervisor_row(now_ns));
        self.previous = Service::PATH.map(|service| self.hops.newest(service));
        let tick = self.hops.newest(Service::Course).map(|header| header.tick);
        SystemSnapshot { system: system.into(), tick, latency_us: end_to_end, services }
    }

    fn supervisor_row(&mut self, now_ns: u64) -> ServiceRow {
        let usage = self.processes.sample(self.owner_pid, now_ns);
        ServiceRow {
            service: "supervisor".into(),
            stage: None,
            state: if usage.is_some() { "running" } else { "exited" }.into(),
            pid: Some(self.owner_pid),
            rate_hz: None,
            latency_us: None,
            lost: 0,
            restarts: 0,
            epoch: 0,
            cpu_percent: usage.and_then(|cost| cost.cpu_percent),
            resident_mib: usage.map(|cost| cost.resident_mib),
        }
    }
}

/// Returns the number of ticks per second between two outputs of a service, measured by the
/// publisher's clock. Messages that the observer missed have no effect.
///
/// The rate is 0 without a new tick, for example while a restarted service repeats earlier ticks.
/// Returns `None` if an output is missing or if the clock has not advanced.
pub fn rate_hz(previous: Option<Header>, current: Option<Header>) -> Option<f64> {
    let (before, now) = previous.zip(current)?;
    let seconds = now.t_sent_ns.checked_sub(before.t_sent_ns)? as f64 * 1e-9;
    let ticks = now.tick.saturating_sub(before.tick);
    if ticks == 0 {
        return Some(0.0);
    }
    Some(ticks as f64 / seconds).filter(|rate_hz| rate_hz.is_finite())
}

impl SystemSnapshot {
    /// Returns a text table at most `columns` characters wide. The least important table columns
    /// are left out first.
    pub fn table(&self, columns: Option<usize>) -> String {
        let visible = visible_columns(columns);
        let tick = self.tick.map_or("-".into(), |tick| tick.to_string());
        let title =
            format!("{}: tick {tick}; latency in µs, per service from its last input to its output", self.system);
        let lines =
            [COLUMNS.map(|column| column.header.into())].into_iter().chain(self.services.iter().map(ServiceRow::cells));
        let lines = lines.map(|cells| format_row(&visible, &cells));
        let label_width: usize = visible
            .iter()
            .map(|i| &COLUMNS[*i])
            .take_while(|column| !column.is_latency())
            .map(|column| column.width)
            .sum();
        let latencies: Vec<_> = visible.iter().copied().filter(|i| COLUMNS[*i].is_latency()).collect();
        let end_to_end =
            format!("{:<label_width$}{}", "end to end", format_row(&latencies, &latency_cells(self.latency_us)));
        [title].into_iter().chain(lines).chain([end_to_end]).collect::<Vec<_>>().join("\n")
    }
}

/// Column of the table.
struct Column {
    header: &'static str,
    width: usize,
    /// Order in which columns are omitted if the terminal is too narrow. The column with the
    /// highest value is omitted first. A column with the value 0 is never omitted.
    drop_order: u8,
}

/// Columns of the table. They fit into a terminal 121 characters wide, or 80 without the three
/// columns that are omitted first.
const COLUMNS: [Column; 13] = [
    Column { header: "service", width: 11, drop_order: 0 },
    Column { header: "stage", width: 25, drop_order: 10 },
    Column { header: "state", width: 9, drop_order: 0 },
    Column { header: "pid", width: 8, drop_order: 3 },
    Column { header: "Hz", width: 8, drop_order: 1 },
    Column { header: "p50", width: 8, drop_order: 5 },
    Column { header: "p99", width: 8, drop_order: 0 },
    Column { header: "max", width: 8, drop_order: 4 },
    Column { header: "lost", width: 6, drop_order: 2 },
    Column { header: "restarts", width: 9, drop_order: 8 },
    Column { header: "epoch", width: 6, drop_order: 9 },
    Column { header: "cpu %", width: 7, drop_order: 6 },
    Column { header: "MiB", width: 7, drop_order: 7 },
];

impl Column {
    fn is_latency(&self) -> bool {
        ["p50", "p99", "max"].contains(&self.header)
    }
}

/// Returns the indices of the table columns that fit into a terminal `columns` characters wide.
fn visible_columns(columns: Option<usize>) -> Vec<usize> {
    let mut visible: Vec<_> = (0..COLUMNS.len()).collect();
    while columns.is_some_and(|columns| visible.iter().map(|i| COLUMNS[*i].width).sum::<usize>() > columns) {
        match visible.iter().copied().max_by_key(|i| COLUMNS[*i].drop_order).filter(|i| COLUMNS[*i].drop_order > 0) {
            Some(first_dropped) => visible.retain(|i| *i != first_dropped),
            None => break,
        }
    }
    visible
}

/// Formats a row of the table: text is left-aligned, numbers are right-aligned.
fn format_row(visible: &[usize], cells: &[String; COLUMNS.len()]) -> String {
    let cell = |i: &usize| match (COLUMNS[*i].width, &cells[*i]) {
        (width, cell) if *i < 3 => format!("{cell:<width$}"),
        (width, cell) => format!("{cell:>width$}"),
    };
    visible.iter().map(cell).collect()
}

/// Returns the cells of a row in which only the latencies are filled in.
fn latency_cells(latency: Option<LatencyUs>) -> [String; COLUMNS.len()] {
    let us = latency.map(|LatencyUs { p50, p99, max }| [p50, p99, max]);
    std::array::from_fn(|i| match (i, us) {
        (5..8, Some(us)) => format!("{:.0}", us[i - 5]),
        (5..8, None) => "-".into(),
        _ => String::new(),
    })
}

impl ServiceRow {
    fn cells(&self) -> [String; COLUMNS.len()] {
        let Self { service, stage, state, pid, lost, restarts, epoch, .. } = self;
        let [rate, cpu, mib] = [self.rate_hz, self.cpu_percent, self.resident_mib]
            .map(|number| number.map_or("-".into(), |number| format!("{number:.1}")));
        let stage = stage.as_ref().map_or("-".into(), ToString::to_string);
        let numbers = [lost.to_string(), restarts.to_string(), epoch.to_string(), cpu, mib];
        let mut cells = latency_cells(self.latency_us);
        let pid = pid.map_or("-".into(), |pid| pid.to_string());
        cells[..5].clone_from_slice(&[service.to_string(), stage, state.to_string(), pid, rate]);
        cells[8..].clone_from_slice(&numbers);
        cells
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(tick: u64, t_sent_ns: u64) -> Option<Header> {
        Some(Header { tick, t_sent_ns, ..bytemuck::Zeroable::zeroed() })
    }

    #[test]
    fn rate_uses_ticks_and_publisher_clock() {
        assert_eq!(rate_hz(header(10, 0), header(510, 500_000_000)), Some(1000.0));
        assert_eq!(
            rate_hz(header(10, 5), header(10, 5)),
            Some(0.0),
            "a stalled service has a rate of 0, not an unknown one"
        );
        assert_eq!(rate_hz(None, header(10, 5)), None);
    }

    #[test]
    fn rate_is_zero_if_tick_goes_back_and_unknown_if_clock_does() {
        assert_eq!(rate_hz(header(510, 0), header(10, 500_000_000)), Some(0.0));
        assert_eq!(rate_hz(header(10, 500_000_000), header(510, 0)), None);
        assert_eq!(rate_hz(header(10, 5), header(510, 5)), None, "no time has passed");
    }

    fn example_snapshot() -> SystemSnapshot {
        let latency_us = Some(LatencyUs { p50: 1234.0, p99: 12345.0, max: 1234567.0 });
        let row = |service: &str| ServiceRow {
            service: service.into(),
            stage: Some("inclinometer-quaternion".into()),
            state: "starting".into(),
            pid: Some(4_194_304),
            rate_hz: Some(10_000.0),
            latency_us,
            lost: 12_345,
            restarts: 100,
            epoch: 1000,
            cpu_percent: Some(100.0),
            resident_mib: Some(1000.5),
        };
        let services = ["ingest", "supervisor"].map(row).into();
        SystemSnapshot { system: "plumbline".into(), tick: Some(1_234_567), latency_us, services }
    }

    fn words(line: &str) -> Vec<&str> {
        line.split_whitespace().collect()
    }

    #[test]
    fn table_fits_terminal_width_with_separate_columns() {
        for columns in 28..140 {
            let table = example_snapshot().table(Some(columns));
            let lines: Vec<_> = table.lines().skip(1).collect();
            assert!(lines.iter().all(|line| line.chars().count() <= columns), "{columns} columns:\n{table}");
            let header_count = words(&lines[0].replace("cpu %", "cpu")).len();
            assert_eq!(
                [lines[1], lines[2]].map(|line| words(line).len()),
                [header_count; 2],
                "{columns} columns:\n{table}"
            );
        }
        assert_eq!(example_snapshot().table(None), example_snapshot().table(Some(121)));
        let table_80 = example_snapshot().table(Some(80));
        let header: Vec<_> = words(table_80.lines().nth(1).unwrap());
        assert_eq!(header.join(" "), "service state pid Hz p50 p99 max lost cpu % MiB");
        assert_eq!(words(table_80.lines().nth(3).unwrap())[4..7], ["1234", "12345", "1234567"]);
        let (above, end_to_end) = (table_80.lines().nth(3).unwrap(), table_80.lines().nth(4).unwrap());
        assert_eq!(end_to_end.find("1234567"), above.find("1234567"), "{table_80}");
    }
}
