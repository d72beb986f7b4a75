//! Overlapping Allan variance, and the covariance of its estimates.
//!
//! The Allan variance at τ is ⟨D²⟩ / (2 τ²) with the second difference D = x(t + 2τ) − 2 x(t + τ) +
//! x(t) of the integral x of the signal. The overlapping estimate is the mean over all t of a
//! recording (Riley, NIST SP 1065, 5.2.4).
//!
//! Second differences of the three noise types are stationary and Gaussian. Their covariances
//! follow from the functions g(t) = −|t|/2 for white noise, t² ln|t| / 2π for flicker noise and
//! |t|³/12 for a random walk (Greenhall and Riley, Uncertainty of stability variances based on finite differences, PTTI 2003). These functions determine the covariances of the estimates at all pairs of τ, and thereby the equivalent degrees of freedom of each estimate, 2 σ⁴ / var σ².

use std::f64::consts::PI;

/// Number of noise types: white, flicker and random walk.
pub(super) const TYPES: usize = 3;
/// Coefficients N², B² and K² of the noise types.
pub(super) type Coefficients = [f64; TYPES];

/// Minimum total duration of the rests longer than 2 τ, in multiples of τ. Below it, the Allan
/// variance at τ is not computed.
const MIN_INTERVALS: f64 = 4.0;
/// Number of steps per interval τ in an integral over lags.
const STEPS: f64 = 8.0;
/// Largest lag of an integral, in multiples of the sum of the two intervals τ. Beyond it, the
/// covariances are negligible.
const MAX_LAG: f64 = 4.0;
/// Maximum number of intervals τ. With 1 s as the shortest one, the longest is 2²³ s, which is 97
/// days.
const MAX_INTERVALS: usize = 24;

/// Returns the integral of a signal over a rest at each sample, starting from zero. The mean of the
/// signal is subtracted first.
pub(super) fn integral(values: impl Iterator<Item = f64> + Clone, interval_s: f64) -> Vec<f64> {
    let (count, sum) = values.clone().fold((0u32, 0.0), |(count, sum), value| (count + 1, sum + value));
    let mean = sum / f64::from(count.max(1));
    let mut integral = Vec::with_capacity(count as usize + 1);
    integral.push(0.0);
    let mut last = 0.0;
    integral.extend(values.map(|value| {
        last += (value - mean) * interval_s;
        last
    }));
    integral
}

/// Returns the overlapping Allan variance over all rests at τ = `m` · `interval_s`. The result is
/// `None` if no rest is as long as 2 τ.
pub(super) fn variance(integrals: &[Vec<f64>], m: usize, interval_s: f64) -> Option<f64> {
    let differences = integrals.iter().flat_map(|x| {
        let later = x.iter().skip(m).zip(x.iter().skip(2 * m));
        x.iter().zip(later).map(|(first, (second, third))| third - 2.0 * second + first)
    });
    let (sum, count) =
        differences.fold((0.0, 0u64), |(sum, count), difference| (sum + difference * difference, count + 1));
    let tau_s = m as f64 * interval_s;
    (count > 0).then(|| sum / (2.0 * tau_s * tau_s * count as f64))
}

/// Returns the intervals τ for which the rests determine an Allan variance, as multiples of
/// `interval_s`. Each interval is twice the previous one. The first interval is `first_s`.
pub(super) fn octaves(first_s: f64, interval_s: f64, rests_s: &[f64]) -> Vec<usize> {
    let multiple = |octave: usize| (first_s / interval_s * (1u64 << octave) as f64).round() as usize;
    let is_determined = |m: &usize| {
        let tau_s = *m as f64 * interval_s;
        rests_s.iter().filter(|rest_s| **rest_s > 2.0 * tau_s).sum::<f64>() >= MIN_INTERVALS * tau_s
    };
    (0..MAX_INTERVALS).map(multiple).take_while(is_determined).collect()
}

/// Covariances of Allan variances at several τ, as a quadratic form in the coefficients.
#[derive(Debug, Clone)]
pub(super) struct Covariances {
    /// Upper triangle, row by row. Each entry has the weights of the products of two coefficients.
    entries: Vec<[[f64; TYPES]; TYPES]>,
    size: usize,
}

impl Covariances {
    /// Computes the covariances for rests of these durations, s.
    pub(super) fn new(taus_s: &[f64], rests_s: &[f64]) -> Self {
        let pairs = (0..taus_s.len()).flat_map(|i| (i..taus_s.len()).map(move |j| (taus_s[i], taus_s[j])));
        Self { entries: pairs.map(|(a_s, b_s)| covariance(a_s, b_s, rests_s)).collect(), size: taus_s.len() }
    }

    /// Returns the covariance matrix, row by row.
    pub(super) fn matrix(&self, coefficients: &Coefficients) -> Vec<Vec<f64>> {
        let mut matrix = vec![vec![0.0; self.size]; self.size];
        let pairs = (0..self.size).flat_map(|i| (i..self.size).map(move |j| (i, j)));
        for ((i, j), entry) in pairs.zip(&self.entries) {
            let form = entry
                .iter()
                .zip(coefficients)
                .map(|(row, a)| a * row.iter().zip(coefficients).map(|(weight, b)| weight * b).sum::<f64>());
            matrix[i][j] = form.sum();
            matrix[j][i] = matrix[i][j];
        }
        matrix
    }
}

