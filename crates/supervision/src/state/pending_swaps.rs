//! Tracks swap requests from receipt to reply, and their effect on the attitudes in the meantime.

use control::SwapReport;
use foreign::ForeignText;
use launch::Slot;
use swap::{FailureReason, Report, SwapOutcome};

use crate::OutputProgress;

/// Number of ticks after the commit tick that count towards the longest interval between attitudes
/// in the swap report.
const TICKS_AFTER_COMMIT: u64 = 50;
/// Time limit in ms for the attitudes after the commit tick to arrive.
const COMMIT_WAIT_TIMEOUT_MS: u64 = 500;

/// Swap requests in progress. A committed swap remains until the attitudes after its commit tick
/// have been collected or are overdue.
#[derive(Debug, Default)]
pub(crate) struct PendingSwaps {
    pending: Vec<Pending>,
}

/// Originator of a swap request, to which the reply is sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Requester {
    /// Client of the control socket. `shadow` is the slot of the requested shadow, which ends when
    /// the client disconnects.
    Client { client: u64, shadow: Option<Slot> },
    /// Promotion rule (`[[watch]]`) of a slot.
    Watch(Slot),
    /// Client that has disconnected.
    Disconnected,
}

/// Swap request in progress.
#[derive(Debug)]
pub(crate) struct Pending {
    id: u64,
    requester: Requester,
    slot: Slot,
    from: String,
    to: String,
    lost: u64,
    duplicated: u64,
    /// Longest interval between two consecutive attitudes since the request.
    max_gap_ns: u64,
    /// Outcome; `None` until the slot's coordinator reports it.
    completion: Option<Completion>,
}

/// Outcome of a swap, with the reason shown to the user.
#[derive(Debug, Clone)]
struct Completion {
    report: Report,
    reason: Option<ForeignText>,
    completed_ms: u64,
}

impl Pending {
    pub(crate) fn new(
        id: u64,
        requester: Requester,
        slot: Slot,
        from: String,
        to: String,
        output: &OutputProgress,
    ) -> Self {
        let OutputProgress { lost, duplicated, .. } = *output;
        Self { id, requester, slot, from, to, lost, duplicated, max_gap_ns: 0, completion: None }
    }

    /// Returns `true` once the outcome is known and the attitudes after the commit tick were
    /// collected or are overdue.
    fn is_settled(&self, now_ms: u64, next_tick: u64) -> bool {
        self.completion.as_ref().is_some_and(|Completion { report, completed_ms, .. }| {
            report.commit_tick.is_none_or(|tick| {
                next_tick > tick + TICKS_AFTER_COMMIT || now_ms > completed_ms + COMMIT_WAIT_TIMEOUT_MS
            })
        })
    }

    fn report(self, output: &OutputProgress) -> (u64, Requester, SwapReport) {
        let Self { id, requester, slot, from, to, lost, duplicated, max_gap_ns, completion } = self;
        let (report, reason) =
            completion.map_or((None, None), |completion| (Some(completion.report), completion.reason));
        let commit_tick = report.as_ref().and_then(|report| report.commit_tick);
        let jump_rad = output.last_swap.filter(|(tick, _)| Some(*tick) == commit_tick).map_or(0.0, |(_, jump)| jump);
        let report = SwapReport {
            slot: slot.name().into(),
            from: from.into(),
            to: to.into(),
            commit_tick,
            lost: output.lost.saturating_sub(lost),
            duplicated: output.duplicated.saturating_sub(duplicated),
            gap_us: max_gap_ns as f64 * 1e-3,
            jump_deg: jump_rad.to_degrees(),
            outcome: report.map_or(SwapOutcome::Aborted, |report| report.outcome),
            reason,
        };
        (id, requester, report)
    }
}

impl PendingSwaps {
    pub(crate) fn has_pending(&self) -> bool {
        !self.pending.is_empty()
    }

    pub(crate) fn push(&mut self, pending: Pending) {
        self.pending.push(pending);
    }

    /// Detaches a client from its request. Returns the slot of the shadow if the request was for a
    /// shadow.
    pub(crate) fn detach_client(&mut self, disconnected: u64) -> Option<Slot> {
        let is_disconnected =
            |requester: Requester| matches!(requester, Requester::Client { client, .. } if client == disconnected);
        let pending = self.pending.iter_mut().find(|pending| is_disconnected(pending.requester))?;
        match std::mem::replace(&mut pending.requester, Requester::Disconnected) {
            Requester::Client { shadow, .. } => shadow,
            _ => None,
        }
    }

    /// Records the outcome reported by a slot's coordinator.
    ///
    /// The report concerns both the request for a shadow and the request for its promotion.
    /// `last_stderr` is the last output on standard error of the slot's most recently exited
    /// process.
    pub(crate) fn complete(&mut self, slot: Slot, report: &Report, last_stderr: &ForeignText, now_ms: u64) {
        let busy = matches!(report.reason, Some(FailureReason::Busy { .. }));
        let is_completed =
            |swap: &&mut Pending| swap.slot == slot && swap.completion.is_none() && (!busy || swap.id == report.id);
        let reason = report.reason.as_ref().map(|reason| match reason {
            FailureReason::CandidateExited if !last_stderr.raw().is_empty() => {
                format!("{reason}; its stderr:\n{}", last_stderr.raw()).into()
            }
            _ => reason.to_string().into(),
        });
        let completion = Completion { report: report.clone(), reason, completed_ms: now_ms };
        for swap in self.pending.iter_mut().filter(is_completed) {
            swap.completion = Some(completion.clone());
        }
    }

    /// Removes and returns the settled requests with their reports.
    pub(crate) fn take_settled(&mut self, now_ms: u64, output: &OutputProgress) -> Vec<(u64, Requester, SwapReport)> {
        let settled = self.pending.extract_if(.., |pending| pending.is_settled(now_ms, output.next_tick));
        settled.map(|pending| pending.report(output)).collect()
    }

    /// Removes and returns all requests. Those without an outcome are reported as aborted for the
    /// given reason.
    pub(crate) fn abort_all(&mut self, reason: &str, output: &OutputProgress) -> Vec<(u64, Requester, SwapReport)> {
        let aborted = |pending: Pending| {
            let incomplete = pending.completion.is_none();
            let (id, requester, mut report) = pending.report(output);
            if incomplete {
                report.reason = Some(reason.into());
            }
            (id, requester, report)
        };
        self.pending.drain(..).map(aborted).collect()
    }

    /// Updates the longest interval between attitudes of every request in progress.
    pub(crate) fn record_gap(&mut self, gap_ns: u64) {
        self.pending.iter_mut().for_each(|swap| swap.max_gap_ns = swap.max_gap_ns.max(gap_ns));
    }
}
