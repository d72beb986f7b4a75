//! Requests from their beginning to their answer, and what becomes of the attitudes in between.

use launch::Service;
use swap::{Outcome, Reason, Report};

use crate::{OutputProgress, SwapReport};

/// Attitudes after the commitment that belong to the longest interval across it.
const TICKS_AFTER: u64 = 50;
/// For how long they are waited for, ms.
const WAIT_AFTER_MS: u64 = 500;

/// Requests that are under way, or whose attitudes are still collected.
#[derive(Debug, Default)]
pub(crate) struct PendingSwaps {
    waiting: Vec<Pending>,
}

/// Who is answered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Asker {
    /// Somebody at the control socket; where it is a shadow, of this slot, it ends with whoever asked.
    Caller { caller: u64, shadow: Option<Service> },
    /// The watch of a slot.
    Watch(Service),
    /// Who asked is gone.
    Nobody,
}

/// A request that is under way.
#[derive(Debug)]
pub(crate) struct Pending {
    id: u64,
    asker: Asker,
    service: Service,
    from: String,
    to: String,
    lost: u64,
    duplicated: u64,
    /// The longest interval between two attitudes so far.
    gap_ns: u64,
    /// It was answered then, and the attitudes after it are collected.
    done: Option<Done>,
}

/// How a swap went, why not, and when that was known, ms.
#[derive(Debug, Clone)]
struct Done {
    report: Report,
    reason: Option<String>,
    at_ms: u64,
}

impl Pending {
    pub(crate) fn new(
        id: u64,
        asker: Asker,
        service: Service,
        from: String,
        to: String,
        output: &OutputProgress,
    ) -> Self {
        let OutputProgress { lost, duplicated, .. } = *output;
        Self { id, asker, service, from, to, lost, duplicated, gap_ns: 0, done: None }
    }

    /// The attitudes after the swap have come.
    fn is_settled(&self, now_ms: u64, next_tick: u64) -> bool {
        self.done.as_ref().is_some_and(|Done { report, at_ms, .. }| {
            report.commit_tick.is_none_or(|tick| next_tick > tick + TICKS_AFTER || now_ms > at_ms + WAIT_AFTER_MS)
        })
    }

    fn report(self, output: &OutputProgress) -> (u64, Asker, SwapReport) {
        let Self { id, asker, service, from, to, lost, duplicated, gap_ns, done } = self;
        let (report, reason) = done.map_or((None, None), |done| (Some(done.report), done.reason));
        let commit_tick = report.as_ref().and_then(|report| report.commit_tick);
        let jump_rad = output.swapped.filter(|(tick, _)| Some(*tick) == commit_tick).map_or(0.0, |(_, jump)| jump);
        let report = SwapReport {
            slot: service.name().into(),
            from,
            to,
            commit_tick,
            lost: output.lost.saturating_sub(lost),
            duplicated: output.duplicated.saturating_sub(duplicated),
            gap_us: gap_ns as f64 * 1e-3,
            jump_deg: jump_rad.to_degrees(),
            outcome: report.map_or(Outcome::Aborted, |report| report.outcome),
            reason,
        };
        (id, asker, report)
    }
}

impl PendingSwaps {
    /// A request is not answered yet.
    pub(crate) fn is_busy(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// A request begins.
    pub(crate) fn open(&mut self, pending: Pending) {
        self.waiting.push(pending);
    }

    /// Who asked is gone; the slot of the shadow that ends with it.
    pub(crate) fn forget_caller(&mut self, gone: u64) -> Option<Service> {
        let is_gone = |asker: Asker| matches!(asker, Asker::Caller { caller, .. } if caller == gone);
        let pending = self.waiting.iter_mut().find(|pending| is_gone(pending.asker))?;
        match std::mem::replace(&mut pending.asker, Asker::Nobody) {
            Asker::Caller { shadow, .. } => shadow,
            _ => None,
        }
    }

    /// A slot's coordinator has answered: who asked for a shadow, and who asked for its promotion. `last_words` are those of the process
    /// that ended last.
    pub(crate) fn settle(&mut self, service: Service, report: &Report, last_words: &str, now_ms: u64) {
        let busy = matches!(report.reason, Some(Reason::Busy { .. }));
        let asked = |waiting: &&mut Pending| {
            waiting.service == service && waiting.done.is_none() && (!busy || waiting.id == report.id)
        };
        let reason = report.reason.as_ref().map(|reason| match reason {
            Reason::CandidateDied if !last_words.is_empty() => format!("{reason}; it said:\n{last_words}"),
            _ => reason.to_string(),
        });
        let done = Done { report: report.clone(), reason, at_ms: now_ms };
        for waiting in self.waiting.iter_mut().filter(asked) {
            waiting.done = Some(done.clone());
        }
    }

    /// The answers to what is settled, once the attitudes after it have come.
    pub(crate) fn finish(&mut self, now_ms: u64, output: &OutputProgress) -> Vec<(u64, Asker, SwapReport)> {
        let settled = self.waiting.extract_if(.., |pending| pending.is_settled(now_ms, output.next_tick));
        settled.map(|pending| pending.report(output)).collect()
    }

    /// The answers to all that waits: what is not settled comes to nothing, for this reason.
    pub(crate) fn abort(&mut self, reason: &str, output: &OutputProgress) -> Vec<(u64, Asker, SwapReport)> {
        let answer = |pending: Pending| {
            let unsettled = pending.done.is_none();
            let (id, asker, mut report) = pending.report(output);
            if unsettled {
                report.reason = Some(reason.into());
            }
            (id, asker, report)
        };
        self.waiting.drain(..).map(answer).collect()
    }

    /// An interval belongs to every request that waits.
    pub(crate) fn note_gap(&mut self, gap_ns: u64) {
        self.waiting.iter_mut().for_each(|waiting| waiting.gap_ns = waiting.gap_ns.max(gap_ns));
    }
}