/// Returns the covariance of the estimates at two τ as a quadratic form of the coefficients.
fn covariance(a_s: f64, b_s: f64, rests_s: &[f64]) -> [[f64; TYPES]; TYPES] {
    let lengths = |tau_s: f64| rests_s.iter().map(move |rest_s| (rest_s - 2.0 * tau_s).max(0.0));
    // Rests that are too short for a difference are left out here. With all rests, the time would
    // grow with the square of the recording's length.
    let overlaps: Vec<_> = lengths(a_s).zip(lengths(b_s)).filter(|(a_s, b_s)| *a_s > 0.0 && *b_s > 0.0).collect();
    let step_s = a_s.min(b_s) / STEPS;
    let steps = (MAX_LAG * (a_s + b_s) / step_s).ceil() as i64;
    let mut form = [[0.0; TYPES]; TYPES];
    for step in -steps..=steps {
        let lag_s = step as f64 * step_s;
        // Total duration over which two differences of a rest have this lag.
        let overlap_s: f64 = overlaps.iter().map(|(a_s, b_s)| (a_s.min(b_s + lag_s) - lag_s.max(0.0)).max(0.0)).sum();
        if overlap_s == 0.0 {
            continue;
        }
        let covariances = difference_covariances(a_s, b_s, lag_s);
        for (row, a) in form.iter_mut().zip(covariances) {
            for (weight, b) in row.iter_mut().zip(covariances) {
                *weight += a * b * overlap_s * step_s;
            }
        }
    }
    let scale = 2.0 * (a_s * b_s).powi(2) * lengths(a_s).sum::<f64>() * lengths(b_s).sum::<f64>();
    form.map(|row| row.map(|weight| weight / scale))
}

/// Returns the covariances of two second differences, over `a_s` and `b_s`.
///
/// There is one covariance per noise type, for a coefficient of 1. The first difference starts
/// `lag_s` after the second.
fn difference_covariances(a_s: f64, b_s: f64, lag_s: f64) -> [f64; TYPES] {
    const WEIGHTS: [(f64, f64); 3] = [(0.0, 1.0), (1.0, -2.0), (2.0, 1.0)];
    let mut sums = [0.0; TYPES];
    for (i, a) in WEIGHTS {
        for (j, b) in WEIGHTS {
            let t_s = (lag_s + i * a_s - j * b_s).abs();
            // The limit of t² ln t at zero is zero.
            let logarithm = if t_s > 0.0 { t_s.ln() } else { 0.0 };
            let terms = [-0.5 * t_s, t_s * t_s * logarithm / (2.0 * PI), t_s * t_s * t_s / 12.0];
            sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += a * b * term);
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variance_matches_the_test_suite_of_nist() {
        // NIST SP 1065, 12.4: 1000 numbers of a linear congruential generator, tables 31 and 32.
        let mut number = 1_234_567_890u64;
        let values: Vec<f64> = (0..1000)
            .map(|_| {
                let value = number as f64 / 2_147_483_647.0;
                number = 16_807 * number % 2_147_483_647;
                value
            })
            .collect();
        let integrals = [integral(values.iter().copied(), 1.0)];
        for (m, expected) in [(1, 2.922_319e-1), (10, 9.159_953e-2), (100, 3.241_343e-2)] {
            let found = variance(&integrals, m, 1.0).unwrap().sqrt();
            assert!((found / expected - 1.0).abs() < 1e-6, "{m}: {found}, expected {expected}");
        }
        assert_eq!(variance(&integrals, 501, 1.0), None);
    }

    #[test]
    fn degrees_of_freedom_match_published_formulae() {
        // NIST SP 1065, table 5, for N phase points and τ = m intervals.
        let (rest_s, m) = (1024.0, 16.0);
        let n: f64 = rest_s + 1.0;
        let published = [
            (3.0 * (n - 1.0) / (2.0 * m) - 2.0 * (n - 2.0) / n) * 4.0 * m * m / (4.0 * m * m + 5.0),
            5.0 * n * n / (4.0 * m * (n + 3.0 * m)),
            (n - 2.0) / m * ((n - 1.0).powi(2) - 3.0 * m * (n - 1.0) + 4.0 * m * m) / (n - 3.0).powi(2),
        ];
        let covariances = Covariances::new(&[m], &[rest_s]);
        for (i, published) in published.into_iter().enumerate() {
            let mut coefficients = [0.0; TYPES];
            coefficients[i] = 1.0;
            let variance =
                coefficients.iter().zip([1.0 / m, 2.0 * 2f64.ln() / PI, m / 3.0]).map(|(a, b)| a * b).sum::<f64>();
            let found = 2.0 * variance * variance / covariances.matrix(&coefficients)[0][0];
            assert!((found / published - 1.0).abs() < 0.06, "type {i}: {found}, published {published}");
        }
    }

    #[test]
    fn octaves_end_at_a_quarter_of_the_rests() {
        assert_eq!(octaves(1.0, 0.1, &[64.0]), [10, 20, 40, 80, 160]);
        // For τ = 16 s, the shorter rest is shorter than 2 τ, and the longer one is shorter than 4
        // τ.
        assert_eq!(octaves(1.0, 0.1, &[40.0, 30.0]), [10, 20, 40, 80]);
        assert!(octaves(1.0, 0.1, &[3.0]).is_empty());
    }
}
