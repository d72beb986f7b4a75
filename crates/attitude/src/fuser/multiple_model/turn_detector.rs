//! Detection of coordinated turns, without an attitude.
//!
//! In a coordinated turn at a bank angle φ, the norm of the force is g/cos φ and its direction in
//! the vehicle is constant. The force on a hand-held body or a robot, in contrast, averages to g
//! over seconds in any frame. The force is therefore averaged in the frame propagated by the gyro.
//! The tilt of this frame does not affect the norm of the mean.
//!
//! An accelerometer with a scale error s reads a force that is too large by the factor 1 + s at
//! every rate. With the mean force f̄ and the rate H' about it, a vehicle with the speed V reads
//!
//! f̄²/g² = (1 + s)² + (V/g)² H'²,
//!
//! where the factor (1 + s)² of the second term is neglected.
//!
//! A Kalman filter estimates intercept and slope of this line. The body counts as turning if two
//! conditions hold: the left side exceeds the intercept by more than the uncertainty of the
//! intercept, and the excess corresponds to a speed V = √(f̄² − g²(1 + s)²)/H' that is plausible
//! for a vehicle.
//!
//! Input: force and rotation of a tick.
//!
//! Output: `true` while a turn lasts.
//!
//! Time: the interval of the motion.
//!
//! Failure: a missing or implausible force, or a rate that cannot be trusted, ends the turn. An
//! interval that is too long ends the turn and restarts the averages, because its rotation is
//! inaccurate. A tick without a motion, or with an implausible rate, is ignored. In the first
//! minute a turn with a bank below 22° is not detected, because the scale of the accelerometer is
//! not yet known.

use crate::{GRAVITY_M_S2, Vector3, fuser::input::FuserInput, gyro::Motion, scalars::scalars};

/// Averaging time of force and rate, s.
const AVERAGING_S: f64 = 3.0;
/// Minimum averaging time before the mean is used, s.
const MIN_AVERAGED_S: f64 = 2.0 * AVERAGING_S;
/// Minimum excess of the squared mean force over the intercept, relative to the intercept. It
/// corresponds to a bank of 7°.
const MIN_EXCESS: f64 = 0.016;
/// Minimum excess in standard deviations of the intercept.
const MIN_EXCESS_SDS: f64 = 4.0;
/// Minimum rate of a turn, rad/s (1 °/s).
const MIN_RATE_RAD_S: f64 = 0.017_453_293;
/// Plausible speeds of a vehicle in a turn, m/s.
const VEHICLE_SPEEDS_M_S: core::ops::Range<f64> = 5.0..300.0;
/// Minimum duration of a turn, s. In the trials of BROAD no motion resembles a turn for more than
/// 0.8 s.
const MIN_TURN_S: f64 = 2.0;
/// Value at which the recorded duration of a turn saturates, s.
const MAX_TURN_S: f64 = 5.0;
/// Initial standard deviation of the intercept. A scale error of 4 % is two standard deviations.
const INTERCEPT_SD: f64 = 0.04;
/// Largest deviation of the intercept from 1. It corresponds to a scale error of 5 %.
const MAX_INTERCEPT_DEVIATION: f64 = 0.1;
/// Random walk of the intercept, 1/√s. It corresponds to a scale change of 0.1 % within 100 s.
const INTERCEPT_WALK: f64 = 2e-4;
/// Standard deviation of the slope (V/g)², s². It corresponds to a speed of 100 m/s.
const SLOPE_SD_S2: f64 = 104.0;
/// Time constant with which the estimated slope is forgotten, s. The slope is forgotten because a
/// vehicle's speed changes.
const SLOPE_TIME_CONSTANT_S: f64 = 30.0;
/// Minimum assumed standard deviation of a measured f̄²/g².
const MIN_NOISE_SD: f64 = 0.003;
/// Averaging time of the squared residuals, s.
const NOISE_MEMORY_S: f64 = 10.0;
/// Interval of the updates, s.
const UPDATE_INTERVAL_S: f64 = 0.2 - 1e-6;
/// Smallest norm of a usable mean force, m/s².
const MIN_FORCE_M_S2: f64 = 1.0;
/// Largest plausible force of a vehicle, m/s² (30 g).
const MAX_FORCE_M_S2: f64 = 300.0;
/// Longest interval with an accurate rotation, s.
const MAX_INTERVAL_S: f64 = 0.25;
/// Largest plausible rate of a vehicle, rad/s.
const MAX_RATE_RAD_S: f64 = 100.0;

