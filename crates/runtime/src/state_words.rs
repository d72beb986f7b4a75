//! The state of a slot as words: every number as its bits, in one order.
//!
//! Input, output: plain values. Time: none. Failure: a word that is not one of a value's is refused by the slot that takes it over.

use attitude::{
    Quaternion, Vector3,
    course::{Bearing, LastReading, Reference},
    fuser::Estimate,
    point::{Chart, Point},
    state::Attitude,
};

use swap::Sequence;

/// Hands every word of a value to `visit`, always in the same order.
pub trait Words {
    /// Reads or replaces each word.
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64));
}

impl Words for u64 {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        visit(self);
    }
}

impl Words for u32 {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        let mut word = u64::from(*self);
        visit(&mut word);
        *self = u32::try_from(word).unwrap_or(Self::MAX);
    }
}

impl Words for i64 {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        let mut word = self.cast_unsigned();
        visit(&mut word);
        *self = word.cast_signed();
    }
}

impl Words for f64 {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        let mut word = self.to_bits();
        visit(&mut word);
        *self = Self::from_bits(word);
    }
}

impl Words for bool {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        let mut word = u64::from(*self);
        visit(&mut word);
        *self = word != 0;
    }
}

impl<T: Words, const N: usize> Words for [T; N] {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.iter_mut().for_each(|value| value.visit(visit));
    }
}

impl<T: Words + Default> Words for Option<T> {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        let mut some = self.is_some();
        some.visit(visit);
        let mut value = self.take().unwrap_or_default();
        value.visit(visit);
        *self = some.then_some(value);
    }
}

impl<A: Words, B: Words> Words for (A, B) {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.0.visit(visit);
        self.1.visit(visit);
    }
}

impl Words for Sequence {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        // The sender is not part of it: whoever goes on reads from the beginning of what there is.
        let Self { next_tick, ticks, lost, duplicated, repeated, sender: _ } = self;
        [next_tick, ticks, lost, duplicated, repeated].into_iter().for_each(visit);
    }
}

impl Words for Attitude {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.up.visit(visit);
        self.z_rad.visit(visit);
    }
}

impl Words for Point {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        let mut inverted = self.chart == Chart::Inverted;
        inverted.visit(visit);
        self.chart = if inverted { Chart::Inverted } else { Chart::Upright };
        self.w.re.visit(visit);
        self.w.im.visit(visit);
    }
}

impl Words for Vector3<f64> {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.iter_mut().for_each(|value| value.visit(visit));
    }
}

impl Words for Quaternion<f64> {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.coords.iter_mut().for_each(|value| value.visit(visit));
    }
}

impl Words for Reference {
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

impl Words for Estimate {
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

impl Words for LastReading {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.quaternion.visit(visit);
        let Bearing { mut course_rad, mut sd_rad, mut reference } =
            self.bearing.unwrap_or(Bearing { course_rad: 0.0, sd_rad: 0.0, reference: Reference::Arbitrary });
        let mut some = self.bearing.is_some();
        some.visit(visit);
        course_rad.visit(visit);
        sd_rad.visit(visit);
        reference.visit(visit);
        self.bearing = some.then_some(Bearing { course_rad, sd_rad, reference });
    }
}
