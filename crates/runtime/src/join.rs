//! Joins several inputs into one stream, ordered by tick and independent of the order of arrival.
//!
//! - Input: the messages of each input in tick order. The inputs may interleave in any way.
//! - Output: ticks in order, each with the messages that belong to it.
//! - Time: no clock is read. Waiting is measured in ticks, so that a replay makes the same
//!   decisions. The times of publication determine only which input a service sleeps on.
//! - Failure: a missing message is skipped, counted and reported.
//!
//! A *dense* input has a message for every tick. A *sparse* input has one only for ticks that carry
//! its flag (see the table of [`graph`]). A tick is complete when every dense input, and every
//! sparse input named by the tick's flags, has delivered or skipped the tick or is absent. An
//! incomplete tick is released once any dense input is `lateness_ticks` ahead of it.

use std::collections::VecDeque;

use messages::{Flags, Ticked};
use swap::Sequence;

/// Maximum number of messages queued per input, which is the capacity of a topic.
pub const MAX_QUEUED: usize = launch::MAX_TOPIC_MESSAGES;

/// Message that can be joined.
pub trait TickStamped {
    /// Returns the tick that the message belongs to.
    fn tick(&self) -> u64;
    /// Returns the flags of the tick that the message belongs to.
    fn flags(&self) -> Flags;
    /// Returns the incarnation of the publisher.
    fn publisher(&self) -> u32;
    /// Returns the time of publication, CLOCK_MONOTONIC, ns.
    fn t_sent_ns(&self) -> u64;
}

impl<M: Ticked> TickStamped for M {
    fn tick(&self) -> u64 {
        self.header().tick
    }

    fn flags(&self) -> Flags {
        self.header().flags
    }

    fn publisher(&self) -> u32 {
        self.header().incarnation
    }

    fn t_sent_ns(&self) -> u64 {
        self.header().t_sent_ns
    }
}

/// Input queue of a join.
#[derive(Debug, Clone)]
pub struct JoinInput<M> {
    queue: VecDeque<M>,
    /// Flag set in ticks that have a message on this input; [`Flags::NONE`] for a dense input.
    flag: Flags,
    /// Tick after the newest one received.
    next_tick: u64,
    /// Publisher of the newest message.
    publisher: u32,
    /// First tick for which the input has no publisher; `u64::MAX` while it has one.
    absent_from: u64,
    /// Time at which the newest message was published, ns.
    t_sent_ns: u64,
}

impl<M: Ticked> Default for JoinInput<M> {
    fn default() -> Self {
        Self::new(M::FLAG)
    }
}

impl<M> JoinInput<M> {
    /// Creates a sparse input for ticks with `flag`, or a dense input if `flag` is
    /// [`Flags::NONE`].
    pub fn new(flag: Flags) -> Self {
        Self { queue: VecDeque::new(), flag, next_tick: 0, publisher: 0, absent_from: u64::MAX, t_sent_ns: 0 }
    }

    /// Sets the first tick for which the input has no publisher; `u64::MAX` if it has one.
    pub fn set_absent_from(&mut self, tick: u64) {
        self.absent_from = tick;
    }
}

impl<M: TickStamped> JoinInput<M> {
    /// Returns the status, from which the join determines the next tick.
    pub fn status(&self) -> InputStatus {
        let Self { flag, next_tick, absent_from, t_sent_ns, .. } = *self;
        let front = self.queue.front().map(|message| (message.tick(), message.flags()));
        InputStatus { flag, next_tick, absent_from, t_sent_ns, front, is_full: self.queue.len() >= MAX_QUEUED }
    }

    /// Removes and returns the message of `tick`, discarding older messages.
    pub fn take(&mut self, tick: u64) -> Option<M> {
        while self.queue.pop_front_if(|message| message.tick() < tick).is_some() {}
        self.queue.pop_front_if(|message| message.tick() == tick)
    }

    fn offer(&mut self, message: M, sequence: &mut Sequence) {
        let (tick, publisher) = (message.tick(), message.publisher());
        if tick < sequence.next_tick.max(self.next_tick) {
            return sequence.reject(publisher == self.publisher);
        }
        // Only a sparse queue needs a limit, which is the capacity of a topic. A dense queue does
        // not exceed it: once the queue is full, the next tick is overdue, so the queue is drained.
        if self.flag != Flags::NONE && self.queue.len() >= MAX_QUEUED {
            return;
        }
        (self.next_tick, self.publisher, self.t_sent_ns) = (tick.saturating_add(1), publisher, message.t_sent_ns());
        self.queue.push_back(message);
    }
}