/// Line f̄²/g² = intercept + slope H'².
#[derive(Debug, Clone, PartialEq)]
struct ForceLine {
    intercept: f64,
    /// Slope (V/g)² of the line, s², with V the speed of the vehicle.
    slope_s2: f64,
    intercept_variance: f64,
    covariance_s2: f64,
    slope_variance_s4: f64,
    /// Mean squared residual of the line.
    noise_variance: f64,
}

impl Default for ForceLine {
    fn default() -> Self {
        Self {
            intercept: 1.0,
            slope_s2: 0.0,
            intercept_variance: INTERCEPT_SD * INTERCEPT_SD,
            covariance_s2: 0.0,
            slope_variance_s4: SLOPE_SD_S2 * SLOPE_SD_S2,
            noise_variance: INTERCEPT_SD * INTERCEPT_SD,
        }
    }
}

impl ForceLine {
    /// Updates the line with a squared force over g² and a squared rate. Both are means over
    /// [`AVERAGING_S`], so measurements within this time are correlated.
    fn update(&mut self, force2: f64, rate2: f64, interval_s: f64) {
        let forget = (1.0 - interval_s / SLOPE_TIME_CONSTANT_S).max(0.0);
        self.slope_s2 *= forget;
        self.covariance_s2 *= forget;
        self.slope_variance_s4 =
            self.slope_variance_s4 * forget * forget + SLOPE_SD_S2 * SLOPE_SD_S2 * (1.0 - forget * forget);
        self.intercept_variance =
            (self.intercept_variance + INTERCEPT_WALK * INTERCEPT_WALK * interval_s).min(INTERCEPT_SD * INTERCEPT_SD);
        let innovation = force2 - self.intercept - self.slope_s2 * rate2;
        let intercept_column = self.intercept_variance + self.covariance_s2 * rate2;
        let slope_column = self.covariance_s2 + self.slope_variance_s4 * rate2;
        let predicted = intercept_column + slope_column * rate2;
        let noise = self.noise_variance.max(MIN_NOISE_SD * MIN_NOISE_SD) * (2.0 * AVERAGING_S / interval_s).max(1.0);
        let gain = 1.0 / (predicted + noise);
        self.intercept += intercept_column * gain * innovation;
        self.intercept = self.intercept.clamp(1.0 - MAX_INTERCEPT_DEVIATION, 1.0 + MAX_INTERCEPT_DEVIATION);
        // The square of a vehicle's speed cannot be negative.
        self.slope_s2 = (self.slope_s2 + slope_column * gain * innovation).max(0.0);
        self.intercept_variance -= intercept_column * intercept_column * gain;
        self.covariance_s2 -= intercept_column * slope_column * gain;
        self.slope_variance_s4 -= slope_column * slope_column * gain;
        let residual = force2 - self.intercept - self.slope_s2 * rate2;
        self.noise_variance +=
            ((residual * residual).min(1.0) - self.noise_variance) * (interval_s / NOISE_MEMORY_S).min(1.0);
    }

    /// Returns the excess of a squared force over the intercept, or `None` if it is insignificant.
    fn excess(&self, force2: f64) -> Option<f64> {
        let excess = force2 - self.intercept;
        let sd = libm::sqrt(self.intercept_variance.max(0.0));
        (excess > (MIN_EXCESS * self.intercept).max(MIN_EXCESS_SDS * sd)).then_some(excess)
    }

