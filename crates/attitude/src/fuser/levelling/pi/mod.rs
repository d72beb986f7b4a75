//! The fuser stage `levelling-pi`: levelling by matched increments of velocity, with an estimate of the gyro's bias.
//!
//! The error ε of the level under a gyro bias b and its estimate b̂ follows
//!
//! ε' = b − b̂ − ε/τ,  b̂' = ε/(4τ²)
//!
//! two equal roots at 1/(2τ): with τ = 20 s the bias is found in minutes and costs nothing afterwards; what remains is the bias of the
//! accelerometer, 0.02 m/s² or 0.12°. V H' of the ground speed is not used where there are fixes: the force is held against the
//! change of velocity as a vector, which is right in wind, as far as the azimuth of the platform is.

mod aiding;
mod filter;
mod heading;
mod law;
mod matched;
mod settings;
mod still;

pub use {filter::LevellingPi, settings::PiSettings};

use super::{
    geometry::{azimuth, turn_rate_rad_s},
    limits::{FLOOR_RAD, bounded, credible, interval_s},
    pull::Pull,
};
use crate::{
    Complex, Vector3,
    accel::Inclination,
    course::Reference,
    fuser::{
        carried::Carried,
        estimate::Estimate,
        fused::{Corrections, Fused, innovation_rad},
        input::FuserInput,
        leaky_velocity::LeakyVelocity,
        low_pass::low_pass_gain,
    },
    gnss::Fix,
    numbers::Numbers,
    parameters::{Parameter, ParameterError, Parameters},
    stage::{RestoreError, Stage, attitude_flaw, bias_flaw},
    turn::Turn,
};
use {
    filter::{BIAS_KNOWN_SD_RAD_S, BIAS_MAX_RAD_S, BIAS_SD_RAD_S},
    heading::Heading,
};

/// Time over which the turn rate is averaged that decides how much the force counts, s.
const TURN_MEAN_S: f64 = 1.0;

impl LevellingPi {
    pub(in crate::fuser) fn realign(&mut self) {
        self.started = false;
    }

    /// Levels anew: what was followed belonged to another level.
    fn level(&mut self, inclination: &Inclination) {
        self.attitude = self.attitude.realigned(inclination.up).attitude;
        let none = Complex::new(0.0, 0.0);
        (self.pending_rad, self.low_pass_m_s2, self.lag_rad) = (none, none, none);
        self.unaveraged_s = 0.0;
        self.aiding.interrupt();
        self.started = true;
    }

    /// One force: into the increment, and in a gap into the level. True when it has levelled.
    fn pull(&mut self, inclination: &Inclination, turn_rate_rad_s: f64) -> bool {
        let pull = Pull::of(self.attitude, inclination, self.unlevelled_s);
        if self.unlevelled_s > pull.dt_s {
            self.aiding.interrupt();
        }
        self.aiding.push(azimuth(self.attitude) * pull.level_m_s2, pull.dt_s);
        if self.aiding.is_recent(self.settings.gap_s) {
            (self.low_pass_m_s2, self.unaveraged_s) = (Complex::new(0.0, 0.0), 0.0);
            return false;
        }
        self.coast(pull, turn_rate_rad_s);
        true
    }

    /// What levelling lags by, and in a gap what an unknown bias has done since.
    fn inclination_sd_rad(&self) -> f64 {
        let since_s = self.aiding.since_fix_s();
        let gap_s = if since_s > self.settings.gap_s { since_s.min(self.settings.gap_time_constant_s) } else { 0.0 };
        let drift_rad = self.bias_sd_rad_s() * gap_s;
        libm::sqrt(self.lag_rad.norm_sqr() + drift_rad * drift_rad + FLOOR_RAD * FLOOR_RAD)
    }

    fn heading_sd_rad(&self) -> f64 {
        self.heading.sd_rad(self.aiding.speed_m_s().unwrap_or(0.0))
    }

    fn reference(&self) -> Reference {
        if self.heading.known { Reference::True } else { Reference::Arbitrary }
    }

    fn usable<'a>(&self, fix: Option<&'a Fix>) -> Option<&'a Fix> {
        credible(fix).filter(|fix| fix.sd_m_s.is_none_or(|sd| sd <= self.settings.velocity_sd_max_m_s))
    }
}

impl Stage for LevellingPi {
    type Input = FuserInput;
    type Output = Fused;
    type Common = Estimate;

