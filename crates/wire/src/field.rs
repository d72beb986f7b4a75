//! A field of a payload as a field of the schema, and back.

use messages::{Chart, CourseReference, EventKind, Flags, Header, State};

use crate::{
    Refusal,
    v1::{self, Complex, Quaternion, Vector3},
};

/// A unit quaternion's length may differ from 1 by this: sixteen digits and the sums of a long flight are far better.
const NORM_TOLERANCE: f64 = 1e-6;

/// A field of a payload whose form in the schema is `P`.
pub(crate) trait Field<P>: Sized {
    fn put(self) -> P;
    fn take(form: P, field: &'static str) -> Result<Self, Refusal>;
    /// Refuses what a checked message cannot hold.
    fn checked(self, _field: &'static str) -> Result<Self, Refusal> {
        Ok(self)
    }
}

macro_rules! as_it_is {
    ($($kind:ty),*) => { $(impl Field<$kind> for $kind {
        fn put(self) -> $kind { self }
        fn take(form: $kind, _: &'static str) -> Result<Self, Refusal> { Ok(form) }
    })* };
}

as_it_is!(u32, u64, i64);

impl Field<f64> for f64 {
    fn put(self) -> f64 {
        self
    }

    fn take(form: f64, _: &'static str) -> Result<Self, Refusal> {
        Ok(form)
    }

    fn checked(self, field: &'static str) -> Result<Self, Refusal> {
        if self.is_finite() { Ok(self) } else { Err(Refusal::NotFinite { field }) }
    }
}

macro_rules! numbers {
    ($form:ident { $($name:ident),* } of $count:literal) => {
        impl Field<Option<$form>> for [f64; $count] {
            fn put(self) -> Option<$form> {
                let [$($name),*] = self;
                Some($form { $($name),* })
            }

            fn take(form: Option<$form>, field: &'static str) -> Result<Self, Refusal> {
                let $form { $($name),* } = form.ok_or(Refusal::Missing { field })?;
                Ok([$($name),*])
            }

            fn checked(self, field: &'static str) -> Result<Self, Refusal> {
                self.iter().try_for_each(|number| number.checked(field).map(drop))?;
                if $count == 4 { unit(self, field) } else { Ok(self) }
            }
        }
    };
}

numbers!(Complex { re, im } of 2);
numbers!(Vector3 { x, y, z } of 3);
numbers!(Quaternion { w, x, y, z } of 4);

fn unit<const N: usize>(quaternion: [f64; N], field: &'static str) -> Result<[f64; N], Refusal> {
    let norm = quaternion.iter().map(|x| x * x).sum::<f64>().sqrt();
    if (norm - 1.0).abs() <= NORM_TOLERANCE {
        return Ok(quaternion);
    }
    Err(Refusal::OutOfRange { field, value: format!("of the length {norm}"), expected: "a unit quaternion" })
}

impl Field<u64> for Flags {
    fn put(self) -> u64 {
        self.0
    }

    fn take(form: u64, _: &'static str) -> Result<Self, Refusal> {
        Ok(Self(form))
    }
}

/// What is named by its place from 0 on board is named by its place from 1 in the schema, where 0 is nothing said.
fn place_put(place: u64, last: i32) -> i32 {
    i32::try_from(place).ok().and_then(|place| place.checked_add(1)).filter(|place| *place <= last).unwrap_or(0)
}

fn place_taken(form: i32, last: i32, field: &'static str) -> Result<u64, Refusal> {
    let place = u64::try_from(form).ok().filter(|_| form <= last).and_then(|place| place.checked_sub(1));
    place.ok_or_else(|| Refusal::OutOfRange {
        field,
        value: form.to_string(),
        expected: "one of the names of the schema",
    })
}

macro_rules! named {
    ($($kind:ident($inner:ty) up to $last:expr),*) => { $(impl Field<i32> for $kind {
        fn put(self) -> i32 { place_put(self.0.into(), $last as i32) }
        fn take(form: i32, field: &'static str) -> Result<Self, Refusal> {
            Ok(Self(place_taken(form, $last as i32, field)? as $inner))
        }
    })* };
}

named!(
    Chart(u64) up to v1::Chart::Inverted,
    CourseReference(u64) up to v1::CourseReference::True,
    State(u32) up to v1::State::Finished
);

/// It has no name for 0 on board, either.
impl Field<i32> for EventKind {
    fn put(self) -> i32 {
        i32::try_from(self.0).ok().filter(|kind| *kind <= v1::EventKind::Finished as i32).unwrap_or(0)
    }

    fn take(form: i32, field: &'static str) -> Result<Self, Refusal> {
        Ok(Self(place_taken(form, v1::EventKind::Finished as i32, field)? as u32 + 1))
    }
}

/// A service.
impl Field<i32> for u32 {
    fn put(self) -> i32 {
        place_put(self.into(), v1::Service::Cockpit as i32)
    }

    fn take(form: i32, field: &'static str) -> Result<Self, Refusal> {
        Ok(place_taken(form, v1::Service::Cockpit as i32, field)? as Self)
    }
}

impl Field<Option<v1::Header>> for Header {
    fn put(self) -> Option<v1::Header> {
        let Self { tick, t_start_ns, t_end_ns, t_born_ns, t_sent_ns, lost_upstream, flags, epoch, incarnation } = self;
        let flags = flags.put();
        Some(v1::Header { tick, t_start_ns, t_end_ns, t_born_ns, t_sent_ns, lost_upstream, flags, epoch, incarnation })
    }

    fn take(form: Option<v1::Header>, field: &'static str) -> Result<Self, Refusal> {
        let v1::Header { tick, t_start_ns, t_end_ns, t_born_ns, t_sent_ns, lost_upstream, flags, epoch, incarnation } =
            form.ok_or(Refusal::Missing { field })?;
        let flags = Flags(flags);
        Ok(Self { tick, t_start_ns, t_end_ns, t_born_ns, t_sent_ns, lost_upstream, flags, epoch, incarnation })
    }

    fn checked(self, _: &'static str) -> Result<Self, Refusal> {
        if self.t_end_ns >= self.t_start_ns {
            return Ok(self);
        }
        let value = format!("{} before the interval's start", self.t_end_ns);
        Err(Refusal::OutOfRange { field: "t_end_ns", value, expected: "a time after t_start_ns" })
    }
}
