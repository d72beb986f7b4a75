//! Variances from standard deviations.

pub(super) fn square(x: f64) -> f64 {
    x * x
}

/// Returns the variance to use for each measurement if errors stay correlated over `memory_s`.
pub(super) fn correlated_variance(sd: f64, memory_s: f64, interval_s: f64) -> f64 {
    sd * sd * 2.0 * memory_s / interval_s.max(1e-3)
}
