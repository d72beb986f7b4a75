//! Promotion rules of the launch file (`[[watch]]`), each with its requests in progress.
//!
//! - Input: differences published by the shadow, and swap reports.
//! - Output: whether the shadow takes over, and lines for the user.
//! - Time: tick time for the bounds, supervisor time between attempts.
//! - Failure: a shadow that fails is retried a limited number of times, then the watch ends.

use std::time::Duration;

use control::SwapReport;
use launch::{Launch, Measure, StageConfig};
use messages::Difference;
use swap::SwapOutcome;

/// Consecutive failed attempts after which a watch ends.
const MAX_ATTEMPTS: u32 = 5;
const RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// Watch with its requests in progress.
#[derive(Debug)]
pub(crate) struct WatchRunner {
    pub(crate) rule: PromotionRule,
    pub(crate) shadow: Option<u64>,
    pub(crate) takeover: Option<u64>,
    /// Swap reports for requests of this watch, received since the previous poll.
    pub(crate) reports: Vec<(u64, SwapReport)>,
    pub(crate) attempts: u32,
    pub(crate) next_attempt: Duration,
}

/// Promotion rule of a watch and its state.
#[derive(Debug)]
pub(crate) struct PromotionRule {
    pub(crate) config: launch::PromotionRule,
    /// Stage of the slot while the watched stage is not promoted.
    pub(crate) default_stage: StageConfig,
    /// Set while the watched stage fills the slot.
    pub(crate) is_promoted: bool,
    pub(crate) promotions: u64,
    /// Tick time in s since which the current bound has been met without interruption.
    pub(crate) bound_met_since_s: Option<f64>,
    pub(crate) ended: bool,
}

/// Creates a runner for each watch of a launch file.
pub(crate) fn from_launch(launch: &Launch) -> Vec<WatchRunner> {
    let runner = |watch: &launch::PromotionRule| {
        let default_stage = launch.stage(watch.slot).clone();
        let rule = PromotionRule {
            config: watch.clone(),
            default_stage,
            is_promoted: false,
            promotions: 0,
            bound_met_since_s: None,
            ended: false,
        };
        let (reports, next_attempt) = (Vec::new(), Duration::ZERO);
        WatchRunner { rule, shadow: None, takeover: None, reports, attempts: 0, next_attempt }
    };
    launch.watch.iter().map(runner).collect()
}

impl WatchRunner {
    /// Processes the reports received since the previous call. Returns a line to print, if any.
    pub(crate) fn process_reports(&mut self, now: Duration) -> Option<String> {
        let reports = std::mem::take(&mut self.reports);
        let report_for = |id: Option<u64>| reports.iter().find(|(request, _)| Some(*request) == id).cloned();
        // The report of a takeover also concludes the request for the shadow.
        let (takeover_report, shadow_report) = (report_for(self.takeover), report_for(self.shadow));
        if takeover_report.is_some() || shadow_report.is_some() {
            (self.shadow, self.next_attempt) = (None, now + RETRY_INTERVAL);
        }
        let shadow_report = shadow_report.filter(|_| self.takeover.is_none());
        if takeover_report.is_some() {
            self.takeover = None;
        }
        let (_, report) = takeover_report.or(shadow_report)?;
        if report.outcome == SwapOutcome::Committed {
            self.attempts = 0;
            self.rule.on_takeover();
            return None;
        }
        self.attempts += 1;
        self.rule.bound_met_since_s = None;
        self.rule.ended |= self.attempts == MAX_ATTEMPTS;
        let suffix = if self.rule.ended { "; the watch has ended" } else { "" };
        let reason = report.reason.unwrap_or_default();
        let reason = reason.with_lines();
        Some(format!("watch {}: {} failed: {reason}{suffix}", self.rule.config.slot, report.to))
    }
}

impl PromotionRule {
    /// Returns the stage that runs as a shadow.
    pub(crate) fn shadow_stage(&self) -> &StageConfig {
        if self.is_promoted { &self.default_stage } else { &self.config.stage }
    }

