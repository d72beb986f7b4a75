//! Adjustable parameters of a stage.
//!
//! Input: a parameter name and a value.
//!
//! Time: parameters are set before the first step.
//!
//! Failure: an unknown name or a value outside the range is rejected and changes nothing.

use core::fmt;

/// Description of an adjustable parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameter {
    /// Name, with the unit as its suffix.
    pub name: &'static str,
    /// Unit; empty for a dimensionless number.
    pub unit: &'static str,
    /// Default value, in `unit`.
    pub default: f64,
    /// Minimum allowed value, in `unit`.
    pub min: f64,
    /// Maximum allowed value, in `unit`.
    pub max: f64,
    /// Meaning of the parameter, in one sentence.
    pub description: &'static str,
}

/// Set of parameters that are accessed by name.
pub trait Parameters {
    /// Descriptions of all parameters.
    const TABLE: &'static [Parameter];

    /// Sets the parameter `name`.
    ///
    /// # Errors
    ///
    /// Returns a [`ParameterError`] if there is no such parameter or the value is out of range.
    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError>;
}

/// Error from setting a parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ParameterError {
    /// The stage has no parameter of that name.
    Unknown {
        /// Parameters that the stage has.
        known: &'static [Parameter],
    },
    /// The value is outside the allowed range or not a number.
    OutOfRange {
        /// Parameter that was to be set.
        parameter: &'static Parameter,
        /// Rejected value.
        value: f64,
    },
}

impl fmt::Display for ParameterError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unknown { known: [] } => write!(f, "unknown parameter; this stage has no parameters"),
            Self::Unknown { known } => {
                write!(f, "unknown parameter; available:")?;
                known
                    .iter()
                    .enumerate()
                    .try_for_each(|(i, known)| write!(f, "{} {}", if i == 0 { "" } else { "," }, known.name))
            }
            Self::OutOfRange { parameter, value } => {
                let Parameter { name, unit, min: least, max: most, .. } = parameter;
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

/// Declares the settings of a stage: a struct of `f64` fields with defaults, ranges and units.
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
            $(
                $(#[doc = $description:literal])+
                $name:ident: $default:literal in $min:literal .. $max:literal, $unit:literal;
            )*
        }
    ) => {
        $(#[$meta])*
        #[derive(Debug, Clone, Copy, PartialEq)]
        $vis struct $Settings {
            $($(#[doc = $description])+ $vis $name: f64,)*
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
                    min: $min,
                    max: $max,
                    description: concat!($($description),+).trim_ascii(),
                },
            )*];

            fn set(&mut self, name: &str, value: f64) -> Result<(), $crate::parameters::ParameterError> {
                let unknown = $crate::parameters::ParameterError::Unknown { known: Self::TABLE };
                let parameter = Self::TABLE.iter().find(|parameter| parameter.name == name).ok_or(unknown)?;
                if !(parameter.min..=parameter.max).contains(&value) {
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

/// Implements the parameter methods of a stage. The parameters are the settings in a struct field
/// of the stage.
macro_rules! parameters_of {
    ($Settings:ident in $($field:ident).+) => {
        fn parameters(&self) -> &'static [$crate::parameters::Parameter] {
            <$Settings as $crate::parameters::Parameters>::TABLE
        }

        fn set(&mut self, name: &str, value: f64) -> Result<(), $crate::parameters::ParameterError> {
            $crate::parameters::Parameters::set(&mut self.$($field).+, name, value)
        }
    };
}
pub(crate) use parameters_of;

#[cfg(test)]
mod tests {
    use super::*;

    settings! {
        /// Settings for the tests.
        struct Settings {
            /// Time constant of the tilt.
            time_constant_s: 1.0 in 0.01 .. 1000.0, "s";
            /// Pure number.
            damping: 0.7 in 0.1 .. 2.0, "";
        }
    }

    #[test]
    fn set_accepts_only_values_in_range() {
        let mut settings = Settings::default();
        assert_eq!(settings.set("damping", 0.5), Ok(()));
        for value in [0.0, 3.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(settings.set("damping", value), Err(ParameterError::OutOfRange { .. })));
        }
        assert!(matches!(settings.set("dampin", 0.5), Err(ParameterError::Unknown { known }) if known.len() == 2));
        assert_eq!(settings, Settings { time_constant_s: 1.0, damping: 0.5 });
    }

    #[test]
    fn table_lists_unit_range_and_description() {
        let [time, _] = Settings::TABLE else { panic!("two parameters") };
        assert_eq!((time.unit, time.min, time.max, time.default), ("s", 0.01, 1000.0, 1.0));
        assert_eq!(time.description, "Time constant of the tilt.");
    }
}
