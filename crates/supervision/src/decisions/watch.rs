//! Automatic promotion of shadows according to the `[[watch]]` rules of the launch file.
//!
//! - Input: differences published by the shadows, and the outcome of swaps.
//! - Output: swap requests, equivalent to those of a client.

use control::{SwapReport, SwapRequest};
use launch::{Service, Slot};
use messages::Difference;

use crate::{
    Supervision,
    state::{pending_swaps::Requester, promotion::WatchRunner},
};

impl Supervision {
    /// Discards the requests of all watches after their shadows were killed.
    pub(crate) fn clear_watches(&mut self) {
        for watch in &mut self.watches {
            (watch.shadow, watch.takeover, watch.rule.bound_met_since_s) = (None, None, None);
            watch.reports.clear();
        }
    }

    /// Ends the watch of a slot after a manual swap request, and stops its shadow.
    pub(crate) fn suspend_watch(&mut self, slot: &str) {
        for index in 0..self.watches.len() {
            let WatchRunner { rule, shadow, .. } = &mut self.watches[index];
            if rule.config.slot.name() == slot {
                rule.ended = true;
                if shadow.take().is_some() {
                    let slot = rule.config.slot;
                    self.notify_slot(slot, swap::Event::Cancel);
                }
            }
        }
    }

    /// Requests a takeover by each shadow that has met its bound for the required time.
    pub(crate) fn on_difference(&mut self, difference: &Difference) {
        let at_s = difference.tick as f64 / self.config.rate_hz;
        for index in 0..self.watches.len() {
            let WatchRunner { rule, shadow, takeover, .. } = &mut self.watches[index];
            let is_relevant =
                difference.service == Service::from(rule.config.slot) as u32 && shadow.is_some() && takeover.is_none();
            if is_relevant && rule.should_take_over(difference, at_s) {
                let line = rule.takeover_message(difference);
                self.announce(line);
                let takeover = self.request_for_watch(index, false);
                self.watches[index].takeover = Some(takeover);
            }
        }
    }

    pub(crate) fn on_watch_report(&mut self, slot: Slot, id: u64, report: SwapReport) {
        for watch in self.watches.iter_mut().filter(|watch| watch.rule.config.slot == slot) {
            watch.reports.push((id, report.clone()));
        }
    }

    /// Requests the missing shadows and processes the reports of earlier requests.
    pub(crate) fn poll_watches(&mut self) {
        if !self.flow.is_running() {
            return;
        }
        for index in 0..self.watches.len() {
            let WatchRunner { rule, shadow, takeover, next_attempt, .. } = &self.watches[index];
            if shadow.is_none() && takeover.is_none() && !rule.ended && self.now >= *next_attempt {
                let shadow = self.request_for_watch(index, true);
                self.watches[index].shadow = Some(shadow);
            }
            if let Some(line) = self.watches[index].process_reports(self.now) {
                self.announce(line);
            }
        }
    }

    /// Requests the watched stage or the default stage, whichever does not currently fill the slot.
    /// Requests a shadow if `shadow` is set, otherwise a takeover. Returns the ID of the request.
    fn request_for_watch(&mut self, index: usize, shadow: bool) -> u64 {
        let rule = &self.watches[index].rule;
        let (slot, stage) = (rule.config.slot, rule.shadow_stage().clone());
        let timeout_ms = (!shadow).then_some(SwapRequest::DEFAULT_TIMEOUT_MS);
        let request = SwapRequest { slot: slot.name().into(), stage, shadow, expected_epoch: None, timeout_ms };
        self.request_swap(request, Requester::Watch(slot))
    }
}
