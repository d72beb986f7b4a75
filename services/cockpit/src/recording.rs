//! A recording, reduced to snapshots of equal duration when it is opened.
//!
//! Input: messages of the topics that contain the source's time, in the order of arrival at the
//! recorder. On a busy host the recorder receives many messages of a topic together, so messages
//! of other topics follow up to seconds later than those of the same tick.
//! Output: snapshots by number.
//! Memory: bounded, independent of the recording's length.

use std::collections::VecDeque;

use graph::Topic;
use wire::{
    cockpit,
    command::ControlMessage,
    v1::{SystemStatus, system_status::State},
};

use crate::decimator::{Decimator, SNAPSHOT_INTERVAL};

/// Maximum number of snapshots of a recording. At the live rate, they cover half an hour. Longer
/// recordings get longer snapshots.
const MAX_SNAPSHOTS: u64 = 60_000;
/// Time span within which messages are sorted by time, ns. It is twice the time that the topics of
/// the bus hold by default.
const SORTED_NS: i64 = 4_000_000_000;
/// Maximum size of the messages that are sorted by time, in bytes.
const MAX_SORTED_BYTES: usize = 128 << 20;
/// Maximum number of snapshots in a reply.
const MAX_REPLY_SNAPSHOTS: usize = 4096;
/// Maximum size of the snapshots in a reply, in bytes.
const MAX_REPLY_BYTES: usize = 8 << 20;

/// Snapshots of a recording.
#[derive(Debug)]
pub struct Recording {
    /// Encoded snapshots in chronological order.
    snapshots: Vec<Vec<u8>>,
    name: String,
    rate_hz: f64,
    t_first_ns: i64,
    t_last_ns: i64,
}

/// Builds a [`Recording`] from its messages.
#[derive(Debug)]
pub struct RecordingBuilder {
    recording: Recording,
    interval_ns: i64,
    decimator: Decimator,
    /// One element per snapshot that is not closed yet, in chronological order. The first element
    /// belongs to the snapshot that follows those of `recording`.
    open: VecDeque<SnapshotMessages>,
    open_bytes: usize,
}

/// Messages of a snapshot in the order of their addition.
#[derive(Debug, Default)]
struct SnapshotMessages {
    /// Topic and length of each message, in the order of `bytes`.
    messages: Vec<(Topic, usize)>,
    bytes: Vec<u8>,
}

impl Recording {
    /// Starts building a recording that covers `t_first_ns` to `t_last_ns` on the source's clock.
    pub fn builder(name: &str, rate_hz: f64, t_first_ns: i64, t_last_ns: i64) -> RecordingBuilder {
        let t_last_ns = t_last_ns.max(t_first_ns.saturating_add(1));
        let min_interval_ns = t_last_ns.abs_diff(t_first_ns).div_ceil(MAX_SNAPSHOTS).cast_signed();
        let interval_ns = (SNAPSHOT_INTERVAL.as_nanos() as i64).max(min_interval_ns);
        let recording = Self { snapshots: Vec::new(), name: name.into(), rate_hz, t_first_ns, t_last_ns };
        RecordingBuilder {
            recording,
            interval_ns,
            decimator: Decimator::default(),
            open: VecDeque::new(),
            open_bytes: 0,
        }
    }

    /// Returns up to `count` encoded snapshots starting at number `from`, but no more than fit into
    /// a reply.
    pub(crate) fn encode_snapshots(&self, from: usize, count: usize) -> Vec<u8> {
        let requested = self.snapshots.iter().skip(from).take(count.min(MAX_REPLY_SNAPSHOTS));
        let mut remaining_bytes = MAX_REPLY_BYTES;
        let fitting = requested.take_while(|snapshot| {
            let fits = remaining_bytes >= snapshot.len();
            remaining_bytes = remaining_bytes.saturating_sub(snapshot.len());
            fits
        });
        cockpit::encode_snapshots(fitting.map(Vec::as_slice))
    }

