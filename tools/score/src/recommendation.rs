//! Recommended stage and setting.

use crate::table::{ErrorsDeg, Recommendation, Scores, StageScore, Sweep};

/// Relative difference below which two errors count as equal.
const EQUIVALENCE_SHARE: f64 = 0.02;

impl Recommendation {
    /// Recommends the chain with the smallest error. Returns `None` if there is only one chain and
    /// no setting was optimised, because there is nothing to choose from.
    pub(crate) fn from_scores(scores: &Scores, heading_is_known: bool) -> Option<Self> {
        let Scores { stages, tuned, .. } = scores;
        if stages.len() < 2 && tuned.is_empty() {
            return None;
        }
        let (name, error) = ranking_error(heading_is_known);
        let known = |stage: &StageScore| Some((stage.clone(), error(&stage.mean.attitude)?));
        let mut ranked: Vec<_> = stages.iter().filter_map(known).collect();
        ranked.sort_by(|a, b| a.1.total_cmp(&b.1));
        let Some((best, deg)) = ranked.first() else {
            let text = "no reference, so no ranking; see the differences between the stages";
            return Some(Self { text: text.into(), launch: String::new() });
        };
        let setting = tuned.iter().find(|tuned| tuned.fuser == best.fuser).map_or_else(String::new, |tuned| {
            let Sweep { setting, unit, best, .. } = tuned;
            format!(" ({setting} = {}{}{unit})", best.value, if unit.is_empty() { "" } else { " " })
        });
        let mut text = format!("best by {name} error: {}{setting} {deg:.3}°", best.fuser);
        if let Some((second, second_deg)) = ranked.get(1) {
            let is_equivalent = second_deg - deg <= EQUIVALENCE_SHARE * second_deg;
            let note = if is_equivalent { " (equally good)" } else { "" };
            text += &format!("; next: {} {second_deg:.3}°{note}", second.fuser);
        }
        for tuned in tuned.iter().filter(|tuned| tuned.at_range_end) {
            let (Sweep { fuser, setting, .. }, value) = (tuned, tuned.best.value);
            text += &format!("; the best {setting} of {fuser}, {value}, is at the end of the range: extend the range");
        }
        let launch = ranked.iter().find_map(|(stage, _)| launch_sections(stage)).unwrap_or_default();
        Some(Self { text, launch })
    }
}

/// Returns the error by which chains, settings and seeds are ranked, with its name.
///
/// If the heading is unknown, this is the inclination error, because the total error is undefined.
pub(crate) fn ranking_error(heading_is_known: bool) -> (&'static str, fn(&ErrorsDeg) -> Option<f64>) {
    if heading_is_known { ("total", |errors| errors.total) } else { ("inclination", |errors| errors.inclination) }
}

/// Formats a chain as sections of `launch.toml`. Returns `None` for an estimate from a file.
fn launch_sections(stage: &StageScore) -> Option<String> {
    let StageScore { gyro, accel, fuser, course, .. } = stage;
    let slots = [("gyro", gyro.as_ref()?), ("accel", accel.as_ref()?), ("fuser", fuser), ("course", course.as_ref()?)];
    let mut lines = Vec::new();
    for (slot, name) in slots {
        lines.push(format!("[{slot}]\nstage = \"{name}\""));
        let set: Vec<_> = stage
            .settings
            .iter()
            .filter_map(|(key, value)| Some(format!("{} = {value:?}", key.strip_prefix(slot)?.strip_prefix('.')?)))
            .collect();
        if !set.is_empty() {
            lines.push(format!("[{slot}.set]\n{}", set.join("\n")));
        }
    }
    Some(lines.join("\n"))
}

#[cfg(test)]
mod tests {
    use launch::Launch;

    use super::*;
    use crate::table::ErrorsDeg;

    fn scores(errors_deg: &[(&str, Option<f64>)]) -> Scores {
        let stage = |(name, deg): &(&str, Option<f64>)| {
            let mut launch = Launch::default();
            launch.fuser.stage = (*name).into();
            let mut stage = StageScore::new(&launch);
            stage.mean.attitude = ErrorsDeg { total: deg.map(|deg| 10.0 - deg), heading: None, inclination: *deg };
            stage
        };
        Scores { stages: errors_deg.iter().map(stage).collect(), ..Scores::default() }
    }

    #[test]
    fn smallest_error_is_recommended_with_runner_up() {
        let scores = scores(&[("vqf", Some(0.5)), ("wz", Some(0.4)), ("aided", None)]);
        let recommendation = Recommendation::from_scores(&scores, false).unwrap();
        assert_eq!(recommendation.text, "best by inclination error: wz 0.400°; next: vqf 0.500°");
        assert!(recommendation.launch.contains("[fuser]\nstage = \"wz\""), "{}", recommendation.launch);
        let by_total = Recommendation::from_scores(&scores, true).unwrap();
        assert!(by_total.text.starts_with("best by total error: vqf 9.500°"), "{}", by_total.text);
    }

    #[test]
    fn launch_sections_are_those_of_best_stage() {
        let mut scores = scores(&[("wz", Some(0.5)), ("vqf", Some(0.4))]);
        let mut estimate = StageScore::from_estimate("mine");
        estimate.mean.attitude.inclination = Some(0.3);
        scores.stages.push(estimate);
        let recommendation = Recommendation::from_scores(&scores, false).unwrap();
        assert_eq!(recommendation.text, "best by inclination error: mine 0.300°; next: vqf 0.400°");
        assert!(recommendation.launch.contains("[fuser]\nstage = \"vqf\""), "{}", recommendation.launch);
    }

    #[test]
    fn nothing_is_recommended_without_choice_or_reference() {
        assert_eq!(Recommendation::from_scores(&scores(&[("wz", Some(0.4))]), true), None);
        let recommendation = Recommendation::from_scores(&scores(&[("wz", None), ("vqf", None)]), true).unwrap();
        assert!(recommendation.text.starts_with("no reference, so no ranking") && recommendation.launch.is_empty());
        let equal = Recommendation::from_scores(&scores(&[("wz", Some(0.4)), ("vqf", Some(0.404))]), false).unwrap();
        assert!(equal.text.ends_with("(equally good)"), "{}", equal.text);
    }
}
