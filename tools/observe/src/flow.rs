//! How a topic flows: messages, intervals, bytes, and what was lost where.
//!
//! Input: every message that an observer got, in order; for one who is not on board, what became of the others on the way. Output: rates
//! and counts. Time: the senders' stamps where the messages have them, else the observer's clock at arrival. Failure: none; what cannot
//! be known is `None`.

use std::fmt;

use graph::{Presence, Topic};
use launch::pluralize;
use messages::{Field, Layout};
use serde::Serialize;

use crate::interval::{Interval, Intervals};

/// The flow of a topic over a while.
#[derive(Debug)]
pub struct Flow {
    topic: String,
    every_tick: bool,
    stamps: Option<Stamps>,
    size: usize,
    messages: u64,
    stamped_ns: Option<[u64; 2]>,
    intervals: Intervals,
    last: Option<Last>,
    lost: u64,
    overwritten: u64,
    repeated: u64,
    /// The observer's own buffer was full.
    was_full: bool,
    delivery: Option<Delivery>,
}

/// What became of a topic's messages between the board and an observer elsewhere, from the first that arrived on.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Delivery {
    /// Messages that were sent and did not arrive.
    pub lost: u64,
    /// Messages that the topic's rate leaves on board.
    pub decimated: u64,
    /// Messages that should have been sent and were not.
    pub dropped: u64,
    /// Messages that arrived, the last of them perhaps not yet looked at.
    pub arrived: u64,
    /// The bytes that they arrived in.
    pub bytes: u64,
    /// Parcels of messages that came again or too late.
    pub repeated: u64,
    /// Parcels that were none.
    pub refused: u64,
    /// Lives of the sender after the first.
    pub restarts: u64,
}

/// Where a message says who it is: offsets of fields of the header.
#[derive(Debug, Clone, Copy)]
struct Stamps {
    tick: usize,
    t_sent_ns: usize,
    lost_upstream: usize,
}

#[derive(Debug, Clone, Copy)]
struct Last {
    tick: u64,
    lost_upstream: u64,
}

/// What a topic did.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FlowReport {
    /// The topic.
    pub topic: String,
    /// Messages that the observer got.
    pub messages: u64,
    /// From the first message to the last, s.
    pub seconds: f64,
    /// Messages per second; `None` before the second one.
    pub rate_hz: Option<f64>,
    /// Payload per second, for an observer elsewhere as it came over the network; `None` before the second message.
    pub bytes_per_s: Option<f64>,
    /// Bytes of a message on the bus.
    pub message_bytes: usize,
    /// Between messages; `None` before the second one.
    pub interval_ms: Option<Interval>,
    /// Whose clock measured: the sender's stamps, or the arrival here.
    pub measured_by: &'static str,
    /// Ticks that the publisher itself never had; `None` where the topic does not have every tick.
    pub lost: Option<u64>,
    /// Messages that this observer missed: overwritten in its own buffer, or lost on the way to it; `None` where that cannot be counted.
    pub overwritten: Option<u64>,
    /// Messages that a restarted service said again.
    pub repeated: u64,
    /// The way from the board; `None` on board.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub delivery: Option<Delivery>,
}

impl Flow {
    /// The flow of a topic of this layout, from its next message on.
    pub fn new(topic: Topic, layout: &Layout) -> Self {
        let offset = |name: &str| {
            let found = layout.fields.iter().find(|field: &&Field| field.name == name && field.kind == "u64");
            found.map(|field| field.offset)
        };
        let stamps = || {
            Some(Stamps {
                tick: offset("tick")?,
                t_sent_ns: offset("t_sent_ns")?,
                lost_upstream: offset("lost_upstream")?,
            })
        };
        Self {
            topic: topic.name().into(),
            every_tick: topic.entry().presence == Presence::EveryTick,
            stamps: stamps(),
            size: layout.size,
            messages: 0,
            stamped_ns: None,
            intervals: Intervals::default(),
            last: None,
            lost: 0,
            overwritten: 0,
            repeated: 0,
            was_full: false,
            delivery: None,
        }
    }