    fn validation_error(&self) -> Option<&'static str> {
        let Self { intercept, slope_s2, intercept_variance, covariance_s2, slope_variance_s4, noise_variance } = *self;
        let in_range = libm::fabs(intercept - 1.0) <= MAX_INTERCEPT_DEVIATION && slope_s2 >= 0.0;
        let definite = intercept_variance >= 0.0
            && slope_variance_s4 >= 0.0
            && covariance_s2 * covariance_s2 <= intercept_variance * slope_variance_s4 * (1.0 + 1e-9) + 1e-12;
        (!in_range || !definite || noise_variance < 0.0).then_some("an implausible force in turns")
    }
}

scalars!(ForceLine: intercept, slope_s2, intercept_variance, covariance_s2, slope_variance_s4, noise_variance);

/// Detector of coordinated turns.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct TurnDetector {
    /// Mean force in body axes, m/s².
    force_m_s2: Vector3<f64>,
    /// Averaging time so far, s.
    averaged_s: f64,
    /// Mean rate about the mean force, rad/s.
    rate_rad_s: f64,
    line: ForceLine,
    /// Time since `line` was updated, s.
    since_update_s: f64,
    /// Duration of the turn, s. It increases while the body turns and decreases at the same rate
    /// otherwise.
    turn_s: f64,
}

impl TurnDetector {
    /// Processes a tick. `bias_rad_s` is the bias of the gyro. Returns `true` once a turn has
    /// lasted long enough.
    pub(super) fn update(&mut self, input: &FuserInput, bias_rad_s: Vector3<f64>) -> bool {
        let Some(motion) = input.motion.as_ref().filter(|motion| motion.rate_rad_s.amax() < MAX_RATE_RAD_S) else {
            return false;
        };
        if motion.dt_s > MAX_INTERVAL_S {
            *self = Self { line: self.line.clone(), ..Self::default() };
            return false;
        }
        let force = input.inclination.as_ref().filter(|inclination| inclination.norm_m_s2 < MAX_FORCE_M_S2);
        let (Some(inclination), true) = (force, input.rate_credible) else {
            self.turn_s = 0.0;
            self.force_m_s2 = motion.rotation.apply_inverse(self.force_m_s2);
            return false;
        };
        self.average(motion, inclination.force_m_s2, bias_rad_s);
        let change_s = if self.is_turning() { motion.dt_s } else { -motion.dt_s };
        self.turn_s = (self.turn_s + change_s).clamp(0.0, MAX_TURN_S);
        self.turn_s >= MIN_TURN_S
    }

    fn average(&mut self, motion: &Motion, force_m_s2: Vector3<f64>, bias_rad_s: Vector3<f64>) {
        let mean_m_s2 = motion.rotation.apply_inverse(self.force_m_s2);
        let length_m_s2 = mean_m_s2.norm();
        if !(MIN_FORCE_M_S2..MAX_FORCE_M_S2).contains(&length_m_s2) {
            *self = Self { force_m_s2, line: self.line.clone(), ..Self::default() };
            return;
        }
        self.averaged_s = (self.averaged_s + motion.dt_s).min(MIN_AVERAGED_S);
        let gain = (motion.dt_s / self.averaged_s.clamp(f64::MIN_POSITIVE, AVERAGING_S)).min(1.0);
        self.force_m_s2 = mean_m_s2 + (force_m_s2 - mean_m_s2) * gain;
        let rate_rad_s = (motion.rate_rad_s - bias_rad_s).dot(&mean_m_s2) / length_m_s2;
        self.rate_rad_s += (rate_rad_s - self.rate_rad_s) * gain;
        self.since_update_s += motion.dt_s;
        if self.averaged_s < MIN_AVERAGED_S || self.since_update_s < UPDATE_INTERVAL_S {
            return;
        }
        let interval_s = core::mem::take(&mut self.since_update_s).min(AVERAGING_S);
        let force2 = self.force2();
        // Averaged over a few seconds, the force on a vehicle is between 0.7 g and 3.2 g.
        if (0.5..10.0).contains(&force2) {
            self.line.update(force2, self.rate_rad_s * self.rate_rad_s, interval_s);
        }
    }

