//! Fuser `vqf`: VQF as implemented by vqf-rs, with its default parameters, as the benchmark.
//!
//! Laidig and Seel, VQF: highly accurate IMU orientation estimation with bias estimation and
//! magnetic disturbance rejection, *Information Fusion* 91, 2023, 187–204.
//!
//! Frames and signs are those of this crate: east, north, up. The heading is that of the
//! magnetometer-free attitude until the first magnetic field sample.
//!
//! vqf-rs filters with a sampling time that is fixed on construction. Here the mean of the first
//! intervals serves as this sampling time. The attitude itself is integrated over the actual length
//! of each interval.

mod filter;
mod level;
mod period;
mod quaternions;
mod vqf_state;

pub use filter::Vqf;

use super::{
    angle_uncertainty::AngleUncertainty,
    estimate::Estimate,
    field::field_direction,
    finite::fuser_items,
    fused::{Corrections, Fused, innovation_rad},
    input::FuserInput,
};
use crate::{
    Vector3,
    course::CourseReference,
    scalars::visit_fields,
    stage::{Stage, bias_validation_error},
};
use {filter::clamped, vqf_state::visit_state};

impl Vqf {
    pub(super) fn realign(&mut self) {
        self.levelled = false;
    }

    fn fuse(&mut self, input: &FuserInput) -> Fused {
        let mut corrections = Corrections::default();
        let mut innovation = 0.0;
        if let Some(motion) = &input.motion {
            self.process_motion(motion);
        }
        if let Some(inclination) = &input.inclination {
            if self.levelled {
                innovation = innovation_rad(inclination, self.attitude());
                corrections.tilt = true;
            } else {
                self.align_level(inclination.up);
                corrections.aligned = true;
            }
            if !input.rest_credible {
                let state = self.filter.state_mut();
                (state.rest_detected, state.rest_t) = (false, 0.0);
            }
            self.filter.update_acc(clamped(inclination.force_m_s2));
            let dt_s = self.motion_period.mean_s;
            self.tilt.record_correction(innovation, dt_s / (self.filter.params().tau_acc + dt_s), dt_s);
            corrections.bias = true;
            corrections.rest = self.filter.rest_detected();
        }
        if let (true, Some(field_ut)) =
            (self.levelled, input.field_ut.filter(|field| field_direction(*field).is_some()))
        {
            corrections.aligned |= self.process_field(field_ut);
            corrections.disturbed = self.filter.mag_dist_detected();
            corrections.magnetic = self.filter.state().last_mag_corr_angular_rate != 0.0;
        }
        let bias_rad_s = self.bias_rad_s();
        Fused {
            attitude: self.attitude(),
            rate_rad_s: input.motion.map_or(Vector3::zeros(), |motion| motion.rate_rad_s - bias_rad_s),
            bias_rad_s,
            innovation_rad: innovation,
            inclination_sd_rad: self.tilt.sd_rad(),
            heading_sd_rad: self.heading.sd_rad(),
            reference: self.reference(),
            corrections,
        }
    }

    /// Continues from a handed-over state. A heading that refers to true north is kept until the
    /// next magnetic field sample, which resets it. The bias is clamped to the range of VQF.
    fn continue_from(&mut self, common: &Estimate) {
        self.set_attitude(common.attitude);
        self.seed_low_pass(common.leaky_velocity.initial_m_s());
        self.velocity_sd_m_s = common.leaky_velocity.initial_sd_m_s();
        self.levelled = true;
        self.magnetic = common.reference == CourseReference::Magnetic;
        let params = self.filter.params();
        let (bias_max, sd_max) = (params.bias_clip.to_radians(), params.bias_sigma_init.to_radians());
        let bias_rad_s = common.bias_rad_s.map(|x| x.clamp(-bias_max, bias_max));
        // VQF treats the uncertainty of the bias as on a cold start, because the composition of the
        // handed-over error is unknown.
        self.filter.set_bias_estimate(bias_rad_s.into(), Some(sd_max));
        let state = self.filter.state_mut();
        state.delta = 0.0;
        state.k_mag_init = if self.magnetic { 0.0 } else { 1.0 };
        self.tilt = AngleUncertainty::from_sd(common.inclination_sd_rad);
        self.heading = AngleUncertainty::from_sd(common.heading_sd_rad);
        self.gyro_scale = common.gyro_scale;
        self.hard_iron = common.hard_iron;
    }
}

impl Stage for Vqf {
    fuser_items!();

    fn name(&self) -> &'static str {
        "vqf"
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let previous_means = (self.motion_period.mean_s, self.field_period.mean_s);
        visit_fields!(self, visit:
            motion_period, field_period, levelled, magnetic, tilt, heading, velocity_sd_m_s, gyro_scale, hard_iron;
            without filter
        );
        visit_state(self.filter.state_mut(), visit);
        if previous_means != (self.motion_period.mean_s, self.field_period.mean_s) && self.timing_error().is_none() {
            self.rebuild();
        }
    }

    fn validation_error(&self) -> Option<&'static str> {
        self.timing_error()
            .or_else(|| vqf_state::validation_error(self.filter.state()))
            .or_else(|| bias_validation_error(self.bias_rad_s()))
            .or_else(|| self.tilt.validation_error())
            .or_else(|| self.heading.validation_error())
            .or_else(|| (self.velocity_sd_m_s < 0.0).then_some("a negative standard deviation"))
            .or_else(|| self.gyro_scale.validation_error())
            .or_else(|| self.hard_iron.validation_error())
    }

    fn common(&self) -> Estimate {
        Estimate {
            attitude: self.attitude(),
            reference: self.reference(),
            bias_rad_s: self.bias_rad_s(),
            inclination_sd_rad: self.tilt.sd_rad(),
            heading_sd_rad: self.heading.sd_rad(),
            bias_sd_rad_s: self.filter.bias_estimate().1,
            gyro_scale: self.gyro_scale,
            hard_iron: self.hard_iron,
            leaky_velocity: self.leaky_velocity(),
        }
    }
}

impl PartialEq for Vqf {
    fn eq(&self, other: &Self) -> bool {
        self.snapshot() == other.snapshot()
    }
}