/// State of an input of a join.
#[derive(Debug, Clone, Copy)]
pub struct InputStatus {
    flag: Flags,
    next_tick: u64,
    absent_from: u64,
    t_sent_ns: u64,
    front: Option<(u64, Flags)>,
    is_full: bool,
}

impl InputStatus {
    /// Returns `true` if the input has a message for every tick.
    pub fn is_dense(&self) -> bool {
        self.flag == Flags::NONE
    }

    /// Returns the tick of the oldest queued message.
    pub fn front_tick(&self) -> Option<u64> {
        self.front.map(|(tick, _)| tick)
    }

    /// Returns the tick after the newest one received.
    pub fn next_tick(&self) -> u64 {
        self.next_tick
    }

    /// Returns `true` if a message for `tick` can still arrive.
    fn may_deliver(&self, tick: u64) -> bool {
        self.next_tick <= tick && tick < self.absent_from
    }
}

/// Inputs of a join.
pub trait JoinInputs {
    /// Messages of one tick.
    type Tick;
    /// Calls `visit` with the status of each input, in the order in which the service lists them.
    fn each(&self, visit: &mut impl FnMut(InputStatus));
    /// Removes and returns the messages of `tick`, discarding older messages.
    fn take(&mut self, tick: u64) -> Self::Tick;
}

/// Defines the inputs of a slot, and the messages of one tick.
#[macro_export]
macro_rules! join_inputs {
    ($(#[$about:meta])* $inputs:ident => $tick:ident { $($input:ident: $message:ty,)* }) => {
        $(#[$about])*
        #[derive(Debug, Clone, Default)]
        struct $inputs { $($input: $crate::JoinInput<$message>,)* }

        /// Messages of one tick; `None` for each input that has no message.
        #[derive(Debug, Clone, Copy)]
        struct $tick { $($input: Option<$message>,)* }

        impl $inputs {
            /// Names of the topics, in the order in which the service lists its inputs.
            #[cfg(test)]
            #[allow(dead_code, reason = "for a test that compares them with the graph's")]
            const TOPICS: &'static [&'static str] = &[$(<$message as messages::Message>::TOPIC.name),*];
        }

        impl $crate::JoinInputs for $inputs {
            type Tick = $tick;

            #[inline]
            fn each(&self, visit: &mut impl FnMut($crate::join::InputStatus)) {
                $(visit(self.$input.status());)*
            }

            fn take(&mut self, tick: u64) -> $tick {
                $tick { $($input: self.$input.take(tick)),* }
            }
        }
    };
}

/// Join of several inputs by tick.
#[derive(Debug, Clone)]
pub struct Join<I> {
    inputs: I,
    lateness_ticks: u64,
    /// End of the backlog: earlier ticks have been published and may still be in delivery.
    backlog_end: u64,
    /// The backlog is given up as soon as a dense input reaches this tick.
    backlog_deadline: u64,
    emits_empty_ticks: bool,
    sequence: Sequence,
}

/// One tick of the joined stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Joined<T> {
    /// Number of the tick.
    pub tick: u64,
    /// Number of ticks missing before this one.
    pub missing: u64,
    /// Messages of the tick.
    pub messages: T,
}

impl<I: JoinInputs> Join<I> {
    /// Creates a join that waits `lateness_ticks` for a missing message.
    pub fn new(inputs: I, lateness_ticks: u64) -> Self {
        let sequence = Sequence::default();
        Self { inputs, lateness_ticks, backlog_end: 0, backlog_deadline: 0, emits_empty_ticks: false, sequence }
    }

    /// Creates a join that also emits ticks for which no input has a message. A series of such
    /// ticks is skipped if it is longer than the capacity of a topic.
    pub fn with_empty_ticks(inputs: I, lateness_ticks: u64) -> Self {
        Self { emits_empty_ticks: true, ..Self::new(inputs, lateness_ticks) }
    }

    /// Declares that all ticks before `tick` have been published.
    ///
    /// A missing tick of this backlog is given up only once a dense input has reached the tick
    /// `patience_ticks` after the end of the backlog.
    pub fn expect_backlog(&mut self, tick: u64, patience_ticks: u64) {
        (self.backlog_end, self.backlog_deadline) = (tick, tick.saturating_add(patience_ticks));
    }

