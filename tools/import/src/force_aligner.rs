//! Interpolates the force at the times of the rate samples.
//!
//! Input: samples of rate and force, each in time order.
//!
//! Output: every rate sample with the force interpolated at its time, in time order.
//!
//! Time: between two force samples that are close in time, the force is interpolated linearly.
//! Otherwise, the nearest sample is used if it is very close in time.
//!
//! Failure: unusable samples are skipped and counted.

use std::collections::VecDeque;

use crate::{
    ImportError,
    row_writer::{RowWriter, Sample},
};

/// Maximum gap in ns between two force samples across which the force is interpolated.
const MAX_INTERPOLATION_GAP_NS: u64 = 200_000_000;
/// Maximum time between a rate sample and the nearest force sample, ns. If interpolation is not
/// possible, the nearest force is used unchanged up to this limit.
const MAX_HOLD_NS: u64 = 20_000_000;
/// Maximum number of rate samples waiting for a later force sample.
const MAX_PENDING: usize = 1024;

#[derive(Default)]
pub(crate) struct ForceAligner {
    pending: VecDeque<Sample>,
    /// Force sample that precedes `last_force`.
    previous_force: Option<Sample>,
    last_force: Option<Sample>,
    last_rate_ns: Option<i64>,
    /// Number of rate samples with non-increasing timestamps.
    pub(crate) rates_out_of_order: u64,
    /// Number of force samples with non-increasing timestamps. Exact repetitions are not counted.
    pub(crate) forces_out_of_order: u64,
    /// Number of rate samples for which no force sample is close enough.
    pub(crate) rates_without_force: u64,
}

impl ForceAligner {
    /// Adds the next rate sample.
    pub(crate) fn push_rate(&mut self, sample: Sample, rows: &mut RowWriter) -> Result<(), ImportError> {
        if self.last_rate_ns.is_some_and(|last_ns| sample.0 <= last_ns) {
            self.rates_out_of_order += 1;
            return Ok(());
        }
        self.last_rate_ns = Some(sample.0);
        self.pending.push_back(sample);
        let is_full = self.pending.len() > MAX_PENDING;
        self.release(rows, is_full)
    }

    /// Adds the next force sample.
    pub(crate) fn push_force(&mut self, sample: Sample, rows: &mut RowWriter) -> Result<(), ImportError> {
        match self.last_force {
            Some(last) if sample == last => return Ok(()),
            Some((last_ns, _)) if sample.0 <= last_ns => {
                self.forces_out_of_order += 1;
                return Ok(());
            }
            _ => {}
        }
        self.previous_force = self.last_force.replace(sample);
        self.release(rows, false)
    }

    /// Writes the rate samples that remain after the last force sample.
    pub(crate) fn finish(&mut self, rows: &mut RowWriter) -> Result<(), ImportError> {
        while !self.pending.is_empty() {
            self.release(rows, true)?;
        }
        Ok(())
    }

    /// Writes the rate samples up to the time of the last force sample. If `must_release_one` is
    /// set, at least one sample is written.
    fn release(&mut self, rows: &mut RowWriter, mut must_release_one: bool) -> Result<(), ImportError> {
        let last_ns = self.last_force.map(|(last_ns, _)| last_ns);
        while let Some((t_ns, rate)) = self.pending.pop_front_if(|(t_ns, _)| must_release_one || Some(*t_ns) <= last_ns)
        {
            must_release_one = false;
            match self.force_at(t_ns) {
                Some(force) => rows.push(t_ns, rate, force)?,
                None => self.rates_without_force += 1,
            }
        }
        Ok(())
    }

    /// Returns the force at a time; `None` if no sample is close enough.
    fn force_at(&self, t_ns: i64) -> Option<[f64; 3]> {
        let (last_ns, last) = self.last_force?;
        if let Some((before_ns, before)) =
            self.previous_force.filter(|(before_ns, _)| (*before_ns..last_ns).contains(&t_ns))
        {
            let (since_ns, gap_ns) = (t_ns.abs_diff(before_ns), last_ns.abs_diff(before_ns));
            if since_ns == 0 {
                return Some(before);
            }
            if gap_ns <= MAX_INTERPOLATION_GAP_NS {
                let fraction = since_ns as f64 / gap_ns as f64;
                return Some([0, 1, 2].map(|axis| before[axis] + fraction * (last[axis] - before[axis])));
            }
        }
        let near = [self.previous_force, self.last_force]
            .into_iter()
            .flatten()
            .min_by_key(|(near_ns, _)| near_ns.abs_diff(t_ns));
        near.filter(|(near_ns, _)| near_ns.abs_diff(t_ns) <= MAX_HOLD_NS).map(|(_, force)| force)
    }
}