    /// Updates the rule with a difference and returns `true` if the shadow should take over.
    pub(crate) fn should_take_over(&mut self, difference: &Difference, at_s: f64) -> bool {
        let launch::PromotionRule { promote_below_deg, promote_after_s, rollback_above_deg, rollback_after_s, .. } =
            self.config;
        let now_deg = self.measured_deg(difference);
        let (is_bound_met, required_s) = if self.is_promoted {
            (now_deg > rollback_above_deg, rollback_after_s)
        } else {
            (now_deg < promote_below_deg, promote_after_s)
        };
        if !is_bound_met {
            self.bound_met_since_s = None;
            return false;
        }
        at_s - *self.bound_met_since_s.get_or_insert(at_s) >= required_s
    }

    fn on_takeover(&mut self) {
        self.bound_met_since_s = None;
        self.is_promoted = !self.is_promoted;
        self.promotions += u64::from(self.is_promoted);
        self.ended = !self.is_promoted && self.promotions >= self.config.limit;
    }

    fn measured_deg(&self, difference: &Difference) -> f64 {
        let [angle, inclination, heading] = difference.now_rad;
        match self.config.measure {
            Measure::Angle => angle,
            Measure::Inclination => inclination,
            Measure::Heading => heading,
        }
        .to_degrees()
    }

    pub(crate) fn takeover_message(&self, difference: &Difference) -> String {
        let (slot, stage) = (self.config.slot, &self.shadow_stage().stage);
        let (now_deg, tick) = (self.measured_deg(difference), difference.tick);
        let change = if self.is_promoted { "rolling back to" } else { "promoting" };
        format!("watch {slot}: {change} {stage}: difference {now_deg:.3}° at tick {tick}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use launch::Slot;

    fn rule() -> PromotionRule {
        let stage = |name: &str| StageConfig { stage: name.into(), set: Default::default() };
        let watch = launch::PromotionRule {
            slot: Slot::Fuser,
            stage: stage("aided"),
            measure: Measure::Heading,
            promote_below_deg: 1.0,
            promote_after_s: 2.0,
            rollback_above_deg: 3.0,
            rollback_after_s: 0.5,
            limit: 2,
        };
        PromotionRule {
            config: watch,
            default_stage: stage("wz"),
            is_promoted: false,
            promotions: 0,
            bound_met_since_s: None,
            ended: false,
        }
    }

    /// Returns the indices in `headings_deg` at which the shadow should take over. Differences are
    /// published every 0.1 s.
    fn takeovers(rule: &mut PromotionRule, headings_deg: &[f64]) -> Vec<usize> {
        let difference = |deg: &f64| Difference { now_rad: [9.0, 9.0, deg.to_radians()], ..Difference::zeroed() };
        (0..headings_deg.len())
            .filter(|i| rule.should_take_over(&difference(&headings_deg[*i]), *i as f64 * 0.1))
            .collect()
    }

    #[test]
    fn stage_is_promoted_after_bound_holds_without_interruption() {
        let mut headings = vec![0.5; 30];
        headings[15] = 1.5;
        assert_eq!(takeovers(&mut rule(), &headings), Vec::<usize>::new());
        headings[15] = 0.5;
        assert_eq!(takeovers(&mut rule(), &headings)[0], 20);
    }

    #[test]
    fn rollback_only_above_rollback_bound() {
        let mut rule = rule();
        rule.on_takeover();
        assert_eq!(rule.shadow_stage().stage, "wz");
        assert_eq!(takeovers(&mut rule, &[2.9; 100]), Vec::<usize>::new());
        assert_eq!(takeovers(&mut rule, &[3.1; 8])[0], 5);
        rule.on_takeover();
        assert_eq!((rule.shadow_stage().stage.as_str(), rule.ended), ("aided", false));
    }

    #[test]
    fn watch_ends_after_promotion_limit() {
        let mut rule = rule();
        let over: Vec<_> = (0..4).map(|_| (rule.on_takeover(), rule.ended).1).collect();
        assert_eq!(over, [false, false, false, true]);
    }
}
