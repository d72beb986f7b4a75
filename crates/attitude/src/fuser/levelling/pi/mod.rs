//! Fuser stage `levelling-pi`: levelling by matched velocity increments, with an estimate of the
//! gyro bias.
//!
//! With a gyro bias b and its estimate b̂, the level error ε follows
//!
//! ε' = b − b̂ − ε/τ,  b̂' = ε/(4τ²)
//!
//! with two equal roots at −1/(2τ). With τ = 20 s the bias estimate converges within minutes, and
//! the bias then has no effect. Only the effect of the accelerometer bias remains, which is 0.12°
//! for 0.02 m/s².
//!
//! While fixes arrive, the centripetal acceleration V H' (speed times turn rate) is not used.
//! Instead, the force is compared with the change of velocity as a vector. This is correct in wind,
//! too, provided that the platform's azimuth is correct.

mod aiding;
mod delay_matching;
mod filter;
mod heading;
mod law;
mod settings;
mod standstill;

pub use {filter::LevellingPi, settings::PiSettings};

use super::{
    geometry::{azimuth, turn_rate_rad_s},
    level_force::LevelForce,
    limits::{MIN_INCLINATION_SD_RAD, interval_s, limited, plausible_fix},
};
use crate::{
    Complex, Vector3,
    accel::Inclination,
    course::CourseReference,
    fuser::{
        bias_handover::HandedOverBias,
        estimate::Estimate,
        finite::fuser_items,
        fused::{Corrections, Fused, innovation_rad},
        input::FuserInput,
        low_pass::low_pass_gain,
    },
    gnss::Fix,
    parameters::parameters_of,
    rotation::Rotation,
    scalars::visit_fields,
    stage::{Stage, attitude_validation_error, bias_validation_error},
};
use {
    filter::{KNOWN_BIAS_SD_RAD_S, MAX_BIAS_RAD_S, UNKNOWN_BIAS_SD_RAD_S},
    heading::Heading,
};

/// Averaging time of the turn rate that determines the weight of the force, s.
const TURN_RATE_AVERAGING_S: f64 = 1.0;

impl LevellingPi {
    pub(in crate::fuser) fn realign(&mut self) {
        self.started = false;
    }

    /// Sets the level and discards increments and filter states, which belong to the previous
    /// level.
    fn align_level(&mut self, inclination: &Inclination) {
        self.attitude = self.attitude.realigned(inclination.up).attitude;
        let zero = Complex::new(0.0, 0.0);
        (self.pending_rad, self.low_pass_m_s2, self.lag_rad) = (zero, zero, zero);
        self.averaging_deficit_s = 0.0;
        self.aiding.interrupt();
        self.started = true;
    }

    /// Integrates a force into the velocity increment. In a gap without fixes, the force also
    /// corrects the level. Returns `true` if the level was corrected.
    fn process_force(&mut self, inclination: &Inclination, turn_rate_rad_s: f64) -> bool {
        let force = LevelForce::new(self.attitude, inclination, self.since_force_s);
        if self.since_force_s > force.dt_s {
            self.aiding.interrupt();
        }
        self.aiding.push_force(azimuth(self.attitude) * force.level_m_s2, force.dt_s);
        if self.aiding.is_recent(self.settings.gap_s) {
            (self.low_pass_m_s2, self.averaging_deficit_s) = (Complex::new(0.0, 0.0), 0.0);
            return false;
        }
        self.level_without_fix(force, turn_rate_rad_s);
        true
    }

    /// Returns the standard deviation of the inclination, rad. It includes the levelling lag. In a
    /// gap it also includes the drift caused by an unknown bias.
    fn inclination_sd_rad(&self) -> f64 {
        let since_s = self.aiding.since_fix_s();
        let gap_s = if since_s > self.settings.gap_s { since_s.min(self.settings.gap_time_constant_s) } else { 0.0 };
        let drift_rad = self.bias_sd_rad_s() * gap_s;
        libm::sqrt(self.lag_rad.norm_sqr() + drift_rad * drift_rad + MIN_INCLINATION_SD_RAD * MIN_INCLINATION_SD_RAD)
    }

    fn heading_sd_rad(&self) -> f64 {
        self.heading.sd_rad(self.aiding.speed_m_s().unwrap_or(0.0))
    }

    fn reference(&self) -> CourseReference {
        if self.heading.known { CourseReference::True } else { CourseReference::Arbitrary }
    }

