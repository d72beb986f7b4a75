//! What a viewer may ask for: swaps, shadows, their end, calibrations. Each needs the token; few are under way at once.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, PoisonError},
};

use control::{Outcome, SwapReport, SwapRequest};
use launch::Stage;
use tokio::sync::{Semaphore, mpsc::Sender};
use wire::{
    command::ControlMessage,
    v1::{PageCommand, SwapAnswer, page_command::Kind, swap_answer},
};

use crate::{
    hub::Hub,
    source::Desk,
    token::{Role, Tokens},
};

/// Commands under way at once, shadows among them.
pub(crate) const UNDER_WAY_MAX: usize = 8;

/// Who takes a viewer's commands.
pub(crate) struct Commands {
    desk: Arc<dyn Desk>,
    tokens: Tokens,
    room: Arc<Semaphore>,
}

/// A viewer's commands.
pub(crate) struct Session<'c> {
    commands: Option<&'c Commands>,
    hub: Arc<Hub>,
    answers: Sender<SwapAnswer>,
    /// The slots in which this viewer's shadows run.
    shadows: Arc<Mutex<Vec<String>>>,
}

impl Commands {
    /// `room`: for how many at once, of all viewers together.
    pub(crate) fn new(desk: Arc<dyn Desk>, tokens: Tokens, room: Arc<Semaphore>) -> Self {
        Self { desk, tokens, room }
    }
}

impl<'c> Session<'c> {
    pub(crate) fn new(commands: Option<&'c Commands>, hub: Arc<Hub>, answers: Sender<SwapAnswer>) -> Self {
        Self { commands, hub, answers, shadows: Arc::default() }
    }

    /// Carries out what the viewer asks for; whether it may go on asking.
    pub(crate) fn ask(&mut self, bytes: &[u8]) -> bool {
        let Ok(command) = PageCommand::decoded(bytes) else { return false };
        if command.kind() == Kind::Look {
            return true;
        }
        let Some(commands) = self.commands else {
            self.refuse(command, "nothing can be commanded from here");
            return true;
        };
        let remedy = match commands.tokens.role(&command.token) {
            Some(Role::Operator) => None,
            Some(Role::Viewer) => Some("this is a viewer's token: it looks and does not command"),
            None => Some(
                "the token is missing or wrong: open the address that `plumb up` or `plumb view` prints, to its end",
            ),
        };
        if let Some(remedy) = remedy {
            self.refuse(command, remedy);
            return true;
        }
        let Ok(permit) = commands.room.clone().try_acquire_owned() else {
            self.refuse(command, "too many commands are under way; ask again");
            return true;
        };
        let (desk, answers, shadows) = (commands.desk.clone(), self.answers.clone(), self.shadows.clone());
        let hub = self.hub.clone();
        tokio::task::spawn_blocking(move || {
            let _permit = permit;
            let answer = match command.kind() {
                Kind::Calibrate => calibrate(&*desk, command, &hub),
                _ => Some(carry_out(&*desk, command, &shadows)),
            };
            // A viewer who has gone needs no answer.
            if let Some(answer) = answer {
                let _ = answers.blocking_send(answer);
            }
        });
        true
    }

    fn refuse(&self, command: PageCommand, why: &str) {
        let _ = self.answers.try_send(refused(command, why.into()));
    }
}

/// A shadow ends with whoever asked for it.
impl Drop for Session<'_> {
    fn drop(&mut self) {
        let Some(commands) = self.commands else { return };
        for slot in std::mem::take(&mut *lock(&self.shadows)) {
            let desk = commands.desk.clone();
            tokio::task::spawn_blocking(move || desk.cancel(&slot));
        }
    }
}

/// Begins or ends a calibration; the answer where that cannot be.
fn calibrate(desk: &dyn Desk, command: PageCommand, hub: &Hub) -> Option<SwapAnswer> {
    if command.what.is_empty() {
        hub.calibrate(None);
        return None;
    }
    let kind = calibrate::Kind::NAMES.iter().find(|(name, _)| *name == command.what).map(|(_, kind)| *kind);
    let kind = kind.ok_or_else(|| "expected gyro, accel, mag, mounting or clock".to_owned());
    match kind.and_then(|kind| desk.wish(kind)) {
        Ok(wish) => {
            hub.calibrate(Some(wish));
            None
        }
        Err(why) => Some(refused(command, why)),
    }
}

fn carry_out(desk: &dyn Desk, command: PageCommand, shadows: &Mutex<Vec<String>>) -> SwapAnswer {
    let shadow = match command.kind() {
        Kind::Cancel => {
            return match desk.cancel(&command.slot) {
                Ok(()) => {
                    let PageCommand { request_id, slot, .. } = command;
                    let outcome = swap_answer::Outcome::Aborted.into();
                    SwapAnswer { request_id, outcome, slot, reason: "cancelled".into(), ..SwapAnswer::default() }
                }
                Err(why) => refused(command, why),
            };
        }
        kind => kind == Kind::Shadow,
    };
    if shadow {
        lock(shadows).push(command.slot.clone());
    }
    let request = SwapRequest {
        slot: command.slot.clone(),
        stage: Stage { stage: command.stage.clone(), set: BTreeMap::new() },
        shadow,
        expected_epoch: Some(command.expected_epoch).filter(|epoch| *epoch != 0),
        limit_ms: (!shadow).then_some(SwapRequest::LIMIT_MS),
    };
    let answer = match desk.swap(request) {
        Ok(report) => answer(command, report),
        Err(why) => refused(command, why),
    };
    if shadow {
        let mut own = lock(shadows);
        if let Some(place) = own.iter().position(|slot| *slot == answer.slot) {
            own.remove(place);
        }
    }
    answer
}

fn answer(command: PageCommand, report: SwapReport) -> SwapAnswer {
    let SwapReport { slot, from, to, commit_tick, lost, duplicated, gap_us, jump_deg, outcome, reason } = report;
    let outcome = match outcome {
        Outcome::Committed => swap_answer::Outcome::Committed,
        Outcome::Aborted => swap_answer::Outcome::Aborted,
        Outcome::Refused => swap_answer::Outcome::Refused,
    };
    SwapAnswer {
        request_id: command.request_id,
        outcome: outcome.into(),
        reason: reason.unwrap_or_default(),
        slot,
        from,
        to,
        commit_tick,
        lost,
        duplicated,
        gap_s: gap_us * 1e-6,
        jump_rad: jump_deg.to_radians(),
    }
}

fn refused(command: PageCommand, reason: String) -> SwapAnswer {
    let PageCommand { request_id, slot, stage, .. } = command;
    let outcome = swap_answer::Outcome::Refused.into();
    SwapAnswer { request_id, outcome, reason, slot, to: stage, ..SwapAnswer::default() }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
