//! Commands of viewers: swaps, shadows, calibrations, recordings and the log of the system.
//!
//! Input: commands of the page, each with a token.
//! Output: one reply per command.
//! Failure: a command without an operator's token, or beyond [`MAX_CONCURRENT_COMMANDS`], is
//! rejected.

use std::sync::{Arc, Mutex};

use control::SwapRequest;
use launch::StageConfig;
use tokio::sync::{Semaphore, mpsc::Sender};
use wire::v1::{Log, PageCommand, SwapAnswer, page_command::Kind, swap_answer, to_page::Content};

use crate::{
    hub::Hub,
    locked::lock,
    log,
    source::CommandTarget,
    token::{Role, Tokens},
};

/// Maximum number of commands in progress, of all viewers together. A shadow counts as in progress
/// until it ends.
pub(crate) const MAX_CONCURRENT_COMMANDS: usize = 8;

/// Executor of the commands of all viewers.
pub(crate) struct Commands {
    target: Arc<dyn CommandTarget>,
    tokens: Tokens,
    permits: Arc<Semaphore>,
}

/// Commands of one viewer. Its shadows are cancelled when the session ends.
pub(crate) struct CommandSession<'c> {
    commands: Option<&'c Commands>,
    hub: Arc<Hub>,
    replies: Sender<Content>,
    /// Slots with a shadow that this viewer started.
    shadows: Arc<Mutex<Vec<String>>>,
}

impl Commands {
    /// Creates the executor. `permits` limits the commands in progress of all viewers together.
    pub(crate) fn new(target: Arc<dyn CommandTarget>, tokens: Tokens, permits: Arc<Semaphore>) -> Self {
        Self { target, tokens, permits }
    }
}

impl<'c> CommandSession<'c> {
    pub(crate) fn new(commands: Option<&'c Commands>, hub: Arc<Hub>, replies: Sender<Content>) -> Self {
        Self { commands, hub, replies, shadows: Arc::default() }
    }

    /// Starts executing a command of the viewer.
    pub(crate) fn handle(&mut self, command: PageCommand) {
        if command.kind() == Kind::View {
            return;
        }
        let Some(commands) = self.commands else {
            self.reject(command, "this page does not accept commands");
            return;
        };
        let remedy = match commands.tokens.role(&command.token) {
            Some(Role::Operator) => None,
            Some(Role::Viewer) => Some("a viewer's token cannot send commands; open the page with an operator's token"),
            None => Some("token missing or wrong; open the complete address printed by `plumb up` or `plumb view`"),
        };
        if let Some(remedy) = remedy {
            self.reject(command, remedy);
            return;
        }
        let Ok(permit) = commands.permits.clone().try_acquire_owned() else {
            self.reject(command, "too many commands in progress; try again");
            return;
        };
        let (target, replies, shadows) = (commands.target.clone(), self.replies.clone(), self.shadows.clone());
        let (hub, tokens) = (self.hub.clone(), commands.tokens.clone());
        tokio::task::spawn_blocking(move || {
            let _permit = permit;
            let reply = match command.kind() {
                Kind::Calibrate => calibrate(&*target, command, &hub).map(Content::Answer),
                Kind::Log => Some(read_log(&*target, command, &tokens)),
                Kind::Apply => Some(Content::Answer(reply(command, |command| {
                    let missing = "there is no result of this calibration any more; repeat it";
                    target.write_launch_file(&hub.calibration_sections(&command.what).ok_or(missing)?)
                }))),
                Kind::Record => Some(Content::Answer(reply(command, |command| match &*command.what {
                    "start" => target.start_recording(),
                    "stop" => target.stop_recording(),
                    other => Err(format!("unknown command {other:?}: expected start or stop")),
                }))),
                _ => Some(Content::Answer(execute(&*target, command, &shadows))),
            };
            // Sending fails only if the viewer has disconnected.
            if let Some(reply) = reply {
                let _ = replies.blocking_send(reply);
            }
        });
    }

