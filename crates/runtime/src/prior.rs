//! What is known of the sensors before the first sample: of all that a run finds out, what outlives its end.
//!
//! Input: a checkpoint of the slot `fuser`, whatever fills it. Output: bias and scale of the gyro, and hard iron, for whatever fills it
//! next. Time: an age makes them less sure. Failure: what cannot be is left out.

use attitude::{
    Vector3,
    fuser::{BIAS_WALK_RAD_S, Estimate, GyroScale, HardIron},
};
use launch::Service;
use messages::Checkpoint;
use serde::{Deserialize, Serialize};

use crate::checkpoint;

/// What is known of the sensors.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Prior {
    /// Gyro bias, rad/s, body axes.
    pub bias_rad_s: Option<Known>,
    /// Hard iron of the magnetometer, µT, body axes.
    pub hard_iron_ut: Option<Known>,
    /// Error of the gyro's scale, body axes: by which part of itself the rate is read too large.
    pub gyro_scale: Option<Known>,
}

/// A constant of a sensor, in the unit of its name.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Known {
    /// Each component.
    pub mean: [f64; 3],
    /// The standard deviation of each.
    pub sd: f64,
}

/// How a constant of a sensor loses its worth.
struct Ageing {
    /// Random walk, per √s.
    walk: f64,
    /// What it may differ by when the sensor was without power.
    power_sd: f64,
    /// The deviation from which on it tells nothing.
    unknown_sd: f64,
}

/// A start without a prior takes a bias to be within 0.003 rad/s: a consumer MEMS gyro after its own calibration. 0.001 rad/s (0.06 °/s)
/// for power is an allowance, for data sheets of consumer gyros do not tell.
const BIAS: Ageing = Ageing { walk: BIAS_WALK_RAD_S, power_sd: 1e-3, unknown_sd: 0.003 };
/// 1 µT in three days, for what is loaded and carried; 5 µT are 14° of heading where the horizontal field is 20 µT.
const HARD_IRON: Ageing = Ageing { walk: 0.002, power_sd: 0.0, unknown_sd: 5.0 };

/// A fuser that has seen no turn says 0.002, which is not worth keeping. After 72 days the sensor may be another one.
const SCALE: Ageing = Ageing { walk: 1.2e-6, power_sd: 0.0, unknown_sd: 0.003 };
/// How well the scale of another run is known at best. A fuser that is surer follows too slowly what a few degrees of temperature change.
const SCALE_SD: f64 = 0.002;

/// The names of the numbers of each: its components, and their standard deviation.
const NAMES: [[&str; 4]; 3] = [
    ["bias_x_rad_s", "bias_y_rad_s", "bias_z_rad_s", "bias_sd_rad_s"],
    ["hard_iron_x_ut", "hard_iron_y_ut", "hard_iron_z_ut", "hard_iron_sd_ut"],
    ["gyro_scale_x", "gyro_scale_y", "gyro_scale_z", "gyro_scale_sd"],
];

impl Prior {
    /// What the fuser of a checkpoint has found, if any of it is worth keeping: known twice as well as it must be to tell something.
    pub fn of(record: &Checkpoint) -> Option<Self> {
        if record.service != Service::Fuser as u32 {
            return None;
        }
        let Estimate { bias_rad_s, bias_sd_rad_s, hard_iron, gyro_scale, .. } =
            checkpoint::common(record, Estimate::UNKNOWN).ok()?;
        let worth = |mean: [f64; 3], sd: f64, ageing: Ageing| {
            (sd > 0.0 && sd < 0.5 * ageing.unknown_sd).then_some(Known { mean, sd })
        };
        let scale = gyro_scale.error.zip_map(&gyro_scale.sd, |error, sd| if sd.is_finite() { error } else { 0.0 });
        let prior = Self {
            bias_rad_s: worth(bias_rad_s.into(), bias_sd_rad_s, BIAS),
            hard_iron_ut: worth(hard_iron.field_ut.into(), hard_iron.sd_ut, HARD_IRON),
            // An axis about which nothing has turned has what it began with.
            gyro_scale: worth(scale.into(), gyro_scale.sd.min(), SCALE),
        };
        (prior.tells() && prior.is_sound()).then_some(prior)
    }

