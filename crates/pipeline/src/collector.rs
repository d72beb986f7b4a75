//! What becomes of the attitude: its order, its accuracy against the truth, its latency, and the file it is written to.

use std::{collections::VecDeque, io, path::PathBuf};

use attitude::{
    Quaternion,
    metrics::{Accuracy, AttitudeError},
};
use hdrhistogram::{CreationError, Histogram};
use messages::{AttitudeOutput, Flags, FusedState, HASH_START, Reference, Ticked, hash};
use runtime::Sequence;

use crate::{columns::OutFile, lines::Lines};

/// References kept for attitudes that are still on the way: twice what a topic holds.
const MAX_PENDING: usize = 2 * launch::MAX_TOPIC_MESSAGES;

/// What is later than this is counted as this late, ns.
const MAX_LATENCY_NS: u64 = 3_600_000_000_000;

/// Why attitudes are not collected, or their file is not whole.
#[derive(Debug, thiserror::Error)]
pub enum CollectorError {
    /// There can be no histogram of the latency.
    #[error("counting latencies: {0}")]
    Histogram(#[from] CreationError),
    /// The file cannot be made.
    #[error("writing {path}: {cause}")]
    Create {
        /// The file.
        path: PathBuf,
        /// What the system answered.
        cause: io::Error,
    },
    /// The file can be written no more.
    #[error(
        "writing {path}: {cause}; the file ends before its time, with a whole line, and nothing else does: make room, or give --out another place"
    )]
    Ends {
        /// The file.
        path: PathBuf,
        /// What the system answered.
        cause: io::Error,
    },
}

/// Takes the attitudes of a run.
pub struct Collector {
    sequence: Sequence,
    pending: VecDeque<Reference>,
    latency_ns: Histogram<u64>,
    accuracy: Accuracy,
    digest: u64,
    flags: Flags,
    last: Option<AttitudeOutput>,
    /// Since it was asked for last: the longest time between two publications.
    gap_ns: u64,
    /// The last tick at which a stage was swapped for another kind, and by how much the attitude jumped there, rad.
    swapped: Option<(u64, f64)>,
    not_recorded: u64,
    out: Option<Lines>,
    /// Lines of the file without their fused state, once it has ended.
    without_fused: u64,
    /// Why nothing more is written to it.
    out_ended: Option<CollectorError>,
}

impl Collector {
    /// Writes to `out`, if there is one.
    pub fn new(out: Option<&OutFile>) -> Result<Self, CollectorError> {
        Ok(Self {
            sequence: Sequence::default(),
            pending: VecDeque::new(),
            latency_ns: Histogram::new_with_max(MAX_LATENCY_NS, 3)?,
            accuracy: Accuracy::default(),
            digest: HASH_START,
            flags: Flags::NONE,
            last: None,
            gap_ns: 0,
            swapped: None,
            not_recorded: 0,
            out: out.map(Lines::create).transpose()?,
            without_fused: 0,
            out_ended: None,
        })
    }

    /// Takes the truth at a tick; before the attitude of that tick.
    pub fn reference(&mut self, reference: Reference) {
        if self.pending.len() < MAX_PENDING {
            self.pending.push_back(reference);
        }
    }

    /// Neither the truth at this tick nor that at a later one has been taken.
    pub fn lacks_reference(&self, tick: u64) -> bool {
        self.pending.back().is_none_or(|newest| newest.tick < tick)
    }

    /// Takes the attitude at a tick. A file that cannot be written any more costs nothing but the file.
    pub fn attitude(&mut self, output: &AttitudeOutput) {
        let header = output.header;
        let Some(missing) = self.sequence.admit(&header) else { return };
        let lost_before = self.last.map_or(0, |last| last.header.lost_upstream);
        self.not_recorded += missing - header.lost_upstream.saturating_sub(lost_before).min(missing);
        self.latency_ns.saturating_record(header.t_sent_ns.saturating_sub(header.t_born_ns));
        self.flags |= header.flags;
        self.digest = hash(self.digest, bytemuck::bytes_of(&output.canonical()));
        while self.pending.front().is_some_and(|reference| reference.tick < header.tick) {
            self.pending.pop_front();
        }
        let reference = self.pending.pop_front_if(|reference| reference.tick == header.tick);
        if let Some(reference) = reference.filter(|reference| reference.scored != 0) {
            self.accuracy.add(AttitudeError::between(quaternion(output.quaternion), quaternion(reference.quaternion)));
        }
        if let Some(before) = self.last {
            self.gap_ns = self.gap_ns.max(header.t_sent_ns.saturating_sub(before.header.t_sent_ns));
            if header.flags.any(Flags::SWAPPED) {
                let jumped = (output.reset_counter, output.jump) != (before.reset_counter, before.jump);
                let angle_rad = 2.0 * output.jump[0].abs().min(1.0).acos();
                self.swapped = Some((header.tick, if jumped { angle_rad } else { 0.0 }));
            }
        }
        self.last = Some(*output);
        self.write(|out| out.attitude(output));
    }

