//! A stage that proves itself beside the one in its slot and takes over by itself: `[[watch]]`.

use std::{collections::BTreeMap, ops::Range};

use serde::{Deserialize, Serialize};

use crate::{Launch, Service, Stage, filling::filling, problem::Problem, walk::Section};

/// What is measured between two stages, and what follows from it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Watch {
    /// The slot; each is watched once at most.
    pub slot: Service,
    /// What runs beside the stage in the slot.
    pub stage: Stage,
    /// Which difference of the two attitudes is meant.
    pub measure: Measure,
    /// The stage takes over when the difference has stayed below this, degrees; 0: never.
    pub promote_below_deg: f64,
    /// For so long, s.
    pub promote_after_s: f64,
    /// After that the former stage comes back when the difference has stayed above this, degrees; more than `promote_below_deg`.
    pub rollback_above_deg: f64,
    /// For so long, s.
    pub rollback_after_s: f64,
    /// Promotions in a run at most.
    pub limit: u64,
}

/// A difference of two attitudes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Measure {
    /// The angle of the turn between them.
    Angle,
    /// Between their verticals.
    Inclination,
    /// Between their headings.
    Heading,
}

const MEASURES: [(&str, Measure); 3] =
    [("angle", Measure::Angle), ("inclination", Measure::Inclination), ("heading", Measure::Heading)];
/// Longest time that a bound must hold, s.
const AFTER_MAX_S: f64 = 86_400.0;

/// Every `[[watch]]`.
pub(crate) fn watches(section: &mut Section<'_, '_>, launch: &mut Launch) {
    let mut places: Vec<(Service, Range<usize>)> = Vec::new();
    section.tables("watch", |section, place| {
        let Some(watch) = watch(section, &place, launch) else { return };
        if let Some((slot, first)) = places.iter().find(|(slot, _)| *slot == watch.slot) {
            section.report(Problem {
                context: Some((first.clone(), "first watched here".into())),
                ..Problem::new(place, format!("watch: the slot \"{slot}\" is watched twice"), "watched again")
            });
            return;
        }
        places.push((watch.slot, place));
        launch.watch.push(watch);
    });
}

fn watch(section: &mut Section<'_, '_>, place: &Range<usize>, launch: &Launch) -> Option<Watch> {
    let mut watch = Watch {
        slot: Service::Fuser,
        stage: Stage { stage: String::new(), set: BTreeMap::new() },
        measure: Measure::Inclination,
        promote_below_deg: 0.0,
        promote_after_s: 10.0,
        rollback_above_deg: 180.0,
        rollback_after_s: 1.0,
        limit: 1,
    };
    let Watch { slot, stage, measure, promote_below_deg, promote_after_s, rollback_above_deg, rollback_after_s, limit } =
        &mut watch;
    let slots: Vec<_> = Service::SLOTS.iter().map(|slot| (slot.name(), *slot)).collect();
    let mut taken = section.choice("slot", slots, slot) & filling(section, *slot, &launch.stages, stage);
    taken &= section.choice("measure", MEASURES, measure);
    let bounds_taken = section.number("promote_below_deg", 0.0..=180.0, promote_below_deg)
        & section.number("rollback_above_deg", 0.0..=180.0, rollback_above_deg);
    taken &= section.number("promote_after_s", 0.1..=AFTER_MAX_S, promote_after_s);
    taken &= section.number("rollback_after_s", 0.1..=AFTER_MAX_S, rollback_after_s);
    taken &= section.count("limit", 1..=1000, limit);
    if !section.has("stage") {
        section.report(Problem::new(place.clone(), "watch: stage is missing", "expected stage"));
        taken = false;
    }
    if bounds_taken && rollback_above_deg <= promote_below_deg {
        let title = format!(
            "watch.rollback_above_deg = {rollback_above_deg} must be more than promote_below_deg = {promote_below_deg}"
        );
        let span = section.span("rollback_above_deg").unwrap_or_else(|| place.clone());
        section.report(Problem {
            note: Some("between the two bounds nothing is changed".into()),
            ..Problem::new(span, title, format!("expected more than {promote_below_deg}"))
        });
        taken = false;
    }
    (taken & bounds_taken).then_some(watch)
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHOLE: &str = "[[watch]]\nslot = \"fuser\"\nstage = \"aided\"\nmeasure = \"heading\"\npromote_below_deg = 0.5\n\
                         promote_after_s = 3\nrollback_above_deg = 2\nrollback_after_s = 0.5\nlimit = 4\n";

    #[test]
    fn a_watch_is_taken_with_every_key() {
        let launch = Launch::parse(
            "launch.toml",
            &format!("{WHOLE}set = {{ earth_rate = 0 }}\n").replace("set = { earth_rate = 0 }\n", ""),
        )
        .unwrap();
        let expected = Watch {
            slot: Service::Fuser,
            stage: Stage { stage: "aided".into(), set: BTreeMap::new() },
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
    fn each_problem_of_a_watch_points_at_its_place() {
        let cases = [
            (WHOLE.replace("\"aided\"", "\"aidd\""), ":3:9\n", "did you mean \"aided\"?"),
            (WHOLE.replace("stage = \"aided\"\n", ""), ":1:1\n", "watch: stage is missing"),
            (WHOLE.replace("\"heading\"", "\"yaw\""), ":4:11\n", "unknown value \"yaw\""),
            (WHOLE.replace("_deg = 2", "_deg = 0.5"), ":7:22\n", "must be more than promote_below_deg = 0.5"),
            (WHOLE.replace("limit = 4", "limit = 0"), ":9:9\n", "expected 1 to 1000, found 0"),
            (format!("{WHOLE}{WHOLE}"), ":10:1\n", "the slot \"fuser\" is watched twice"),
        ];
        for (text, place, said) in cases {
            let shown = Launch::parse("launch.toml", &text).unwrap_err().to_string();
            assert!(shown.contains(place) && shown.contains(said), "{place}{said}:\n{shown}");
            assert!(shown.ends_with("1 problem"), "{said}:\n{shown}");
        }
    }
}
