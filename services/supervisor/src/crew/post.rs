//! A service of the crew, whoever lives in it.

use std::time::{Duration, Instant};

use launch::{Restart, Service};
use messages::{Health, State};
use rustix::process::Signal;
use serde::{Deserialize, Serialize};

use super::{News, process::Process};
use crate::lives::{FIRST_WORD_LIMIT, Lives};

/// A service beside the data path that says nothing for so long is killed: it may have to wait for the machine.
const SILENCE_BESIDE: Duration = Duration::from_secs(5);

/// A service and its lives.
#[derive(Debug, Default)]
pub(crate) struct Post {
    pub(super) process: Option<Process>,
    /// A stage that is to take over.
    pub(super) candidate: Option<Process>,
    /// A stage that was taken over from.
    pub(super) retired: Option<Process>,
    pub(super) lives: Lives,
    /// When it is started again.
    pub(super) due: Option<Instant>,
    /// It is not started again.
    pub(super) away: bool,
    /// It was asked to end with the system.
    pub(super) ending: bool,
    /// The decision that its next life begins under, and the first tick that it publishes.
    pub(super) term: Option<(u32, u64)>,
    /// Where it can be reached.
    pub(super) at: Option<String>,
}

/// How a service is, for whoever asks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Standing {
    /// Its name.
    pub service: String,
    /// What fills its slot.
    pub stage: Option<String>,
    /// What it does, in a word.
    pub state: String,
    /// Its process; 0 where there is none.
    pub pid: u32,
    /// Times it was started again.
    pub restarts: u32,
    /// Its life.
    pub incarnation: u32,
    /// The last decision about its slot; 0 where it has none.
    pub epoch: u32,
    /// Ticks published.
    pub ticks: u64,
    /// Ticks that never came.
    pub lost: u64,
    /// Where it can be reached.
    pub at: Option<String>,
}

impl Post {
    /// What it said last.
    pub(crate) fn heard(&self) -> Option<&Health> {
        self.process.as_ref()?.heard.as_ref()
    }

    /// What its candidate said last.
    pub(crate) fn candidate_heard(&self) -> Option<&Health> {
        self.candidate.as_ref()?.heard.as_ref()
    }

    /// The life that owns the slot; 0 where there is none.
    pub(crate) fn incarnation(&self) -> u32 {
        self.process.as_ref().map_or(0, |process| process.incarnation)
    }

    /// Its process; 0 where there is none.
    pub(crate) fn pid(&self) -> u32 {
        self.process.as_ref().map_or(0, |process| process.pid)
    }

    /// Times it was started again.
    pub(crate) fn restarts(&self) -> u32 {
        self.lives.restarts
    }

    /// What it does, in a word.
    pub(crate) fn standing(&self, silence: Duration) -> &'static str {
        match (&self.process, self.heard()) {
            _ if self.away => "failed",
            (None, _) => "backoff",
            (Some(_), None) => "starting",
            (Some(process), Some(_)) if process.quiet_since.elapsed() > silence => "silent",
            (Some(_), Some(heard)) => State::name(heard.state),
        }
    }

    /// It has opened its topics, or will not any more.
    pub(crate) fn is_settled(&self) -> bool {
        self.away || self.heard().is_some() || self.is_replaced() && self.candidate_heard().is_some()
    }

    /// Another stage begins in the place of its last life.
    pub(super) fn is_replaced(&self) -> bool {
        self.candidate.as_ref().is_some_and(|candidate| candidate.owns)
    }

    /// No life of it goes on.
    pub(crate) fn has_ended(&self) -> bool {
        self.process.as_ref().is_none_or(|process| process.ended.is_some())
    }

    /// A time in which nobody could say anything. Of a service that still says nothing no second one is forgiven: on a machine with too much to
    /// do the supervisor is late again and again.
    pub(super) fn forgive(&mut self, stood_still: Duration) {
        let lives = [&mut self.process, &mut self.candidate].into_iter().flatten();
        for process in lives.filter(|process| !process.forgiven) {
            process.quiet_since += stood_still;
            process.forgiven = true;
        }
    }

    /// Kills who says nothing any more.
    pub(super) fn kill_the_silent(&mut self, service: Service, rule: &Restart, news: &mut News) {
        // Until a candidate has begun to work, its exchange has a deadline for it.
        let candidate = self.candidate.as_mut().filter(|candidate| candidate.heard.is_some());
        let first_word_limit = if service.is_beside() { FIRST_WORD_LIMIT } else { self.lives.first_word_limit(rule) };
        for process in self.process.iter_mut().chain(candidate) {
            let (limit, what) = match &process.heard {
                Some(_) => {
                    let limit = Duration::from_secs_f64(rule.silence_s);
                    (if service.is_beside() { limit.max(SILENCE_BESIDE) } else { limit }, "said nothing")
                }
                None => (first_word_limit, "not opened its topics"),
            };
            let silent = process.quiet_since.elapsed();
            if silent > limit && process.ended.is_none() && !std::mem::replace(&mut process.given_up, true) {
                let ms = silent.as_millis();
                news.lines.push(format!("{service}: process {} has {what} for {ms} ms", process.pid));
                process.signal(Signal::KILL);
            }
        }
    }
}
