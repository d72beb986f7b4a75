//! How the services of a running system do, from moment to moment.

use bus::{BusError, Observer, Tap};
use control::ServiceStatus;
use graph::Topic;
use launch::Service;
use messages::{AttitudeOutput, EventKind, Header, SystemEvent};
use runtime::clock::monotonic_ns;
use serde::Serialize;

use crate::{
    hops::{Hops, LatencyUs},
    process::Processes,
};

/// Watches the path of a system.
#[derive(Debug)]
pub struct Top {
    /// From the end of the path to its beginning: an output is read before what it was made of, so that no input is missed.
    taps: Vec<(Service, Tap)>,
    events: Tap,
    hops: Hops,
    attitude: Option<AttitudeOutput>,
    end: Option<SystemEvent>,
    processes: Processes,
    /// The newest of each service at the last moment; at first, the first that came.
    before: [Option<Header>; Service::PATH.len()],
    owner_pid: u32,
}

/// A moment of a system.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Moment {
    /// The system's name.
    pub system: String,
    /// The newest tick with an attitude.
    pub tick: Option<u64>,
    /// From birth at ingest to publication of the attitude, since the last moment.
    pub latency_us: Option<LatencyUs>,
    /// The services and their supervisor.
    pub services: Vec<Row>,
}

/// A process of a system.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Its name.
    pub service: String,
    /// What fills its slot.
    pub stage: Option<String>,
    /// What it does, in a word.
    pub state: String,
    /// Its process, where there is one.
    pub pid: Option<u32>,
    /// Ticks published per second since the last moment.
    pub rate_hz: Option<f64>,
    /// From its last input to its output, since the last moment.
    pub latency_us: Option<LatencyUs>,
    /// Ticks that never came to it.
    pub lost: u64,
    /// Times it was started again.
    pub restarts: u32,
    /// The decision about its slot that it follows.
    pub epoch: u32,
    /// Share of one core since the last moment, %.
    pub cpu_percent: Option<f64>,
    /// Resident memory, MiB.
    pub resident_mib: Option<f64>,
}

impl Top {
    /// Begins to watch; the costs of the processes count from here.
    pub fn new(observer: &Observer, statuses: &[ServiceStatus]) -> Result<Self, BusError> {
        let (mut processes, owner_pid) = (Processes::default(), observer.owner_pid());
        for pid in statuses.iter().filter_map(|status| status.pid).chain([owner_pid]) {
            processes.look(pid, monotonic_ns());
        }
        let outputs = Service::PATH.into_iter().rev().filter_map(|service| Some((service, service.output()?)));
        let taps = outputs.map(|(service, topic)| Ok((service, observer.tap(topic)?)));
        Ok(Self {
            taps: taps.collect::<Result<_, BusError>>()?,
            events: observer.tap(Topic::Event)?,
            hops: Hops::default(),
            attitude: None,
            end: None,
            processes,
            before: [None; Service::PATH.len()],
            owner_pid,
        })
    }

    /// Takes what has been published; several times a second, or messages are missed here.
    pub fn look(&mut self) -> Result<(), BusError> {
        for (service, tap) in &self.taps {
            tap.drain(&mut |bytes| {
                // Every message of the path begins with its header.
                let header = bytes.get(..size_of::<Header>());
                if let Some(header) = header.and_then(|header| bytemuck::try_pod_read_unaligned(header).ok()) {
                    self.before[*service as usize].get_or_insert(header);
                    self.hops.take(*service, header);
                }
                if *service == Service::Course {
                    self.attitude = bytemuck::try_pod_read_unaligned(bytes).ok().or(self.attitude);
                }
            })?;
        }
        self.events.drain(&mut |bytes| {
            let event = bytemuck::try_pod_read_unaligned(bytes).ok();
            self.end = event.filter(|event: &SystemEvent| event.kind == EventKind::FINISHED).or(self.end);
        })?;
        self.hops.settle();
        Ok(())
    }

    /// The newest attitude, in our frames.
    pub fn attitude(&self) -> Option<&AttitudeOutput> {
        self.attitude.as_ref()
    }

    /// What ended the system before its time, or that it came to its end; `None` until its supervisor says so.
    pub fn end(&self) -> Option<&str> {
        self.end.as_ref().map(|event| if event.reason().is_empty() { "it came to its end" } else { event.reason() })
    }

