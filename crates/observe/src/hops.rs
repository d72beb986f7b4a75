//! Latency of each service, from the timestamps in the messages.
//!
//! - Input: tick, reception time of the sample and publication time of every message of the data
//!   path.
//! - Output: time from the publication of a service's latest input to the publication of its
//!   output.
//! - Time: CLOCK_MONOTONIC of the timestamps.
//! - Failure: a tick with a missing input is skipped.

use graph::Service;
use hdrhistogram::Histogram;
use messages::Header;
use serde::Serialize;

/// Number of ticks kept. It exceeds the capacity of an observer's buffer.
const RING_TICKS: usize = 4096;
/// Upper bound of recorded latencies, ns. Longer latencies are recorded as this value.
const MAX_LATENCY_NS: u64 = 60_000_000_000;

/// Latency of each service, and end to end from the reception of a sample to the publication of its
/// attitude.
#[derive(Debug)]
pub struct HopLatencies {
    ring: Vec<PublishTimes>,
    pending: Vec<(Service, Header)>,
    by_service: [LatencyHistogram; Service::PATH.len()],
    end_to_end: LatencyHistogram,
    newest: [Option<Header>; Service::PATH.len()],
    /// Upstream services of each service on the data path.
    sources: [Vec<Service>; Service::PATH.len()],
}

/// Publication times of a tick by service, ns; 0 if not received.
#[derive(Debug, Clone, Copy, Default)]
struct PublishTimes {
    tick: u64,
    sent_ns: [u64; Service::PATH.len()],
}

/// Latency distribution, µs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LatencyUs {
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Maximum.
    pub max: f64,
}

impl Default for HopLatencies {
    fn default() -> Self {
        Self {
            ring: vec![PublishTimes { tick: u64::MAX, ..PublishTimes::default() }; RING_TICKS],
            pending: Vec::new(),
            by_service: Default::default(),
            end_to_end: LatencyHistogram::default(),
            newest: [None; Service::PATH.len()],
            // Auxiliary services are not on the data path.
            sources: Service::PATH.map(|service| service.sources().filter(|source| !source.is_auxiliary()).collect()),
        }
    }
}

impl HopLatencies {
    /// Records an output of a service. Ticks repeated by a restarted service are ignored.
    pub fn record(&mut self, service: Service, header: Header) {
        let newest = &mut self.newest[service as usize];
        if newest.is_some_and(|newest| header.tick <= newest.tick) {
            return;
        }
        *newest = Some(header);
        let times = &mut self.ring[header.tick as usize % RING_TICKS];
        if times.tick != header.tick {
            *times = PublishTimes { tick: header.tick, ..PublishTimes::default() };
        }
        times.sent_ns[service as usize] = header.t_sent_ns;
        self.pending.push((service, header));
    }

    /// Computes the latencies of the outputs recorded so far.
    ///
    /// Call this after all topics have been read, so that the inputs of every recorded output have
    /// been recorded, too.
    pub fn process_pending(&mut self) {
        for (service, header) in self.pending.drain(..) {
            let times = self.ring[header.tick as usize % RING_TICKS];
            let inputs = self.sources[service as usize].iter().map(|source| times.sent_ns[*source as usize]);
            let complete = times.tick == header.tick && inputs.clone().all(|sent_ns| sent_ns != 0);
            if complete {
                let start_ns = inputs.max().unwrap_or(header.t_born_ns);
                self.by_service[service as usize].record_ns(header.t_sent_ns.saturating_sub(start_ns));
            }
            if service == Service::Course {
                self.end_to_end.record_ns(header.t_sent_ns.saturating_sub(header.t_born_ns));
            }
        }
    }

    /// Returns the header of the newest output of a service.
    pub fn newest(&self, service: Service) -> Option<Header> {
        self.newest[service as usize]
    }

    /// Returns the latencies since the last call, for each service and end to end.
    pub fn take_latencies(&mut self) -> ([Option<LatencyUs>; Service::PATH.len()], Option<LatencyUs>) {
        let by_service = Service::PATH.map(|service| self.by_service[service as usize].take());
        (by_service, self.end_to_end.take())
    }
}

/// Histogram of latencies in ns, which is emptied when it is read.
#[derive(Debug)]
pub struct LatencyHistogram(Histogram<u64>);

impl Default for LatencyHistogram {
    fn default() -> Self {
        // The arguments are valid constants, so the call cannot fail.
        Self(Histogram::new_with_max(MAX_LATENCY_NS, 3).unwrap_or_else(|_| unreachable!("3 digits")))
    }
}

impl LatencyHistogram {
    /// Adds a latency.
    pub fn record_ns(&mut self, ns: u64) {
        self.0.saturating_record(ns);
    }

    /// Returns the distribution and empties the histogram; `None` if nothing was recorded.
    pub fn take(&mut self) -> Option<LatencyUs> {
        let us = |ns: u64| ns as f64 * 1e-3;
        let [p50, p99] = [0.5, 0.99].map(|quantile| us(self.0.value_at_quantile(quantile)));
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

    fn path_headers() -> [(Service, Header); 5] {
        use Service::{Accel, Course, Fuser, Gyro, Ingest};
        [(Ingest, 2_000), (Gyro, 5_000), (Accel, 9_000), (Fuser, 10_000), (Course, 30_000)]
            .map(|(service, t_sent_ns)| (service, header(7, t_sent_ns)))
    }

    #[test]
    fn latency_is_independent_of_reading_order() {
        let mut hops = HopLatencies::default();
        path_headers().into_iter().rev().for_each(|(service, header)| hops.record(service, header));
        hops.process_pending();
        let (by_service, end_to_end) = hops.take_latencies();
        let us = by_service.map(|latency| latency.unwrap().max.round());
        assert_eq!(us, [1.0, 3.0, 7.0, 1.0, 20.0], "the fuser waits for the later of its inputs");
        assert_eq!(end_to_end.unwrap().p50.round(), 29.0);
        assert_eq!(hops.take_latencies(), ([None; 5], None), "each latency is returned once");
    }

    #[test]
    fn tick_with_missing_input_is_skipped() {
        let mut hops = HopLatencies::default();
        path_headers().into_iter().skip(2).for_each(|(service, header)| hops.record(service, header));
        hops.process_pending();
        let (by_service, _) = hops.take_latencies();
        assert_eq!(by_service.map(|latency| latency.is_some()), [false, false, false, false, true]);
    }
}
