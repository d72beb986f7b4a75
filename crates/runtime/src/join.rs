//! Several inputs become one stream, by tick and never by arrival.
//!
//! Input: messages of each input in the order of ticks, the inputs in whatever order they arrive. Output: the ticks in order, each with
//! what there is of it. Time: none; how long to wait is counted in ticks, so that a replay decides alike. Failure: what stays away is left
//! out, counted and said.
//!
//! An input has a message of every tick, or of those whose flags say so: which it is stands in the table of [`graph`]. A tick is complete
//! when each input of every tick has brought it, has passed it, or is absent, and each other input that its flags name has, too. It goes on
//! incomplete once the newest tick of any input is `lateness_ticks` ahead of it.

use std::collections::VecDeque;

use messages::{Flags, Ticked};
use swap::Sequence;

/// Messages of an input that wait for their tick at most: as many as a topic holds.
pub const QUEUE_MAX: usize = launch::TOPIC_MESSAGES_MAX;

/// What a join must know of a message.
pub trait Placed {
    /// The tick that it comes from.
    fn tick(&self) -> u64;
    /// The tick's flags.
    fn flags(&self) -> Flags;
    /// The incarnation of its publisher.
    fn sender(&self) -> u32;
}

impl<M: Ticked> Placed for M {
    fn tick(&self) -> u64 {
        self.header().tick
    }

    fn flags(&self) -> Flags {
        self.header().flags
    }

    fn sender(&self) -> u32 {
        self.header().incarnation
    }
}

/// One input: its messages that wait for their tick.
#[derive(Debug, Clone)]
pub struct Lane<M> {
    queue: VecDeque<M>,
    /// Of the ticks that have a message; none where every tick has.
    flag: Flags,
    /// The tick after the newest that came.
    next_tick: u64,
    /// The incarnation that sent it.
    sender: u32,
    /// From this tick on nobody publishes the input.
    absent_from: u64,
}

impl<M: Ticked> Default for Lane<M> {
    fn default() -> Self {
        Self::new(M::FLAG)
    }
}

impl<M> Lane<M> {
    /// An input with a message of each tick that has `flag`; of every tick where that is none.
    pub fn new(flag: Flags) -> Self {
        Self { queue: VecDeque::new(), flag, next_tick: 0, sender: 0, absent_from: u64::MAX }
    }

    /// From `tick` on nobody publishes it; `u64::MAX` where somebody does.
    pub fn is_absent_from(&mut self, tick: u64) {
        self.absent_from = tick;
    }
}

impl<M: Placed> Lane<M> {
    /// How it stands.
    pub fn look(&self) -> Look {
        let Self { flag, next_tick, absent_from, .. } = *self;
        let front = self.queue.front().map(|message| (message.tick(), message.flags()));
        Look { flag, next_tick, absent_from, front, is_full: self.queue.len() >= QUEUE_MAX }
    }

    /// The message of this tick, if it has come; older ones go.
    pub fn take(&mut self, tick: u64) -> Option<M> {
        while self.queue.pop_front_if(|message| message.tick() < tick).is_some() {}
        self.queue.pop_front_if(|message| message.tick() == tick)
    }

    fn offer(&mut self, message: M, sequence: &mut Sequence) {
        let (tick, sender) = (message.tick(), message.sender());
        if tick < sequence.next_tick.max(self.next_tick) {
            return sequence.refuse(sender == self.sender);
        }
        // Where every tick has one a full queue is overdue and empties; the others wait for no more than a topic holds.
        if self.flag != Flags::NONE && self.queue.len() >= QUEUE_MAX {
            return;
        }
        (self.next_tick, self.sender) = (tick.saturating_add(1), sender);
        self.queue.push_back(message);
    }
}

/// How an input stands.
#[derive(Debug, Clone, Copy)]
pub struct Look {
    flag: Flags,
    next_tick: u64,
    absent_from: u64,
    front: Option<(u64, Flags)>,
    is_full: bool,
}

impl Look {
    /// It has a message of every tick.
    pub fn is_dense(&self) -> bool {
        self.flag == Flags::NONE
    }

    /// The oldest tick that waits.
    pub fn front_tick(&self) -> Option<u64> {
        self.front.map(|(tick, _)| tick)
    }

    /// The tick after the newest that came.
    pub fn next_tick(&self) -> u64 {
        self.next_tick
    }

    /// It may still bring the tick.
    fn brings(&self, tick: u64) -> bool {
        self.next_tick <= tick && tick < self.absent_from
    }
}

/// The inputs of a join.
pub trait Lanes {
    /// What there is of one tick.
    type Tick;
    /// Looks at each, in the order of a service's inputs.
    fn each(&self, look: &mut impl FnMut(Look));
    /// Takes what there is of a tick.
    fn take(&mut self, tick: u64) -> Self::Tick;
}

