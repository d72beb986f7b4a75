//! Scenarios: a motion with the rate, duration, scoring and errors that belong to its name.
//!
//! Input: a name, with a query where something is to be otherwise: `cruise?seed=3&gnss=gaps`. Output: the scenario and its readings.
//! Failure: a name, key or value that does not exist is refused with what does.

use core::fmt;

use attitude::{GRAVITY_M_S2, gyro::RateKind};

use crate::{Coverage, Errors, Motion, Reading, Receiver, Sensors, s3};

/// A motion and all that belongs to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scenario {
    /// Its name, one of [`Scenario::NAMES`].
    pub name: &'static str,
    /// What the body does.
    pub motion: Motion,
    /// Readings per second.
    pub rate_hz: f64,
    /// Length, s.
    pub duration_s: f64,
    /// Time from which errors count, s.
    pub scored_from_s: f64,
    /// Of everything random in it.
    pub seed: u64,
    /// What is wrong with the sensors, at `rate_hz`.
    pub errors: Errors,
    /// What its rate samples mean.
    pub rate_kind: RateKind,
}

/// The keys of a query that are no [`PARAMETERS`].
const KEYS: [&str; 4] = ["seed", "rate_hz", "duration_s", "gnss"];

/// A number by which a scenario can be set.
#[derive(Debug, Clone, Copy)]
pub struct Parameter {
    /// Its name, with the unit.
    pub name: &'static str,
    /// The least that it may be.
    pub least: f64,
    /// The most.
    pub most: f64,
    /// What it is.
    pub about: &'static str,
    /// Sets it; a scenario that has nothing of the kind says what it lacks.
    set: fn(&mut Scenario, f64) -> Result<(), &'static str>,
}

/// Every number by which scenarios can be set; errors are those at the scenario's rate.
pub const PARAMETERS: [Parameter; 12] = [
    Parameter {
        name: "gyro_bias_deg_s",
        least: 0.0,
        most: 100.0,
        about: "constant gyro bias on each axis, °/s",
        set: |scenario, value| give(&mut scenario.errors.gyro_bias_rad_s, value.to_radians()),
    },
    Parameter {
        name: "gyro_noise_deg_s",
        least: 0.0,
        most: 100.0,
        about: "white noise of the gyro on each axis and sample, °/s",
        set: |scenario, value| give(&mut scenario.errors.gyro_noise_rad_s, value.to_radians()),
    },
    Parameter {
        name: "gyro_scale",
        least: 0.0,
        most: 0.5,
        about: "scale error of the gyro on each axis",
        set: |scenario, value| give(&mut scenario.errors.gyro_scale, value),
    },
    Parameter {
        name: "accel_bias_g",
        least: 0.0,
        most: 10.0,
        about: "constant bias of the accelerometer on each axis, g",
        set: |scenario, value| give(&mut scenario.errors.accel_bias_m_s2, value * GRAVITY_M_S2),
    },
    Parameter {
        name: "accel_noise_g",
        least: 0.0,
        most: 10.0,
        about: "white noise of the accelerometer on each axis and sample, g",
        set: |scenario, value| give(&mut scenario.errors.accel_noise_m_s2, value * GRAVITY_M_S2),
    },
    Parameter {
        name: "field_noise_ut",
        least: 0.0,
        most: 1000.0,
        about: "white noise of the magnetometer on each axis and sample, µT",
        set: |scenario, value| give(&mut scenario.errors.field.as_mut().ok_or("magnetometer")?.noise_ut, value),
    },
    Parameter {
        name: "gnss_noise_m_s",
        least: 0.0,
        most: 100.0,
        about: "white noise of the satellite velocity on each axis and fix, m/s",
        set: |scenario, value| give(&mut receiver(scenario)?.noise_m_s, value),
    },
    Parameter {
        name: "gnss_latency_s",
        least: 0.0,
        most: 2.0,
        about: "how late fixes arrive, s",
        set: |scenario, value| give(&mut receiver(scenario)?.latency_s, value),
    },
    Parameter {
        name: "antenna_right_m",
        least: -100.0,
        most: 100.0,
        about: "place of the receiver's antenna from the sensors, to the right, m",
        set: |scenario, value| give(&mut receiver(scenario)?.antenna_m.x, value),
    },
    Parameter {
        name: "antenna_forward_m",
        least: -100.0,
        most: 100.0,
        about: "the same, forward, m",
        set: |scenario, value| give(&mut receiver(scenario)?.antenna_m.y, value),
    },
    Parameter {
        name: "antenna_up_m",
        least: -100.0,
        most: 100.0,
        about: "the same, up, m",
        set: |scenario, value| give(&mut receiver(scenario)?.antenna_m.z, value),
    },
    Parameter {
        name: "amplitude_deg",
        least: 0.0,
        most: 89.0,
        about: "how far the body swings, °: of s1 the roll, with its pitch in proportion; of coning half the cone",
        set: |scenario, value| match &mut scenario.motion {
            Motion::Swing(swing) => give(swing, swing.scaled_to(value.to_radians())),
            Motion::Coning(coning) => give(&mut coning.half_angle_rad, value.to_radians()),
            Motion::Tumble(_) | Motion::S3 | Motion::Cruise(_) => Err("amplitude"),
        },
    },
];

