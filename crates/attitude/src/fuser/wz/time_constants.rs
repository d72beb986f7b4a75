//! Time constants of the levelling loop.
//!
//! Input: acceleration, rate, and uncertainties of tilt and gyro bias at each update of the gyro
//! errors.
//!
//! Output: the time constant T2 of the tilt.
//!
//! Time: the intervals of the updates.
//!
//! Failure: a tilt error that the gyro error filter does not notice counts as acceleration and
//! lengthens T2.
//!
//! Accelerations with the spectral density S (of the force divided by g) cause a tilt error with
//! the variance S/(2 T2), as the noise bandwidth of 1/(T1 T2 s² + T2 s + 1) is 1/(2 T2). A gyro
//! that lets the tilt drift with the random walk q and the bias error σ adds q² (T1 + T2)/2 and
//! σ² T2². T2 minimises the sum of the three variances. Without a bias error this is the time
//! constant √S/q of a Kalman filter for the tilt.
//!
//! S is measured at the frequencies that the loop passes: a reference loop with the time constants
//! T1 and [`REFERENCE_S`] low-pass filters the acceleration. The tilt error of this reference loop
//! has the variance S/(2 · [`REFERENCE_S`]). Fast shaking, which the levelling loop suppresses in
//! any case, hardly affects S.
//!
//! After a sensor fault the level is wrong, and T2 must be short:
//!
//! - The acceleration is the horizontal force without the part that the estimated tilt error
//!   causes. Otherwise a wrong level would count as acceleration and slow its own correction.
//! - S does not exceed the value for which T2 is [`MAX_T2_S`]. Otherwise T2 would remain at its
//!   maximum long after a large force.
//! - A Kalman filter whose tilt has the variance P would correct it at the rate P/S. T2 is
//!   therefore limited in proportion to S/P, where P is the square of the estimated tilt error. If
//!   the body accelerates more than S indicates, its present acceleration replaces S. The force
//!   then does not show the true level.

use crate::{Complex, scalars::scalars};

/// Time constant T1 of the leaky velocity, s. The damping of the loop, ½√(T2/T1), is at least 0.5.
pub(super) const T1_S: f64 = 2.0;
/// Smallest time constant of the tilt, s.
const MIN_T2_S: f64 = 3.0;
/// Time constant of the tilt at the start, s.
const INITIAL_T2_S: f64 = 2.0;
/// Largest time constant of the tilt, as a fraction of the time since the start.
///
/// The limit grows with time because the level is only as certain as the mean of the force since
/// the start.
const GROWTH: f64 = 0.35;
/// Largest time constant of the tilt, s.
const MAX_T2_S: f64 = 12.0;
/// Time constant of the loop with which the spectral density is measured, s.
const REFERENCE_S: f64 = 3.0;
/// Averaging time of the mean squares, s.
const MEMORY_S: f64 = 10.0;
/// Duration over which the initial mean square is assumed to have been observed, s.
const INITIAL_MEMORY_S: f64 = 1.0;
/// Initial standard deviation of the reference loop's tilt, rad. It is that of a body moved by
/// hand.
const INITIAL_TILT_SD_RAD: f64 = 0.01;
/// Random walk of the tilt at rest, rad/√s. It includes effects that the bias filter does not
/// model.
const TILT_WALK_RAD: f64 = 2.5e-3;
/// Additional random walk of the tilt per unit of rate, √s, caused by misaligned axes and timing
/// errors.
const TILT_WALK_PER_RATE: f64 = 1e-3;
/// Fraction of the bias uncertainty for which T2 is optimised. The bias filter corrects the effect
/// of the remaining part once it has found the bias.
const REMAINING_BIAS_FRACTION: f64 = 0.1;
/// Largest mean acceleration over T1, divided by g. It limits the effect of a clipped or broken
/// accelerometer. At this acceleration, a body reaches 10 m/s within T1.
const MAX_MEAN_ACCELERATION: f64 = 0.5;
/// Largest leaky velocity of the reference loop, divided by g, s.
const MAX_VELOCITY_S: f64 = MAX_MEAN_ACCELERATION * T1_S;
/// Upper limit of T2 P/S, where P is the square of the estimated tilt error about one axis. The
/// acceleration causes a tilt error with the variance S/(2 T2). With the value 2, the limit applies
/// to tilt errors of more than two standard deviations.
const MAX_T2_P_PER_S: f64 = 2.0;
/// Shortest time in which T2 changes by the factor e, s. If T2 changed in one step, the tilt rate
/// would jump.
const CHANGE_S: f64 = 2.0;
/// Largest rate that enters the mean square, rad/s.
const MAX_RATE_RAD_S: f64 = 100.0;
/// Number of Newton steps. This number makes T2 accurate to 1 % over its range.
const NEWTON_STEPS: usize = 4;

