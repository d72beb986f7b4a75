//! What is known of the sensors before the first sample: of all that a run finds out, what outlives its end.
//!
//! Input: a checkpoint of the slot `fuser`, whatever fills it. Output: the bias of the gyro for whatever fills it next. Time: an age makes
//! it less sure. Failure: what cannot be a bias is none.

use attitude::{
    Vector3,
    fuser::{BIAS_WALK_RAD_S, Estimate},
};
use launch::Service;
use messages::Checkpoint;
use serde::{Deserialize, Serialize};

use crate::checkpoint;

/// What a start without a prior takes each component of the bias to be within, rad/s: a consumer MEMS gyro after its own calibration. A
/// prior that is no surer tells nothing.
const UNKNOWN_SD_RAD_S: f64 = 0.003;
/// What the bias of a gyro that was without power in between may differ by, rad/s: 0.06 °/s, an allowance, for data sheets of consumer
/// gyros do not tell.
const POWER_SD_RAD_S: f64 = 1e-3;

/// What is known of the sensors.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Prior {
    /// Gyro bias, rad/s, body axes.
    pub bias_rad_s: [f64; 3],
    /// Standard deviation of each component of the bias, rad/s.
    pub bias_sd_rad_s: f64,
}

impl Prior {
    /// What the fuser of a checkpoint has found, if it is worth to be kept: known twice as well as at a start without it.
    pub fn of(record: &Checkpoint) -> Option<Self> {
        if record.service != Service::Fuser as u32 {
            return None;
        }
        let unknown = Estimate::of_sensors(Vector3::zeros(), f64::INFINITY);
        let Estimate { bias_rad_s, bias_sd_rad_s, .. } = checkpoint::common(record, unknown).ok()?;
        let prior = Self { bias_rad_s: bias_rad_s.into(), bias_sd_rad_s };
        (prior.is_sound() && bias_sd_rad_s < 0.5 * UNKNOWN_SD_RAD_S).then_some(prior)
    }

    /// The same after `age_s`, in which the gyro may have been without power.
    pub fn aged(self, age_s: f64, power_lost: bool) -> Self {
        let drift_rad_s = BIAS_WALK_RAD_S * age_s.max(0.0).sqrt();
        let power_rad_s = if power_lost { POWER_SD_RAD_S } else { 0.0 };
        Self { bias_sd_rad_s: self.bias_sd_rad_s.hypot(drift_rad_s).hypot(power_rad_s), ..self }
    }

    /// It is surer than a start without it.
    pub fn tells(&self) -> bool {
        self.bias_sd_rad_s < UNKNOWN_SD_RAD_S
    }

    /// It can be what it says.
    pub fn is_sound(&self) -> bool {
        self.bias_sd_rad_s > 0.0 && Estimate::of_sensors(self.bias_rad_s.into(), self.bias_sd_rad_s).checked().is_ok()
    }
}