    /// Starts the joined stream at `tick`. Earlier messages are discarded.
    pub fn start_at(&mut self, tick: u64) {
        if let Some(before) = tick.checked_sub(1) {
            self.inputs.take(before);
        }
        self.sequence.next_tick = tick;
    }

    /// Returns the inputs.
    pub fn inputs(&self) -> &I {
        &self.inputs
    }

    /// Returns a mutable reference to the inputs, for changing which of them have a publisher.
    pub fn inputs_mut(&mut self) -> &mut I {
        &mut self.inputs
    }

    /// Queues a message at the input that `select` returns, or discards the message if `select`
    /// returns `None`.
    pub fn offer<M: TickStamped>(&mut self, select: impl FnOnce(&mut I) -> Option<&mut JoinInput<M>>, message: M) {
        if let Some(input) = select(&mut self.inputs) {
            input.offer(message, &mut self.sequence);
        }
        if self.sequence.next_tick < self.backlog_end {
            self.extend_backlog();
        }
    }

    /// Extends the backlog to the newest tick of any dense input while an awaited input has not
    /// delivered its first message.
    ///
    /// Until then, all messages of the awaited input may still be in delivery.
    fn extend_backlog(&mut self) {
        let (mut newest_next, mut flags, mut is_silent) = (0, Flags::NONE, false);
        self.inputs.each(&mut |input| {
            if input.is_dense() {
                newest_next = newest_next.max(input.next_tick);
                flags |= input.front.map_or(Flags::NONE, |(_, flags)| flags);
            }
        });
        let tick = self.sequence.next_tick;
        self.inputs.each(&mut |input| {
            is_silent |= input.next_tick == 0 && input.may_deliver(tick) && (input.is_dense() || flags.any(input.flag));
        });
        if is_silent {
            self.backlog_end = self.backlog_end.max(newest_next);
        }
    }

    /// Returns the next tick once every input has delivered it or has been given up.
    #[allow(clippy::should_implement_trait, reason = "`None` means not yet, which an iterator would take for the end")]
    pub fn next(&mut self) -> Option<Joined<I::Tick>> {
        let tick = self.next_due().ok()?;
        let missing = self.sequence.advance(tick);
        Some(Joined { tick, missing, messages: self.inputs.take(tick) })
    }

    /// Returns the index of the input that the next tick is waiting for.
    pub fn awaited_input(&self) -> usize {
        self.next_due().err().unwrap_or(0)
    }

    /// Returns `true` if an input has a message for a tick that is not complete yet.
    pub fn has_incomplete_tick(&self) -> bool {
        let mut has_message = false;
        self.inputs.each(&mut |input| has_message |= input.front.is_some());
        has_message
    }

    /// Returns the position and counters of the joined stream.
    pub fn sequence(&self) -> &Sequence {
        &self.sequence
    }

    /// Returns a mutable reference to the position and counters, for restoring them.
    pub fn sequence_mut(&mut self) -> &mut Sequence {
        &mut self.sequence
    }

    /// Returns the next tick to release, or the index of the input that it waits for.
    fn next_due(&self) -> Result<u64, usize> {
        let (mut newest, mut first, mut is_full) = (None, None, false);
        // Finds the dense input that is furthest behind among those that have a publisher. If
        // several are at the same tick, it is the one with the earliest message. The service is
        // then awake when the others publish the next tick.
        let (mut index, mut slowest) = (0, None);
        self.inputs.each(&mut |input| {
            is_full |= input.is_full;
            if input.is_dense() {
                newest = newest.max(input.next_tick.checked_sub(1));
                first = [first, input.front_tick()].into_iter().flatten().min();
                let position = (input.next_tick, input.t_sent_ns);
                let is_published = input.next_tick < input.absent_from;
                if is_published && slowest.is_none_or(|(least, _)| position < least) {
                    slowest = Some((position, index));
                }
            }
            index += 1;
        });
        let slowest = slowest.map_or(0, |(_, index)| index);
        let empty = Some(self.sequence.next_tick).filter(|_| self.emits_empty_ticks);
        // Without this limit, a tick far ahead, such as one from another host, would cause an
        // almost endless series of empty ticks.
        let is_emitted = |empty: &u64| first.is_none_or(|first| first.saturating_sub(*empty) <= MAX_QUEUED as u64);
        let next = empty.filter(is_emitted).or(first);
        let Some((tick, newest)) = next.zip(newest).filter(|(tick, newest)| tick <= newest) else {
            return Err(slowest);
        };
        if is_full || self.is_overdue(tick, newest) {
            return Ok(tick);
        }
        let (mut flags, mut awaits_dense) = (Flags::NONE, false);
        self.inputs.each(&mut |input| {
            if input.is_dense() {
                awaits_dense |= input.may_deliver(tick);
                flags |= input.front.filter(|(front, _)| *front == tick).map_or(Flags::NONE, |(_, flags)| flags);
            }
        });
        if awaits_dense {
            return Err(slowest);
        }
        let (mut index, mut awaited) = (0, None);
        self.inputs.each(&mut |input| {
            if flags.any(input.flag) && input.may_deliver(tick) {
                awaited = awaited.or(Some(index));
            }
            index += 1;
        });
        awaited.map_or(Ok(tick), Err)
    }