/// Time constant T2 of the tilt, adapted to the motion.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TiltTimeConstant {
    t2_s: f64,
    /// Leaky velocity of the reference loop divided by g, s.
    reference_velocity_s: Complex<f64>,
    /// Tilt of the reference loop, rad.
    reference_tilt_rad: Complex<f64>,
    /// Spectral density of the acceleration divided by g, about one axis, s.
    density_s: f64,
    /// Mean square of the rate, rad²/s².
    rate_variance_rad2_s2: f64,
    memory_s: f64,
    /// Time since the start, s. It saturates once it no longer limits the time constant.
    age_s: f64,
}

/// Observation of the motion over an interval.
#[derive(Debug, Clone, Copy)]
pub(super) struct MotionObservation {
    /// Mean horizontal acceleration divided by g: the horizontal force without the part that the
    /// estimated tilt error causes.
    pub(super) acceleration: Complex<f64>,
    /// Estimated tilt error of the loop, rad.
    pub(super) tilt_error_rad: Complex<f64>,
    /// Square of the rate, rad²/s².
    pub(super) rate2_rad2_s2: f64,
    /// Standard deviation of the bias about a horizontal axis, rad/s.
    pub(super) bias_sd_rad_s: f64,
    pub(super) interval_s: f64,
}

impl Default for TiltTimeConstant {
    fn default() -> Self {
        Self {
            t2_s: INITIAL_T2_S,
            reference_velocity_s: Complex::new(0.0, 0.0),
            reference_tilt_rad: Complex::new(0.0, 0.0),
            density_s: 2.0 * REFERENCE_S * INITIAL_TILT_SD_RAD * INITIAL_TILT_SD_RAD,
            rate_variance_rad2_s2: 0.0,
            memory_s: INITIAL_MEMORY_S,
            age_s: 0.0,
        }
    }
}

impl TiltTimeConstant {
    /// Returns the time constant T2 of the tilt, s.
    #[inline]
    pub(super) fn t2_s(&self) -> f64 {
        self.t2_s
    }

    /// Adapts the time constant to the motion over an interval.
    pub(super) fn update(&mut self, observation: &MotionObservation) {
        let MotionObservation { acceleration, tilt_error_rad, rate2_rad2_s2, bias_sd_rad_s, interval_s } = *observation;
        self.age_s = (self.age_s + interval_s).min(MAX_T2_S / GROWTH);
        self.memory_s = (self.memory_s + interval_s).min(MEMORY_S);
        let gain = (interval_s / self.memory_s).min(1.0);
        let rate2_rad2_s2 = rate2_rad2_s2.min(MAX_RATE_RAD_S * MAX_RATE_RAD_S);
        self.rate_variance_rad2_s2 += (rate2_rad2_s2 - self.rate_variance_rad2_s2) * gain;
        let walk2 =
            TILT_WALK_RAD * TILT_WALK_RAD + TILT_WALK_PER_RATE * TILT_WALK_PER_RATE * self.rate_variance_rad2_s2;
        let bias_sd_rad_s = REMAINING_BIAS_FRACTION * bias_sd_rad_s;
        let bias_variance = bias_sd_rad_s * bias_sd_rad_s;
        let present_density_s = self.present_density_s(acceleration, interval_s);
        let max_density_s = MAX_T2_S * MAX_T2_S * (walk2 + 4.0 * bias_variance * MAX_T2_S);
        self.density_s = (self.density_s + (present_density_s - self.density_s) * gain).min(max_density_s);
        let tilt_error2_rad2 = (0.5 * tilt_error_rad.norm_sqr()).max(f64::MIN_POSITIVE);
        let max_t2_s = MAX_T2_P_PER_S * self.density_s.max(present_density_s) / tilt_error2_rad2;
        let t2_s = optimal_s(self.density_s, walk2, bias_variance)
            .min(max_t2_s)
            .clamp(MIN_T2_S, MAX_T2_S)
            .min(INITIAL_T2_S.max(GROWTH * self.age_s));
        let max_change = libm::exp(interval_s / CHANGE_S);
        self.t2_s = limited(t2_s, self.t2_s / max_change, self.t2_s * max_change);
    }

    /// Updates the reference loop and returns the spectral density that its present tilt indicates,
    /// s.
    fn present_density_s(&mut self, acceleration: Complex<f64>, interval_s: f64) -> f64 {
        let velocity_s = self.reference_velocity_s * libm::exp(-interval_s / T1_S) + acceleration * interval_s;
        let excess = libm::sqrt(velocity_s.norm_sqr()) / MAX_VELOCITY_S;
        self.reference_velocity_s = velocity_s / excess.max(1.0);
        let tilt_rad = self.reference_velocity_s / T1_S;
        self.reference_tilt_rad += (tilt_rad - self.reference_tilt_rad) * (interval_s / REFERENCE_S).min(1.0);
        REFERENCE_S * self.reference_tilt_rad.norm_sqr()
    }

