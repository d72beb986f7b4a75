//! Several topics become one stream of records: every tick once, in order, with all that there is of it.
//!
//! Input: messages of each topic in the order of ticks, the topics in any order. Output: contiguous records. Time: none; how long to wait
//! is counted in ticks. Failure: what stays away is left out of its record.

use std::collections::VecDeque;

use launch::CARRIED;
use messages::Flags;

use super::record::{Record, Topic, places};

/// Messages of one topic that wait for their tick; beyond it nothing is waited for.
const QUEUE_MAX: usize = 65_536;

/// The join.
#[derive(Debug)]
pub struct Merge {
    mask: u8,
    lanes: [Lane; CARRIED.len()],
    next_tick: Option<u64>,
    lateness_ticks: u64,
    expected_until: u64,
}

#[derive(Debug, Default)]
struct Lane {
    queue: VecDeque<Part>,
    first_tick: Option<u64>,
    next_tick: u64,
}

#[derive(Debug)]
struct Part {
    tick: u64,
    flags: Flags,
    bytes: Vec<u8>,
}

impl Merge {
    /// Joins the topics of `mask` from tick 0 on.
    pub fn starting(mask: u8, lateness_ticks: u64) -> Self {
        Self { next_tick: Some(0), ..Self::joining(mask, lateness_ticks, 0) }
    }

    /// Joins them from the first tick on that all topics still hold; before `expected_until` everything was published once and is not
    /// given up so soon.
    pub fn joining(mask: u8, lateness_ticks: u64, expected_until: u64) -> Self {
        Self { mask, lanes: Default::default(), next_tick: None, lateness_ticks, expected_until }
    }

    /// Takes a message; one that comes again is left out.
    pub fn offer(&mut self, place: usize, tick: u64, flags: Flags, bytes: &[u8]) {
        let Some(lane) = self.lanes.get_mut(place) else { return };
        if tick < lane.next_tick {
            return;
        }
        lane.first_tick.get_or_insert(tick);
        lane.next_tick = tick.saturating_add(1);
        if self.next_tick.is_none_or(|next_tick| tick >= next_tick) {
            lane.queue.push_back(Part { tick, flags, bytes: bytes.to_vec() });
        }
    }

    /// The next tick, once it is certain what there is of it.
    pub fn take(&mut self) -> Option<Record> {
        let newest_tick = self.dense().filter_map(|lane| lane.next_tick.checked_sub(1)).max()?;
        let tick = self.begin(newest_tick)?;
        if tick > newest_tick {
            return None;
        }
        let overdue = self.overdue(tick, newest_tick);
        if !overdue && !self.dense().all(|lane| lane.next_tick > tick) {
            return None;
        }
        let of_tick = |lane: &&Lane| lane.queue.front().is_some_and(|part| part.tick == tick);
        let fronts = self.dense().filter(of_tick).filter_map(|lane| lane.queue.front());
        let flags = fronts.fold(Flags::NONE, |flags, part| flags | part.flags);
        let lacks = |(place, topic): (usize, &Topic)| {
            flags.any(topic.flag) && self.lanes.get(place).is_some_and(|lane| lane.next_tick <= tick)
        };
        if !overdue && places(self.mask).any(lacks) {
            return None;
        }
        self.next_tick = Some(tick + 1);
        Some(self.record(tick))
    }

    /// The topic that the next tick waits for: its place.
    pub fn lacks(&self) -> Option<usize> {
        let dense = places(self.mask).filter(|(_, topic)| topic.is_dense);
        let next_tick = |(place, _): &(usize, &Topic)| self.lanes.get(*place).map(|lane| lane.next_tick);
        dense.min_by_key(next_tick).map(|(place, _)| place)
    }

    fn record(&mut self, tick: u64) -> Record {
        let mut record = Record::empty(tick);
        for (place, _) in places(self.mask) {
            let Some(lane) = self.lanes.get_mut(place) else { continue };
            while lane.queue.pop_front_if(|part| part.tick < tick).is_some() {}
            if let Some(part) = lane.queue.pop_front_if(|part| part.tick == tick) {
                record.push(place, &part.bytes);
            }
        }
        record
    }

    /// The tick that is next; where the stream began is known when every topic has been heard.
    fn begin(&mut self, newest_tick: u64) -> Option<u64> {
        if self.next_tick.is_none() {
            let all_heard = self.dense().all(|lane| lane.first_tick.is_some());
            let given_up = newest_tick >= self.expected_until.saturating_add(self.lateness_ticks);
            if all_heard || given_up {
                self.next_tick = self.dense().filter_map(|lane| lane.first_tick).max();
                let first_tick = self.next_tick.unwrap_or(0);
                for lane in &mut self.lanes {
                    while lane.queue.pop_front_if(|part| part.tick < first_tick).is_some() {}
                }
            }
        }
        self.next_tick
    }

    fn overdue(&self, tick: u64, newest_tick: u64) -> bool {
        newest_tick >= tick.max(self.expected_until).saturating_add(self.lateness_ticks)
            || self.lanes.iter().any(|lane| lane.queue.len() >= QUEUE_MAX)
    }

    fn dense(&self) -> impl Iterator<Item = &Lane> {
        places(self.mask).filter(|(_, topic)| topic.is_dense).filter_map(|(place, _)| self.lanes.get(place))
    }
}