    /// Returns the status message for the page.
    pub fn status(&self) -> SystemStatus {
        SystemStatus {
            state: State::Recording.into(),
            system: self.name.clone(),
            source: "recording".into(),
            rate_hz: self.rate_hz,
            version: env!("CARGO_PKG_VERSION").into(),
            t_first_ns: self.t_first_ns,
            t_last_ns: self.t_last_ns,
            snapshots: self.snapshots.len() as u64,
            ..SystemStatus::default()
        }
    }
}

impl RecordingBuilder {
    /// Adds a message to the snapshot of its time. A message from before the open snapshots goes
    /// into the first one of them.
    pub fn push(&mut self, t_ns: i64, topic: Topic, bytes: &[u8]) {
        let number = self.snapshot_number(t_ns);
        self.close_snapshots_until(self.snapshot_number(t_ns.saturating_sub(SORTED_NS)));
        if self.open_bytes + bytes.len() > MAX_SORTED_BYTES {
            // Only the newest snapshot remains open.
            self.close_snapshots_until((self.recording.snapshots.len() + self.open.len()).saturating_sub(1));
            self.decimate_first();
        }
        let index = number.saturating_sub(self.recording.snapshots.len());
        if self.open.len() <= index {
            self.open.resize_with(index + 1, SnapshotMessages::default);
        }
        let snapshot = &mut self.open[index];
        snapshot.messages.push((topic, bytes.len()));
        snapshot.bytes.extend_from_slice(bytes);
        self.open_bytes += bytes.len();
    }

    /// Closes the remaining snapshots and returns the recording.
    pub fn finish(mut self) -> Recording {
        self.close_snapshots_until(self.snapshot_number(self.recording.t_last_ns) + 1);
        self.recording
    }

    /// Returns the number of the snapshot that contains a time, at most that of the last snapshot.
    fn snapshot_number(&self, t_ns: i64) -> usize {
        let t_ns = t_ns.min(self.recording.t_last_ns);
        let since_first_ns = u64::try_from(i128::from(t_ns) - i128::from(self.recording.t_first_ns)).unwrap_or(0);
        (since_first_ns / self.interval_ns.unsigned_abs()).min(MAX_SNAPSHOTS) as usize
    }

    /// Closes the snapshots with numbers below `number`.
    fn close_snapshots_until(&mut self, number: usize) {
        while self.recording.snapshots.len() < number {
            self.close_snapshot();
        }
    }

    /// Returns the end of the first open snapshot on the source's clock.
    fn snapshot_end_ns(&self) -> i64 {
        let count = self.recording.snapshots.len() as i64 + 1;
        self.recording.t_first_ns.saturating_add(count.saturating_mul(self.interval_ns))
    }

    fn close_snapshot(&mut self) {
        self.decimate_first();
        self.open.pop_front();
        let end_ns = self.snapshot_end_ns().max(0).cast_unsigned();
        self.recording.snapshots.push(self.decimator.take_snapshot(end_ns).to_bytes());
    }

    /// Passes the messages of the first open snapshot to the decimator.
    fn decimate_first(&mut self) {
        let Some(SnapshotMessages { messages, bytes }) = self.open.front_mut().map(std::mem::take) else { return };
        self.open_bytes -= bytes.len();
        let mut rest = bytes.as_slice();
        for (topic, len) in messages {
            let (message, after) = rest.split_at(len);
            self.decimator.push(topic, message);
            rest = after;
        }
    }
}

#[cfg(test)]
mod tests {
    use messages::{AttitudeOutput, Reference};
    use wire::v1::{Quantity, Snapshot};

    use super::*;

    fn attitude_at(t_ns: i64) -> AttitudeOutput {
        let mut attitude: AttitudeOutput = bytemuck::Zeroable::zeroed();
        attitude.quaternion = [1.0, 0.0, 0.0, 0.0];
        attitude.header.t_end_ns = t_ns;
        attitude
    }

