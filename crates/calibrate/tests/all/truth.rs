//! Consistency of errors with their standard deviations.

/// Errors divided by their standard deviations.
#[derive(Debug, Default)]
pub(crate) struct NormalisedErrors(Vec<f64>);

impl NormalisedErrors {
    pub(crate) fn push(&mut self, estimate: &[f64], sd: &[f64], truth: &[f64]) {
        assert_eq!((estimate.len(), sd.len()), (truth.len(), truth.len()));
        for ((estimate, sd), truth) in estimate.iter().zip(sd).zip(truth) {
            assert!(*sd > 0.0 && sd.is_finite(), "a standard deviation of {sd}");
            self.0.push((estimate - truth) / sd);
        }
    }

    /// Checks that the RMS is about 1, that at most 2 % exceed three standard deviations, and that
    /// none exceeds five.
    pub(crate) fn assert_consistent(&self, label: &str) {
        self.assert_rms_above(label, 0.7);
    }

    /// Checks consistency, but allows conservative standard deviations: the RMS may be as small as
    /// `min_rms`.
    pub(crate) fn assert_rms_above(&self, label: &str, min_rms: f64) {
        let count = self.0.len() as f64;
        let rms = (self.0.iter().map(|x| x * x).sum::<f64>() / count).sqrt();
        let beyond = self.0.iter().filter(|x| x.abs() > 3.0).count() as f64;
        let largest = self.0.iter().fold(0.0, |largest: f64, x| largest.max(x.abs()));
        println!("{label}: {count} errors, normalised rms {rms:.3}, {beyond} beyond 3 sd, largest {largest:.2} sd");
        assert!((min_rms..1.4).contains(&rms), "{label}: normalised rms {rms}");
        assert!(beyond <= 0.02 * count && largest < 5.0, "{label}: {beyond} beyond 3 sd, the largest at {largest}");
    }
}
