//! The numbers by which a stage can be set.
//!
//! Input: a name and a value. Output: a stage that works with it. Time: before the first step. Failure: a name that the stage does
//! not have, or a value outside its range, is refused and changes nothing.

use core::fmt;

/// A number by which a stage can be set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameter {
    /// Its name, unit last.
    pub name: &'static str,
    /// Its unit; empty for a pure number.
    pub unit: &'static str,
    /// Its value where nothing is said.
    pub default: f64,
    /// The least allowed.
    pub least: f64,
    /// The most allowed.
    pub most: f64,
    /// What it means.
    pub about: &'static str,
}

/// Parameters of a stage, by name.
pub trait Parameters {
    /// All of them.
    const TABLE: &'static [Parameter];

    /// Sets the parameter of that name.
    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError>;
}

/// Why a parameter was refused.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ParameterError {
    /// The stage has no such parameter.
    Unknown {
        /// Those it has.
        known: &'static [Parameter],
    },
    /// The value is outside the range, or not a number.
    OutOfRange {
        /// The parameter.
        parameter: &'static Parameter,
        /// The value.
        value: f64,
    },
}

impl fmt::Display for ParameterError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unknown { known: [] } => write!(f, "this stage has no parameters"),
            Self::Unknown { known } => {
                write!(f, "no such parameter; there are")?;
                known
                    .iter()
                    .enumerate()
                    .try_for_each(|(i, known)| write!(f, "{} {}", if i == 0 { "" } else { "," }, known.name))
            }
            Self::OutOfRange { parameter, value } => {
                let Parameter { name, unit, least, most, .. } = parameter;
                write!(f, "{name}: expected {least} to {most}")?;
                if !unit.is_empty() {
                    write!(f, " {unit}")?;
                }
                write!(f, ", found {value}")
            }
        }
    }
}

impl core::error::Error for ParameterError {}

/// Declares a stage's settings: a struct of `f64` with defaults, ranges and units.
///
/// ```
/// attitude::parameters::settings! {
///     /// Settings of the stage.
///     pub struct Settings {
///         /// Time constant of the tilt.
///         time_constant_s: 1.0 in 0.01 .. 1000.0, "s";
///     }
/// }
/// assert_eq!(Settings::default().time_constant_s, 1.0);
/// ```
#[macro_export]
macro_rules! settings {
    (
        $(#[$meta:meta])*
        $vis:vis struct $Settings:ident {
            $(#[doc = $about:literal] $name:ident: $default:literal in $least:literal .. $most:literal, $unit:literal;)*
        }
    ) => {
        $(#[$meta])*
        #[derive(Debug, Clone, Copy, PartialEq)]
        $vis struct $Settings {
            $(#[doc = $about] $vis $name: f64,)*
        }

        impl Default for $Settings {
            fn default() -> Self {
                Self { $($name: $default,)* }
            }
        }

        impl $crate::parameters::Parameters for $Settings {
            const TABLE: &'static [$crate::parameters::Parameter] = &[$(
                $crate::parameters::Parameter {
                    name: stringify!($name),
                    unit: $unit,
                    default: $default,
                    least: $least,
                    most: $most,
                    about: $about.trim_ascii(),
                },
            )*];

            fn set(&mut self, name: &str, value: f64) -> Result<(), $crate::parameters::ParameterError> {
                let unknown = $crate::parameters::ParameterError::Unknown { known: Self::TABLE };
                let parameter = Self::TABLE.iter().find(|parameter| parameter.name == name).ok_or(unknown)?;
                if !(parameter.least..=parameter.most).contains(&value) {
                    return Err($crate::parameters::ParameterError::OutOfRange { parameter, value });
                }
                match name {
                    $(stringify!($name) => self.$name = value,)*
                    _ => return Err(unknown),
                }
                Ok(())
            }
        }
    };
}
pub use crate::settings;

#[cfg(test)]
mod tests {
    use super::*;

    settings! {
        /// For the tests.
        struct Settings {
            /// Time constant of the tilt.
            time_constant_s: 1.0 in 0.01 .. 1000.0, "s";
            /// Pure number.
            damping: 0.7 in 0.1 .. 2.0, "";
        }
    }

    #[test]
    fn a_value_in_range_is_taken_and_any_other_changes_nothing() {
        let mut settings = Settings::default();
        assert_eq!(settings.set("damping", 0.5), Ok(()));
        for value in [0.0, 3.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(settings.set("damping", value), Err(ParameterError::OutOfRange { .. })));
        }
        assert!(matches!(settings.set("dampin", 0.5), Err(ParameterError::Unknown { known }) if known.len() == 2));
        assert_eq!(settings, Settings { time_constant_s: 1.0, damping: 0.5 });
    }

    #[test]
    fn the_table_tells_unit_range_and_meaning() {
        let [time, _] = Settings::TABLE else { panic!("two parameters") };
        assert_eq!((time.unit, time.least, time.most, time.default), ("s", 0.01, 1000.0, 1.0));
        assert_eq!(time.about, "Time constant of the tilt.");
    }
}
