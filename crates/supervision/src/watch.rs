//! Stages that take over by themselves: the rule of a `[[watch]]`, and what it asks for.
//!
//! Input: the differences that a shadow says, and how swaps went. Output: requests, as people have them. Time: that of the ticks for
//! the bounds, that of the supervisor between attempts. Failure: a shadow that does not live is tried again a few times, then given up.

use std::time::Duration;

use launch::{Launch, Measure, Service, Stage};
use messages::Difference;
use swap::Outcome;

use crate::{Supervision, SwapReport, SwapRequest, pending_swaps::Asker};

/// Attempts in a row that fail before a watch is given up.
const ATTEMPTS_MAX: u32 = 5;
/// Between two attempts.
const PAUSE: Duration = Duration::from_secs(1);

/// A watch, and what it has asked for.
#[derive(Debug)]
pub(crate) struct Watch {
    rule: Rule,
    shadow: Option<u64>,
    takeover: Option<u64>,
    /// How its requests went, until it looks.
    answers: Vec<(u64, SwapReport)>,
    attempts: u32,
    due: Duration,
}

/// When the stage beside takes over.
#[derive(Debug)]
struct Rule {
    watch: launch::Watch,
    /// What fills the slot when the watched stage does not.
    home: Stage,
    /// The watched stage fills the slot.
    trusted: bool,
    promotions: u64,
    /// Since when the bound that matters has held, s.
    since_s: Option<f64>,
    over: bool,
}

/// The watches of a launch file.
pub(crate) fn watches(launch: &Launch) -> Vec<Watch> {
    let watch = |watch: &launch::Watch| {
        let home = launch.slot(watch.slot)?.clone();
        let rule = Rule { watch: watch.clone(), home, trusted: false, promotions: 0, since_s: None, over: false };
        let (answers, due) = (Vec::new(), Duration::ZERO);
        Some(Watch { rule, shadow: None, takeover: None, answers, attempts: 0, due })
    };
    launch.watch.iter().filter_map(watch).collect()
}

impl Supervision {
    /// The shadows of the watches are no more.
    pub(crate) fn leave_watches(&mut self) {
        for watch in &mut self.watches {
            (watch.shadow, watch.takeover, watch.rule.since_s) = (None, None, None);
            watch.answers.clear();
        }
    }

    /// Somebody asks by hand: the slot's watch is over.
    pub(crate) fn yield_watch(&mut self, slot: &str) {
        for index in 0..self.watches.len() {
            let Watch { rule, shadow, .. } = &mut self.watches[index];
            if rule.watch.slot.name() == slot {
                rule.over = true;
                if shadow.take().is_some() {
                    let slot = rule.watch.slot;
                    self.notify_slot(slot, swap::Event::Cancel);
                }
            }
        }
    }

    /// A shadow says how far it is: where the bound has held long enough it takes over.
    pub(crate) fn on_difference(&mut self, difference: &Difference) {
        let at_s = difference.tick as f64 / self.config.rate_hz;
        for index in 0..self.watches.len() {
            let Watch { rule, shadow, takeover, .. } = &mut self.watches[index];
            let concerned = difference.service == rule.watch.slot as u32 && shadow.is_some() && takeover.is_none();
            if concerned && rule.judge(difference, at_s) {
                let line = rule.says(difference);
                self.announce(line);
                let takeover = self.ask_for_watch(index, false);
                self.watches[index].takeover = Some(takeover);
            }
        }
    }

    pub(crate) fn on_watch_answer(&mut self, service: Service, id: u64, report: SwapReport) {
        for watch in self.watches.iter_mut().filter(|watch| watch.rule.watch.slot == service) {
            watch.answers.push((id, report.clone()));
        }
    }

    /// Asks for the shadows that are to run, and takes how what was asked for went.
    pub(crate) fn poll_watches(&mut self) {
        if !self.flow.is_running() {
            return;
        }
        for index in 0..self.watches.len() {
            let Watch { rule, shadow, takeover, due, .. } = &self.watches[index];
            if shadow.is_none() && takeover.is_none() && !rule.over && self.now >= *due {
                let shadow = self.ask_for_watch(index, true);
                self.watches[index].shadow = Some(shadow);
            }
            if let Some(line) = self.watches[index].take_answers(self.now) {
                self.announce(line);
            }
        }
    }

    /// Asks for the stage beside to run as a shadow, or to take over.
    fn ask_for_watch(&mut self, index: usize, shadow: bool) -> u64 {
        let rule = &self.watches[index].rule;
        let (service, stage) = (rule.watch.slot, rule.beside().clone());
        let limit_ms = (!shadow).then_some(SwapRequest::LIMIT_MS);
        let request = SwapRequest { slot: service.name().into(), stage, shadow, expected_epoch: None, limit_ms };
        self.request_swap(request, Asker::Watch(service))
    }
}

