//! Time constants of the levelling loop.
//!
//! Input: leaky velocity, rate and uncertainty of the gyro bias at each update of the gyro errors.
//!
//! Output: the time constant T2 of the tilt.
//!
//! Time: the intervals of the updates.
//!
//! Accelerations with the spectral density S (of the force divided by g) cause a tilt error with
//! the variance S/(2 T2), as the noise bandwidth of 1/(T1 T2 s² + T2 s + 1) is 1/(2 T2). A gyro
//! that lets the tilt drift with the random walk q and the bias error σ adds q² (T1 + T2)/2 and
//! σ² T2². T2 minimises the sum of the three variances. Without a bias error this is the time
//! constant √S/q of a Kalman filter for the tilt.
//!
//! S is measured at the frequencies that the loop passes: a reference loop with the time constant
//! [`REFERENCE_S`] low-pass filters the leaky velocity. The tilt error of this reference loop has
//! the variance S/(2 · [`REFERENCE_S`]). Fast shaking, which the levelling loop suppresses in any
//! case, hardly affects S.

use crate::{Complex, GRAVITY_M_S2, scalars::scalars};

/// Time constant T1 of the leaky velocity, s. The damping of the loop, ½√(T2/T1), is at least 0.5.
pub(super) const T1_S: f64 = 2.0;
/// Smallest time constant of the tilt, s.
const MIN_T2_S: f64 = 3.0;
/// Time constant at the start, s.
const INITIAL_T2_S: f64 = 2.0;
/// Largest time constant as a fraction of the time since the start. The level found at the start is
/// as uncertain as the mean of the force over that time.
const GROWTH: f64 = 0.35;
/// Largest time constant of the tilt, s.
const MAX_T2_S: f64 = 12.0;
/// Time constant of the loop with which the spectral density is measured, s.
const REFERENCE_S: f64 = 3.0;
/// Averaging time of the mean squares, s.
const MEMORY_S: f64 = 10.0;
/// Duration over which the initial mean square is assumed to have been observed, s.
const INITIAL_MEMORY_S: f64 = 1.0;
/// Initial standard deviation of the reference loop's tilt, rad, for a body moved by hand.
const INITIAL_TILT_SD_RAD: f64 = 0.01;
/// Random walk of the tilt at rest, rad/√s. It includes effects that the bias filter does not
/// model.
const TILT_WALK_RAD: f64 = 2.5e-3;
/// Additional random walk of the tilt per unit of rate, √s: misaligned axes and timing errors.
const TILT_WALK_PER_RATE: f64 = 1e-3;
/// Fraction of the bias uncertainty for which T2 is optimised. The bias filter corrects the effect
/// of the remaining part once it has found the bias.
const REMAINING_BIAS_FRACTION: f64 = 0.1;
/// Largest tilt of the reference loop, rad.
const MAX_TILT_RAD: f64 = 1.0;
/// Largest rate that enters the mean square, rad/s.
const MAX_RATE_RAD_S: f64 = 100.0;
/// Number of Newton steps. They make T2 accurate to 1 % over its range.
const NEWTON_STEPS: usize = 4;

/// Time constant T2 of the tilt, adapted to the motion.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TiltTimeConstant {
    t2_s: f64,
    /// Tilt of the reference loop, rad.
    reference_tilt_rad: Complex<f64>,
    /// Mean square of `reference_tilt_rad` about one axis, rad².
    tilt_variance_rad2: f64,
    /// Mean square of the rate, rad²/s².
    rate_variance_rad2_s2: f64,
    memory_s: f64,
    /// Time since the start, s. It saturates once it no longer limits the time constant.
    age_s: f64,
}

impl Default for TiltTimeConstant {
    fn default() -> Self {
        Self {
            t2_s: INITIAL_T2_S,
            reference_tilt_rad: Complex::new(0.0, 0.0),
            tilt_variance_rad2: INITIAL_TILT_SD_RAD * INITIAL_TILT_SD_RAD,
            rate_variance_rad2_s2: 0.0,
            memory_s: INITIAL_MEMORY_S,
            age_s: 0.0,
        }
    }
}

impl TiltTimeConstant {
    /// Returns the time constant, s.
    #[inline]
    pub(super) fn t2_s(&self) -> f64 {
        self.t2_s
    }

