//! Open loop as published: w_c = HPF(w_gyro) + LPF(w_acc).
//!
//! Because HPF = 1 − LPF, w_c = w_gyro + e with T e' = (w_acc − w_gyro) − e — Matveev 2025, fig. 9,
//! T = 1 s. z is corrected by the magnetic field in the same way, or follows the gyro if there is
//! no field. The gyro channel integrates without correction and drifts without bound, so the error
//! grows with time. The published method is kept for comparison.

use super::{
    angle_uncertainty::{ASSUMED_BIAS_SD_RAD_S, AngleUncertainty},
    bias_handover::HandedOverBias,
    compass::Compass,
    estimate::Estimate,
    finite::fuser_step,
    fused::{Corrections, Fused, innovation_rad},
    input::FuserInput,
    low_pass::low_pass_gain,
    wz_closed::MAX_POINT_MODULUS,
};
use crate::{
    Complex, Vector3,
    gyro::Motion,
    parameters::{parameters_of, settings},
    point::Point,
    scalars::visit_fields,
    stage::{RestoreError, Stage, attitude_validation_error},
    state::{Attitude, wrapped_rad},
};

settings! {
    /// Settings of the stage `wz-open`.
    pub struct Settings {
        /// Tilt time constant T. Faster motion is taken from the gyro, slower from the
        /// accelerometer.
        time_constant_s: 1.0 in 0.01 .. 1000.0, "s";
        /// Time constant of the blend from gyro heading to magnetic heading.
        heading_time_constant_s: 20.0 in 0.01 .. 10000.0, "s";
    }
}

/// Fuser stage `wz-open`.
#[derive(Debug, Clone, PartialEq)]
pub struct WzOpen {
    settings: Settings,
    /// Last attitude of the gyro slot.
    gyro_attitude: Attitude,
    /// Offset e of the fused point from the gyro's point, in the gyro's chart.
    w_offset: Complex<f64>,
    /// Offset of the fused z from the gyro's z.
    z_offset_rad: f64,
    /// Set if `gyro_attitude` was adopted from another stage instead of received from the gyro
    /// slot.
    adopted: bool,
    started: bool,
    tilt_uncertainty: AngleUncertainty,
    compass: Compass,
    handed_over: HandedOverBias,
}

impl Default for WzOpen {
    fn default() -> Self {
        Self {
            settings: Settings::default(),
            gyro_attitude: Attitude::default(),
            w_offset: Complex::new(0.0, 0.0),
            z_offset_rad: 0.0,
            adopted: false,
            started: false,
            tilt_uncertainty: AngleUncertainty::UNKNOWN,
            compass: Compass::default(),
            handed_over: HandedOverBias::default(),
        }
    }
}

impl WzOpen {
    pub(super) fn realign(&mut self) {
        self.started = false;
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

    /// Adopts the gyro's attitude and converts the offset if its chart has changed. The fused point
    /// stays unchanged.
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
        let dt_s = input.motion.map_or(0.0, |motion| motion.dt_s);
        if let Some(motion) = &input.motion {
            self.follow_gyro(motion);
        }
        self.tilt_uncertainty.drift(ASSUMED_BIAS_SD_RAD_S, dt_s);
        self.compass.drift(dt_s);
        self.handed_over.observe(input);
        let mut innovation = 0.0;
        if let Some(inclination) = &input.inclination {
            let Point { w, chart } = self.gyro_attitude.up;
            let offset = inclination.up.w_in_chart(chart, MAX_POINT_MODULUS) - w;
            if self.started {
                let gain = low_pass_gain(dt_s, self.settings.time_constant_s);
                self.w_offset += (offset - self.w_offset) * gain;
                innovation = innovation_rad(inclination, self.fused_attitude());
                self.tilt_uncertainty.record_correction(innovation, gain, dt_s);
                corrections.tilt = true;
            } else {
                self.w_offset = offset;
                (self.started, self.tilt_uncertainty) = (true, AngleUncertainty::INITIAL);
                corrections.aligned = true;
            }
        }
        if let (true, Some(field_ut)) = (self.started, input.field_ut) {
            let time_constant_s = self.settings.heading_time_constant_s;
            let z_rad = self.compass.correction_rad(self.fused_attitude(), field_ut, time_constant_s, &mut corrections);
            self.z_offset_rad = wrapped_rad(self.z_offset_rad + z_rad);
        }
        Fused {
            attitude: self.fused_attitude(),
            rate_rad_s: input.motion.map_or(Vector3::zeros(), |motion| motion.rate_rad_s),
            bias_rad_s: Vector3::zeros(),
            innovation_rad: innovation,
            inclination_sd_rad: self.tilt_uncertainty.sd_rad(),
            heading_sd_rad: self.compass.sd_rad(),
            reference: self.compass.reference(),
            corrections,
        }
    }
}

impl Stage for WzOpen {
    fuser_step!();

    fn name(&self) -> &'static str {
        "wz-open"
    }

    parameters_of!(Settings);

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        visit_fields!(self, visit:
            gyro_attitude, w_offset, z_offset_rad, adopted, started, tilt_uncertainty, compass, handed_over; without
            settings
        );
    }

    fn validation_error(&self) -> Option<&'static str> {
        // The offset is the difference between two points, each within the maximum modulus.
        let out_of_range =
            self.w_offset.norm_sqr() > 4.0 * MAX_POINT_MODULUS * MAX_POINT_MODULUS || self.z_offset_rad.abs() > 4.0;
        attitude_validation_error(self.gyro_attitude)
            .or(out_of_range.then_some("an offset out of range between the fused attitude and the gyro's"))
            .or_else(|| self.tilt_uncertainty.validation_error())
            .or_else(|| self.compass.validation_error())
            .or_else(|| self.handed_over.validation_error())
    }

    fn common(&self) -> Estimate {
        Estimate {
            attitude: self.fused_attitude(),
            reference: self.compass.reference(),
            inclination_sd_rad: self.tilt_uncertainty.sd_rad(),
            heading_sd_rad: self.compass.sd_rad(),
            ..self.handed_over.sensor_errors()
        }
    }

    /// Adopts the attitude of another stage. It differs from that of the gyro slot, so the offset
    /// is computed at the next motion.
    fn adopt(&mut self, common: &Estimate) -> Result<(), RestoreError> {
        common.validate()?;
        self.gyro_attitude = common.attitude;
        (self.w_offset, self.z_offset_rad) = (Complex::new(0.0, 0.0), 0.0);
        (self.adopted, self.started) = (true, true);
        self.tilt_uncertainty = AngleUncertainty::from_sd(common.inclination_sd_rad);
        self.compass = Compass::new(common.reference, common.heading_sd_rad);
        self.handed_over = HandedOverBias::from_estimate(common);
        Ok(())
    }
}
