//! What becomes of the attitude: its order, its accuracy against the truth, its latency, and the file it is written to.

use std::{collections::VecDeque, path::Path};

use attitude::{
    Quaternion,
    metrics::{Accuracy, AttitudeError},
};
use hdrhistogram::Histogram;
use messages::{AttitudeOutput, Flags, HASH_START, Reference, Ticked, hash};
use runtime::Sequence;
use serde::{Deserialize, Serialize};

use crate::{UpError, out::Out};

/// References kept for attitudes that are still on the way.
const PENDING_MAX: usize = 1 << 20;

/// What is later than this is counted as this late, ns.
const LATENCY_MAX_NS: u64 = 3_600_000_000_000;

/// What the report of a running system and its file lack, for whoever asks.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Record {
    /// Attitudes that were published and not taken.
    pub not_recorded: u64,
    /// Why nothing more is written to the file.
    pub out_ended: Option<String>,
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
    /// The last tick at which a stage was exchanged for another kind, and by how much the attitude jumped there, rad.
    exchanged: Option<(u64, f64)>,
    not_recorded: u64,
    out: Option<Out>,
    /// Why nothing more is written to it.
    out_ended: Option<UpError>,
}

impl Collector {
    /// Writes to `out`, if there is one.
    pub fn new(out: Option<&Path>) -> Result<Self, UpError> {
        Ok(Self {
            sequence: Sequence::default(),
            pending: VecDeque::new(),
            latency_ns: Histogram::new_with_max(LATENCY_MAX_NS, 3).map_err(|cause| UpError::System {
                doing: "making a histogram".into(),
                cause: std::io::Error::other(cause.to_string()),
            })?,
            accuracy: Accuracy::default(),
            digest: HASH_START,
            flags: Flags::NONE,
            last: None,
            gap_ns: 0,
            exchanged: None,
            not_recorded: 0,
            out: out.map(Out::create).transpose()?,
            out_ended: None,
        })
    }

    /// Takes the truth at a tick; before the attitude of that tick.
    pub fn reference(&mut self, reference: Reference) {
        if self.pending.len() < PENDING_MAX {
            self.pending.push_back(reference);
        }
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
            if header.flags.any(Flags::EXCHANGED) {
                let jumped = (output.reset_counter, output.jump) != (before.reset_counter, before.jump);
                let angle_rad = 2.0 * output.jump[0].abs().min(1.0).acos();
                self.exchanged = Some((header.tick, if jumped { angle_rad } else { 0.0 }));
            }
        }
        self.last = Some(*output);
        if let Some(Err(error)) = self.out.as_mut().map(|out| out.write(output)) {
            (self.out, self.out_ended) = (None, Some(error));
        }
    }

    /// The run is at its end: the file has every attitude that was taken, or the error says why not.
    pub fn finish(&mut self) -> Result<(), UpError> {
        let unwritten = self.out.take().and_then(|mut out| out.flush().err());
        self.out_ended.take().or(unwritten).map_or(Ok(()), Err)
    }

    /// Why nothing more is written to the file.
    pub fn out_ended(&self) -> Option<&UpError> {
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

    /// What the report and the file lack by now.
    pub(crate) fn record(&self) -> Record {
        Record { not_recorded: self.not_recorded, out_ended: self.out_ended.as_ref().map(UpError::to_string) }
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

    /// By how much the attitude jumped where another stage took over, rad.
    pub fn jump_rad(&self, commit_tick: u64) -> f64 {
        self.exchanged.filter(|(tick, _)| *tick == commit_tick).map_or(0.0, |(_, jump_rad)| jump_rad)
    }

    /// The newest attitude.
    pub fn last(&self) -> Option<&AttitudeOutput> {
        self.last.as_ref()
    }
}

fn quaternion([w, x, y, z]: [f64; 4]) -> Quaternion<f64> {
    Quaternion::new(w, x, y, z)
}
