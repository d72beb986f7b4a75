//! Rate, intervals, bandwidth and losses of a topic.
//!
//! - Input: every message that the observer receives, in order; for a remote observer also the
//!   delivery counts.
//! - Output: rates and counts.
//! - Time: publisher timestamps if the messages have them, otherwise the observer's clock at
//!   arrival.
//! - Failure: a value that cannot be determined is `None`.

use std::fmt;

use graph::{Presence, Topic};
use launch::pluralize;
use messages::{Field, Layout};
use serde::Serialize;

use crate::interval::{IntervalAccumulator, IntervalStats};

/// Statistics of a topic during an observation.
#[derive(Debug)]
pub struct FlowMonitor {
    topic: String,
    every_tick: bool,
    stamps: Option<StampOffsets>,
    message_bytes: usize,
    messages: u64,
    time_range_ns: Option<[u64; 2]>,
    intervals: IntervalAccumulator,
    last_message: Option<LastMessage>,
    lost: u64,
    missed: u64,
    repeated: u64,
    buffer_was_full: bool,
    delivery: Option<Delivery>,
}

/// Counts of the messages that a remote observer has received on a topic, and of those lost since
/// the first one.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Delivery {
    /// Messages sent but not received.
    pub lost: u64,
    /// Messages omitted on board because of the configured topic rate.
    pub decimated: u64,
    /// Messages that were due but were dropped by the gateway.
    pub dropped: u64,
    /// Messages received, including those not yet processed by the observer.
    pub received: u64,
    /// Size of the received messages, bytes.
    pub bytes: u64,
    /// Batches received more than once or too late.
    pub repeated: u64,
    /// Batches that could not be decoded.
    pub rejected: u64,
    /// Restarts of the gateway.
    pub restarts: u64,
}

/// Offsets of the header fields from which the statistics are computed.
#[derive(Debug, Clone, Copy)]
struct StampOffsets {
    tick: usize,
    t_sent_ns: usize,
    lost_upstream: usize,
}

#[derive(Debug, Clone, Copy)]
struct LastMessage {
    tick: u64,
    lost_upstream: u64,
}

/// Statistics of a topic.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FlowReport {
    /// Name of the topic.
    pub topic: String,
    /// Messages received by the observer.
    pub messages: u64,
    /// Time from the first to the last message, s.
    pub duration_s: f64,
    /// Messages per second; `None` before the second message.
    pub rate_hz: Option<f64>,
    /// Bytes per second; `None` before the second message. For a remote observer, only the bytes
    /// received over the network count.
    pub bytes_per_s: Option<f64>,
    /// Size of a message on the bus, bytes.
    pub message_bytes: usize,
    /// Intervals between messages; `None` before the second message.
    pub interval_ms: Option<IntervalStats>,
    /// Clock by which the rate and the intervals are measured: `sent` for publisher timestamps,
    /// `arrival` for the observer's clock.
    pub measured_by: &'static str,
    /// Ticks that never reached the publisher; `None` for a topic that does not have a message on
    /// every tick.
    pub lost: Option<u64>,
    /// Messages missed by this observer, because they were overwritten in its buffer or lost on the
    /// network. `None` if unknown.
    pub missed: Option<u64>,
    /// Messages repeated by a restarted service.
    pub repeated: u64,
    /// Delivery to a remote observer; `None` for an observer on board.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub delivery: Option<Delivery>,
}

impl FlowMonitor {
    /// Creates a monitor. Its observation starts with the next message of the topic.
    pub fn new(topic: Topic, layout: &Layout) -> Self {
        let offset = |name: &str| {
            let found = layout.fields.iter().find(|field: &&Field| field.name == name && field.kind == "u64");
            found.map(|field| field.offset)
        };
        let stamps = || {
            Some(StampOffsets {
                tick: offset("tick")?,
                t_sent_ns: offset("t_sent_ns")?,
                lost_upstream: offset("lost_upstream")?,
            })
        };
        Self {
            topic: topic.name().into(),
            every_tick: topic.entry().presence == Presence::EveryTick,
            stamps: stamps(),
            message_bytes: layout.size,
            messages: 0,
            time_range_ns: None,
            intervals: IntervalAccumulator::default(),
            last_message: None,
            lost: 0,
            missed: 0,
            repeated: 0,
            buffer_was_full: false,
            delivery: None,
        }
    }

