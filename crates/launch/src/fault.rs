//! What the sensors are made to do wrong: `[[ingest.fault]]`.

use serde::{Deserialize, Serialize};
use std::ops::Range;

use crate::{problem::Problem, walk::Section};

/// Entries of a script at most.
pub const FAULTS_MAX: usize = 64;
/// Readings that `delayed` holds back at most: the longest delay at the highest rate.
pub const DELAY_READINGS_MAX: usize = 20_000;

/// Longest delay, s.
const DELAY_MAX_S: f64 = 2.0;
/// Latest time of a script, s: 11 days.
const TIME_MAX_S: f64 = 1e6;

/// One fault of a sensor, from a time until another.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Fault {
    /// Whose.
    pub sensor: Sensor,
    /// What it does.
    pub kind: FaultKind,
    /// Of the source's time since the first reading, s.
    pub from_s: f64,
    /// Likewise; the reading at this time is whole.
    pub until_s: f64,
}

/// A sensor that fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Sensor {
    /// The body rate.
    Gyro,
    /// The specific force.
    Accel,
    /// The magnetic field.
    Mag,
    /// The satellite receiver.
    Gnss,
    /// All four, and where they are absent the reading itself.
    All,
}

/// What a sensor does wrong.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FaultKind {
    /// Says nothing.
    Off,
    /// Repeats what it said before.
    Stuck,
    /// Says what no sensor can: not numbers, infinities, 1e300, any 64 bits.
    Garbage {
        /// Of the choice.
        seed: u64,
    },
    /// Says factor · value + offset.
    Wrong {
        /// 1 is right.
        factor: f64,
        /// In the sensor's units: rad/s, m/s², µT; of a receiver's velocity m/s east, north, up.
        offset: [f64; 3],
    },
    /// Says every n-th value only. A gyro or an accelerometer repeats it, as one that is read faster than it measures.
    Slow {
        /// n.
        every: u64,
    },
    /// Says what it should have said earlier.
    Delayed {
        /// By so much, s.
        delay_s: f64,
    },
    /// Speaks now and then.
    Intermittent {
        /// Of its values, those that are said: 0 to 1.
        share: f64,
        /// Of the choice.
        seed: u64,
    },
}

/// The script; one that is not `allowed` is a problem of its own.
pub(crate) fn script(section: &mut Section<'_, '_>, allowed: bool, out: &mut Vec<Fault>) {
    let (mut count, mut surplus) = (0, None);
    section.tables("fault", |section, place| {
        count += 1;
        if count == FAULTS_MAX + 1 {
            surplus = Some(place.clone());
        }
        out.extend(fault(section, &place));
    });
    if let Some(place) = surplus {
        let title = format!("ingest.fault: {count} entries, expected at most {FAULTS_MAX}");
        section.report(Problem::new(place, title, "one too many"));
    }
    if let (false, 1.., Some(place)) = (allowed, count, section.span("fault")) {
        section.report(Problem {
            help: Some("to make sensors fail on purpose, write faults = true at the top of the file".into()),
            note: Some("on a vehicle remove the script instead".into()),
            ..Problem::new(place, "ingest.fault: a script of faults needs faults = true", "faults on purpose")
        });
    }
}

/// The names of the kinds.
#[derive(Clone, Copy, PartialEq)]
enum Name {
    Off,
    Stuck,
    Garbage,
    Wrong,
    Slow,
    Delayed,
    Intermittent,
}

const SENSORS: [(&str, Sensor); 5] = [
    ("gyro", Sensor::Gyro),
    ("accel", Sensor::Accel),
    ("mag", Sensor::Mag),
    ("gnss", Sensor::Gnss),
    ("all", Sensor::All),
];
const KINDS: [(&str, Name); 7] = [
    ("off", Name::Off),
    ("stuck", Name::Stuck),
    ("garbage", Name::Garbage),
    ("wrong", Name::Wrong),
    ("slow", Name::Slow),
    ("delayed", Name::Delayed),
    ("intermittent", Name::Intermittent),
];

fn fault(section: &mut Section<'_, '_>, place: &Range<usize>) -> Option<Fault> {
    let (mut sensor, mut name) = (Sensor::All, Name::Off);
    let (mut from_s, mut until_s) = (0.0, TIME_MAX_S);
    let mut taken = needs(section, place, &["sensor", "kind", "from_s", "until_s"]);
    taken &= section.choice("sensor", SENSORS, &mut sensor);
    let kind_taken = section.choice("kind", KINDS, &mut name) && section.has("kind");
    let times_taken = section.number("from_s", 0.0..=TIME_MAX_S, &mut from_s)
        & section.number("until_s", 0.0..=TIME_MAX_S, &mut until_s);
    if taken && times_taken && until_s <= from_s {
        let title = format!("ingest.fault.until_s = {until_s} must be more than from_s = {from_s}");
        let span = section.span("until_s").unwrap_or_default();
        section.report(Problem {
            context: section.span("from_s").map(|span| (span, "begins here".into())),
            ..Problem::new(span, title, format!("expected more than {from_s}"))
        });
    }
    let kind = if kind_taken { kind(section, place, name, sensor) } else { ignore(section) };
    kind.filter(|_| taken && times_taken).map(|kind| Fault { sensor, kind, from_s, until_s })
}

