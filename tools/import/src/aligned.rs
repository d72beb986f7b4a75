//! Force at the times of the rate.
//!
//! Input: samples of both, each in the order of time. Output: every sample of the rate with the force at its time, in order.
//! Time: between two samples that are close to each other, the force is on the line between them; else it is the nearest one,
//! if that is very close. Failure: none; what cannot be used is counted.

use std::collections::VecDeque;

use crate::{ImportError, rows::Rows};

/// Samples further apart say nothing about what was between them, ns.
const LINE_MAX_NS: u64 = 200_000_000;
/// A sample stands for a time no further away than this, ns.
const HOLD_MAX_NS: u64 = 20_000_000;
/// Samples of the rate that wait for a force after them.
const PENDING_MAX: usize = 1024;

pub(crate) type Sample = (i64, [f64; 3]);

#[derive(Default)]
pub(crate) struct Aligned {
    pending: VecDeque<Sample>,
    /// The last two samples of the force.
    before: Option<Sample>,
    last: Option<Sample>,
    last_rate_ns: Option<i64>,
    /// Samples of the rate that are not after the one before them.
    pub(crate) rates_not_after: u64,
    /// The same of the force, without those that are there again.
    pub(crate) forces_not_after: u64,
    /// Samples of the rate with no force near them.
    pub(crate) without_force: u64,
}

impl Aligned {
    /// Takes the next sample of the rate.
    pub(crate) fn rate(&mut self, sample: Sample, rows: &mut Rows) -> Result<(), ImportError> {
        if self.last_rate_ns.is_some_and(|last_ns| sample.0 <= last_ns) {
            self.rates_not_after += 1;
            return Ok(());
        }
        self.last_rate_ns = Some(sample.0);
        self.pending.push_back(sample);
        let is_full = self.pending.len() > PENDING_MAX;
        self.settle(rows, is_full)
    }

    /// Takes the next sample of the force.
    pub(crate) fn force(&mut self, sample: Sample, rows: &mut Rows) -> Result<(), ImportError> {
        match self.last {
            Some(last) if sample == last => return Ok(()),
            Some((last_ns, _)) if sample.0 <= last_ns => {
                self.forces_not_after += 1;
                return Ok(());
            }
            _ => {}
        }
        self.before = self.last.replace(sample);
        self.settle(rows, false)
    }

    /// There are no more samples.
    pub(crate) fn finish(&mut self, rows: &mut Rows) -> Result<(), ImportError> {
        while !self.pending.is_empty() {
            self.settle(rows, true)?;
        }
        Ok(())
    }

    /// Hands over the rates up to the last force, and one more where that must not wait.
    fn settle(&mut self, rows: &mut Rows, mut must: bool) -> Result<(), ImportError> {
        let last_ns = self.last.map(|(last_ns, _)| last_ns);
        while let Some((t_ns, rate)) = self.pending.pop_front_if(|(t_ns, _)| must || Some(*t_ns) <= last_ns) {
            must = false;
            match self.at(t_ns) {
                Some(force) => rows.push(t_ns, rate, force)?,
                None => self.without_force += 1,
            }
        }
        Ok(())
    }

    fn at(&self, t_ns: i64) -> Option<[f64; 3]> {
        let (last_ns, last) = self.last?;
        if let Some((before_ns, before)) = self.before.filter(|(before_ns, _)| (*before_ns..last_ns).contains(&t_ns)) {
            let (since_ns, gap_ns) = (t_ns.abs_diff(before_ns), last_ns.abs_diff(before_ns));
            if since_ns == 0 {
                return Some(before);
            }
            if gap_ns <= LINE_MAX_NS {
                let part = since_ns as f64 / gap_ns as f64;
                return Some([0, 1, 2].map(|axis| before[axis] + part * (last[axis] - before[axis])));
            }
        }
        let near = [self.before, self.last].into_iter().flatten().min_by_key(|(near_ns, _)| near_ns.abs_diff(t_ns));
        near.filter(|(near_ns, _)| near_ns.abs_diff(t_ns) <= HOLD_MAX_NS).map(|(_, force)| force)
    }
}
