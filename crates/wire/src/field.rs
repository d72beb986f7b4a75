//! Conversion of payload fields to and from fields of the schema.

use graph::Service;
use messages::{Chart, CourseReference, EventKind, Flags, Header, State};

use crate::{
    DecodeError,
    v1::{self, Complex, Quaternion, Vector3},
};

/// Maximum deviation of a quaternion's norm from 1. It is far above the rounding error that
/// accumulates in a long flight.
const NORM_TOLERANCE: f64 = 1e-6;

/// Payload field that is represented by `P` in the schema.
pub(crate) trait Field<P>: Sized {
    fn to_proto(self) -> P;
    fn from_proto(value: P, field: &'static str) -> Result<Self, DecodeError>;
    /// Returns the value, or an error if a validated message cannot contain it.
    fn validated(self, _field: &'static str) -> Result<Self, DecodeError> {
        Ok(self)
    }
}

macro_rules! identity_fields {
    ($($kind:ty),*) => { $(impl Field<$kind> for $kind {
        fn to_proto(self) -> $kind { self }
        fn from_proto(value: $kind, _: &'static str) -> Result<Self, DecodeError> { Ok(value) }
    })* };
}

identity_fields!(u32, u64, i64);

impl Field<f64> for f64 {
    fn to_proto(self) -> f64 {
        self
    }

    fn from_proto(value: f64, _: &'static str) -> Result<Self, DecodeError> {
        Ok(value)
    }

    fn validated(self, field: &'static str) -> Result<Self, DecodeError> {
        if self.is_finite() { Ok(self) } else { Err(DecodeError::NotFinite { field }) }
    }
}

macro_rules! vector_fields {
    ($proto:ident { $($name:ident),* } of $count:literal) => {
        impl Field<Option<$proto>> for [f64; $count] {
            fn to_proto(self) -> Option<$proto> {
                let [$($name),*] = self;
                Some($proto { $($name),* })
            }

            fn from_proto(value: Option<$proto>, field: &'static str) -> Result<Self, DecodeError> {
                let $proto { $($name),* } = value.ok_or(DecodeError::Missing { field })?;
                Ok([$($name),*])
            }

            fn validated(self, field: &'static str) -> Result<Self, DecodeError> {
                self.iter().try_for_each(|number| number.validated(field).map(drop))?;
                if $count == 4 { check_unit(self, field) } else { Ok(self) }
            }
        }
    };
}

vector_fields!(Complex { re, im } of 2);
vector_fields!(Vector3 { x, y, z } of 3);
vector_fields!(Quaternion { w, x, y, z } of 4);

fn check_unit<const N: usize>(quaternion: [f64; N], field: &'static str) -> Result<[f64; N], DecodeError> {
    let norm = quaternion.iter().map(|x| x * x).sum::<f64>().sqrt();
    if (norm - 1.0).abs() <= NORM_TOLERANCE {
        return Ok(quaternion);
    }
    Err(DecodeError::OutOfRange {
        field,
        value: format!("a quaternion of norm {norm}"),
        expected: "norm 1 within 1e-6",
    })
}

impl Field<u64> for Flags {
    fn to_proto(self) -> u64 {
        self.0
    }

    fn from_proto(value: u64, _: &'static str) -> Result<Self, DecodeError> {
        Ok(Self(value))
    }
}

/// Converts an on-board index to an enum value of the schema. Indices start at 0, but enum values
/// start at 1, because the schema reserves 0 for "unspecified".
fn enum_to_proto(index: u64, last: i32) -> i32 {
    i32::try_from(index).ok().and_then(|index| index.checked_add(1)).filter(|value| *value <= last).unwrap_or(0)
}

fn enum_from_proto(value: i32, last: i32, field: &'static str) -> Result<u64, DecodeError> {
    let index = u64::try_from(value).ok().filter(|_| value <= last).and_then(|value| value.checked_sub(1));
    index.ok_or_else(|| DecodeError::OutOfRange { field, value: value.to_string(), expected: "a value of the enum" })
}

macro_rules! enum_fields {
    ($($kind:ident($inner:ty) up to $last:expr),*) => { $(impl Field<i32> for $kind {
        fn to_proto(self) -> i32 { enum_to_proto(self.0.into(), $last as i32) }
        fn from_proto(value: i32, field: &'static str) -> Result<Self, DecodeError> {
            Ok(Self(enum_from_proto(value, $last as i32, field)? as $inner))
        }
    })* };
}

enum_fields!(
    Chart(u64) up to v1::Chart::Inverted,
    CourseReference(u64) up to v1::CourseReference::True,
    State(u32) up to v1::State::Finished
);

/// Event kinds are already numbered from 1 on board, so the value is the same in the schema.
impl Field<i32> for EventKind {
    fn to_proto(self) -> i32 {
        i32::try_from(self.0).ok().filter(|kind| *kind <= v1::EventKind::Finished as i32).unwrap_or(0)
    }

    fn from_proto(value: i32, field: &'static str) -> Result<Self, DecodeError> {
        Ok(Self(enum_from_proto(value, v1::EventKind::Finished as i32, field)? as u32 + 1))
    }
}

/// Enum value of the last service.
const LAST_SERVICE: i32 = Service::ALL.len() as i32;

/// Index of a service, which is an enum value in the schema.
impl Field<i32> for u32 {
    fn to_proto(self) -> i32 {
        enum_to_proto(self.into(), LAST_SERVICE)
    }

    fn from_proto(value: i32, field: &'static str) -> Result<Self, DecodeError> {
        Ok(enum_from_proto(value, LAST_SERVICE, field)? as Self)
    }
}

impl Field<Option<v1::Header>> for Header {
    fn to_proto(self) -> Option<v1::Header> {
        let Self { tick, t_start_ns, t_end_ns, t_born_ns, t_sent_ns, lost_upstream, flags, epoch, incarnation } = self;
        let flags = flags.to_proto();
        Some(v1::Header { tick, t_start_ns, t_end_ns, t_born_ns, t_sent_ns, lost_upstream, flags, epoch, incarnation })
    }

    fn from_proto(value: Option<v1::Header>, field: &'static str) -> Result<Self, DecodeError> {
        let v1::Header { tick, t_start_ns, t_end_ns, t_born_ns, t_sent_ns, lost_upstream, flags, epoch, incarnation } =
            value.ok_or(DecodeError::Missing { field })?;
        let flags = Flags(flags);
        Ok(Self { tick, t_start_ns, t_end_ns, t_born_ns, t_sent_ns, lost_upstream, flags, epoch, incarnation })
    }

    fn validated(self, _: &'static str) -> Result<Self, DecodeError> {
        if self.t_end_ns >= self.t_start_ns {
            return Ok(self);
        }
        let value = self.t_end_ns.to_string();
        Err(DecodeError::OutOfRange { field: "t_end_ns", value, expected: "t_start_ns or later" })
    }
}
