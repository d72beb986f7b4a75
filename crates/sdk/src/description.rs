//! Description of a stage as text: its slot and its parameters.
//!
//! Input, output: one tab-separated line per item, `slot NAME` and `parameter NAME UNIT DEFAULT MIN
//! MAX DESCRIPTION`.
//!
//! Failure: an invalid line is rejected and quoted in the error.

use std::fmt::Write as _;

use attitude::parameters::Parameter;

/// Maximum number of parameters of a stage.
const MAX_PARAMETERS: usize = 64;

/// Slot and parameters of an external stage.
#[derive(Debug, Clone, PartialEq)]
pub struct Description {
    /// Name of the slot that the stage fills.
    pub slot: String,
    /// Adjustable parameters. Their order defines the index in
    /// [`RequestKind::Set`](crate::frame::RequestKind::Set).
    pub parameters: Vec<ParameterDescription>,
}

/// Description of an adjustable parameter: a [`Parameter`] with owned text.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterDescription {
    /// Name, with the unit as its suffix.
    pub name: String,
    /// Unit; empty for a dimensionless number.
    pub unit: String,
    /// Default value.
    pub default: f64,
    /// Minimum allowed value.
    pub min: f64,
    /// Maximum allowed value.
    pub max: f64,
    /// Meaning of the parameter in one sentence.
    pub description: String,
}

/// Error in a description, with at most 80 characters of the invalid line.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("invalid line in the stage description: {0:?}")]
pub struct DescriptionError(String);

/// Formats a description.
pub(crate) fn to_text(slot: &str, parameters: &[Parameter]) -> String {
    let mut text = format!("slot\t{slot}\n");
    for Parameter { name, unit, default, min, max, description } in parameters {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "parameter\t{name}\t{unit}\t{default}\t{min}\t{max}\t{description}");
    }
    text
}

impl Description {
    /// Parses the description that a program sent.
    ///
    /// # Errors
    ///
    /// Returns a [`DescriptionError`] for an invalid line, more than 64 parameters or a missing
    /// slot.
    pub fn parse(bytes: &[u8]) -> Result<Self, DescriptionError> {
        let text = String::from_utf8_lossy(bytes);
        let invalid = |line: &str| DescriptionError(line.chars().take(80).collect());
        let mut parsed = Self { slot: String::new(), parameters: Vec::new() };
        for line in text.lines() {
            match line.split('\t').collect::<Vec<_>>()[..] {
                ["slot", slot] => parsed.slot = slot.into(),
                ["parameter", name, unit, default, min, max, description] => {
                    let number = |text: &str| {
                        text.parse().ok().filter(|number: &f64| number.is_finite()).ok_or_else(|| invalid(line))
                    };
                    let (default, min, max) = (number(default)?, number(min)?, number(max)?);
                    let in_range = min <= default && default <= max;
                    if !in_range || name.is_empty() || parsed.parameters.len() == MAX_PARAMETERS {
                        return Err(invalid(line));
                    }
                    let (name, unit, description) = (name.into(), unit.into(), description.into());
                    parsed.parameters.push(ParameterDescription { name, unit, default, min, max, description });
                }
                _ => return Err(invalid(line)),
            }
        }
        if parsed.slot.is_empty() { Err(invalid(&text)) } else { Ok(parsed) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use attitude::{parameters::Parameters, settings};

    settings! {
        /// Settings for the tests.
        pub struct Settings {
            /// Time constant of the tilt.
            time_constant_s: 0.1 in 1e-3 .. 1000.0, "s";
        }
    }

    #[test]
    fn description_round_trips_through_text() {
        let parsed = Description::parse(to_text("fuser", Settings::TABLE).as_bytes()).unwrap();
        let [time] = &parsed.parameters[..] else { panic!("one parameter") };
        assert_eq!((parsed.slot.as_str(), time.name.as_str(), time.unit.as_str()), ("fuser", "time_constant_s", "s"));
        assert_eq!((time.default, time.min, time.max), (0.1, 1e-3, 1000.0));
        assert_eq!(time.description, "Time constant of the tilt.");
    }

    #[test]
    fn invalid_description_is_rejected() {
        let invalid = [
            "",
            "slot",
            "no\ttab",
            "slot\tfuser\nparameter\tx\ts\t1\t2\t3\tdefault below minimum",
            "slot\tfuser\nparameter\tx\ts\t1\t0\tinf\tinfinite maximum",
            "slot\tfuser\nparameter\tx\ts\tone\t0\t2\tdefault not a number",
        ];
        for text in invalid {
            assert!(Description::parse(text.as_bytes()).is_err(), "{text:?}");
        }
        let too_many = "slot\tfuser\n".to_owned() + &"parameter\tx\t\t1\t0\t2\tparameter\n".repeat(65);
        assert!(Description::parse(too_many.as_bytes()).is_err());
    }
}
