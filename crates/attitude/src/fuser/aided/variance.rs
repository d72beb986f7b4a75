//! Variances from standard deviations.

pub(super) fn square(x: f64) -> f64 {
    x * x
}

/// Returns the variance to use for a measurement that is repeated every `interval_s`. Its errors
/// stay correlated over `memory_s`.
///
/// The variance allows for the correlation, because correlated measurements contain less
/// information than independent ones.
pub(super) fn correlated_variance(sd: f64, memory_s: f64, interval_s: f64) -> f64 {
    sd * sd * 2.0 * memory_s / interval_s.max(1e-3)
}
