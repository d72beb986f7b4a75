//! Evaluates the order, accuracy and latency of a run's attitudes, and writes the attitudes to a
//! file.

use std::collections::VecDeque;

use attitude::{
    Quaternion,
    metrics::{Accuracy, AttitudeError},
};
use hdrhistogram::Histogram;
use messages::{AttitudeOutput, Flags, FusedState, HASH_START, Reference, Ticked, hash_words};
use runtime::Sequence;

use crate::{
    attitude_file::{AttitudeFile, AttitudeLines},
    error::CollectorError,
};

/// Maximum number of references held until their attitudes arrive. It is twice the capacity of a
/// topic.
const MAX_PENDING: usize = 2 * launch::MAX_TOPIC_MESSAGES;

/// Largest latency recorded, ns. Larger latencies are counted as this value.
const MAX_LATENCY_NS: u64 = 3_600_000_000_000;

/// Collector of the attitudes of a run.
pub struct Collector {
    sequence: Sequence,
    pending: VecDeque<Reference>,
    latency_ns: Histogram<u64>,
    accuracy: Accuracy,
    digest: u64,
    flags: Flags,
    last: Option<AttitudeOutput>,
    /// Longest interval in ns between two publications since the last call of `take_gap_ns`.
    gap_ns: u64,
    /// Tick of the last swap to another stage, and the attitude jump in rad at that tick.
    last_swap: Option<(u64, f64)>,
    not_recorded: u64,
    lines: Option<AttitudeLines>,
    /// Number of lines without a fused state, once the file is finished.
    lines_without_fused: u64,
    /// Write error that ended the file early.
    file_error: Option<CollectorError>,
}

impl Collector {
    /// Creates a collector that writes to `file`, if given.
    ///
    /// # Errors
    ///
    /// Returns an error if the file cannot be created.
    pub fn new(file: Option<&AttitudeFile>) -> Result<Self, CollectorError> {
        Ok(Self {
            sequence: Sequence::default(),
            pending: VecDeque::new(),
            latency_ns: Histogram::new_with_max(MAX_LATENCY_NS, 3)?,
            accuracy: Accuracy::default(),
            digest: HASH_START,
            flags: Flags::NONE,
            last: None,
            gap_ns: 0,
            last_swap: None,
            not_recorded: 0,
            lines: file.map(AttitudeLines::create).transpose()?,
            lines_without_fused: 0,
            file_error: None,
        })
    }

    /// Records the reference of a tick. Call it before the attitude of that tick is recorded.
    pub fn record_reference(&mut self, reference: Reference) {
        if self.pending.len() < MAX_PENDING {
            self.pending.push_back(reference);
        }
    }

    /// Returns `true` if no reference of this tick or a later one has been recorded.
    pub fn awaits_reference(&self, tick: u64) -> bool {
        self.pending.back().is_none_or(|newest| newest.tick < tick)
    }

    /// Records the attitude of a tick. A write error ends only the file, not the run; see
    /// [`Collector::file_error`].
    pub fn record_attitude(&mut self, output: &AttitudeOutput) {
        let header = output.header;
        let Some(missing) = self.sequence.admit(&header) else { return };
        let lost_before = self.last.map_or(0, |last| last.header.lost_upstream);
        self.not_recorded += missing - header.lost_upstream.saturating_sub(lost_before).min(missing);
        self.latency_ns.saturating_record(header.t_sent_ns.saturating_sub(header.t_born_ns));
        self.flags |= header.flags;
        self.digest = hash_words(self.digest, bytemuck::cast_slice(std::slice::from_ref(&output.canonical())));
        while self.pending.front().is_some_and(|reference| reference.tick < header.tick) {
            self.pending.pop_front();
        }
        let reference = self.pending.pop_front_if(|reference| reference.tick == header.tick);
        if let Some(reference) = reference.filter(|reference| reference.scored != 0) {
            self.accuracy.add(AttitudeError::between(compared_attitude(output), quaternion(reference.quaternion)));
        }
        if let Some(previous) = self.last {
            self.gap_ns = self.gap_ns.max(header.t_sent_ns.saturating_sub(previous.header.t_sent_ns));
            if header.flags.any(Flags::SWAPPED) {
                let has_jump = (output.reset_counter, output.jump) != (previous.reset_counter, previous.jump);
                let angle_rad = 2.0 * output.jump[0].abs().min(1.0).acos();
                self.last_swap = Some((header.tick, if has_jump { angle_rad } else { 0.0 }));
            }
        }
        self.last = Some(*output);
        self.write(|lines| lines.push_attitude(output));
    }

