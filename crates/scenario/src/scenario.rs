//! Scenarios: a motion with the rate, duration, scoring and errors that belong to its name.
//!
//! Input: a name, with a query where something is to be otherwise: `cruise?seed=3&gnss=gaps`. Output: the scenario and its readings.
//! Failure: a name, key or value that does not exist is refused with what does.

use core::fmt;

use attitude::gyro::RateKind;

use crate::{Coverage, Errors, Motion, Reading, Sensors, s3};

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

/// The keys of a query.
const KEYS: [&str; 4] = ["seed", "rate_hz", "duration_s", "gnss"];

impl Scenario {
    /// The scenarios.
    pub const NAMES: [&'static str; 6] = Motion::NAMES;

    /// The scenario of that name as it usually is; a query after `?` changes its `seed`, `rate_hz`, `duration_s` or `gnss`.
    pub fn named(text: &str) -> Result<Self, ScenarioError> {
        let (name, query) = text.split_once('?').unwrap_or((text, ""));
        let mut scenario = Self::usual(name).ok_or_else(|| ScenarioError::Name { found: name.into() })?;
        for pair in query.split('&').filter(|pair| !pair.is_empty()) {
            let (key, value) = pair.split_once('=').unwrap_or((pair, ""));
            scenario.change(key, value)?;
        }
        Ok(scenario)
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
            Motion::S1 => (100.0, 5.0, Errors::S1, RateKind::Instant),
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
        let number = |least: f64, most: f64| {
            let parsed = value.parse::<f64>().ok().filter(|x| (least..=most).contains(x));
            parsed.ok_or_else(|| refused(format!("a number from {least} to {most}")))
        };
        match key {
            "seed" => *self = self.with_seed(value.parse().map_err(|_| refused("a natural number".into()))?),
            "rate_hz" => *self = self.with_rate_hz(number(1.0, 10_000.0)?),
            "duration_s" => self.duration_s = number(0.0, 1e7)?,
            "gnss" => {
                let coverage = Coverage::NAMED.into_iter().find(|(name, _)| *name == value);
                let names = Coverage::NAMED.map(|(name, _)| name).join(", ");
                let (_, coverage) = coverage.ok_or_else(|| refused(format!("one of {names}")))?;
                let receiver = self.errors.receiver.as_mut();
                receiver.ok_or(ScenarioError::NoReceiver { scenario: self.name })?.coverage = coverage;
            }
            _ => return Err(ScenarioError::Key { found: key.into() }),
        }
        Ok(())
    }
}

/// Why a scenario was refused.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ScenarioError {
    /// There is no such scenario.
    Name {
        /// What was asked for.
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
    /// `gnss` of a scenario without a satellite receiver.
    NoReceiver {
        /// The scenario.
        scenario: &'static str,
    },
}

impl fmt::Display for ScenarioError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Name { found } => {
                write!(f, "there is no scenario `{found}`; there are {}", Scenario::NAMES.join(", "))
            }
            Self::Key { found } => {
                write!(
                    f,
                    "a scenario has no `{found}`; {} can be set, as in `cruise?seed=3&gnss=gaps`",
                    KEYS.join(", ")
                )
            }
            Self::Value { key, found, expected } => {
                write!(f, "a scenario's {key}: expected {expected}, found `{found}`")
            }
            Self::NoReceiver { scenario } => {
                write!(f, "the scenario `{scenario}` has no satellite receiver; leave out `gnss`")
            }
        }
    }
}

impl std::error::Error for ScenarioError {}
