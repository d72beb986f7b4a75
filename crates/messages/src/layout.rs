//! The layout of a payload as text and as a fingerprint: what two programs compare before they share memory.

use core::fmt;

/// One field of a payload.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    /// Its name, unit last.
    pub name: &'static str,
    /// Its type as written.
    pub kind: &'static str,
    /// Bytes from the start of the payload.
    pub offset: usize,
    /// What it means, with its unit; no part of the layout's text.
    pub about: &'static str,
}

/// How names end, and the units that they mean; a longer ending comes before a shorter one.
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
    /// The unit that its name ends with.
    pub fn unit(&self) -> Option<&'static str> {
        UNITS.iter().find(|(ending, _)| self.name.ends_with(ending)).map(|(_, unit)| *unit)
    }
}

/// The layout of a payload.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Layout {
    /// The payload's type name with its version.
    pub name: &'static str,
    /// Its size in bytes.
    pub size: usize,
    /// Its fields in order of their place; those of the header first.
    pub fields: Vec<Field>,
    /// The topic that carries it; none for what is only a part of payloads.
    pub topic: Option<&'static str>,
    /// What it is.
    pub about: &'static str,
    /// How many of its fields, from the first on, are those of [`Header`](crate::Header).
    pub header_fields: usize,
}

impl Layout {
    /// A number that differs when any name, type or place differs.
    pub fn fingerprint(&self) -> u64 {
        crate::hash(crate::HASH_START, self.to_string().as_bytes())
    }

    /// This layout, of what a topic of this name carries.
    pub(crate) fn on(mut self, topic: &'static str) -> Self {
        self.topic = Some(topic);
        self
    }

    /// This layout with that of its first field, a header, put in the header's place.
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

/// Defines a struct of a payload: `repr(C)`, no padding, no invalid bit pattern, with its layout.
macro_rules! laid_out {
    ($(#[doc = $about:literal])* $name:ident = $type_name:literal {
        $($(#[doc = $field_about:literal])* $field:ident: $kind:ty,)*
    }) => {
        $(#[doc = $about])*
        #[derive(Debug, Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
        #[repr(C)]
        pub struct $name { $($(#[doc = $field_about])* pub $field: $kind,)* }

        impl $name {
            /// Its layout, the header as one field.
            pub(crate) fn own_layout() -> $crate::Layout {
                $crate::Layout {
                    name: $type_name,
                    size: size_of::<$name>(),
                    fields: vec![$($crate::Field {
                        name: stringify!($field),
                        kind: stringify!($kind),
                        offset: core::mem::offset_of!($name, $field),
                        about: concat!($($field_about),*).trim_ascii_start(),
                    }),*],
                    topic: None,
                    about: concat!($($about),*).trim_ascii_start(),
                    header_fields: 0,
                }
            }
        }
    };
}

/// Defines a payload. What does not descend from a sample may say of when on the source's clock it is: `at (|message, rate_hz| …)`, ns.
macro_rules! payload {
    ($(#[doc = $about:literal])* $name:ident = $type_name:literal at ($time_ns:expr) $fields:tt) => {
        $crate::layout::laid_out! { $(#[doc = $about])* $name = $type_name $fields }

        impl $name {
            pub(crate) const TYPE_NAME: &'static str = $type_name;
            pub(crate) const OWN_TIME_NS: fn(&Self, f64) -> Option<i64> = $time_ns;
        }
    };
    ($(#[doc = $about:literal])* $name:ident = $type_name:literal $fields:tt) => {
        $crate::layout::payload! { $(#[doc = $about])* $name = $type_name at (|_, _| None) $fields }
    };
}

pub(crate) use {laid_out, payload};
