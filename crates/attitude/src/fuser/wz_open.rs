//! Open loop as published: w_c = HPF(w_gyro) + LPF(w_acc).
//!
//! Because HPF = 1 − LPF, w_c = w_gyro + e with T e' = (w_acc − w_gyro) − e — Matveev 2025, fig. 9,
//! T = 1 s. z is corrected by the magnetic field in the same way, or follows the gyro if there is
//! no field. The gyro channel integrates without correction and drifts without bound, so the error
//! grows with time. The published method is kept for comparison.

use super::{
    estimate::Estimate,
    finite::fuser_items,
    first_order::{FirstOrder, MAX_POINT_MODULUS, Settings},
    fused::{Corrections, Fused, innovation_rad},
    input::FuserInput,
};
use crate::{
    Complex,
    gyro::Motion,
    parameters::parameters_of,
    point::Point,
    scalars::visit_fields,
    stage::{Stage, attitude_validation_error},
    state::{Attitude, wrapped_rad},
};

/// Fuser stage `wz-open`: high-pass filtered gyro plus low-pass filtered accelerometer.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WzOpen {
    /// Last attitude of the gyro slot.
    gyro_attitude: Attitude,
    /// Offset e of the fused point from the gyro's point, in the gyro's chart.
    w_offset: Complex<f64>,
    /// Offset of the fused z from the gyro's z.
    z_offset_rad: f64,
    /// Set if `gyro_attitude` was adopted from another stage instead of received from the gyro
    /// slot.
    adopted: bool,
    common: FirstOrder,
}

impl WzOpen {
    pub(super) fn realign(&mut self) {
        self.common.started = false;
    }

    fn fused_attitude(&self) -> Attitude {
        let up = Point { w: self.gyro_attitude.up.w + self.w_offset, chart: self.gyro_attitude.up.chart };
        Attitude { up, z_rad: wrapped_rad(self.gyro_attitude.z_rad + self.z_offset_rad) }.normalised()
    }

    /// Adopts the latest attitude of the gyro slot. Sets the offset first if it has not been set
    /// yet.
    fn follow_gyro(&mut self, motion: &Motion) {
        if self.adopted {
            self.set_offset(self.gyro_attitude.rotated(motion.rotation).attitude, motion.attitude);
            self.adopted = false;
        }
        self.follow_chart(motion.attitude);
    }

    /// Adopts the gyro's attitude and converts the offset if the gyro's chart has changed. The
    /// fused point stays unchanged.
    fn follow_chart(&mut self, gyro: Attitude) {
        if gyro.up.chart != self.gyro_attitude.up.chart {
            let fused = Point { w: self.gyro_attitude.up.w + self.w_offset, chart: self.gyro_attitude.up.chart };
            let before = self.gyro_attitude.up.w_in_chart(gyro.up.chart, MAX_POINT_MODULUS);
            self.w_offset = fused.w_in_chart(gyro.up.chart, MAX_POINT_MODULUS) - before;
        }
        self.gyro_attitude = gyro;
    }

    /// Sets the offset between the fused attitude and the gyro's.
    fn set_offset(&mut self, fused: Attitude, gyro: Attitude) {
        self.w_offset = fused.up.w_in_chart(gyro.up.chart, MAX_POINT_MODULUS) - gyro.up.w;
        self.gyro_attitude = gyro;
        // The remaining difference between the two attitudes is a rotation about the vertical.
        let rotation = fused.quaternion() * self.fused_attitude().quaternion().conjugate();
        self.z_offset_rad = wrapped_rad(self.z_offset_rad + 2.0 * libm::atan2(rotation.k, rotation.w));
    }

    fn fuse(&mut self, input: &FuserInput) -> Fused {
        let mut corrections = Corrections::default();
        if let Some(motion) = &input.motion {
            self.follow_gyro(motion);
        }
        let dt_s = self.common.advance(input);
        let mut innovation = 0.0;
        if let Some(inclination) = &input.inclination {
            let Point { w, chart } = self.gyro_attitude.up;
            let offset = inclination.up.w_in_chart(chart, MAX_POINT_MODULUS) - w;
            if self.common.started {
                let gain = self.common.tilt_gain(dt_s);
                self.w_offset += (offset - self.w_offset) * gain;
                innovation = innovation_rad(inclination, self.fused_attitude());
                self.common.record_correction(innovation, gain, dt_s, &mut corrections);
            } else {
                self.w_offset = offset;
                self.common.record_alignment(&mut corrections);
            }
        }
        if let Some(z_rad) = self.common.heading_correction_rad(self.fused_attitude(), input, &mut corrections) {
            self.z_offset_rad = wrapped_rad(self.z_offset_rad + z_rad);
        }
        self.common.fused(self.fused_attitude(), input, innovation, corrections)
    }

    /// Adopts the attitude of another stage. This attitude differs from that of the gyro slot, so
    /// the offset between them is computed at the next motion.
    fn continue_from(&mut self, common: &Estimate) {
        *self = Self {
            gyro_attitude: common.attitude,
            adopted: true,
            common: self.common.continued_from(common),
            ..Self::default()
        };
    }
}

impl Stage for WzOpen {
    fuser_items!();

    fn name(&self) -> &'static str {
        "wz-open"
    }

    parameters_of!(Settings in common.settings);

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        visit_fields!(self, visit: gyro_attitude, w_offset, z_offset_rad, adopted, common);
    }

    fn validation_error(&self) -> Option<&'static str> {
        // The offset is the difference between two points, each within the maximum modulus.
        let out_of_range =
            self.w_offset.norm_sqr() > 4.0 * MAX_POINT_MODULUS * MAX_POINT_MODULUS || self.z_offset_rad.abs() > 4.0;
        attitude_validation_error(self.gyro_attitude)
            .or(out_of_range.then_some("an offset out of range between the fused attitude and the gyro's"))
            .or_else(|| self.common.validation_error())
    }

    fn common(&self) -> Estimate {
        self.common.estimate(self.fused_attitude())
    }
}
