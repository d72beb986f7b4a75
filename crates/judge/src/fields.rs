//! Fields on their way to the samples that they go with.

use std::collections::VecDeque;

use messages::MagSample;

/// Fields whose sample has not come, at most: what a topic holds. Of more the oldest go.
const WAITING_MAX: usize = 1 << 14;

/// Fields that wait for their samples, in the order of ticks.
#[derive(Debug, Clone, Default)]
pub struct Fields(VecDeque<MagSample>);

impl Fields {
    /// Takes a field.
    pub fn push(&mut self, field: MagSample) {
        if self.0.len() >= WAITING_MAX {
            self.0.pop_front();
        }
        self.0.push_back(field);
    }

    /// The field of this tick, if it has come; those of earlier ticks go.
    pub fn of(&mut self, tick: u64) -> Option<MagSample> {
        while self.0.pop_front_if(|field| field.header.tick < tick).is_some() {}
        self.0.pop_front_if(|field| field.header.tick == tick)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_goes_with_its_tick_and_no_other() {
        let mut fields = Fields::default();
        for tick in [2, 4, 5] {
            let mut field: MagSample = bytemuck::Zeroable::zeroed();
            field.header.tick = tick;
            fields.push(field);
        }
        let found = [0, 3, 4, 4, 6].map(|tick| fields.of(tick).map(|field| field.header.tick));
        assert_eq!(found, [None, None, Some(4), None, None]);
    }
}
