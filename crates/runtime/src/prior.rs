//! Estimates of sensor errors from an earlier run, if they are still valid.
//!
//! - Input: a checkpoint of the slot `fuser`, written by any stage.
//! - Output: gyro bias, gyro scale error and hard iron, for any stage of the slot.
//! - Time: the uncertainty grows with age.
//! - Failure: invalid values are left out.

use attitude::{
    Vector3,
    fuser::{BIAS_WALK_RAD_S, Estimate, GyroScale, HardIron},
};
use launch::Service;
use messages::Checkpoint;
use serde::{Deserialize, Serialize};

use crate::checkpoint;

/// Sensor errors estimated by an earlier run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Prior {
    /// Gyro bias, rad/s, body axes.
    pub bias_rad_s: Option<PriorEstimate>,
    /// Hard iron of the magnetometer, µT, body axes.
    pub hard_iron_ut: Option<PriorEstimate>,
    /// Gyro scale error, body axes: relative amount by which the measured rate is too high.
    pub gyro_scale: Option<PriorEstimate>,
}

/// Estimate of a sensor error. [`Prior`] defines its unit and axes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PriorEstimate {
    /// Value per axis.
    pub mean: [f64; 3],
    /// Standard deviation of each axis.
    pub sd: f64,
}

/// Growth of an estimate's uncertainty with time.
struct AgeingModel {
    /// Random walk, per √s.
    random_walk: f64,
    /// Standard deviation of the change caused by a power cycle of the sensor.
    power_cycle_sd: f64,
    /// Standard deviation at or above which the estimate is useless.
    uninformative_sd: f64,
}

/// Ageing of the gyro bias.
///
/// An estimate with a standard deviation of 0.003 rad/s is useless, because the bias of a consumer
/// MEMS gyro is assumed to be within that limit after the gyro's own calibration. The 0.001 rad/s
/// (0.06 °/s) for a power cycle is an assumption, because data sheets of consumer gyros do not
/// specify it.
const BIAS: AgeingModel = AgeingModel { random_walk: BIAS_WALK_RAD_S, power_cycle_sd: 1e-3, uninformative_sd: 0.003 };
/// Ageing of the hard iron.
///
/// The random walk is 1 µT in three days, to allow for changes of load and cargo. An uncertainty of
/// 5 µT makes the estimate useless, because in a horizontal magnetic field of 20 µT it corresponds
/// to a heading error of 14°.
const HARD_IRON: AgeingModel = AgeingModel { random_walk: 0.002, power_cycle_sd: 0.0, uninformative_sd: 5.0 };

/// Ageing of the gyro scale error.
///
/// A fuser that has observed no rotation reports a standard deviation of 0.002. Such an estimate is
/// not worth storing. The random walk makes an estimate expire after at most 72 days, because the
/// sensor may have been replaced by then.
const SCALE: AgeingModel = AgeingModel { random_walk: 1.2e-6, power_cycle_sd: 0.0, uninformative_sd: 0.003 };
/// Minimum standard deviation of a scale error from an earlier run. With a smaller value, the fuser
/// would follow a temperature change of a few degrees too slowly.
const MIN_SCALE_SD: f64 = 0.002;

/// Plausibility limits of gyro bias and hard iron: quantity, largest plausible magnitude, factor
/// that converts the estimate to the unit of the magnitude, and that unit. The gyro scale error is
/// limited by [`Estimate::validate`] instead.
///
/// A larger value comes from a damaged or forged file rather than from a sensor: the zero-rate
/// level of consumer gyros is within a few °/s, and a magnetic field of 1000 µT is 20 times that of
/// the Earth.
const PLAUSIBLE: [(&str, f64, f64, &str); 2] =
    [("gyro bias", 15.0, 180.0 / std::f64::consts::PI, "°/s"), ("hard iron", 1000.0, 1.0, "µT")];

/// Value of a prior that is too large for any plausible sensor.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("its {quantity} of {found:.1} {unit} is implausible; the limit is ±{limit} {unit}")]
pub struct ImplausibleValue {
    quantity: &'static str,
    found: f64,
    limit: f64,
    unit: &'static str,
}

/// Names of the values of each estimate: three components and the standard deviation.
const VALUE_NAMES: [[&str; 4]; 3] = [
    ["bias_x_rad_s", "bias_y_rad_s", "bias_z_rad_s", "bias_sd_rad_s"],
    ["hard_iron_x_ut", "hard_iron_y_ut", "hard_iron_z_ut", "hard_iron_sd_ut"],
    ["gyro_scale_x", "gyro_scale_y", "gyro_scale_z", "gyro_scale_sd"],
];

impl Prior {
    /// Extracts the estimates that are worth storing from a fuser checkpoint.
    ///
    /// These are estimates whose standard deviation is less than half of the value at which the
    /// estimate is useless. Returns `None` if there are no such estimates, or if the checkpoint is
    /// invalid or belongs to another slot.
    pub fn from_checkpoint(record: &Checkpoint) -> Option<Self> {
        if record.service != Service::Fuser as u32 {
            return None;
        }
        let Estimate { bias_rad_s, bias_sd_rad_s, hard_iron, gyro_scale, .. } =
            checkpoint::common(record, Estimate::UNKNOWN).ok()?;
        let informative = |mean: [f64; 3], sd: f64, ageing: AgeingModel| {
            (sd > 0.0 && sd < 0.5 * ageing.uninformative_sd).then_some(PriorEstimate { mean, sd })
        };
        let scale = gyro_scale.error.zip_map(&gyro_scale.sd, |error, sd| if sd.is_finite() { error } else { 0.0 });
        let prior = Self {
            bias_rad_s: informative(bias_rad_s.into(), bias_sd_rad_s, BIAS),
            hard_iron_ut: informative(hard_iron.field_ut.into(), hard_iron.sd_ut, HARD_IRON),
            // An axis about which the body has not rotated still has its initial standard
            // deviation, so the minimum over the axes is used.
            gyro_scale: informative(scale.into(), gyro_scale.sd.min(), SCALE),
        };
        (prior.has_estimate() && prior.is_valid() && prior.implausible_value().is_none()).then_some(prior)
    }

