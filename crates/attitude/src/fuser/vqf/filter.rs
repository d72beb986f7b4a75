//! State of the fuser stage `vqf`: the filter of vqf-rs, its sampling times and its standard
//! deviations.

use core::fmt;

use super::{
    period::{DEFAULT_INTERVAL_S, SamplingPeriod},
    quaternions::from_vqf,
};
use crate::{
    Vector3,
    course::CourseReference,
    fuser::{angle_uncertainty::AngleUncertainty, gyro_scale::GyroScale, hard_iron::HardIron},
    gyro::Motion,
    state::Attitude,
};
use vqf_rs::{Params, VQF};

/// Interval between magnetic field samples above which the field is not smoothed, s.
///
/// At a longer interval, the cut-off of the 0.05 s low-pass filter would exceed the Nyquist
/// frequency.
const MAX_SMOOTHED_INTERVAL_S: f64 = 0.1;
/// Largest component of a sample, in its SI unit or µT. It is far beyond any sensor's range, yet
/// its square is finite.
const MAX_READING: f64 = 1e6;

/// Fuser stage `vqf`: the filter of vqf-rs.
pub struct Vqf {
    pub(super) filter: VQF,
    pub(super) motion_period: SamplingPeriod,
    pub(super) field_period: SamplingPeriod,
    pub(super) levelled: bool,
    pub(super) magnetic: bool,
    pub(super) tilt: AngleUncertainty,
    pub(super) heading: AngleUncertainty,
    /// Standard deviation of the error that a handed-over velocity has left in the low-pass filter,
    /// m/s.
    pub(super) velocity_sd_m_s: f64,
    /// Handed-over gyro scale, which is passed on unchanged.
    pub(super) gyro_scale: GyroScale,
    /// Hard iron received from the previous fuser and passed on unchanged.
    pub(super) hard_iron: HardIron,
}

impl Default for Vqf {
    fn default() -> Self {
        Self {
            filter: VQF::new(DEFAULT_INTERVAL_S, None, None, None),
            motion_period: SamplingPeriod::default(),
            field_period: SamplingPeriod::default(),
            levelled: false,
            magnetic: false,
            tilt: AngleUncertainty::UNKNOWN,
            heading: AngleUncertainty::UNKNOWN,
            velocity_sd_m_s: 0.0,
            gyro_scale: GyroScale::UNKNOWN,
            hard_iron: HardIron::UNKNOWN,
        }
    }
}

impl Vqf {
    /// Rebuilds the filter for the current sampling times. Its state is kept.
    pub(super) fn rebuild(&mut self) {
        let state = *self.filter.state();
        let field_s = self.field_period.mean_s;
        let smoothing_s = if field_s < MAX_SMOOTHED_INTERVAL_S { Params::default().mag_current_tau } else { 0.0 };
        let params = Params { mag_current_tau: smoothing_s, ..Params::default() };
        self.filter = VQF::new(self.motion_period.mean_s, None, Some(field_s), Some(params));
        *self.filter.state_mut() = state;
    }

    pub(super) fn attitude(&self) -> Attitude {
        let q = if self.magnetic { self.filter.quat_9d() } else { self.filter.quat_6d() };
        Attitude::from_quaternion(from_vqf(q))
    }

    pub(super) fn process_motion(&mut self, motion: &Motion) {
        self.motion_period.since_s += motion.dt_s;
        self.field_period.since_s += motion.dt_s;
        if self.motion_period.record_sample() {
            // The internal state of the low-pass filter depends on the sampling time, so it is
            // converted.
            let low_pass = self.force_low_pass();
            self.rebuild();
            if let Some(low_pass) = low_pass {
                self.set_force_low_pass(low_pass);
            }
        }
        self.filter.update_gyr_with_ts(clamped(motion.rate_rad_s), motion.dt_s);
        self.velocity_sd_m_s *= 1.0 - (motion.dt_s / self.filter.params().tau_acc).min(1.0);
        let bias_sd_rad_s = self.filter.bias_estimate().1;
        self.tilt.drift(bias_sd_rad_s, motion.dt_s);
        self.heading.drift(bias_sd_rad_s, motion.dt_s);
    }

    /// Corrects the heading with a magnetic field sample. Returns `true` for the first sample,
    /// which sets the heading.
    pub(super) fn process_field(&mut self, field_ut: Vector3<f64>) -> bool {
        let interval_s = self.field_period.since_s;
        if self.field_period.record_sample() {
            self.rebuild();
        }
        self.filter.update_mag(clamped(field_ut));
        let first = !self.magnetic;
        self.magnetic = true;
        let state = self.filter.state();
        if first {
            self.heading = AngleUncertainty::INITIAL;
        } else if state.last_mag_corr_angular_rate != 0.0 {
            let correction_rad = state.last_mag_corr_angular_rate * self.filter.coeffs().mag_ts;
            self.heading.record_correction(
                state.last_mag_dis_angle,
                correction_rad / state.last_mag_dis_angle,
                interval_s,
            );
        }
        first
    }

    pub(super) fn reference(&self) -> CourseReference {
        if self.magnetic { CourseReference::Magnetic } else { CourseReference::Arbitrary }
    }

    pub(super) fn timing_error(&self) -> Option<&'static str> {
        self.motion_period.validation_error().or_else(|| self.field_period.validation_error())
    }

    pub(super) fn bias_rad_s(&self) -> Vector3<f64> {
        Vector3::from(self.filter.state().bias)
    }
}

impl Clone for Vqf {
    fn clone(&self) -> Self {
        let mut clone = Self { filter: VQF::new(DEFAULT_INTERVAL_S, None, None, None), ..*self };
        *clone.filter.state_mut() = *self.filter.state();
        clone.rebuild();
        clone
    }
}

impl fmt::Debug for Vqf {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut debug = f.debug_struct("Vqf");
        debug.field("attitude", &self.attitude()).field("bias_rad_s", &self.bias_rad_s());
        debug.field("motion", &self.motion_period).field("field", &self.field_period).finish_non_exhaustive()
    }
}

pub(super) fn clamped(reading: Vector3<f64>) -> [f64; 3] {
    reading.map(|x| x.clamp(-MAX_READING, MAX_READING)).into()
}
