//! Coordinated turns, seen without an attitude.
//!
//! In a coordinated turn at the bank φ the force is g/cos φ long and keeps its direction in the vehicle, while what a hand or a robot
//! does has a mean of g over seconds, in whatever frame. So the force is averaged in the frame that the gyro carries, whose tilt does
//! not matter to a length. With the rate H' about that mean, √(f̄² − g²) = V H' gives a speed, which must be one that a vehicle has.
//!
//! Input: force and turn of a tick. Output: whether a turn lasts. Time: the motion's interval. Failure: a force that no vehicle has is
//! left out, a rate that is not to be believed ends the turn.

use crate::{GRAVITY_M_S2, Vector3, fuser::input::FuserInput, gyro::Motion, numbers::Numbers};

/// Time over which force and rate are averaged, s.
const MEAN_S: f64 = 3.0;
/// Before that the mean says nothing, s.
const AVERAGED_S: f64 = 2.0 * MEAN_S;
/// How much longer than at straight motion the mean force has to be: a bank of 7°.
const LONGER: f64 = 0.008;
/// Least rate of a turn, rad/s: 1 °/s.
const RATE_MIN_RAD_S: f64 = 0.017_453_293;
/// Speeds of a vehicle in a turn, m/s.
const SPEEDS_M_S: core::ops::Range<f64> = 5.0..300.0;
/// How long a turn has to last, s. On the trials of BROAD nothing looks like one for more than 0.8 s.
const LASTS_S: f64 = 2.0;
/// Most that is kept of its length, s.
const KEPT_S: f64 = 5.0;
/// Time constant at which the length of the force at straight motion is learned, and how far from g it may be.
const LEARN_S: f64 = 30.0;
const SCALE_MAX: f64 = 0.03;
/// Less than a mean has, and more than a vehicle has: 30 g, and rad/s.
const FORCE_MIN_M_S2: f64 = 1.0;
const FORCE_MAX_M_S2: f64 = 300.0;
const RATE_MAX_RAD_S: f64 = 100.0;

/// What is known of turns.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Turns {
    /// The mean force in body axes, m/s².
    force_m_s2: Vector3<f64>,
    /// Over how long it is a mean, s.
    averaged_s: f64,
    /// Mean rate about it, rad/s.
    rate_rad_s: f64,
    /// Length of the mean force at straight motion, m/s².
    straight_m_s2: f64,
    /// How long a turn has lasted; what interrupts it takes as long off.
    lasted_s: f64,
}

impl Default for Turns {
    fn default() -> Self {
        Self {
            force_m_s2: Vector3::zeros(),
            averaged_s: 0.0,
            rate_rad_s: 0.0,
            straight_m_s2: GRAVITY_M_S2,
            lasted_s: 0.0,
        }
    }
}

impl Turns {
    /// One tick of a gyro with this bias, rad/s; whether a turn has lasted long enough.
    pub(super) fn lasts(&mut self, input: &FuserInput, bias_rad_s: Vector3<f64>) -> bool {
        let Some(motion) = input.motion.filter(|motion| motion.rate_rad_s.amax() < RATE_MAX_RAD_S) else {
            return false;
        };
        let force = input.inclination.filter(|inclination| inclination.norm_m_s2 < FORCE_MAX_M_S2);
        let (Some(inclination), true) = (force, input.rate_credible) else {
            self.lasted_s = 0.0;
            self.force_m_s2 = motion.turn.seen_after(self.force_m_s2);
            return false;
        };
        self.average(&motion, inclination.force_m_s2, bias_rad_s);
        let change_s = if self.is_turning() { motion.dt_s } else { -motion.dt_s };
        self.lasted_s = (self.lasted_s + change_s).clamp(0.0, KEPT_S);
        self.lasted_s >= LASTS_S
    }

    fn average(&mut self, motion: &Motion, force_m_s2: Vector3<f64>, bias_rad_s: Vector3<f64>) {
        let mean_m_s2 = motion.turn.seen_after(self.force_m_s2);
        let length_m_s2 = mean_m_s2.norm();
        if !(FORCE_MIN_M_S2..FORCE_MAX_M_S2).contains(&length_m_s2) {
            *self = Self { force_m_s2, straight_m_s2: self.straight_m_s2, ..Self::default() };
            return;
        }
        self.averaged_s = (self.averaged_s + motion.dt_s).min(AVERAGED_S);
        let gain = (motion.dt_s / self.averaged_s.clamp(f64::MIN_POSITIVE, MEAN_S)).min(1.0);
        self.force_m_s2 = mean_m_s2 + (force_m_s2 - mean_m_s2) * gain;
        let rate_rad_s = (motion.rate_rad_s - bias_rad_s).dot(&mean_m_s2) / length_m_s2;
        self.rate_rad_s += (rate_rad_s - self.rate_rad_s) * gain;
        let near = (length_m_s2 / GRAVITY_M_S2 - 1.0).abs() < SCALE_MAX;
        if near && self.averaged_s >= AVERAGED_S && self.rate_rad_s.abs() < RATE_MIN_RAD_S {
            self.straight_m_s2 += (length_m_s2 - self.straight_m_s2) * (motion.dt_s / LEARN_S).min(1.0);
        }
    }

    fn is_turning(&self) -> bool {
        let (length2, straight2) = (self.force_m_s2.norm_squared(), self.straight_m_s2 * self.straight_m_s2);
        let rate_rad_s = self.rate_rad_s.abs();
        let speed_m_s = libm::sqrt((length2 - straight2).max(0.0)) / rate_rad_s.max(RATE_MIN_RAD_S);
        self.averaged_s >= AVERAGED_S
            && length2 > straight2 * ((1.0 + LONGER) * (1.0 + LONGER))
            && rate_rad_s > RATE_MIN_RAD_S
            && SPEEDS_M_S.contains(&speed_m_s)
    }

    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        let off = (self.straight_m_s2 / GRAVITY_M_S2 - 1.0).abs();
        let held = off <= SCALE_MAX && (0.0..=KEPT_S).contains(&self.lasted_s) && self.averaged_s >= 0.0;
        (!held || self.force_m_s2.amax() > FORCE_MAX_M_S2).then_some("a turn that no vehicle makes")
    }
}

impl Numbers for Turns {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.force_m_s2.visit(visit);
        [&mut self.averaged_s, &mut self.rate_rad_s, &mut self.straight_m_s2, &mut self.lasted_s]
            .into_iter()
            .for_each(visit);
    }
}
