//! How long each service takes: from the stamps that messages carry.
//!
//! Input: tick, birth and publication of every message of the path. Output: the time from the last input that a service waited for to
//! what it published. Time: the stamps' CLOCK_MONOTONIC. Failure: a tick of which an input was not seen is left out.

use graph::Service;
use hdrhistogram::Histogram;
use messages::Header;
use serde::Serialize;

/// Ticks remembered: more than an observer's buffer holds.
const TICKS: usize = 4096;
/// What takes longer is counted as this long, ns.
const MAX_LATENCY_NS: u64 = 60_000_000_000;

/// Latencies of every service, and from birth to attitude.
#[derive(Debug)]
pub struct Hops {
    seen: Vec<Seen>,
    fresh: Vec<(Service, Header)>,
    each: [Latencies; Service::PATH.len()],
    whole: Latencies,
    newest: [Option<Header>; Service::PATH.len()],
    /// Whose outputs each service waits for.
    sources: [Vec<Service>; Service::PATH.len()],
}

/// When each service published a tick, ns; 0 where that was not seen.
#[derive(Debug, Clone, Copy, Default)]
struct Seen {
    tick: u64,
    sent_ns: [u64; Service::PATH.len()],
}

/// A latency, µs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LatencyUs {
    /// Median.
    pub p50: f64,
    /// 99 %.
    pub p99: f64,
    /// Largest.
    pub max: f64,
}

impl Default for Hops {
    fn default() -> Self {
        Self {
            seen: vec![Seen { tick: u64::MAX, ..Seen::default() }; TICKS],
            fresh: Vec::new(),
            each: Default::default(),
            whole: Latencies::default(),
            newest: [None; Service::PATH.len()],
            // Only what is on the path has a place here.
            sources: Service::PATH.map(|service| service.sources().filter(|source| !source.is_auxiliary()).collect()),
        }
    }
}

impl Hops {
    /// Takes what a service published; what a restarted one says again is left out.
    pub fn take(&mut self, service: Service, header: Header) {
        let newest = &mut self.newest[service as usize];
        if newest.is_some_and(|newest| header.tick <= newest.tick) {
            return;
        }
        *newest = Some(header);
        let seen = &mut self.seen[header.tick as usize % TICKS];
        if seen.tick != header.tick {
            *seen = Seen { tick: header.tick, ..Seen::default() };
        }
        seen.sent_ns[service as usize] = header.t_sent_ns;
        self.fresh.push((service, header));
    }

    /// Every message published before the newest one taken has been taken: what each took is known.
    pub fn settle(&mut self) {
        for (service, header) in self.fresh.drain(..) {
            let seen = self.seen[header.tick as usize % TICKS];
            let inputs = self.sources[service as usize].iter().map(|source| seen.sent_ns[*source as usize]);
            let complete = seen.tick == header.tick && inputs.clone().all(|sent_ns| sent_ns != 0);
            if complete {
                let from_ns = inputs.max().unwrap_or(header.t_born_ns);
                self.each[service as usize].add(header.t_sent_ns.saturating_sub(from_ns));
            }
            if service == Service::Course {
                self.whole.add(header.t_sent_ns.saturating_sub(header.t_born_ns));
            }
        }
    }

    /// The newest message of a service.
    pub fn newest(&self, service: Service) -> Option<Header> {
        self.newest[service as usize]
    }

    /// What was measured since the last time: of each service, and from birth to attitude.
    pub fn report(&mut self) -> ([Option<LatencyUs>; Service::PATH.len()], Option<LatencyUs>) {
        let each = Service::PATH.map(|service| self.each[service as usize].take());
        (each, self.whole.take())
    }
}

/// Latencies since they were last asked for.
#[derive(Debug)]
pub struct Latencies(Histogram<u64>);

impl Default for Latencies {
    fn default() -> Self {
        // The bounds are constants that a histogram takes.
        Self(Histogram::new_with_max(MAX_LATENCY_NS, 3).unwrap_or_else(|_| unreachable!("3 digits")))
    }
}

impl Latencies {
    /// Takes one, ns.
    pub fn add(&mut self, ns: u64) {
        self.0.saturating_record(ns);
    }

    /// What they were since the last time; `None` where there was none.
    pub fn take(&mut self) -> Option<LatencyUs> {
        let us = |ns: u64| ns as f64 * 1e-3;
        let [p50, p99] = [0.5, 0.99].map(|share| us(self.0.value_at_quantile(share)));
        let latency = (!self.0.is_empty()).then(|| LatencyUs { p50, p99, max: us(self.0.max()) });
        self.0.reset();
        latency
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(tick: u64, t_sent_ns: u64) -> Header {
        Header { tick, t_sent_ns, t_born_ns: 1_000, ..bytemuck::Zeroable::zeroed() }
    }

    fn path() -> [(Service, Header); 5] {
        use Service::{Accel, Course, Fuser, Gyro, Ingest};
        [(Ingest, 2_000), (Gyro, 5_000), (Accel, 9_000), (Fuser, 10_000), (Course, 30_000)]
            .map(|(service, t_sent_ns)| (service, header(7, t_sent_ns)))
    }

    #[test]
    fn each_service_is_charged_for_its_own_time_whatever_the_order_of_reading() {
        let mut hops = Hops::default();
        path().into_iter().rev().for_each(|(service, header)| hops.take(service, header));
        hops.settle();
        let (each, whole) = hops.report();
        let us = each.map(|latency| latency.unwrap().max.round());
        assert_eq!(us, [1.0, 3.0, 7.0, 1.0, 20.0], "the fuser waits for the later of its inputs");
        assert_eq!(whole.unwrap().p50.round(), 29.0);
        assert_eq!(hops.report(), ([None; 5], None), "each is told once");
    }

    #[test]
    fn a_tick_of_which_an_input_was_not_seen_is_left_out() {
        let mut hops = Hops::default();
        path().into_iter().skip(2).for_each(|(service, header)| hops.take(service, header));
        hops.settle();
        let (each, _) = hops.report();
        assert_eq!(each.map(|latency| latency.is_some()), [false, false, false, false, true]);
    }
}