    fn usable_fix<'a>(&self, fix: Option<&'a Fix>) -> Option<&'a Fix> {
        plausible_fix(fix).filter(|fix| fix.sd_m_s.is_none_or(|sd| sd <= self.settings.velocity_sd_max_m_s))
    }

    fn fuse(&mut self, input: &FuserInput) -> Fused {
        let mut corrections = Corrections::default();
        let dt_s = interval_s(input.motion.as_ref());
        let measured_rad_s = input.motion.map_or(Vector3::zeros(), |motion| motion.rate_rad_s);
        self.bias_handover.observe(input);
        if let Some(motion) = &input.motion {
            let bias_rotation = Rotation::from_rotation_vector(self.bias_rad_s * -dt_s);
            self.attitude = self.attitude.rotated(motion.rotation.then(bias_rotation)).attitude;
        }
        self.advance(dt_s);
        let turn_rate_rad_s = turn_rate_rad_s(self.attitude, measured_rad_s - self.bias_rad_s);
        self.turn_rate_rad_s += (turn_rate_rad_s - self.turn_rate_rad_s) * low_pass_gain(dt_s, TURN_RATE_AVERAGING_S);
        let mut innovation = 0.0;
        if let Some(inclination) = &input.inclination {
            if self.started {
                innovation = innovation_rad(inclination, self.attitude);
                corrections.tilt = self.process_force(inclination, turn_rate_rad_s);
            } else {
                self.align_level(inclination);
                corrections.aligned = true;
            }
            self.since_force_s = 0.0;
        }
        if let (true, Some(fix)) = (self.started, self.usable_fix(input.fix.as_ref())) {
            let by_fix = self.process_fix(fix);
            let (tilt, aligned) = (corrections.tilt || by_fix.tilt, corrections.aligned || by_fix.aligned);
            corrections = Corrections { tilt, aligned, ..by_fix };
        }
        self.apply_pending(dt_s);
        match (&input.motion, &input.inclination) {
            (Some(_), Some(inclination)) if input.rest_credible => {
                corrections.rest = self.update_standstill(measured_rad_s, inclination.force_m_s2, dt_s);
                corrections.bias |= corrections.rest;
            }
            _ => self.standstill.interrupt(),
        }
        Fused {
            attitude: self.attitude,
            rate_rad_s: measured_rad_s - self.bias_rad_s,
            bias_rad_s: self.bias_rad_s,
            innovation_rad: innovation,
            inclination_sd_rad: self.inclination_sd_rad(),
            heading_sd_rad: self.heading_sd_rad(),
            reference: self.reference(),
            corrections,
        }
    }

    fn continue_from(&mut self, common: &Estimate) {
        let mut adopted = Self { settings: self.settings, attitude: common.attitude, started: true, ..Self::default() };
        if common.bias_sd_rad_s.is_finite() {
            adopted.bias_rad_s = limited(common.bias_rad_s, MAX_BIAS_RAD_S);
            // A bias may count as known only if the level and the speed are known, too. After a
            // hand-over, level and speed count as unknown, as on a cold start.
            let sd_rad_s = common.bias_sd_rad_s.max(KNOWN_BIAS_SD_RAD_S);
            adopted.bias_variance_rad2_s2 = (sd_rad_s * sd_rad_s).min(adopted.bias_variance_rad2_s2);
        }
        // The previous stage's level may lag. The mean horizontal force is then not zero, so the
        // low-pass filter starts as a plain mean.
        adopted.averaging_deficit_s = self.settings.cold_low_pass_s;
        adopted.bias_handover = HandedOverBias::from_estimate(common);
        if common.reference == CourseReference::True {
            adopted.heading = Heading::with_sd(common.heading_sd_rad);
        }
        *self = adopted;
    }
}

impl Stage for LevellingPi {
    fuser_items!();

    fn name(&self) -> &'static str {
        "levelling-pi"
    }

    parameters_of!(PiSettings in settings);

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        visit_fields!(self, visit:
            attitude, started, since_force_s, bias_rad_s, bias_variance_rad2_s2, turn_rate_rad_s, aiding, heading,
            pending_rad, low_pass_m_s2, averaging_deficit_s, lag_rad, standstill, bias_handover; without settings
        );
    }

    fn validation_error(&self) -> Option<&'static str> {
        let negative = self.bias_variance_rad2_s2 < 0.0 || self.since_force_s < 0.0 || self.averaging_deficit_s < 0.0;
        attitude_validation_error(self.attitude)
            .or(bias_validation_error(self.bias_rad_s))
            .or(negative.then_some("a negative variance or time"))
            .or_else(|| self.aiding.validation_error())
            .or_else(|| self.heading.validation_error())
            .or_else(|| self.standstill.validation_error())
            .or_else(|| self.bias_handover.validation_error())
    }

    fn common(&self) -> Estimate {
        // The initial standard deviation is an assumption, not an estimate.
        let own_sd_rad_s = Some(self.bias_sd_rad_s()).filter(|sd_rad_s| *sd_rad_s < UNKNOWN_BIAS_SD_RAD_S);
        Estimate {
            attitude: self.attitude,
            reference: self.reference(),
            inclination_sd_rad: self.inclination_sd_rad(),
            heading_sd_rad: self.heading_sd_rad(),
            ..self.bias_handover.sensor_errors_or(self.bias_rad_s, own_sd_rad_s.unwrap_or(f64::INFINITY))
        }
    }
}