    /// What was seen since the last moment, with what the supervisor says.
    pub fn moment(&mut self, system: &str, statuses: &[ServiceStatus]) -> Moment {
        let (latencies, whole) = self.hops.report();
        let now_ns = monotonic_ns();
        let mut services: Vec<_> = statuses
            .iter()
            .map(|status| {
                let service = Service::from_name(&status.service).filter(|service| !service.is_auxiliary());
                let cost = status.pid.and_then(|pid| self.processes.look(pid, now_ns));
                Row {
                    service: status.service.clone(),
                    stage: status.stage.clone(),
                    state: status.state.clone(),
                    pid: status.pid,
                    rate_hz: service
                        .and_then(|service| rate_hz(self.before[service as usize], self.hops.newest(service))),
                    latency_us: service.and_then(|service| latencies[service as usize]),
                    lost: status.lost,
                    restarts: status.restarts,
                    epoch: status.epoch,
                    cpu_percent: cost.and_then(|cost| cost.cpu_percent),
                    resident_mib: cost.map(|cost| cost.resident_mib),
                }
            })
            .collect();
        services.push(self.supervisor(now_ns));
        self.before = Service::PATH.map(|service| self.hops.newest(service));
        let tick = self.hops.newest(Service::Course).map(|header| header.tick);
        Moment { system: system.into(), tick, latency_us: whole, services }
    }

    fn supervisor(&mut self, now_ns: u64) -> Row {
        let cost = self.processes.look(self.owner_pid, now_ns);
        Row {
            service: "supervisor".into(),
            stage: None,
            state: if cost.is_some() { "running" } else { "gone" }.into(),
            pid: Some(self.owner_pid),
            rate_hz: None,
            latency_us: None,
            lost: 0,
            restarts: 0,
            epoch: 0,
            cpu_percent: cost.and_then(|cost| cost.cpu_percent),
            resident_mib: cost.map(|cost| cost.resident_mib),
        }
    }
}

/// Ticks per second of the senders' clock: what this observer missed does not count.
fn rate_hz(before: Option<Header>, now: Option<Header>) -> Option<f64> {
    let (before, now) = before.zip(now)?;
    if now.tick == before.tick {
        return Some(0.0);
    }
    let seconds = now.t_sent_ns.checked_sub(before.t_sent_ns)? as f64 * 1e-9;
    Some((now.tick - before.tick) as f64 / seconds).filter(|rate_hz| rate_hz.is_finite())
}

impl Moment {
    /// A table for people, no wider than so many columns of a terminal: what is needed least is left out first.
    pub fn table(&self, columns: Option<usize>) -> String {
        let kept = kept(columns);
        let tick = self.tick.map_or("-".into(), |tick| tick.to_string());
        let title = format!("{}: tick {tick}; latency in µs: of each service from its last input on", self.system);
        let lines = [COLUMNS.map(|column| column.head.into())].into_iter().chain(self.services.iter().map(Row::cells));
        let lines = lines.map(|cells| line(&kept, &cells));
        let before: usize =
            kept.iter().map(|i| &COLUMNS[*i]).take_while(|it| !it.is_latency()).map(|it| it.width).sum();
        let latencies: Vec<_> = kept.iter().copied().filter(|i| COLUMNS[*i].is_latency()).collect();
        let whole = format!("{:<before$}{}", "birth to attitude", line(&latencies, &cells_of(self.latency_us)));
        [title].into_iter().chain(lines).chain([whole]).collect::<Vec<_>>().join("\n")
    }
}

/// A column of the table.
struct Column {
    head: &'static str,
    width: usize,
    /// Where there is no room for all, the columns with the largest are left out; 0 never.
    spare: u8,
}

/// All fit into 121 columns, without the three most spare into 80.
const COLUMNS: [Column; 13] = [
    Column { head: "service", width: 11, spare: 0 },
    Column { head: "stage", width: 25, spare: 10 },
    Column { head: "state", width: 9, spare: 0 },
    Column { head: "pid", width: 8, spare: 3 },
    Column { head: "Hz", width: 8, spare: 1 },
    Column { head: "p50", width: 8, spare: 5 },
    Column { head: "p99", width: 8, spare: 0 },
    Column { head: "max", width: 8, spare: 4 },
    Column { head: "lost", width: 6, spare: 2 },
    Column { head: "restarts", width: 9, spare: 8 },
    Column { head: "epoch", width: 6, spare: 9 },
    Column { head: "cpu %", width: 7, spare: 6 },
    Column { head: "MiB", width: 7, spare: 7 },
];