    /// Returns the reason why the state is invalid, or `None` if it is valid.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        let Self { t2_s, reference_velocity_s, reference_tilt_rad, density_s, rate_variance_rad2_s2, memory_s, age_s } =
            *self;
        // Twice the limits that `update` keeps, because of rounding errors.
        const MAX_DENSITY_S: f64 = 2.0 * REFERENCE_S * MAX_MEAN_ACCELERATION * MAX_MEAN_ACCELERATION;
        const MAX_RATE_VARIANCE_RAD2_S2: f64 = 2.0 * MAX_RATE_RAD_S * MAX_RATE_RAD_S;
        let in_range = (INITIAL_T2_S..=MAX_T2_S).contains(&t2_s)
            && reference_velocity_s.norm_sqr() <= 2.0 * MAX_VELOCITY_S * MAX_VELOCITY_S
            && reference_tilt_rad.norm_sqr() <= 2.0 * MAX_MEAN_ACCELERATION * MAX_MEAN_ACCELERATION
            && (0.0..=MAX_DENSITY_S).contains(&density_s)
            && (0.0..=MAX_RATE_VARIANCE_RAD2_S2).contains(&rate_variance_rad2_s2)
            && (0.0..=MAX_T2_S / GROWTH).contains(&age_s)
            && memory_s > 0.0
            && memory_s <= MEMORY_S;
        (!in_range).then_some("a time constant of the level out of range")
    }
}

/// Returns the value of T that minimises S/(2 T) + q² T/2 + σ² T².
///
/// The derivative of this sum is concave and increasing. Newton's method, which starts at the
/// solution for σ = 0, can therefore overshoot the zero only in its first step. Each step changes T
/// by a factor of at most 4.
fn optimal_s(density: f64, walk2: f64, bias_variance: f64) -> f64 {
    let mut t_s = limited(libm::sqrt(density / walk2), MIN_T2_S, 100.0 * MAX_T2_S);
    for _ in 0..NEWTON_STEPS {
        let slope = 0.5 * walk2 + 2.0 * bias_variance * t_s - density / (2.0 * t_s * t_s);
        let curvature = 2.0 * bias_variance + density / (t_s * t_s * t_s);
        t_s = limited(t_s - slope / curvature.max(f64::MIN_POSITIVE), 0.25 * t_s, 4.0 * t_s);
    }
    t_s
}

/// Returns the value in the range that is closest to `x`, or `min` if `x` is not a number.
fn limited(x: f64, min: f64, max: f64) -> f64 {
    x.max(min).min(max)
}

scalars!(
    TiltTimeConstant: reference_velocity_s, reference_tilt_rad, t2_s, density_s, rate_variance_rad2_s2, memory_s, age_s
);

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the time constant after `duration_s` with the given acceleration (divided by g) and
    /// tilt error.
    fn t2_after(time_constant: &mut TiltTimeConstant, acceleration: f64, tilt_error_rad: f64, duration_s: f64) -> f64 {
        let observation = MotionObservation {
            acceleration: Complex::new(acceleration, 0.0),
            tilt_error_rad: Complex::new(tilt_error_rad, 0.0),
            rate2_rad2_s2: 0.0,
            bias_sd_rad_s: 0.0,
            interval_s: 0.2,
        };
        (0..(duration_s / observation.interval_s) as u32).for_each(|_| time_constant.update(&observation));
        time_constant.t2_s()
    }

    #[test]
    fn time_constant_relaxes_after_clipped_force() {
        let mut time_constant = TiltTimeConstant::default();
        assert_eq!(t2_after(&mut time_constant, 0.0, 0.0, 100.0), MIN_T2_S);
        assert!(t2_after(&mut time_constant, 22.0, 0.0, 4.0) > 0.99 * MAX_T2_S);
        assert!(t2_after(&mut time_constant, 0.0, 0.0, 50.0) < 1.2 * MIN_T2_S);
    }

    #[test]
    fn known_tilt_error_shortens_time_constant_without_force() {
        let mut time_constant = TiltTimeConstant::default();
        assert!(t2_after(&mut time_constant, 0.3, 0.0, 40.0) > 0.99 * MAX_T2_S);
        assert!(t2_after(&mut time_constant.clone(), 0.3, 0.2, 10.0) > 0.99 * MAX_T2_S);
        assert_eq!(t2_after(&mut time_constant, 0.0, 0.2, 10.0), MIN_T2_S);
    }

    #[test]
    fn optimal_time_constant_has_zero_slope() {
        for (density, walk2, bias_variance) in [(1e-4, 6e-6, 0.0), (2e-3, 6e-6, 9e-8), (1e-3, 1e-5, 1e-5)] {
            let t_s = optimal_s(density, walk2, bias_variance);
            let cost = |t_s: f64| density / (2.0 * t_s) + 0.5 * walk2 * t_s + bias_variance * t_s * t_s;
            assert!(cost(t_s) < cost(0.9 * t_s) && cost(t_s) < cost(1.1 * t_s), "{t_s}");
        }
    }
}
