//! The swap of a slot's stage as a machine of states, each with a deadline and a way back.
//!
//! Input: events, with the supervisor's time. Output: actions. Time: told with each event; grows. Failure: until the commitment every
//! failure gives the slot back to the active stage under a newer decision; after it the candidate is the slot's owner like any other.
//! Where the active stage itself has ended, the new one begins in its place as a restart of it would.

mod change;
mod state;

use crate::{
    Control, OwnershipStatus,
    event::{Action, Event, Limits, Outcome, Reason, Request},
};

pub use state::State;
use state::Swap;

/// Swaps the stage of one slot.
#[derive(Debug, Clone)]
pub struct Coordinator {
    limits: Limits,
    /// The last decision.
    epoch: u32,
    /// The first tick that the slot's owner publishes when it is restarted.
    from_tick: u64,
    active: Option<u32>,
    status: Option<OwnershipStatus>,
    /// The decision under which the active stage is known to own the slot.
    active_epoch: u32,
    checkpoint_tick: u64,
    newest_input_tick: u64,
    /// Everything before it has been published.
    published_tick: u64,
    /// The owner has ended and is not started again.
    vacant: bool,
    /// Every reader's checkpoint is at least this far.
    readers_tick: u64,
    swap: Option<Swap>,
}

impl Coordinator {
    /// A slot that `active` owns from its first tick by the decision `epoch`.
    pub fn new(active: u32, epoch: u32, limits: Limits) -> Self {
        Self {
            limits,
            epoch,
            from_tick: 0,
            active: Some(active),
            status: None,
            active_epoch: epoch,
            checkpoint_tick: 0,
            newest_input_tick: 0,
            published_tick: 0,
            vacant: false,
            readers_tick: 0,
            swap: None,
        }
    }

    /// Where the swap is.
    pub fn state(&self) -> State {
        self.swap.as_ref().map_or(State::Idle, |swap| swap.state)
    }

    /// The last decision's number.
    pub fn epoch(&self) -> u32 {
        self.epoch
    }

    /// The incarnation that owns the slot, unless it is being restarted.
    pub fn active(&self) -> Option<u32> {
        self.active
    }

    /// Whether a checkpoint with this next tick may replace the one kept of that service.
    ///
    /// Until a change of hands is settled, none beyond its tick: what the active stage has published from there on may not be what the
    /// readers took.
    pub fn admits(&mut self, incarnation: u32, next_tick: u64) -> bool {
        let limit = self.swap.as_ref().filter(|swap| swap.is_open()).and_then(|swap| swap.from_tick);
        let candidate = self.swap.as_ref().and_then(|swap| swap.candidate);
        let known = self.active == Some(incarnation) || candidate == Some(incarnation);
        let admitted = known && limit.is_none_or(|limit| next_tick <= limit);
        if admitted && self.active == Some(incarnation) {
            self.checkpoint_tick = self.checkpoint_tick.max(next_tick);
        }
        admitted
    }

    /// Takes an event, then looks at the deadlines; what is to be done comes in order.
    pub fn handle(&mut self, now_ms: u64, event: Event) -> Vec<Action> {
        let mut actions = Vec::new();
        self.apply(now_ms, event, &mut actions);
        self.go_on(now_ms, &mut actions);
        actions
    }

