//! Payload layouts, as text and as fingerprints. Programs compare them before they share memory.

use core::fmt;

/// Field of a payload.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    /// Field name, with the unit as its suffix.
    pub name: &'static str,
    /// Type as written in the source.
    pub kind: &'static str,
    /// Offset from the start of the payload, bytes.
    pub offset: usize,
    /// Meaning and unit. It is not part of the layout text.
    pub description: &'static str,
}

/// Name suffixes and their units. The first match applies, so longer suffixes come first.
const UNITS: [(&str, &str); 8] = [
    ("_rad_s", "rad/s"),
    ("_m_s2", "m/s²"),
    ("_m_s", "m/s"),
    ("_m", "m"),
    ("_rad", "rad"),
    ("_ns", "ns"),
    ("_ut", "µT"),
    ("_s", "s"),
];

impl Field {
    /// Returns the unit indicated by the name's suffix, if any.
    pub fn unit(&self) -> Option<&'static str> {
        UNITS.iter().find(|(ending, _)| self.name.ends_with(ending)).map(|(_, unit)| *unit)
    }
}

/// Layout of a payload.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Layout {
    /// Type name of the payload, including its version.
    pub name: &'static str,
    /// Size of the payload, bytes.
    pub size: usize,
    /// Fields in order of their offset. Those of the header come first.
    pub fields: Vec<Field>,
    /// Topic that carries the payload; `None` for a struct that is only a part of payloads.
    pub topic: Option<&'static str>,
    /// Description of the payload.
    pub description: &'static str,
    /// Number of leading fields that belong to [`Header`](crate::Header).
    pub header_fields: usize,
}

impl Layout {
    /// Returns a hash that differs if any name, type or offset differs.
    pub fn fingerprint(&self) -> u64 {
        crate::hash(crate::HASH_START, self.to_string().as_bytes())
    }

    /// Sets the topic that carries the payload.
    pub(crate) fn with_topic(mut self, topic: &'static str) -> Self {
        self.topic = Some(topic);
        self
    }

    /// Replaces the first field, a header, with the header's own fields.
    pub(crate) fn with_header(mut self, header: Layout) -> Self {
        self.header_fields = header.fields.len();
        self.fields.splice(0..1, header.fields);
        self
    }
}

impl fmt::Display for Layout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.name, self.size)?;
        self.fields.iter().try_for_each(|field| write!(f, " {}:{}@{}", field.name, field.kind, field.offset))
    }
}

/// Defines a `repr(C)` struct and its layout. The struct has no padding and no invalid bit
/// patterns.
macro_rules! layout_struct {
    ($(#[doc = $description:literal])* $name:ident = $type_name:literal {
        $($(#[doc = $field_description:literal])* $field:ident: $kind:ty,)*
    }) => {
        $(#[doc = $description])*
        #[derive(Debug, Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
        #[repr(C)]
        pub struct $name { $($(#[doc = $field_description])* pub $field: $kind,)* }

        impl $name {
            /// Returns the layout, with the header as a single field.
            pub(crate) fn struct_layout() -> $crate::Layout {
                $crate::Layout {
                    name: $type_name,
                    size: size_of::<$name>(),
                    fields: vec![$($crate::Field {
                        name: stringify!($field),
                        kind: stringify!($kind),
                        offset: core::mem::offset_of!($name, $field),
                        description: concat!($($field_description),*).trim_ascii_start(),
                    }),*],
                    topic: None,
                    description: concat!($($description),*).trim_ascii_start(),
                    header_fields: 0,
                }
            }
        }
    };
}

/// Defines a payload. A payload that is not derived from a sample may define its time in ns on the
/// source's clock with `at (|message| …)`.
macro_rules! payload {
    ($(#[doc = $description:literal])* $name:ident = $type_name:literal at ($time_ns:expr) $fields:tt) => {
        $crate::layout::layout_struct! { $(#[doc = $description])* $name = $type_name $fields }

        impl $name {
            pub(crate) const TYPE_NAME: &'static str = $type_name;
            pub(crate) const SOURCE_TIME_NS: fn(&Self) -> Option<i64> = $time_ns;
        }
    };
    ($(#[doc = $description:literal])* $name:ident = $type_name:literal $fields:tt) => {
        $crate::layout::payload! { $(#[doc = $description])* $name = $type_name at (|_| None) $fields }
    };
}

pub(crate) use {layout_struct, payload};
