//! The contract of a stage: a plain value that turns one tick's input into one output.
//!
//! Input: what its slot offers at a tick. Output: exactly one value per step, finite for finite input. Time: a stage reads no
//! clock; its output is a function of its configuration and its inputs. Failure: a state it is given is checked before it is used.

use core::fmt;

use crate::{
    Complex, Vector3,
    point::{Chart, Point},
    state::Attitude,
};

/// Numbers a state may have at most.
pub const STATE_LIMIT: usize = 96;

/// An estimator that can fill a slot.
pub trait Stage {
    /// What the slot offers at a tick.
    type Input;
    /// What the slot publishes.
    type Output;

    /// The name by which it is chosen.
    fn name(&self) -> &'static str;

    /// One tick.
    fn step(&mut self, input: &Self::Input) -> Self::Output;

    /// Hands every number of the state to `visit`, always in the same order.
    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64));

    /// The state as a record.
    fn snapshot(&self) -> Snapshot
    where
        Self: Clone,
    {
        let mut record = Snapshot { stage: self.name(), values: [0.0; STATE_LIMIT], len: 0 };
        self.clone().visit_state(&mut |value| {
            record.values[record.len] = *value;
            record.len += 1;
        });
        record
    }

    /// Takes over a recorded state; a record that does not fit leaves the stage as it was.
    fn restore(&mut self, record: &Snapshot) -> Result<(), RestoreError>
    where
        Self: Clone,
    {
        if record.stage != self.name() {
            return Err(RestoreError::OtherStage { expected: self.name(), found: record.stage });
        }
        let expected = self.snapshot().len;
        if record.len != expected {
            return Err(RestoreError::OtherLength { expected, found: record.len });
        }
        if let Some(index) = record.values[..record.len].iter().position(|value| !value.is_finite()) {
            return Err(RestoreError::NotFinite { index });
        }
        let mut index = 0;
        self.visit_state(&mut |value| {
            *value = record.values[index];
            index += 1;
        });
        Ok(())
    }
}

/// The state of a stage at one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Snapshot {
    /// The stage it belongs to.
    pub stage: &'static str,
    /// The numbers of the state; those from `len` on are zero.
    pub values: [f64; STATE_LIMIT],
    /// How many of them there are.
    pub len: usize,
}

/// Why a recorded state was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RestoreError {
    /// It was recorded by another stage.
    OtherStage {
        /// The stage that was to take it over.
        expected: &'static str,
        /// The stage that recorded it.
        found: &'static str,
    },
    /// It has another number of values.
    OtherLength {
        /// Numbers in the state of this stage.
        expected: usize,
        /// Numbers in the record.
        found: usize,
    },
    /// A value is infinite or not a number.
    NotFinite {
        /// Which one.
        index: usize,
    },
}

impl fmt::Display for RestoreError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "restoring a stage's state: ")?;
        match self {
            Self::OtherStage { expected, found } => write!(f, "a record of {found}, this is {expected}"),
            Self::OtherLength { expected, found } => write!(f, "{found} values, expected {expected}"),
            Self::NotFinite { index } => write!(f, "value {index} is not finite"),
        }
    }
}

impl core::error::Error for RestoreError {}

/// Something made of numbers that a snapshot holds.
pub(crate) trait Numbers {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64));
}

impl Numbers for f64 {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        visit(self);
    }
}

impl Numbers for bool {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let mut value = f64::from(u8::from(*self));
        visit(&mut value);
        *self = value > 0.5;
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

impl Numbers for Attitude {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.up.visit(visit);
        self.z_rad.visit(visit);
    }
}

impl Numbers for Point {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let mut inverted = self.chart == Chart::Inverted;
        inverted.visit(visit);
        self.chart = if inverted { Chart::Inverted } else { Chart::Upright };
        self.w.visit(visit);
    }
}
