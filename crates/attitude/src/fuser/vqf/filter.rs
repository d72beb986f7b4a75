//! The state of the fuser stage `vqf`: the filter of vqf-rs, its sampling times, its standard deviations.

use core::fmt;

use super::{
    period::{FIRST_INTERVAL_S, Period},
    quaternions::to_ours,
};
use crate::{
    Vector3,
    course::Reference,
    fuser::{gyro_scale::GyroScale, hard_iron::HardIron, spread::Spread},
    gyro::Motion,
    state::Attitude,
};
use vqf_rs::{Params, VQF};

/// Interval of the field from which on it is not smoothed, s: the low-pass of 0.05 s would be beyond its Nyquist frequency.
const SMOOTHED_FIELD_S: f64 = 0.1;
/// Largest component of a reading, in its SI unit or µT: far beyond any sensor, and its squares stay finite.
const READING_MAX: f64 = 1e6;

/// The fuser stage `vqf`.
pub struct Vqf {
    pub(super) filter: VQF,
    pub(super) motion: Period,
    pub(super) field: Period,
    pub(super) levelled: bool,
    pub(super) magnetic: bool,
    pub(super) tilt: Spread,
    pub(super) heading: Spread,
    /// Standard deviation of what the low-pass still has of the error of a velocity that was taken over, m/s.
    pub(super) velocity_sd_m_s: f64,
    /// Of the giver.
    pub(super) gyro_scale: GyroScale,
    pub(super) hard_iron: HardIron,
}

impl Default for Vqf {
    fn default() -> Self {
        Self {
            filter: VQF::new(FIRST_INTERVAL_S, None, None, None),
            motion: Period::default(),
            field: Period::default(),
            levelled: false,
            magnetic: false,
            tilt: Spread::UNKNOWN,
            heading: Spread::UNKNOWN,
            velocity_sd_m_s: 0.0,
            gyro_scale: GyroScale::UNKNOWN,
            hard_iron: HardIron::UNKNOWN,
        }
    }
}

impl Vqf {
    /// The filter for the sampling times as they are known, in the state it is in.
    pub(super) fn retime(&mut self) {
        let state = *self.filter.state();
        let field_s = self.field.mean_s;
        let smoothing_s = if field_s < SMOOTHED_FIELD_S { Params::default().mag_current_tau } else { 0.0 };
        let params = Params { mag_current_tau: smoothing_s, ..Params::default() };
        self.filter = VQF::new(self.motion.mean_s, None, Some(field_s), Some(params));
        *self.filter.state_mut() = state;
    }

    pub(super) fn attitude(&self) -> Attitude {
        let q = if self.magnetic { self.filter.quat_9d() } else { self.filter.quat_6d() };
        Attitude::of_quaternion(to_ours(q))
    }

    pub(super) fn turn(&mut self, motion: &Motion) {
        self.motion.since_s += motion.dt_s;
        self.field.since_s += motion.dt_s;
        if self.motion.sampled() {
            // What the low-pass holds means something else at another sampling time.
            let averaged = self.averaged();
            self.retime();
            if let Some(averaged) = averaged {
                self.average(averaged);
            }
        }
        self.filter.update_gyr_with_ts(bounded(motion.rate_rad_s), motion.dt_s);
        self.velocity_sd_m_s *= 1.0 - (motion.dt_s / self.filter.params().tau_acc).min(1.0);
        let bias_sd_rad_s = self.filter.bias_estimate().1;
        self.tilt.drift(bias_sd_rad_s, motion.dt_s);
        self.heading.drift(bias_sd_rad_s, motion.dt_s);
    }

    /// The correction by a field; true when the heading was set anew.
    pub(super) fn point(&mut self, field_ut: Vector3<f64>) -> bool {
        let interval_s = self.field.since_s;
        if self.field.sampled() {
            self.retime();
        }
        self.filter.update_mag(bounded(field_ut));
        let first = !self.magnetic;
        self.magnetic = true;
        let state = self.filter.state();
        if first {
            self.heading = Spread::FIRST;
        } else if state.last_mag_corr_angular_rate != 0.0 {
            let taken_off_rad = state.last_mag_corr_angular_rate * self.filter.coeffs().mag_ts;
            self.heading.corrected(state.last_mag_dis_angle, taken_off_rad / state.last_mag_dis_angle, interval_s);
        }
        first
    }

    pub(super) fn reference(&self) -> Reference {
        if self.magnetic { Reference::Magnetic } else { Reference::Arbitrary }
    }

    pub(super) fn timing_flaw(&self) -> Option<&'static str> {
        self.motion.flaw().or_else(|| self.field.flaw())
    }

    pub(super) fn bias_rad_s(&self) -> Vector3<f64> {
        Vector3::from(self.filter.state().bias)
    }
}

impl Clone for Vqf {
    fn clone(&self) -> Self {
        let mut clone = Self { filter: VQF::new(FIRST_INTERVAL_S, None, None, None), ..*self };
        *clone.filter.state_mut() = *self.filter.state();
        clone.retime();
        clone
    }
}

impl fmt::Debug for Vqf {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut debug = f.debug_struct("Vqf");
        debug.field("attitude", &self.attitude()).field("bias_rad_s", &self.bias_rad_s());
        debug.field("motion", &self.motion).field("field", &self.field).finish_non_exhaustive()
    }
}

pub(super) fn bounded(reading: Vector3<f64>) -> [f64; 3] {
    reading.map(|x| x.clamp(-READING_MAX, READING_MAX)).into()
}
