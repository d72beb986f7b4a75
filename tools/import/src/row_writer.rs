//! Writes the rows of a recording, with magnetic field and reference merged in by time.
//!
//! Input: rate and force row by row; magnetic field and reference samples in time order.
//!
//! Output: the recording.
//!
//! Time: each magnetic field sample is written to the nearest row only. The reference is
//! interpolated between two samples that are close in time.
//!
//! Failure: an error if the output cannot be written, or if the magnetic field or reference cannot
//! be read.

use std::iter::Peekable;

use recording::{Reference, Row, Writer, rotated};

use crate::ImportError;

/// Time in ns and vector of a sample.
pub(crate) type Sample = (i64, [f64; 3]);

/// Maximum time between a magnetic field sample and its row, ns.
const MAX_FIELD_DISTANCE_NS: u64 = 50_000_000;
/// Maximum gap in ns between two reference attitudes across which the reference is always
/// interpolated.
const MAX_REFERENCE_GAP_NS: u64 = 60_000_000;
/// Maximum gap in ns across which a slow reference is interpolated.
///
/// A reference is slow if its gaps are longer than [`MAX_REFERENCE_GAP_NS`]. It is interpolated
/// only if the rotation during the gap is small. The limit allows for references at 1 Hz.
const MAX_SLOW_REFERENCE_GAP_NS: u64 = 1_100_000_000;
/// Cosine of half the largest rotation (5°) for which a slow reference is interpolated.
const MIN_HALF_ROTATION_COS: f64 = 0.999_048_221_581_857_8;
/// Maximum number of attitudes that are read to determine whether a reference is slow and calm.
const MAX_JUDGED_ATTITUDES: usize = 10_000;
/// Minimum number of attitudes for recognising a reference that is not slow.
const MIN_JUDGED_ATTITUDES: usize = 100;
/// Maximum share of large rotations in a slow reference that is interpolated.
///
/// If the share is larger, only the calm parts of the motion could be interpolated, and these parts
/// would dominate the error statistics.
const MAX_LARGE_ROTATION_SHARE: f64 = 0.01;
/// Maximum number of row intervals from which the median interval is computed.
const MAX_MEDIAN_INTERVALS: usize = 100_000;
/// Threshold for the value of 1 − cos(θ/2), where θ is the angle between two attitudes. Below the
/// threshold, slerp is replaced by linear interpolation.
const SMALL_ANGLE_ONE_MINUS_COS: f64 = 1e-9;

/// Attitude with its time, in native axes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Attitude {
    /// Time, ns.
    pub(crate) t_ns: i64,
    pub(crate) reference: Reference,
    /// Number of attitude resets made by the estimator.
    ///
    /// The reference is interpolated only between attitudes whose counters are equal, and never if
    /// the counter is `None`.
    pub(crate) reset_counter: Option<u8>,
}

/// Samples of a series that is merged into the rows.
pub(crate) type Samples<'a, T> = Box<dyn Iterator<Item = Result<T, ImportError>> + 'a>;

/// Minimum number of equal magnetic field samples for a magnetometer to count as dead. The samples
/// of a working magnetometer vary, because its noise exceeds its resolution.
const MIN_CONSTANT_FIELDS: u64 = 500;

pub(crate) struct RowWriter<'a> {
    writer: Writer,
    fields: Peekable<Samples<'a, Sample>>,
    last_field_ns: Option<i64>,
    attitudes: Peekable<Samples<'a, Attitude>>,
    /// `true` if a slow reference is interpolated. Otherwise, it is used only at the times of its
    /// samples.
    interpolates_slow: bool,
    /// Newest attitude before the current row.
    previous_attitude: Option<Attitude>,
    /// Last row. It is held back because a later magnetic field sample may be nearest to this row.
    pending: Option<Row>,
    /// Time between the pending row and its magnetic field sample, ns.
    pending_distance_ns: u64,
    intervals_ns: Vec<u64>,
    force_sum_m_s2: f64,
    first_ns: Option<i64>,
    last_ns: i64,
    pub(crate) rows: u64,
    pub(crate) field_rows: u64,
    field_log_sum: f64,
    first_field: Option<[f64; 3]>,
    /// `true` once a magnetic field has differed from the first one.
    field_varies: bool,
    pub(crate) reference_rows: u64,
    /// Number of magnetic field samples with non-increasing timestamps.
    pub(crate) fields_out_of_order: u64,
    /// Number of magnetic field samples discarded because no row was near enough in time, or
    /// because another sample was nearer to the row.
    pub(crate) fields_unmatched: u64,
    /// Number of attitudes with non-increasing timestamps.
    pub(crate) attitudes_out_of_order: u64,
}

