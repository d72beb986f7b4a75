//! Heading by the magnetic field through a first-order low-pass, as the point is fused by the accelerometer.
//!
//! z_c' = z' + (z_mag − z_c)/T, the difference wrapped; z_mag = atan2(m'_ξ, m'_η) of the levelled field m' = A(w)ᵀ m. "z is fused like
//! w" — Matveev 2025, which says no more. Every field is believed.

use super::{
    field::{field_direction, north_rad},
    fused::Corrections,
    low_pass::low_pass_gain,
    spread::{BIAS_SD_RAD_S, Spread},
};
use crate::{Vector3, course::Reference, numbers::Numbers, state::Attitude};

/// What is known of the heading.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Compass {
    magnetic: bool,
    /// Since the last field, s.
    since_s: f64,
    spread: Spread,
}

impl Default for Compass {
    fn default() -> Self {
        Self { magnetic: false, since_s: 0.0, spread: Spread::UNKNOWN }
    }
}

impl Compass {
    /// As another stage knew it; a heading from true north is kept until the next field, which sets it anew.
    pub(super) fn of(reference: Reference, heading_sd_rad: f64) -> Self {
        Self { magnetic: reference == Reference::Magnetic, since_s: 0.0, spread: Spread::of(heading_sd_rad) }
    }

    /// The gyro leads for a while.
    pub(super) fn drift(&mut self, dt_s: f64) {
        self.since_s += dt_s;
        self.spread.drift(BIAS_SD_RAD_S, dt_s);
    }

    /// What a field adds to z, rad; the first one sets the heading.
    pub(super) fn correction_rad(
        &mut self,
        attitude: Attitude,
        field_ut: Vector3<f64>,
        time_constant_s: f64,
        corrections: &mut Corrections,
    ) -> f64 {
        let Some(field) = field_direction(field_ut) else { return 0.0 };
        let off_rad = north_rad(attitude, field);
        let interval_s = core::mem::take(&mut self.since_s);
        if !self.magnetic {
            (self.magnetic, self.spread) = (true, Spread::FIRST);
            corrections.aligned = true;
            return off_rad;
        }
        let gain = low_pass_gain(interval_s, time_constant_s);
        self.spread.corrected(off_rad, gain, interval_s);
        corrections.magnetic = true;
        off_rad * gain
    }

    pub(super) fn reference(&self) -> Reference {
        if self.magnetic { Reference::Magnetic } else { Reference::Arbitrary }
    }

    pub(super) fn sd_rad(&self) -> f64 {
        self.spread.sd_rad()
    }

    pub(super) fn flaw(&self) -> Option<&'static str> {
        (self.since_s < 0.0).then_some("a time below zero").or_else(|| self.spread.flaw())
    }
}

impl Numbers for Compass {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.magnetic.visit(visit);
        self.since_s.visit(visit);
        self.spread.visit(visit);
    }
}