    #[test]
    fn long_recording_lengthens_snapshot_interval() {
        const HOURS_4_NS: i64 = 4 * 3_600_000_000_000;
        let mut builder = Recording::builder("long", 1.0, 0, HOURS_4_NS);
        for t_ns in (0..=HOURS_4_NS).step_by(1_000_000_000) {
            builder.push(t_ns, Topic::Attitude, bytemuck::bytes_of(&attitude_at(t_ns)));
        }
        let recording = builder.finish();
        assert!(recording.snapshots.len() as u64 <= MAX_SNAPSHOTS + 1, "{}", recording.snapshots.len());
        let middle = Snapshot::from_bytes(&recording.snapshots[MAX_SNAPSHOTS as usize / 2]).unwrap();
        let t_ns = middle.attitude.map_or(0, |attitude| attitude.header.unwrap_or_default().t_end_ns);
        assert!((t_ns - HOURS_4_NS / 2).abs() <= HOURS_4_NS / MAX_SNAPSHOTS as i64 + 1_000_000_000 || t_ns == 0);
    }

    #[test]
    fn topic_that_arrives_later_reaches_snapshots_of_its_time() {
        const STEP_NS: i64 = 10_000_000;
        let mut builder = Recording::builder("late", 100.0, 0, 299 * STEP_NS);
        // A second of attitudes arrives before the references of the same ticks.
        for first in [0, 100, 200] {
            let ticks = first..first + 100;
            for tick in ticks.clone() {
                let mut attitude = attitude_at(tick * STEP_NS);
                attitude.header.tick = tick.cast_unsigned();
                builder.push(tick * STEP_NS, Topic::Attitude, bytemuck::bytes_of(&attitude));
            }
            for tick in ticks {
                let mut reference: Reference = bytemuck::Zeroable::zeroed();
                (reference.tick, reference.quaternion) = (tick.cast_unsigned(), [1.0, 0.0, 0.0, 0.0]);
                builder.push(tick * STEP_NS, Topic::Reference, bytemuck::bytes_of(&reference));
            }
        }
        let recording = builder.finish();
        for (number, bytes) in recording.snapshots.iter().enumerate() {
            let snapshot = Snapshot::from_bytes(bytes).unwrap();
            let has_error = snapshot.extremes.iter().any(|range| range.quantity() == Quantity::ErrorRad);
            assert!(has_error, "snapshot {number} of {}", recording.snapshots.len());
            assert!((3..=4).contains(&snapshot.attitudes), "snapshot {number}: {} attitudes", snapshot.attitudes);
        }
    }

    #[test]
    fn messages_of_one_snapshot_are_bounded() {
        let mut builder = Recording::builder("flood", 100.0, 0, 1);
        let message = vec![0; MAX_SORTED_BYTES / 4];
        for _ in 0..8 {
            builder.push(0, Topic::Event, &message);
            assert!(builder.open_bytes <= MAX_SORTED_BYTES, "{}", builder.open_bytes);
        }
        assert_eq!(builder.finish().snapshots.len(), 1);
    }

    #[test]
    fn extreme_times_yield_a_bounded_number_of_snapshots() {
        for (t_first_ns, t_last_ns) in [(0, i64::MAX), (i64::MIN, i64::MAX), (i64::MAX, i64::MAX), (i64::MIN, 0)] {
            let mut builder = Recording::builder("extreme", 100.0, t_first_ns, t_last_ns);
            for t_ns in [t_first_ns, 0, t_last_ns, i64::MIN, i64::MAX] {
                builder.push(t_ns, Topic::Attitude, bytemuck::bytes_of(&attitude_at(t_ns)));
            }
            let count = builder.finish().snapshots.len() as u64;
            assert!((1..=MAX_SNAPSHOTS + 1).contains(&count), "{count}");
        }
    }

    #[test]
    fn snapshots_are_indexed_and_empty_beyond_the_end() {
        let mut builder = Recording::builder("short", 100.0, 0, 1_000_000_000);
        (0..100).for_each(|i| builder.push(i * 10_000_000, Topic::Attitude, bytemuck::bytes_of(&attitude_at(i))));
        let recording = builder.finish();
        assert_eq!(recording.status().snapshots, 31, "one per 33 ms of a second");
        assert!(recording.encode_snapshots(0, usize::MAX).len() > recording.encode_snapshots(30, 10).len());
        assert_eq!(recording.encode_snapshots(31, 1), Vec::<u8>::new());
    }
}