impl<'a> RowWriter<'a> {
    /// Creates a writer. `interpolates_slow` is the result of [`is_calm`] for the attitudes.
    pub(crate) fn new(
        writer: Writer,
        fields: Samples<'a, Sample>,
        attitudes: Samples<'a, Attitude>,
        interpolates_slow: bool,
    ) -> Self {
        Self {
            writer,
            interpolates_slow,
            fields: fields.peekable(),
            last_field_ns: None,
            attitudes: attitudes.peekable(),
            previous_attitude: None,
            pending: None,
            pending_distance_ns: 0,
            intervals_ns: Vec::new(),
            force_sum_m_s2: 0.0,
            first_ns: None,
            last_ns: 0,
            rows: 0,
            field_rows: 0,
            field_log_sum: 0.0,
            first_field: None,
            field_varies: false,
            reference_rows: 0,
            fields_out_of_order: 0,
            fields_unmatched: 0,
            attitudes_out_of_order: 0,
        }
    }

    /// Adds the next row. Its time must be later than that of the previous row.
    pub(crate) fn push(&mut self, t_ns: i64, rate_rad_s: [f64; 3], force_m_s2: [f64; 3]) -> Result<(), ImportError> {
        if self.first_ns.is_none() {
            self.first_ns = Some(t_ns);
        } else if self.intervals_ns.len() < MAX_MEDIAN_INTERVALS {
            self.intervals_ns.push(t_ns.abs_diff(self.last_ns));
        }
        self.last_ns = t_ns;
        self.rows += 1;
        self.force_sum_m_s2 += length(force_m_s2);
        let previous_ns = self.pending.map(|row| row.t_ns);
        let reference = self.reference_at(previous_ns, t_ns, rate_rad_s)?;
        self.reference_rows += u64::from(reference.is_some());
        self.assign_fields(Some(t_ns))?;
        let row = Row { t_ns, rate_rad_s, force_m_s2, field_ut: None, reference };
        self.write_pending(Some(row))
    }

    /// Assigns the remaining magnetic field samples and writes the last row.
    pub(crate) fn finish(&mut self) -> Result<(), ImportError> {
        self.assign_fields(None)?;
        self.write_pending(None)
    }

    pub(crate) fn into_writer(self) -> Writer {
        self.writer
    }

    /// Returns the times of the first and the last row, ns.
    pub(crate) fn range_ns(&self) -> [i64; 2] {
        [self.first_ns.unwrap_or(self.last_ns), self.last_ns]
    }

    pub(crate) fn duration_s(&self) -> f64 {
        self.first_ns.map_or(0.0, |first_ns| self.last_ns.abs_diff(first_ns) as f64 / 1e9)
    }

    pub(crate) fn mean_force_m_s2(&self) -> f64 {
        self.force_sum_m_s2 / self.rows as f64
    }

    /// Returns the geometric mean of the magnitude of the magnetic field, µT; NaN without
    /// a magnetometer.
    ///
    /// A few disturbed samples hardly change the geometric mean.
    pub(crate) fn mean_field_ut(&self) -> f64 {
        (self.field_log_sum / self.field_rows as f64).exp()
    }

    /// Returns `true` if the magnetometer is dead: its samples never change.
    pub(crate) fn is_field_constant(&self) -> bool {
        self.field_rows >= MIN_CONSTANT_FIELDS && !self.field_varies
    }

    pub(crate) fn rate_hz(&mut self) -> f64 {
        if self.intervals_ns.is_empty() {
            return f64::NAN;
        }
        let middle = self.intervals_ns.len() / 2;
        let (_, &mut median_ns, _) = self.intervals_ns.select_nth_unstable(middle);
        1e9 / median_ns as f64
    }

