//! Tests the rules of the reorder buffer and the output gate one by one.

use swap::{DecisionResponse, OutputGate, OwnershipDecision, ReorderBuffer, Sequence, Stamped};

/// Message with tick, epoch and incarnation.
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

/// Offers a message. Returns the delivered ticks, each with the number of ticks missing before it.
fn offer(reorder_buffer: &mut ReorderBuffer<Tick>, tick: u64, epoch: u32, incarnation: u32) -> Vec<(u64, u64)> {
    let mut delivered = Vec::new();
    reorder_buffer.offer(Tick(tick, epoch, incarnation), &mut |message, missing| delivered.push((message.0, missing)));
    delivered
}

#[test]
fn buffer_with_unknown_start_counts_earlier_ticks_as_lost() {
    let mut reorder_buffer = ReorderBuffer::with_unknown_start(1, 10);
    assert_eq!(offer(&mut reorder_buffer, 7, 1, 1), [(7, 7)]);
    assert_eq!(
        *reorder_buffer.sequence(),
        Sequence { next_tick: 8, ticks: 1, lost: 7, publisher: 1, ..Sequence::default() }
    );
}

#[test]
fn gap_of_one_publisher_is_reported_immediately() {
    let mut reorder_buffer = ReorderBuffer::new(0, 1, 10);
    let delivered = [0, 1, 4, 4, 5].map(|tick| offer(&mut reorder_buffer, tick, 1, 1));
    assert_eq!(delivered.concat(), [(0, 0), (1, 0), (4, 2), (5, 0)]);
    assert_eq!(
        (reorder_buffer.sequence().lost, reorder_buffer.sequence().duplicated, reorder_buffer.sequence().repeated),
        (2, 1, 0)
    );
}

#[test]
fn restarted_publisher_fills_gap() {
    let mut reorder_buffer = ReorderBuffer::new(0, 1, 10);
    let offers = [(0, 1), (1, 1), (3, 2), (2, 1), (4, 2), (3, 1)];
    let delivered = offers.map(|(tick, incarnation)| offer(&mut reorder_buffer, tick, 1, incarnation));
    assert_eq!(delivered.concat(), [(0, 0), (1, 0), (2, 0), (3, 0), (4, 0)]);
    assert_eq!((reorder_buffer.sequence().lost, reorder_buffer.sequence().repeated), (0, 1));
}

#[test]
fn missing_tick_is_given_up_after_lateness() {
    let mut reorder_buffer = ReorderBuffer::new(0, 1, 4);
    assert_eq!(offer(&mut reorder_buffer, 0, 1, 1), [(0, 0)]);
    assert_eq!(offer(&mut reorder_buffer, 3, 2, 2), []);
    assert_eq!(offer(&mut reorder_buffer, 4, 2, 2), []);
    assert_eq!(offer(&mut reorder_buffer, 5, 2, 2), [(3, 2), (4, 0), (5, 0)]);
}

#[test]
fn backlog_is_given_up_after_patience() {
    let mut reorder_buffer = ReorderBuffer::new(0, 1, 4);
    reorder_buffer.expect_backlog(10, 20);
    assert!((5..29).all(|tick| offer(&mut reorder_buffer, tick, 2, 2).is_empty()));
    assert_eq!(offer(&mut reorder_buffer, 0, 1, 1), [(0, 0)]);
    assert_eq!(offer(&mut reorder_buffer, 29, 2, 2), []);
    assert_eq!(offer(&mut reorder_buffer, 30, 2, 2).first(), Some(&(5, 4)), "the backlog is given up");
}

#[test]
fn messages_of_displaced_owner_are_rejected() {
    let mut reorder_buffer = ReorderBuffer::new(0, 1, 10);
    let offers = [(0, 1, 1), (1, 2, 2), (2, 1, 1), (2, 2, 2)];
    let delivered = offers.map(|(tick, epoch, incarnation)| offer(&mut reorder_buffer, tick, epoch, incarnation));
    assert_eq!(delivered.concat(), [(0, 0), (1, 0), (2, 0)]);
    assert_eq!(reorder_buffer.sequence().repeated, 1);
}

/// Pushes `ticks`, then applies a decision. Returns the response and the outputs that the decision
/// published.
fn decide(
    gate: &mut OutputGate<Tick>,
    ticks: std::ops::Range<u64>,
    decision: OwnershipDecision,
) -> (Option<DecisionResponse>, Vec<Tick>) {
    ticks.for_each(|tick| gate.push(Tick(tick, 0, 0), &mut |_| ()));
    let mut published = Vec::new();
    let response = gate.apply(decision, &mut |message| published.push(message));
    (response, published)
}

#[test]
fn candidate_publishes_history_from_decided_tick() {
    let mut gate = OutputGate::candidate(2, 1, 8);
    let result = decide(&mut gate, 0..6, OwnershipDecision { epoch: 2, owner: 2, from_tick: 4 });
    assert_eq!(result, (Some(DecisionResponse::Armed), vec![Tick(4, 2, 2), Tick(5, 2, 2)]));
    assert_eq!(gate.status().published_from, Some(4));
}

#[test]
fn candidate_without_decided_tick_misses_decision() {
    let mut gate = OutputGate::candidate(2, 1, 3);
    let result = decide(&mut gate, 0..6, OwnershipDecision { epoch: 2, owner: 2, from_tick: 2 });
    assert_eq!(result, (Some(DecisionResponse::Missed), vec![]));
    assert!(gate.status().missed && !gate.owns_next_tick());
}

#[test]
fn former_owner_publishes_history_on_return_of_slot() {
    let mut gate = OutputGate::owner(1, 1, 0, 8);
    assert_eq!(
        decide(&mut gate, 0..3, OwnershipDecision { epoch: 2, owner: 2, from_tick: 4 }).0,
        Some(DecisionResponse::Armed)
    );
    let back = OwnershipDecision { epoch: 3, owner: 1, from_tick: 4 };
    let result = decide(&mut gate, 3..7, back);
    assert_eq!(result, (Some(DecisionResponse::Armed), vec![Tick(4, 3, 1), Tick(5, 3, 1), Tick(6, 3, 1)]));
    assert_eq!(decide(&mut gate, 7..8, back), (None, vec![]), "the same decision again");
}

#[test]
fn owner_beyond_tick_misses_decision_and_can_republish() {
    let mut gate = OutputGate::owner(1, 1, 0, 8);
    assert_eq!(
        decide(&mut gate, 0..6, OwnershipDecision { epoch: 2, owner: 2, from_tick: 4 }).0,
        Some(DecisionResponse::Missed)
    );
    assert!(gate.owns_next_tick());
    let result = decide(&mut gate, 6..6, OwnershipDecision { epoch: 3, owner: 1, from_tick: 4 });
    assert_eq!(result, (Some(DecisionResponse::Armed), vec![Tick(4, 3, 1), Tick(5, 3, 1)]));
}
