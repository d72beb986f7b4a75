//! What is known to be wrong is taken back by and by: whoever reads the attitude sees no step that is not announced.
//!
//! Input: what is left to be taken back. Output: the share of it for a tick. Time: the tick's interval. Failure: none; what is more
//! than a step should hide jumps, and is announced by those who call.

/// Time constant, s: half the time between two findings.
const EASE_S: f64 = 0.1;
/// Most that is taken back in a tick, rad: 0.03°.
const STEP_MAX_RAD: f64 = 5.235_988e-4;

/// How much of a rest of this square, rad², is taken back in a tick.
#[inline]
pub(super) fn share(left2_rad2: f64, dt_s: f64) -> f64 {
    let share = (dt_s * (1.0 / EASE_S)).min(1.0);
    if left2_rad2 * (share * share) > STEP_MAX_RAD * STEP_MAX_RAD { largest(left2_rad2) } else { share }
}

#[cold]
fn largest(left2_rad2: f64) -> f64 {
    STEP_MAX_RAD / libm::sqrt(left2_rad2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_left_after_a_second_and_no_step_is_above_its_limit() {
        for dt_s in [1e-3, 4e-3, 0.02] {
            let mut left_rad: f64 = 0.01;
            for _ in 0..(1.0 / dt_s) as u32 {
                let step_rad = left_rad * share(left_rad * left_rad, dt_s);
                assert!((0.0..=STEP_MAX_RAD * (1.0 + 1e-12)).contains(&step_rad), "{step_rad} in {dt_s} s");
                left_rad -= step_rad;
            }
            assert!(left_rad < 1e-5, "{left_rad} left at {dt_s} s");
        }
    }
}
