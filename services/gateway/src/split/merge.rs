//! Joins several topics into one stream of records, with each tick once and in order.
//!
//! Input: messages of each topic in tick order; topics may interleave in any way.
//!
//! Output: contiguous records.
//!
//! Time: waiting is measured in ticks.
//!
//! Failure: a missing message is omitted from its record.

use messages::Flags;
use runtime::{
    Join, JoinInput, JoinInputs,
    join::{InputStatus, TickStamped},
};

use super::record::{Record, topics_in};

/// Join of the topics that a mask selects.
#[derive(Debug)]
pub struct Merge {
    join: Join<TopicInputs>,
    /// Set once the first tick of the stream is known.
    has_started: bool,
    /// Deadline for the start of the stream, as a tick. The stream starts as soon as a dense topic
    /// is past this tick, even if other dense topics have not delivered a message yet.
    start_deadline: u64,
}

/// Join inputs of the topics that a mask selects, with the indices of these topics.
#[derive(Debug)]
struct TopicInputs(Vec<(usize, JoinInput<TopicMessage>)>);

#[derive(Debug)]
struct TopicMessage {
    tick: u64,
    flags: Flags,
    bytes: Vec<u8>,
}

impl Merge {
    /// Creates a join of the topics in `mask` that starts at tick 0.
    pub fn new(mask: u8, lateness_ticks: u64) -> Self {
        Self { has_started: true, ..Self::with_unknown_start(mask, lateness_ticks, 0) }
    }

    /// Creates a join that starts at the first tick that is still available from all dense topics.
    /// A dense topic has a message for every tick.
    ///
    /// Ticks before `backlog_end` have already been published, but their messages are still being
    /// delivered. These ticks are therefore given up later than other ticks.
    pub fn with_unknown_start(mask: u8, lateness_ticks: u64, backlog_end: u64) -> Self {
        let topics = topics_in(mask).map(|(index, topic)| (index, JoinInput::new(topic.flag)));
        let mut join = Join::with_empty_ticks(TopicInputs(topics.collect()), lateness_ticks);
        join.expect_backlog(backlog_end, lateness_ticks);
        Self { join, has_started: false, start_deadline: backlog_end.saturating_add(lateness_ticks) }
    }

    /// Adds a message of the topic at `index`. Repeated messages are ignored.
    pub fn offer(&mut self, index: usize, tick: u64, flags: Flags, bytes: &[u8]) {
        self.join.offer(|topics| topics.input(index), TopicMessage { tick, flags, bytes: bytes.to_vec() });
    }

    /// Returns the next record. Returns `None` until every topic has either delivered the record's
    /// tick or been given up for this tick.
    pub fn next_record(&mut self) -> Option<Record> {
        if !self.has_started {
            self.join.start_at(self.first_tick()?);
            self.has_started = true;
        }
        self.join.next().map(|joined| joined.messages)
    }

    /// Returns the index of the topic that the next record is waiting for.
    pub fn awaited_topic(&self) -> Option<usize> {
        self.join.inputs().0.get(self.join.awaited_input()).map(|(index, _)| *index)
    }

    /// Returns the first tick of the stream. Returns `None` until every dense topic has delivered a
    /// message or the deadline for the start has passed.
    fn first_tick(&self) -> Option<u64> {
        let (mut first, mut all_received, mut timed_out) = (None, true, false);
        self.join.inputs().each(&mut |input| {
            if input.is_dense() {
                first = first.max(input.front_tick());
                all_received &= input.front_tick().is_some();
                timed_out |= input.next_tick() > self.start_deadline;
            }
        });
        first.filter(|_| all_received || timed_out)
    }
}

impl TopicInputs {
    fn input(&mut self, index: usize) -> Option<&mut JoinInput<TopicMessage>> {
        self.0.iter_mut().find(|(input_index, _)| *input_index == index).map(|(_, input)| input)
    }
}

impl JoinInputs for TopicInputs {
    type Tick = Record;

    fn each(&self, visit: &mut impl FnMut(InputStatus)) {
        self.0.iter().for_each(|(_, input)| visit(input.status()));
    }

    fn take(&mut self, tick: u64) -> Record {
        let mut record = Record::new(tick);
        for (index, input) in &mut self.0 {
            if let Some(message) = input.take(tick) {
                record.push(*index, &message.bytes);
            }
        }
        record
    }
}

impl TickStamped for TopicMessage {
    fn tick(&self) -> u64 {
        self.tick
    }

    fn flags(&self) -> Flags {
        self.flags
    }

    fn publisher(&self) -> u32 {
        0
    }

    fn t_sent_ns(&self) -> u64 {
        0
    }
}
