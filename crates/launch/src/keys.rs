//! Declaration of launch keys.
//!
//! [`keys!`] declares a section: one row per key with documentation, name, type, default and
//! allowed values. [`choices!`] declares the values of a key that has a fixed set of names.
//!
//! The struct, its `Default`, the reader with its checks, the comments of `launch.toml` and the
//! reference chapter are generated from these rows.

use crate::{description::Key, toml_reader::Section};

/// Values that are allowed for a key, and their conversion to `T`.
pub(crate) trait Kind<T> {
    /// Replaces `out` if the key is present with a valid value. Reports an invalid value.
    fn read(&self, section: &mut Section<'_, '_>, key: Key, out: &mut T);
}

/// Evaluates to the [`Key`](crate::description::Key) of a row, from its documentation and name.
macro_rules! key {
    ($($doc:literal)+, $name:expr $(, unit $unit:literal)? $(, example $example:literal)?) => {
        $crate::description::Key {
            name: $name,
            doc: concat!($($doc, "\n"),+),
            unit: concat!("" $(, $unit)?),
            example: concat!("" $(, $example)?),
        }
    };
}

/// Evaluates to the name of a field, or to the literal if the key has another name.
macro_rules! key_name {
    ($field:ident) => {
        stringify!($field)
    };
    ($field:ident $name:literal) => {
        $name
    };
}

/// Declares a section: a public struct with one field per key.
///
/// A row is `/// Meaning.` `field: Type = default, kind;`. `kind` implements [`Kind`]. It may be
/// followed by `unit "s"`, and by `example "value"` for a key that is not set by default. Write
/// `field as "key"` if the name of the key differs from that of the field.
macro_rules! keys {
    (
        $(#[$meta:meta])*
        $vis:vis struct $Section:ident {
            $(
                $(#[doc = $doc:literal])+
                $(#[serde $serde:tt])?
                $field:ident $(as $name:literal)?: $Type:ty = $default:expr, $kind:expr
                    $(, unit $unit:literal)? $(, example $example:literal)?;
            )*
        }
    ) => {
        #[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
        $(#[$meta])*
        $vis struct $Section {
            $(
                $(#[doc = $doc])+
                $(#[doc = concat!("\n\nUnit: ", $unit, ".")])?
                $(#[serde $serde])?
                $vis $field: $Type,
            )*
        }

        impl Default for $Section {
            fn default() -> Self {
                Self { $($field: $default,)* }
            }
        }

        impl $Section {
            /// Reads every key of the section.
            pub(crate) fn read_keys(&mut self, section: &mut $crate::toml_reader::Section<'_, '_>) {
                $(
                    let name = $crate::keys::key_name!($field $($name)?);
                    let key = $crate::keys::key!($($doc)+, name $(, unit $unit)? $(, example $example)?);
                    $crate::keys::Kind::read(&$kind, section, key, &mut self.$field);
                )*
            }
        }
    };
}

/// Declares the values of a key: a public enum with a name for each variant.
///
/// A variant is `/// Meaning.` `Variant = "name",`. Fields in braces after the name are rows of
/// keys that belong to this value only.
macro_rules! choices {
    (
        $(#[$meta:meta])*
        $vis:vis enum $Choice:ident {
            $(
                $(#[doc = $doc:literal])+
                $Variant:ident = $name:literal $({
                    $(
                        $(#[doc = $field_doc:literal])+
                        $field:ident: $Type:ty = $default:expr, $kind:expr $(, unit $unit:literal)?;
                    )*
                })?,
            )*
        }
    ) => {
        #[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
        $(#[$meta])*
        $vis enum $Choice {
            $(
                $(#[doc = $doc])+
                $Variant $({
                    $(
                        $(#[doc = $field_doc])+
                        $(#[doc = concat!("\n\nUnit: ", $unit, ".")])?
                        $field: $Type,
                    )*
                })?,
            )*
        }

        impl $crate::keys::Named for $Choice {
            const NAMES: &'static [(&'static str, Self)] =
                &[$(($name, Self::$Variant $({ $($field: $default,)* })?)),*];
            const DOCS: &'static [&'static str] = &[$(concat!($($doc, "\n"),+)),*];
        }

        impl $Choice {
            /// Returns the name in a launch file.
            pub const fn name(&self) -> &'static str {
                match self {
                    $(Self::$Variant { .. } => $name,)*
                }
            }

            $crate::keys::choices!(@read $($(($Variant { $(
                [$($field_doc)+] $field, $kind $(, unit $unit)?;
            )* }))?)*);
        }
    };
    (@read) => {};
    (@read $(($Variant:ident { $([$($doc:literal)+] $field:ident, $kind:expr $(, unit $unit:literal)?;)* }))+) => {
        /// Reads the keys that belong to this value.
        fn read_keys(&mut self, section: &mut $crate::toml_reader::Section<'_, '_>) {
            match self {
                $(
                    Self::$Variant { $($field),* } => {
                        $(
                            let key = $crate::keys::key!($($doc)+, stringify!($field) $(, unit $unit)?);
                            $crate::keys::Kind::read(&$kind, section, key, $field);
                        )*
                    }
                )+
                _ => {}
            }
        }
    };
}

/// Values of a key that has a fixed set of names.
pub(crate) trait Named: Sized + 'static {
    /// All values with their names.
    const NAMES: &'static [(&'static str, Self)];
    /// Meanings of the values, in the order of [`NAMES`](Self::NAMES).
    const DOCS: &'static [&'static str];
}

pub(crate) use {choices, key, key_name, keys};
