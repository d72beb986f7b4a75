//! The contract of a stage: a plain value that turns one tick's input into one output.
//!
//! Input: what its slot offers at a tick. Output: exactly one value per step, finite for finite input. Time: a stage reads no
//! clock; its output is a function of its configuration and its inputs. Failure: a state it is given is checked before it is used.

use core::fmt;

use crate::{
    Vector3,
    numbers::Numbers,
    parameters::{Parameter, ParameterError},
    state::Attitude,
};

/// What a stage gives at a tick, as it must be.
pub trait Sound {
    /// What is wrong with it: a number that is not finite, a rotation that is none.
    fn flaw(&self) -> Option<&'static str>;
}

/// By how much the square of a length of 1 may differ from 1.
pub const UNIT: f64 = 1e-6;

/// Numbers a state may have at most.
pub const STATE_LIMIT: usize = 1536;

/// An estimator that can fill a slot.
pub trait Stage {
    /// What the slot offers at a tick.
    type Input;
    /// What the slot publishes.
    type Output;
    /// What every stage of the slot can take over from every other.
    type Common: Copy;

    /// The name by which it is chosen.
    fn name(&self) -> &'static str;

    /// The stages it consists of, where it runs others.
    fn parts(&self) -> &'static [&'static str] {
        &[]
    }

    /// The numbers by which it can be set.
    fn parameters(&self) -> &'static [Parameter] {
        &[]
    }

    /// Sets one of them; before the first step.
    fn set(&mut self, _name: &str, _value: f64) -> Result<(), ParameterError> {
        Err(ParameterError::Unknown { known: self.parameters() })
    }

    /// One tick.
    fn step(&mut self, input: &Self::Input) -> Self::Output;

    /// Hands every number of the state to `visit`, always in the same order.
    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64));

    /// What is wrong with a state of finite numbers: a length that is not 1, a variance below zero.
    fn flaw(&self) -> Option<&'static str> {
        None
    }

    /// The part of the state that another stage of the slot can go on with.
    fn common(&self) -> Self::Common;

    /// Goes on from where another stage of the slot was; what cannot be taken over leaves the stage as it was.
    fn adopt(&mut self, common: &Self::Common) -> Result<(), RestoreError>;

    /// Why the stage cannot go on, if it cannot: what it gives from then on means nothing. A stage in this process always can.
    fn failure(&self) -> Option<&dyn core::error::Error> {
        None
    }

    /// The state as a record.
    fn snapshot(&self) -> Snapshot
    where
        Self: Clone,
    {
        let mut record = Snapshot { stage: self.name(), values: [0.0; STATE_LIMIT], len: 0, checksum: 0 };
        self.clone().visit_state(&mut |value| {
            record.values[record.len] = *value;
            record.len += 1;
        });
        record.checksum = record.sum();
        record
    }

    /// Takes over a recorded state; a record that does not fit leaves the stage as it was.
    fn restore(&mut self, record: &Snapshot) -> Result<(), RestoreError>
    where
        Self: Clone,
    {
        record.check(self.name(), self.snapshot().len)?;
        let mut restored = self.clone();
        let mut index = 0;
        restored.visit_state(&mut |value| {
            *value = record.values[index];
            index += 1;
        });
        if let Some(flaw) = restored.flaw() {
            return Err(RestoreError::Flaw { flaw });
        }
        *self = restored;
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
    /// Of the values, so that a record that was damaged on its way is known.
    pub checksum: u64,
}

impl Snapshot {
    /// FNV-1a over the bits of the values.
    pub fn sum(&self) -> u64 {
        self.values[..self.len]
            .iter()
            .flat_map(|value| value.to_bits().to_le_bytes())
            .fold(0xcbf2_9ce4_8422_2325, |sum, byte| (sum ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3))
    }

    /// Refuses what no stage of that name with so many numbers has recorded.
    pub fn check(&self, stage: &'static str, expected: usize) -> Result<(), RestoreError> {
        if self.stage != stage {
            return Err(RestoreError::OtherStage { expected: stage, found: self.stage });
        }
        if self.len != expected {
            return Err(RestoreError::OtherLength { expected, found: self.len });
        }
        if let Some(index) = self.values[..self.len].iter().position(|value| !value.is_finite()) {
            return Err(RestoreError::NotFinite { index });
        }
        if self.checksum != self.sum() { Err(RestoreError::Corrupt) } else { Ok(()) }
    }
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
    /// The values are not those that were recorded.
    Corrupt,
    /// The values are finite and yet no state of this stage.
    Flaw {
        /// What is wrong.
        flaw: &'static str,
    },
}

impl fmt::Display for RestoreError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "restoring a stage's state: ")?;
        match self {
            Self::OtherStage { expected, found } => write!(f, "a record of {found}, this is {expected}"),
            Self::OtherLength { expected, found } => write!(f, "{found} values, expected {expected}"),
            Self::NotFinite { index } => write!(f, "value {index} is not finite"),
            Self::Corrupt => write!(f, "the checksum does not fit the values"),
            Self::Flaw { flaw } => write!(f, "{flaw}"),
        }
    }
}

impl core::error::Error for RestoreError {}

impl Attitude {
    /// Refuses what is not an attitude.
    pub fn checked(&self) -> Result<(), RestoreError> {
        let mut index = 0;
        let mut bad = None;
        { *self }.visit(&mut |value| {
            bad = bad.or((!value.is_finite()).then_some(index));
            index += 1;
        });
        if let Some(index) = bad {
            return Err(RestoreError::NotFinite { index });
        }
        attitude_flaw(*self).map_or(Ok(()), |flaw| Err(RestoreError::Flaw { flaw }))
    }
}

/// What is wrong with an attitude; one that is not a number is in no chart.
pub fn attitude_flaw(attitude: Attitude) -> Option<&'static str> {
    let inside = attitude.up.w.norm_sqr() <= 2.0 && attitude.z_rad.abs() <= 4.0;
    (!inside).then_some("an attitude outside its chart")
}

/// What is wrong with a gyro bias of finite numbers.
pub fn bias_flaw(bias_rad_s: Vector3<f64>) -> Option<&'static str> {
    (bias_rad_s.amax() > 10.0).then_some("a gyro bias above 10 rad/s")
}
