//! Scenarios: a motion with its sampling rate, duration, scored interval and sensor errors.
//!
//! Input: a name, optionally with a query that overrides parameters, such as
//! `cruise?seed=3&gnss=gaps`.
//!
//! Output: the scenario and its readings.
//!
//! Failure: an unknown name, key or value is rejected with a list of the accepted ones.

use core::fmt;

use attitude::{GRAVITY_M_S2, gyro::RateKind};
use mapping::names::UnknownName;

use crate::{Coverage, Motion, Reading, Receiver, SensorErrors, Sensors, s3};

/// Motion with its sampling rate, duration and sensor errors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scenario {
    /// Name, one of [`Scenario::NAMES`].
    pub name: &'static str,
    /// Motion of the body.
    pub motion: Motion,
    /// Sampling rate of the readings, Hz.
    pub rate_hz: f64,
    /// Duration, s.
    pub duration_s: f64,
    /// Time in s from which attitude errors are scored. Before that, the estimators converge.
    pub scored_from_s: f64,
    /// Seed of all random values.
    pub seed: u64,
    /// Errors of the sensors at the sampling rate `rate_hz`.
    pub errors: SensorErrors,
    /// Kind of the rate samples: instantaneous or mean.
    pub rate_kind: RateKind,
}

/// Keys that a query accepts in addition to the [`PARAMETERS`].
const KEYS: [&str; 4] = ["seed", "rate_hz", "duration_s", "gnss"];

/// Numeric parameter of a scenario.
#[derive(Debug, Clone, Copy)]
pub struct Parameter {
    /// Name, ending in the unit if the parameter has one.
    pub name: &'static str,
    /// Minimum value.
    pub min: f64,
    /// Maximum value.
    pub max: f64,
    /// Short description with the unit.
    pub description: &'static str,
    /// Sets the parameter. If the scenario has no element to which the parameter applies, such as a
    /// magnetometer, the error names that element.
    set: fn(&mut Scenario, f64) -> Result<(), &'static str>,
}

/// Numeric parameters of scenarios. Noise values apply at the sampling rate of the scenario.
pub const PARAMETERS: [Parameter; 12] = [
    Parameter {
        name: "gyro_bias_deg_s",
        min: 0.0,
        max: 100.0,
        description: "constant gyro bias on each axis, °/s",
        set: |scenario, value| assign(&mut scenario.errors.gyro_bias_rad_s, value.to_radians()),
    },
    Parameter {
        name: "gyro_noise_deg_s",
        min: 0.0,
        max: 100.0,
        description: "white noise of the gyro on each axis and sample, °/s",
        set: |scenario, value| assign(&mut scenario.errors.gyro_noise_rad_s, value.to_radians()),
    },
    Parameter {
        name: "gyro_scale",
        min: 0.0,
        max: 0.5,
        description: "scale error of the gyro on each axis",
        set: |scenario, value| assign(&mut scenario.errors.gyro_scale, value),
    },
    Parameter {
        name: "accel_bias_g",
        min: 0.0,
        max: 10.0,
        description: "constant bias of the accelerometer on each axis, g",
        set: |scenario, value| assign(&mut scenario.errors.accel_bias_m_s2, value * GRAVITY_M_S2),
    },
    Parameter {
        name: "accel_noise_g",
        min: 0.0,
        max: 10.0,
        description: "white noise of the accelerometer on each axis and sample, g",
        set: |scenario, value| assign(&mut scenario.errors.accel_noise_m_s2, value * GRAVITY_M_S2),
    },
    Parameter {
        name: "field_noise_ut",
        min: 0.0,
        max: 1000.0,
        description: "white noise of the magnetometer on each axis and sample, µT",
        set: |scenario, value| {
            assign(&mut scenario.errors.magnetometer.as_mut().ok_or("magnetometer")?.noise_ut, value)
        },
    },
    Parameter {
        name: "gnss_noise_m_s",
        min: 0.0,
        max: 100.0,
        description: "white noise of the satellite velocity on each axis and fix, m/s",
        set: |scenario, value| assign(&mut receiver(scenario)?.noise_m_s, value),
    },
    Parameter {
        name: "gnss_latency_s",
        min: 0.0,
        max: 2.0,
        description: "latency of the fixes, s",
        set: |scenario, value| assign(&mut receiver(scenario)?.latency_s, value),
    },
    Parameter {
        name: "antenna_right_m",
        min: -100.0,
        max: 100.0,
        description: "position of the receiver's antenna from the sensors, to the right, m",
        set: |scenario, value| assign(&mut receiver(scenario)?.antenna_m.x, value),
    },
    Parameter {
        name: "antenna_forward_m",
        min: -100.0,
        max: 100.0,
        description: "position of the receiver's antenna from the sensors, forward, m",
        set: |scenario, value| assign(&mut receiver(scenario)?.antenna_m.y, value),
    },
    Parameter {
        name: "antenna_up_m",
        min: -100.0,
        max: 100.0,
        description: "position of the receiver's antenna from the sensors, upward, m",
        set: |scenario, value| assign(&mut receiver(scenario)?.antenna_m.z, value),
    },
    Parameter {
        name: "amplitude_deg",
        min: 0.0,
        max: 89.0,
        description: "amplitude, °: of s1 the roll, with the pitch in proportion; of coning the half angle of the cone",
        set: |scenario, value| match &mut scenario.motion {
            Motion::Swing(swing) => assign(swing, swing.with_roll_amplitude(value.to_radians())),
            Motion::Coning(coning) => assign(&mut coning.half_angle_rad, value.to_radians()),
            Motion::Tumble(_) | Motion::S3 | Motion::Cruise(_) => Err("amplitude"),
        },
    },
];

