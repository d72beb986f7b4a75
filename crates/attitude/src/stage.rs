//! Contract of a stage: a plain value that computes one output from the input of one tick.
//!
//! Input: the input of the slot at a tick.
//!
//! Output: exactly one value per step, finite for finite input.
//!
//! Time: a stage reads no clock. Its output depends only on its configuration and its inputs.
//!
//! Failure: a state is validated before it is restored or adopted.

use core::fmt;

use crate::{
    Vector3,
    parameters::{Parameter, ParameterError},
    scalars::Scalars,
    state::Attitude,
};

/// Validation of a stage's output.
pub trait Validate {
    /// Returns the reason why the value is invalid, or `None` if it is valid.
    ///
    /// A value is invalid if a number is not finite or a rotation does not have unit length.
    fn validation_error(&self) -> Option<&'static str>;
}

/// Tolerance on the squared norm of a unit quaternion or unit vector.
pub const UNIT_NORM_SQUARED_TOLERANCE: f64 = 1e-6;

/// Maximum number of values in the state of a stage.
pub const MAX_STATE_VALUES: usize = 1536;

/// Estimator that can fill a slot.
pub trait Stage {
    /// Input of the slot at a tick.
    type Input;
    /// Output that the slot publishes.
    type Output;
    /// State that any stage of the slot can hand over to any other.
    type Common: Copy;

    /// Returns the name that selects the stage in a launch file or a swap request.
    fn name(&self) -> &'static str;

    /// Returns the names of the stages that this stage runs internally.
    fn parts(&self) -> &'static [&'static str] {
        &[]
    }

    /// Returns the adjustable parameters.
    fn parameters(&self) -> &'static [Parameter] {
        &[]
    }

    /// Sets a parameter. Call it before the first step.
    ///
    /// # Errors
    ///
    /// Returns a [`ParameterError`] if the stage has no parameter of that name or the value is out
    /// of range. The stage is then unchanged.
    fn set(&mut self, _name: &str, _value: f64) -> Result<(), ParameterError> {
        Err(ParameterError::Unknown { known: self.parameters() })
    }

    /// Processes the input of one tick.
    fn step(&mut self, input: &Self::Input) -> Self::Output;

    /// Visits every number of the state, always in the same order.
    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64));

    /// Returns the reason why a state of finite numbers is invalid, or `None` if it is valid.
    ///
    /// A negative variance, for example, makes a state invalid.
    fn validation_error(&self) -> Option<&'static str> {
        None
    }

    /// Returns the part of the state that another stage of the slot can adopt.
    fn common(&self) -> Self::Common;

    /// Continues from the state of another stage of the slot.
    ///
    /// # Errors
    ///
    /// Returns a [`RestoreError`] if the state is invalid. The stage is then unchanged.
    fn adopt(&mut self, common: &Self::Common) -> Result<(), RestoreError>;

    /// Returns the error if the stage has failed permanently. Its outputs are then meaningless.
    ///
    /// Only stages in a separate process can fail.
    fn failure(&self) -> Option<&dyn core::error::Error> {
        None
    }

    /// Visits the value of every number of the state, in the order of
    /// [`visit_state`](Self::visit_state).
    fn visit_values(&self, visit: &mut dyn FnMut(f64))
    where
        Self: Clone,
    {
        self.clone().visit_state(&mut |value| visit(*value));
    }

    /// Returns a snapshot of the state.
    fn snapshot(&self) -> Snapshot
    where
        Self: Clone,
    {
        let mut record = Snapshot { stage: self.name(), values: [0.0; MAX_STATE_VALUES], len: 0, checksum: 0 };
        self.visit_values(&mut |value| {
            record.values[record.len] = value;
            record.len += 1;
        });
        record.checksum = record.compute_checksum();
        record
    }

    /// Restores the state from a snapshot.
    ///
    /// # Errors
    ///
    /// Returns a [`RestoreError`] if the snapshot belongs to another stage, is corrupt or holds an
    /// invalid state. The stage is then unchanged.
    fn restore(&mut self, record: &Snapshot) -> Result<(), RestoreError>
    where
        Self: Clone,
    {
        record.validate(self.name(), self.snapshot().len)?;
        let mut restored = self.clone();
        let mut index = 0;
        restored.visit_state(&mut |value| {
            *value = record.values[index];
            index += 1;
        });
        if let Some(flaw) = restored.validation_error() {
            return Err(RestoreError::Invalid { reason: flaw });
        }
        *self = restored;
        Ok(())
    }
}

