//! Automatic promotion of a shadow stage, based on its difference from the stage in the slot:
//! `[[watch]]`.

use std::ops::Range;

use toml::Spanned;

use crate::{
    Slot, StageConfig,
    keys::{choices, keys},
    kind::{Inline, Tables, choice, one_of},
    problem::Problem,
    slot_stage,
    toml_reader::Section,
};

/// Allowed values of `promote_after_s` and `rollback_after_s`, s.
const AFTER_S: std::ops::RangeInclusive<f64> = 0.1..=86_400.0;

keys! {
    /// Rule that promotes a shadow stage, or rolls the promotion back, based on the measured
    /// difference.
    pub struct PromotionRule {
        /// Slot to which the rule applies.
        slot: Slot = slot_stage::DEFAULT_RULE_SLOT, one_of(Slot::ALL.map(|slot| (slot.name(), slot)));
        /// Shadow stage that runs in parallel with the stage in the slot.
        stage: StageConfig = StageConfig::new(""), Inline(slot_stage::read_keys);
        /// Measure of the difference between the two attitudes.
        measure: Measure = Measure::Inclination, choice();
        /// Threshold below which the shadow is promoted. 0 disables promotion.
        promote_below_deg: f64 = 0.0, 0.0..=180.0, unit "°", example "0.5";
        /// Time for which the difference must stay below `promote_below_deg` before the promotion.
        promote_after_s: f64 = 10.0, AFTER_S, unit "s";
        /// Threshold above which a promotion is rolled back. Must be larger than
        /// `promote_below_deg`.
        rollback_above_deg: f64 = 180.0, 0.0..=180.0, unit "°", example "2";
        /// Time for which the difference must stay above `rollback_above_deg` before the rollback.
        rollback_after_s: f64 = 1.0, AFTER_S, unit "s";
        /// Maximum number of promotions per run.
        limit: u64 = 1, 1..=1000;
    }
}

choices! {
    /// Difference between two attitudes.
    #[derive(Eq)]
    #[serde(rename_all = "lowercase")]
    pub enum Measure {
        /// Angle of the rotation between the attitudes.
        Angle = "angle",
        /// Angle between the verticals.
        Inclination = "inclination",
        /// Difference between the headings.
        Heading = "heading",
    }
}

/// Kind of the key `watch`.
pub(crate) const PROMOTION_RULES: Tables<PromotionRule> = Tables { read: promotion_rule, check: require_one_per_slot };

fn promotion_rule(section: &mut Section<'_, '_>, span: Range<usize>) -> Option<PromotionRule> {
    let before = section.problem_count();
    let mut rule = PromotionRule::default();
    rule.read_keys(section);
    if section.missing(&["stage"]).is_some() {
        section.report(Problem::new(span.clone(), "watch: stage is missing", "expected stage"));
    }
    let PromotionRule { promote_below_deg, rollback_above_deg, .. } = rule;
    if section.are_valid(&["promote_below_deg", "rollback_above_deg"]) && rollback_above_deg <= promote_below_deg {
        let title = format!(
            "watch.rollback_above_deg = {rollback_above_deg} must be more than promote_below_deg = {promote_below_deg}"
        );
        section.report(Problem {
            note: Some("between the two thresholds the owner stays unchanged".into()),
            ..Problem::new(
                section.span("rollback_above_deg").unwrap_or(span),
                title,
                format!("expected more than {promote_below_deg}"),
            )
        });
    }
    (section.problem_count() == before).then_some(rule)
}

fn require_one_per_slot(section: &mut Section<'_, '_>, rules: &[Spanned<PromotionRule>]) {
    for (index, rule) in rules.iter().enumerate() {
        let slot = rule.get_ref().slot;
        if let Some(first) = rules[..index].iter().find(|earlier| earlier.get_ref().slot == slot) {
            section.report(Problem {
                context: Some((first.span(), "first watched here".into())),
                ..Problem::new(rule.span(), format!("watch: the slot \"{slot}\" is watched twice"), "watched again")
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::{Launch, Slot};

    const COMPLETE: &str = "[[watch]]\nslot = \"fuser\"\nstage = \"aided\"\nmeasure = \"heading\"\npromote_below_deg = 0.5\n\
                         promote_after_s = 3\nrollback_above_deg = 2\nrollback_after_s = 0.5\nlimit = 4\n";

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

    #[test]
    fn stage_of_invalid_slot_is_not_checked() {
        for (slot, expected) in [("\"gyrp\"", "did you mean \"gyro\"?"), ("3", "expected a string, found an integer")] {
            for stage in ["stage = \"rk4\"", "stage = \"rk4\"\nset.any = 1"] {
                let shown = Launch::parse("launch.toml", &format!("[[watch]]\nslot = {slot}\n{stage}\n"));
                let shown = shown.unwrap_err().to_string();
                assert!(shown.contains(":2:8\n") && shown.contains(expected), "{slot} {stage}:\n{shown}");
                assert!(shown.ends_with("1 problem"), "{slot} {stage}:\n{shown}");
            }
        }
    }

    #[test]
    fn rule_without_slot_applies_to_fuser() {
        let rule = |stage: &str| Launch::parse("launch.toml", &format!("[[watch]]\nstage = \"{stage}\"\n"));
        assert_eq!(rule("aided").unwrap().watch[0].slot, Slot::Fuser);
        let shown = rule("rk4").unwrap_err().to_string();
        assert!(shown.contains("watch.stage: unknown value \"rk4\""), "{shown}");
    }
}