fn assign<T>(target: &mut T, value: T) -> Result<(), &'static str> {
    *target = value;
    Ok(())
}

fn receiver(scenario: &mut Scenario) -> Result<&mut Receiver, &'static str> {
    scenario.errors.receiver.as_mut().ok_or("satellite receiver")
}

impl Scenario {
    /// Names of the scenarios.
    pub const NAMES: [&'static str; 6] = Motion::NAMES;

    /// Parses the name of a scenario with an optional query after `?`.
    ///
    /// The query overrides `seed`, `rate_hz`, `duration_s`, `gnss` or any of the [`PARAMETERS`].
    ///
    /// # Errors
    ///
    /// Returns an error for an unknown name or key, a key given twice, a value out of range, or a
    /// key that does not apply to the scenario.
    pub fn parse(text: &str) -> Result<Self, ScenarioError> {
        let (name, query) = text.split_once('?').unwrap_or((text, ""));
        let mut scenario = Self::default_for(name).ok_or_else(|| ScenarioError::UnknownName { found: name.into() })?;
        let pairs = query.split('&').filter(|pair| !pair.is_empty());
        let pairs: Vec<_> = pairs.map(|pair| pair.split_once('=').unwrap_or((pair, ""))).collect();
        if let Some((key, _)) =
            (1..).zip(&pairs).find_map(|(next, pair)| pairs[next..].iter().find(|it| it.0 == pair.0))
        {
            return Err(ScenarioError::DuplicateKey { found: (*key).into() });
        }
        // A new sampling rate rescales the noise, so the numeric parameters, such as noise, are set
        // afterwards.
        let (others, numbers): (Vec<_>, Vec<_>) = pairs.into_iter().partition(|(key, _)| KEYS.contains(key));
        others.into_iter().try_for_each(|(key, value)| scenario.set_key(key, value))?;
        for (key, value) in numbers {
            let parameter = PARAMETERS.iter().find(|parameter| parameter.name == key);
            let parameter = parameter.ok_or_else(|| ScenarioError::UnknownKey { found: key.into() })?;
            scenario.set(key, parse_number(key, value, parameter.min, parameter.max)?)?;
        }
        Ok(scenario)
    }

    /// Sets one of the [`PARAMETERS`] without checking its range.
    ///
    /// # Errors
    ///
    /// Returns an error if there is no such parameter or it does not apply to the scenario.
    pub fn set(&mut self, name: &str, value: f64) -> Result<(), ScenarioError> {
        let parameter = PARAMETERS.iter().find(|parameter| parameter.name == name);
        let Parameter { name, set, .. } = parameter.ok_or_else(|| ScenarioError::UnknownKey { found: name.into() })?;
        set(self, value).map_err(|missing| ScenarioError::NotApplicable { scenario: self.name, key: name, missing })
    }

    /// Returns the scenario with the given seed for all random values.
    #[must_use]
    pub fn with_seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        if let Motion::Cruise(flight) = &mut self.motion {
            flight.seed = seed;
        }
        self
    }

    /// Returns the scenario with the given sampling rate.
    ///
    /// The noise of a flight is scaled with the rate, as for a sensor that averages over its
    /// sampling interval.
    #[must_use]
    pub fn with_rate_hz(mut self, rate_hz: f64) -> Self {
        if let Motion::Cruise(_) = self.motion {
            self.errors = self.errors.resampled(self.rate_hz, rate_hz);
        }
        self.rate_hz = rate_hz;
        self
    }

    /// Returns the sensors of the scenario.
    pub fn sensors(&self) -> Sensors {
        let sensors = Sensors::new(self.motion, self.errors, self.seed);
        if self.rate_kind == RateKind::Mean { sensors.with_integrating_gyro() } else { sensors }
    }

