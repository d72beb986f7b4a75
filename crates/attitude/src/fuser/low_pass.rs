//! Gains of first-order low-pass filters.

/// Returns the gain of a first-order low-pass filter over one step, 1 − e^{−dt/T}. It is exact for
/// a constant input.
pub(super) fn low_pass_gain(dt_s: f64, time_constant_s: f64) -> f64 {
    if time_constant_s > 0.0 { -libm::expm1(-dt_s / time_constant_s) } else { 1.0 }
}

/// Returns the gain of a low-pass filter that starts as a plain mean.
///
/// `remaining_s` is the time until the averaging time reaches the time constant. Until then, the
/// output is the mean of all input so far. Each call reduces `remaining_s` by `dt_s`.
pub(super) fn averaging_gain(dt_s: f64, time_constant_s: f64, remaining_s: &mut f64) -> f64 {
    let gain = low_pass_gain(dt_s, time_constant_s);
    if *remaining_s <= 0.0 || dt_s <= 0.0 {
        return gain;
    }
    let averaged_s = (time_constant_s - *remaining_s).max(0.0) + dt_s;
    *remaining_s = (*remaining_s - dt_s).max(0.0);
    gain.max(dt_s / averaged_s)
}
