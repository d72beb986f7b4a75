//! State of a slot as 64-bit words: the bits of each number, in a fixed order.
//!
//! - Input, output: plain values.
//! - Failure: conversion never fails. The slot validates restored values.

use crate::{
    Quaternion, Vector3,
    course::{CourseEstimate, CourseReference, LastReading},
    fuser::Estimate,
    point::{Chart, Point},
    state::Attitude,
};

/// Value with a state that can be read and replaced word by word.
pub trait StateWords {
    /// Calls `visit` with each word, always in the same order. `visit` may replace the word.
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64));
}

impl StateWords for u64 {
    #[inline]
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        visit(self);
    }
}

impl StateWords for u32 {
    #[inline]
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        let mut word = u64::from(*self);
        visit(&mut word);
        *self = u32::try_from(word).unwrap_or(Self::MAX);
    }
}

impl StateWords for i64 {
    #[inline]
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        let mut word = self.cast_unsigned();
        visit(&mut word);
        *self = word.cast_signed();
    }
}

impl StateWords for f64 {
    #[inline]
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        let mut word = self.to_bits();
        visit(&mut word);
        *self = Self::from_bits(word);
    }
}

impl StateWords for bool {
    #[inline]
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        let mut word = u64::from(*self);
        visit(&mut word);
        *self = word != 0;
    }
}

impl<T: StateWords, const N: usize> StateWords for [T; N] {
    #[inline]
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.iter_mut().for_each(|value| value.visit(visit));
    }
}

impl<T: StateWords + Default> StateWords for Option<T> {
    #[inline]
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        let mut some = self.is_some();
        some.visit(visit);
        let mut value = self.take().unwrap_or_default();
        value.visit(visit);
        *self = some.then_some(value);
    }
}

impl<A: StateWords, B: StateWords> StateWords for (A, B) {
    #[inline]
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.0.visit(visit);
        self.1.visit(visit);
    }
}

impl StateWords for Attitude {
    #[inline]
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.up.visit(visit);
        self.z_rad.visit(visit);
    }
}

impl StateWords for Point {
    #[inline]
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        let mut inverted = self.chart == Chart::Inverted;
        inverted.visit(visit);
        self.chart = if inverted { Chart::Inverted } else { Chart::Upright };
        self.w.re.visit(visit);
        self.w.im.visit(visit);
    }
}

impl StateWords for Vector3<f64> {
    #[inline]
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.iter_mut().for_each(|value| value.visit(visit));
    }
}

impl StateWords for Quaternion<f64> {
    #[inline]
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.coords.iter_mut().for_each(|value| value.visit(visit));
    }
}

impl StateWords for CourseReference {
    #[inline]
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        let mut word = match self {
            Self::Arbitrary => 0,
            Self::Magnetic => 1,
            Self::True => 2,
        };
        visit(&mut word);
        *self = match word {
            1 => Self::Magnetic,
            2 => Self::True,
            _ => Self::Arbitrary,
        };
    }
}

impl StateWords for Estimate {
    #[inline]
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.attitude.visit(visit);
        self.reference.visit(visit);
        self.bias_rad_s.visit(visit);
        let Self { inclination_sd_rad, heading_sd_rad, bias_sd_rad_s, gyro_scale, hard_iron, leaky_velocity, .. } =
            self;
        [inclination_sd_rad, heading_sd_rad, bias_sd_rad_s].into_iter().for_each(|value| value.visit(visit));
        gyro_scale.error.visit(visit);
        gyro_scale.sd.visit(visit);
        hard_iron.field_ut.visit(visit);
        hard_iron.sd_ut.visit(visit);
        leaky_velocity.velocity_m_s.re.visit(visit);
        leaky_velocity.velocity_m_s.im.visit(visit);
        leaky_velocity.sd_m_s.visit(visit);
    }
}

impl StateWords for LastReading {
    #[inline]
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.quaternion.visit(visit);
        let CourseEstimate { mut course_rad, mut sd_rad, mut reference } = self.course.unwrap_or(CourseEstimate {
            course_rad: 0.0,
            sd_rad: 0.0,
            reference: CourseReference::Arbitrary,
        });
        let mut some = self.course.is_some();
        some.visit(visit);
        course_rad.visit(visit);
        sd_rad.visit(visit);
        reference.visit(visit);
        self.course = some.then_some(CourseEstimate { course_rad, sd_rad, reference });
    }
}
