//! Several inputs of a slot become one stream, by tick and never by arrival.
//!
//! Input: messages in whatever order they arrive. Output: the ticks in order, each with what there is of it. Time: none; how long
//! to wait is counted in ticks, so that a replay decides alike. Failure: what stays away is left out, counted and said.

use std::collections::VecDeque;

use messages::{Flags, Header, Ticked};

use crate::slot::Sequence;

/// One tick of two inputs, at least one of which is there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Joined<A, B> {
    /// Ticks missing before this one.
    pub missing: u64,
    /// The first input's message.
    pub first: Option<A>,
    /// The second input's message.
    pub second: Option<B>,
}

/// Joins two inputs by tick, never by arrival.
///
/// A tick is complete when both messages are there, or when an input has passed it, or when one input is `lateness_ticks` ahead of
/// a silent one. The last is decided by ticks alone, so a replay decides alike.
#[derive(Debug, Clone)]
pub struct Join<A, B> {
    first: Inbox<A>,
    second: Inbox<B>,
    lateness_ticks: u64,
    expected_until: u64,
    sequence: Sequence,
}

/// Messages of one input that wait for their tick.
#[derive(Debug, Clone)]
struct Inbox<M> {
    queue: VecDeque<M>,
    /// The life that sent the newest.
    sender: u32,
    /// From this tick on nobody publishes this input.
    absent_from: u64,
}

impl<A: Ticked, B: Ticked> Join<A, B> {
    /// A join that waits for `lateness_ticks`.
    pub fn new(lateness_ticks: u64) -> Self {
        let (first, second) = (Inbox::default(), Inbox::default());
        Self { first, second, lateness_ticks, expected_until: 0, sequence: Sequence::default() }
    }

    /// From `tick` on nobody publishes the first input; `u64::MAX` where somebody does.
    pub fn first_is_absent_from(&mut self, tick: u64) {
        self.first.absent_from = tick;
    }

    /// From `tick` on nobody publishes the second input; `u64::MAX` where somebody does.
    pub fn second_is_absent_from(&mut self, tick: u64) {
        self.second.absent_from = tick;
    }

    /// Before `tick` neither input is given up.
    pub fn expect_until(&mut self, tick: u64) {
        self.expected_until = tick;
    }

    /// Takes a message of the first input.
    pub fn offer_first(&mut self, message: A) {
        self.first.offer(message, &mut self.sequence);
    }

    /// Takes a message of the second input.
    pub fn offer_second(&mut self, message: B) {
        self.second.offer(message, &mut self.sequence);
    }

    /// The next complete tick.
    pub fn take(&mut self) -> Option<Joined<A, B>> {
        let header = self.peek()?;
        let missing = self.sequence.admit(&header)?;
        let its = |message: &mut Header| message.tick == header.tick;
        Some(Joined {
            missing,
            first: self.first.queue.pop_front_if(|message| its(message.header_mut())),
            second: self.second.queue.pop_front_if(|message| its(message.header_mut())),
        })
    }

    /// The header of the tick that [`Self::take`] would give next; any of its messages' flags.
    pub fn peek(&self) -> Option<Header> {
        let (first, second) = (self.first.front(), self.second.front());
        match (first, second) {
            (Some(first), Some(second)) if first.tick == second.tick => {
                Some(Header { flags: first.flags | second.flags, ..*first })
            }
            (Some(first), Some(second)) => Some(if first.tick < second.tick { *first } else { *second }),
            (Some(tick), None) => {
                (tick.tick >= self.second.absent_from || self.overdue(tick.tick, self.first.back())).then_some(*tick)
            }
            (None, Some(tick)) => {
                (tick.tick >= self.first.absent_from || self.overdue(tick.tick, self.second.back())).then_some(*tick)
            }
            (None, None) => None,
        }
    }

    /// The newest tick of either input.
    pub fn newest_tick(&self) -> u64 {
        self.first.back().max(self.second.back()).unwrap_or(0)
    }

    /// Which input the next tick waits for: 1 for the second while only the first is there, else 0.
    pub fn lacks(&self) -> usize {
        usize::from(!self.first.queue.is_empty() && self.second.queue.is_empty())
    }

