//! Subscriber of the slot, which keeps the output received for each tick.

use swap::ReorderBuffer;

use crate::process::Packet;

#[derive(Debug)]
pub(crate) struct Subscriber {
    pub(crate) reorder_buffer: ReorderBuffer<Packet>,
    /// Output received for each tick, starting with tick 0.
    pub(crate) received: Vec<Packet>,
    pub(crate) checkpoint_interval_ticks: u64,
    pub(crate) checkpoint: Checkpoint,
    pub(crate) max_held: usize,
}

/// State from which a subscriber restarts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Checkpoint {
    pub(crate) next_tick: u64,
    pub(crate) epoch: u32,
}

impl Subscriber {
    pub(crate) fn new(lateness_ticks: u64, checkpoint_interval_ticks: u64) -> Self {
        let reorder_buffer = ReorderBuffer::new(0, 1, lateness_ticks);
        Self {
            reorder_buffer,
            received: Vec::new(),
            checkpoint_interval_ticks,
            checkpoint: Checkpoint { next_tick: 0, epoch: 1 },
            max_held: 0,
        }
    }

    /// Receives a message. Fails if a delivered tick is out of order, follows a missing tick, or
    /// has a lower epoch than the tick before.
    pub(crate) fn receive(&mut self, packet: Packet) -> Result<(), String> {
        let mut failure = None;
        let received = &mut self.received;
        self.reorder_buffer.offer(packet, &mut |packet, missing| {
            if packet.tick != received.len() as u64 || missing > 0 {
                failure.get_or_insert(format!(
                    "received tick {} instead of {}, {missing} missing",
                    packet.tick,
                    received.len()
                ));
            }
            if received.last().is_some_and(|last| last.epoch > packet.epoch) {
                failure.get_or_insert(format!(
                    "tick {} has the epoch {}, lower than that of the tick before",
                    packet.tick, packet.epoch
                ));
            }
            received.push(packet);
        });
        self.max_held = self.max_held.max(self.reorder_buffer.held());
        if self.received.len() as u64 >= self.checkpoint.next_tick + self.checkpoint_interval_ticks {
            self.checkpoint = Checkpoint { next_tick: self.received.len() as u64, epoch: self.reorder_buffer.epoch() };
        }
        failure.map_or(Ok(()), Err)
    }

    /// Simulates an exit and a restart from the checkpoint.
    pub(crate) fn restart(&mut self, lateness_ticks: u64) {
        let Checkpoint { next_tick, epoch } = self.checkpoint;
        self.reorder_buffer = ReorderBuffer::new(next_tick, epoch, lateness_ticks);
        self.received.truncate(next_tick as usize);
    }
}