    /// Sets the delivery counts of a remote observer.
    ///
    /// Afterwards, the number of missed messages is `delivery.lost`. Gaps between ticks no longer
    /// count as missed, because the configured topic rate may omit ticks.
    pub fn set_delivery(&mut self, delivery: Delivery) {
        self.delivery = Some(delivery);
    }

    /// Records a message; `arrived_ns` is the observer's CLOCK_MONOTONIC.
    pub fn record(&mut self, bytes: &[u8], arrived_ns: u64) {
        self.messages += 1;
        let Some(stamps) = self.stamps else { return self.record_time(arrived_ns) };
        let [Some(tick), Some(t_sent_ns), Some(lost_upstream)] =
            [stamps.tick, stamps.t_sent_ns, stamps.lost_upstream].map(|offset| read_u64(bytes, offset))
        else {
            return;
        };
        if let Some(last) = self.last_message {
            if tick <= last.tick {
                self.repeated += 1;
                return;
            }
            let missing = tick - last.tick - 1;
            let lost = lost_upstream.saturating_sub(last.lost_upstream).min(missing);
            self.lost += lost;
            self.missed += missing - lost;
        }
        self.last_message = Some(LastMessage { tick, lost_upstream });
        self.record_time(t_sent_ns);
    }

    /// Records that the observer's buffer was full. Messages may have been overwritten.
    pub fn mark_buffer_full(&mut self) {
        self.buffer_was_full = true;
    }

    /// Returns the number of messages received so far.
    pub fn messages(&self) -> u64 {
        self.messages
    }

    /// Returns the statistics so far.
    pub fn report(&self) -> FlowReport {
        let duration_s = self.time_range_ns.map_or(0.0, |[first, last]| (last - first) as f64 * 1e-9);
        let rate_hz = Some(self.intervals.count / duration_s).filter(|rate_hz| rate_hz.is_finite());
        let missed = match self.delivery {
            Some(delivery) => Some(delivery.lost),
            None if self.every_tick => Some(self.missed),
            None => (!self.buffer_was_full).then_some(0),
        };
        let bytes = self
            .delivery
            .map_or(self.message_bytes as f64, |delivery| delivery.bytes as f64 / delivery.received as f64);
        FlowReport {
            topic: self.topic.clone(),
            messages: self.messages,
            duration_s,
            rate_hz,
            bytes_per_s: rate_hz.map(|rate_hz| rate_hz * bytes),
            message_bytes: self.message_bytes,
            interval_ms: self.intervals.stats(),
            measured_by: if self.stamps.is_some() { "sent" } else { "arrival" },
            lost: self.every_tick.then_some(self.lost),
            missed,
            repeated: self.repeated,
            delivery: self.delivery,
        }
    }

    fn record_time(&mut self, t_ns: u64) {
        let Some([first, last]) = self.time_range_ns else {
            self.time_range_ns = Some([t_ns; 2]);
            return;
        };
        self.intervals.push(t_ns.saturating_sub(last) as f64 * 1e-6);
        self.time_range_ns = Some([first, t_ns.max(last)]);
    }
}

fn read_u64(bytes: &[u8], offset: usize) -> Option<u64> {
    Some(u64::from_ne_bytes(bytes.get(offset..offset + 8)?.try_into().ok()?))
}

impl FlowReport {
    /// Returns a line with the rate, the intervals and the losses.
    pub fn rate_line(&self) -> String {
        let Some((rate_hz, IntervalStats { mean, min, max, jitter })) = self.rate_hz.zip(self.interval_ms) else {
            return format!("{}: {}", self.topic, pluralize(self.messages, "message"));
        };
        format!(
            "{}: {rate_hz:.2} Hz, interval {mean:.3} ms mean, {min:.3} min, {max:.3} max, {jitter:.3} jitter; {self}",
            self.topic
        )
    }

    /// Returns a line with the bandwidth and the losses.
    pub fn bandwidth_line(&self) -> String {
        let bytes_per_s = self.bytes_per_s.unwrap_or(0.0);
        let suffixes = if self.delivery.is_some() { [" over the network", " on board"] } else { [""; 2] };
        format!(
            "{}: {bytes_per_s:.0} B/s{}, {} B per message{}; {self}",
            self.topic, suffixes[0], self.message_bytes, suffixes[1]
        )
    }
}

