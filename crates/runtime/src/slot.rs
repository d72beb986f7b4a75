//! A slot's work without clock or bus: messages in, messages out, in the order of ticks.

use std::collections::VecDeque;

use messages::{Flags, Header, Ticked};

/// The work of a slot. What it gives out depends on what it was offered, and on nothing else.
pub trait Slot {
    /// Any message that it reads.
    type Input;
    /// What it publishes.
    type Output: Ticked;

    /// Takes a message; hands every output that has become certain to `publish`.
    fn offer(&mut self, input: Self::Input, publish: &mut dyn FnMut(Self::Output));

    /// The stream it gives out, so far.
    fn sequence(&self) -> &Sequence;

    /// Which of its inputs the next output waits for: the one to sleep for.
    fn lacks(&self) -> usize {
        0
    }
}

/// The work of a slot with one input: one message out for each message in.
pub trait Work {
    /// What it reads.
    type Input: Ticked;
    /// What it publishes.
    type Output: Ticked;

    /// The work of one tick. `header` is the output's, with what the input said; ticks missing before it are flagged.
    fn work(&mut self, input: &Self::Input, header: Header) -> Self::Output;
}

/// A slot with one input, which it takes in the order of ticks.
#[derive(Debug, Clone)]
pub struct EachTick<W> {
    work: W,
    sequence: Sequence,
}

impl<W> EachTick<W> {
    /// The slot that does this work.
    pub fn new(work: W) -> Self {
        Self { work, sequence: Sequence::default() }
    }
}

impl<W: Work> Slot for EachTick<W> {
    type Input = W::Input;
    type Output = W::Output;

    fn offer(&mut self, input: W::Input, publish: &mut dyn FnMut(W::Output)) {
        if let Some(missing) = self.sequence.admit(input.header().tick) {
            let header = self.sequence.mark(*input.header(), missing);
            publish(self.work.work(&input, header));
        }
    }

    fn sequence(&self) -> &Sequence {
        &self.sequence
    }
}

/// A stream in the order of ticks: what is next, what is missing, what came again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Sequence {
    /// The tick that comes next when nothing is lost.
    pub next_tick: u64,
    /// Ticks in the stream.
    pub ticks: u64,
    /// Ticks that never came.
    pub lost: u64,
    /// Messages left out because they came again, or too late.
    pub duplicated: u64,
}

impl Sequence {
    /// Admits a tick to the stream and tells how many before it are missing; `None` for one that has had its turn.
    pub fn admit(&mut self, tick: u64) -> Option<u64> {
        let Some(missing) = tick.checked_sub(self.next_tick) else {
            self.duplicated += 1;
            return None;
        };
        self.lost += missing;
        self.ticks += 1;
        self.next_tick = tick.saturating_add(1);
        Some(missing)
    }

    /// A header of the tick just admitted that says what is missing before it.
    pub fn mark(&self, header: Header, missing: u64) -> Header {
        let flags = header.flags | Flags::LOST_BEFORE.when(missing > 0);
        Header { lost_upstream: self.lost, flags, ..header }
    }
}

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
    first: VecDeque<A>,
    second: VecDeque<B>,
    lateness_ticks: u64,
    sequence: Sequence,
}

impl<A: Ticked, B: Ticked> Join<A, B> {
    /// A join that waits for `lateness_ticks`.
    pub fn new(lateness_ticks: u64) -> Self {
        Self { first: VecDeque::new(), second: VecDeque::new(), lateness_ticks, sequence: Sequence::default() }
    }

    /// Takes a message of the first input.
    pub fn offer_first(&mut self, message: A) {
        offer(&mut self.first, message, &mut self.sequence);
    }

    /// Takes a message of the second input.
    pub fn offer_second(&mut self, message: B) {
        offer(&mut self.second, message, &mut self.sequence);
    }

    /// The next complete tick.
    pub fn take(&mut self) -> Option<Joined<A, B>> {
        let (first, second) = (front(&self.first), front(&self.second));
        let tick = match (first, second) {
            (Some(first), Some(second)) => first.min(second),
            (Some(tick), None) => self.overdue(tick, back(&self.first))?,
            (None, Some(tick)) => self.overdue(tick, back(&self.second))?,
            (None, None) => return None,
        };
        let missing = self.sequence.admit(tick)?;
        Some(Joined {
            missing,
            first: self.first.pop_front_if(|message| message.header().tick == tick),
            second: self.second.pop_front_if(|message| message.header().tick == tick),
        })
    }

    /// Which input the next tick waits for: 1 for the second while only the first is there, else 0.
    pub fn lacks(&self) -> usize {
        usize::from(!self.first.is_empty() && self.second.is_empty())
    }

    /// The joined stream, so far.
    pub fn sequence(&self) -> &Sequence {
        &self.sequence
    }

    fn overdue(&self, tick: u64, newest: Option<u64>) -> Option<u64> {
        newest.filter(|newest| newest - tick >= self.lateness_ticks).map(|_| tick)
    }
}

fn offer<M: Ticked>(queue: &mut VecDeque<M>, message: M, sequence: &mut Sequence) {
    let tick = message.header().tick;
    if tick < sequence.next_tick || back(queue).is_some_and(|newest| tick <= newest) {
        sequence.duplicated += 1;
        return;
    }
    queue.push_back(message);
}

fn front<M: Ticked>(queue: &VecDeque<M>) -> Option<u64> {
    queue.front().map(|message| message.header().tick)
}

fn back<M: Ticked>(queue: &VecDeque<M>) -> Option<u64> {
    queue.back().map(|message| message.header().tick)
}

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
    fn ticks_missing_on_both_sides_are_counted_and_repeats_left_out() {
        let mut join = Join::new(10);
        for tick in [0, 0, 4, 3] {
            join.offer_first(gyro(tick));
            join.offer_second(accel(tick));
        }
        assert_eq!(drain(&mut join), [(0, true, true, 0), (4, true, true, 3)]);
        assert_eq!(*join.sequence(), Sequence { next_tick: 5, ticks: 2, lost: 3, duplicated: 4 });
    }
}