    fn is_overdue(&self, tick: u64, newest: u64) -> bool {
        let in_backlog = tick < self.backlog_end && newest < self.backlog_deadline;
        newest - tick >= self.lateness_ticks && !in_backlog
    }
}

#[cfg(test)]
mod tests {
    use messages::{AccelPoint, GnssFix, GyroStep, Header, MagSample};

    use super::*;

    join_inputs! {
        Inputs => Tick { gyro: GyroStep, accel: AccelPoint, mag: MagSample, gnss: GnssFix, }
    }

    fn join(lateness_ticks: u64) -> Join<Inputs> {
        Join::new(Inputs::default(), lateness_ticks)
    }

    fn header(tick: u64, flags: Flags) -> Header {
        Header { tick, flags, ..bytemuck::Zeroable::zeroed() }
    }

    impl Join<Inputs> {
        fn gyro(&mut self, tick: u64, flags: Flags) {
            let message = GyroStep { header: header(tick, flags), ..bytemuck::Zeroable::zeroed() };
            self.offer(|inputs| Some(&mut inputs.gyro), message);
        }

        fn accel(&mut self, tick: u64, flags: Flags) {
            let message = AccelPoint { header: header(tick, flags), ..bytemuck::Zeroable::zeroed() };
            self.offer(|inputs| Some(&mut inputs.accel), message);
        }

        fn mag(&mut self, tick: u64) {
            let message = MagSample { header: header(tick, Flags::FIELD), ..bytemuck::Zeroable::zeroed() };
            self.offer(|inputs| Some(&mut inputs.mag), message);
        }

        fn gnss(&mut self, tick: u64) {
            let message = GnssFix { header: header(tick, Flags::FIX), ..bytemuck::Zeroable::zeroed() };
            self.offer(|inputs| Some(&mut inputs.gnss), message);
        }

        /// Returns all ticks that can be released. Each entry contains the tick, the inputs with a
        /// message, and the number of ticks missing before it.
        fn drain(&mut self) -> Vec<(u64, &'static str, u64)> {
            let name = |Tick { gyro, accel, mag, gnss }: &Tick| match (gyro, accel, mag, gnss) {
                (Some(_), Some(_), None, None) => "both",
                (Some(_), Some(_), Some(_), None) => "both, mag",
                (Some(_), Some(_), None, Some(_)) => "both, gnss",
                (Some(_), Some(_), Some(_), Some(_)) => "all",
                (Some(_), None, ..) => "gyro",
                (None, Some(_), ..) => "accel",
                (None, None, ..) => "none",
            };
            std::iter::from_fn(|| self.next())
                .map(|joined| (joined.tick, name(&joined.messages), joined.missing))
                .collect()
        }
    }

    const NONE: Flags = Flags::NONE;

    /// Returns the flags of a tick: the flag `field` on every third tick, and `fix` on every fifth.
    fn flags(tick: u64) -> Flags {
        Flags::FIELD.when(tick.is_multiple_of(3)) | Flags::FIX.when(tick.is_multiple_of(5))
    }

    #[test]
    fn join_output_is_independent_of_arrival_order() {
        const TICKS: u64 = 60;
        let expected = |tick| match [Flags::FIELD, Flags::FIX].map(|flag| flags(tick).any(flag)) {
            [false, false] => (tick, "both", 0),
            [true, false] => (tick, "both, mag", 0),
            [false, true] => (tick, "both, gnss", 0),
            [true, true] => (tick, "all", 0),
        };
        let expected: Vec<_> = (0..TICKS).map(expected).collect();
        for seed in 1..200_u64 {
            let (mut join, mut state, mut next, mut out) = (join(1000), seed, [0; 4], Vec::new());
            while next.iter().any(|next| *next < TICKS) {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                let input = (state >> 33) as usize % 4;
                let tick = next[input];
                if tick >= TICKS {
                    continue;
                }
                next[input] += 1;
                match input {
                    0 => join.gyro(tick, flags(tick)),
                    1 => join.accel(tick, flags(tick)),
                    2 if flags(tick).any(Flags::FIELD) => join.mag(tick),
                    3 if flags(tick).any(Flags::FIX) => join.gnss(tick),
                    _ => {}
                }
                out.extend(join.drain());
            }
            assert_eq!(out, expected, "seed {seed}");
        }
    }

