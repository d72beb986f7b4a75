//! Checkpoints of a split system's progress.

use bus::Publisher;
use launch::Service;
use messages::Checkpoint;
use runtime::{RuntimeError, ServiceContext, service_config::CONTROL_BUFFER};

/// Publisher of checkpoints with the gateway's progress. The next incarnation of the gateway
/// resumes from the newest of these checkpoints.
pub(super) struct ProgressCheckpoints {
    pub(super) checkpoints: Publisher<Checkpoint>,
    pub(super) due_tick: u64,
}

impl ProgressCheckpoints {
    pub(super) fn open(context: &ServiceContext) -> Result<Self, RuntimeError> {
        Ok(Self { checkpoints: context.bus.publisher(CONTROL_BUFFER)?, due_tick: 1 })
    }

    pub(super) fn publish(&mut self, context: &ServiceContext, next_tick: u64, run: u64) -> Result<(), RuntimeError> {
        if next_tick < self.due_tick {
            return Ok(());
        }
        self.due_tick = next_tick + context.config.checkpoint_ticks();
        let mut checkpoint = Checkpoint {
            next_tick,
            service: Service::Gateway as u32,
            incarnation: context.config.incarnation,
            slot_words: 1,
            ..bytemuck::Zeroable::zeroed()
        };
        checkpoint.words[0] = run;
        checkpoint.checksum = checkpoint.compute_checksum();
        Ok(self.checkpoints.send_checkpoint(&checkpoint)?)
    }
}
