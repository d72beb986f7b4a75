//! Hand-over of a slot: decision, confirmation, abort, and takeover from an owner that has exited.

use super::{Coordinator, SwapState};
use crate::{
    OwnershipDecision,
    event::{Action, FailureReason, Report, Request, SwapOutcome},
};

impl Coordinator {
    /// Decides that the candidate owns the slot from a future tick on. Neither stage has reached
    /// this tick, so both can receive the decision in time.
    pub(super) fn arm(&mut self, now_ms: u64, actions: &mut Vec<Action>) {
        let Some(swap) = &mut self.swap else { return };
        let Some(owner) = swap.candidate else { return };
        let ahead = [self.status, swap.status].into_iter().flatten().map(|status| status.next_tick).max();
        let newest = ahead.unwrap_or(0).max(self.newest_input_tick.saturating_add(1)).max(self.checkpoint_tick);
        let from_tick = newest.saturating_add(self.limits.margin_ticks(swap.request.previous_attempts));
        self.epoch += 1;
        swap.from_tick = Some(from_tick);
        swap.enter(SwapState::Armed { from_tick }, now_ms);
        actions.push(Action::PublishDecision(OwnershipDecision { epoch: self.epoch, owner, from_tick }));
    }

    /// Commits once the active stage has published all ticks before the hand-over and the candidate
    /// has published its first tick.
    pub(super) fn confirm(&mut self, now_ms: u64, from_tick: u64, waited_ms: u64, actions: &mut Vec<Action>) {
        let epoch = self.epoch;
        let Some(swap) = &self.swap else { return };
        let candidate = swap.status.filter(|status| status.decided_epoch == epoch);
        let active = self.status.filter(|status| status.decided_epoch == epoch);
        if candidate.is_some_and(|status| status.missed) {
            self.abort(now_ms, FailureReason::CandidateMissed, actions);
        } else if active.is_some_and(|status| status.missed) {
            self.abort(now_ms, FailureReason::ActiveMissed, actions);
        } else if active.is_some_and(|status| status.next_tick >= from_tick)
            && candidate.is_some_and(|status| status.published_from.is_some())
        {
            self.commit(now_ms, from_tick, actions);
        } else if waited_ms >= self.limits.commit_timeout_ms {
            self.abort(now_ms, FailureReason::NotConfirmed { from_tick }, actions);
        }
    }

    fn commit(&mut self, now_ms: u64, from_tick: u64, actions: &mut Vec<Action>) {
        let Some(swap) = &mut self.swap else { return };
        let (Some(previous), Some(candidate)) = (self.active, swap.candidate.take()) else { return };
        (self.active, self.status, self.active_epoch) = (Some(candidate), swap.status, self.epoch);
        (self.progress, self.from_tick, self.checkpoint_tick) = (swap.progress, from_tick, 0);
        swap.enter(SwapState::Committed { previous }, now_ms);
        let (request, took_ms) = (swap.request.clone(), now_ms.saturating_sub(swap.started_ms));
        actions.push(self.report(&request, SwapOutcome::Committed, None, Some(from_tick), took_ms));
    }

    /// Makes a new decision and starts the new stage in place of an owner that has exited.
    pub(super) fn replace_owner(&mut self, now_ms: u64, actions: &mut Vec<Action>) {
        let Some(swap) = &mut self.swap else { return };
        self.epoch += 1;
        swap.takeover_tick = Some(self.published_tick);
        (swap.candidate, swap.status, swap.from_tick, swap.spawn_pending) = (None, None, None, true);
        swap.enter(SwapState::Starting, now_ms);
        let (stage, epoch, from_tick) = (swap.request.stage.clone(), self.epoch, self.from_tick);
        actions.push(Action::SpawnOwner { stage, epoch, from_tick });
    }

