//! Detection of coordinated turns, without an attitude.
//!
//! In a coordinated turn at a bank angle φ, the norm of the force is g/cos φ and its direction in
//! the vehicle is constant. The force on a hand-held body or a robot, in contrast, averages to g
//! over seconds in any frame. The force is therefore averaged in the frame propagated by the gyro.
//! The tilt of this frame does not affect the norm of the mean. With the mean force f̄ and the rate
//! H' about it, √(f̄² − g²) = V H' gives the speed V, which must be plausible for a vehicle.
//!
//! Input: force and rotation of a tick.
//!
//! Output: `true` while a turn lasts.
//!
//! Time: the interval of the motion.
//!
//! Failure: a missing or implausible force, or a rate that cannot be trusted, ends the turn. A tick
//! without a motion, or with an implausible rate, is ignored.

use crate::{GRAVITY_M_S2, Vector3, fuser::input::FuserInput, gyro::Motion, scalars::Scalars};

/// Averaging time of force and rate, s.
const AVERAGING_S: f64 = 3.0;
/// Minimum averaging time before the mean is used, s.
const MIN_AVERAGED_S: f64 = 2.0 * AVERAGING_S;
/// Minimum relative excess of the mean force over the force in straight motion. It corresponds to a
/// bank of 7°.
const MIN_FORCE_EXCESS: f64 = 0.008;
/// Minimum rate of a turn, rad/s: 1 °/s.
const MIN_RATE_RAD_S: f64 = 0.017_453_293;
/// Plausible speeds of a vehicle in a turn, m/s.
const VEHICLE_SPEEDS_M_S: core::ops::Range<f64> = 5.0..300.0;
/// Minimum duration of a turn, s. In the trials of BROAD no motion resembles a turn for more than
/// 0.8 s.
const MIN_TURN_S: f64 = 2.0;
/// Value at which the recorded duration of a turn saturates, s.
const MAX_TURN_S: f64 = 5.0;
/// Time constant with which the estimated force in straight motion is updated, s.
const GRAVITY_TIME_CONSTANT_S: f64 = 30.0;
/// Maximum difference between the force in straight motion and g, relative to g.
const MAX_SCALE_ERROR: f64 = 0.03;
/// Smallest norm of a usable mean force, m/s².
const MIN_FORCE_M_S2: f64 = 1.0;
/// Largest plausible force of a vehicle, m/s²: 30 g.
const MAX_FORCE_M_S2: f64 = 300.0;
/// Largest plausible rate of a vehicle, rad/s.
const MAX_RATE_RAD_S: f64 = 100.0;

/// Detector of coordinated turns.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TurnDetector {
    /// Mean force in body axes, m/s².
    force_m_s2: Vector3<f64>,
    /// Averaging time so far, s.
    averaged_s: f64,
    /// Mean rate about the mean force, rad/s.
    rate_rad_s: f64,
    /// Norm of the mean force in straight motion, m/s².
    gravity_m_s2: f64,
    /// Duration of the turn, s. It increases while the body turns and decreases as fast otherwise.
    turn_s: f64,
}

impl Default for TurnDetector {
    fn default() -> Self {
        Self { force_m_s2: Vector3::zeros(), averaged_s: 0.0, rate_rad_s: 0.0, gravity_m_s2: GRAVITY_M_S2, turn_s: 0.0 }
    }
}

impl TurnDetector {
    /// Processes a tick. `bias_rad_s` is the bias of the gyro. Returns `true` once a turn has
    /// lasted long enough.
    pub(super) fn update(&mut self, input: &FuserInput, bias_rad_s: Vector3<f64>) -> bool {
        let Some(motion) = input.motion.filter(|motion| motion.rate_rad_s.amax() < MAX_RATE_RAD_S) else {
            return false;
        };
        let force = input.inclination.filter(|inclination| inclination.norm_m_s2 < MAX_FORCE_M_S2);
        let (Some(inclination), true) = (force, input.rate_credible) else {
            self.turn_s = 0.0;
            self.force_m_s2 = motion.rotation.apply_inverse(self.force_m_s2);
            return false;
        };
        self.average(&motion, inclination.force_m_s2, bias_rad_s);
        let change_s = if self.is_turning() { motion.dt_s } else { -motion.dt_s };
        self.turn_s = (self.turn_s + change_s).clamp(0.0, MAX_TURN_S);
        self.turn_s >= MIN_TURN_S
    }

    fn average(&mut self, motion: &Motion, force_m_s2: Vector3<f64>, bias_rad_s: Vector3<f64>) {
        let mean_m_s2 = motion.rotation.apply_inverse(self.force_m_s2);
        let length_m_s2 = mean_m_s2.norm();
        if !(MIN_FORCE_M_S2..MAX_FORCE_M_S2).contains(&length_m_s2) {
            *self = Self { force_m_s2, gravity_m_s2: self.gravity_m_s2, ..Self::default() };
            return;
        }
        self.averaged_s = (self.averaged_s + motion.dt_s).min(MIN_AVERAGED_S);
        let gain = (motion.dt_s / self.averaged_s.clamp(f64::MIN_POSITIVE, AVERAGING_S)).min(1.0);
        self.force_m_s2 = mean_m_s2 + (force_m_s2 - mean_m_s2) * gain;
        let rate_rad_s = (motion.rate_rad_s - bias_rad_s).dot(&mean_m_s2) / length_m_s2;
        self.rate_rad_s += (rate_rad_s - self.rate_rad_s) * gain;
        let plausible = (length_m_s2 / GRAVITY_M_S2 - 1.0).abs() < MAX_SCALE_ERROR;
        if plausible && self.averaged_s >= MIN_AVERAGED_S && self.rate_rad_s.abs() < MIN_RATE_RAD_S {
            self.gravity_m_s2 += (length_m_s2 - self.gravity_m_s2) * (motion.dt_s / GRAVITY_TIME_CONSTANT_S).min(1.0);
        }
    }

    fn is_turning(&self) -> bool {
        let (force2, gravity2) = (self.force_m_s2.norm_squared(), self.gravity_m_s2 * self.gravity_m_s2);
        let rate_rad_s = self.rate_rad_s.abs();
        let speed_m_s = libm::sqrt((force2 - gravity2).max(0.0)) / rate_rad_s.max(MIN_RATE_RAD_S);
        self.averaged_s >= MIN_AVERAGED_S
            && force2 > gravity2 * ((1.0 + MIN_FORCE_EXCESS) * (1.0 + MIN_FORCE_EXCESS))
            && rate_rad_s > MIN_RATE_RAD_S
            && VEHICLE_SPEEDS_M_S.contains(&speed_m_s)
    }

    pub(super) fn validation_error(&self) -> Option<&'static str> {
        let scale_error = (self.gravity_m_s2 / GRAVITY_M_S2 - 1.0).abs();
        let in_range =
            scale_error <= MAX_SCALE_ERROR && (0.0..=MAX_TURN_S).contains(&self.turn_s) && self.averaged_s >= 0.0;
        (!in_range || self.force_m_s2.amax() > MAX_FORCE_M_S2).then_some("an implausible turn")
    }
}

impl Scalars for TurnDetector {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.force_m_s2.visit(visit);
        [&mut self.averaged_s, &mut self.rate_rad_s, &mut self.gravity_m_s2, &mut self.turn_s]
            .into_iter()
            .for_each(visit);
    }
}
