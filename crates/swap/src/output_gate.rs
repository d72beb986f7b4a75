//! What a service does with its outputs: publish them while it owns the slot, keep the last of them in any case.
//!
//! Input: outputs in the order of ticks, and decisions. Output: what is to be published, stamped. Time: none. Failure: a decision
//! that comes too late to be obeyed changes nothing and is answered [`Answer::Missed`].

use std::collections::VecDeque;

use crate::{Control, OwnershipStatus, Stamped};

/// What a service answers to a decision.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answer {
    /// It does, or will do, what was decided.
    Armed,
    /// It can do so no more: it has published beyond, or no longer keeps what it is to publish. Nothing has changed.
    Missed,
}

/// Ticks from one on, as far as the next span begins.
#[derive(Debug, Clone, Copy)]
struct OwnershipSpan {
    from_tick: u64,
    epoch: u32,
    mine: bool,
}

/// The outputs of one service.
#[derive(Debug, Clone)]
pub struct OutputGate<O> {
    incarnation: u32,
    capacity: usize,
    kept: VecDeque<O>,
    /// Everything given out from this tick on is kept.
    kept_from: Option<u64>,
    next_tick: u64,
    /// In the order of ticks; epochs grow with them.
    spans: Vec<OwnershipSpan>,
    decided_epoch: u32,
    missed: bool,
    published_from: Option<u64>,
}

impl<O: Stamped + Clone> OutputGate<O> {
    /// A service that owns the slot from `from_tick` on by the decision `epoch`, and keeps its last `capacity` outputs.
    pub fn owner(incarnation: u32, epoch: u32, from_tick: u64, capacity: usize) -> Self {
        let mut gate = Self::candidate(incarnation, epoch, capacity);
        gate.spans.push(OwnershipSpan { from_tick, epoch, mine: true });
        gate.kept_from = Some(0);
        gate
    }

    /// A service that publishes nothing until a decision after `epoch` names it.
    pub fn candidate(incarnation: u32, epoch: u32, capacity: usize) -> Self {
        Self {
            incarnation,
            capacity: capacity.max(1),
            kept: VecDeque::new(),
            kept_from: None,
            next_tick: 0,
            spans: Vec::new(),
            decided_epoch: epoch,
            missed: false,
            published_from: None,
        }
    }

    /// Takes the next output; publishes it if its tick is owned. Outputs come in the order of ticks; one that comes again is left out.
    pub fn take(&mut self, output: O, publish: &mut dyn FnMut(O)) {
        let tick = output.tick();
        if tick < self.next_tick {
            return;
        }
        if self.kept.is_empty() {
            self.kept_from = Some(tick);
        } else if self.kept.len() == self.capacity {
            self.kept_from = self.kept.pop_front().map(|forgotten| forgotten.tick().saturating_add(1));
        }
        self.next_tick = tick.saturating_add(1);
        self.publish(output.clone(), publish);
        self.kept.push_back(output);
    }

    /// Obeys a decision; `None` for one that came again, late or out of order. What is kept and owned by it is published at once.
    pub fn decide(&mut self, control: Control, publish: &mut dyn FnMut(O)) -> Option<Answer> {
        let Control { epoch, owner, from_tick } = control;
        if epoch <= self.decided_epoch {
            return None;
        }
        (self.decided_epoch, self.published_from) = (epoch, None);
        let mine = owner == self.incarnation;
        let able =
            if mine { self.kept_from.is_some_and(|kept| kept <= from_tick) } else { !self.has_published(from_tick) };
        self.missed = !able;
        if !able {
            return Some(Answer::Missed);
        }
        self.spans.retain(|span| span.from_tick < from_tick);
        self.spans.push(OwnershipSpan { from_tick, epoch, mine });
        if mine {
            let due = self.kept.partition_point(|output| output.tick() < from_tick);
            let due: Vec<O> = self.kept.range(due..).cloned().collect();
            due.into_iter().for_each(|output| self.publish(output, publish));
        }
        self.forget_terms();
        Some(Answer::Armed)
    }

    /// How the service stands to its slot.
    pub fn status(&self) -> OwnershipStatus {
        let Self { next_tick, decided_epoch, missed, published_from, .. } = *self;
        OwnershipStatus { next_tick, decided_epoch, missed, published_from }
    }

    /// Whether the next tick would be published.
    pub fn publishes(&self) -> bool {
        self.span(self.next_tick).is_some_and(|span| span.mine)
    }

    fn publish(&mut self, mut output: O, publish: &mut dyn FnMut(O)) {
        let Some(OwnershipSpan { epoch, mine: true, .. }) = self.span(output.tick()).copied() else { return };
        if epoch == self.decided_epoch {
            self.published_from.get_or_insert(output.tick());
        }
        output.stamp(epoch, self.incarnation);
        publish(output);
    }

    fn span(&self, tick: u64) -> Option<&OwnershipSpan> {
        self.spans.iter().rev().find(|span| span.from_tick <= tick)
    }

    /// A tick at or after this one has been published.
    fn has_published(&self, from_tick: u64) -> bool {
        let ends = self.spans.iter().skip(1).map(|next| next.from_tick).chain([u64::MAX]);
        self.spans
            .iter()
            .zip(ends)
            .any(|(span, end)| span.mine && span.from_tick.max(from_tick) < end.min(self.next_tick))
    }

    /// Leaves out spans that ended before the first tick kept.
    fn forget_terms(&mut self) {
        let kept_from = self.kept_from.unwrap_or(0);
        let past = self.spans.iter().skip(1).take_while(|next| next.from_tick <= kept_from).count();
        self.spans.drain(..past);
    }
}