fn give<T>(place: &mut T, value: T) -> Result<(), &'static str> {
    *place = value;
    Ok(())
}

fn receiver(scenario: &mut Scenario) -> Result<&mut Receiver, &'static str> {
    scenario.errors.receiver.as_mut().ok_or("satellite receiver")
}

impl Scenario {
    /// The scenarios.
    pub const NAMES: [&'static str; 6] = Motion::NAMES;

    /// The scenario of that name as it usually is; a query after `?` changes its `seed`, `rate_hz`, `duration_s`, `gnss` or one of the
    /// [`PARAMETERS`].
    pub fn named(text: &str) -> Result<Self, ScenarioError> {
        let (name, query) = text.split_once('?').unwrap_or((text, ""));
        let mut scenario = Self::usual(name).ok_or_else(|| ScenarioError::Name { found: name.into() })?;
        let pairs = query.split('&').filter(|pair| !pair.is_empty());
        let pairs: Vec<_> = pairs.map(|pair| pair.split_once('=').unwrap_or((pair, ""))).collect();
        if let Some((key, _)) =
            (1..).zip(&pairs).find_map(|(next, pair)| pairs[next..].iter().find(|it| it.0 == pair.0))
        {
            return Err(ScenarioError::Twice { found: (*key).into() });
        }
        // Another rate changes the noise that is not set.
        let (others, numbers): (Vec<_>, Vec<_>) = pairs.into_iter().partition(|(key, _)| KEYS.contains(key));
        others.into_iter().try_for_each(|(key, value)| scenario.change(key, value))?;
        for (key, value) in numbers {
            let parameter = PARAMETERS.iter().find(|parameter| parameter.name == key);
            let Parameter { least, most, .. } = parameter.ok_or_else(|| ScenarioError::Key { found: key.into() })?;
            scenario.set(key, number(key, value, *least, *most)?)?;
        }
        Ok(scenario)
    }

    /// Sets one of the [`PARAMETERS`], whose range is not looked at.
    pub fn set(&mut self, name: &str, value: f64) -> Result<(), ScenarioError> {
        let parameter = PARAMETERS.iter().find(|parameter| parameter.name == name);
        let Parameter { name, set, .. } = parameter.ok_or_else(|| ScenarioError::Key { found: name.into() })?;
        set(self, value).map_err(|lacks| ScenarioError::Lacks { scenario: self.name, key: name, lacks })
    }

    /// The same scenario with everything random in it drawn from another seed.
    #[must_use]
    pub fn with_seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        if let Motion::Cruise(flight) = &mut self.motion {
            flight.seed = seed;
        }
        self
    }

    /// The same scenario with another rate; the errors of a flight are those of a sensor that averages.
    #[must_use]
    pub fn with_rate_hz(mut self, rate_hz: f64) -> Self {
        if let Motion::Cruise(_) = self.motion {
            self.errors = self.errors.resampled(self.rate_hz, rate_hz);
        }
        self.rate_hz = rate_hz;
        self
    }

    /// Its sensors.
    pub fn sensors(&self) -> Sensors {
        let sensors = Sensors::new(self.motion, self.errors, self.seed);
        if self.rate_kind == RateKind::Mean { sensors.integrating() } else { sensors }
    }

