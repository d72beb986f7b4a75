//! Queue of magnetometer samples waiting for the IMU sample of their tick.

use std::collections::VecDeque;

use messages::MagSample;

/// Maximum number of queued samples: the capacity of a topic. The oldest are dropped first.
const MAX_WAITING: usize = 1 << 14;

/// Magnetometer samples in the order of their ticks.
#[derive(Debug, Clone, Default)]
pub struct FieldQueue(VecDeque<MagSample>);

impl FieldQueue {
    /// Appends a sample.
    pub fn push(&mut self, field: MagSample) {
        if self.0.len() >= MAX_WAITING {
            self.0.pop_front();
        }
        self.0.push_back(field);
    }

    /// Removes and returns the sample of `tick`, if present, and discards older ones.
    pub fn take(&mut self, tick: u64) -> Option<MagSample> {
        while self.0.pop_front_if(|field| field.header.tick < tick).is_some() {}
        self.0.pop_front_if(|field| field.header.tick == tick)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn take_returns_only_the_field_of_its_tick() {
        let mut fields = FieldQueue::default();
        for tick in [2, 4, 5] {
            let mut field: MagSample = bytemuck::Zeroable::zeroed();
            field.header.tick = tick;
            fields.push(field);
        }
        let found = [0, 3, 4, 4, 6].map(|tick| fields.take(tick).map(|field| field.header.tick));
        assert_eq!(found, [None, None, Some(4), None, None]);
    }
}