/// Defines the inputs of a slot, and what there is of one tick of them.
#[macro_export]
macro_rules! lanes {
    ($(#[$about:meta])* $lanes:ident => $tick:ident { $($lane:ident: $message:ty,)* }) => {
        $(#[$about])*
        #[derive(Debug, Clone, Default)]
        struct $lanes { $($lane: $crate::Lane<$message>,)* }

        /// What there is of one tick.
        #[derive(Debug, Clone, Copy)]
        struct $tick { $($lane: Option<$message>,)* }

        impl $lanes {
            /// The topics, in the order in which the service reads them.
            #[cfg(test)]
            #[allow(dead_code, reason = "for a test that compares them with the graph's")]
            const TOPICS: &'static [&'static str] = &[$(<$message as messages::Message>::TOPIC.name),*];
        }

        impl $crate::Lanes for $lanes {
            type Tick = $tick;

            #[inline]
            fn each(&self, look: &mut impl FnMut($crate::join::Look)) {
                $(look(self.$lane.look());)*
            }

            fn take(&mut self, tick: u64) -> $tick {
                $tick { $($lane: self.$lane.take(tick)),* }
            }
        }
    };
}

/// Joins inputs by tick.
#[derive(Debug, Clone)]
pub struct Join<L> {
    lanes: L,
    lateness_ticks: u64,
    /// Before this tick everything is on its way, as it was published once,
    expected_until: u64,
    /// and is given up when the newest tick is this.
    given_up_at: u64,
    fills_gaps: bool,
    sequence: Sequence,
}

/// A tick of the joined stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Joined<T> {
    /// Which one.
    pub tick: u64,
    /// Ticks missing before it.
    pub missing: u64,
    /// What there is of it.
    pub parts: T,
}

impl<L: Lanes> Join<L> {
    /// A join that waits for `lateness_ticks`.
    pub fn new(lanes: L, lateness_ticks: u64) -> Self {
        let sequence = Sequence::default();
        Self { lanes, lateness_ticks, expected_until: 0, given_up_at: 0, fills_gaps: false, sequence }
    }

    /// A join that gives ticks, too, of which there is nothing.
    pub fn without_gaps(lanes: L, lateness_ticks: u64) -> Self {
        Self { fills_gaps: true, ..Self::new(lanes, lateness_ticks) }
    }

    /// Before `tick` everything was published once: it is given up only when an input is `patience_ticks` beyond that.
    pub fn expect_until(&mut self, tick: u64, patience_ticks: u64) {
        (self.expected_until, self.given_up_at) = (tick, tick.saturating_add(patience_ticks));
    }

    /// The joined stream begins with `tick`; what came of earlier ones is left out.
    pub fn begin_with(&mut self, tick: u64) {
        if let Some(before) = tick.checked_sub(1) {
            self.lanes.take(before);
        }
        self.sequence.next_tick = tick;
    }

    /// The inputs.
    pub fn lanes(&self) -> &L {
        &self.lanes
    }

    /// The inputs, for what is not a message.
    pub fn lanes_mut(&mut self) -> &mut L {
        &mut self.lanes
    }

    /// Takes a message of the input that `lane` names.
    pub fn offer<M: Placed>(&mut self, lane: impl FnOnce(&mut L) -> Option<&mut Lane<M>>, message: M) {
        if let Some(lane) = lane(&mut self.lanes) {
            lane.offer(message, &mut self.sequence);
        }
        if self.sequence.next_tick < self.expected_until {
            self.expect_history();
        }
    }

    /// As long as an input has brought nothing, all that it holds for those who come late is on its way: up to the newest of the others.
    fn expect_history(&mut self) {
        let (mut newest_next, mut flags, mut is_silent) = (0, Flags::NONE, false);
        self.lanes.each(&mut |lane| {
            if lane.is_dense() {
                newest_next = newest_next.max(lane.next_tick);
                flags |= lane.front.map_or(Flags::NONE, |(_, flags)| flags);
            }
        });
        let tick = self.sequence.next_tick;
        self.lanes.each(&mut |lane| {
            is_silent |= lane.next_tick == 0 && lane.brings(tick) && (lane.is_dense() || flags.any(lane.flag));
        });
        if is_silent {
            self.expected_until = self.expected_until.max(newest_next);
        }
    }

    /// The next tick, once it is certain what there is of it.
    pub fn take(&mut self) -> Option<Joined<L::Tick>> {
        let tick = self.due().ok()?;
        let missing = self.sequence.pass(tick);
        Some(Joined { tick, missing, parts: self.lanes.take(tick) })
    }

    /// Which input the next tick waits for: its place among them.
    pub fn lacks(&self) -> usize {
        self.due().err().unwrap_or(0)
    }

