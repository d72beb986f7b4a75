//! Gains of first-order low-passes.

/// The gain of a first-order low-pass over one step, exact for an input that holds still: 1 − e^{−dt/T}.
pub(super) fn low_pass_gain(dt_s: f64, time_constant_s: f64) -> f64 {
    if time_constant_s > 0.0 { -libm::expm1(-dt_s / time_constant_s) } else { 1.0 }
}

/// The gain of a low-pass of which `unaveraged_s` of its time constant is yet to come: a mean of what there was so far.
pub(super) fn averaging_gain(dt_s: f64, time_constant_s: f64, unaveraged_s: &mut f64) -> f64 {
    let gain = low_pass_gain(dt_s, time_constant_s);
    if *unaveraged_s <= 0.0 || dt_s <= 0.0 {
        return gain;
    }
    let averaged_s = (time_constant_s - *unaveraged_s).max(0.0) + dt_s;
    *unaveraged_s = (*unaveraged_s - dt_s).max(0.0);
    gain.max(dt_s / averaged_s)
}
