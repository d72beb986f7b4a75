//! Summarises a complete recording.

use crate::{Reader, RecordingError, Row};
use std::path::Path;

/// Maximum number of intervals used for the median. It limits the memory needed.
const MAX_INTERVALS: usize = 100_000;

/// Summary of a recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Survey {
    /// Number of rows.
    pub rows: u64,
    /// Sampling rate, Hz. It is the inverse of the median of the first 100,000 positive intervals,
    /// times the number of samples per stamp. A coarse clock gives several samples the same stamp.
    pub rate_hz: f64,
    /// `true` if any row has a reference attitude.
    pub has_reference: bool,
}

/// Reads a complete recording and summarises it. This also detects malformed lines early.
///
/// # Errors
///
/// Returns an error if the file cannot be opened, any line is malformed, or the time never
/// increases.
pub fn survey(path: &Path) -> Result<Survey, RecordingError> {
    let (mut rows, mut has_reference) = (0, false);
    let mut intervals_ns = Vec::new();
    let (mut samples, mut stamps) = (0u64, 0u64);
    let mut previous: Option<Row> = None;
    for row in Reader::open(path)? {
        let row = row?;
        rows += 1;
        has_reference |= row.reference.is_some();
        let Some(previous) = previous.replace(row) else { continue };
        let is_new_stamp = row.t_ns != previous.t_ns;
        let is_repeated_row =
            !is_new_stamp && row.rate_rad_s == previous.rate_rad_s && row.force_m_s2 == previous.force_m_s2;
        samples += u64::from(!is_repeated_row);
        stamps += u64::from(is_new_stamp);
        if row.t_ns > previous.t_ns && intervals_ns.len() < MAX_INTERVALS {
            intervals_ns.push(row.t_ns.abs_diff(previous.t_ns));
        }
    }
    if intervals_ns.is_empty() {
        return Err(RecordingError::NoInterval { path: path.to_owned(), rows });
    }
    let middle = intervals_ns.len() / 2;
    let (_, &mut median_ns, _) = intervals_ns.select_nth_unstable(middle);
    let samples_per_stamp = samples as f64 / stamps as f64;
    Ok(Survey { rows, rate_hz: 1e9 / median_ns as f64 * samples_per_stamp, has_reference })
}