    fn apply(&mut self, now_ms: u64, event: Event, actions: &mut Vec<Action>) {
        match event {
            Event::Request(request) => self.begin(now_ms, request, actions),
            Event::Restarted { incarnation } => {
                (self.active, self.status, self.active_epoch) = (Some(incarnation), None, self.epoch);
                self.vacant = false;
            }
            Event::Vacated => {
                self.vacant = true;
                if self.swap.as_ref().is_none_or(|swap| swap.replaces.is_none()) {
                    self.leave(actions);
                }
            }
            Event::Published { next_tick } => self.published_tick = self.published_tick.max(next_tick),
            Event::NewestInput { tick } => self.newest_input_tick = self.newest_input_tick.max(tick),
            Event::ReadersKeep { next_tick } => self.readers_tick = self.readers_tick.max(next_tick),
            Event::Time => {}
            Event::Cancel => {
                // A shadow that somebody has promoted is not the canceller's any more.
                if self.swap.as_ref().is_some_and(|swap| swap.request.shadow_only) {
                    self.abort(now_ms, Reason::Cancelled, actions);
                }
            }
            Event::Died { incarnation } => self.on_died(now_ms, incarnation, actions),
            Event::Health { incarnation, status, flawed } => {
                if self.active == Some(incarnation) {
                    if status.decided_epoch == self.epoch && !status.missed {
                        self.active_epoch = self.epoch;
                    }
                    self.status = Some(status);
                } else if let Some(swap) = self.swap.as_mut().filter(|swap| swap.candidate == Some(incarnation)) {
                    swap.status = Some(status);
                    if flawed {
                        self.abort(now_ms, Reason::Flawed, actions);
                    }
                }
            }
            Event::SpawnFailed { cause } => {
                if let Some(swap) = &mut self.swap {
                    swap.spawning = false;
                }
                self.abort(now_ms, Reason::SpawnFailed { cause }, actions);
            }
            Event::Promote { until_ms } => {
                let shadow_ms = self.limits.shadow_ms;
                if let Some(swap) = self.swap.as_mut().filter(|swap| swap.request.shadow_only) {
                    (swap.request.shadow_only, swap.request.until_ms) = (false, until_ms);
                    if swap.state == State::Shadowing {
                        swap.since_ms = now_ms.saturating_sub(shadow_ms);
                    }
                }
            }
            Event::Spawned { incarnation } => {
                let Some(swap) = &mut self.swap else { return };
                (swap.spawning, swap.candidate) = (false, Some(incarnation));
                if swap.state == State::Aborting {
                    actions.push(Action::EndCandidate { incarnation });
                }
            }
            Event::Ready { incarnation } => {
                let Some(swap) = &mut self.swap else { return };
                if swap.state == State::Starting && swap.candidate == Some(incarnation) {
                    let alone = swap.replaces.is_some();
                    swap.enter(if alone { State::TakingOver } else { State::CatchingUp }, now_ms);
                    if alone {
                        let (epoch, from_tick) = (self.epoch, self.from_tick);
                        actions.push(Action::PublishControl(Control { epoch, owner: incarnation, from_tick }));
                    }
                }
            }
        }
    }

    fn begin(&mut self, now_ms: u64, request: Request, actions: &mut Vec<Action>) {
        let reason = match (&self.swap, self.active) {
            (Some(swap), _) => Reason::Busy { id: swap.request.id },
            (None, None) if request.shadow_only => Reason::ActiveDown,
            (None, None) => {
                self.swap = Some(Swap::new(request, now_ms));
                return self.replace(now_ms, actions);
            }
            (None, Some(_)) => {
                actions.push(Action::SpawnCandidate { stage: request.stage.clone(), epoch: self.epoch });
                self.swap = Some(Swap::new(request, now_ms));
                return;
            }
        };
        actions.push(self.answer(&request, Outcome::Refused, Some(reason), None, 0));
    }

    fn on_died(&mut self, now_ms: u64, incarnation: u32, actions: &mut Vec<Action>) {
        if self.active == Some(incarnation) {
            (self.active, self.status) = (None, None);
            let goes_on = |swap: &Swap| swap.is_open() && swap.state != State::Aborting && !swap.request.shadow_only;
            if self.swap.as_ref().is_some_and(goes_on) {
                self.replace(now_ms, actions);
            } else {
                self.abort(now_ms, Reason::ActiveDied, actions);
                self.restart(actions);
            }
        } else if let Some(swap) = &mut self.swap {
            if swap.candidate == Some(incarnation) {
                swap.candidate = None;
                self.abort(now_ms, Reason::CandidateDied, actions);
            } else if matches!(swap.state, State::Committed { old } | State::Retiring { old } if old == incarnation) {
                // One that was asked to go had stayed long enough.
                let unasked = matches!(swap.state, State::Committed { .. });
                self.swap = None;
                if unasked {
                    self.make_again(actions);
                }
            }
        }
    }

