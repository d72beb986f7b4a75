//! Automatic promotion of a shadow stage by its difference from the stage in the slot: `[[watch]]`.

use std::{collections::BTreeMap, ops::Range};

use serde::{Deserialize, Serialize};

use crate::{Launch, Slot, StageConfig, problem::Problem, slot_stage::stage_config, toml_reader::Section};

/// Rule that promotes a shadow stage by its measured difference, and rolls it back.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PromotionRule {
    /// Slot to which the rule applies. Each slot has at most one rule.
    pub slot: Slot,
    /// Shadow stage that runs in parallel with the stage in the slot.
    pub stage: StageConfig,
    /// Difference between the two attitudes that is measured.
    pub measure: Measure,
    /// Threshold below which the shadow is promoted, °. 0 disables promotion.
    pub promote_below_deg: f64,
    /// Time for which the difference must stay below `promote_below_deg` before the promotion, s.
    pub promote_after_s: f64,
    /// Threshold above which a promotion is rolled back, °. Larger than `promote_below_deg`.
    pub rollback_above_deg: f64,
    /// Time for which the difference must stay above `rollback_above_deg` before the rollback, s.
    pub rollback_after_s: f64,
    /// Maximum number of promotions per run.
    pub limit: u64,
}

/// Difference between two attitudes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Measure {
    /// Angle of the rotation between the attitudes.
    Angle,
    /// Angle between the verticals.
    Inclination,
    /// Difference between the headings.
    Heading,
}

const MEASURES: [(&str, Measure); 3] =
    [("angle", Measure::Angle), ("inclination", Measure::Inclination), ("heading", Measure::Heading)];
/// Maximum value of `promote_after_s` and `rollback_after_s`, s.
const MAX_AFTER_S: f64 = 86_400.0;

/// Reads every `[[watch]]`.
pub(crate) fn promotion_rules(section: &mut Section<'_, '_>, launch: &mut Launch) {
    let mut spans: Vec<(Slot, Range<usize>)> = Vec::new();
    section.tables("watch", |section, span| {
        let Some(rule) = promotion_rule(section, &span, launch) else { return };
        if let Some((slot, first)) = spans.iter().find(|(slot, _)| *slot == rule.slot) {
            section.report(Problem {
                context: Some((first.clone(), "first watched here".into())),
                ..Problem::new(span, format!("watch: the slot \"{slot}\" is watched twice"), "watched again")
            });
            return;
        }
        spans.push((rule.slot, span));
        launch.watch.push(rule);
    });
}

fn promotion_rule(section: &mut Section<'_, '_>, span: &Range<usize>, launch: &Launch) -> Option<PromotionRule> {
    let mut rule = PromotionRule {
        slot: Slot::Fuser,
        stage: StageConfig { stage: String::new(), set: BTreeMap::new() },
        measure: Measure::Inclination,
        promote_below_deg: 0.0,
        promote_after_s: 10.0,
        rollback_above_deg: 180.0,
        rollback_after_s: 1.0,
        limit: 1,
    };
    let PromotionRule {
        slot,
        stage,
        measure,
        promote_below_deg,
        promote_after_s,
        rollback_above_deg,
        rollback_after_s,
        limit,
    } = &mut rule;
    let slots: Vec<_> = Slot::ALL.iter().map(|slot| (slot.name(), *slot)).collect();
    let mut valid = section.choice("slot", slots, slot) & stage_config(section, *slot, &launch.stages, stage);
    valid &= section.choice("measure", MEASURES, measure);
    let bounds_valid = section.number("promote_below_deg", 0.0..=180.0, promote_below_deg)
        & section.number("rollback_above_deg", 0.0..=180.0, rollback_above_deg);
    valid &= section.number("promote_after_s", 0.1..=MAX_AFTER_S, promote_after_s);
    valid &= section.number("rollback_after_s", 0.1..=MAX_AFTER_S, rollback_after_s);
    valid &= section.integer("limit", 1..=1000, limit);
    if !section.has("stage") {
        section.report(Problem::new(span.clone(), "watch: stage is missing", "expected stage"));
        valid = false;
    }
    if bounds_valid && rollback_above_deg <= promote_below_deg {
        let title = format!(
            "watch.rollback_above_deg = {rollback_above_deg} must be more than promote_below_deg = {promote_below_deg}"
        );
        let span = section.span("rollback_above_deg").unwrap_or_else(|| span.clone());
        section.report(Problem {
            note: Some("between the two thresholds the owner stays unchanged".into()),
            ..Problem::new(span, title, format!("expected more than {promote_below_deg}"))
        });
        valid = false;
    }
    (valid & bounds_valid).then_some(rule)
}

#[cfg(test)]
mod tests {
    use super::*;

    const COMPLETE: &str = "[[watch]]\nslot = \"fuser\"\nstage = \"aided\"\nmeasure = \"heading\"\npromote_below_deg = 0.5\n\
                         promote_after_s = 3\nrollback_above_deg = 2\nrollback_after_s = 0.5\nlimit = 4\n";

    #[test]
    fn every_key_of_a_watch_is_read() {
        let launch = Launch::parse(
            "launch.toml",
            &format!("{COMPLETE}set = {{ earth_rate = 0 }}\n").replace("set = { earth_rate = 0 }\n", ""),
        )
        .unwrap();
        let expected = PromotionRule {
            slot: Slot::Fuser,
            stage: StageConfig { stage: "aided".into(), set: BTreeMap::new() },
            measure: Measure::Heading,
            promote_below_deg: 0.5,
            promote_after_s: 3.0,
            rollback_above_deg: 2.0,
            rollback_after_s: 0.5,
            limit: 4,
        };
        assert_eq!(launch.watch, [expected]);
    }

    #[test]
    fn each_invalid_entry_is_reported_at_its_location() {
        let cases = [
            (COMPLETE.replace("\"aided\"", "\"aidd\""), ":3:9\n", "did you mean \"aided\"?"),
            (COMPLETE.replace("stage = \"aided\"\n", ""), ":1:1\n", "watch: stage is missing"),
            (COMPLETE.replace("\"heading\"", "\"yaw\""), ":4:11\n", "unknown value \"yaw\""),
            (COMPLETE.replace("_deg = 2", "_deg = 0.5"), ":7:22\n", "must be more than promote_below_deg = 0.5"),
            (COMPLETE.replace("limit = 4", "limit = 0"), ":9:9\n", "expected 1 to 1000, found 0"),
            (format!("{COMPLETE}{COMPLETE}"), ":10:1\n", "the slot \"fuser\" is watched twice"),
        ];
        for (text, location, expected) in cases {
            let shown = Launch::parse("launch.toml", &text).unwrap_err().to_string();
            assert!(shown.contains(location) && shown.contains(expected), "{location}{expected}:\n{shown}");
            assert!(shown.ends_with("1 problem"), "{expected}:\n{shown}");
        }
    }
}