/// The kind with its own keys.
fn kind(section: &mut Section<'_, '_>, place: &Range<usize>, name: Name, sensor: Sensor) -> Option<FaultKind> {
    let (mut seed, mut factor, mut offset) = (1, 1.0, [0.0; 3]);
    let (mut every, mut delay_s, mut share) = (2, 0.0, 0.0);
    let (taken, kind) = match name {
        Name::Off => (true, FaultKind::Off),
        Name::Stuck => (true, FaultKind::Stuck),
        Name::Garbage => (section.natural("seed", &mut seed), FaultKind::Garbage { seed }),
        Name::Wrong => {
            let mut taken = section.number("factor", -1e6..=1e6, &mut factor);
            if sensor == Sensor::All {
                taken &= needs(section, place, &["factor"]);
            } else {
                taken &= section.vector("offset", &mut offset);
                if !(section.has("factor") || section.has("offset")) {
                    taken &= needs(section, place, &["offset"]);
                }
            }
            (taken, FaultKind::Wrong { factor, offset })
        }
        Name::Slow => {
            let taken = needs(section, place, &["every"]) & section.count("every", 2..=100_000, &mut every);
            (taken, FaultKind::Slow { every })
        }
        Name::Delayed => {
            let taken =
                needs(section, place, &["delay_s"]) & section.number("delay_s", 0.001..=DELAY_MAX_S, &mut delay_s);
            (taken, FaultKind::Delayed { delay_s })
        }
        Name::Intermittent => {
            let taken = needs(section, place, &["share"])
                & section.number("share", 0.0..=1.0, &mut share)
                & section.natural("seed", &mut seed);
            (taken, FaultKind::Intermittent { share, seed })
        }
    };
    taken.then_some(kind)
}

/// Keys of whatever kind it was to be cause no second problem.
fn ignore(section: &mut Section<'_, '_>) -> Option<FaultKind> {
    for key in ["seed", "factor", "offset", "every", "delay_s", "share"] {
        section.knows(key);
    }
    None
}

