//! Requests from their beginning to their answer, and what becomes of the attitudes in between.
//!
//! Input: requests, what the coordinators answer, attitudes as they are counted. Output: one report for each request, kept until it is
//! fetched. Time: that of the exchange, ms. Failure: none; the oldest report that nobody fetches is given up.

use launch::Service;
use swap::{Outcome, Reason, Report};

use super::SwapReport;
use crate::collector::Collector;

/// Attitudes after the commitment that belong to the longest interval across it.
const TICKS_AFTER: u64 = 50;
/// For how long they are waited for, ms.
const WAIT_AFTER_MS: u64 = 500;
/// Answers kept until they are fetched.
const ANSWERS_MAX: usize = 64;

/// Requests that are under way or settled.
#[derive(Default)]
pub(super) struct Desk {
    waiting: Vec<Waiting>,
    answers: Vec<(u64, SwapReport)>,
}

/// A request that is under way.
struct Waiting {
    id: u64,
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

/// How an exchange went, why not, and when that was known, ms.
#[derive(Clone)]
struct Done {
    report: Report,
    reason: Option<String>,
    at_ms: u64,
}

impl Desk {
    /// A request is not answered yet.
    pub(super) fn is_busy(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// A request begins.
    pub(super) fn open(&mut self, id: u64, service: Service, from: String, to: String, collector: &mut Collector) {
        self.note_gap(collector);
        let (lost, duplicated) = (collector.lost(), collector.duplicated());
        self.waiting.push(Waiting { id, service, from, to, lost, duplicated, gap_ns: 0, done: None });
    }

    /// A request that cannot begin is answered with the reason.
    pub(super) fn refuse(&mut self, id: u64, slot: String, from: String, to: String, reason: String) {
        let (commit_tick, outcome, reason) = (None, Outcome::Refused, Some(reason));
        let (lost, duplicated, gap_us, jump_deg) = (0, 0, 0.0, 0.0);
        let report = SwapReport { slot, from, to, commit_tick, lost, duplicated, gap_us, jump_deg, outcome, reason };
        self.answer(id, report);
    }

    /// A slot's coordinator has answered: who asked for a shadow, and who asked for its promotion. `last_words` are those of the stage
    /// that ended last.
    pub(super) fn settle(&mut self, service: Service, report: &Report, last_words: &str, now_ms: u64) {
        let busy = matches!(report.reason, Some(Reason::Busy { .. }));
        let asked = |waiting: &&mut Waiting| {
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

    /// Answers what is settled, once the attitudes after it have come.
    pub(super) fn finish(&mut self, now_ms: u64, collector: &mut Collector) {
        self.note_gap(collector);
        let next_tick = collector.next_tick();
        let settled = |waiting: &Waiting| {
            waiting.done.as_ref().is_some_and(|Done { report, at_ms, .. }| {
                report.commit_tick.is_none_or(|tick| next_tick > tick + TICKS_AFTER || now_ms > at_ms + WAIT_AFTER_MS)
            })
        };
        while let Some(place) = self.waiting.iter().position(settled) {
            let Waiting { id, service, from, to, lost, duplicated, gap_ns, done } = self.waiting.swap_remove(place);
            let Some(Done { report, reason, .. }) = done else { continue };
            let (lost, duplicated) = (collector.lost() - lost, collector.duplicated() - duplicated);
            let jump_deg = report.commit_tick.map_or(0.0, |tick| collector.jump_rad(tick).to_degrees());
            self.answer(
                id,
                SwapReport {
                    slot: service.name().into(),
                    from,
                    to,
                    commit_tick: report.commit_tick,
                    lost,
                    duplicated,
                    gap_us: gap_ns as f64 * 1e-3,
                    jump_deg,
                    outcome: report.outcome,
                    reason,
                },
            );
        }
    }

    /// The answer to a request, once.
    pub(super) fn take_answer(&mut self, id: u64) -> Option<SwapReport> {
        let place = self.answers.iter().position(|(answered, _)| *answered == id)?;
        Some(self.answers.swap_remove(place).1)
    }

    /// An interval belongs to every request that waits.
    fn note_gap(&mut self, collector: &mut Collector) {
        let gap_ns = collector.take_gap_ns();
        self.waiting.iter_mut().for_each(|waiting| waiting.gap_ns = waiting.gap_ns.max(gap_ns));
    }

    fn answer(&mut self, id: u64, report: SwapReport) {
        if self.answers.len() == ANSWERS_MAX {
            self.answers.remove(0);
        }
        self.answers.push((id, report));
    }
}
