//! Settings, uncertainties, magnetic heading and hand-over that `wz-closed` and `wz-open` share.

use super::{
    angle_uncertainty::{ASSUMED_BIAS_SD_RAD_S, AngleUncertainty},
    bias_handover::HandedOverBias,
    compass::Compass,
    estimate::Estimate,
    fused::{Corrections, Fused},
    input::FuserInput,
    low_pass::low_pass_gain,
};
use crate::{Vector3, parameters::settings, scalars::scalars, state::Attitude};

/// Largest modulus of the accelerometer's point in a chart; it corresponds to a tilt of 168.6°. The
/// limit keeps sums of points finite.
pub(super) const MAX_POINT_MODULUS: f64 = 10.0;

settings! {
    /// Settings of the stages `wz-closed` and `wz-open`.
    pub(super) struct Settings {
        /// Tilt time constant T. Faster motion is taken from the gyro, slower from the
        /// accelerometer.
        time_constant_s: 1.0 in 0.01 .. 1000.0, "s";
        /// Time constant of the blend from gyro heading to magnetic heading.
        heading_time_constant_s: 20.0 in 0.01 .. 10000.0, "s";
    }
}

/// State of `wz-closed` or `wz-open`, apart from its attitude.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FirstOrder {
    pub(super) settings: Settings,
    /// Set once the level has been aligned.
    pub(super) started: bool,
    tilt_uncertainty: AngleUncertainty,
    compass: Compass,
    handed_over: HandedOverBias,
}

impl Default for FirstOrder {
    fn default() -> Self {
        Self {
            settings: Settings::default(),
            started: false,
            tilt_uncertainty: AngleUncertainty::UNKNOWN,
            compass: Compass::default(),
            handed_over: HandedOverBias::default(),
        }
    }
}

impl FirstOrder {
    /// Adds the gyro drift of the tick to the uncertainties and returns its duration, s.
    pub(super) fn advance(&mut self, input: &FuserInput) -> f64 {
        let dt_s = input.motion.map_or(0.0, |motion| motion.dt_s);
        self.tilt_uncertainty.drift(ASSUMED_BIAS_SD_RAD_S, dt_s);
        self.compass.drift(dt_s);
        self.handed_over.observe(input);
        dt_s
    }

    /// Returns the fraction of the tilt error that a tick of length `dt_s` corrects.
    pub(super) fn tilt_gain(&self, dt_s: f64) -> f64 {
        low_pass_gain(dt_s, self.settings.time_constant_s)
    }

    /// Records the alignment of the level.
    pub(super) fn record_alignment(&mut self, corrections: &mut Corrections) {
        (self.started, self.tilt_uncertainty) = (true, AngleUncertainty::INITIAL);
        corrections.aligned = true;
    }

    /// Records a correction of the tilt by `gain` times the innovation.
    pub(super) fn record_correction(
        &mut self,
        innovation_rad: f64,
        gain: f64,
        dt_s: f64,
        corrections: &mut Corrections,
    ) {
        self.tilt_uncertainty.record_correction(innovation_rad, gain, dt_s);
        corrections.tilt = true;
    }

    /// Returns the correction to z from the magnetic field of the tick, rad.
    ///
    /// Returns `None` if the tick has no magnetic field or the level is not aligned yet.
    pub(super) fn heading_correction_rad(
        &mut self,
        attitude: Attitude,
        input: &FuserInput,
        corrections: &mut Corrections,
    ) -> Option<f64> {
        let field_ut = input.field_ut.filter(|_| self.started)?;
        let time_constant_s = self.settings.heading_time_constant_s;
        Some(self.compass.correction_rad(attitude, field_ut, time_constant_s, corrections))
    }

    /// Returns the output of the stage for the given attitude.
    pub(super) fn fused(
        &self,
        attitude: Attitude,
        input: &FuserInput,
        innovation_rad: f64,
        corrections: Corrections,
    ) -> Fused {
        Fused {
            attitude,
            rate_rad_s: input.motion.map_or(Vector3::zeros(), |motion| motion.rate_rad_s),
            bias_rad_s: Vector3::zeros(),
            innovation_rad,
            inclination_sd_rad: self.tilt_uncertainty.sd_rad(),
            heading_sd_rad: self.compass.sd_rad(),
            reference: self.compass.reference(),
            corrections,
        }
    }

    /// Returns the reason why the state is invalid, or `None` if it is valid.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        self.tilt_uncertainty
            .validation_error()
            .or_else(|| self.compass.validation_error())
            .or_else(|| self.handed_over.validation_error())
    }

    /// Returns the estimate that the stage hands over together with the given attitude.
    pub(super) fn estimate(&self, attitude: Attitude) -> Estimate {
        Estimate {
            attitude,
            reference: self.compass.reference(),
            inclination_sd_rad: self.tilt_uncertainty.sd_rad(),
            heading_sd_rad: self.compass.sd_rad(),
            ..self.handed_over.sensor_errors()
        }
    }

    /// Returns the state that continues from a handed-over estimate.
    pub(super) fn continued_from(&self, common: &Estimate) -> Self {
        Self {
            settings: self.settings,
            started: true,
            tilt_uncertainty: AngleUncertainty::from_sd(common.inclination_sd_rad),
            compass: Compass::new(common.reference, common.heading_sd_rad),
            handed_over: HandedOverBias::from_estimate(common),
        }
    }
}

scalars!(FirstOrder: started, tilt_uncertainty, compass, handed_over; without settings);
