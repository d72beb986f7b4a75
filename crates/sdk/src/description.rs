//! What a stage says of itself: its slot, and the numbers by which it can be set.
//!
//! Input, output: text of one line for each thing, its parts between tabs: `slot NAME`, `parameter NAME UNIT DEFAULT LEAST MOST MEANING`. Time:
//! none. Failure: what is not such a line is refused with the line.

use std::fmt::Write as _;

use attitude::parameters::Parameter;

/// Parameters of a stage at most.
const MAX_PARAMETERS: usize = 64;

/// What a stage says of itself.
#[derive(Debug, Clone, PartialEq)]
pub struct Description {
    /// The slot that it fills.
    pub slot: String,
    /// The numbers by which it can be set.
    pub parameters: Vec<Described>,
}

/// A number by which a stage can be set: a [`Parameter`] that was told.
#[derive(Debug, Clone, PartialEq)]
pub struct Described {
    /// Its name, unit last.
    pub name: String,
    /// Its unit; empty for a pure number.
    pub unit: String,
    /// Its value where nothing is said.
    pub default: f64,
    /// The least allowed.
    pub least: f64,
    /// The most allowed.
    pub most: f64,
    /// What it means.
    pub about: String,
}

/// A line that says nothing of a stage.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} does not describe a stage")]
pub struct DescriptionError(String);

/// A stage as text.
pub(crate) fn text(slot: &str, parameters: &[Parameter]) -> String {
    let mut text = format!("slot\t{slot}\n");
    for Parameter { name, unit, default, min: least, max: most, description: about } in parameters {
        // A string takes every line.
        let _ = writeln!(text, "parameter\t{name}\t{unit}\t{default}\t{least}\t{most}\t{about}");
    }
    text
}

impl Description {
    /// From what a program answered.
    pub fn read(bytes: &[u8]) -> Result<Self, DescriptionError> {
        let text = String::from_utf8_lossy(bytes);
        let wrong = |line: &str| DescriptionError(line.chars().take(80).collect());
        let mut description = Self { slot: String::new(), parameters: Vec::new() };
        for line in text.lines() {
            match line.split('\t').collect::<Vec<_>>()[..] {
                ["slot", slot] => description.slot = slot.into(),
                ["parameter", name, unit, default, least, most, about] => {
                    let number = |text: &str| {
                        text.parse().ok().filter(|number: &f64| number.is_finite()).ok_or_else(|| wrong(line))
                    };
                    let (default, least, most) = (number(default)?, number(least)?, number(most)?);
                    let in_range = least <= default && default <= most;
                    if !in_range || name.is_empty() || description.parameters.len() == MAX_PARAMETERS {
                        return Err(wrong(line));
                    }
                    let (name, unit, about) = (name.into(), unit.into(), about.into());
                    description.parameters.push(Described { name, unit, default, least, most, about });
                }
                _ => return Err(wrong(line)),
            }
        }
        if description.slot.is_empty() { Err(wrong(&text)) } else { Ok(description) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use attitude::{parameters::Parameters, settings};

    settings! {
        /// For the tests.
        pub struct Settings {
            /// What is faster comes from the gyro.
            time_constant_s: 0.1 in 1e-3 .. 1000.0, "s";
        }
    }

    #[test]
    fn a_description_is_read_as_it_was_written() {
        let read = Description::read(text("fuser", Settings::TABLE).as_bytes()).unwrap();
        let [time] = &read.parameters[..] else { panic!("one parameter") };
        assert_eq!((read.slot.as_str(), time.name.as_str(), time.unit.as_str()), ("fuser", "time_constant_s", "s"));
        assert_eq!((time.default, time.least, time.most), (0.1, 1e-3, 1000.0));
        assert_eq!(time.about, "What is faster comes from the gyro.");
    }

    #[test]
    fn what_describes_nothing_is_refused() {
        let bad = [
            "",
            "slot",
            "no\ttab",
            "slot\tfuser\nparameter\tx\ts\t1\t2\t3\tdefault below least",
            "slot\tfuser\nparameter\tx\ts\t1\t0\tinf\tno end",
            "slot\tfuser\nparameter\tx\ts\tone\t0\t2\tno number",
        ];
        for text in bad {
            assert!(Description::read(text.as_bytes()).is_err(), "{text:?}");
        }
        let many = "slot\tfuser\n".to_owned() + &"parameter\tx\t\t1\t0\t2\ttoo many\n".repeat(65);
        assert!(Description::read(many.as_bytes()).is_err());
    }
}