    /// Assigns to the pending row the magnetic field samples that are nearer in time to this row
    /// than to the next row.
    fn assign_fields(&mut self, next_ns: Option<i64>) -> Result<(), ImportError> {
        let pending_ns = self.pending.map(|row| row.t_ns);
        loop {
            let belongs_to_pending = |t_ns: i64| match (pending_ns, next_ns) {
                (Some(pending_ns), Some(next_ns)) => t_ns.abs_diff(pending_ns) <= t_ns.abs_diff(next_ns),
                (Some(_), None) => true,
                // Before the first row, samples that are too long before that row are discarded
                // here. Later samples are kept until the row is pending.
                (None, Some(next_ns)) => t_ns < next_ns && t_ns.abs_diff(next_ns) > MAX_FIELD_DISTANCE_NS,
                (None, None) => true,
            };
            // The condition is also true for an error, so that the `?` below ends the import.
            let Some(sample) =
                self.fields.next_if(|next| next.as_ref().map_or(true, |(t_ns, _)| belongs_to_pending(*t_ns)))
            else {
                return Ok(());
            };
            let (t_ns, field) = sample?;
            if self.last_field_ns.is_some_and(|last_ns| t_ns <= last_ns) {
                self.fields_out_of_order += 1;
                continue;
            }
            self.last_field_ns = Some(t_ns);
            match &mut self.pending {
                Some(row) if t_ns.abs_diff(row.t_ns) <= MAX_FIELD_DISTANCE_NS => {
                    let distance_ns = t_ns.abs_diff(row.t_ns);
                    let is_nearer = row.field_ut.is_none() || distance_ns < self.pending_distance_ns;
                    self.fields_unmatched += u64::from(row.field_ut.is_some());
                    if is_nearer {
                        (row.field_ut, self.pending_distance_ns) = (Some(field), distance_ns);
                    }
                }
                _ => self.fields_unmatched += 1,
            }
        }
    }

    fn write_pending(&mut self, next: Option<Row>) -> Result<(), ImportError> {
        let Some(row) = std::mem::replace(&mut self.pending, next) else { return Ok(()) };
        if let Some(field_ut) = row.field_ut {
            self.field_rows += 1;
            self.field_log_sum += length(field_ut).max(f64::MIN_POSITIVE).ln();
            self.field_varies |= *self.first_field.get_or_insert(field_ut) != field_ut;
        }
        Ok(self.writer.write(&row)?)
    }

    /// Returns the reference at the time of a row.
    ///
    /// If [`is_interpolated`] returns `true`, interpolates between the attitudes before and after
    /// the row. Otherwise, an attitude that is later than the previous row is rotated with the body
    /// rate up to the time of this row.
    fn reference_at(
        &mut self,
        previous_ns: Option<i64>,
        t_ns: i64,
        rate_rad_s: [f64; 3],
    ) -> Result<Option<Reference>, ImportError> {
        // The condition is also true for an error, so that the `?` below ends the import.
        while let Some(attitude) =
            self.attitudes.next_if(|next| next.as_ref().map_or(true, |attitude| attitude.t_ns < t_ns))
        {
            let attitude = attitude?;
            if self.previous_attitude.is_some_and(|last| attitude.t_ns <= last.t_ns) {
                self.attitudes_out_of_order += 1;
            } else {
                self.previous_attitude = Some(attitude);
            }
        }
        let after = self.attitudes.peek().and_then(|after| after.as_ref().ok()).copied();
        if let Some(after) = after.filter(|after| after.t_ns == t_ns) {
            return Ok(Some(after.reference));
        }
        let Some(before) = self.previous_attitude else { return Ok(None) };
        if let Some(after) = after.filter(|after| is_interpolated(&before, after, self.interpolates_slow)) {
            let gap_ns = after.t_ns.abs_diff(before.t_ns);
            let fraction = t_ns.abs_diff(before.t_ns) as f64 / gap_ns as f64;
            let quaternion = slerp(before.reference.quaternion, after.reference.quaternion, fraction);
            return Ok(Some(Reference { quaternion, scored: before.reference.scored && after.reference.scored }));
        }
        let is_of_this_row = previous_ns.is_some_and(|previous_ns| before.t_ns > previous_ns);
        if !is_of_this_row || before.reset_counter.is_none() {
            return Ok(None);
        }
        let dt_s = t_ns.abs_diff(before.t_ns) as f64 * 1e-9;
        let quaternion = rotated(before.reference.quaternion, rate_rad_s.map(|part| part * dt_s));
        Ok(Some(Reference { quaternion, ..before.reference }))
    }
}

