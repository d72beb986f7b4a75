//! A reader of the slot: what it got, by tick.

use swap::ReorderBuffer;

use crate::process::Packet;

#[derive(Debug)]
pub(crate) struct Reader {
    pub(crate) reorder_buffer: ReorderBuffer<Packet>,
    /// What it got for each tick, from 0.
    pub(crate) got: Vec<Packet>,
    pub(crate) checkpoint_interval_ticks: u64,
    pub(crate) checkpoint: Checkpoint,
    pub(crate) held_max: usize,
}

/// What a reader restarts from.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Checkpoint {
    pub(crate) next_tick: u64,
    pub(crate) epoch: u32,
}

impl Reader {
    pub(crate) fn new(lateness_ticks: u64, checkpoint_interval_ticks: u64) -> Self {
        let reorder_buffer = ReorderBuffer::starting(0, 1, lateness_ticks);
        Self {
            reorder_buffer,
            got: Vec::new(),
            checkpoint_interval_ticks,
            checkpoint: Checkpoint { next_tick: 0, epoch: 1 },
            held_max: 0,
        }
    }

    /// Takes a message; fails when a tick does not come in its turn.
    pub(crate) fn take(&mut self, packet: Packet) -> Result<(), String> {
        let mut wrong = None;
        let got = &mut self.got;
        self.reorder_buffer.offer(packet, &mut |packet, missing| {
            if packet.tick != got.len() as u64 || missing > 0 {
                wrong.get_or_insert(format!(
                    "tick {} came where {} is next, missing {missing}",
                    packet.tick,
                    got.len()
                ));
            }
            if got.last().is_some_and(|last| last.epoch > packet.epoch) {
                wrong.get_or_insert(format!(
                    "tick {} is of epoch {}, earlier than the one before it",
                    packet.tick, packet.epoch
                ));
            }
            got.push(packet);
        });
        self.held_max = self.held_max.max(self.reorder_buffer.held());
        if self.got.len() as u64 >= self.checkpoint.next_tick + self.checkpoint_interval_ticks {
            self.checkpoint = Checkpoint { next_tick: self.got.len() as u64, epoch: self.reorder_buffer.epoch() };
        }
        wrong.map_or(Ok(()), Err)
    }

    /// Dies, and goes on from its checkpoint.
    pub(crate) fn restart(&mut self, lateness_ticks: u64) {
        let Checkpoint { next_tick, epoch } = self.checkpoint;
        self.reorder_buffer = ReorderBuffer::starting(next_tick, epoch, lateness_ticks);
        self.got.truncate(next_tick as usize);
    }
}
