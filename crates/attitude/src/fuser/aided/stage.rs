//! Implementation of the stage contract: step, snapshot and hand-over.

use core::f64::consts::PI;

use super::{
    covariance::{GYRO, HEADING},
    filter::Aided,
    settings::Settings,
    strapdown,
    variance::square,
};
use crate::{
    Vector3,
    course::CourseReference,
    fuser::{
        bias_handover::HandedOverBias,
        estimate::Estimate,
        finite::fuser_items,
        fused::{Corrections, Fused, innovation_rad},
        input::FuserInput,
    },
    parameters::{Parameter, ParameterError, Parameters},
    scalars::{Scalars, visit_fields},
    stage::{Stage, attitude_validation_error, bias_validation_error},
};

impl Aided {
    pub(in crate::fuser) fn fuse(&mut self, input: &FuserInput) -> Fused {
        let corrections = self.advance(input);
        self.output(input, corrections)
    }

    /// Processes a tick and returns the corrections that were applied.
    pub(in crate::fuser) fn advance(&mut self, input: &FuserInput) -> Corrections {
        let mut corrections = Corrections::default();
        let dt_s = input.motion.as_ref().map_or(0.0, |motion| motion.dt_s);
        if let (false, Some(inclination)) = (self.started, &input.inclination) {
            self.attitude = self.attitude.realigned(inclination.up).attitude;
            self.started = true;
            corrections.aligned = true;
        }
        let force_m_s2 =
            input.inclination.as_ref().map(|inclination| inclination.force_m_s2).filter(strapdown::is_plausible_force);
        self.handed_over.observe(input);
        if let Some(motion) = &input.motion {
            corrections.aligned |= self.propagate(motion, force_m_s2);
            corrections.tilt = self.started;
        }
        if self.started {
            self.aiding.advance_time(dt_s);
            if let Some(fix) = &input.fix {
                self.on_fix(fix, &mut corrections);
            }
            corrections.bias |= self.apply_assumed_velocity();
            corrections.rest = self.apply_standstill(input, force_m_s2);
            corrections.bias |= corrections.velocity || corrections.rest;
            self.since_field_s = (self.since_field_s + dt_s).min(10.0);
            if let Some(field_ut) = &input.field_ut {
                self.update_magnetic_heading(*field_ut, &mut corrections);
            }
        }
        corrections
    }

    /// Returns the output after [`advance`](Self::advance) with the same input.
    pub(in crate::fuser) fn output(&self, input: &FuserInput, corrections: Corrections) -> Fused {
        Fused {
            attitude: self.attitude,
            rate_rad_s: input.motion.map_or(Vector3::zeros(), |motion| motion.rate_rad_s - self.gyro_bias_rad_s),
            bias_rad_s: self.gyro_bias_rad_s,
            innovation_rad: input.inclination.map_or(0.0, |inclination| innovation_rad(&inclination, self.attitude)),
            inclination_sd_rad: self.reported_inclination_sd_rad(),
            heading_sd_rad: self.reported_heading_sd_rad(),
            reference: self.reference,
            corrections,
        }
    }

    pub(in crate::fuser) fn continue_from(&mut self, common: &Estimate) {
        let max_variance = square(self.settings.gyro_bias_sd_deg_s.to_radians());
        let mut adopted = Self::new(self.settings);
        adopted.attitude = common.attitude;
        adopted.started = true;
        adopted.gyro_bias_rad_s = common.bias_rad_s.map(|x| x.clamp(-1.0, 1.0));
        for axis in GYRO..GYRO + 3 {
            adopted.covariance.reset(axis, square(common.bias_sd_rad_s).min(max_variance));
        }
        // The received standard deviation comes from innovations, which do not show a lasting level
        // error. The standard deviation of an initial level is therefore added.
        adopted.reset_level(libm::hypot(common.inclination_sd_rad.min(1.0), self.settings.level_sd_deg.to_radians()));
        adopted.handed_over = HandedOverBias::from_estimate(common);
        adopted.reference = common.reference;
        adopted.course_known = common.reference == CourseReference::True;
        adopted.covariance.reset(HEADING, square(common.heading_sd_rad.clamp(1e-3, PI)));
        *self = adopted;
    }
}

impl Stage for Aided {
    fuser_items!();

    fn name(&self) -> &'static str {
        "aided"
    }

    fn parameters(&self) -> &'static [Parameter] {
        Settings::TABLE
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        let mut settings = self.settings;
        settings.set(name, value)?;
        *self = Self::new(settings);
        Ok(())
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.attitude.visit(visit);
        self.pending_rad.visit(visit);
        self.started.visit(visit);
        let (mut is_magnetic, mut is_true) =
            (self.reference == CourseReference::Magnetic, self.reference == CourseReference::True);
        is_magnetic.visit(visit);
        is_true.visit(visit);
        self.reference = match (is_magnetic, is_true) {
            (_, true) => CourseReference::True,
            (true, false) => CourseReference::Magnetic,
            (false, false) => CourseReference::Arbitrary,
        };
        self.course_known.visit(visit);
        visit_fields!(self, visit:
            velocity_m_s, antenna_velocity_m_s, gyro_bias_rad_s, accel_bias_m_s2, latency_s, covariance,
            velocity_history, sums, turn_rate_rad_s, aiding, consistency, standstill, handed_over, since_field_s;
            without settings, attitude, pending_rad, started, reference, course_known
        );
    }

    fn validation_error(&self) -> Option<&'static str> {
        // Each component is clamped to 1 rad when it is set. Rotating the axes can increase it to
        // √2 rad.
        let pending = (self.pending_rad.amax() > 1.5).then_some("a pending correction above 1.5 rad");
        let latency = (!(0.0..=0.6).contains(&self.latency_s)).then_some("a latency outside 0 to 0.6 s");
        attitude_validation_error(self.attitude)
            .or_else(|| bias_validation_error(self.gyro_bias_rad_s))
            .or(pending)
            .or(latency)
            .or_else(|| self.covariance.validation_error())
            .or_else(|| self.consistency.validation_error())
            .or_else(|| self.sums.validation_error())
            .or_else(|| self.handed_over.validation_error())
    }

    fn common(&self) -> Estimate {
        let bias_variance = (GYRO..GYRO + 3).map(|axis| self.covariance.variance(axis)).fold(0.0, f64::max);
        Estimate {
            attitude: self.attitude,
            reference: self.reference,
            inclination_sd_rad: self.inclination_sd_rad(),
            heading_sd_rad: self.heading_sd_rad(),
            ..self.handed_over.sensor_errors_or(self.gyro_bias_rad_s, libm::sqrt(bias_variance))
        }
    }
}