    /// The joined stream, so far.
    pub fn sequence(&self) -> &Sequence {
        &self.sequence
    }

    /// The joined stream, for a state to be put in.
    pub fn sequence_mut(&mut self) -> &mut Sequence {
        &mut self.sequence
    }

    fn overdue(&self, tick: u64, newest: Option<u64>) -> bool {
        tick >= self.expected_until && newest.is_some_and(|newest| newest - tick >= self.lateness_ticks)
            || self.first.queue.len().max(self.second.queue.len()) >= QUEUE_MAX
    }
}

impl<M> Default for Inbox<M> {
    fn default() -> Self {
        Self { queue: VecDeque::new(), sender: 0, absent_from: u64::MAX }
    }
}

impl<M: Ticked> Inbox<M> {
    fn offer(&mut self, message: M, sequence: &mut Sequence) {
        let Header { tick, incarnation, .. } = *message.header();
        if tick < sequence.next_tick || self.back().is_some_and(|newest| tick <= newest) {
            sequence.refuse(incarnation, self.sender);
            return;
        }
        self.sender = incarnation;
        self.queue.push_back(message);
    }

    fn front(&self) -> Option<&Header> {
        self.queue.front().map(Ticked::header)
    }

    fn back(&self) -> Option<u64> {
        self.queue.back().map(|message| message.header().tick)
    }
}

/// Messages that go with some ticks of another stream, as a flag of those ticks says.
#[derive(Debug, Clone)]
pub struct Beside<M> {
    queue: VecDeque<M>,
    flag: Flags,
    lateness_ticks: u64,
    expected_until: u64,
    next_tick: u64,
}

impl<M: Ticked> Beside<M> {
    /// Messages for ticks with `flag`, waited for until the other stream is `lateness_ticks` ahead.
    pub fn new(flag: Flags, lateness_ticks: u64) -> Self {
        Self { queue: VecDeque::new(), flag, lateness_ticks, expected_until: 0, next_tick: 0 }
    }

    /// Before `tick` no message is given up.
    pub fn expect_until(&mut self, tick: u64) {
        self.expected_until = tick;
    }

    /// Takes a message; one that comes again or too late is left out.
    pub fn offer(&mut self, message: M) {
        let tick = message.header().tick;
        if tick >= self.next_tick && self.queue.len() < QUEUE_MAX {
            self.next_tick = tick.saturating_add(1);
            self.queue.push_back(message);
        }
    }

    /// Nothing more is to be waited for at this tick; `newest_tick` is how far the other stream is.
    pub fn is_ready(&self, header: &Header, newest_tick: u64) -> bool {
        !header.flags.any(self.flag)
            || self.next_tick > header.tick
            || header.tick >= self.expected_until && newest_tick.saturating_sub(header.tick) >= self.lateness_ticks
    }

    /// The message of this tick, if it has come.
    pub fn take(&mut self, tick: u64) -> Option<M> {
        while self.queue.pop_front_if(|message| message.header().tick < tick).is_some() {}
        self.queue.pop_front_if(|message| message.header().tick == tick)
    }
}

/// Messages of another stream that wait for their tick at most.
const QUEUE_MAX: usize = launch::TOPIC_MESSAGES_MAX;

#[cfg(test)]
mod tests {
    use super::*;
    use messages::{AccelPoint, GyroStep};

    fn gyro(tick: u64) -> GyroStep {
        let mut message: GyroStep = bytemuck::Zeroable::zeroed();
        message.header.tick = tick;
        message
    }

    fn accel(tick: u64) -> AccelPoint {
        let mut message: AccelPoint = bytemuck::Zeroable::zeroed();
        message.header.tick = tick;
        message
    }

    /// (tick, first there, second there, missing before)
    fn drain(join: &mut Join<GyroStep, AccelPoint>) -> Vec<(u64, bool, bool, u64)> {
        std::iter::from_fn(|| join.take())
            .map(|joined| {
                let tick = joined.first.map(|m| m.header.tick).or(joined.second.map(|m| m.header.tick));
                (tick.unwrap(), joined.first.is_some(), joined.second.is_some(), joined.missing)
            })
            .collect()
    }