    /// Returns this prior, with the gyro scale error of `before` if it has none itself.
    #[must_use]
    pub fn or_scale_from(self, before: Option<Self>) -> Self {
        Self { gyro_scale: self.gyro_scale.or(before.and_then(|before| before.gyro_scale)), ..self }
    }

    /// Returns the estimates that are still useful after `age_s`.
    ///
    /// Pass `power_lost` as `true` if the sensors may have been without power.
    pub fn aged(self, age_s: f64, power_lost: bool) -> Self {
        let aged = |estimate: Option<PriorEstimate>, ageing: AgeingModel| {
            let power_cycle_sd = if power_lost { ageing.power_cycle_sd } else { 0.0 };
            let grown = |PriorEstimate { mean, sd }| PriorEstimate {
                mean,
                sd: sd.hypot(ageing.random_walk * age_s.max(0.0).sqrt()).hypot(power_cycle_sd),
            };
            estimate.map(grown).filter(|estimate| estimate.sd < ageing.uninformative_sd)
        };
        Self {
            bias_rad_s: aged(self.bias_rad_s, BIAS),
            hard_iron_ut: aged(self.hard_iron_ut, HARD_IRON),
            gyro_scale: aged(self.gyro_scale, SCALE),
        }
    }

    /// Returns `true` if at least one estimate is present.
    pub fn has_estimate(&self) -> bool {
        self.estimates().iter().any(Option::is_some)
    }

    /// Returns `true` if all values are within their ranges.
    pub fn is_valid(&self) -> bool {
        self.estimates().into_iter().flatten().all(|estimate| estimate.sd > 0.0) && self.estimate().validate().is_ok()
    }

    /// Returns the first value that is too large for any plausible sensor.
    pub fn implausible_value(&self) -> Option<ImplausibleValue> {
        self.estimates().into_iter().zip(PLAUSIBLE).find_map(|(estimate, (quantity, limit, factor, unit))| {
            let values = estimate?.mean.map(|value| value * factor);
            let found = values.into_iter().find(|value| value.abs() > limit)?;
            Some(ImplausibleValue { quantity, found, limit, unit })
        })
    }

    /// Returns the values of the estimates that are present, with their names.
    pub fn named_values(&self) -> Vec<(&'static str, f64)> {
        let present =
            self.estimates().into_iter().zip(VALUE_NAMES).filter_map(|(estimate, names)| Some((estimate?, names)));
        present
            .flat_map(|(PriorEstimate { mean: [x, y, z], sd }, names)| names.into_iter().zip([x, y, z, sd]))
            .collect()
    }

    /// Creates a prior from named values. Returns `None` if a name is unknown or missing, or if a
    /// value is invalid.
    pub fn from_named_values(values: &[(&str, f64)]) -> Option<Self> {
        let estimate = |names: [&str; 4]| {
            let value = |name| values.iter().find(|(other, _)| *other == name).map(|(_, value)| *value);
            let [x, y, z, sd] = names.map(value);
            Some(PriorEstimate { mean: [x?, y?, z?], sd: sd? })
        };
        let [bias_rad_s, hard_iron_ut, gyro_scale] = VALUE_NAMES.map(estimate);
        let prior = Self { bias_rad_s, hard_iron_ut, gyro_scale };
        (prior.named_values().len() == values.len() && prior.is_valid()).then_some(prior)
    }

    /// Returns `true` if at least one estimate has less than half the standard deviation that it
    /// has in `other`.
    pub fn is_much_more_certain_than(&self, other: &Self) -> bool {
        let more_certain = |(own, other): (Option<PriorEstimate>, Option<PriorEstimate>)| {
            own.is_some_and(|own| other.is_none_or(|other| own.sd < 0.5 * other.sd))
        };
        self.estimates().into_iter().zip(other.estimates()).any(more_certain)
    }

    /// Returns the prior as an estimate from which a fuser can start.
    pub fn estimate(&self) -> Estimate {
        let mut estimate = Estimate::UNKNOWN;
        if let Some(PriorEstimate { mean, sd }) = self.bias_rad_s {
            (estimate.bias_rad_s, estimate.bias_sd_rad_s) = (mean.into(), sd);
        }
        if let Some(PriorEstimate { mean, sd }) = self.hard_iron_ut {
            estimate.hard_iron = HardIron { field_ut: mean.into(), sd_ut: sd };
        }
        if let Some(PriorEstimate { mean, sd }) = self.gyro_scale {
            estimate.gyro_scale = GyroScale { error: mean.into(), sd: Vector3::repeat(sd.hypot(MIN_SCALE_SD)) };
        }
        estimate
    }

    fn estimates(&self) -> [Option<PriorEstimate>; 3] {
        [self.bias_rad_s, self.hard_iron_ut, self.gyro_scale]
    }
}