    /// Commits once the new stage has published a new tick and at least `shadow_ms` have passed.
    pub(super) fn confirm_takeover(&mut self, now_ms: u64, waited_ms: u64, actions: &mut Vec<Action>) {
        let Some(swap) = &self.swap else { return };
        let progress = swap.progress;
        let (Some(newest_tick), Some(candidate)) = (swap.takeover_tick, swap.candidate) else { return };
        let resumed = swap.status.filter(|status| status.next_tick > newest_tick);
        let Some(first_tick) = resumed.and_then(|status| status.published_from) else {
            if now_ms >= swap.request.deadline_ms {
                self.abort(now_ms, FailureReason::NoTick, actions);
            }
            return;
        };
        if waited_ms < self.limits.shadow_ms {
            return;
        }
        let (request, took_ms) = (swap.request.clone(), now_ms.saturating_sub(swap.started_ms));
        (self.active, self.status, self.active_epoch) = (Some(candidate), resumed, self.epoch);
        (self.progress, self.checkpoint_tick, self.vacant, self.swap) = (progress, 0, false, None);
        let commit_tick = Some(first_tick.max(newest_tick));
        actions.push(self.report(&request, SwapOutcome::Committed, None, commit_tick, took_ms));
    }

    /// Publishes a decision that leaves the slot without an owner from the first unpublished tick
    /// on.
    pub(super) fn vacate(&mut self, actions: &mut Vec<Action>) {
        self.epoch += 1;
        let decision = OwnershipDecision { epoch: self.epoch, owner: 0, from_tick: self.published_tick };
        actions.push(Action::PublishDecision(decision));
    }

    /// Cancels the swap: the active stage keeps the slot, and the candidate is stopped.
    ///
    /// Has no effect once the swap is committed.
    pub(super) fn abort(&mut self, now_ms: u64, reason: FailureReason, actions: &mut Vec<Action>) {
        let Some(swap) = self.swap.as_mut().filter(|swap| swap.is_open() && swap.state != SwapState::Aborting) else {
            return;
        };
        if let SwapState::Armed { from_tick } = swap.state {
            self.epoch += 1;
            if let Some(owner) = self.active {
                actions.push(Action::PublishDecision(OwnershipDecision { epoch: self.epoch, owner, from_tick }));
            }
        }
        swap.enter(SwapState::Aborting, now_ms);
        swap.stop_requested_ms = now_ms;
        if let Some(incarnation) = swap.candidate {
            actions.push(Action::StopCandidate { incarnation });
        }
        let (request, took_ms) = (swap.request.clone(), now_ms.saturating_sub(swap.started_ms));
        actions.push(self.report(&request, SwapOutcome::Aborted, Some(reason), None, took_ms));
    }

    /// Ends the swap once the candidate has exited and the active stage owns the slot again.
    /// Restarts the active stage if it cannot resume ownership.
    pub(super) fn finish_abort(&mut self, now_ms: u64, waited_ms: u64, actions: &mut Vec<Action>) {
        let Some(swap) = &mut self.swap else { return };
        if let Some(incarnation) = swap.candidate
            && now_ms.saturating_sub(swap.stop_requested_ms) >= self.limits.stop_retry_ms
        {
            swap.stop_requested_ms = now_ms;
            actions.push(Action::StopCandidate { incarnation });
        }
        let exited = swap.candidate.is_none() && !swap.spawn_pending;
        if swap.takeover_tick.is_some() || self.vacant {
            if exited {
                self.cancel_takeover(actions);
            }
            return;
        }
        let missed = self.status.is_some_and(|status| status.decided_epoch == self.epoch && status.missed);
        if self.active_epoch == self.epoch && self.active.is_some() {
            if exited {
                self.swap = None;
            }
        } else if self.active.is_some() && (missed || waited_ms >= self.limits.restore_timeout_ms) {
            self.restart(actions);
        }
    }

    /// Ends a failed takeover with a new decision. The previous owner is restarted, or the slot
    /// stays vacant.
    fn cancel_takeover(&mut self, actions: &mut Vec<Action>) {
        let replaced = self.swap.take().is_some_and(|swap| swap.takeover_tick.is_some());
        match (replaced, self.vacant) {
            (true, true) => self.vacate(actions),
            (true, false) => {
                self.epoch += 1;
                self.restart(actions);
            }
            (false, _) => {}
        }
    }

    pub(super) fn report(
        &self,
        request: &Request,
        outcome: SwapOutcome,
        reason: Option<FailureReason>,
        commit_tick: Option<u64>,
        took_ms: u64,
    ) -> Action {
        let (id, stage) = (request.id, request.stage.clone());
        Action::Report(Report { id, stage, outcome, reason, commit_tick, epoch: self.epoch, took_ms })
    }
}
