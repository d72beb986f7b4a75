//! Snapshots of a filter as bytes, from which it can continue after a restart.
//!
//! Input: the bytes of a snapshot, from any origin.
//!
//! Output: a filter whose later attitudes have the same bits as those of the original.
//!
//! Failure: a snapshot that is truncated, corrupt, or belongs to other stages is rejected.

use core::fmt;

use attitude::{
    accel::Accelerometer,
    course::Course,
    flags::Flags,
    fuser::FuserStage,
    gyro::Gyro,
    scalars::Scalars,
    stage::{RestoreError, Stage},
    state_words::StateWords,
};

use crate::{Ahrs, Attitude};

/// First bytes of a snapshot: name and version of the format.
const MAGIC: u64 = u64::from_le_bytes(*b"plmahrs1");
/// Number of words before the state: magic, hash of the stage names, number of words, checksum.
const HEADER_WORDS: usize = 4;

impl<F: FuserStage> Ahrs<F> {
    /// Returns the size of a snapshot in bytes.
    pub fn snapshot_len(&self) -> usize {
        let mut words = HEADER_WORDS;
        self.clone().visit_words(&mut |_| words += 1);
        words * size_of::<u64>()
    }

    /// Writes a snapshot of the whole state to the start of `buffer` and returns its length in
    /// bytes.
    ///
    /// The properties that the builder has set are not part of the snapshot.
    ///
    /// ```
    /// use plumbline_ahrs::Ahrs;
    ///
    /// let mut ahrs = Ahrs::new();
    /// ahrs.update([0.0; 3], [0.0, 0.0, 9.81], None, 0.01);
    /// let mut buffer = vec![0; ahrs.snapshot_len()];
    /// ahrs.save(&mut buffer)?;
    ///
    /// let mut other = Ahrs::new();
    /// other.restore(&buffer)?;
    /// let [first, second] = [&mut ahrs, &mut other]
    ///     .map(|ahrs| ahrs.update([0.0, 0.1, 0.0], [0.0, 0.1, 9.8], None, 0.01));
    /// assert_eq!(first, second);
    /// # Ok::<(), plumbline_ahrs::SnapshotError>(())
    /// ```
    ///
    /// # Errors
    ///
    /// Returns [`SnapshotError::BufferTooSmall`] if the buffer is shorter than
    /// [`snapshot_len`](Self::snapshot_len).
    pub fn save(&self, buffer: &mut [u8]) -> Result<usize, SnapshotError> {
        let needed = self.snapshot_len();
        let found = buffer.len();
        let bytes = buffer.get_mut(..needed).ok_or(SnapshotError::BufferTooSmall { needed, found })?;
        let (header, state) = bytes.split_at_mut(HEADER_WORDS * size_of::<u64>());
        let (places, _) = state.as_chunks_mut::<8>();
        let mut places = places.iter_mut();
        self.clone().visit_words(&mut |word| {
            if let Some(place) = places.next() {
                *place = word.to_le_bytes();
            }
        });
        let words = [MAGIC, self.stages_hash(), needed as u64, checksum(state)];
        let (places, _) = header.as_chunks_mut::<8>();
        places.iter_mut().zip(words).for_each(|(place, word)| *place = word.to_le_bytes());
        Ok(needed)
    }

    /// Continues from a snapshot of a filter with the same stages.
    ///
    /// # Errors
    ///
    /// Returns a [`SnapshotError`] if the bytes are not a valid snapshot of such a filter. The
    /// filter is then unchanged.
    pub fn restore(&mut self, snapshot: &[u8]) -> Result<(), SnapshotError> {
        let expected = self.snapshot_len();
        let (words, _) = snapshot.as_chunks::<8>();
        let mut words = words.iter().map(|word| u64::from_le_bytes(*word));
        let mut next = || words.next().unwrap_or_default();
        let [magic, stages, len, sum] = [next(), next(), next(), next()];
        if magic != MAGIC {
            return Err(SnapshotError::NotASnapshot);
        }
        if stages != self.stages_hash() {
            return Err(SnapshotError::OtherStages);
        }
        let is_whole = snapshot.len() == expected && len == expected as u64;
        let state = snapshot.get(HEADER_WORDS * size_of::<u64>()..).unwrap_or_default();
        if !is_whole || sum != checksum(state) {
            return Err(SnapshotError::Corrupt { expected, found: snapshot.len() });
        }
        let mut restored = self.clone();
        restored.visit_words(&mut |word| *word = next());
        restored.validate()?;
        *self = restored;
        Ok(())
    }

