//! How the services of a running system do, from moment to moment.

use std::fmt;

use bus::{BusError, Observer, Tap};
use launch::Service;
use messages::Header;
use runtime::clock::monotonic_ns;
use serde::Serialize;
use supervisor::Standing;

use crate::{
    hops::{Hops, LatencyUs, output},
    process::Processes,
};

/// Watches the path of a system.
#[derive(Debug)]
pub struct Top {
    /// From the end of the path to its beginning: an output is read before what it was made of, so that no input is missed.
    taps: Vec<(Service, Tap)>,
    hops: Hops,
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
    /// Its process; 0 where there is none.
    pub pid: u32,
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
    pub fn new(observer: &Observer, standings: &[Standing]) -> Result<Self, BusError> {
        let (mut processes, owner_pid) = (Processes::default(), observer.owner_pid());
        for pid in standings.iter().map(|standing| standing.pid).chain([owner_pid]) {
            processes.look(pid, monotonic_ns());
        }
        let taps = Service::PATH.into_iter().rev().map(|service| Ok((service, observer.tap(output(service))?)));
        Ok(Self {
            taps: taps.collect::<Result<_, BusError>>()?,
            hops: Hops::default(),
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
            })?;
        }
        self.hops.settle();
        Ok(())
    }

    /// What was seen since the last moment, with what the supervisor says.
    pub fn moment(&mut self, system: &str, standings: &[Standing]) -> Moment {
        let (latencies, whole) = self.hops.report();
        let now_ns = monotonic_ns();
        let mut services: Vec<_> = standings
            .iter()
            .map(|standing| {
                let service = Service::named(&standing.service).filter(|service| !service.is_beside());
                let cost = self.processes.look(standing.pid, now_ns);
                Row {
                    service: standing.service.clone(),
                    stage: standing.stage.clone(),
                    state: standing.state.clone(),
                    pid: standing.pid,
                    rate_hz: service
                        .and_then(|service| rate_hz(self.before[service as usize], self.hops.newest(service))),
                    latency_us: service.and_then(|service| latencies[service as usize]),
                    lost: standing.lost,
                    restarts: standing.restarts,
                    epoch: standing.epoch,
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
            pid: self.owner_pid,
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

/// A table for people.
impl fmt::Display for Moment {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let us = |latency: Option<LatencyUs>| match latency {
            Some(LatencyUs { p50, p99, max }) => format!("{p50:>8.0}{p99:>8.0}{max:>8.0}"),
            None => format!("{:>8}{:>8}{:>8}", "-", "-", "-"),
        };
        let number = |number: Option<f64>| number.map_or("-".into(), |number| format!("{number:.1}"));
        let tick = self.tick.map_or("-".into(), |tick| tick.to_string());
        writeln!(f, "{}: tick {tick}; latency in µs: of each service from its last input on", self.system)?;
        write!(
            f,
            "{:<11}{:<24}{:<10}{:>8}{:>9}{:>8}{:>8}{:>8}{:>6}{:>9}{:>6}{:>7}{:>7}",
            "service", "stage", "state", "pid", "Hz", "p50", "p99", "max", "lost", "restarts", "epoch", "cpu %", "MiB"
        )?;
        for row in &self.services {
            let Row { service, state, pid, lost, restarts, epoch, .. } = row;
            let (stage, latency) = (row.stage.as_deref().unwrap_or("-"), us(row.latency_us));
            let [rate, cpu, mib] = [row.rate_hz, row.cpu_percent, row.resident_mib].map(number);
            write!(
                f,
                "\n{service:<11}{stage:<24}{state:<10}{pid:>8}{rate:>9}{latency}{lost:>6}{restarts:>9}{epoch:>6}{cpu:>7}{mib:>7}"
            )?;
        }
        let end = "birth to attitude";
        write!(f, "\n{end:<62}{}", us(self.latency_us))
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
}
