//! The fuser `wz`: a levelled low-pass of second order with Möbius correction and an estimate of the gyro bias.
//!
//! Real accelerations last for seconds and their mean over a movement is zero, so the specific force is averaged, all of it, in the
//! level frame, where gravity stands still. Per tick:
//!
//! 1. w ← the exact step less the bias; the level frame turns by Δz, and with it what is kept in it;
//! 2. h, the horizontal part of the force in the level frame; V' = h − V/T1 (a leaky velocity); κ = V/(g T1 T2), the tilt rate;
//! 3. the level leans by κ dt: w ← (w + l)/(1 − w̄ l), l = κ dt/2.
//!
//! The transfer from the accelerometer to the tilt is 1/(T1 T2 s² + T2 s + 1): the complementary filter of Matveev 2025, fig. 9, of
//! second order, with its "+" replaced by a Möbius map and its low-pass moved to the level frame.

mod bias;
mod heading;
mod rest;

use super::{Corrections, Estimate, Fused, FuserInput, innovation_rad};
use core::f64::consts::PI;

use crate::{
    Complex, GRAVITY_M_S2, Vector3,
    course::Reference,
    parameters::{Parameter, ParameterError, Parameters},
    stage::{Numbers, RestoreError, Stage, attitude_flaw},
    state::{Attitude, Moved},
    turn::Turn,
};
use {
    bias::BiasFilter,
    heading::{Heading, Settings, Sighting},
    rest::Rest,
};

/// Memory of the leaky velocity, s.
const T1_S: f64 = 3.0;
/// Time constant of the tilt, s.
const T2_S: f64 = 2.0;

/// The fuser stage `wz`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Wz {
    attitude: Attitude,
    started: bool,
    velocity_m_s: Complex<f64>,
    bias: BiasFilter,
    rest: Rest,
    heading: Heading,
}

impl Wz {
    /// t
    pub fn debug(&self) -> ([f64; 11], [f64; 6]) {
        self.heading.debug()
    }

    pub(super) fn realign(&mut self) {
        self.started = false;
        self.velocity_m_s = Complex::new(0.0, 0.0);
        self.bias.restart();
        self.rest.interrupt();
    }

    fn moved(&mut self, moved: Moved) {
        self.attitude = moved.attitude;
        self.velocity_m_s *= moved.swing;
        self.bias.swing(moved.swing);
    }

    /// Levels the attitude by a force; true when the bias was updated.
    fn level(&mut self, force_m_s2: Vector3<f64>, dt_s: f64) -> bool {
        self.velocity_m_s += (self.attitude.horizontal(force_m_s2) - self.velocity_m_s / T1_S) * dt_s;
        let tilt_rate_rad_s = self.velocity_m_s / (GRAVITY_M_S2 * T1_S * T2_S);
        let updated = self.bias.follow(tilt_rate_rad_s, dt_s);
        self.moved(self.attitude.leaned(tilt_rate_rad_s * (0.5 * dt_s)));
        let Some(error) = updated else { return false };
        self.velocity_m_s -= error.velocity * GRAVITY_M_S2;
        self.moved(self.attitude.leaned(error.tilt * 0.5));
        true
    }
}

impl Stage for Wz {
    type Input = FuserInput;
    type Output = Fused;
    type Common = Estimate;

    fn name(&self) -> &'static str {
        "wz"
    }

    fn parameters(&self) -> &'static [Parameter] {
        Settings::TABLE
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        self.heading.settings.set(name, value)
    }

    fn step(&mut self, input: &FuserInput) -> Fused {
        let mut corrections = Corrections::default();
        let dt_s = input.motion.map_or(0.0, |motion| motion.dt_s);
        if let Some(motion) = &input.motion {
            let bias_turn = Turn::of_rotation_vector(self.bias.bias_rad_s() * -dt_s);
            self.moved(self.attitude.turned(motion.turn.then(bias_turn)));
            self.bias.drift(self.attitude, dt_s);
        }
        let mut innovation = 0.0;
        if let Some(inclination) = &input.inclination {
            if self.started {
                innovation = innovation_rad(inclination, self.attitude);
                corrections.bias = self.level(inclination.force_m_s2, dt_s);
                corrections.tilt = true;
            } else {
                self.moved(self.attitude.realigned(inclination.up));
                self.started = true;
                corrections.aligned = true;
            }
        }
        match (&input.motion, &input.inclination) {
            (Some(motion), Some(inclination)) if input.rest_credible => {
                if let Some(bias_rad_s) = self.rest.step(motion.rate_rad_s, inclination.force_m_s2, dt_s) {
                    self.bias.at_rest(bias_rad_s);
                    corrections.rest = true;
                    corrections.bias = true;
                }
            }
            _ => self.rest.interrupt(),
        }
        let bias_rad_s = self.bias.bias_rad_s();
        let rate_rad_s = input.motion.map_or(Vector3::zeros(), |motion| motion.rate_rad_s - bias_rad_s);
        let force = input.inclination.map_or(Vector3::zeros(), |inclination| inclination.force_m_s2);
        let news = self.heading.step(&Sighting {
            attitude: self.attitude,
            rate_rad_s,
            acceleration_m_s2: self.attitude.horizontal(force),
            field_ut: input.field_ut,
            at_rest: corrections.rest,
            dt_s,
        });
        corrections.magnetic = news.magnetic;
        corrections.aligned |= news.aligned;
        corrections.disturbed = self.heading.disturbed();
        Fused {
            attitude: self.attitude.faced(self.heading.turn_rad()),
            rate_rad_s,
            bias_rad_s,
            innovation_rad: innovation,
            // The loop's correction follows a tilt error by ε/T2.
            inclination_sd_rad: T2_S * libm::sqrt(self.bias.innovation2_rad2_s2()),
            heading_sd_rad: self.heading.sd_rad(),
            reference: self.heading.reference(),
            corrections,
        }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.attitude.visit(visit);
        self.started.visit(visit);
        self.velocity_m_s.visit(visit);
        self.bias.visit(visit);
        self.rest.visit(visit);
        self.heading.visit(visit);
    }
    fn flaw(&self) -> Option<&'static str> {
        attitude_flaw(self.attitude).or_else(|| self.bias.flaw())
    }

    fn common(&self) -> Estimate {
        Estimate {
            attitude: self.attitude,
            reference: Reference::Arbitrary,
            bias_rad_s: self.bias.bias_rad_s(),
            inclination_sd_rad: T2_S * libm::sqrt(self.bias.innovation2_rad2_s2()),
            heading_sd_rad: PI,
            bias_sd_rad_s: self.bias.sd_rad_s(),
        }
    }

    fn adopt(&mut self, common: &Estimate) -> Result<(), RestoreError> {
        common.checked()?;
        self.attitude = common.attitude;
        self.velocity_m_s = Complex::new(0.0, 0.0);
        self.bias.adopt(common.bias_rad_s, common.bias_sd_rad_s, common.inclination_sd_rad);
        self.rest.interrupt();
        self.started = true;
        Ok(())
    }
}
