//! Which stage and which setting to choose.

use serde::Serialize;

use crate::{
    table::{ErrorsDeg, Scores, StageScore},
    tune::Sweep,
};

/// Errors closer than this share of each other say nothing about which is better.
const ALIKE: f64 = 0.02;

/// The advice that follows from the scores.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Verdict {
    /// What is best by which error, for people.
    pub text: String,
    /// The piece of `launch.toml` that has it; empty where nothing can be said.
    pub launch: String,
}

impl Verdict {
    /// Of scores that are complete; `None` where one chain of stages was scored as it is and there is nothing to choose.
    pub(crate) fn of(scores: &Scores, heading_is_known: bool) -> Option<Self> {
        let Scores { stages, tuned, .. } = scores;
        if stages.len() < 2 && tuned.is_empty() {
            return None;
        }
        let (name, error) = least_of(heading_is_known);
        let known = |stage: &StageScore| Some((stage.clone(), error(&stage.mean.attitude)?));
        let mut ranked: Vec<_> = stages.iter().filter_map(known).collect();
        ranked.sort_by(|a, b| a.1.total_cmp(&b.1));
        let Some((best, deg)) = ranked.first() else {
            let text = "nothing tells which stage is right: no trial has a reference; how far the stages are apart is told below";
            return Some(Self { text: text.into(), launch: String::new() });
        };
        let mut text = format!("choose fuser {}", best.fuser);
        if let Some(Sweep { setting, unit, best, .. }) = tuned.iter().find(|tuned| tuned.fuser == best.fuser) {
            text += &format!(" with {setting} = {}{}{unit}", best.value, if unit.is_empty() { "" } else { " " });
        }
        text += &format!(": {name} error {deg:.3}°");
        if let Some((second, second_deg)) = ranked.get(1) {
            let alike = second_deg - deg <= ALIKE * second_deg;
            let more = if alike { "which is as good" } else { "which is worse" };
            text += &format!("; next is {} with {second_deg:.3}°, {more}", second.fuser);
        }
        for tuned in tuned.iter().filter(|tuned| tuned.at_end) {
            let (Sweep { fuser, setting, .. }, value) = (tuned, tuned.best.value);
            text += &format!("; of {fuser} the best {setting}, {value}, is at the end of the range: look beyond it");
        }
        Some(Self { text, launch: piece(best) })
    }
}

/// The error by which chains, settings and seeds are ranked, with its name: of a heading from nowhere the total means nothing.
pub(crate) fn least_of(heading_is_known: bool) -> (&'static str, fn(&ErrorsDeg) -> Option<f64>) {
    if heading_is_known { ("total", |errors| errors.total) } else { ("inclination", |errors| errors.inclination) }
}

/// A chain of stages as `launch.toml` has it.
fn piece(stage: &StageScore) -> String {
    let slots = [("gyro", &stage.gyro), ("accel", &stage.accel), ("fuser", &stage.fuser), ("course", &stage.course)];
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
    lines.join("\n")
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
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
    fn the_least_error_is_chosen_and_the_next_is_told() {
        let scores = scores(&[("vqf", Some(0.5)), ("wz", Some(0.4)), ("aided", None)]);
        let verdict = Verdict::of(&scores, false).unwrap();
        assert_eq!(verdict.text, "choose fuser wz: inclination error 0.400°; next is vqf with 0.500°, which is worse");
        assert!(verdict.launch.contains("[fuser]\nstage = \"wz\""), "{}", verdict.launch);
        assert!(Verdict::of(&scores, true).unwrap().text.starts_with("choose fuser vqf: total error 9.500°"));
    }

    #[test]
    fn what_nobody_can_tell_is_not_advised() {
        assert_eq!(Verdict::of(&scores(&[("wz", Some(0.4))]), true), None);
        let verdict = Verdict::of(&scores(&[("wz", None), ("vqf", None)]), true).unwrap();
        assert!(verdict.text.starts_with("nothing tells which stage is right") && verdict.launch.is_empty());
        let alike = Verdict::of(&scores(&[("wz", Some(0.4)), ("vqf", Some(0.404))]), false).unwrap();
        assert!(alike.text.ends_with("which is as good"), "{}", alike.text);
    }
}
