//! First-order closed loop: steps the fused point exactly, then moves it towards the
//! accelerometer's point.
//!
//! w_c' = f(w_c, ω) + (w_acc − w_c)/T — Matveev 2025, fig. 9, closed. z is corrected by the
//! magnetic field in the same way, or follows the gyro if there is no field.

use super::{
    estimate::Estimate,
    finite::fuser_items,
    first_order::{FirstOrder, MAX_POINT_MODULUS, Settings},
    fused::{Corrections, Fused, innovation_rad},
    input::FuserInput,
};
use crate::{
    parameters::parameters_of,
    point::Point,
    scalars::visit_fields,
    stage::{Stage, attitude_validation_error},
    state::{Attitude, wrapped_rad},
};

/// Fuser stage `wz-closed`: first-order closed loop with the accelerometer's point.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WzClosed {
    attitude: Attitude,
    common: FirstOrder,
}

impl WzClosed {
    pub(super) fn realign(&mut self) {
        self.common.started = false;
    }

    fn fuse(&mut self, input: &FuserInput) -> Fused {
        let mut corrections = Corrections::default();
        if let Some(motion) = &input.motion {
            self.attitude = self.attitude.rotated(motion.rotation).attitude;
        }
        let dt_s = self.common.advance(input);
        let mut innovation = 0.0;
        if let Some(inclination) = &input.inclination {
            if self.common.started {
                innovation = innovation_rad(inclination, self.attitude);
                let gain = self.common.tilt_gain(dt_s);
                let Point { w, chart } = self.attitude.up;
                self.attitude.up.w += (inclination.up.w_in_chart(chart, MAX_POINT_MODULUS) - w) * gain;
                self.attitude = self.attitude.normalised();
                self.common.record_correction(innovation, gain, dt_s, &mut corrections);
            } else {
                self.attitude = self.attitude.realigned(inclination.up).attitude;
                self.common.record_alignment(&mut corrections);
            }
        }
        if let Some(z_rad) = self.common.heading_correction_rad(self.attitude, input, &mut corrections) {
            self.attitude.z_rad = wrapped_rad(self.attitude.z_rad + z_rad);
        }
        self.common.fused(self.attitude, input, innovation, corrections)
    }

    fn continue_from(&mut self, common: &Estimate) {
        *self = Self { attitude: common.attitude, common: self.common.continued_from(common) };
    }
}

impl Stage for WzClosed {
    fuser_items!();

    fn name(&self) -> &'static str {
        "wz-closed"
    }

    parameters_of!(Settings in common.settings);

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        visit_fields!(self, visit: attitude, common);
    }

    fn validation_error(&self) -> Option<&'static str> {
        attitude_validation_error(self.attitude).or_else(|| self.common.validation_error())
    }

    fn common(&self) -> Estimate {
        self.common.estimate(self.attitude)
    }
}
