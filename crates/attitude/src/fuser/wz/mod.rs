//! The fuser `wz`: a levelled low-pass of second order with Möbius correction and an estimate of the gyro's bias and scale.
//!
//! Real accelerations last for seconds and their mean over a movement is zero, so the specific force is averaged, all of it, in a
//! horizontal frame, where gravity stands still. Per tick:
//!
//! 1. w ← the exact step less what bias and scale add, while the level leans by κ dt (`Level`);
//! 2. h, the horizontal part of the force; V' = h − V/T1 (a leaky velocity); κ = V/(g T1 T2), the tilt rate.
//!
//! The transfer from the accelerometer to the tilt is 1/(T1 T2 s² + T2 s + 1): the complementary filter of Matveev 2025, fig. 9, of
//! second order, with its "+" replaced by a Möbius map and its low-pass moved to the horizontal frame.

mod ease;
mod gyro_errors;
mod heading;
mod initial_velocity;
mod level;
mod noise;
mod settings;
mod tilt_fault;
mod time_constants;
mod told;

use super::{
    estimate::Estimate,
    fused::{Corrections, Fused},
    input::FuserInput,
    rest::Rest,
};

use crate::{
    Complex, Vector3,
    numbers::Numbers,
    parameters::{Parameter, ParameterError, Parameters},
    stage::{RestoreError, Stage},
    turn::Turn,
};
pub(super) use settings::OF_AIDED_TOO;
use {
    gyro_errors::GyroErrorFilter,
    heading::{Heading, HeadingInput},
    level::Level,
    settings::Settings,
};

/// The longest interval over which a rate tells the turn of a body that moves as it likes, s.
const TOLD_BY_RATE_S: f64 = 0.1;
/// More than an accelerometer measures, m/s²: 300 g. A force beyond it is not used.
const FORCE_MAX_M_S2: f64 = 3000.0;

/// The fuser stage `wz`.
#[derive(Debug, Clone, PartialEq)]
pub struct Wz {
    settings: Settings,
    level: Level,
    gyro_errors: GyroErrorFilter,
    rest: Rest,
    heading: Heading,
    /// Of the last motion that had one, s: for so long a tick without a motion is taken to last.
    interval_s: f64,
    /// For how long nobody has seen the body turn, s.
    gyro_outage_s: f64,
}

impl Default for Wz {
    fn default() -> Self {
        Self {
            settings: Settings::default(),
            level: Level::new(),
            gyro_errors: GyroErrorFilter::default(),
            rest: Rest::default(),
            heading: Heading::default(),
            interval_s: 0.0,
            gyro_outage_s: 0.0,
        }
    }
}

impl Wz {
    /// Numbers by which it can be set.
    pub(super) const PARAMETERS: &'static [Parameter] = Settings::TABLE;

    /// The hard iron that the heading found, µT, body axes: where it is above 3 µT the magnetometer wants a calibration.
    pub fn hard_iron_ut(&self) -> Vector3<f64> {
        self.heading.hard_iron().field_ut
    }

    /// How late the magnetometer was found to be on the gyro, s.
    pub fn magnetometer_delay_s(&self) -> f64 {
        self.heading.delay_s()
    }

    pub(super) fn realign(&mut self) {
        self.level.restart();
        self.gyro_errors.restart(true);
        self.rest = Rest::default();
        self.heading.realign();
    }

    /// After a time in which nobody saw the body turn its level is as unknown as a first one; bias and scale stay.
    #[inline]
    fn see_again(&mut self, gyro_outage_s: f64) {
        if gyro_outage_s > 0.0 {
            self.gyro_outage_s = (self.gyro_outage_s + gyro_outage_s).min(1.0);
        } else if core::mem::take(&mut self.gyro_outage_s) > TOLD_BY_RATE_S {
            self.gyro_errors.restart(false);
            self.level.forget_velocity();
        }
    }

    /// For how long of a tick nobody saw the body turn, s.
    #[inline]
    fn gyro_outage_s(&mut self, input: &FuserInput) -> f64 {
        let Some(motion) = &input.motion else { return self.interval_s };
        if motion.dt_s > 0.0 {
            self.interval_s = motion.dt_s.min(TOLD_BY_RATE_S);
        }
        if input.rate_credible && motion.dt_s <= TOLD_BY_RATE_S { 0.0 } else { motion.dt_s }
    }

    /// What is done once in a while: the errors of the gyro, and what they take back. The level jumps.
    #[inline(never)]
    fn update(&mut self, rate_rad_s: Vector3<f64>, force_m_s2: Vector3<f64>) -> bool {
        let (interval_s, force_dt_m_s) = self.gyro_errors.seen();
        let leaned_rad = self.level.take_leaned(force_dt_m_s);
        self.rest.update(force_m_s2, interval_s);
        let (bias_at_rest, loop_velocity_s) = (self.rest.bias_rad_s(), self.level.velocity_s());
        let error = self.gyro_errors.update(rate_rad_s, leaned_rad, bias_at_rest, loop_velocity_s, &self.settings);
        self.level.take_back(error)
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
        Self::PARAMETERS
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        self.settings.set(name, value)
    }

