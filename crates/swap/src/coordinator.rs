//! Coordinator of a slot: a state machine for swaps, with deadlines.
//!
//! - Input: events, each with the supervisor's time, which never decreases.
//! - Output: actions.
//! - Failure: until a swap is committed, every failure returns the slot to the active stage under a
//!   new decision. Once it is committed, the candidate is an ordinary owner. If the active stage
//!   itself has exited, the new stage starts in its place, as in a restart.

mod handover;
mod state;

use crate::{
    OwnershipDecision, OwnershipStatus,
    event::{Action, Event, FailureReason, Progress, Request, SwapLimits, SwapOutcome},
};

use state::Swap;
pub use state::SwapState;

/// Coordinator of the swaps of one slot.
#[derive(Debug, Clone)]
pub struct Coordinator {
    limits: SwapLimits,
    /// Epoch of the last decision.
    epoch: u32,
    /// First tick of the owner under the last decision. A restarted owner publishes from this tick
    /// on.
    from_tick: u64,
    active: Option<u32>,
    status: Option<OwnershipStatus>,
    /// Progress of the active stage.
    progress: Progress,
    /// Epoch of the last decision that the active stage has confirmed.
    active_epoch: u32,
    checkpoint_tick: u64,
    newest_input_tick: u64,
    /// First tick that has not been published yet.
    published_tick: u64,
    /// `true` if the owner has exited and is not restarted.
    vacant: bool,
    /// Lowest tick from which any subscriber would resume after a restart.
    subscribers_tick: u64,
    swap: Option<Swap>,
}

impl Coordinator {
    /// Creates the coordinator of a slot. The incarnation `active` owns the slot from tick 0 on.
    /// `epoch` is the number of the decision that made `active` the owner.
    pub fn new(active: u32, epoch: u32, limits: SwapLimits) -> Self {
        Self {
            limits,
            epoch,
            from_tick: 0,
            active: Some(active),
            status: None,
            progress: Progress::default(),
            active_epoch: epoch,
            checkpoint_tick: 0,
            newest_input_tick: 0,
            published_tick: 0,
            vacant: false,
            subscribers_tick: 0,
            swap: None,
        }
    }

    /// Returns the state of the swap.
    pub fn state(&self) -> SwapState {
        self.swap.as_ref().map_or(SwapState::Idle, |swap| swap.state)
    }

    /// Returns the epoch of the last decision.
    pub fn epoch(&self) -> u32 {
        self.epoch
    }

    /// Returns the incarnation that owns the slot; `None` while the owner is being restarted.
    pub fn active(&self) -> Option<u32> {
        self.active
    }

    /// Returns `true` if a checkpoint with the given next tick may be stored for the service.
    ///
    /// Until a hand-over is settled, checkpoints beyond the hand-over tick are rejected, because
    /// the outputs that the active stage publishes from that tick on might not have reached the
    /// subscribers.
    pub fn admits_checkpoint(&mut self, incarnation: u32, next_tick: u64) -> bool {
        let limit = self.swap.as_ref().filter(|swap| swap.is_open()).and_then(|swap| swap.from_tick);
        let candidate = self.swap.as_ref().and_then(|swap| swap.candidate);
        let is_known = self.active == Some(incarnation) || candidate == Some(incarnation);
        let admitted = is_known && limit.is_none_or(|limit| next_tick <= limit);
        if admitted && self.active == Some(incarnation) {
            self.checkpoint_tick = self.checkpoint_tick.max(next_tick);
        }
        admitted
    }

    /// Handles an event, checks the deadlines, and returns the actions in order.
    pub fn handle(&mut self, now_ms: u64, event: Event) -> Vec<Action> {
        let mut actions = Vec::new();
        self.apply(now_ms, event, &mut actions);
        self.advance(now_ms, &mut actions);
        actions
    }

