//! A curve of bounded size: of each bin of samples the least and the largest value, in their order.

/// Bins of a curve, each of at most two points.
pub(crate) const BINS: u64 = 1000;

/// Values over time, thinned as they come.
#[derive(Debug, Clone)]
pub(crate) struct Curve {
    samples_per_bin: u64,
    taken: u64,
    least: Option<(f64, f64)>,
    largest: Option<(f64, f64)>,
    /// Some value of the bin is none.
    broken: bool,
    points: Vec<(f64, f64)>,
}

impl Curve {
    /// A curve of about so many samples.
    pub(crate) fn new(samples: u64) -> Self {
        Self::in_bins(samples, BINS)
    }

    /// The same in so many bins.
    pub(crate) fn in_bins(samples: u64, bins: u64) -> Self {
        Self {
            samples_per_bin: samples.div_ceil(bins).max(1),
            taken: 0,
            least: None,
            largest: None,
            broken: false,
            points: Vec::new(),
        }
    }

    /// Takes the value at a time, s; one that is not finite breaks the line.
    pub(crate) fn push(&mut self, t_s: f64, value: f64) {
        self.taken += 1;
        if value.is_finite() {
            self.least = self.least.filter(|least| least.1 <= value).or(Some((t_s, value)));
            self.largest = self.largest.filter(|largest| largest.1 >= value).or(Some((t_s, value)));
        } else {
            self.broken = true;
        }
        if self.taken >= self.samples_per_bin {
            self.end_bin();
        }
    }

    /// The last bin is over.
    pub(crate) fn finish(&mut self) {
        if self.taken > 0 {
            self.end_bin();
        }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.points.iter().all(|(_, value)| value.is_nan())
    }

    /// The points that belong together; a step of more than `jump` does not.
    pub(crate) fn lines(&self, jump: f64) -> impl Iterator<Item = &[(f64, f64)]> {
        let together = move |a: &(f64, f64), b: &(f64, f64)| (a.1 - b.1).abs() <= jump;
        self.points.chunk_by(together).filter(|line| line.iter().all(|point| !point.1.is_nan()))
    }

    /// The least and the largest value.
    pub(crate) fn range(&self) -> Option<(f64, f64)> {
        let values = || self.points.iter().map(|(_, value)| *value).filter(|value| !value.is_nan());
        Some((values().reduce(f64::min)?, values().reduce(f64::max)?))
    }

    /// Between which all but so many hundredths of the points at either end lie; a spike does not count.
    pub(crate) fn robust_range(&self, hundredths: f64) -> Option<(f64, f64)> {
        let mut values: Vec<_> = self.points.iter().map(|(_, value)| *value).filter(|value| !value.is_nan()).collect();
        values.sort_by(f64::total_cmp);
        let last = values.len().checked_sub(1)?;
        let spared = (last as f64 * hundredths * 0.01) as usize;
        Some((values[spared], values[last - spared]))
    }

    /// The last time, s.
    pub(crate) fn end_s(&self) -> f64 {
        self.points.iter().map(|(t_s, _)| *t_s).filter(|t_s| !t_s.is_nan()).fold(0.0, f64::max)
    }

    fn end_bin(&mut self) {
        let mut ends: Vec<_> = self.least.take().into_iter().chain(self.largest.take()).collect();
        ends.sort_by(|a, b| a.0.total_cmp(&b.0));
        ends.dedup();
        self.points.extend(ends);
        if std::mem::take(&mut self.broken) {
            self.points.push((f64::NAN, f64::NAN));
        }
        self.taken = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spike_of_one_sample_is_kept_and_the_size_is_bounded() {
        let mut curve = Curve::new(1_000_000);
        for k in 0..1_000_000 {
            curve.push(f64::from(k), if k == 123_456 { 9.0 } else { 0.0 });
        }
        curve.finish();
        assert!(curve.points.len() <= 2 * BINS as usize);
        assert_eq!(curve.range(), Some((0.0, 9.0)));
    }

    #[test]
    fn what_is_not_there_and_what_jumps_breaks_the_line() {
        let mut curve = Curve::new(6);
        for (k, value) in [1.0, 2.0, f64::NAN, 179.0, -179.0, -178.0].into_iter().enumerate() {
            curve.push(k as f64, value);
        }
        curve.finish();
        let lines: Vec<Vec<f64>> = curve.lines(180.0).map(|line| line.iter().map(|point| point.1).collect()).collect();
        assert_eq!(lines, [vec![1.0, 2.0], vec![179.0], vec![-179.0, -178.0]]);
        assert!(!curve.is_empty() && Curve::new(5).is_empty());
    }
}
