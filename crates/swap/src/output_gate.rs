//! Gate for the outputs of a service. It publishes them while the service owns the slot, and always
//! keeps the latest ones.
//!
//! - Input: outputs in tick order, and decisions.
//! - Output: stamped messages to publish.
//! - Failure: a decision that arrives too late changes nothing, and the response is
//!   [`DecisionResponse::Missed`].

use std::collections::VecDeque;

use crate::{OwnershipDecision, OwnershipStatus, Stamped};

/// Response of a service to a decision.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DecisionResponse {
    /// The decision has been or will be carried out.
    Armed,
    /// The decision came too late and changed nothing.
    ///
    /// The service has already published ticks that the decision assigns to another owner, or it no
    /// longer holds outputs that it would have to publish.
    Missed,
}

/// Ownership from `from_tick` on, up to the start of the next span.
#[derive(Debug, Clone, Copy)]
struct OwnershipSpan {
    from_tick: u64,
    epoch: u32,
    is_own: bool,
}

/// Output gate of a service.
#[derive(Debug, Clone)]
pub struct OutputGate<O> {
    incarnation: u32,
    capacity: usize,
    history: VecDeque<O>,
    /// First tick from which `history` is complete.
    history_start: Option<u64>,
    next_tick: u64,
    /// Spans in tick order, with increasing epochs.
    spans: Vec<OwnershipSpan>,
    decided_epoch: u32,
    missed: bool,
    published_from: Option<u64>,
}

impl<O: Stamped + Clone> OutputGate<O> {
    /// Creates the gate of a service that owns the slot from `from_tick` on. `epoch` is the number
    /// of the decision that made the service the owner. The gate keeps the last `capacity` outputs.
    pub fn owner(incarnation: u32, epoch: u32, from_tick: u64, capacity: usize) -> Self {
        let mut gate = Self::candidate(incarnation, epoch, capacity);
        gate.spans.push(OwnershipSpan { from_tick, epoch, is_own: true });
        gate.history_start = Some(0);
        gate
    }

    /// Creates the gate of a candidate. It publishes nothing until a decision after `epoch` names
    /// the candidate as the owner.
    pub fn candidate(incarnation: u32, epoch: u32, capacity: usize) -> Self {
        Self {
            incarnation,
            capacity: capacity.max(1),
            history: VecDeque::new(),
            history_start: None,
            next_tick: 0,
            spans: Vec::new(),
            decided_epoch: epoch,
            missed: false,
            published_from: None,
        }
    }

    /// Adds the next output, and publishes it if the service owns the output's tick. A repeated
    /// tick is ignored.
    pub fn push(&mut self, output: O, publish: &mut dyn FnMut(O)) {
        let tick = output.tick();
        if tick < self.next_tick {
            return;
        }
        if self.history.is_empty() {
            self.history_start = Some(tick);
        } else if self.history.len() == self.capacity {
            self.history_start = self.history.pop_front().map(|dropped| dropped.tick().saturating_add(1));
        }
        self.next_tick = tick.saturating_add(1);
        self.publish(output.clone(), publish);
        self.history.push_back(output);
    }

    /// Applies a decision. Returns `None` unless its epoch is higher than that of the last
    /// decision.
    ///
    /// If the service becomes the owner, it immediately publishes the outputs in its history from
    /// the decision's first tick on.
    pub fn apply(&mut self, decision: OwnershipDecision, publish: &mut dyn FnMut(O)) -> Option<DecisionResponse> {
        let OwnershipDecision { epoch, owner, from_tick } = decision;
        if epoch <= self.decided_epoch {
            return None;
        }
        (self.decided_epoch, self.published_from) = (epoch, None);
        let is_own = owner == self.incarnation;
        let in_time = if is_own {
            self.history_start.is_some_and(|start| start <= from_tick)
        } else {
            !self.has_published(from_tick)
        };
        self.missed = !in_time;
        if !in_time {
            return Some(DecisionResponse::Missed);
        }
        self.spans.retain(|span| span.from_tick < from_tick);
        self.spans.push(OwnershipSpan { from_tick, epoch, is_own });
        if is_own {
            let first = self.history.partition_point(|output| output.tick() < from_tick);
            let due: Vec<O> = self.history.range(first..).cloned().collect();
            due.into_iter().for_each(|output| self.publish(output, publish));
        }
        self.drop_ended_spans();
        Some(DecisionResponse::Armed)
    }

    /// Returns the ownership state for the health report.
    pub fn status(&self) -> OwnershipStatus {
        let Self { next_tick, decided_epoch, missed, published_from, .. } = *self;
        OwnershipStatus { next_tick, decided_epoch, missed, published_from }
    }

    /// Returns `true` if the service owns the next tick.
    pub fn owns_next_tick(&self) -> bool {
        self.span(self.next_tick).is_some_and(|span| span.is_own)
    }

    fn publish(&mut self, mut output: O, publish: &mut dyn FnMut(O)) {
        let Some(OwnershipSpan { epoch, is_own: true, .. }) = self.span(output.tick()).copied() else { return };
        if epoch == self.decided_epoch {
            self.published_from.get_or_insert(output.tick());
        }
        output.stamp(epoch, self.incarnation);
        publish(output);
    }

    fn span(&self, tick: u64) -> Option<&OwnershipSpan> {
        self.spans.iter().rev().find(|span| span.from_tick <= tick)
    }

    /// Returns `true` if the service has published a tick at or after `from_tick`.
    fn has_published(&self, from_tick: u64) -> bool {
        let ends = self.spans.iter().skip(1).map(|next| next.from_tick).chain([u64::MAX]);
        self.spans
            .iter()
            .zip(ends)
            .any(|(span, end)| span.is_own && span.from_tick.max(from_tick) < end.min(self.next_tick))
    }

    /// Drops spans that ended before the history starts.
    fn drop_ended_spans(&mut self) {
        let history_start = self.history_start.unwrap_or(0);
        let past = self.spans.iter().skip(1).take_while(|next| next.from_tick <= history_start).count();
        self.spans.drain(..past);
    }
}
