//! The change of hands: decided, confirmed, or taken back; and what is done where nobody is left to take a slot from.

use super::{Coordinator, State};
use crate::{
    Control,
    event::{Action, Outcome, Reason, Report, Request},
};

impl Coordinator {
    /// Decides that the candidate owns the slot from a tick that neither has reached, so that both hear of it before.
    pub(super) fn arm(&mut self, now_ms: u64, actions: &mut Vec<Action>) {
        let Some(swap) = &mut self.swap else { return };
        let Some(owner) = swap.candidate else { return };
        let ahead = [self.status, swap.status].into_iter().flatten().map(|status| status.next_tick).max();
        let newest = ahead.unwrap_or(0).max(self.newest_input_tick.saturating_add(1)).max(self.checkpoint_tick);
        let from_tick = newest.saturating_add(self.limits.margin_ticks(swap.request.attempts_before));
        self.epoch += 1;
        swap.from_tick = Some(from_tick);
        swap.enter(State::Armed { from_tick }, now_ms);
        actions.push(Action::PublishControl(Control { epoch: self.epoch, owner, from_tick }));
    }

    /// Commits when the active stage has published everything before the tick and the candidate what begins with it.
    pub(super) fn confirm(&mut self, now_ms: u64, from_tick: u64, waited_ms: u64, actions: &mut Vec<Action>) {
        let epoch = self.epoch;
        let Some(swap) = &self.swap else { return };
        let candidate = swap.status.filter(|status| status.decided_epoch == epoch);
        let active = self.status.filter(|status| status.decided_epoch == epoch);
        if candidate.is_some_and(|status| status.missed) {
            self.abort(now_ms, Reason::CandidateMissed, actions);
        } else if active.is_some_and(|status| status.missed) {
            self.abort(now_ms, Reason::ActiveMissed, actions);
        } else if active.is_some_and(|status| status.next_tick >= from_tick)
            && candidate.is_some_and(|status| status.published_from.is_some())
        {
            self.commit(now_ms, from_tick, actions);
        } else if waited_ms >= self.limits.commit_ms {
            self.abort(now_ms, Reason::NotConfirmed { from_tick }, actions);
        }
    }

    fn commit(&mut self, now_ms: u64, from_tick: u64, actions: &mut Vec<Action>) {
        let Some(swap) = &mut self.swap else { return };
        let (Some(old), Some(candidate)) = (self.active, swap.candidate.take()) else { return };
        (self.active, self.status, self.active_epoch) = (Some(candidate), swap.status, self.epoch);
        (self.from_tick, self.checkpoint_tick) = (from_tick, 0);
        swap.enter(State::Committed { old }, now_ms);
        let (request, took_ms) = (swap.request.clone(), now_ms.saturating_sub(swap.began_ms));
        actions.push(self.answer(&request, Outcome::Committed, None, Some(from_tick), took_ms));
    }

    /// The owner has ended: the new stage begins in its place, under a decision of its own.
    pub(super) fn replace(&mut self, now_ms: u64, actions: &mut Vec<Action>) {
        let Some(swap) = &mut self.swap else { return };
        self.epoch += 1;
        swap.replaces = Some(self.published_tick);
        (swap.candidate, swap.status, swap.from_tick, swap.spawning) = (None, None, None, true);
        swap.enter(State::Starting, now_ms);
        let (stage, epoch, from_tick) = (swap.request.stage.clone(), self.epoch, self.from_tick);
        actions.push(Action::SpawnOwner { stage, epoch, from_tick });
    }

