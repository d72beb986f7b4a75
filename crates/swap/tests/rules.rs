//! The rules of a reader and of a service, one by one.

use swap::{Answer, Control, OutputGate, ReorderBuffer, Sequence, Stamped};

/// Tick, epoch, incarnation.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Tick(u64, u32, u32);

impl Stamped for Tick {
    fn tick(&self) -> u64 {
        self.0
    }

    fn epoch(&self) -> u32 {
        self.1
    }

    fn incarnation(&self) -> u32 {
        self.2
    }

    fn stamp(&mut self, epoch: u32, incarnation: u32) {
        (self.1, self.2) = (epoch, incarnation);
    }
}

/// What the reader delivers for a message: ticks, each with what is missing before it.
fn offer(reorder_buffer: &mut ReorderBuffer<Tick>, tick: u64, epoch: u32, incarnation: u32) -> Vec<(u64, u64)> {
    let mut delivered = Vec::new();
    reorder_buffer.offer(Tick(tick, epoch, incarnation), &mut |message, missing| delivered.push((message.0, missing)));
    delivered
}

#[test]
fn a_reader_that_joins_late_begins_with_any_tick_and_counts_those_before_it_as_lost() {
    let mut reorder_buffer = ReorderBuffer::joining(1, 10);
    assert_eq!(offer(&mut reorder_buffer, 7, 1, 1), [(7, 7)]);
    assert_eq!(
        *reorder_buffer.sequence(),
        Sequence { next_tick: 8, ticks: 1, lost: 7, sender: 1, ..Sequence::default() }
    );
}

#[test]
fn a_gap_in_the_ticks_of_one_publisher_is_a_loss_and_told_at_once() {
    let mut reorder_buffer = ReorderBuffer::starting(0, 1, 10);
    let delivered = [0, 1, 4, 4, 5].map(|tick| offer(&mut reorder_buffer, tick, 1, 1));
    assert_eq!(delivered.concat(), [(0, 0), (1, 0), (4, 2), (5, 0)]);
    assert_eq!(
        (reorder_buffer.sequence().lost, reorder_buffer.sequence().duplicated, reorder_buffer.sequence().repeated),
        (2, 1, 0)
    );
}

#[test]
fn a_restarted_publisher_repeats_and_fills_up_without_a_gap() {
    let mut reorder_buffer = ReorderBuffer::starting(0, 1, 10);
    let offers = [(0, 1), (1, 1), (3, 2), (2, 1), (4, 2), (3, 1)];
    let delivered = offers.map(|(tick, incarnation)| offer(&mut reorder_buffer, tick, 1, incarnation));
    assert_eq!(delivered.concat(), [(0, 0), (1, 0), (2, 0), (3, 0), (4, 0)]);
    assert_eq!((reorder_buffer.sequence().lost, reorder_buffer.sequence().repeated), (0, 1));
}

#[test]
fn what_never_comes_is_waited_for_no_longer_than_agreed() {
    let mut reorder_buffer = ReorderBuffer::starting(0, 1, 4);
    assert_eq!(offer(&mut reorder_buffer, 0, 1, 1), [(0, 0)]);
    assert_eq!(offer(&mut reorder_buffer, 3, 2, 2), []);
    assert_eq!(offer(&mut reorder_buffer, 4, 2, 2), []);
    assert_eq!(offer(&mut reorder_buffer, 5, 2, 2), [(3, 2), (4, 0), (5, 0)]);
}

#[test]
fn what_was_published_before_the_reader_came_is_waited_for_as_long_as_it_may_take() {
    let mut reorder_buffer = ReorderBuffer::starting(0, 1, 4);
    reorder_buffer.expect_until(10, 20);
    assert!((5..29).all(|tick| offer(&mut reorder_buffer, tick, 2, 2).is_empty()));
    assert_eq!(offer(&mut reorder_buffer, 0, 1, 1), [(0, 0)]);
    assert_eq!(offer(&mut reorder_buffer, 29, 2, 2), []);
    assert_eq!(offer(&mut reorder_buffer, 30, 2, 2).first(), Some(&(5, 4)), "nor for ever");
}

#[test]
fn the_displaced_owner_is_not_heard_any_more() {
    let mut reorder_buffer = ReorderBuffer::starting(0, 1, 10);
    let offers = [(0, 1, 1), (1, 2, 2), (2, 1, 1), (2, 2, 2)];
    let delivered = offers.map(|(tick, epoch, incarnation)| offer(&mut reorder_buffer, tick, epoch, incarnation));
    assert_eq!(delivered.concat(), [(0, 0), (1, 0), (2, 0)]);
    assert_eq!(reorder_buffer.sequence().repeated, 1);
}

/// What a service publishes for the ticks computed, then for the decision.
fn decide(gate: &mut OutputGate<Tick>, ticks: std::ops::Range<u64>, control: Control) -> (Option<Answer>, Vec<Tick>) {
    ticks.for_each(|tick| gate.take(Tick(tick, 0, 0), &mut |_| ()));
    let mut published = Vec::new();
    let answer = gate.decide(control, &mut |message| published.push(message));
    (answer, published)
}

#[test]
fn a_candidate_publishes_what_it_has_kept_from_the_tick_on() {
    let mut gate = OutputGate::candidate(2, 1, 8);
    let answered = decide(&mut gate, 0..6, Control { epoch: 2, owner: 2, from_tick: 4 });
    assert_eq!(answered, (Some(Answer::Armed), vec![Tick(4, 2, 2), Tick(5, 2, 2)]));
    assert_eq!(gate.status().published_from, Some(4));
}

#[test]
fn a_candidate_that_no_longer_keeps_the_tick_says_so_and_stays_silent() {
    let mut gate = OutputGate::candidate(2, 1, 3);
    let answered = decide(&mut gate, 0..6, Control { epoch: 2, owner: 2, from_tick: 2 });
    assert_eq!(answered, (Some(Answer::Missed), vec![]));
    assert!(gate.status().missed && !gate.publishes());
}

#[test]
fn an_owner_that_stopped_gives_everything_when_the_slot_comes_back() {
    let mut gate = OutputGate::owner(1, 1, 0, 8);
    assert_eq!(decide(&mut gate, 0..3, Control { epoch: 2, owner: 2, from_tick: 4 }).0, Some(Answer::Armed));
    let back = Control { epoch: 3, owner: 1, from_tick: 4 };
    let answered = decide(&mut gate, 3..7, back);
    assert_eq!(answered, (Some(Answer::Armed), vec![Tick(4, 3, 1), Tick(5, 3, 1), Tick(6, 3, 1)]));
    assert_eq!(decide(&mut gate, 7..8, back), (None, vec![]), "the same decision again");
}

#[test]
fn an_owner_that_has_passed_the_tick_goes_on_and_can_repeat_it_under_a_later_decision() {
    let mut gate = OutputGate::owner(1, 1, 0, 8);
    assert_eq!(decide(&mut gate, 0..6, Control { epoch: 2, owner: 2, from_tick: 4 }).0, Some(Answer::Missed));
    assert!(gate.publishes());
    let answered = decide(&mut gate, 6..6, Control { epoch: 3, owner: 1, from_tick: 4 });
    assert_eq!(answered, (Some(Answer::Armed), vec![Tick(4, 3, 1), Tick(5, 3, 1)]));
}
