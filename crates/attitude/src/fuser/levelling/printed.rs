//! The fuser stage `levelling`: S4 as printed, aided and autonomous, switching by itself.

use super::{
    geometry::{azimuth, carried, lean_of, tilt_of, turn_rate_rad_s},
    limits::{FLOOR_RAD, credible, interval_s},
    pull::Pull,
};
use crate::{
    Complex, Vector3,
    course::Reference,
    fuser::{
        carried::Carried,
        estimate::Estimate,
        fused::{Corrections, Fused, innovation_rad},
        input::FuserInput,
        low_pass::{averaging_gain, low_pass_gain},
    },
    gnss::Fix,
    numbers::Numbers,
    parameters::{Parameter, ParameterError, Parameters, settings},
    stage::{RestoreError, Stage, attitude_flaw},
    state::Attitude,
};
use core::f64::consts::PI;

settings! {
    /// Settings of `levelling`.
    pub struct PrintedSettings {
        /// Time constant of levelling with satellite velocity, 1/(K g). A short one hides the gyro's bias and shows the noise.
        time_constant_s: 5.0 in 1.0 .. 1000.0, "s";
        /// Time constant of levelling without it.
        autonomous_time_constant_s: 60.0 in 1.0 .. 10000.0, "s";
        /// Low-pass of the specific force without satellite velocity.
        low_pass_s: 20.0 in 0.0 .. 1000.0, "s";
        /// Time after the last fix from which levelling is autonomous.
        gap_s: 1.5 in 0.1 .. 60.0, "s";
    }
}

/// The fuser stage `levelling`.
///
/// The speed stands until the next fix, its derivative for one interval between fixes only: an increment of speed counts once.
/// The heading is free: it follows the gyro from wherever it began.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Levelling {
    settings: PrintedSettings,
    attitude: Attitude,
    started: bool,
    /// Time since the last force, s.
    unlevelled_s: f64,
    /// The low-passed f_P, platform, m/s².
    low_pass_m_s2: Complex<f64>,
    /// How much less than its time constant the low-pass has averaged, s.
    unaveraged_s: f64,
    /// What levelling took for tilt, low-passed over its own time constant, platform, rad.
    lag_rad: Complex<f64>,
    /// V.
    speed_m_s: f64,
    /// V'.
    speed_rate_m_s2: f64,
    /// For how long it counts yet, s.
    increment_s: f64,
    since_fix_s: f64,
    seen: bool,
    carried: Carried,
}

impl Levelling {
    pub(in crate::fuser) fn realign(&mut self) {
        self.started = false;
        self.low_pass_m_s2 = Complex::new(0.0, 0.0);
        self.unaveraged_s = 0.0;
        self.lag_rad = Complex::new(0.0, 0.0);
    }

    fn is_aided(&self) -> bool {
        self.seen && self.since_fix_s <= self.settings.gap_s
    }

    fn take(&mut self, fix: &Fix) {
        let speed_m_s = fix.speed_m_s();
        if self.is_aided() && self.since_fix_s > 1e-3 {
            self.speed_rate_m_s2 = (speed_m_s - self.speed_m_s) / self.since_fix_s;
            self.increment_s = self.since_fix_s;
        }
        self.speed_m_s = speed_m_s;
        self.since_fix_s = 0.0;
        self.seen = true;
    }

    /// One move of the level towards what the force and the speed say.
    fn level(&mut self, pull: Pull, turn_rate_rad_s: f64) {
        let Pull { level_m_s2, dt_s } = pull;
        let azimuth = azimuth(self.attitude);
        let gain = averaging_gain(dt_s, self.settings.low_pass_s, &mut self.unaveraged_s);
        self.low_pass_m_s2 += (azimuth * level_m_s2 - self.low_pass_m_s2) * gain;
        let (unexplained_m_s2, time_constant_s) = if self.is_aided() {
            let along_m_s2 = if self.increment_s > 0.0 { self.speed_rate_m_s2 } else { 0.0 };
            let motion_m_s2 = carried(self.attitude, self.speed_m_s * turn_rate_rad_s, along_m_s2);
            (level_m_s2 - motion_m_s2, self.settings.time_constant_s)
        } else {
            (azimuth.conj() * self.low_pass_m_s2, self.settings.autonomous_time_constant_s)
        };
        let (tilt_rad, gain) = (tilt_of(unexplained_m_s2), low_pass_gain(dt_s, time_constant_s));
        self.attitude = self.attitude.leaned(lean_of(tilt_rad * gain)).attitude;
        self.lag_rad += (azimuth * tilt_rad - self.lag_rad) * gain;
    }