    fn name(&self) -> &'static str {
        "levelling-pi"
    }

    fn parameters(&self) -> &'static [Parameter] {
        PiSettings::TABLE
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        self.settings.set(name, value)
    }

    fn step(&mut self, input: &FuserInput) -> Fused {
        let mut room = None;
        let input = input.finite(&mut room);
        let mut corrections = Corrections::default();
        let dt_s = interval_s(input.motion.as_ref());
        let sensed_rad_s = input.motion.map_or(Vector3::zeros(), |motion| motion.rate_rad_s);
        self.carried.observe(input);
        if let Some(motion) = &input.motion {
            let bias_turn = Turn::of_rotation_vector(self.bias_rad_s * -dt_s);
            self.attitude = self.attitude.turned(motion.turn.then(bias_turn)).attitude;
        }
        self.pass(dt_s);
        let turn_rate_rad_s = turn_rate_rad_s(self.attitude, sensed_rad_s - self.bias_rad_s);
        self.turn_rate_rad_s += (turn_rate_rad_s - self.turn_rate_rad_s) * low_pass_gain(dt_s, TURN_MEAN_S);
        let mut innovation = 0.0;
        if let Some(inclination) = &input.inclination {
            if self.started {
                innovation = innovation_rad(inclination, self.attitude);
                corrections.tilt = self.pull(inclination, turn_rate_rad_s);
            } else {
                self.level(inclination);
                corrections.aligned = true;
            }
            self.unlevelled_s = 0.0;
        }
        if let (true, Some(fix)) = (self.started, self.usable(input.fix.as_ref())) {
            let taken = self.take(fix);
            let (tilt, aligned) = (corrections.tilt || taken.tilt, corrections.aligned || taken.aligned);
            corrections = Corrections { tilt, aligned, ..taken };
        }
        self.feed_in(dt_s);
        match (&input.motion, &input.inclination) {
            (Some(_), Some(inclination)) if input.rest_credible => {
                corrections.rest = self.stand(sensed_rad_s, inclination.force_m_s2, dt_s);
                corrections.bias |= corrections.rest;
            }
            _ => self.still.interrupt(),
        }
        Fused {
            attitude: self.attitude,
            rate_rad_s: sensed_rad_s - self.bias_rad_s,
            bias_rad_s: self.bias_rad_s,
            innovation_rad: innovation,
            inclination_sd_rad: self.inclination_sd_rad(),
            heading_sd_rad: self.heading_sd_rad(),
            reference: self.reference(),
            corrections,
        }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.attitude.visit(visit);
        self.started.visit(visit);
        self.unlevelled_s.visit(visit);
        self.bias_rad_s.visit(visit);
        self.bias_variance_rad2_s2.visit(visit);
        self.turn_rate_rad_s.visit(visit);
        self.aiding.visit(visit);
        self.heading.visit(visit);
        self.pending_rad.visit(visit);
        self.low_pass_m_s2.visit(visit);
        self.unaveraged_s.visit(visit);
        self.lag_rad.visit(visit);
        self.still.visit(visit);
        self.carried.visit(visit);
    }

    fn flaw(&self) -> Option<&'static str> {
        let negative = self.bias_variance_rad2_s2 < 0.0 || self.unlevelled_s < 0.0 || self.unaveraged_s < 0.0;
        attitude_flaw(self.attitude)
            .or(bias_flaw(self.bias_rad_s))
            .or(negative.then_some("a variance or a time below zero"))
            .or_else(|| self.aiding.flaw())
            .or_else(|| self.heading.flaw())
            .or_else(|| self.still.flaw())
            .or_else(|| self.carried.flaw())
    }

    fn common(&self) -> Estimate {
        // At first it is assumed, not found.
        let own_sd_rad_s = Some(self.bias_sd_rad_s()).filter(|sd_rad_s| *sd_rad_s < BIAS_SD_RAD_S);
        let (bias_rad_s, bias_sd_rad_s) = self.carried.or(self.bias_rad_s, own_sd_rad_s.unwrap_or(f64::INFINITY));
        Estimate {
            attitude: self.attitude,
            reference: self.reference(),
            bias_rad_s,
            inclination_sd_rad: self.inclination_sd_rad(),
            heading_sd_rad: self.heading_sd_rad(),
            bias_sd_rad_s,
            gyro_scale: self.carried.gyro_scale(),
            hard_iron: self.carried.hard_iron(),
            leaky_velocity: LeakyVelocity::UNKNOWN,
        }
    }

    fn adopt(&mut self, common: &Estimate) -> Result<(), RestoreError> {
        common.checked()?;
        let mut adopted = Self { settings: self.settings, attitude: common.attitude, started: true, ..Self::default() };
        if common.bias_sd_rad_s.is_finite() {
            adopted.bias_rad_s = bounded(common.bias_rad_s, BIAS_MAX_RAD_S);
            // As well as that it is known only where the level is, too, and the speed: what the giver has is levelled as in the beginning.
            let sd_rad_s = common.bias_sd_rad_s.max(BIAS_KNOWN_SD_RAD_S);
            adopted.bias_variance_rad2_s2 = (sd_rad_s * sd_rad_s).min(adopted.bias_variance_rad2_s2);
        }
        // The giver's level lags by what it lags by: what is left of the force then is not zero.
        adopted.unaveraged_s = self.settings.cold_low_pass_s;
        adopted.carried = Carried::of(common);
        if common.reference == Reference::True {
            adopted.heading = Heading::of(common.heading_sd_rad);
        }
        *self = adopted;
        Ok(())
    }
}