    /// Returns the readings from time 0 to the end, each with its time in s.
    pub fn readings(&self) -> impl Iterator<Item = (f64, Reading)> + use<> {
        let (mut sensors, rate_hz) = (self.sensors(), self.rate_hz);
        let count = libm::round(self.duration_s * rate_hz) as u64;
        (0..=count).map(move |k| k as f64 / rate_hz).map(move |t_s| (t_s, sensors.read(t_s)))
    }

    fn default_for(name: &str) -> Option<Self> {
        let motion = Motion::from_name(name)?;
        let name = Self::NAMES.into_iter().find(|known| *known == name)?;
        let (duration_s, scored_from_s, errors, rate_kind) = match motion {
            Motion::Swing(_) => (100.0, 5.0, SensorErrors::S1, RateKind::Instant),
            Motion::Tumble(_) => (100.0, 5.0, SensorErrors::S1, RateKind::Instant),
            Motion::S3 => (s3::DURATION_S, 0.0, SensorErrors::s3(), RateKind::Mean),
            Motion::Coning(_) => (60.0, 0.0, SensorErrors::NONE, RateKind::Mean),
            Motion::Cruise(flight) => (
                1800.0,
                120.0,
                if flight.hard { SensorErrors::CRUISE_HARD } else { SensorErrors::CRUISE },
                RateKind::Instant,
            ),
        };
        Some(Self { name, motion, rate_hz: 100.0, duration_s, scored_from_s, seed: 1, errors, rate_kind })
    }

    fn set_key(&mut self, key: &str, value: &str) -> Result<(), ScenarioError> {
        let invalid = |expected: String| ScenarioError::InvalidValue { key: key.into(), found: value.into(), expected };
        match key {
            "seed" => *self = self.with_seed(value.parse().map_err(|_| invalid("a natural number".into()))?),
            "rate_hz" => *self = self.with_rate_hz(parse_number(key, value, 1.0, 10_000.0)?),
            "duration_s" => self.duration_s = parse_number(key, value, 0.0, 1e7)?,
            "gnss" => {
                let coverage = Coverage::BY_NAME.into_iter().find(|(name, _)| *name == value);
                let names = Coverage::BY_NAME.map(|(name, _)| name).join(", ");
                let (_, coverage) = coverage.ok_or_else(|| invalid(format!("one of {names}")))?;
                let scenario = self.name;
                let not_applicable = |missing| ScenarioError::NotApplicable { scenario, key: "gnss", missing };
                receiver(self).map_err(not_applicable)?.coverage = coverage;
            }
            _ => return Err(ScenarioError::UnknownKey { found: key.into() }),
        }
        Ok(())
    }
}

fn parse_number(key: &str, value: &str, min: f64, max: f64) -> Result<f64, ScenarioError> {
    let parsed = value.parse::<f64>().ok().filter(|x| (min..=max).contains(x));
    let expected = || format!("a number from {min} to {max}");
    parsed.ok_or_else(|| ScenarioError::InvalidValue { key: key.into(), found: value.into(), expected: expected() })
}

/// Error in the text of a scenario.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ScenarioError {
    /// The scenario does not exist.
    UnknownName {
        /// Unknown name.
        found: String,
    },
    /// The query has the same key twice.
    DuplicateKey {
        /// Repeated key.
        found: String,
    },
    /// The key does not exist.
    UnknownKey {
        /// Unknown key.
        found: String,
    },
    /// The value is malformed or out of range.
    InvalidValue {
        /// Key of the value.
        key: String,
        /// Value found.
        found: String,
        /// Accepted values.
        expected: String,
    },
    /// The key does not apply to the scenario.
    NotApplicable {
        /// Name of the scenario.
        scenario: &'static str,
        /// Key that does not apply.
        key: &'static str,
        /// Missing element of the scenario, such as a magnetometer.
        missing: &'static str,
    },
}

impl fmt::Display for ScenarioError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::UnknownName { found } => UnknownName::new("scenario", found, Scenario::NAMES.iter().copied()).fmt(f),
            Self::DuplicateKey { found } => write!(f, "scenario parameter `{found}` is set twice; remove one"),
            Self::UnknownKey { found } => {
                let keys = KEYS.into_iter().chain(PARAMETERS.iter().map(|parameter| parameter.name));
                let unknown = UnknownName::new("scenario parameter", found, keys);
                write!(f, "{unknown}, as in `cruise?seed=3&gnss=gaps`")
            }
            Self::InvalidValue { key, found, expected } => {
                write!(f, "invalid scenario parameter {key}: found `{found}`, expected {expected}")
            }
            Self::NotApplicable { scenario, key, missing } => {
                write!(f, "scenario `{scenario}` has no {missing}; remove `{key}`")
            }
        }
    }
}

impl std::error::Error for ScenarioError {}
