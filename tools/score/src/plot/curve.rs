//! Curve of bounded size: each bin of samples keeps its smallest and largest value, in time order.

/// Default number of bins in a curve. Each bin yields at most two points.
pub(crate) const BINS: u64 = 1000;

/// Values over time, decimated as they arrive.
#[derive(Debug, Clone)]
pub(crate) struct Curve {
    samples_per_bin: u64,
    count: u64,
    min: Option<(f64, f64)>,
    max: Option<(f64, f64)>,
    /// `true` if a value in the bin is not finite.
    has_gap: bool,
    points: Vec<(f64, f64)>,
}

impl Curve {
    /// Creates a curve for about `samples` values.
    pub(crate) fn new(samples: u64) -> Self {
        Self::with_bins(samples, BINS)
    }

    /// Creates a curve with a given number of bins.
    pub(crate) fn with_bins(samples: u64, bins: u64) -> Self {
        Self {
            samples_per_bin: samples.div_ceil(bins).max(1),
            count: 0,
            min: None,
            max: None,
            has_gap: false,
            points: Vec::new(),
        }
    }

    /// Adds the value at a time, s. A value that is not finite interrupts the curve.
    pub(crate) fn push(&mut self, t_s: f64, value: f64) {
        self.count += 1;
        if value.is_finite() {
            self.min = self.min.filter(|min| min.1 <= value).or(Some((t_s, value)));
            self.max = self.max.filter(|max| max.1 >= value).or(Some((t_s, value)));
        } else {
            self.has_gap = true;
        }
        if self.count >= self.samples_per_bin {
            self.end_bin();
        }
    }

    /// Completes the last bin.
    pub(crate) fn finish(&mut self) {
        if self.count > 0 {
            self.end_bin();
        }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.points.iter().all(|(_, value)| value.is_nan())
    }

    /// Returns the connected segments. They are separated by gaps and by steps of more than
    /// `max_step`.
    pub(crate) fn segments(&self, max_step: f64) -> impl Iterator<Item = &[(f64, f64)]> {
        let is_connected = move |a: &(f64, f64), b: &(f64, f64)| (a.1 - b.1).abs() <= max_step;
        self.points.chunk_by(is_connected).filter(|line| line.iter().all(|point| !point.1.is_nan()))
    }

    /// Returns the smallest and the largest value.
    pub(crate) fn range(&self) -> Option<(f64, f64)> {
        let values = || self.points.iter().map(|(_, value)| *value).filter(|value| !value.is_nan());
        Some((values().reduce(f64::min)?, values().reduce(f64::max)?))
    }

    /// Returns the range of the values. At each end, `percent` % of the points are excluded, so
    /// that spikes are ignored.
    pub(crate) fn robust_range(&self, percent: f64) -> Option<(f64, f64)> {
        let mut values: Vec<_> = self.points.iter().map(|(_, value)| *value).filter(|value| !value.is_nan()).collect();
        values.sort_by(f64::total_cmp);
        let last = values.len().checked_sub(1)?;
        let trimmed = (last as f64 * percent * 0.01) as usize;
        Some((values[trimmed], values[last - trimmed]))
    }

    /// Returns the time of the last point, s.
    pub(crate) fn end_s(&self) -> f64 {
        self.points.iter().map(|(t_s, _)| *t_s).filter(|t_s| !t_s.is_nan()).fold(0.0, f64::max)
    }

    fn end_bin(&mut self) {
        let mut ends: Vec<_> = self.min.take().into_iter().chain(self.max.take()).collect();
        ends.sort_by(|a, b| a.0.total_cmp(&b.0));
        ends.dedup();
        self.points.extend(ends);
        if std::mem::take(&mut self.has_gap) {
            self.points.push((f64::NAN, f64::NAN));
        }
        self.count = 0;
    }
}

/// Returns the smallest and the largest point of each `merged_bins` bins of a line, in time order.
pub(crate) fn min_and_max(line: &[(f64, f64)], merged_bins: usize) -> Vec<(f64, f64)> {
    if merged_bins == 1 {
        return line.to_vec();
    }
    let mut points = Vec::new();
    // A bin has up to two points.
    for bins in line.chunks(2 * merged_bins) {
        let min = bins.iter().copied().reduce(|a, b| if b.1 < a.1 { b } else { a });
        let max = bins.iter().copied().reduce(|a, b| if b.1 > a.1 { b } else { a });
        let mut ends: Vec<_> = min.into_iter().chain(max).collect();
        ends.sort_by(|a, b| a.0.total_cmp(&b.0));
        ends.dedup();
        points.extend(ends);
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn single_sample_spike_survives_decimation() {
        let mut curve = Curve::new(1_000_000);
        for k in 0..1_000_000 {
            curve.push(f64::from(k), if k == 123_456 { 9.0 } else { 0.0 });
        }
        curve.finish();
        assert!(curve.points.len() <= 2 * BINS as usize);
        assert_eq!(curve.range(), Some((0.0, 9.0)));
    }

    #[test]
    fn merged_bins_keep_spikes_in_time_order() {
        let mut line: Vec<_> = (0..1000).map(|k| (f64::from(k), 0.0)).collect();
        (line[500].1, line[503].1) = (9.0, -9.0);
        let merged = min_and_max(&line, 4);
        assert!(merged.len() <= 250 && merged.is_sorted_by(|a, b| a.0 < b.0), "{}", merged.len());
        assert!(merged.contains(&(500.0, 9.0)) && merged.contains(&(503.0, -9.0)));
        assert_eq!(min_and_max(&line, 1), line);
    }

    #[test]
    fn missing_value_and_jump_break_line() {
        let mut curve = Curve::new(6);
        for (k, value) in [1.0, 2.0, f64::NAN, 179.0, -179.0, -178.0].into_iter().enumerate() {
            curve.push(k as f64, value);
        }
        curve.finish();
        let lines: Vec<Vec<f64>> =
            curve.segments(180.0).map(|line| line.iter().map(|point| point.1).collect()).collect();
        assert_eq!(lines, [vec![1.0, 2.0], vec![179.0], vec![-179.0, -178.0]]);
        assert!(!curve.is_empty() && Curve::new(5).is_empty());
    }
}