    /// The observer is not on board: what became of the messages on the way, so far. What it missed is known by this alone, for a rate may
    /// leave ticks out.
    pub fn passed(&mut self, delivery: Delivery) {
        self.delivery = Some(delivery);
    }

    /// Takes a message; `arrived_ns` is the observer's CLOCK_MONOTONIC.
    pub fn take(&mut self, bytes: &[u8], arrived_ns: u64) {
        self.messages += 1;
        let Some(stamps) = self.stamps else { return self.stamp(arrived_ns) };
        let [Some(tick), Some(t_sent_ns), Some(lost_upstream)] =
            [stamps.tick, stamps.t_sent_ns, stamps.lost_upstream].map(|offset| number(bytes, offset))
        else {
            return;
        };
        if let Some(last) = self.last {
            if tick <= last.tick {
                self.repeated += 1;
                return;
            }
            let missing = tick - last.tick - 1;
            let lost = lost_upstream.saturating_sub(last.lost_upstream).min(missing);
            self.lost += lost;
            self.overwritten += missing - lost;
        }
        self.last = Some(Last { tick, lost_upstream });
        self.stamp(t_sent_ns);
    }

    /// The observer's buffer was found full: messages may have been overwritten.
    pub fn was_full(&mut self) {
        self.was_full = true;
    }

    /// Messages so far.
    pub fn messages(&self) -> u64 {
        self.messages
    }

    /// What it has been so far.
    pub fn report(&self) -> FlowReport {
        let seconds = self.stamped_ns.map_or(0.0, |[first, last]| (last - first) as f64 * 1e-9);
        let rate_hz = Some(self.intervals.count / seconds).filter(|rate_hz| rate_hz.is_finite());
        let overwritten = match self.delivery {
            Some(delivery) => Some(delivery.lost),
            None if self.every_tick => Some(self.overwritten),
            None => (!self.was_full).then_some(0),
        };
        let bytes = self.delivery.map_or(self.size as f64, |delivery| delivery.bytes as f64 / delivery.arrived as f64);
        FlowReport {
            topic: self.topic.clone(),
            messages: self.messages,
            seconds,
            rate_hz,
            bytes_per_s: rate_hz.map(|rate_hz| rate_hz * bytes),
            message_bytes: self.size,
            interval_ms: self.intervals.report(),
            measured_by: if self.stamps.is_some() { "sent" } else { "arrival" },
            lost: self.every_tick.then_some(self.lost),
            overwritten,
            repeated: self.repeated,
            delivery: self.delivery,
        }
    }

    fn stamp(&mut self, t_ns: u64) {
        let Some([first, last]) = self.stamped_ns else {
            self.stamped_ns = Some([t_ns; 2]);
            return;
        };
        self.intervals.add(t_ns.saturating_sub(last) as f64 * 1e-6);
        self.stamped_ns = Some([first, t_ns.max(last)]);
    }
}

fn number(bytes: &[u8], offset: usize) -> Option<u64> {
    Some(u64::from_ne_bytes(bytes.get(offset..offset + 8)?.try_into().ok()?))
}

impl FlowReport {
    /// The rate and its regularity, on a line.
    pub fn hz(&self) -> String {
        let Some((rate_hz, Interval { mean, min, max, jitter })) = self.rate_hz.zip(self.interval_ms) else {
            return format!("{}: {}", self.topic, pluralize(self.messages, "message"));
        };
        format!(
            "{}: {rate_hz:.2} Hz, interval {mean:.3} ms mean, {min:.3} min, {max:.3} max, {jitter:.3} jitter; {self}",
            self.topic
        )
    }

    /// The bytes, on a line.
    pub fn bw(&self) -> String {
        let bytes_per_s = self.bytes_per_s.unwrap_or(0.0);
        let place = if self.delivery.is_some() { [" over the network", " on board"] } else { [""; 2] };
        format!(
            "{}: {bytes_per_s:.0} B/s{}, {} B per message{}; {self}",
            self.topic, place[0], self.message_bytes, place[1]
        )
    }
}