/// Formats the counts of received and missing messages.
impl fmt::Display for FlowReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let count_text = |count: Option<u64>| count.map_or("unknown".into(), |count| count.to_string());
        let Self { messages, lost, missed, repeated, .. } = self;
        let (lost, missed) = (count_text(*lost), count_text(*missed));
        write!(
            f,
            "{}, lost on the bus {lost}, missed by this observer {missed}, repeated {repeated}",
            pluralize(*messages, "message")
        )?;
        let Some(Delivery { decimated, dropped, restarts, rejected, .. }) = self.delivery else { return Ok(()) };
        write!(f, "; decimated {decimated}, dropped by the gateway {dropped}, gateway restarts {restarts}")?;
        if rejected > 0 { write!(f, ", rejected {rejected}") } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use messages::{FusedState, Health, Message};

    use super::*;

    fn fused(tick: u64, lost_upstream: u64) -> FusedState {
        let mut state: FusedState = bytemuck::Zeroable::zeroed();
        (state.header.tick, state.header.lost_upstream) = (tick, lost_upstream);
        state.header.t_sent_ns = 1_000_000 * tick;
        state
    }

    fn flow(messages: &[FusedState]) -> FlowReport {
        let mut flow = FlowMonitor::new(Topic::Fused, &FusedState::layout());
        messages.iter().for_each(|message| flow.record(bytemuck::bytes_of(message), 0));
        flow.report()
    }

    #[test]
    fn observer_misses_are_not_bus_losses() {
        let report = flow(&[fused(5, 2), fused(6, 2), fused(10, 3), fused(14, 6), fused(15, 6)]);
        assert_eq!((report.lost, report.missed), (Some(4), Some(2)), "six ticks are missing");
    }

    #[test]
    fn repeats_after_restart_are_neither_lost_nor_missed() {
        let report = flow(&[fused(5, 0), fused(6, 0), fused(4, 0), fused(5, 0), fused(6, 0), fused(7, 0)]);
        assert_eq!((report.lost, report.missed, report.repeated), (Some(0), Some(0), 3));
    }

    #[test]
    fn rate_and_intervals_use_publisher_stamps() {
        let report = flow(&[fused(0, 0), fused(1, 0), fused(2, 0), fused(5, 0)]);
        let IntervalStats { mean, min, max, jitter } = report.interval_ms.unwrap();
        assert!((report.rate_hz.unwrap() - 600.0).abs() < 1e-9, "{report:?}");
        assert!((mean - 5.0 / 3.0).abs() < 1e-12 && (min, max) == (1.0, 3.0));
        assert!((jitter - (8.0f64 / 9.0).sqrt()).abs() < 1e-12);
        assert!((report.bytes_per_s.unwrap() - 600.0 * 184.0).abs() < 1e-6);
    }

    #[test]
    fn remote_decimated_tick_is_not_missed() {
        let mut flow = FlowMonitor::new(Topic::Fused, &FusedState::layout());
        for tick in [0, 20, 40, 80] {
            flow.set_delivery(Delivery {
                lost: tick / 80,
                decimated: 76,
                received: 4,
                bytes: 150,
                ..Delivery::default()
            });
            flow.record(bytemuck::bytes_of(&fused(tick, tick / 40)), 0);
        }
        let report = flow.report();
        assert_eq!((report.lost, report.missed), (Some(2), Some(1)), "{report}");
        assert!((report.bytes_per_s.unwrap() - 37.5 * 37.5).abs() < 1e-9, "{report:?}");
        assert!(report.to_string().contains("decimated 76"), "{report}");
    }

    #[test]
    fn counts_are_unknown_without_ticks_after_full_buffer() {
        let mut flow = FlowMonitor::new(Topic::Health, &Health::layout());
        let health: Health = bytemuck::Zeroable::zeroed();
        flow.record(bytemuck::bytes_of(&health), 1_000_000_000);
        assert_eq!(flow.report().rate_hz, None);
        flow.record(bytemuck::bytes_of(&health), 1_500_000_000);
        let report = flow.report();
        assert_eq!((report.rate_hz, report.lost, report.missed), (Some(2.0), None, Some(0)));
        flow.mark_buffer_full();
        assert_eq!(flow.report().missed, None);
    }
}
