//! Who is asked: the supervisor's end of the control socket.

use std::{
    fs::{self, Permissions},
    io::{ErrorKind, Read, Write},
    os::unix::{
        fs::PermissionsExt,
        net::{UnixListener, UnixStream},
    },
    time::{Duration, Instant},
};

use bus::SystemName;
use serde::Serialize;

use crate::{ControlError, ControlRequest, LINE_MAX, Response, takes_time};

/// Callers at once.
pub(super) const CALLERS_MAX: usize = 16;
/// Callers let in at a look at most; the others wait for the next.
const ARRIVALS_MAX: usize = 64;
/// A caller who has not asked by then is sent away.
pub(super) const QUESTION_LIMIT: Duration = Duration::from_secs(1);

/// The listening end.
#[derive(Debug)]
pub struct ControlSocket {
    listener: UnixListener,
    callers: Vec<Caller>,
    next_caller: u64,
    /// Callers who have asked and are gone.
    departed: Vec<u64>,
}

#[derive(Debug)]
struct Caller {
    number: u64,
    stream: UnixStream,
    text: Vec<u8>,
    came: Instant,
    asked: bool,
    gone: bool,
}

impl ControlSocket {
    /// Opens the socket of a system, for its user alone.
    pub fn open(system_name: &SystemName) -> Result<Self, ControlError> {
        let path = system_name.door()?;
        let failed = |cause| ControlError::Open { path: path.clone(), cause };
        let listener = UnixListener::bind(&path).map_err(failed)?;
        fs::set_permissions(&path, Permissions::from_mode(0o600)).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        Ok(Self { listener, callers: Vec::new(), next_caller: 0, departed: Vec::new() })
    }

    /// The questions that have come, each with its caller's number.
    pub fn requests(&mut self) -> Vec<(u64, ControlRequest)> {
        self.let_in();
        let mut questions = Vec::new();
        let mut wrong = Vec::new();
        for caller in &mut self.callers {
            match caller.question() {
                Some(Ok(ask)) => {
                    if takes_time(&ask) {
                        caller.answer(&Response::<()>::Taken);
                    }
                    questions.push((caller.number, ask));
                }
                Some(Err(cause)) => wrong.push((caller.number, cause)),
                None => {}
            }
        }
        for (caller, cause) in wrong {
            self.send(caller, &Response::<()>::Error(cause));
        }
        let departed = self.callers.iter().filter(|caller| caller.gone && caller.asked).map(|caller| caller.number);
        self.departed.extend(departed);
        self.callers.retain(|caller| !caller.gone && (caller.asked || caller.came.elapsed() < QUESTION_LIMIT));
        questions
    }

    /// Callers who have asked and do not wait any more.
    pub fn departed(&mut self) -> Vec<u64> {
        std::mem::take(&mut self.departed)
    }

    /// Answers a caller, and is done with it.
    pub fn answer(&mut self, caller: u64, answer: &impl Serialize) {
        self.send(caller, &Response::Answer(answer));
    }

    /// Lets in who has come; those for whom there is no room are told so.
    fn let_in(&mut self) {
        for _ in 0..ARRIVALS_MAX {
            let Ok((stream, _)) = self.listener.accept() else { return };
            if stream.set_nonblocking(true).is_err() {
                continue;
            }
            self.next_caller += 1;
            let (number, came) = (self.next_caller, Instant::now());
            let mut caller = Caller { number, stream, text: Vec::new(), came, asked: false, gone: false };
            if self.callers.len() < CALLERS_MAX {
                self.callers.push(caller);
            } else {
                caller.answer(&Response::<()>::Error(format!("{CALLERS_MAX} others wait for an answer; ask again")));
            }
        }
    }

    fn send(&mut self, caller: u64, what: &Response<impl Serialize>) {
        let Some(place) = self.callers.iter().position(|one| one.number == caller) else { return };
        self.callers.swap_remove(place).answer(what);
    }
}

impl Caller {
    /// The question, once it is whole. That of a caller who has gone is none: it was told that nobody answers.
    fn question(&mut self) -> Option<Result<ControlRequest, String>> {
        let mut chunk = [0; 4096];
        loop {
            match self.stream.read(&mut chunk) {
                Ok(0) => {
                    self.gone = true;
                    return None;
                }
                Ok(count) => self.text.extend_from_slice(&chunk[..count]),
                Err(cause) if cause.kind() == ErrorKind::WouldBlock => break,
                Err(_) => {
                    self.gone = true;
                    return None;
                }
            }
            if self.text.len() > LINE_MAX {
                return Some(Err(format!("a question of more than {LINE_MAX} bytes")));
            }
        }
        let end = self.text.iter().position(|byte| *byte == b'\n').filter(|_| !self.asked)?;
        self.asked = true;
        Some(serde_json::from_slice(&self.text[..end]).map_err(|cause| format!("no question: {cause}")))
    }

    fn answer(&mut self, what: &Response<impl Serialize>) {
        let text = serde_json::to_string(what).unwrap_or_default();
        // It fits into the socket; a caller who has gone needs none.
        let _ = writeln!(self.stream, "{text}");
    }
}