    /// The joined stream, so far.
    pub fn sequence(&self) -> &Sequence {
        &self.sequence
    }

    /// The joined stream, for a state to be put in.
    pub fn sequence_mut(&mut self) -> &mut Sequence {
        &mut self.sequence
    }

    /// The tick that has its turn, or the place of the input that is waited for.
    fn due(&self) -> Result<u64, usize> {
        let (mut newest, mut first, mut is_full) = (None, None, false);
        self.lanes.each(&mut |lane| {
            is_full |= lane.is_full;
            if lane.is_dense() {
                newest = newest.max(lane.next_tick.checked_sub(1));
                first = [first, lane.front_tick()].into_iter().flatten().min();
            }
        });
        let next = if self.fills_gaps { Some(self.sequence.next_tick) } else { first };
        let Some((tick, newest)) = next.zip(newest).filter(|(tick, newest)| tick <= newest) else {
            return Err(self.lagging());
        };
        if is_full || self.overdue(tick, newest) {
            return Ok(tick);
        }
        let (mut flags, mut lacks_dense) = (Flags::NONE, false);
        self.lanes.each(&mut |lane| {
            if lane.is_dense() {
                lacks_dense |= lane.brings(tick);
                flags |= lane.front.filter(|(front, _)| *front == tick).map_or(Flags::NONE, |(_, flags)| flags);
            }
        });
        if lacks_dense {
            return Err(self.lagging());
        }
        let (mut place, mut lacking) = (0, None);
        self.lanes.each(&mut |lane| {
            if flags.any(lane.flag) && lane.brings(tick) {
                lacking = lacking.or(Some(place));
            }
            place += 1;
        });
        lacking.map_or(Ok(tick), Err)
    }

    fn overdue(&self, tick: u64, newest: u64) -> bool {
        let is_expected = tick < self.expected_until && newest < self.given_up_at;
        newest - tick >= self.lateness_ticks && !is_expected
    }

    /// The input of every tick that is the furthest behind.
    fn lagging(&self) -> usize {
        let (mut place, mut lagging) = (0, None);
        self.lanes.each(&mut |lane| {
            let (next_tick, is_there) = (lane.next_tick, lane.next_tick < lane.absent_from);
            if lane.is_dense() && is_there && lagging.is_none_or(|(least, _)| next_tick < least) {
                lagging = Some((next_tick, place));
            }
            place += 1;
        });
        lagging.map_or(0, |(_, place)| place)
    }
}

#[cfg(test)]
mod tests {
    use messages::{AccelPoint, GnssFix, GyroStep, Header, MagSample};

    use super::*;

