//! What becomes of the attitude: its order, its accuracy against the truth, its latency, and the file it is written to.

use std::{
    collections::VecDeque,
    fs::{self, File},
    io::{self, BufWriter, Write},
    os::unix::fs::FileTypeExt,
    path::{Path, PathBuf},
};

use attitude::{
    Quaternion,
    metrics::{Accuracy, AttitudeError},
};
use hdrhistogram::Histogram;
use messages::{AttitudeOutput, Flags, HASH_START, Reference, Ticked, hash};
use runtime::Sequence;

use crate::UpError;

/// References kept for attitudes that are still on the way.
const PENDING_MAX: usize = 1 << 20;

/// What is later than this is counted as this late, ns.
const LATENCY_MAX_NS: u64 = 3_600_000_000_000;

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
    out: Option<Csv>,
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
            out: out.map(Csv::create).transpose()?,
        })
    }

    /// Takes the truth at a tick; before the attitude of that tick.
    pub fn reference(&mut self, reference: Reference) {
        if self.pending.len() < PENDING_MAX {
            self.pending.push_back(reference);
        }
    }

    /// Takes the attitude at a tick.
    pub fn attitude(&mut self, output: &AttitudeOutput) -> Result<(), UpError> {
        let header = output.header;
        if self.sequence.admit(&header).is_none() {
            return Ok(());
        }
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
        match &mut self.out {
            Some(out) => out.write(output),
            None => Ok(()),
        }
    }

    /// The run is at its end: what was written is on the disk.
    pub fn finish(&mut self) -> Result<(), UpError> {
        self.out.as_mut().map_or(Ok(()), Csv::finish)
    }

    /// The stream of attitudes.
    pub fn sequence(&self) -> &Sequence {
        &self.sequence
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

/// `t_s,qw,qx,qy,qz`, one line per tick, every number with all its digits.
struct Csv {
    path: PathBuf,
    file: BufWriter<File>,
}

impl Csv {
    fn create(path: &Path) -> Result<Self, UpError> {
        let failed = |cause| UpError::Out { path: path.into(), cause };
        // A pipe would hold up the run for as long as its reader pleases.
        if fs::metadata(path).is_ok_and(|at_path| at_path.file_type().is_fifo()) {
            return Err(failed(io::Error::other("it is a pipe; name a file")));
        }
        let mut file = BufWriter::new(File::create(path).map_err(failed)?);
        writeln!(file, "t_s,qw,qx,qy,qz").map_err(failed)?;
        Ok(Self { path: path.into(), file })
    }

    fn write(&mut self, output: &AttitudeOutput) -> Result<(), UpError> {
        let t_ns = output.header.t_end_ns;
        let sign = if t_ns < 0 { "-" } else { "" };
        let (s, ns) = (t_ns.unsigned_abs() / 1_000_000_000, t_ns.unsigned_abs() % 1_000_000_000);
        let [w, x, y, z] = output.quaternion;
        writeln!(self.file, "{sign}{s}.{ns:09},{w},{x},{y},{z}").map_err(|cause| self.failed(cause))
    }

    fn finish(&mut self) -> Result<(), UpError> {
        self.file.flush().map_err(|cause| self.failed(cause))
    }

    fn failed(&self, cause: std::io::Error) -> UpError {
        UpError::Out { path: self.path.clone(), cause }
    }
}