    fn apply(&mut self, now_ms: u64, event: Event, actions: &mut Vec<Action>) {
        match event {
            Event::Request(request) => self.start(now_ms, request, actions),
            Event::Restarted { incarnation } => {
                (self.active, self.status, self.active_epoch) = (Some(incarnation), None, self.epoch);
                (self.progress, self.vacant) = (Progress::default(), false);
            }
            Event::Vacated => {
                self.vacant = true;
                if self.swap.as_ref().is_none_or(|swap| swap.takeover_tick.is_none()) {
                    self.vacate(actions);
                }
            }
            Event::Published { next_tick } => self.published_tick = self.published_tick.max(next_tick),
            Event::NewestInput { tick } => self.newest_input_tick = self.newest_input_tick.max(tick),
            Event::SubscribersCheckpointed { next_tick } => {
                self.subscribers_tick = self.subscribers_tick.max(next_tick)
            }
            Event::TimePassed => {}
            Event::Cancel => {
                // A shadow that was promoted no longer belongs to the client that cancels it.
                if self.swap.as_ref().is_some_and(|swap| swap.request.shadow_only) {
                    self.abort(now_ms, FailureReason::Cancelled, actions);
                }
            }
            Event::Exited { incarnation } => self.on_exited(now_ms, incarnation, actions),
            Event::Health { incarnation, status, progress, invalid_output } => {
                if self.active == Some(incarnation) {
                    if status.decided_epoch == self.epoch && !status.missed {
                        self.active_epoch = self.epoch;
                    }
                    (self.status, self.progress) = (Some(status), progress);
                } else if let Some(swap) = self.swap.as_mut().filter(|swap| swap.candidate == Some(incarnation)) {
                    (swap.status, swap.progress) = (Some(status), progress);
                    if invalid_output {
                        self.abort(now_ms, FailureReason::InvalidOutput, actions);
                    }
                }
            }
            Event::SpawnFailed { cause } => {
                if let Some(swap) = &mut self.swap {
                    swap.spawn_pending = false;
                }
                self.abort(now_ms, FailureReason::SpawnFailed { cause }, actions);
            }
            Event::Promote { deadline_ms } => {
                let (shadow_ms, missed_ticks) = (self.limits.shadow_ms, self.missed_ticks());
                if let Some(swap) = self.swap.as_mut().filter(|swap| swap.request.shadow_only) {
                    (swap.request.shadow_only, swap.request.deadline_ms) = (false, deadline_ms);
                    swap.accepted_missed_ticks = missed_ticks;
                    if swap.state == SwapState::Shadowing {
                        swap.state_since_ms = now_ms.saturating_sub(shadow_ms);
                    }
                }
            }
            Event::Spawned { incarnation } => {
                let Some(swap) = &mut self.swap else { return };
                (swap.spawn_pending, swap.candidate) = (false, Some(incarnation));
                if swap.state == SwapState::Aborting {
                    actions.push(Action::StopCandidate { incarnation });
                }
            }
            Event::Ready { incarnation } => {
                let Some(swap) = &mut self.swap else { return };
                if swap.state == SwapState::Starting && swap.candidate == Some(incarnation) {
                    let is_takeover = swap.takeover_tick.is_some();
                    swap.enter(if is_takeover { SwapState::TakingOver } else { SwapState::CatchingUp }, now_ms);
                    if is_takeover {
                        let (epoch, from_tick) = (self.epoch, self.from_tick);
                        actions.push(Action::PublishDecision(OwnershipDecision {
                            epoch,
                            owner: incarnation,
                            from_tick,
                        }));
                    }
                }
            }
        }
    }

    fn start(&mut self, now_ms: u64, request: Request, actions: &mut Vec<Action>) {
        let reason = match (&self.swap, self.active) {
            (Some(swap), _) => FailureReason::Busy { id: swap.request.id },
            (None, None) if request.shadow_only => FailureReason::ActiveDown,
            (None, None) => {
                self.swap = Some(Swap::new(request, now_ms));
                return self.replace_owner(now_ms, actions);
            }
            (None, Some(_)) => {
                actions.push(Action::SpawnCandidate { stage: request.stage.clone(), epoch: self.epoch });
                self.swap = Some(Swap::new(request, now_ms));
                return;
            }
        };
        actions.push(self.report(&request, SwapOutcome::Refused, Some(reason), None, 0));
    }

    fn on_exited(&mut self, now_ms: u64, incarnation: u32, actions: &mut Vec<Action>) {
        if self.active == Some(incarnation) {
            (self.active, self.status) = (None, None);
            let continues =
                |swap: &Swap| swap.is_open() && swap.state != SwapState::Aborting && !swap.request.shadow_only;
            if self.swap.as_ref().is_some_and(continues) {
                self.replace_owner(now_ms, actions);
            } else {
                self.abort(now_ms, FailureReason::ActiveExited, actions);
                self.restart(actions);
            }
        } else if let Some(swap) = &mut self.swap {
            if swap.candidate == Some(incarnation) {
                swap.candidate = None;
                self.abort(now_ms, FailureReason::CandidateExited, actions);
            } else if matches!(swap.state, SwapState::Committed { previous } | SwapState::Retiring { previous } if previous == incarnation)
            {
                // The stop is requested only after the subscribers have had time to read all
                // outputs of the stage. An exit before that may lose outputs.
                let unrequested = matches!(swap.state, SwapState::Committed { .. });
                self.swap = None;
                if unrequested {
                    self.republish_lost(actions);
                }
            }
        }
    }

    /// Restarts the owner from its checkpoint, under the last decision.
    fn restart(&mut self, actions: &mut Vec<Action>) {
        (self.active, self.status) = (None, None);
        actions.push(Action::RestartActive { epoch: self.epoch, from_tick: self.from_tick });
    }

