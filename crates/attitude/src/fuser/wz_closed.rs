//! First-order closed loop: steps the fused point exactly, then moves it towards the
//! accelerometer's point.
//!
//! w_c' = f(w_c, ω) + (w_acc − w_c)/T — Matveev 2025, fig. 9, closed. z is corrected by the
//! magnetic field in the same way, or follows the gyro if there is no field.

use super::{
    angle_uncertainty::{ASSUMED_BIAS_SD_RAD_S, AngleUncertainty},
    bias_handover::HandedOverBias,
    compass::Compass,
    estimate::Estimate,
    finite::fuser_step,
    fused::{Corrections, Fused, innovation_rad},
    input::FuserInput,
    low_pass::low_pass_gain,
};
use crate::{
    Vector3,
    parameters::{parameters_of, settings},
    point::Point,
    scalars::visit_fields,
    stage::{RestoreError, Stage, attitude_validation_error},
    state::{Attitude, wrapped_rad},
};

/// Largest modulus of the accelerometer's point in a chart; it corresponds to a tilt of 168.6°. The
/// limit keeps sums of points finite.
pub(super) const MAX_POINT_MODULUS: f64 = 10.0;

settings! {
    /// Settings of the stage `wz-closed`.
    pub struct Settings {
        /// Tilt time constant T. Faster motion is taken from the gyro, slower from the
        /// accelerometer.
        time_constant_s: 1.0 in 0.01 .. 1000.0, "s";
        /// Time constant of the blend from gyro heading to magnetic heading.
        heading_time_constant_s: 20.0 in 0.01 .. 10000.0, "s";
    }
}

/// Fuser stage `wz-closed`.
#[derive(Debug, Clone, PartialEq)]
pub struct WzClosed {
    settings: Settings,
    attitude: Attitude,
    started: bool,
    tilt_uncertainty: AngleUncertainty,
    compass: Compass,
    handed_over: HandedOverBias,
}

impl Default for WzClosed {
    fn default() -> Self {
        Self {
            settings: Settings::default(),
            attitude: Attitude::default(),
            started: false,
            tilt_uncertainty: AngleUncertainty::UNKNOWN,
            compass: Compass::default(),
            handed_over: HandedOverBias::default(),
        }
    }
}

impl WzClosed {
    pub(super) fn realign(&mut self) {
        self.started = false;
    }

    fn fuse(&mut self, input: &FuserInput) -> Fused {
        let mut corrections = Corrections::default();
        let dt_s = input.motion.map_or(0.0, |motion| motion.dt_s);
        if let Some(motion) = &input.motion {
            self.attitude = self.attitude.rotated(motion.rotation).attitude;
        }
        self.tilt_uncertainty.drift(ASSUMED_BIAS_SD_RAD_S, dt_s);
        self.compass.drift(dt_s);
        self.handed_over.observe(input);
        let mut innovation = 0.0;
        if let Some(inclination) = &input.inclination {
            if self.started {
                innovation = innovation_rad(inclination, self.attitude);
                let gain = low_pass_gain(dt_s, self.settings.time_constant_s);
                let Point { w, chart } = self.attitude.up;
                self.attitude.up.w += (inclination.up.w_in_chart(chart, MAX_POINT_MODULUS) - w) * gain;
                self.attitude = self.attitude.normalised();
                self.tilt_uncertainty.record_correction(innovation, gain, dt_s);
                corrections.tilt = true;
            } else {
                self.attitude = self.attitude.realigned(inclination.up).attitude;
                (self.started, self.tilt_uncertainty) = (true, AngleUncertainty::INITIAL);
                corrections.aligned = true;
            }
        }
        if let (true, Some(field_ut)) = (self.started, input.field_ut) {
            let time_constant_s = self.settings.heading_time_constant_s;
            let z_rad = self.compass.correction_rad(self.attitude, field_ut, time_constant_s, &mut corrections);
            self.attitude.z_rad = wrapped_rad(self.attitude.z_rad + z_rad);
        }
        Fused {
            attitude: self.attitude,
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

impl Stage for WzClosed {
    fuser_step!();

    fn name(&self) -> &'static str {
        "wz-closed"
    }

    parameters_of!(Settings);

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        visit_fields!(self, visit: attitude, started, tilt_uncertainty, compass, handed_over; without settings);
    }

    fn validation_error(&self) -> Option<&'static str> {
        attitude_validation_error(self.attitude)
            .or_else(|| self.tilt_uncertainty.validation_error())
            .or_else(|| self.compass.validation_error())
            .or_else(|| self.handed_over.validation_error())
    }

    fn common(&self) -> Estimate {
        Estimate {
            attitude: self.attitude,
            reference: self.compass.reference(),
            inclination_sd_rad: self.tilt_uncertainty.sd_rad(),
            heading_sd_rad: self.compass.sd_rad(),
            ..self.handed_over.sensor_errors()
        }
    }

    fn adopt(&mut self, common: &Estimate) -> Result<(), RestoreError> {
        common.validate()?;
        self.attitude = common.attitude;
        self.started = true;
        self.tilt_uncertainty = AngleUncertainty::from_sd(common.inclination_sd_rad);
        self.compass = Compass::new(common.reference, common.heading_sd_rad);
        self.handed_over = HandedOverBias::from_estimate(common);
        Ok(())
    }
}
