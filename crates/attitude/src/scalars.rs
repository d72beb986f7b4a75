//! Traversal of the numbers that make up a value, always in the same order.
//!
//! Snapshots consist of these numbers. The same numbers are sent to a stage in another process.
//!
//! Failure: code that restores numbers must validate the resulting value.

use crate::{Complex, Quaternion, Vector3};

/// Value that consists of numbers.
pub trait Scalars {
    /// Passes each number to `visit`, which reads or replaces it.
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64));
}

/// Returns `true` if all numbers are finite.
///
/// A finite number times zero is zero. For infinity and NaN the product is NaN. The sum needs fewer
/// instructions than a comparison of each number.
#[inline]
pub(crate) fn are_finite<const COUNT: usize>(numbers: [f64; COUNT]) -> bool {
    numbers.into_iter().fold(0.0, |sum, number| sum + number * 0.0) == 0.0
}

/// Visits struct fields of `self` in the given order. Fields after `without` hold no state.
///
/// A field that is in neither list causes a compile error, so that no part of a state is forgotten.
macro_rules! visit_fields {
    ($self:ident, $visit:ident: $($field:ident),+ $(; without $($other:ident),+)?) => {
        let Self { $($field,)+ $($($other: _,)+)? } = $self;
        $($crate::scalars::Scalars::visit($field, $visit);)+
    };
}
pub(crate) use visit_fields;

/// Implements [`Scalars`] for a struct, with the fields of `visit_fields`.
macro_rules! scalars {
    ($Type:ident: $($fields:tt)+) => {
        impl $crate::scalars::Scalars for $Type {
            fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
                $crate::scalars::visit_fields!(self, visit: $($fields)+);
            }
        }
    };
}
pub(crate) use scalars;

impl Scalars for f64 {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        visit(self);
    }
}

/// Visits the value as 0 or 1.
impl Scalars for bool {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let mut value = f64::from(u8::from(*self));
        visit(&mut value);
        *self = value > 0.5;
    }
}

/// Visits a presence flag, then the numbers of the value, or those of the default value for `None`.
impl<T: Scalars + Default> Scalars for Option<T> {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let mut present = self.is_some();
        present.visit(visit);
        let mut value = self.take().unwrap_or_default();
        value.visit(visit);
        *self = present.then_some(value);
    }
}

impl<T: Scalars, const N: usize> Scalars for [T; N] {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.iter_mut().for_each(|value| value.visit(visit));
    }
}

impl Scalars for Complex<f64> {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        visit(&mut self.re);
        visit(&mut self.im);
    }
}

impl Scalars for Vector3<f64> {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.iter_mut().for_each(visit);
    }
}

/// Visits the components in the order i, j, k, w.
impl Scalars for Quaternion<f64> {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.coords.iter_mut().for_each(visit);
    }
}