fn length(vector: [f64; 3]) -> f64 {
    vector.iter().map(|part| part * part).sum::<f64>().sqrt()
}

/// Returns `true` if the reference may be interpolated between two attitudes.
fn is_interpolated(before: &Attitude, after: &Attitude, interpolates_slow: bool) -> bool {
    if after.reset_counter.is_none() || after.reset_counter != before.reset_counter {
        return false;
    }
    let gap_ns = after.t_ns.abs_diff(before.t_ns);
    let is_slow_but_calm =
        || interpolates_slow && gap_ns <= MAX_SLOW_REFERENCE_GAP_NS && !is_large_rotation(before, after);
    gap_ns <= MAX_REFERENCE_GAP_NS || is_slow_but_calm()
}

fn is_large_rotation(before: &Attitude, after: &Attitude) -> bool {
    let (a, b) = (before.reference.quaternion, after.reference.quaternion);
    a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>().abs() < MIN_HALF_ROTATION_COS
}

/// Returns `true` unless the reference is slow and the rotation between two attitudes is often
/// large. A reference for which the result is `false` is used only at the times of its samples.
pub(crate) fn is_calm(attitudes: Samples<'_, Attitude>) -> Result<bool, ImportError> {
    let (mut before, mut slow, mut large) = (None::<Attitude>, 0usize, 0usize);
    for (count, attitude) in attitudes.take(MAX_JUDGED_ATTITUDES).enumerate() {
        let attitude = attitude?;
        if let Some(before) = before.replace(attitude) {
            let gap_ns = attitude.t_ns.abs_diff(before.t_ns);
            slow += usize::from((MAX_REFERENCE_GAP_NS + 1..=MAX_SLOW_REFERENCE_GAP_NS).contains(&gap_ns));
            large += usize::from(gap_ns > MAX_REFERENCE_GAP_NS && is_large_rotation(&before, &attitude));
        }
        if count == MIN_JUDGED_ATTITUDES && 2 * slow < count {
            return Ok(true);
        }
    }
    Ok(large as f64 <= MAX_LARGE_ROTATION_SHARE * slow as f64)
}

/// Interpolates spherically between two attitudes, along the shorter arc.
fn slerp(a: [f64; 4], b: [f64; 4], fraction: f64) -> [f64; 4] {
    let dot: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
    let b = if dot < 0.0 { b.map(|part| -part) } else { b };
    let cos = dot.abs().min(1.0);
    let (weight_a, weight_b) = if 1.0 - cos < SMALL_ANGLE_ONE_MINUS_COS {
        (1.0 - fraction, fraction)
    } else {
        let angle = cos.acos();
        (((1.0 - fraction) * angle).sin() / angle.sin(), (fraction * angle).sin() / angle.sin())
    };
    let sum = [0, 1, 2, 3].map(|i| weight_a * a[i] + weight_b * b[i]);
    let length = sum.iter().map(|part| part * part).sum::<f64>().sqrt();
    sum.map(|part| part / length)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slerp_rotates_evenly_along_shorter_arc() {
        let about_z = |angle: f64| [(angle / 2.0).cos(), 0.0, 0.0, (angle / 2.0).sin()];
        for (from, to, fraction, expected) in [(0.2, 1.4, 0.25, 0.5), (0.0, 1e-6, 0.5, 5e-7), (3.0, 3.2, 0.5, 3.1)] {
            for sign in [1.0, -1.0] {
                let found = slerp(about_z(from), about_z(to).map(|part| sign * part), fraction);
                let close = found.iter().zip(about_z(expected)).all(|(a, b)| (a - b).abs() < 1e-15);
                assert!(close, "{found:?} {:?}", about_z(expected));
            }
        }
    }
}
