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
}

impl Layout {
    /// A number that differs when any name, type or place differs.
    pub fn fingerprint(&self) -> u64 {
        crate::hash(crate::HASH_START, self.to_string().as_bytes())
    }

    /// This layout with that of its first field, a header, put in the header's place.
    pub(crate) fn with_header(mut self, header: Layout) -> Self {
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

/// Defines a payload: `repr(C)`, no padding, no invalid bit pattern, with its layout.
macro_rules! payload {
    ($(#[$meta:meta])* $name:ident = $type_name:literal on $topic:literal {
        $($(#[$field_meta:meta])* $field:ident: $kind:ty,)*
    }) => {
        $(#[$meta])*
        #[derive(Debug, Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
        #[repr(C)]
        pub struct $name { $($(#[$field_meta])* pub $field: $kind,)* }

        impl crate::Message for $name {
            const TOPIC: &'static str = $topic;
            const TYPE: &'static str = $type_name;

            fn layout() -> crate::Layout {
                let layout = $crate::layout::layout_of!($name, $type_name, $($field: $kind),*);
                <$name>::complete(layout)
            }
        }
    };
}

macro_rules! layout_of {
    ($name:ident, $type_name:literal, $($field:ident: $kind:ty),*) => {
        crate::Layout {
            name: $type_name,
            size: size_of::<$name>(),
            fields: vec![$(crate::Field {
                name: stringify!($field),
                kind: stringify!($kind),
                offset: core::mem::offset_of!($name, $field),
            }),*],
        }
    };
}

pub(crate) use {layout_of, payload};