    /// Commits when the new stage has published what nobody had published before, and has lived as long as one in the shadow must.
    pub(super) fn confirm_alone(&mut self, now_ms: u64, waited_ms: u64, actions: &mut Vec<Action>) {
        let Some(swap) = &self.swap else { return };
        let (Some(newest_tick), Some(candidate)) = (swap.replaces, swap.candidate) else { return };
        let gone_on = swap.status.filter(|status| status.next_tick > newest_tick);
        let Some(begun_tick) = gone_on.and_then(|status| status.published_from) else {
            if now_ms >= swap.request.until_ms {
                self.abort(now_ms, Reason::NoTick, actions);
            }
            return;
        };
        if waited_ms < self.limits.shadow_ms {
            return;
        }
        let (request, took_ms) = (swap.request.clone(), now_ms.saturating_sub(swap.began_ms));
        (self.active, self.status, self.active_epoch) = (Some(candidate), gone_on, self.epoch);
        (self.checkpoint_tick, self.vacant, self.swap) = (0, false, None);
        let commit_tick = Some(begun_tick.max(newest_tick));
        actions.push(self.answer(&request, Outcome::Committed, None, commit_tick, took_ms));
    }

    /// From the tick on that is published next nobody owns the slot.
    pub(super) fn leave(&mut self, actions: &mut Vec<Action>) {
        self.epoch += 1;
        let control = Control { epoch: self.epoch, owner: 0, from_tick: self.published_tick };
        actions.push(Action::PublishControl(control));
    }

    /// Gives the slot back, if it was to change hands, and ends the candidate. After the commitment there is no way back.
    pub(super) fn abort(&mut self, now_ms: u64, reason: Reason, actions: &mut Vec<Action>) {
        let Some(swap) = self.swap.as_mut().filter(|swap| swap.is_open() && swap.state != State::Aborting) else {
            return;
        };
        if let State::Armed { from_tick } = swap.state {
            self.epoch += 1;
            if let Some(owner) = self.active {
                actions.push(Action::PublishControl(Control { epoch: self.epoch, owner, from_tick }));
            }
        }
        swap.enter(State::Aborting, now_ms);
        swap.asked_ms = now_ms;
        if let Some(incarnation) = swap.candidate {
            actions.push(Action::EndCandidate { incarnation });
        }
        let (request, took_ms) = (swap.request.clone(), now_ms.saturating_sub(swap.began_ms));
        actions.push(self.answer(&request, Outcome::Aborted, Some(reason), None, took_ms));
    }

    /// Waits until the candidate is gone and the active stage has its slot; restarts the one that cannot take it back.
    pub(super) fn clear(&mut self, now_ms: u64, waited_ms: u64, actions: &mut Vec<Action>) {
        let Some(swap) = &mut self.swap else { return };
        if let Some(incarnation) = swap.candidate
            && now_ms.saturating_sub(swap.asked_ms) >= self.limits.end_ms
        {
            swap.asked_ms = now_ms;
            actions.push(Action::EndCandidate { incarnation });
        }
        let gone = swap.candidate.is_none() && !swap.spawning;
        if swap.replaces.is_some() || self.vacant {
            if gone {
                self.give_up(actions);
            }
            return;
        }
        let missed = self.status.is_some_and(|status| status.decided_epoch == self.epoch && status.missed);
        if self.active_epoch == self.epoch && self.active.is_some() {
            if gone {
                self.swap = None;
            }
        } else if self.active.is_some() && (missed || waited_ms >= self.limits.restore_ms) {
            self.restart(actions);
        }
    }

    /// Whoever was to begin in the owner's place is gone: all is as it was, under a newer decision.
    fn give_up(&mut self, actions: &mut Vec<Action>) {
        let replaced = self.swap.take().is_some_and(|swap| swap.replaces.is_some());
        match (replaced, self.vacant) {
            (true, true) => self.leave(actions),
            (true, false) => {
                self.epoch += 1;
                self.restart(actions);
            }
            (false, _) => {}
        }
    }

    pub(super) fn answer(
        &self,
        request: &Request,
        outcome: Outcome,
        reason: Option<Reason>,
        commit_tick: Option<u64>,
        took_ms: u64,
    ) -> Action {
        let (id, stage) = (request.id, request.stage.clone());
        Action::Answer(Report { id, stage, outcome, reason, commit_tick, epoch: self.epoch, took_ms })
    }
}