    fn reject(&self, command: PageCommand, reason: &str) {
        let _ = self.replies.try_send(Content::Answer(rejection(command, reason.into())));
    }
}

impl Drop for CommandSession<'_> {
    fn drop(&mut self) {
        let Some(commands) = self.commands else { return };
        for slot in std::mem::take(&mut *lock(&self.shadows)) {
            let target = commands.target.clone();
            tokio::task::spawn_blocking(move || target.cancel_shadow(&slot));
        }
    }
}

/// Starts or cancels a calibration. Returns a reply only if the request is rejected.
fn calibrate(target: &dyn CommandTarget, command: PageCommand, hub: &Hub) -> Option<SwapAnswer> {
    if command.what.is_empty() {
        hub.request_calibration(None);
        return None;
    }
    let kind = calibrate::Kind::NAMES.iter().find(|(name, _)| *name == command.what).map(|(_, kind)| *kind);
    let kind = kind.ok_or_else(|| "expected gyro, accel, mag, mounting or clock".to_owned());
    match kind.and_then(|kind| target.calibration_request(kind)) {
        Ok(request) => {
            hub.request_calibration(Some(request));
            None
        }
        Err(reason) => Some(rejection(command, reason)),
    }
}

/// Returns the last lines of the log, or the reason why they are not available.
fn read_log(target: &dyn CommandTarget, command: PageCommand, tokens: &Tokens) -> Content {
    match target.log() {
        Ok(lines) => {
            let lines = lines.iter().map(|line| log::without_tokens(line, tokens)).collect();
            Content::Log(Log { request_id: command.request_id, lines })
        }
        Err(reason) => Content::Answer(rejection(command, reason)),
    }
}

/// Executes a command that does not concern a slot, and returns its reply.
fn reply(command: PageCommand, execute: impl FnOnce(&PageCommand) -> Result<(), String>) -> SwapAnswer {
    match execute(&command) {
        Ok(()) => {
            let outcome = swap_answer::Outcome::Committed.into();
            SwapAnswer { request_id: command.request_id, outcome, ..SwapAnswer::default() }
        }
        Err(reason) => rejection(command, reason),
    }
}

fn execute(target: &dyn CommandTarget, command: PageCommand, shadows: &Mutex<Vec<String>>) -> SwapAnswer {
    let shadow = match command.kind() {
        Kind::Cancel => {
            return match target.cancel_shadow(&command.slot) {
                Ok(()) => {
                    let PageCommand { request_id, slot, .. } = command;
                    let outcome = swap_answer::Outcome::Aborted.into();
                    SwapAnswer { request_id, outcome, slot, reason: "cancelled".into(), ..SwapAnswer::default() }
                }
                Err(reason) => rejection(command, reason),
            };
        }
        kind => kind == Kind::Shadow,
    };
    if shadow {
        lock(shadows).push(command.slot.clone());
    }
    let set = command.set.iter().map(|setting| (setting.name.clone(), setting.value)).collect();
    let request = SwapRequest {
        slot: command.slot.clone(),
        stage: StageConfig { stage: command.stage.clone(), set },
        shadow,
        expected_epoch: Some(command.expected_epoch).filter(|epoch| *epoch != 0),
        timeout_ms: (!shadow).then_some(SwapRequest::DEFAULT_TIMEOUT_MS),
    };
    let reply = match target.swap(request) {
        Ok(report) => report.into_answer(command.request_id),
        Err(reason) => rejection(command, reason),
    };
    if shadow {
        let mut running = lock(shadows);
        if let Some(index) = running.iter().position(|slot| *slot == reply.slot) {
            running.remove(index);
        }
    }
    reply
}

fn rejection(command: PageCommand, reason: String) -> SwapAnswer {
    let PageCommand { request_id, slot, stage, .. } = command;
    let outcome = swap_answer::Outcome::Refused.into();
    SwapAnswer { request_id, outcome, reason, slot, to: stage, ..SwapAnswer::default() }
}
