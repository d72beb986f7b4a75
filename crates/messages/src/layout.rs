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
const UNITS: [(&str, &str); 7] = [
    ("_rad_s", "rad/s"),
    ("_m_s2", "m/s²"),
    ("_m_s", "m/s"),
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
    ($(#[doc = $about:literal])* $name:ident = $type_name:literal on $topic:expr, {
        $($(#[doc = $field_about:literal])* $field:ident: $kind:ty,)*
    }) => {
        $(#[doc = $about])*
        #[derive(Debug, Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
        #[repr(C)]
        pub struct $name { $($(#[doc = $field_about])* pub $field: $kind,)* }

        impl $name {
            fn own_layout() -> crate::Layout {
                crate::Layout {
                    name: $type_name,
                    size: size_of::<$name>(),
                    fields: vec![$(crate::Field {
                        name: stringify!($field),
                        kind: stringify!($kind),
                        offset: core::mem::offset_of!($name, $field),
                        about: concat!($($field_about),*).trim_ascii_start(),
                    }),*],
                    topic: $topic,
                    about: concat!($($about),*).trim_ascii_start(),
                    header_fields: 0,
                }
            }
        }
    };
}

/// Defines a payload with its topic.
macro_rules! payload {
    ($(#[doc = $about:literal])* $name:ident = $type_name:literal on $topic:literal $fields:tt) => {
        crate::layout::laid_out! { $(#[doc = $about])* $name = $type_name on Some($topic), $fields }

        impl crate::Message for $name {
            const TOPIC: &'static str = $topic;
            const TYPE: &'static str = $type_name;

            fn layout() -> crate::Layout {
                <$name>::complete(Self::own_layout())
            }
        }
    };
}

pub(crate) use {laid_out, payload};
