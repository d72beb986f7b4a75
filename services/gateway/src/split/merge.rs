//! Several topics become one stream of records: every tick once, in order, with all that there is of it.
//!
//! Input: messages of each topic in the order of ticks, the topics in any order. Output: contiguous records. Time: none; how long to wait
//! is counted in ticks. Failure: what stays away is left out of its record.

use messages::Flags;
use runtime::{
    Join, Lane, Lanes,
    join::{Look, Placed},
};

use super::record::{Record, places};

/// The join.
#[derive(Debug)]
pub struct Merge {
    join: Join<Topics>,
    /// The stream has a first tick.
    has_begun: bool,
    /// From here on the other topics are not waited for to begin.
    given_up_at: u64,
}

/// The topics of a mask, each with its place.
#[derive(Debug)]
struct Topics(Vec<(usize, Lane<Part>)>);

#[derive(Debug)]
struct Part {
    tick: u64,
    flags: Flags,
    bytes: Vec<u8>,
}

impl Merge {
    /// Joins the topics of `mask` from tick 0 on.
    pub fn starting(mask: u8, lateness_ticks: u64) -> Self {
        Self { has_begun: true, ..Self::joining(mask, lateness_ticks, 0) }
    }

    /// Joins them from the first tick on that all topics still hold; before `expected_until` everything was published once and is not
    /// given up so soon.
    pub fn joining(mask: u8, lateness_ticks: u64, expected_until: u64) -> Self {
        let topics = places(mask).map(|(place, topic)| (place, Lane::new(topic.flag)));
        let mut join = Join::without_gaps(Topics(topics.collect()), lateness_ticks);
        join.expect_until(expected_until, lateness_ticks);
        Self { join, has_begun: false, given_up_at: expected_until.saturating_add(lateness_ticks) }
    }

    /// Takes a message; one that comes again is left out.
    pub fn offer(&mut self, place: usize, tick: u64, flags: Flags, bytes: &[u8]) {
        self.join.offer(|topics| topics.lane(place), Part { tick, flags, bytes: bytes.to_vec() });
    }

    /// The next tick, once it is certain what there is of it.
    pub fn take(&mut self) -> Option<Record> {
        if !self.has_begun {
            self.join.begin_with(self.first_tick()?);
            self.has_begun = true;
        }
        self.join.take().map(|joined| joined.parts)
    }

    /// The topic that the next tick waits for: its place.
    pub fn lacks(&self) -> Option<usize> {
        self.join.lanes().0.get(self.join.lacks()).map(|(place, _)| *place)
    }

    /// Where the stream begins: known when every topic with every tick has been heard, or is not waited for any more.
    fn first_tick(&self) -> Option<u64> {
        let (mut first, mut all_heard, mut given_up) = (None, true, false);
        self.join.lanes().each(&mut |lane| {
            if lane.is_dense() {
                first = first.max(lane.front_tick());
                all_heard &= lane.front_tick().is_some();
                given_up |= lane.next_tick() > self.given_up_at;
            }
        });
        first.filter(|_| all_heard || given_up)
    }
}

impl Topics {
    fn lane(&mut self, place: usize) -> Option<&mut Lane<Part>> {
        self.0.iter_mut().find(|(its, _)| *its == place).map(|(_, lane)| lane)
    }
}

impl Lanes for Topics {
    type Tick = Record;

    fn each(&self, look: &mut impl FnMut(Look)) {
        self.0.iter().for_each(|(_, lane)| look(lane.look()));
    }

    fn take(&mut self, tick: u64) -> Record {
        let mut record = Record::empty(tick);
        for (place, lane) in &mut self.0 {
            if let Some(part) = lane.take(tick) {
                record.push(*place, &part.bytes);
            }
        }
        record
    }
}

impl Placed for Part {
    fn tick(&self) -> u64 {
        self.tick
    }

    fn flags(&self) -> Flags {
        self.flags
    }

    fn sender(&self) -> u32 {
        0
    }
}