    #[test]
    fn join_gives_up_silent_input_after_lateness() {
        let mut join = join(10);
        (0..10).for_each(|tick| join.gyro(tick, NONE));
        assert_eq!((join.drain(), join.awaited_input()), (vec![], 1));
        join.gyro(10, NONE);
        assert_eq!(join.drain(), [(0, "gyro", 0)]);
        join.accel(0, NONE);
        assert_eq!(join.sequence().duplicated, 1, "a late message is dropped");
        join.accel(1, NONE);
        assert_eq!(join.drain(), [(1, "both", 0)]);
    }

    #[test]
    fn join_awaits_the_input_that_was_published_first() {
        let mut join = join(1000);
        let gyro = |join: &mut Join<Inputs>, tick, t_sent_ns| {
            let header = Header { t_sent_ns, ..header(tick, NONE) };
            join.offer(|inputs| Some(&mut inputs.gyro), GyroStep { header, ..bytemuck::Zeroable::zeroed() });
        };
        let accel = |join: &mut Join<Inputs>, tick, t_sent_ns| {
            let header = Header { t_sent_ns, ..header(tick, NONE) };
            join.offer(|inputs| Some(&mut inputs.accel), AccelPoint { header, ..bytemuck::Zeroable::zeroed() });
        };
        gyro(&mut join, 0, 20);
        accel(&mut join, 0, 10);
        assert_eq!((join.drain(), join.awaited_input()), (vec![(0, "both", 0)], 1));
        assert!(!join.has_incomplete_tick());
        gyro(&mut join, 1, 30);
        assert_eq!((join.drain(), join.awaited_input()), (vec![], 1), "accel is behind");
        assert!(join.has_incomplete_tick());
        accel(&mut join, 1, 40);
        assert_eq!((join.drain(), join.awaited_input()), (vec![(1, "both", 0)], 0));
        accel(&mut join, 2, 50);
        assert_eq!((join.drain(), join.awaited_input()), (vec![], 0), "gyro is behind");
    }

    #[test]
    fn join_does_not_wait_for_skipped_tick() {
        let mut join = join(1000);
        join.gyro(0, NONE);
        join.gyro(1, NONE);
        join.accel(1, NONE);
        assert_eq!(join.drain(), [(0, "gyro", 0), (1, "both", 0)]);
    }

    #[test]
    fn join_does_not_wait_for_absent_input() {
        let mut join = join(1000);
        (0..4).for_each(|tick| join.gyro(tick, NONE));
        join.accel(0, NONE);
        join.inputs_mut().accel.set_absent_from(2);
        assert_eq!(join.drain(), [(0, "both", 0)], "1 may still come");
        join.accel(1, NONE);
        assert_eq!(join.drain(), [(1, "both", 0), (2, "gyro", 0), (3, "gyro", 0)]);
        assert_eq!(join.awaited_input(), 0, "an absent input is not awaited");
        join.inputs_mut().accel.set_absent_from(u64::MAX);
        join.gyro(4, NONE);
        assert_eq!((join.drain(), join.awaited_input()), (vec![], 1));
    }

    #[test]
    fn join_waits_for_sparse_input_only_at_flagged_ticks() {
        let mut join = join(10);
        let both = |join: &mut Join<Inputs>, tick, flags| {
            join.gyro(tick, flags);
            join.accel(tick, NONE);
        };
        both(&mut join, 0, NONE);
        assert_eq!(join.drain(), [(0, "both", 0)]);
        both(&mut join, 1, Flags::FIELD | Flags::FIX);
        assert_eq!((join.drain(), join.awaited_input()), (vec![], 2));
        join.mag(1);
        assert_eq!((join.drain(), join.awaited_input()), (vec![], 3));
        join.gnss(4);
        assert_eq!(join.drain(), [(1, "both, mag", 0)], "gnss skipped tick 1");
        (2..5).for_each(|tick| both(&mut join, tick, Flags::FIX.when(tick == 4)));
        assert_eq!(join.drain(), [(2, "both", 0), (3, "both", 0), (4, "both, gnss", 0)]);
        (5..15).for_each(|tick| both(&mut join, tick, Flags::FIELD.when(tick == 5)));
        assert_eq!((join.drain(), join.awaited_input()), (vec![], 2));
        both(&mut join, 15, NONE);
        assert_eq!(join.drain().first(), Some(&(5, "both", 0)), "mag is given up");
    }

