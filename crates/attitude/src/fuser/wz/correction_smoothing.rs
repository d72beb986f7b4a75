//! Applies corrections gradually, so that the output has no unflagged step.
//!
//! Input: the pending correction.
//!
//! Output: the fraction to apply in a tick.
//!
//! Time: the interval of the tick.
//!
//! Corrections too large to be smoothed are applied immediately and flagged by the caller.

/// Time constant of the smoothing, s: half the time between two updates of the gyro errors.
const TIME_CONSTANT_S: f64 = 0.1;
/// Largest correction applied in a tick, rad (0.03°).
const MAX_STEP_RAD: f64 = 5.235_988e-4;

/// Returns the fraction of a pending correction to apply in a tick. `pending2_rad2` is the squared
/// angle of the correction, rad².
#[inline]
pub(super) fn fraction(pending2_rad2: f64, dt_s: f64) -> f64 {
    let fraction = (dt_s * (1.0 / TIME_CONSTANT_S)).min(1.0);
    if pending2_rad2 * (fraction * fraction) > MAX_STEP_RAD * MAX_STEP_RAD {
        max_step_fraction(pending2_rad2)
    } else {
        fraction
    }
}

#[cold]
fn max_step_fraction(pending2_rad2: f64) -> f64 {
    MAX_STEP_RAD / libm::sqrt(pending2_rad2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn correction_completes_within_1_s_in_bounded_steps() {
        for dt_s in [1e-3, 4e-3, 0.02] {
            let mut pending_rad: f64 = 0.01;
            for _ in 0..(1.0 / dt_s) as u32 {
                let step_rad = pending_rad * fraction(pending_rad * pending_rad, dt_s);
                assert!((0.0..=MAX_STEP_RAD * (1.0 + 1e-12)).contains(&step_rad), "{step_rad} in {dt_s} s");
                pending_rad -= step_rad;
            }
            assert!(pending_rad < 1e-5, "{pending_rad} left at {dt_s} s");
        }
    }
}
