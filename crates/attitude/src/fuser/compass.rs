//! Magnetic heading through a first-order low-pass filter, like the fusion of w with the
//! accelerometer.
//!
//! z_c' = z' + (z_mag − z_c)/T, with the difference wrapped. Here z_c is the fused z, z is
//! integrated from the gyro, and T is the time constant. z_mag = atan2(m'_ξ, m'_η) is the heading
//! of the levelled magnetic field m' = A(w)ᵀ m, with m in body axes. "z is fused like w" — Matveev
//! 2025, which gives no further detail. No magnetic field sample is rejected as disturbed.

use super::{
    angle_uncertainty::{ASSUMED_BIAS_SD_RAD_S, AngleUncertainty},
    field::{field_direction, heading_correction_rad},
    fused::Corrections,
    low_pass::low_pass_gain,
};
use crate::{Vector3, course::CourseReference, scalars::scalars, state::Attitude};

/// State of the heading correction.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Compass {
    magnetic: bool,
    since_field_s: f64,
    uncertainty: AngleUncertainty,
}

impl Default for Compass {
    fn default() -> Self {
        Self { magnetic: false, since_field_s: 0.0, uncertainty: AngleUncertainty::UNKNOWN }
    }
}

impl Compass {
    /// Creates the state from another stage's heading.
    ///
    /// A heading that refers to true north is kept until the first magnetic field sample, which
    /// sets the heading.
    pub(super) fn new(reference: CourseReference, heading_sd_rad: f64) -> Self {
        Self {
            magnetic: reference == CourseReference::Magnetic,
            since_field_s: 0.0,
            uncertainty: AngleUncertainty::from_sd(heading_sd_rad),
        }
    }

    /// Adds the gyro drift over `dt_s` to the uncertainty.
    pub(super) fn drift(&mut self, dt_s: f64) {
        self.since_field_s += dt_s;
        self.uncertainty.drift(ASSUMED_BIAS_SD_RAD_S, dt_s);
    }

    /// Returns the correction to z from a magnetic field sample, rad. The first sample sets the
    /// heading.
    pub(super) fn correction_rad(
        &mut self,
        attitude: Attitude,
        field_ut: Vector3<f64>,
        time_constant_s: f64,
        corrections: &mut Corrections,
    ) -> f64 {
        let Some(field) = field_direction(field_ut) else { return 0.0 };
        let innovation_rad = heading_correction_rad(attitude, field);
        let interval_s = core::mem::take(&mut self.since_field_s);
        if !self.magnetic {
            (self.magnetic, self.uncertainty) = (true, AngleUncertainty::INITIAL);
            corrections.aligned = true;
            return innovation_rad;
        }
        let gain = low_pass_gain(interval_s, time_constant_s);
        self.uncertainty.record_correction(innovation_rad, gain, interval_s);
        corrections.magnetic = true;
        innovation_rad * gain
    }

    pub(super) fn reference(&self) -> CourseReference {
        if self.magnetic { CourseReference::Magnetic } else { CourseReference::Arbitrary }
    }

    pub(super) fn sd_rad(&self) -> f64 {
        self.uncertainty.sd_rad()
    }

    pub(super) fn validation_error(&self) -> Option<&'static str> {
        (self.since_field_s < 0.0).then_some("a time below zero").or_else(|| self.uncertainty.validation_error())
    }
}

scalars!(Compass: magnetic, since_field_s, uncertainty);