impl Watch {
    /// Takes how its requests went; what people are to be told.
    fn take_answers(&mut self, now: Duration) -> Option<String> {
        let answers = std::mem::take(&mut self.answers);
        let answer_to = |id: Option<u64>| answers.iter().find(|(answered, _)| Some(*answered) == id).cloned();
        // A takeover answers the shadow too.
        let (answer, ended) = (answer_to(self.takeover), answer_to(self.shadow));
        if answer.is_some() || ended.is_some() {
            (self.shadow, self.due) = (None, now + PAUSE);
        }
        let ended = ended.filter(|_| self.takeover.is_none());
        if answer.is_some() {
            self.takeover = None;
        }
        let (_, report) = answer.or(ended)?;
        if report.outcome == Outcome::Committed {
            self.attempts = 0;
            self.rule.took_over();
            return None;
        }
        self.attempts += 1;
        self.rule.since_s = None;
        self.rule.over |= self.attempts == ATTEMPTS_MAX;
        let then = if self.rule.over { "; the watch is given up" } else { "" };
        let reason = report.reason.unwrap_or_default();
        Some(format!("watch {}: {} does not run beside: {reason}{then}", self.rule.watch.slot, report.to))
    }
}

impl Rule {
    /// What is to run beside the stage in the slot.
    fn beside(&self) -> &Stage {
        if self.trusted { &self.home } else { &self.watch.stage }
    }

    /// Whether the stage beside is to take over, now that the difference is this.
    fn judge(&mut self, difference: &Difference, at_s: f64) -> bool {
        let launch::Watch { promote_below_deg, promote_after_s, rollback_above_deg, rollback_after_s, .. } = self.watch;
        let now_deg = self.measured_deg(difference);
        let (holds, after_s) = if self.trusted {
            (now_deg > rollback_above_deg, rollback_after_s)
        } else {
            (now_deg < promote_below_deg, promote_after_s)
        };
        if !holds {
            self.since_s = None;
            return false;
        }
        at_s - *self.since_s.get_or_insert(at_s) >= after_s
    }

    fn took_over(&mut self) {
        self.since_s = None;
        self.trusted = !self.trusted;
        self.promotions += u64::from(self.trusted);
        self.over = !self.trusted && self.promotions >= self.watch.limit;
    }

    fn measured_deg(&self, difference: &Difference) -> f64 {
        let [angle, inclination, heading] = difference.now_rad;
        match self.watch.measure {
            Measure::Angle => angle,
            Measure::Inclination => inclination,
            Measure::Heading => heading,
        }
        .to_degrees()
    }

    fn says(&self, difference: &Difference) -> String {
        let (slot, stage) = (self.watch.slot, &self.beside().stage);
        let (now_deg, tick) = (self.measured_deg(difference), difference.tick);
        let why = if self.trusted { "comes back" } else { "has proved itself" };
        format!("watch {slot}: {stage} {why}: {now_deg:.3}° apart at tick {tick}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use launch::Service;

    fn rule() -> Rule {
        let stage = |name: &str| Stage { stage: name.into(), set: Default::default() };
        let watch = launch::Watch {
            slot: Service::Fuser,
            stage: stage("aided"),
            measure: Measure::Heading,
            promote_below_deg: 1.0,
            promote_after_s: 2.0,
            rollback_above_deg: 3.0,
            rollback_after_s: 0.5,
            limit: 2,
        };
        Rule { watch, home: stage("wz"), trusted: false, promotions: 0, since_s: None, over: false }
    }

    /// The times at which the stage beside is to take over, of differences said every 0.1 s.
    fn takeovers(rule: &mut Rule, headings_deg: &[f64]) -> Vec<usize> {
        let apart = |deg: &f64| Difference { now_rad: [9.0, 9.0, deg.to_radians()], ..Difference::zeroed() };
        (0..headings_deg.len()).filter(|i| rule.judge(&apart(&headings_deg[*i]), *i as f64 * 0.1)).collect()
    }

    #[test]
    fn a_stage_is_promoted_once_the_bound_has_held_without_a_break() {
        let mut headings = vec![0.5; 30];
        headings[15] = 1.5;
        assert_eq!(takeovers(&mut rule(), &headings), Vec::<usize>::new());
        headings[15] = 0.5;
        assert_eq!(takeovers(&mut rule(), &headings)[0], 20);
    }

    #[test]
    fn between_the_bounds_nothing_changes_and_beyond_them_the_former_stage_comes_back() {
        let mut rule = rule();
        rule.took_over();
        assert_eq!(rule.beside().stage, "wz");
        assert_eq!(takeovers(&mut rule, &[2.9; 100]), Vec::<usize>::new());
        assert_eq!(takeovers(&mut rule, &[3.1; 8])[0], 5);
        rule.took_over();
        assert_eq!((rule.beside().stage.as_str(), rule.over), ("aided", false));
    }

    #[test]
    fn after_so_many_promotions_a_watch_is_over() {
        let mut rule = rule();
        let over: Vec<_> = (0..4).map(|_| (rule.took_over(), rule.over).1).collect();
        assert_eq!(over, [false, false, false, true]);
    }
}