    /// Returns the squared mean force over g².
    fn force2(&self) -> f64 {
        self.force_m_s2.norm_squared() / (GRAVITY_M_S2 * GRAVITY_M_S2)
    }

    fn is_turning(&self) -> bool {
        if self.averaged_s < MIN_AVERAGED_S {
            return false;
        }
        let rate_rad_s = self.rate_rad_s.abs();
        let Some(excess) = self.line.excess(self.force2()).filter(|_| rate_rad_s > MIN_RATE_RAD_S) else {
            return false;
        };
        VEHICLE_SPEEDS_M_S.contains(&(GRAVITY_M_S2 * libm::sqrt(excess) / rate_rad_s))
    }

    pub(super) fn validation_error(&self) -> Option<&'static str> {
        let in_range =
            (0.0..=MAX_TURN_S).contains(&self.turn_s) && self.averaged_s >= 0.0 && self.since_update_s >= 0.0;
        (!in_range || self.force_m_s2.amax() > MAX_FORCE_M_S2)
            .then_some("an implausible turn")
            .or_else(|| self.line.validation_error())
    }
}

scalars!(TurnDetector: force_m_s2, averaged_s, rate_rad_s, since_update_s, turn_s, line);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{accel::Inclination, rotation::Rotation};

    const DT_S: f64 = 0.01;

    /// Returns the time (s) for which a turn is detected within `duration_s`. The body rotates
    /// about the force. `rate` returns the rate of the body (rad/s) at a given time (s).
    fn turning_s(detector: &mut TurnDetector, duration_s: f64, force_m_s2: f64, rate: impl Fn(f64) -> f64) -> f64 {
        let mut turning_s = 0.0;
        for tick in 0..(duration_s / DT_S) as u32 {
            let rate_rad_s = Vector3::z() * rate(f64::from(tick) * DT_S);
            let rotation = Rotation::from_rotation_vector(rate_rad_s * DT_S);
            let force_m_s2 = Vector3::z() * force_m_s2;
            let input = FuserInput {
                motion: Some(Motion { rotation, rate_rad_s, dt_s: DT_S, ..Motion::default() }),
                inclination: Some(Inclination { force_m_s2, norm_m_s2: force_m_s2.norm(), ..Inclination::default() }),
                rate_credible: true,
                ..FuserInput::default()
            };
            turning_s += if detector.update(&input, Vector3::zeros()) { DT_S } else { 0.0 };
        }
        turning_s
    }

    #[test]
    fn scale_error_of_a_walker_is_no_turn() {
        for scale in [0.96, 1.02, 1.04] {
            let walk = |t_s: f64| 0.4 * libm::sin(0.3 * t_s);
            let turning_s = turning_s(&mut TurnDetector::default(), 120.0, scale * GRAVITY_M_S2, walk);
            assert!(turning_s == 0.0, "scale {scale}: {turning_s} s");
        }
    }

    #[test]
    fn vehicle_turn_is_detected_despite_scale_error() {
        for scale in [0.96, 1.0, 1.04] {
            let mut detector = TurnDetector::default();
            assert_eq!(turning_s(&mut detector, 60.0, scale * GRAVITY_M_S2, |_| 0.0), 0.0);
            // A bank of 15° at 20 m/s.
            let force_m_s2 = scale * GRAVITY_M_S2 / libm::cos(15.0_f64.to_radians());
            let turning_s = turning_s(&mut detector, 30.0, force_m_s2, |_| 0.131);
            assert!(turning_s > 22.0, "scale {scale}: {turning_s} s");
        }
    }
}