    /// Its readings, from time 0 to the end, each with its time, s.
    pub fn readings(&self) -> impl Iterator<Item = (f64, Reading)> + use<> {
        let (mut sensors, rate_hz) = (self.sensors(), self.rate_hz);
        let count = libm::round(self.duration_s * rate_hz) as u64;
        (0..=count).map(move |k| k as f64 / rate_hz).map(move |t_s| (t_s, sensors.read(t_s)))
    }

    fn usual(name: &str) -> Option<Self> {
        let motion = Motion::named(name)?;
        let name = Self::NAMES.into_iter().find(|known| *known == name)?;
        let (duration_s, scored_from_s, errors, rate_kind) = match motion {
            Motion::Swing(_) => (100.0, 5.0, Errors::S1, RateKind::Instant),
            Motion::Tumble(_) => (100.0, 5.0, Errors::S1, RateKind::Instant),
            Motion::S3 => (s3::DURATION_S, 0.0, Errors::s3(), RateKind::Mean),
            Motion::Coning(_) => (60.0, 0.0, Errors::NONE, RateKind::Mean),
            Motion::Cruise(flight) => {
                (1800.0, 120.0, if flight.hard { Errors::CRUISE_HARD } else { Errors::CRUISE }, RateKind::Instant)
            }
        };
        Some(Self { name, motion, rate_hz: 100.0, duration_s, scored_from_s, seed: 1, errors, rate_kind })
    }

    fn change(&mut self, key: &str, value: &str) -> Result<(), ScenarioError> {
        let refused = |expected: String| ScenarioError::Value { key: key.into(), found: value.into(), expected };
        match key {
            "seed" => *self = self.with_seed(value.parse().map_err(|_| refused("a natural number".into()))?),
            "rate_hz" => *self = self.with_rate_hz(number(key, value, 1.0, 10_000.0)?),
            "duration_s" => self.duration_s = number(key, value, 0.0, 1e7)?,
            "gnss" => {
                let coverage = Coverage::NAMED.into_iter().find(|(name, _)| *name == value);
                let names = Coverage::NAMED.map(|(name, _)| name).join(", ");
                let (_, coverage) = coverage.ok_or_else(|| refused(format!("one of {names}")))?;
                let scenario = self.name;
                let lacks = |lacks| ScenarioError::Lacks { scenario, key: "gnss", lacks };
                receiver(self).map_err(lacks)?.coverage = coverage;
            }
            _ => return Err(ScenarioError::Key { found: key.into() }),
        }
        Ok(())
    }
}

fn number(key: &str, value: &str, least: f64, most: f64) -> Result<f64, ScenarioError> {
    let parsed = value.parse::<f64>().ok().filter(|x| (least..=most).contains(x));
    let expected = || format!("a number from {least} to {most}");
    parsed.ok_or_else(|| ScenarioError::Value { key: key.into(), found: value.into(), expected: expected() })
}

/// Why a scenario was refused.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ScenarioError {
    /// There is no such scenario.
    Name {
        /// What was asked for.
        found: String,
    },
    /// The query has a key twice.
    Twice {
        /// The key.
        found: String,
    },
    /// The query has no such key.
    Key {
        /// What was asked for.
        found: String,
    },
    /// The key does not take this value.
    Value {
        /// The key.
        key: String,
        /// The value.
        found: String,
        /// What it takes.
        expected: String,
    },
    /// The scenario has nothing that the key could set.
    Lacks {
        /// The scenario.
        scenario: &'static str,
        /// The key.
        key: &'static str,
        /// What it has not.
        lacks: &'static str,
    },
}

impl fmt::Display for ScenarioError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Name { found } => {
                write!(f, "there is no scenario `{found}`; there are {}", Scenario::NAMES.join(", "))
            }
            Self::Twice { found } => write!(f, "`{found}` is set twice; keep one"),
            Self::Key { found } => {
                let keys: Vec<_> = KEYS.into_iter().chain(PARAMETERS.iter().map(|parameter| parameter.name)).collect();
                write!(
                    f,
                    "a scenario has no `{found}`; {} can be set, as in `cruise?seed=3&gnss=gaps`",
                    keys.join(", ")
                )
            }
            Self::Value { key, found, expected } => {
                write!(f, "a scenario's {key}: expected {expected}, found `{found}`")
            }
            Self::Lacks { scenario, key, lacks } => {
                write!(f, "the scenario `{scenario}` has no {lacks}; leave out `{key}`")
            }
        }
    }
}

impl std::error::Error for ScenarioError {}