/// What came, and what did not.
impl fmt::Display for FlowReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let told = |count: Option<u64>| count.map_or("unknown".into(), |count| count.to_string());
        let Self { messages, lost, overwritten, repeated, .. } = self;
        let (lost, overwritten) = (told(*lost), told(*overwritten));
        write!(
            f,
            "{}, lost on the bus {lost}, missed by this observer {overwritten}, repeated {repeated}",
            pluralize(*messages, "message")
        )?;
        let Some(Delivery { decimated, dropped, restarts, refused, .. }) = self.delivery else { return Ok(()) };
        write!(f, "; decimated {decimated}, dropped by the gateway {dropped}, gateway restarts {restarts}")?;
        if refused > 0 { write!(f, ", refused here {refused}") } else { Ok(()) }
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
        let mut flow = Flow::new(Topic::Fused, &FusedState::layout());
        messages.iter().for_each(|message| flow.take(bytemuck::bytes_of(message), 0));
        flow.report()
    }

    #[test]
    fn what_the_observer_missed_is_not_lost_on_the_bus() {
        let report = flow(&[fused(5, 2), fused(6, 2), fused(10, 3), fused(14, 6), fused(15, 6)]);
        assert_eq!((report.lost, report.overwritten), (Some(4), Some(2)), "of six that are missing");
    }

    #[test]
    fn what_a_restarted_service_says_again_is_neither() {
        let report = flow(&[fused(5, 0), fused(6, 0), fused(4, 0), fused(5, 0), fused(6, 0), fused(7, 0)]);
        assert_eq!((report.lost, report.overwritten, report.repeated), (Some(0), Some(0), 3));
    }

    #[test]
    fn rate_and_intervals_are_those_of_the_stamps() {
        let report = flow(&[fused(0, 0), fused(1, 0), fused(2, 0), fused(5, 0)]);
        let Interval { mean, min, max, jitter } = report.interval_ms.unwrap();
        assert!((report.rate_hz.unwrap() - 600.0).abs() < 1e-9, "{report:?}");
        assert!((mean - 5.0 / 3.0).abs() < 1e-12 && (min, max) == (1.0, 3.0));
        assert!((jitter - (8.0f64 / 9.0).sqrt()).abs() < 1e-12);
        assert!((report.bytes_per_s.unwrap() - 600.0 * 184.0).abs() < 1e-6);
    }

    #[test]
    fn from_elsewhere_a_tick_that_the_rate_leaves_out_is_not_missed() {
        let mut flow = Flow::new(Topic::Fused, &FusedState::layout());
        for tick in [0, 20, 40, 80] {
            flow.passed(Delivery { lost: tick / 80, decimated: 76, arrived: 4, bytes: 150, ..Delivery::default() });
            flow.take(bytemuck::bytes_of(&fused(tick, tick / 40)), 0);
        }
        let report = flow.report();
        assert_eq!((report.lost, report.overwritten), (Some(2), Some(1)), "{report}");
        assert!((report.bytes_per_s.unwrap() - 37.5 * 37.5).abs() < 1e-9, "{report:?}");
        assert!(report.to_string().contains("decimated 76"), "{report}");
    }

    #[test]
    fn where_nothing_can_be_counted_nothing_is_claimed() {
        let mut flow = Flow::new(Topic::Health, &Health::layout());
        let health: Health = bytemuck::Zeroable::zeroed();
        flow.take(bytemuck::bytes_of(&health), 1_000_000_000);
        assert_eq!(flow.report().rate_hz, None);
        flow.take(bytemuck::bytes_of(&health), 1_500_000_000);
        let report = flow.report();
        assert_eq!((report.rate_hz, report.lost, report.overwritten), (Some(2.0), None, Some(0)));
        flow.was_full();
        assert_eq!(flow.report().overwritten, None);
    }
}