    /// Passes each word of the state to `visit`, always in the same order.
    fn visit_words(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        let Self { conditioner, gyro, accel, fuser, course, t_ns, pending_field_ut, pending_fix, attitude } = self;
        conditioner.visit(visit);
        visit_stage(&mut gyro.validated.stage, visit);
        gyro.state_mut().visit(visit);
        visit_stage(&mut accel.stage, visit);
        visit_stage(fuser.stage_mut(), visit);
        fuser.state_mut().visit(visit);
        visit_stage(&mut course.validated.stage, visit);
        course.state_mut().visit(visit);
        StateWords::visit(t_ns, visit);
        StateWords::visit(pending_field_ut, visit);
        StateWords::visit(pending_fix, visit);
        let Attitude { tick, t_ns, flags: Flags(flags), fused, reading, reset_counter, jump } = attitude;
        tick.visit(visit);
        StateWords::visit(t_ns, visit);
        flags.visit(visit);
        Scalars::visit(fused, &mut as_numbers(visit));
        Scalars::visit(reading, &mut as_numbers(visit));
        reset_counter.visit(visit);
        StateWords::visit(jump, visit);
    }

    /// Checks a restored state.
    fn validate(&self) -> Result<(), SnapshotError> {
        let reason = stage_error(&self.gyro.validated.stage)
            .or_else(|| stage_error(&self.accel.stage))
            .or_else(|| stage_error(self.fuser.stage()))
            .or_else(|| stage_error(&self.course.validated.stage))
            .or_else(|| self.fuser.state().validation_error())
            .or_else(|| self.course.state().validation_error());
        reason.map_or(Ok(()), |reason| Err(SnapshotError::Invalid(RestoreError::Invalid { reason })))
    }

    /// Returns a hash of the names of the stages.
    fn stages_hash(&self) -> u64 {
        let names: [&str; 4] = [
            Gyro::name(&self.gyro.validated.stage),
            Accelerometer::name(&self.accel.stage),
            self.fuser.stage().name(),
            Course::name(&self.course.validated.stage),
        ];
        names.iter().fold(HASH_START, |sum, name| hash(hash(sum, name.as_bytes()), &[0]))
    }
}

fn visit_stage<S: Stage>(stage: &mut S, visit: &mut dyn FnMut(&mut u64)) {
    stage.visit_state(&mut as_numbers(visit));
}

fn stage_error<S: Stage + Clone>(stage: &S) -> Option<&'static str> {
    let mut is_finite = true;
    stage.clone().visit_state(&mut |number| is_finite &= number.is_finite());
    stage.validation_error().or((!is_finite).then_some("a number that is not finite"))
}

/// Returns a visitor of `f64` numbers that passes the bits of each number to `visit`.
fn as_numbers(visit: &mut dyn FnMut(&mut u64)) -> impl FnMut(&mut f64) {
    |number| StateWords::visit(number, visit)
}

const HASH_START: u64 = 0xcbf2_9ce4_8422_2325;

/// Continues the FNV-1a hash `start` over `bytes`.
fn hash(start: u64, bytes: &[u8]) -> u64 {
    bytes.iter().fold(start, |sum, byte| (sum ^ u64::from(*byte)).wrapping_mul(0x100_0000_01b3))
}

fn checksum(state: &[u8]) -> u64 {
    hash(HASH_START, state)
}

/// Error of [`Ahrs::save`] or [`Ahrs::restore`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum SnapshotError {
    /// The buffer is too small for the snapshot.
    BufferTooSmall {
        /// Size of the snapshot, bytes.
        needed: usize,
        /// Size of the buffer, bytes.
        found: usize,
    },
    /// The bytes are not a snapshot of this version of the crate.
    NotASnapshot,
    /// The snapshot belongs to a filter with other stages.
    OtherStages,
    /// The snapshot is truncated or damaged.
    Corrupt {
        /// Size of a snapshot of this filter, bytes.
        expected: usize,
        /// Size of the snapshot, bytes.
        found: usize,
    },
    /// The state in the snapshot is invalid.
    Invalid(RestoreError),
}

impl fmt::Display for SnapshotError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::BufferTooSmall { needed, found } => {
                write!(f, "a snapshot needs {needed} bytes, found a buffer of {found}; allocate snapshot_len()")
            }
            Self::NotASnapshot => {
                write!(f, "the bytes are not a snapshot of this version; start without one")
            }
            Self::OtherStages => {
                write!(f, "the snapshot belongs to other stages; build the filter with the same stages")
            }
            Self::Corrupt { expected, found } => {
                write!(f, "the snapshot is damaged: expected {expected} intact bytes, found {found}")
            }
            Self::Invalid(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for SnapshotError {}