    #[test]
    fn order_of_arrival_does_not_matter() {
        let mut together = Join::new(100);
        let mut apart = Join::new(100);
        let mut out = (Vec::new(), Vec::new());
        for tick in 0..50 {
            together.offer_first(gyro(tick));
            together.offer_second(accel(tick));
            out.0.extend(drain(&mut together));
        }
        (0..50).for_each(|tick| apart.offer_second(accel(tick)));
        for tick in 0..50 {
            apart.offer_first(gyro(tick));
            out.1.extend(drain(&mut apart));
        }
        assert_eq!(out.0, out.1);
        assert_eq!(out.0, (0..50).map(|tick| (tick, true, true, 0)).collect::<Vec<_>>());
    }

    #[test]
    fn a_silent_input_is_left_out_once_the_other_is_far_enough_ahead() {
        let mut join = Join::new(10);
        (0..10).for_each(|tick| join.offer_first(gyro(tick)));
        assert_eq!(drain(&mut join), []);
        join.offer_first(gyro(10));
        assert_eq!(drain(&mut join), [(0, true, false, 0)]);
        join.offer_second(accel(0));
        assert_eq!(join.sequence().duplicated, 1, "too late is left out");
        join.offer_second(accel(1));
        assert_eq!(drain(&mut join), [(1, true, true, 0)]);
    }

    #[test]
    fn an_input_that_has_passed_a_tick_will_not_bring_it() {
        let mut join = Join::new(1000);
        join.offer_first(gyro(0));
        join.offer_first(gyro(1));
        join.offer_second(accel(1));
        assert_eq!(drain(&mut join), [(0, true, false, 0), (1, true, true, 0)]);
    }

    #[test]
    fn a_message_beside_is_waited_for_only_where_the_tick_says_so_and_not_for_ever() {
        let flagged = |tick, flags| Header { tick, flags, ..bytemuck::Zeroable::zeroed() };
        let mut field: Beside<GyroStep> = Beside::new(Flags::FIELD, 10);
        assert!(field.is_ready(&flagged(3, Flags::FIX), 3));
        assert!(!field.is_ready(&flagged(3, Flags::FIELD), 12));
        assert!(field.is_ready(&flagged(3, Flags::FIELD), 13), "too late");
        [3, 3, 1, 5].into_iter().for_each(|tick| field.offer(gyro(tick)));
        assert!(field.is_ready(&flagged(3, Flags::FIELD), 3));
        assert!(field.is_ready(&flagged(4, Flags::FIELD), 4), "it has been passed");
        assert!(!field.is_ready(&flagged(6, Flags::FIELD), 6));
        let taken = [2, 3, 4, 5].map(|tick| field.take(tick).map(|message| message.header.tick));
        assert_eq!(taken, [None, Some(3), None, Some(5)]);
    }

    #[test]
    fn what_is_peeked_is_what_is_taken() {
        let mut join = Join::new(10);
        (3..14).for_each(|tick| join.offer_first(gyro(tick)));
        for tick in [5, 6, 8] {
            join.offer_second(accel(tick));
        }
        while let Some(seen) = join.peek() {
            let taken = join.take().unwrap();
            let tick = taken.first.map(|m| m.header.tick).or(taken.second.map(|m| m.header.tick));
            assert_eq!(Some(seen.tick), tick);
        }
        assert_eq!(join.take(), None);
    }

    #[test]
    fn ticks_missing_on_both_sides_are_counted_and_repeats_left_out() {
        let mut join = Join::new(10);
        for tick in [0, 0, 4, 3] {
            join.offer_first(gyro(tick));
            join.offer_second(accel(tick));
        }
        assert_eq!(drain(&mut join), [(0, true, true, 0), (4, true, true, 3)]);
        assert_eq!(
            *join.sequence(),
            Sequence { next_tick: 5, ticks: 2, lost: 3, duplicated: 4, repeated: 0, sender: 0 }
        );
    }
}