/// Reports the first of these keys that is not there.
fn needs(section: &mut Section<'_, '_>, place: &Range<usize>, keys: &[&str]) -> bool {
    let missing = keys.iter().find(|key| !section.has(key));
    if let Some(key) = missing {
        let title = format!("ingest.fault: {key} is missing");
        section.report(Problem::new(place.clone(), title, format!("expected {key}")));
    }
    missing.is_none()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Launch;

    fn problems(text: &str) -> String {
        Launch::parse("launch.toml", text).unwrap_err().to_string()
    }

    #[test]
    fn every_kind_is_taken_with_its_keys() {
        let entry =
            |sensor, rest: &str| format!("[[ingest.fault]]\nsensor = {sensor:?}\nfrom_s = 1\nuntil_s = 2.5\n{rest}\n");
        let fault = |sensor, kind| Fault { sensor, kind, from_s: 1.0, until_s: 2.5 };
        let cases = [
            ("gyro", "kind = \"off\"", fault(Sensor::Gyro, FaultKind::Off)),
            ("accel", "kind = \"stuck\"", fault(Sensor::Accel, FaultKind::Stuck)),
            ("mag", "kind = \"garbage\"\nseed = 7", fault(Sensor::Mag, FaultKind::Garbage { seed: 7 })),
            (
                "gnss",
                "kind = \"wrong\"\noffset = [1, 2, 3]",
                fault(Sensor::Gnss, FaultKind::Wrong { factor: 1.0, offset: [1.0, 2.0, 3.0] }),
            ),
            (
                "all",
                "kind = \"wrong\"\nfactor = -2",
                fault(Sensor::All, FaultKind::Wrong { factor: -2.0, offset: [0.0; 3] }),
            ),
            ("all", "kind = \"slow\"\nevery = 3", fault(Sensor::All, FaultKind::Slow { every: 3 })),
            ("gyro", "kind = \"delayed\"\ndelay_s = 0.2", fault(Sensor::Gyro, FaultKind::Delayed { delay_s: 0.2 })),
            (
                "gyro",
                "kind = \"intermittent\"\nshare = 0.5",
                fault(Sensor::Gyro, FaultKind::Intermittent { share: 0.5, seed: 1 }),
            ),
        ];
        let text: String = cases.iter().map(|(sensor, rest, _)| entry(sensor, rest)).collect();
        let launch = Launch::parse("launch.toml", &format!("faults = true\n{text}")).unwrap();
        assert_eq!(launch.ingest.faults, cases.map(|(_, _, fault)| fault));
    }

    #[test]
    fn a_script_without_faults_allowed_is_refused_at_its_line_with_the_remedy() {
        let text = "name = \"a\"\n[[ingest.fault]]\nsensor = \"gyro\"\nkind = \"off\"\nfrom_s = 1\nuntil_s = 2\n";
        for text in [text.to_owned(), format!("faults = false\n{text}")] {
            let line = if text.starts_with("faults") { ":3:1\n" } else { ":2:1\n" };
            let shown = problems(&text);
            for said in [line, "write faults = true at the top of the file", "remove the script", "1 problem"] {
                assert!(shown.contains(said), "{said:?} is not in\n{shown}");
            }
        }
        assert!(problems(&format!("faults = 1\n{text}")).ends_with("1 problem"), "one cause, one problem");
        assert!(Launch::parse("launch.toml", &format!("faults = true\n{text}")).is_ok());
        assert!(Launch::parse("launch.toml", "faults = true").is_ok());
    }

    #[test]
    fn each_problem_of_an_entry_points_at_its_place() {
        let whole = ["sensor = \"gyro\"", "kind = \"off\"", "from_s = 1", "until_s = 2"];
        let with = |index: usize, line: &str| {
            let mut lines = whole.map(str::to_owned);
            line.clone_into(&mut lines[index]);
            format!("faults = true\n[[ingest.fault]]\n{}", lines.join("\n"))
        };
        let cases = [
            (with(0, "sensor = \"gyr\""), ":3:10\n", "did you mean \"gyro\"?"),
            (with(0, ""), ":2:1\n", "ingest.fault: sensor is missing"),
            (with(1, "kind = \"of\"\nshare = 2"), ":4:8\n", "did you mean \"off\"?"),
            (with(1, ""), ":2:1\n", "ingest.fault: kind is missing"),
            (with(2, "from_s = -1"), ":5:10\n", "expected 0 to 1000000, found -1"),
            (with(3, "until_s = 1"), ":6:11\n", "until_s = 1 must be more than from_s = 1"),
            (with(3, ""), ":2:1\n", "ingest.fault: until_s is missing"),
            (with(1, "kind = \"off\"\nshare = 1"), ":5:1\n", "unknown key \"share\" in [ingest.fault]"),
            (with(1, "kind = \"slow\""), ":2:1\n", "ingest.fault: every is missing"),
            (with(1, "kind = \"slow\"\nevery = 1"), ":5:9\n", "expected 2 to 100000, found 1"),
            (with(1, "kind = \"delayed\""), ":2:1\n", "ingest.fault: delay_s is missing"),
            (with(1, "kind = \"delayed\"\ndelay_s = 3"), ":5:11\n", "expected 0.001 to 2, found 3"),
            (with(1, "kind = \"intermittent\""), ":2:1\n", "ingest.fault: share is missing"),
            (with(1, "kind = \"intermittent\"\nshare = nan"), ":5:9\n", "expected 0 to 1, found nan"),
            (with(1, "kind = \"wrong\""), ":2:1\n", "ingest.fault: offset is missing"),
            (with(1, "kind = \"wrong\"\noffset = 1"), ":5:10\n", "an array of 3 finite numbers"),
            (with(1, "kind = \"garbage\"\nseed = -1"), ":5:8\n", "found -1"),
            ("faults = true\ningest.fault = [3]".to_owned(), ":2:17\n", "expected a table, found an integer"),
            ("faults = true\ningest.fault = 3".to_owned(), ":2:16\n", "expected an array of tables, found an integer"),
        ];
        for (text, place, said) in cases {
            let shown = problems(&text);
            assert!(shown.contains(place) && shown.contains(said), "{place}{said}:\n{shown}");
            assert!(shown.ends_with("1 problem"), "{said}:\n{shown}");
        }
        let all = with(0, "sensor = \"all\"\noffset = [0, 0, 0]").replace("off\"", "wrong\"\nfactor = 2");
        assert!(problems(&all).contains("unknown key \"offset\""), "four sensors have no unit in common");
    }

    #[test]
    fn more_entries_than_a_script_has_are_refused_at_the_first_too_many() {
        let entry = "[[ingest.fault]]\nsensor = \"gyro\"\nkind = \"off\"\nfrom_s = 1\nuntil_s = 2\n";
        let script = |count| format!("faults = true\n{}", entry.repeat(count));
        assert_eq!(Launch::parse("launch.toml", &script(FAULTS_MAX)).unwrap().ingest.faults.len(), FAULTS_MAX);
        let shown = problems(&script(FAULTS_MAX + 2));
        assert!(shown.contains("66 entries, expected at most 64"), "{shown}");
        assert!(shown.contains(&format!(":{}:1\n", 2 + 5 * FAULTS_MAX)), "{shown}");
    }
}