impl Column {
    fn is_latency(&self) -> bool {
        ["p50", "p99", "max"].contains(&self.head)
    }
}

/// The columns that there is room for.
fn kept(columns: Option<usize>) -> Vec<usize> {
    let mut kept: Vec<_> = (0..COLUMNS.len()).collect();
    while columns.is_some_and(|columns| kept.iter().map(|i| COLUMNS[*i].width).sum::<usize>() > columns) {
        match kept.iter().copied().max_by_key(|i| COLUMNS[*i].spare).filter(|i| COLUMNS[*i].spare > 0) {
            Some(sparest) => kept.retain(|i| *i != sparest),
            None => break,
        }
    }
    kept
}

/// A line of the table: words begin at the left of their columns, numbers end at the right.
fn line(kept: &[usize], cells: &[String; COLUMNS.len()]) -> String {
    let cell = |i: &usize| match (COLUMNS[*i].width, &cells[*i]) {
        (width, cell) if *i < 3 => format!("{cell:<width$}"),
        (width, cell) => format!("{cell:>width$}"),
    };
    kept.iter().map(cell).collect()
}

/// A line that has latencies only.
fn cells_of(latency: Option<LatencyUs>) -> [String; COLUMNS.len()] {
    let mut cells = [const { String::new() }; COLUMNS.len()];
    let us = latency.map_or([None; 3], |LatencyUs { p50, p99, max }| [p50, p99, max].map(Some));
    for (cell, us) in cells[5..8].iter_mut().zip(us) {
        *cell = us.map_or("-".into(), |us| format!("{us:.0}"));
    }
    cells
}

impl Row {
    fn cells(&self) -> [String; COLUMNS.len()] {
        let Self { service, stage, state, pid, lost, restarts, epoch, .. } = self;
        let [rate, cpu, mib] = [self.rate_hz, self.cpu_percent, self.resident_mib]
            .map(|number| number.map_or("-".into(), |number| format!("{number:.1}")));
        let stage = stage.clone().unwrap_or_else(|| "-".into());
        let numbers = [lost.to_string(), restarts.to_string(), epoch.to_string(), cpu, mib];
        let mut cells = cells_of(self.latency_us);
        let pid = pid.map_or("-".into(), |pid| pid.to_string());
        cells[..5].clone_from_slice(&[service.clone(), stage, state.clone(), pid, rate]);
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
    fn a_rate_is_of_ticks_and_of_the_senders_clock() {
        assert_eq!(rate_hz(header(10, 0), header(510, 500_000_000)), Some(1000.0));
        assert_eq!(
            rate_hz(header(10, 5), header(10, 5)),
            Some(0.0),
            "a service that stands has a rate, and it is none"
        );
        assert_eq!(rate_hz(None, header(10, 5)), None);
    }

    fn moment() -> Moment {
        let latency_us = Some(LatencyUs { p50: 1234.0, p99: 12345.0, max: 1234567.0 });
        let row = |service: &str| Row {
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
        Moment { system: "plumbline".into(), tick: Some(1_234_567), latency_us, services }
    }

    fn words(line: &str) -> Vec<&str> {
        line.split_whitespace().collect()
    }

    #[test]
    fn a_table_is_as_wide_as_the_terminal_allows_and_tells_apart_what_it_shows() {
        for columns in 28..140 {
            let table = moment().table(Some(columns));
            let lines: Vec<_> = table.lines().skip(1).collect();
            assert!(lines.iter().all(|line| line.chars().count() <= columns), "{columns} columns:\n{table}");
            let heads = words(&lines[0].replace("cpu %", "cpu")).len();
            assert_eq!([lines[1], lines[2]].map(|line| words(line).len()), [heads; 2], "{columns} columns:\n{table}");
        }
        assert_eq!(moment().table(None), moment().table(Some(121)));
        let of_80 = moment().table(Some(80));
        let head: Vec<_> = words(of_80.lines().nth(1).unwrap());
        assert_eq!(head.join(" "), "service state pid Hz p50 p99 max lost cpu % MiB");
        assert_eq!(words(of_80.lines().nth(3).unwrap())[4..7], ["1234", "12345", "1234567"]);
        let (above, whole) = (of_80.lines().nth(3).unwrap(), of_80.lines().nth(4).unwrap());
        assert_eq!(whole.find("1234567"), above.find("1234567"), "{of_80}");
    }
}