    /// Records the fused state of a tick, for a file that includes its columns.
    pub fn record_fused(&mut self, state: &FusedState) {
        self.write(|lines| lines.push_fused(state));
    }

    fn write(&mut self, write: impl FnOnce(&mut AttitudeLines) -> Result<(), CollectorError>) {
        if let Some(Err(error)) = self.lines.as_mut().map(write) {
            (self.lines, self.file_error) = (None, Some(error));
        }
    }

    /// Finishes the file.
    ///
    /// # Errors
    ///
    /// Returns an error if not all recorded attitudes could be written.
    pub fn finish(&mut self) -> Result<(), CollectorError> {
        let (without_fused, written) = self.lines.take().map_or((0, Ok(())), AttitudeLines::finish);
        self.lines_without_fused = without_fused;
        self.file_error.take().map_or(written, Err)
    }

    /// Returns the number of lines for which no fused state was received.
    pub fn lines_without_fused(&self) -> u64 {
        self.lines.as_ref().map_or(self.lines_without_fused, AttitudeLines::lines_without_fused)
    }

    /// Returns the write error that ended the file early, if any.
    pub fn file_error(&self) -> Option<&CollectorError> {
        self.file_error.as_ref()
    }

    /// Returns the number of attitudes recorded.
    pub fn ticks(&self) -> u64 {
        self.sequence.ticks
    }

    /// Returns the next expected tick.
    pub fn next_tick(&self) -> u64 {
        self.sequence.next_tick
    }

    /// Returns the number of ticks so far for which no attitude was published.
    pub fn lost(&self) -> u64 {
        self.sequence.lost - self.not_recorded
    }

    /// Returns the number of attitudes that were published but not received in time.
    pub fn not_recorded(&self) -> u64 {
        self.not_recorded
    }

    /// Returns the number of attitudes received more than once.
    pub fn duplicated(&self) -> u64 {
        self.sequence.duplicated
    }

    /// Returns the latencies in ns from reception at ingest to publication of the attitude.
    pub fn latency_ns(&self) -> &Histogram<u64> {
        &self.latency_ns
    }

    /// Returns the accuracy against the reference attitude.
    pub fn accuracy(&self) -> &Accuracy {
        &self.accuracy
    }

    /// Returns a hash of all attitudes. Two runs have the same hash if their attitudes are
    /// bit-identical.
    pub fn digest(&self) -> u64 {
        self.digest
    }

    /// Returns the union of the flags of all attitudes.
    pub fn flags(&self) -> Flags {
        self.flags
    }

    /// Returns and resets the longest interval between two publications, ns.
    pub fn take_gap_ns(&mut self) -> u64 {
        std::mem::take(&mut self.gap_ns)
    }

    /// Returns the tick of the last swap to another stage, and the attitude jump in rad at that
    /// tick.
    pub fn last_swap(&self) -> Option<(u64, f64)> {
        self.last_swap
    }

    /// Returns the newest attitude.
    pub fn last(&self) -> Option<&AttitudeOutput> {
        self.last.as_ref()
    }
}

/// Returns the attitude that is compared with a reference.
///
/// If the declination was added to the course, the reference is relative to true north, and the
/// attitude is rotated accordingly.
pub fn compared_attitude(output: &AttitudeOutput) -> Quaternion<f64> {
    let (sin, cos) = (-0.5 * output.declination_rad).sin_cos();
    Quaternion::new(cos, 0.0, 0.0, sin) * quaternion(output.quaternion)
}

fn quaternion([w, x, y, z]: [f64; 4]) -> Quaternion<f64> {
    Quaternion::new(w, x, y, z)
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;

    use super::*;

    #[test]
    fn pending_references_are_bounded() {
        let mut collector = Collector::new(None).unwrap();
        assert!(collector.awaits_reference(0));
        for tick in 0..MAX_PENDING as u64 + 10 {
            collector.record_reference(Reference { tick, ..Reference::zeroed() });
        }
        assert_eq!(collector.pending.len(), MAX_PENDING);
        let newest = MAX_PENDING as u64 - 1;
        assert_eq!([newest, newest + 1].map(|tick| collector.awaits_reference(tick)), [false, true]);
    }
}