    /// A loop of first order lags by τ b, and shows that as the tilt it never gets rid of.
    fn inclination_sd_rad(&self) -> f64 {
        libm::hypot(FLOOR_RAD, libm::sqrt(self.lag_rad.norm_sqr()))
    }
}

impl Stage for Levelling {
    type Input = FuserInput;
    type Output = Fused;
    type Common = Estimate;

    fn name(&self) -> &'static str {
        "levelling"
    }

    fn parameters(&self) -> &'static [Parameter] {
        PrintedSettings::TABLE
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        self.settings.set(name, value)
    }

    fn step(&mut self, input: &FuserInput) -> Fused {
        let mut room = None;
        let input = input.finite(&mut room);
        let mut corrections = Corrections::default();
        let dt_s = interval_s(input.motion.as_ref());
        let rate_rad_s = input.motion.map_or(Vector3::zeros(), |motion| motion.rate_rad_s);
        if let Some(motion) = &input.motion {
            self.attitude = self.attitude.turned(motion.turn).attitude;
        }
        self.carried.observe(input);
        self.since_fix_s += dt_s;
        self.unlevelled_s += dt_s;
        if let Some(fix) = credible(input.fix.as_ref()) {
            self.take(fix);
            corrections.velocity = true;
        }
        let mut innovation = 0.0;
        if let Some(inclination) = &input.inclination {
            if self.started {
                innovation = innovation_rad(inclination, self.attitude);
                let pull = Pull::of(self.attitude, inclination, self.unlevelled_s);
                self.level(pull, turn_rate_rad_s(self.attitude, rate_rad_s));
                corrections.tilt = true;
            } else {
                self.attitude = self.attitude.realigned(inclination.up).attitude;
                self.started = true;
                corrections.aligned = true;
            }
            self.unlevelled_s = 0.0;
        }
        self.increment_s = (self.increment_s - dt_s).max(0.0);
        Fused {
            attitude: self.attitude,
            rate_rad_s,
            bias_rad_s: Vector3::zeros(),
            innovation_rad: innovation,
            inclination_sd_rad: self.inclination_sd_rad(),
            heading_sd_rad: PI,
            reference: Reference::Arbitrary,
            corrections,
        }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.attitude.visit(visit);
        self.started.visit(visit);
        self.unlevelled_s.visit(visit);
        self.low_pass_m_s2.visit(visit);
        self.unaveraged_s.visit(visit);
        self.lag_rad.visit(visit);
        self.speed_m_s.visit(visit);
        self.speed_rate_m_s2.visit(visit);
        self.increment_s.visit(visit);
        self.since_fix_s.visit(visit);
        self.seen.visit(visit);
        self.carried.visit(visit);
    }

    fn flaw(&self) -> Option<&'static str> {
        let Self { unlevelled_s, unaveraged_s, speed_m_s, increment_s, since_fix_s, .. } = self;
        let negative = [unlevelled_s, unaveraged_s, speed_m_s, increment_s, since_fix_s].iter().any(|x| **x < 0.0);
        attitude_flaw(self.attitude)
            .or(negative.then_some("a time or a speed below zero"))
            .or_else(|| self.carried.flaw())
    }

    fn common(&self) -> Estimate {
        let (bias_rad_s, bias_sd_rad_s) = self.carried.bias();
        Estimate {
            attitude: self.attitude,
            reference: Reference::Arbitrary,
            bias_rad_s,
            inclination_sd_rad: self.inclination_sd_rad(),
            heading_sd_rad: PI,
            bias_sd_rad_s,
            hard_iron: self.carried.hard_iron(),
        }
    }

    fn adopt(&mut self, common: &Estimate) -> Result<(), RestoreError> {
        common.checked()?;
        self.realign();
        self.attitude = common.attitude;
        self.started = true;
        // The giver's level lags by what it lags by: what is left of the force then is not zero.
        self.unaveraged_s = self.settings.low_pass_s;
        self.carried = Carried::of(common);
        Ok(())
    }
}