    /// The slot's owner begins anew from its checkpoint, under the last decision.
    fn restart(&mut self, actions: &mut Vec<Action>) {
        (self.active, self.status) = (None, None);
        actions.push(Action::RestartActive { epoch: self.epoch, from_tick: self.from_tick });
    }

    /// The stage that had the slot is gone before its readers have passed what it alone held for them: the owner makes that again, under a
    /// decision of its own.
    fn make_again(&mut self, actions: &mut Vec<Action>) {
        if self.vacant || self.readers_tick >= self.from_tick {
            return;
        }
        self.epoch += 1;
        self.from_tick = self.readers_tick;
        self.restart(actions);
    }

    /// Looks at what is reached and what is overdue.
    fn go_on(&mut self, now_ms: u64, actions: &mut Vec<Action>) {
        let limits = self.limits;
        let lag_ticks = self.lag_ticks();
        let behind_ticks = self.status.map_or(0, |active| self.newest_input_tick.saturating_sub(active.next_tick));
        let caught_up = lag_ticks.is_some_and(|lag| lag <= limits.lag_max_ticks);
        // Before its first tick nobody knows at which one a slot could change hands.
        let begun = self.status.is_some_and(|active| active.next_tick > 0);
        let Some(swap) = &mut self.swap else { return };
        if matches!(swap.state, State::CatchingUp | State::Shadowing) && !begun {
            swap.since_ms = now_ms;
            if now_ms >= swap.request.until_ms {
                self.abort(now_ms, Reason::NoTick, actions);
            }
            return;
        }
        let waited_ms = now_ms.saturating_sub(swap.since_ms);
        match swap.state {
            State::Idle => {}
            State::Starting if waited_ms >= limits.ready_ms => {
                self.abort(now_ms, Reason::NotReady { ready_ms: limits.ready_ms }, actions);
            }
            State::Starting => {}
            State::CatchingUp if caught_up => swap.enter(State::Shadowing, now_ms),
            State::CatchingUp if waited_ms >= limits.caught_up_ms => {
                self.abort(now_ms, Reason::NotCaughtUp { lag_ticks }, actions);
            }
            State::CatchingUp => {}
            State::Shadowing if swap.request.shadow_only || waited_ms < limits.shadow_ms => {}
            State::Shadowing if caught_up && behind_ticks <= limits.lag_max_ticks => self.arm(now_ms, actions),
            State::Shadowing if waited_ms >= limits.shadow_ms + limits.caught_up_ms => {
                let active_behind = Reason::ActiveBehind { lag_ticks: behind_ticks };
                let reason = if caught_up { active_behind } else { Reason::NotCaughtUp { lag_ticks } };
                self.abort(now_ms, reason, actions);
            }
            State::Shadowing => {}
            State::TakingOver => self.confirm_alone(now_ms, waited_ms, actions),
            State::Armed { from_tick } => self.confirm(now_ms, from_tick, waited_ms, actions),
            State::Committed { old } if waited_ms >= limits.linger_ms || swap.from_tick <= Some(self.readers_tick) => {
                swap.enter(State::Retiring { old }, now_ms);
                actions.push(Action::RetireOld { incarnation: old });
            }
            State::Committed { .. } => {}
            State::Retiring { old } if waited_ms >= limits.end_ms => {
                swap.enter(State::Retiring { old }, now_ms);
                actions.push(Action::RetireOld { incarnation: old });
            }
            State::Retiring { .. } => {}
            State::Aborting => self.clear(now_ms, waited_ms, actions),
        }
    }

    /// How far the candidate is behind the active stage, where both are known.
    fn lag_ticks(&self) -> Option<u64> {
        let candidate = self.swap.as_ref()?.status?;
        Some(self.status?.next_tick.saturating_sub(candidate.next_tick))
    }
}
