//! Stages that take over by themselves: the rule of a `[[watch]]`, and what it asks of the exchange.
//!
//! Input: the differences that a shadow says, and how exchanges went. Output: wishes, as people have them. Time: that of the ticks for
//! the bounds, the clock between attempts. Failure: a shadow that does not live is tried again a few times, then given up.

use std::time::{Duration, Instant};

use bus::Subscriber;
use launch::{Launch, Measure, Stage, Watch};
use messages::Difference;
use runtime::orders::BUFFER_BESIDE;
use swap::Outcome;

use crate::{
    UpError,
    collector::Collector,
    crew::Crew,
    exchange::{Exchange, Wish},
    memory::Memory,
};

/// Attempts in a row that fail before a watch is given up.
const ATTEMPTS_MAX: u32 = 5;
/// Between two attempts.
const PAUSE: Duration = Duration::from_secs(1);

/// The watches of a system.
pub(crate) struct Watches {
    differences: Option<Subscriber<Difference>>,
    rate_hz: f64,
    all: Vec<Attended>,
}

/// A watch, and what it has asked for.
struct Attended {
    rule: Rule,
    shadow: Option<u64>,
    takeover: Option<u64>,
    attempts: u32,
    due: Instant,
}

/// When the stage beside takes over.
struct Rule {
    watch: Watch,
    /// What fills the slot when the watched stage does not.
    home: Stage,
    /// The watched stage fills the slot.
    trusted: bool,
    promotions: u64,
    /// Since when the bound that matters has held, s.
    since_s: Option<f64>,
    over: bool,
}

impl Watches {
    /// The watches of a launch file. `differences` is where shadows say how far they are.
    pub(crate) fn new(launch: &Launch, rate_hz: f64, differences: Option<Subscriber<Difference>>) -> Self {
        let attended = |watch: &Watch| {
            let home = launch.slot(watch.slot)?.clone();
            let rule = Rule { watch: watch.clone(), home, trusted: false, promotions: 0, since_s: None, over: false };
            Some(Attended { rule, shadow: None, takeover: None, attempts: 0, due: Instant::now() })
        };
        Self { differences, rate_hz, all: launch.watch.iter().filter_map(attended).collect() }
    }

    /// The exchange and the bus of the shadows are no more.
    pub(crate) fn leave_bus(&mut self) {
        self.differences = None;
        for attended in &mut self.all {
            (attended.shadow, attended.takeover, attended.rule.since_s) = (None, None, None);
        }
    }

    /// Where shadows say how far they are on another bus.
    pub(crate) fn go_on_at(&mut self, differences: Option<Subscriber<Difference>>) {
        self.differences = differences;
    }

    /// Somebody asks by hand: the slot's watch is over.
    pub(crate) fn yield_to(&mut self, slot: &str, exchange: &mut Exchange, crew: &mut Crew, memory: &mut Memory) {
        for Attended { rule, shadow, .. } in self.all.iter_mut().filter(|one| one.rule.watch.slot.name() == slot) {
            if shadow.take().is_some() {
                exchange.cancel(rule.watch.slot, crew, memory);
            }
            rule.over = true;
        }
    }

    /// Hears how far the shadows are, and asks for what follows; what people are told comes into `lines`.
    pub(crate) fn go_on(
        &mut self,
        exchange: &mut Exchange,
        collector: &mut Collector,
        crew: &mut Crew,
        memory: &mut Memory,
        lines: &mut Vec<String>,
    ) -> Result<(), UpError> {
        let Self { differences: Some(differences), rate_hz, all } = self else { return Ok(()) };
        let mut heard = Vec::new();
        differences.drain(BUFFER_BESIDE, |difference| heard.push(difference))?;
        for Attended { rule, shadow, takeover, attempts, due } in all {
            let slot = rule.watch.slot;
            let mut wish = |stage: &Stage, shadow: bool| {
                let limit_ms = (!shadow).then_some(Wish::LIMIT_MS);
                let (slot, stage) = (slot.name().into(), stage.clone());
                let wish = Wish { slot, stage, shadow, expected_epoch: None, limit_ms };
                exchange.wish(wish, collector, crew, memory)
            };
            for difference in heard.iter().filter(|it| it.service == slot as u32 && shadow.is_some()) {
                if takeover.is_none() && rule.judge(difference, difference.tick as f64 / *rate_hz) {
                    lines.push(rule.says(difference));
                    *takeover = Some(wish(rule.beside(), false));
                }
            }
            if shadow.is_none() && takeover.is_none() && !rule.over && Instant::now() >= *due {
                *shadow = Some(wish(rule.beside(), true));
            }
            // A takeover answers the shadow too.
            let answer = takeover.and_then(|id| exchange.take_answer(id));
            let ended = shadow.and_then(|id| exchange.take_answer(id));
            if answer.is_some() || ended.is_some() {
                (*shadow, *due) = (None, Instant::now() + PAUSE);
            }
            if answer.is_some() {
                *takeover = None;
            }
            match answer.or(ended.filter(|_| takeover.is_none())) {
                Some(report) if report.outcome == Outcome::Committed => {
                    *attempts = 0;
                    rule.took_over();
                }
                Some(report) => {
                    *attempts += 1;
                    rule.since_s = None;
                    rule.over |= *attempts == ATTEMPTS_MAX;
                    let then = if rule.over { "; the watch is given up" } else { "" };
                    let reason = report.reason.unwrap_or_default();
                    lines.push(format!("watch {slot}: {} does not run beside: {reason}{then}", report.to));
                }
                None => {}
            }
        }
        Ok(())
    }
}

impl Rule {
    /// What is to run beside the stage in the slot.
    fn beside(&self) -> &Stage {
        if self.trusted { &self.home } else { &self.watch.stage }
    }

    /// Whether the stage beside is to take over, now that the difference is this.
    fn judge(&mut self, difference: &Difference, at_s: f64) -> bool {
        let Watch { promote_below_deg, promote_after_s, rollback_above_deg, rollback_after_s, .. } = self.watch;
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
        let watch = Watch {
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