/// Implements the methods of [`Stage`] that have no default, and those that describe a stage, by
/// calling the same method of the stage that an enum holds.
///
/// `$each` is a macro that matches on the enum: `$each!(value, stage => expression)`. The attribute
/// is that of [`step`](Stage::step).
#[doc(hidden)]
#[macro_export]
macro_rules! forward_stage {
    ($each:ident $(, #[$step_attribute:meta])?) => {
        fn name(&self) -> &'static str {
            $each!(self, stage => stage.name())
        }

        fn parts(&self) -> &'static [&'static str] {
            $each!(self, stage => stage.parts())
        }

        fn parameters(&self) -> &'static [$crate::parameters::Parameter] {
            $each!(self, stage => stage.parameters())
        }

        fn set(&mut self, name: &str, value: f64) -> Result<(), $crate::parameters::ParameterError> {
            $each!(self, stage => stage.set(name, value))
        }

        $(#[$step_attribute])?
        fn step(&mut self, input: &Self::Input) -> Self::Output {
            $each!(self, stage => stage.step(input))
        }

        fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
            $each!(self, stage => stage.visit_state(visit));
        }

        fn validation_error(&self) -> Option<&'static str> {
            $each!(self, stage => stage.validation_error())
        }

        fn common(&self) -> Self::Common {
            $each!(self, stage => stage.common())
        }

        fn adopt(&mut self, common: &Self::Common) -> Result<(), $crate::stage::RestoreError> {
            $each!(self, stage => stage.adopt(common))
        }
    };
}

pub use forward_stage;

/// State of a stage at one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Snapshot {
    /// Name of the stage that wrote the snapshot.
    pub stage: &'static str,
    /// Values of the state. Entries from index `len` onwards are zero.
    pub values: [f64; MAX_STATE_VALUES],
    /// Number of values in use.
    pub len: usize,
    /// Checksum of the values, to detect corruption in transit.
    pub checksum: u64,
}

impl Snapshot {
    /// Computes the FNV-1a hash over the bits of the values.
    pub fn compute_checksum(&self) -> u64 {
        self.values[..self.len]
            .iter()
            .flat_map(|value| value.to_bits().to_le_bytes())
            .fold(0xcbf2_9ce4_8422_2325, |sum, byte| (sum ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3))
    }

    /// Checks that the snapshot was written by `stage`, has `expected` values and is intact.
    ///
    /// # Errors
    ///
    /// Returns a [`RestoreError`] if the stage or the number of values differs, a value is not
    /// finite or the checksum is wrong.
    pub fn validate(&self, stage: &'static str, expected: usize) -> Result<(), RestoreError> {
        if self.stage != stage {
            return Err(RestoreError::OtherStage { expected: stage, found: self.stage });
        }
        if self.len != expected {
            return Err(RestoreError::OtherLength { expected, found: self.len });
        }
        if let Some(index) = self.values[..self.len].iter().position(|value| !value.is_finite()) {
            return Err(RestoreError::NotFinite { index });
        }
        if self.checksum != self.compute_checksum() { Err(RestoreError::Corrupt) } else { Ok(()) }
    }
}

/// Error of [`Stage::restore`], [`Stage::adopt`] or [`Attitude::validate`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RestoreError {
    /// The state belongs to another stage.
    OtherStage {
        /// Name of the restoring stage.
        expected: &'static str,
        /// Name of the stage that wrote the snapshot.
        found: &'static str,
    },
    /// The number of values differs from that of the stage's state.
    OtherLength {
        /// Number of values in the state of the stage.
        expected: usize,
        /// Number of values in the snapshot.
        found: usize,
    },
    /// A value is infinite or NaN.
    NotFinite {
        /// Index of the first such value.
        index: usize,
    },
    /// The checksum does not match the values.
    Corrupt,
    /// The values are finite but are not a valid state of the stage.
    Invalid {
        /// Validation error of the stage.
        reason: &'static str,
    },
}

impl fmt::Display for RestoreError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "cannot restore stage state: ")?;
        match self {
            Self::OtherStage { expected, found } => {
                write!(f, "the snapshot belongs to stage {found}, expected {expected}")
            }
            Self::OtherLength { expected, found } => write!(f, "found {found} values, expected {expected}"),
            Self::NotFinite { index } => write!(f, "value {index} is not finite"),
            Self::Corrupt => write!(f, "the checksum does not match the values"),
            Self::Invalid { reason } => write!(f, "{reason}"),
        }
    }
}

impl core::error::Error for RestoreError {}

impl Attitude {
    /// Checks that all values are finite and within the bounds of the chart.
    ///
    /// # Errors
    ///
    /// Returns [`RestoreError::NotFinite`] or [`RestoreError::Invalid`].
    pub fn validate(&self) -> Result<(), RestoreError> {
        let mut index = 0;
        let mut bad = None;
        { *self }.visit(&mut |value| {
            bad = bad.or((!value.is_finite()).then_some(index));
            index += 1;
        });
        if let Some(index) = bad {
            return Err(RestoreError::NotFinite { index });
        }
        attitude_validation_error(*self).map_or(Ok(()), |flaw| Err(RestoreError::Invalid { reason: flaw }))
    }
}

/// Returns the reason why an attitude is invalid, or `None` if it is valid.
///
/// An attitude is invalid if it is outside the bounds of its chart or NaN.
#[inline]
pub fn attitude_validation_error(attitude: Attitude) -> Option<&'static str> {
    let inside = attitude.up.w.norm_sqr() <= 2.0 && attitude.z_rad.abs() <= 4.0;
    (!inside).then_some("an attitude outside its chart")
}

/// Returns the reason why a gyro bias is invalid, or `None` if it is valid.
///
/// The components must be finite. A component above 10 rad/s is invalid.
pub fn bias_validation_error(bias_rad_s: Vector3<f64>) -> Option<&'static str> {
    (bias_rad_s.amax() > 10.0).then_some("a gyro bias above 10 rad/s")
}
