//! What becomes of the attitude: its order, its accuracy against the truth, its latency, and the file it is written to.

use std::{
    collections::VecDeque,
    fs::{self, File},
    io::{self, BufWriter, Write},
    os::unix::fs::FileTypeExt,
    path::{Path, PathBuf},
};

use attitude::Quaternion;
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
    error: InclinationError,
    digest: u64,
    flags: Flags,
    last: Option<AttitudeOutput>,
    out: Option<Csv>,
}

/// Inclination of the estimate against the truth, degrees.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct InclinationError {
    count: u64,
    sum_deg2: f64,
    /// The largest.
    pub max_deg: f64,
    /// The last.
    pub now_deg: f64,
}

impl InclinationError {
    /// Root of the mean square; `None` without a single reference.
    pub fn rmse_deg(&self) -> Option<f64> {
        (self.count > 0).then(|| (self.sum_deg2 / self.count as f64).sqrt())
    }

    fn add(&mut self, error_deg: f64) {
        self.count += 1;
        self.sum_deg2 += error_deg * error_deg;
        self.max_deg = self.max_deg.max(error_deg);
        self.now_deg = error_deg;
    }
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
            error: InclinationError::default(),
            digest: HASH_START,
            flags: Flags::NONE,
            last: None,
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
        if self.sequence.admit(header.tick).is_none() {
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
            self.error.add(inclination_error_deg(output.quaternion, reference.quaternion));
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
    pub fn error(&self) -> &InclinationError {
        &self.error
    }

    /// A number that two runs share when every attitude was the same to the last bit.
    pub fn digest(&self) -> u64 {
        self.digest
    }

    /// Every flag of any attitude.
    pub fn flags(&self) -> Flags {
        self.flags
    }

    /// The newest attitude.
    pub fn last(&self) -> Option<&AttitudeOutput> {
        self.last.as_ref()
    }
}

/// Angle between the up vectors: 2 acos √(e_w² + e_z²) of e = q_est q_ref*, degrees (Laidig 2021).
fn inclination_error_deg(estimate: [f64; 4], truth: [f64; 4]) -> f64 {
    let quaternion = |[w, x, y, z]: [f64; 4]| Quaternion::new(w, x, y, z);
    let e = quaternion(estimate) * quaternion(truth).conjugate();
    (2.0 * e.i.hypot(e.j).atan2(e.w.hypot(e.k))).to_degrees()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heading_does_not_count_as_inclination() {
        let half = 0.3f64;
        let tilt = [half.cos(), half.sin(), 0.0, 0.0];
        let turn = [half.cos(), 0.0, 0.0, half.sin()];
        assert!((inclination_error_deg(tilt, [1.0, 0.0, 0.0, 0.0]) - 0.6f64.to_degrees()).abs() < 1e-12);
        assert_eq!(inclination_error_deg(turn, [1.0, 0.0, 0.0, 0.0]), 0.0);
    }
}