    /// Restarts the owner under a new decision, so that it republishes ticks of the previous stage.
    ///
    /// This is necessary if the previous stage exits before the subscribers' checkpoints have
    /// reached the hand-over.
    fn republish_lost(&mut self, actions: &mut Vec<Action>) {
        if self.vacant || self.subscribers_tick >= self.from_tick {
            return;
        }
        self.epoch += 1;
        self.from_tick = self.subscribers_tick;
        self.restart(actions);
    }

    /// Enters the next state if its condition is met, and aborts the swap if a deadline has passed.
    fn advance(&mut self, now_ms: u64, actions: &mut Vec<Action>) {
        let limits = self.limits;
        let lag_ticks = self.lag_ticks();
        let behind_ticks = self.status.map_or(0, |active| self.newest_input_tick.saturating_sub(active.next_tick));
        let missed_ticks = self.missed_ticks();
        let caught_up = lag_ticks.is_some_and(|lag| lag <= limits.max_lag_ticks);
        // Until the slot has produced its first tick, no tick can be chosen for the hand-over.
        let has_ticked = self.status.is_some_and(|active| active.next_tick > 0);
        let Some(swap) = &mut self.swap else { return };
        // The active stage may still skip the same ticks if the candidate is ahead of it.
        let has_missed = missed_ticks > swap.accepted_missed_ticks && !swap.request.shadow_only;
        let is_unfit = has_missed && swap.progress.next_tick <= self.progress.next_tick;
        if matches!(swap.state, SwapState::CatchingUp | SwapState::Shadowing) && !has_ticked {
            swap.state_since_ms = now_ms;
            if now_ms >= swap.request.deadline_ms {
                self.abort(now_ms, FailureReason::NoTick, actions);
            }
            return;
        }
        let waited_ms = now_ms.saturating_sub(swap.state_since_ms);
        match swap.state {
            SwapState::Idle => {}
            SwapState::CatchingUp | SwapState::Shadowing if is_unfit => {
                self.abort(now_ms, FailureReason::InputMissed { ticks: missed_ticks }, actions);
            }
            SwapState::Starting if waited_ms >= limits.ready_timeout_ms => {
                self.abort(now_ms, FailureReason::NotReady { ready_timeout_ms: limits.ready_timeout_ms }, actions);
            }
            SwapState::Starting => {}
            SwapState::CatchingUp if caught_up => swap.enter(SwapState::Shadowing, now_ms),
            SwapState::CatchingUp if waited_ms >= limits.catch_up_timeout_ms => {
                self.abort(now_ms, FailureReason::NotCaughtUp { lag_ticks }, actions);
            }
            SwapState::CatchingUp => {}
            SwapState::Shadowing if swap.request.shadow_only || waited_ms < limits.shadow_ms => {}
            SwapState::Shadowing if !has_missed && caught_up && behind_ticks <= limits.max_lag_ticks => {
                self.arm(now_ms, actions)
            }
            SwapState::Shadowing if waited_ms >= limits.shadow_ms + limits.catch_up_timeout_ms => {
                let reason = match caught_up {
                    false => FailureReason::NotCaughtUp { lag_ticks },
                    true if has_missed => FailureReason::InputMissed { ticks: missed_ticks },
                    true => FailureReason::ActiveBehind { lag_ticks: behind_ticks },
                };
                self.abort(now_ms, reason, actions);
            }
            SwapState::Shadowing => {}
            SwapState::TakingOver => self.confirm_takeover(now_ms, waited_ms, actions),
            SwapState::Armed { from_tick } => self.confirm(now_ms, from_tick, waited_ms, actions),
            SwapState::Committed { previous }
                if waited_ms >= limits.linger_ms || swap.from_tick <= Some(self.subscribers_tick) =>
            {
                swap.enter(SwapState::Retiring { previous }, now_ms);
                actions.push(Action::RetirePrevious { incarnation: previous });
            }
            SwapState::Committed { .. } => {}
            SwapState::Retiring { previous } if waited_ms >= limits.stop_retry_ms => {
                swap.enter(SwapState::Retiring { previous }, now_ms);
                actions.push(Action::RetirePrevious { incarnation: previous });
            }
            SwapState::Retiring { .. } => {}
            SwapState::Aborting => self.finish_abort(now_ms, waited_ms, actions),
        }
    }

    /// Returns the number of ticks that the candidate has skipped in addition to those that the
    /// active stage has reported as skipped.
    fn missed_ticks(&self) -> u64 {
        self.swap.as_ref().map_or(0, |swap| swap.progress.lost.saturating_sub(self.progress.lost))
    }

    /// Returns the number of ticks by which the candidate lags behind the active stage, if known.
    fn lag_ticks(&self) -> Option<u64> {
        let candidate = self.swap.as_ref()?.status?;
        Some(self.status?.next_tick.saturating_sub(candidate.next_tick))
    }
}