    /// Processes an update. `rate2_rad2_s2` is the square of the rate, and `bias_sd_rad_s` the
    /// standard deviation of the bias about a horizontal axis.
    pub(super) fn update(
        &mut self,
        velocity_m_s: Complex<f64>,
        rate2_rad2_s2: f64,
        bias_sd_rad_s: f64,
        interval_s: f64,
    ) {
        let tilt_rad = velocity_m_s / (GRAVITY_M_S2 * T1_S);
        self.reference_tilt_rad += (tilt_rad - self.reference_tilt_rad) * (interval_s / REFERENCE_S).min(1.0);
        self.age_s = (self.age_s + interval_s).min(MAX_T2_S / GROWTH);
        self.memory_s = (self.memory_s + interval_s).min(MEMORY_S);
        let gain = (interval_s / self.memory_s).min(1.0);
        let tilt2_rad2 = (0.5 * self.reference_tilt_rad.norm_sqr()).min(MAX_TILT_RAD * MAX_TILT_RAD);
        self.tilt_variance_rad2 += (tilt2_rad2 - self.tilt_variance_rad2) * gain;
        let rate2_rad2_s2 = rate2_rad2_s2.min(MAX_RATE_RAD_S * MAX_RATE_RAD_S);
        self.rate_variance_rad2_s2 += (rate2_rad2_s2 - self.rate_variance_rad2_s2) * gain;
        let walk2 =
            TILT_WALK_RAD * TILT_WALK_RAD + TILT_WALK_PER_RATE * TILT_WALK_PER_RATE * self.rate_variance_rad2_s2;
        let bias_sd_rad_s = REMAINING_BIAS_FRACTION * bias_sd_rad_s;
        self.t2_s = optimal_s(2.0 * REFERENCE_S * self.tilt_variance_rad2, walk2, bias_sd_rad_s * bias_sd_rad_s)
            .clamp(MIN_T2_S, MAX_T2_S)
            .min(INITIAL_T2_S.max(GROWTH * self.age_s));
    }

    /// Returns why the state is invalid, or `None` if it is valid.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        let Self { t2_s, tilt_variance_rad2, rate_variance_rad2_s2, memory_s, age_s, .. } = *self;
        let in_range = (INITIAL_T2_S..=MAX_T2_S).contains(&t2_s) && age_s >= 0.0 && memory_s > 0.0;
        (!in_range || tilt_variance_rad2 < 0.0 || rate_variance_rad2_s2 < 0.0)
            .then_some("a time constant of the level out of range")
    }
}

/// Returns the T that minimises S/(2 T) + q² T/2 + σ² T².
///
/// The derivative of this sum is concave and increasing. Newton's method, which starts at the
/// solution for σ = 0, can therefore overshoot the zero only in its first step. Each step changes T
/// by a factor of at most 4.
fn optimal_s(density: f64, walk2: f64, bias_variance: f64) -> f64 {
    let mut t_s = libm::sqrt(density / walk2).clamp(MIN_T2_S, 100.0 * MAX_T2_S);
    for _ in 0..NEWTON_STEPS {
        let slope = 0.5 * walk2 + 2.0 * bias_variance * t_s - density / (2.0 * t_s * t_s);
        let curvature = 2.0 * bias_variance + density / (t_s * t_s * t_s);
        t_s = (t_s - slope / curvature.max(f64::MIN_POSITIVE)).clamp(0.25 * t_s, 4.0 * t_s);
    }
    t_s
}

scalars!(TiltTimeConstant: reference_tilt_rad, t2_s, tilt_variance_rad2, rate_variance_rad2_s2, memory_s, age_s);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn optimal_time_constant_has_zero_slope() {
        for (density, walk2, bias_variance) in [(1e-4, 6e-6, 0.0), (2e-3, 6e-6, 9e-8), (1e-3, 1e-5, 1e-5)] {
            let t_s = optimal_s(density, walk2, bias_variance);
            let cost = |t_s: f64| density / (2.0 * t_s) + 0.5 * walk2 * t_s + bias_variance * t_s * t_s;
            assert!(cost(t_s) < cost(0.9 * t_s) && cost(t_s) < cost(1.1 * t_s), "{t_s}");
        }
    }
}
