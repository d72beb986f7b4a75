//! The fuser `vqf`: VQF as vqf-rs has it, with its default parameters; the yardstick.
//!
//! Laidig and Seel, VQF: highly accurate IMU orientation estimation with bias estimation and magnetic disturbance rejection,
//! *Information Fusion* 91, 2023, 187–204. Frames and signs are those used here, east, north, up; heading is that of its
//! magnetometer-free part until the first field.
//!
//! vqf-rs filters with a sampling time fixed when it is made. It is the mean of the first intervals here; the attitude itself is
//! integrated over each interval's own length.

mod filter;
mod level;
mod numbers;
mod period;
mod quaternions;

pub use filter::Vqf;

use super::{
    estimate::Estimate,
    field::field_direction,
    fused::{Corrections, Fused, innovation_rad},
    input::FuserInput,
    spread::Spread,
};
use crate::{
    Vector3,
    course::Reference,
    numbers::Numbers,
    stage::{RestoreError, Stage, bias_flaw},
};
use {filter::bounded, numbers::visit_numbers};

impl Vqf {
    pub(super) fn realign(&mut self) {
        self.levelled = false;
    }
}

impl Stage for Vqf {
    type Input = FuserInput;
    type Output = Fused;
    type Common = Estimate;

    fn name(&self) -> &'static str {
        "vqf"
    }

    fn step(&mut self, input: &FuserInput) -> Fused {
        let mut room = None;
        let input = input.finite(&mut room);
        let mut corrections = Corrections::default();
        let mut innovation = 0.0;
        if let Some(motion) = &input.motion {
            self.turn(motion);
        }
        if let Some(inclination) = &input.inclination {
            if self.levelled {
                innovation = innovation_rad(inclination, self.attitude());
                corrections.tilt = true;
            } else {
                self.level(inclination.up);
                corrections.aligned = true;
            }
            if !input.rest_credible {
                let state = self.filter.state_mut();
                (state.rest_detected, state.rest_t) = (false, 0.0);
            }
            self.filter.update_acc(bounded(inclination.force_m_s2));
            let dt_s = self.motion.mean_s;
            self.tilt.corrected(innovation, dt_s / (self.filter.params().tau_acc + dt_s), dt_s);
            corrections.bias = true;
            corrections.rest = self.filter.rest_detected();
        }
        if let (true, Some(field_ut)) =
            (self.levelled, input.field_ut.filter(|field| field_direction(*field).is_some()))
        {
            corrections.aligned |= self.point(field_ut);
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

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let timed = (self.motion.mean_s, self.field.mean_s);
        self.motion.visit(visit);
        self.field.visit(visit);
        self.levelled.visit(visit);
        self.magnetic.visit(visit);
        self.tilt.visit(visit);
        self.heading.visit(visit);
        self.velocity_sd_m_s.visit(visit);
        self.gyro_scale.visit(visit);
        self.hard_iron.visit(visit);
        visit_numbers(self.filter.state_mut(), visit);
        if timed != (self.motion.mean_s, self.field.mean_s) && self.timing_flaw().is_none() {
            self.retime();
        }
    }

    fn flaw(&self) -> Option<&'static str> {
        self.timing_flaw()
            .or_else(|| numbers::flaw(self.filter.state()))
            .or_else(|| bias_flaw(self.bias_rad_s()))
            .or_else(|| self.tilt.flaw())
            .or_else(|| self.heading.flaw())
            .or_else(|| (self.velocity_sd_m_s < 0.0).then_some("a standard deviation below zero"))
            .or_else(|| self.gyro_scale.flaw())
            .or_else(|| self.hard_iron.flaw())
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

    /// A heading from true north is kept until the next field, which sets it anew. The bias is held to what VQF allows.
    fn adopt(&mut self, common: &Estimate) -> Result<(), RestoreError> {
        common.checked()?;
        self.put(common.attitude);
        self.trust_level(common.leaky_velocity.first_m_s());
        self.velocity_sd_m_s = common.leaky_velocity.first_sd_m_s();
        self.levelled = true;
        self.magnetic = common.reference == Reference::Magnetic;
        let params = self.filter.params();
        let (bias_max, sd_max) = (params.bias_clip.to_radians(), params.bias_sigma_init.to_radians());
        let bias_rad_s = common.bias_rad_s.map(|x| x.clamp(-bias_max, bias_max));
        // How well it is known VQF finds out as at its own beginning: what the giver's error is made of is not known here.
        self.filter.set_bias_estimate(bias_rad_s.into(), Some(sd_max));
        let state = self.filter.state_mut();
        state.delta = 0.0;
        state.k_mag_init = if self.magnetic { 0.0 } else { 1.0 };
        self.tilt = Spread::of(common.inclination_sd_rad);
        self.heading = Spread::of(common.heading_sd_rad);
        self.gyro_scale = common.gyro_scale;
        self.hard_iron = common.hard_iron;
        Ok(())
    }
}

impl PartialEq for Vqf {
    fn eq(&self, other: &Self) -> bool {
        self.snapshot() == other.snapshot()
    }
}