    /// Takes the fused state at a tick, for a file that has it.
    pub fn fused(&mut self, state: &FusedState) {
        self.write(|out| out.fused(state));
    }

    fn write(&mut self, write: impl FnOnce(&mut Lines) -> Result<(), CollectorError>) {
        if let Some(Err(error)) = self.out.as_mut().map(write) {
            (self.out, self.out_ended) = (None, Some(error));
        }
    }

    /// The run is at its end: the file has every attitude that was taken, or the error says why not.
    pub fn finish(&mut self) -> Result<(), CollectorError> {
        let (without_fused, written) = self.out.take().map_or((0, Ok(())), Lines::finish);
        self.without_fused = without_fused;
        self.out_ended.take().map_or(written, Err)
    }

    /// Lines of the file that lack their fused state: it was not taken while its topic held it.
    pub fn without_fused(&self) -> u64 {
        self.out.as_ref().map_or(self.without_fused, Lines::without_fused)
    }

    /// Why nothing more is written to the file.
    pub fn out_ended(&self) -> Option<&CollectorError> {
        self.out_ended.as_ref()
    }

    /// Attitudes taken.
    pub fn ticks(&self) -> u64 {
        self.sequence.ticks
    }

    /// The tick that comes next when nothing is lost.
    pub fn next_tick(&self) -> u64 {
        self.sequence.next_tick
    }

    /// Ticks before it that have no attitude.
    pub fn lost(&self) -> u64 {
        self.sequence.lost - self.not_recorded
    }

    /// Ticks before it whose attitudes were published and not taken while the topic held them.
    pub fn not_recorded(&self) -> u64 {
        self.not_recorded
    }

    /// Attitudes that came again.
    pub fn duplicated(&self) -> u64 {
        self.sequence.duplicated
    }

    /// From birth at ingest to publication of the attitude, ns.
    pub fn latency_ns(&self) -> &Histogram<u64> {
        &self.latency_ns
    }

    /// Accuracy against the truth.
    pub fn accuracy(&self) -> &Accuracy {
        &self.accuracy
    }

    /// A number that two runs share when every attitude was the same to the last bit.
    pub fn digest(&self) -> u64 {
        self.digest
    }

    /// Every flag of any attitude.
    pub fn flags(&self) -> Flags {
        self.flags
    }

    /// The longest time between two publications since this was asked last, ns.
    pub fn take_gap_ns(&mut self) -> u64 {
        std::mem::take(&mut self.gap_ns)
    }

    /// The last tick at which a stage of another kind took over, and by how much the attitude jumped there, rad.
    pub fn swapped(&self) -> Option<(u64, f64)> {
        self.swapped
    }

    /// The newest attitude.
    pub fn last(&self) -> Option<&AttitudeOutput> {
        self.last.as_ref()
    }
}

fn quaternion([w, x, y, z]: [f64; 4]) -> Quaternion<f64> {
    Quaternion::new(w, x, y, z)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use bytemuck::Zeroable;

    use super::*;

    #[test]
    fn references_wait_for_their_attitudes_up_to_a_limit() {
        let mut collector = Collector::new(None).unwrap();
        assert!(collector.lacks_reference(0));
        for tick in 0..MAX_PENDING as u64 + 10 {
            collector.reference(Reference { tick, ..Reference::zeroed() });
        }
        assert_eq!(collector.pending.len(), MAX_PENDING);
        let newest = MAX_PENDING as u64 - 1;
        assert_eq!([newest, newest + 1].map(|tick| collector.lacks_reference(tick)), [false, true]);
    }
}
