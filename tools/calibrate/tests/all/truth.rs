//! Whether errors are as large as they are said to be.

/// Errors divided by the standard deviations that came with them.
#[derive(Debug, Default)]
pub(crate) struct Normalised(Vec<f64>);

impl Normalised {
    pub(crate) fn take(&mut self, found: &[f64], sd: &[f64], truth: &[f64]) {
        assert_eq!((found.len(), sd.len()), (truth.len(), truth.len()));
        for ((found, sd), truth) in found.iter().zip(sd).zip(truth) {
            assert!(*sd > 0.0 && sd.is_finite(), "a standard deviation of {sd}");
            self.0.push((found - truth) / sd);
        }
    }

    /// The root mean square is about 1; of a hundred one may be beyond three deviations, and none beyond five.
    pub(crate) fn assert_honest(&self, what: &str) {
        self.assert_within(what, 0.7);
    }

    /// The same of deviations that are cautious: the root mean square may be as small as `least`.
    pub(crate) fn assert_within(&self, what: &str, least: f64) {
        let count = self.0.len() as f64;
        let rms = (self.0.iter().map(|x| x * x).sum::<f64>() / count).sqrt();
        let beyond = self.0.iter().filter(|x| x.abs() > 3.0).count() as f64;
        let largest = self.0.iter().fold(0.0, |largest: f64, x| largest.max(x.abs()));
        println!("{what}: {count} errors, normalised rms {rms:.3}, {beyond} beyond 3 sd, largest {largest:.2} sd");
        assert!((least..1.4).contains(&rms), "{what}: normalised rms {rms}");
        assert!(beyond <= 0.02 * count && largest < 5.0, "{what}: {beyond} beyond 3 sd, the largest at {largest}");
    }
}
