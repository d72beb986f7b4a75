//! A value as the numbers it is made of, always in the same order: what a snapshot holds, and what a stage in another process is sent.
//!
//! Input, output: a value. Time: none. Failure: none here; whoever takes numbers over checks what they make.

use crate::{Complex, Quaternion, Vector3};

/// Something made of numbers.
pub trait Numbers {
    /// Hands each number to `visit`, which reads or replaces it.
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64));
}

impl Numbers for f64 {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        visit(self);
    }
}

/// 0 or 1.
impl Numbers for bool {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let mut value = f64::from(u8::from(*self));
        visit(&mut value);
        *self = value > 0.5;
    }
}

/// Whether it is there, then its numbers; zeros or the like where it is not.
impl<T: Numbers + Default> Numbers for Option<T> {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let mut there = self.is_some();
        there.visit(visit);
        let mut value = self.take().unwrap_or_default();
        value.visit(visit);
        *self = there.then_some(value);
    }
}

impl Numbers for Complex<f64> {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        visit(&mut self.re);
        visit(&mut self.im);
    }
}

impl Numbers for Vector3<f64> {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.iter_mut().for_each(visit);
    }
}

/// i, j, k, w.
impl Numbers for Quaternion<f64> {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.coords.iter_mut().for_each(visit);
    }
}