    /// The same with the scale that was known before where there is none.
    #[must_use]
    pub fn or_scale_of(self, before: Option<Self>) -> Self {
        Self { gyro_scale: self.gyro_scale.or(before.and_then(|before| before.gyro_scale)), ..self }
    }

    /// What of it still tells something after `age_s`, in which the sensors may have been without power.
    pub fn aged(self, age_s: f64, power_lost: bool) -> Self {
        let aged = |known: Option<Known>, ageing: Ageing| {
            let power_sd = if power_lost { ageing.power_sd } else { 0.0 };
            let grown =
                |Known { mean, sd }| Known { mean, sd: sd.hypot(ageing.walk * age_s.max(0.0).sqrt()).hypot(power_sd) };
            known.map(grown).filter(|known| known.sd < ageing.unknown_sd)
        };
        Self {
            bias_rad_s: aged(self.bias_rad_s, BIAS),
            hard_iron_ut: aged(self.hard_iron_ut, HARD_IRON),
            gyro_scale: aged(self.gyro_scale, SCALE),
        }
    }

    /// There is something in it.
    pub fn tells(&self) -> bool {
        self.parts().iter().any(Option::is_some)
    }

    /// It can be what it says.
    pub fn is_sound(&self) -> bool {
        self.parts().into_iter().flatten().all(|known| known.sd > 0.0) && self.estimate().checked().is_ok()
    }

    /// The numbers of it with their names.
    pub fn numbers(&self) -> Vec<(&'static str, f64)> {
        let known = self.parts().into_iter().zip(NAMES).filter_map(|(known, names)| Some((known?, names)));
        known.flat_map(|(Known { mean: [x, y, z], sd }, names)| names.into_iter().zip([x, y, z, sd])).collect()
    }

    /// The same of numbers with their names; `None` where they are others, or cannot be.
    pub fn of_numbers(numbers: &[(&str, f64)]) -> Option<Self> {
        let known = |names: [&str; 4]| {
            let number = |name| numbers.iter().find(|(other, _)| *other == name).map(|(_, number)| *number);
            let [x, y, z, sd] = names.map(number);
            Some(Known { mean: [x?, y?, z?], sd: sd? })
        };
        let [bias_rad_s, hard_iron_ut, gyro_scale] = NAMES.map(known);
        let prior = Self { bias_rad_s, hard_iron_ut, gyro_scale };
        (prior.numbers().len() == numbers.len() && prior.is_sound()).then_some(prior)
    }

    /// Some of it is known twice as well.
    pub fn is_much_surer_than(&self, other: &Self) -> bool {
        let surer = |(own, other): (Option<Known>, Option<Known>)| {
            own.is_some_and(|own| other.is_none_or(|other| own.sd < 0.5 * other.sd))
        };
        self.parts().into_iter().zip(other.parts()).any(surer)
    }

    /// The same as what a fuser can begin with.
    pub fn estimate(&self) -> Estimate {
        let mut estimate = Estimate::UNKNOWN;
        if let Some(Known { mean, sd }) = self.bias_rad_s {
            (estimate.bias_rad_s, estimate.bias_sd_rad_s) = (mean.into(), sd);
        }
        if let Some(Known { mean, sd }) = self.hard_iron_ut {
            estimate.hard_iron = HardIron { field_ut: mean.into(), sd_ut: sd };
        }
        if let Some(Known { mean, sd }) = self.gyro_scale {
            estimate.gyro_scale = GyroScale { error: mean.into(), sd: Vector3::repeat(sd.hypot(SCALE_SD)) };
        }
        estimate
    }

    fn parts(&self) -> [Option<Known>; 3] {
        [self.bias_rad_s, self.hard_iron_ut, self.gyro_scale]
    }
}
