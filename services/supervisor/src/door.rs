//! The door of a running system: a socket at which other programs ask.
//!
//! Input: one line of JSON from each caller. Output: one line back, when it is known. Time: none is lost: a caller who says nothing
//! holds up nobody. Failure: what is no question is answered with what is wrong with it; callers beyond the limit are sent away.

use std::{
    fs,
    io::{self, BufRead, BufReader, ErrorKind, Read, Write},
    os::unix::net::{UnixListener, UnixStream},
    path::PathBuf,
    time::Duration,
};

use bus::{BusError, Domain};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::{UpError, exchange::Wish};

/// Callers at once.
const CALLERS_MAX: usize = 16;
/// A question, bytes.
const QUESTION_MAX: usize = 64 * 1024;
/// How long a caller waits for its answer.
const ANSWER_LIMIT: Duration = Duration::from_secs(60);

/// What may be asked.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Ask {
    /// Exchange what fills a slot.
    Swap(Wish),
    /// End a shadow.
    Cancel {
        /// The slot.
        slot: String,
    },
    /// How the services are.
    Ps,
    /// What was to run, with the stages that fill the slots by now.
    Orders,
    /// A service has something to say to people.
    Tell {
        /// Which one.
        service: String,
        /// A line.
        what: String,
    },
    /// A service says where it can be reached.
    At {
        /// Which one.
        service: String,
        /// Its address.
        at: String,
    },
}

/// Why a question was not answered.
#[derive(Debug, thiserror::Error)]
pub enum DoorError {
    /// The name is none.
    #[error(transparent)]
    Name(#[from] BusError),
    /// Nobody is there.
    #[error(
        "asking the system {name:?}: it does not run ({cause}); start it with `plumb up`, or name another with --system"
    )]
    Nobody {
        /// The system.
        name: String,
        /// What the system answered.
        cause: io::Error,
    },
    /// It did not answer.
    #[error("asking the system {name:?}: {cause}")]
    Unanswered {
        /// The system.
        name: String,
        /// What is wrong.
        cause: String,
    },
}

/// Asks a running system, and waits for the answer.
pub fn ask<A: DeserializeOwned>(name: &str, question: &Ask) -> Result<A, DoorError> {
    let unanswered = |cause: String| DoorError::Unanswered { name: name.into(), cause };
    let mut stream = UnixStream::connect(Domain::new(name)?.door())
        .map_err(|cause| DoorError::Nobody { name: name.into(), cause })?;
    let failed = |cause: io::Error| unanswered(cause.to_string());
    stream.set_read_timeout(Some(ANSWER_LIMIT)).map_err(failed)?;
    let text = serde_json::to_string(question).map_err(|cause| unanswered(cause.to_string()))?;
    writeln!(stream, "{text}").map_err(failed)?;
    let mut line = String::new();
    BufReader::new(stream).take(QUESTION_MAX as u64).read_line(&mut line).map_err(failed)?;
    match serde_json::from_str::<Answered<A>>(&line).map_err(|cause| unanswered(cause.to_string()))? {
        Answered::Ok(answer) => Ok(answer),
        Answered::Error(cause) => Err(unanswered(cause)),
    }
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Answered<A> {
    Ok(A),
    Error(String),
}

/// The listening end.
pub(crate) struct Door {
    listener: UnixListener,
    callers: Vec<Caller>,
    next_caller: u64,
}

struct Caller {
    number: u64,
    stream: UnixStream,
    text: Vec<u8>,
    asked: bool,
    gone: bool,
}

impl Door {
    pub(crate) fn open(domain: &Domain) -> Result<Self, UpError> {
        let path: PathBuf = domain.door();
        let failed = |cause| UpError::System { doing: format!("opening {}", path.display()), cause };
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).map_err(failed)?;
        }
        let listener = UnixListener::bind(&path).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        Ok(Self { listener, callers: Vec::new(), next_caller: 0 })
    }

    /// The questions that have come, each with its caller's number.
    pub(crate) fn questions(&mut self) -> Vec<(u64, Ask)> {
        while self.callers.len() < CALLERS_MAX {
            let Ok((stream, _)) = self.listener.accept() else { break };
            if stream.set_nonblocking(true).is_ok() {
                self.next_caller += 1;
                let number = self.next_caller;
                self.callers.push(Caller { number, stream, text: Vec::new(), asked: false, gone: false });
            }
        }
        let mut questions = Vec::new();
        let mut wrong = Vec::new();
        for caller in &mut self.callers {
            match caller.question() {
                Some(Ok(ask)) => questions.push((caller.number, ask)),
                Some(Err(cause)) => wrong.push((caller.number, cause)),
                None => {}
            }
        }
        for (caller, cause) in wrong {
            self.send(caller, &Answered::<()>::Error(cause));
        }
        self.callers.retain(|caller| !caller.gone);
        questions
    }

    /// Callers who still wait.
    pub(crate) fn is_waiting(&self, caller: u64) -> bool {
        self.callers.iter().any(|one| one.number == caller)
    }

    /// Answers a caller, and is done with it.
    pub(crate) fn answer(&mut self, caller: u64, answer: &impl Serialize) {
        self.send(caller, &Answered::Ok(answer));
    }

    fn send(&mut self, caller: u64, answer: &impl Serialize) {
        let Some(place) = self.callers.iter().position(|one| one.number == caller) else { return };
        let mut stream = self.callers.swap_remove(place).stream;
        let text = serde_json::to_string(answer).unwrap_or_default();
        // An answer fits into the socket; a caller who has gone needs none.
        let _ = writeln!(stream, "{text}");
    }
}

impl Caller {
    fn question(&mut self) -> Option<Result<Ask, String>> {
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
            if self.text.len() > QUESTION_MAX {
                return Some(Err(format!("a question of more than {QUESTION_MAX} bytes")));
            }
        }
        let end = self.text.iter().position(|byte| *byte == b'\n').filter(|_| !self.asked)?;
        self.asked = true;
        Some(serde_json::from_slice(&self.text[..end]).map_err(|cause| format!("no question: {cause}")))
    }
}
