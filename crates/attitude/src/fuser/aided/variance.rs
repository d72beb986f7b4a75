//! Variances from standard deviations.

pub(super) fn square(x: f64) -> f64 {
    x * x
}

/// The variance of one of many measurements of which those within `memory_s` share their error.
pub(super) fn shared(sd: f64, memory_s: f64, interval_s: f64) -> f64 {
    sd * sd * 2.0 * memory_s / interval_s.max(1e-3)
}
