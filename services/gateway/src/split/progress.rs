//! Checkpoints of a split system's progress, and the identifier of a run.

use std::fs;

use bus::Publisher;
use launch::Service;
use messages::Checkpoint;
use runtime::{RuntimeError, ServiceContext, service_config::CONTROL_BUFFER};

/// Publisher of the gateway's progress as checkpoints, from which neighbouring services and the
/// gateway's next incarnation resume.
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
        Ok(self.checkpoints.send(&checkpoint)?)
    }
}

/// Returns a number that is unique to this run. It is derived from the boot identifier and from the
/// process identifier and start time of the supervisor.
pub(super) fn run_id(supervisor_pid: u32) -> u64 {
    let read = |path: &str| fs::read_to_string(path).unwrap_or_default();
    let boot = read("/proc/sys/kernel/random/boot_id");
    let stat = read(&format!("/proc/{supervisor_pid}/stat"));
    // The process name may contain any character, so the fields are counted from its closing
    // parenthesis. The start time is the 20th field after it.
    let start = stat.rsplit_once(')').and_then(|(_, rest)| rest.split_whitespace().nth(19)).unwrap_or_default();
    messages::hash(messages::HASH_START, format!("{boot} {supervisor_pid} {start}").as_bytes())
}