    #[inline(always)]
    fn step(&mut self, input: &FuserInput) -> Fused {
        let mut room = None;
        let input = input.finite(&mut room);
        let mut corrections = Corrections::default();
        let (turn, rate_rad_s, dt_s) = match &input.motion {
            Some(motion) => (motion.turn, motion.rate_rad_s, motion.dt_s),
            None => (Turn::NONE, Vector3::zeros(), 0.0),
        };
        let gyro_outage_s = self.gyro_outage_s(input);
        self.see_again(gyro_outage_s);
        self.gyro_errors.overlook(gyro_outage_s);
        let inclination = input.inclination.as_ref().filter(|inclination| inclination.norm_m_s2 <= FORCE_MAX_M_S2);
        let levelling = self.level.started() && inclination.is_some();
        let lean_s = if levelling { dt_s } else { 0.0 };
        let axes = self.level.turn(self.gyro_errors.corrected_turn(turn, dt_s), dt_s, lean_s);
        self.gyro_errors.drift(&axes, turn, dt_s);

        let (mut innovation_rad, mut force_m_s2) = (0.0, Complex::new(0.0, 0.0));
        if let Some(inclination) = inclination {
            if levelling {
                let up_m_s2 = axes.up.dot(&inclination.force_m_s2);
                let horizontal_m_s2 = axes.horizontal(inclination.force_m_s2);
                innovation_rad = angle_rad(inclination.norm_m_s2, up_m_s2, horizontal_m_s2);
                force_m_s2 = self.level.corrected(horizontal_m_s2, up_m_s2);
                let force_dt_m_s = force_m_s2 * dt_s;
                self.level.follow(force_dt_m_s, dt_s);
                self.gyro_errors.observe(force_dt_m_s, inclination.norm_m_s2, dt_s);
                self.rest.observe(rate_rad_s, dt_s);
                corrections.tilt = true;
            } else {
                self.level.align(inclination.up);
                corrections.aligned = true;
            }
        }
        if !(levelling && input.motion.is_some() && input.rest_credible) {
            self.rest.interrupt();
        }
        if let (Some(inclination), true) = (inclination, self.gyro_errors.is_due()) {
            corrections.aligned |= self.update(rate_rad_s, inclination.force_m_s2);
            corrections.bias = true;
        }
        corrections.rest = self.rest.is_found();
        let moved = input.motion.is_some();
        let rate_rad_s = if moved { self.gyro_errors.corrected_rad_s(rate_rad_s) } else { Vector3::zeros() };
        let input = HeadingInput {
            attitude: self.level.attitude(),
            azimuth: self.level.azimuth(),
            rate_rad_s,
            force_m_s2,
            norm_m_s2: inclination.map(|inclination| inclination.norm_m_s2),
            scale_variance: self.gyro_errors.scale_variance(),
            field_ut: input.field_ut,
            at_rest: corrections.rest,
            dt_s,
            gyro_outage_s,
        };
        let news = self.heading.step(&input, &self.settings);
        corrections.magnetic = news.magnetic;
        corrections.aligned |= news.aligned;
        corrections.disturbed = self.heading.disturbed();
        Fused {
            attitude: self.heading.with_heading(self.level.attitude()),
            rate_rad_s,
            bias_rad_s: self.gyro_errors.bias_rad_s(),
            innovation_rad,
            inclination_sd_rad: told::inclination_rad(
                self.gyro_errors.tilt_sd_rad(),
                rate_rad_s.norm_squared(),
                &self.settings,
            ),
            heading_sd_rad: told::heading_rad(self.heading.sd_rad()),
            reference: self.heading.reference(),
            corrections,
        }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.level.visit(visit);
        self.gyro_errors.visit(visit);
        self.rest.visit(visit);
        self.heading.visit(visit);
        self.interval_s.visit(visit);
        self.gyro_outage_s.visit(visit);
    }

    fn flaw(&self) -> Option<&'static str> {
        let interval = (self.interval_s < 0.0 || self.gyro_outage_s < 0.0).then_some("an interval below zero");
        let parts = self.level.flaw().or_else(|| self.gyro_errors.flaw()).or_else(|| self.rest.flaw());
        parts.or_else(|| self.heading.flaw()).or(interval)
    }

    fn common(&self) -> Estimate {
        let attitude = self.heading.with_heading(self.level.attitude());
        Estimate {
            attitude,
            reference: self.heading.reference(),
            bias_rad_s: self.gyro_errors.bias_rad_s(),
            inclination_sd_rad: self.gyro_errors.tilt_sd_rad(),
            heading_sd_rad: self.heading.sd_rad(),
            bias_sd_rad_s: self.gyro_errors.bias_sd_rad_s(),
            gyro_scale: self.gyro_errors.scale(),
            hard_iron: self.heading.hard_iron(),
            leaky_velocity: self.level.leaky_velocity(attitude.z_rad, self.gyro_errors.first_velocity_sd_m_s()),
        }
    }

    fn adopt(&mut self, common: &Estimate) -> Result<(), RestoreError> {
        common.checked()?;
        self.heading = Heading::of(&self.settings, common);
        self.level = Level::of(common.attitude, common.leaky_velocity.first_m_s());
        self.gyro_errors = GyroErrorFilter::found(common);
        self.rest = Rest::default();
        Ok(())
    }
}

/// Angle between the accelerometer's up and the attitude's, rad, of a force of this length, vertical and horizontal part.
///
/// By the first terms of its series in the chord: to 1e-3 of itself up to 60°, to 1 % up to 90°.
#[inline]
fn angle_rad(norm_m_s2: f64, up_m_s2: f64, horizontal_m_s2: Complex<f64>) -> f64 {
    // 2 (1 − cos) = 2 sin² / (1 + cos), and 4 upside down.
    let below = (norm_m_s2 * (norm_m_s2 + up_m_s2)).max(f64::MIN_POSITIVE);
    let chord2 = (2.0 * horizontal_m_s2.norm_sqr() / below).min(4.0);
    libm::sqrt(chord2) * (1.0 + chord2 * (1.0 / 24.0 + chord2 * (3.0 / 640.0)))
}