    lanes! {
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

        /// (tick, who has it, missing before)
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
            std::iter::from_fn(|| self.take())
                .map(|joined| (joined.tick, name(&joined.parts), joined.missing))
                .collect()
        }
    }

    const NONE: Flags = Flags::NONE;

    /// Which ticks have a field and a fix, in what follows.
    fn flags(tick: u64) -> Flags {
        Flags::FIELD.when(tick.is_multiple_of(3)) | Flags::FIX.when(tick.is_multiple_of(5))
    }

    #[test]
    fn order_of_arrival_does_not_matter() {
        const TICKS: u64 = 60;
        let whole = |tick| match [Flags::FIELD, Flags::FIX].map(|flag| flags(tick).any(flag)) {
            [false, false] => (tick, "both", 0),
            [true, false] => (tick, "both, mag", 0),
            [false, true] => (tick, "both, gnss", 0),
            [true, true] => (tick, "all", 0),
        };
        let whole: Vec<_> = (0..TICKS).map(whole).collect();
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
            assert_eq!(out, whole, "seed {seed}");
        }
    }

    #[test]
    fn a_silent_input_is_left_out_once_the_other_is_far_enough_ahead() {
        let mut join = join(10);
        (0..10).for_each(|tick| join.gyro(tick, NONE));
        assert_eq!((join.drain(), join.lacks()), (vec![], 1));
        join.gyro(10, NONE);
        assert_eq!(join.drain(), [(0, "gyro", 0)]);
        join.accel(0, NONE);
        assert_eq!(join.sequence().duplicated, 1, "too late is left out");
        join.accel(1, NONE);
        assert_eq!(join.drain(), [(1, "both", 0)]);
    }

    #[test]
    fn an_input_that_has_passed_a_tick_will_not_bring_it() {
        let mut join = join(1000);
        join.gyro(0, NONE);
        join.gyro(1, NONE);
        join.accel(1, NONE);
        assert_eq!(join.drain(), [(0, "gyro", 0), (1, "both", 0)]);
    }

    #[test]
    fn an_input_that_nobody_publishes_is_not_waited_for() {
        let mut join = join(1000);
        (0..4).for_each(|tick| join.gyro(tick, NONE));
        join.accel(0, NONE);
        join.lanes_mut().accel.is_absent_from(2);
        assert_eq!(join.drain(), [(0, "both", 0)], "1 may still come");
        join.accel(1, NONE);
        assert_eq!(join.drain(), [(1, "both", 0), (2, "gyro", 0), (3, "gyro", 0)]);
        assert_eq!(join.lacks(), 0, "nobody sleeps for it");
        join.lanes_mut().accel.is_absent_from(u64::MAX);
        join.gyro(4, NONE);
        assert_eq!((join.drain(), join.lacks()), (vec![], 1));
    }

    #[test]
    fn what_goes_with_some_ticks_is_waited_for_only_where_the_flags_say_so_and_not_for_ever() {
        let mut join = join(10);
        let both = |join: &mut Join<Inputs>, tick, flags| {
            join.gyro(tick, flags);
            join.accel(tick, NONE);
        };
        both(&mut join, 0, NONE);
        assert_eq!(join.drain(), [(0, "both", 0)]);
        both(&mut join, 1, Flags::FIELD | Flags::FIX);
        assert_eq!((join.drain(), join.lacks()), (vec![], 2));
        join.mag(1);
        assert_eq!((join.drain(), join.lacks()), (vec![], 3));
        join.gnss(4);
        assert_eq!(join.drain(), [(1, "both, mag", 0)], "it has been passed");
        (2..5).for_each(|tick| both(&mut join, tick, Flags::FIX.when(tick == 4)));
        assert_eq!(join.drain(), [(2, "both", 0), (3, "both", 0), (4, "both, gnss", 0)]);
        (5..15).for_each(|tick| both(&mut join, tick, Flags::FIELD.when(tick == 5)));
        assert_eq!((join.drain(), join.lacks()), (vec![], 2));
        both(&mut join, 15, NONE);
        assert_eq!(join.drain().first(), Some(&(5, "both", 0)), "too late");
    }

    #[test]
    fn what_was_published_once_is_given_up_later_and_not_never() {
        let mut join = join(10);
        join.expect_until(20, 50);
        (0..70).for_each(|tick| join.gyro(tick, NONE));
        assert_eq!(join.drain(), []);
        join.gyro(70, NONE);
        assert_eq!(join.drain().last(), Some(&(60, "gyro", 0)));
    }

    #[test]
    fn an_input_that_has_brought_nothing_yet_is_waited_for_however_far_the_others_have_come_since() {
        let mut join = join(10);
        join.expect_until(5, 1000);
        (0..40).for_each(|tick| join.gyro(tick, NONE));
        assert_eq!(join.drain(), []);
        for tick in 0..40 {
            join.accel(tick, NONE);
            assert_eq!(join.drain(), [(tick, "both", 0)]);
        }
        (40..51).for_each(|tick| join.gyro(tick, NONE));
        assert_eq!(join.drain(), [(40, "gyro", 0)], "what it has brought no longer");
    }

    #[test]
    fn an_input_of_some_ticks_that_has_brought_nothing_yet_is_waited_for_once_a_tick_says_that_it_has_one() {
        let mut join = join(10);
        join.expect_until(5, 1000);
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
    fn a_stream_without_gaps_has_every_tick_from_its_beginning() {
        let mut join = Join::without_gaps(Inputs::default(), 1000);
        [3, 4, 7].into_iter().for_each(|tick| join.gyro(tick, flags(tick)));
        [2, 4, 7].into_iter().for_each(|tick| join.accel(tick, flags(tick)));
        join.begin_with(4);
        assert_eq!(join.drain(), [(4, "both", 0), (5, "none", 0), (6, "none", 0), (7, "both", 0)]);
        assert_eq!(join.sequence().lost, 0);
    }

    #[test]
    fn ticks_missing_on_both_sides_are_counted_and_repeats_left_out() {
        let mut join = join(10);
        for tick in [0, 0, 4, 3] {
            join.gyro(tick, NONE);
            join.accel(tick, NONE);
        }
        assert_eq!(join.drain(), [(0, "both", 0), (4, "both", 3)]);
        assert_eq!(
            *join.sequence(),
            Sequence { next_tick: 5, ticks: 2, lost: 3, duplicated: 4, repeated: 0, sender: 0 }
        );
    }

    #[test]
    fn no_input_holds_more_than_a_topic() {
        let mut join = join(u64::MAX);
        (0..2 * QUEUE_MAX as u64).for_each(|tick| join.mag(tick));
        assert_eq!(join.lanes().mag.queue.len(), QUEUE_MAX);
        (0..2 * QUEUE_MAX as u64).for_each(|tick| {
            join.gyro(tick, NONE);
            while join.take().is_some() {}
        });
        assert!(join.lanes().gyro.queue.len() <= QUEUE_MAX);
    }
}