    #[test]
    fn join_gives_up_backlog_after_patience() {
        let mut join = join(10);
        join.expect_backlog(20, 50);
        (0..70).for_each(|tick| join.gyro(tick, NONE));
        assert_eq!(join.drain(), []);
        join.gyro(70, NONE);
        assert_eq!(join.drain().last(), Some(&(60, "gyro", 0)));
    }

    #[test]
    fn join_waits_for_history_of_silent_dense_input() {
        let mut join = join(10);
        join.expect_backlog(5, 1000);
        (0..40).for_each(|tick| join.gyro(tick, NONE));
        assert_eq!(join.drain(), []);
        for tick in 0..40 {
            join.accel(tick, NONE);
            assert_eq!(join.drain(), [(tick, "both", 0)]);
        }
        (40..51).for_each(|tick| join.gyro(tick, NONE));
        assert_eq!(join.drain(), [(40, "gyro", 0)], "accel has delivered and is given up as usual");
    }

    #[test]
    fn join_waits_for_history_of_flagged_sparse_input() {
        let mut join = join(10);
        join.expect_backlog(5, 1000);
        for tick in 0..40 {
            join.gyro(tick, flags(tick));
            join.accel(tick, flags(tick));
            assert_eq!(join.drain(), []);
        }
        (0..40).filter(|tick| flags(*tick).any(Flags::FIX)).for_each(|tick| join.gnss(tick));
        (0..40).filter(|tick| flags(*tick).any(Flags::FIELD)).for_each(|tick| join.mag(tick));
        assert_eq!(join.drain().len(), 40);
        assert_eq!(join.sequence().lost, 0);
    }

    #[test]
    fn join_with_empty_ticks_emits_every_tick() {
        let mut join = Join::with_empty_ticks(Inputs::default(), 1000);
        [3, 4, 7].into_iter().for_each(|tick| join.gyro(tick, flags(tick)));
        [2, 4, 7].into_iter().for_each(|tick| join.accel(tick, flags(tick)));
        join.start_at(4);
        assert_eq!(join.drain(), [(4, "both", 0), (5, "none", 0), (6, "none", 0), (7, "both", 0)]);
        assert_eq!(join.sequence().lost, 0);
    }

    #[test]
    fn join_counts_lost_ticks_and_drops_repeats() {
        let mut join = join(10);
        for tick in [0, 0, 4, 3] {
            join.gyro(tick, NONE);
            join.accel(tick, NONE);
        }
        assert_eq!(join.drain(), [(0, "both", 0), (4, "both", 3)]);
        assert_eq!(
            *join.sequence(),
            Sequence { next_tick: 5, ticks: 2, lost: 3, duplicated: 4, repeated: 0, publisher: 0 }
        );
    }

    #[test]
    fn empty_ticks_end_at_a_gap_longer_than_a_topic() {
        for (gap, ticks) in [(MAX_QUEUED as u64 - 1, MAX_QUEUED + 1), (1 << 60, 2)] {
            let mut join = Join::with_empty_ticks(Inputs::default(), 20);
            for tick in [0, 1 + gap] {
                join.gyro(tick, Flags::NONE);
                join.accel(tick, Flags::NONE);
            }
            let emitted: Vec<_> = std::iter::from_fn(|| join.next()).take(2 * MAX_QUEUED).collect();
            let missing: u64 = emitted.iter().map(|joined| joined.missing).sum();
            assert_eq!((emitted.len(), missing), (ticks, if ticks == 2 { gap } else { 0 }), "{gap}");
        }
    }

    #[test]
    fn join_queue_is_bounded_by_topic_capacity() {
        let mut join = join(u64::MAX);
        (0..2 * MAX_QUEUED as u64).for_each(|tick| join.mag(tick));
        assert_eq!(join.inputs().mag.queue.len(), MAX_QUEUED);
        (0..2 * MAX_QUEUED as u64).for_each(|tick| {
            join.gyro(tick, NONE);
            while join.next().is_some() {}
        });
        assert!(join.inputs().gyro.queue.len() <= MAX_QUEUED);
    }
}
