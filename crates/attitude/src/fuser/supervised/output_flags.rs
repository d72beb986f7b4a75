//! Flags of a fused attitude, and the counter of its jumps.

use crate::{flags::Flags, fuser::Fused, state::Attitude};

/// Output of a [`SupervisedFuser`](super::SupervisedFuser) at a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SupervisedFused {
    /// Output of the stage. Its `corrections` also flag a realignment, rest and a disturbed
    /// magnetic field.
    pub fused: Fused,
    /// Set once the attitude has been aligned. Before that, the attitude is arbitrary.
    pub is_aligned: bool,
    /// Set if the stage was reset for this output, because its first output was invalid.
    pub is_reset: bool,
    /// Number of jumps of the attitude after the first alignment.
    pub reset_counter: u64,
}

impl SupervisedFused {
    /// Returns the flags of the output.
    #[inline]
    pub fn flags(&self) -> Flags {
        let Self { fused, is_aligned, is_reset, .. } = self;
        Flags::RESET.when(*is_reset)
            | Flags::ALIGNED.when(fused.corrections.aligned)
            | Flags::UNALIGNED.when(!is_aligned)
            | Flags::AT_REST.when(fused.corrections.rest)
            | Flags::FIELD_DISTURBED.when(fused.corrections.disturbed)
    }
}

/// Supervision of the outputs of a stage.
#[derive(Debug)]
pub(super) struct OutputSupervisor<'a> {
    pub(super) is_aligned: &'a mut bool,
    pub(super) reset_counter: &'a mut u64,
    pub(super) attitude: &'a mut Attitude,
}

impl OutputSupervisor<'_> {
    #[inline(always)]
    pub(super) fn supervise(&mut self, fused: Fused, is_reset: bool, is_sensor_stage_reset: bool) -> SupervisedFused {
        *self.attitude = fused.attitude;
        let has_jumped = fused.corrections.aligned || is_reset || is_sensor_stage_reset;
        *self.reset_counter += u64::from(*self.is_aligned && has_jumped);
        *self.is_aligned |= fused.corrections.aligned;
        SupervisedFused { fused, is_aligned: *self.is_aligned, is_reset, reset_counter: *self.reset_counter }
    }
}
