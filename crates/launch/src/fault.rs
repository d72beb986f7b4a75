//! Injection of sensor faults: `[[ingest.fault]]`.

use serde::{Deserialize, Serialize};
use std::ops::Range;

use crate::{problem::Problem, toml_reader::Section};

/// Maximum number of faults.
pub const MAX_FAULTS: usize = 64;
/// Maximum number of readings held back by [`FaultKind::Delayed`]. It covers the longest delay at
/// the highest rate.
pub const MAX_DELAYED_READINGS: usize = 20_000;

/// Longest delay, s.
const MAX_DELAY_S: f64 = 2.0;
/// Latest allowed start or end of a fault, s (11 days).
const MAX_TIME_S: f64 = 1e6;

/// Fault of a sensor during a time interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Fault {
    /// Affected sensor.
    pub sensor: Sensor,
    /// Effect on the sensor.
    pub kind: FaultKind,
    /// Start, s since the first reading, in the source's time.
    pub from_s: f64,
    /// End (exclusive), s since the first reading, in the source's time.
    pub until_s: f64,
}

/// Sensor to which a fault applies.
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
    /// All four sensors. If a fault removes all of them, the reading itself is omitted.
    All,
}

/// Effect of a fault on a sensor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FaultKind {
    /// No output.
    Off,
    /// The last output is repeated.
    Stuck,
    /// Impossible values: NaN, infinities, 1e300, arbitrary bits.
    Garbage {
        /// Seed of the random values.
        seed: u64,
    },
    /// Output of factor · value + offset.
    Miscalibrated {
        /// Factor. 1 has no effect.
        factor: f64,
        /// Offset in the sensor's units: rad/s, m/s² or µT. For a receiver, the velocity offset
        /// east, north and up, m/s.
        offset: [f64; 3],
    },
    /// Only every n-th value is output. In between, a gyro or accelerometer repeats the last value,
    /// like a sensor that is read faster than it samples.
    Slow {
        /// Value of n.
        every: u64,
    },
    /// Values are output late.
    Delayed {
        /// Delay, s.
        delay_s: f64,
    },
    /// Only randomly selected values are output.
    Intermittent {
        /// Share of values that are output, 0 to 1.
        share: f64,
        /// Seed of the random selection.
        seed: u64,
    },
}

/// Reads the faults. If faults are not `allowed`, reports a single problem for all of them.
pub(crate) fn faults(section: &mut Section<'_, '_>, allowed: bool, out: &mut Vec<Fault>) {
    let (mut count, mut surplus) = (0, None);
    section.tables("fault", |section, span| {
        count += 1;
        if count == MAX_FAULTS + 1 {
            surplus = Some(span.clone());
        }
        out.extend(fault(section, &span));
    });
    if let Some(span) = surplus {
        let title = format!("ingest.fault: {count} entries, expected at most {MAX_FAULTS}");
        section.report(Problem::new(span, title, "one too many"));
    }
    if let (false, 1.., Some(span)) = (allowed, count, section.span("fault")) {
        section.report(Problem {
            help: Some("to inject faults, write faults = true at the top of the file".into()),
            note: Some("on a vehicle, remove the faults instead".into()),
            ..Problem::new(span, "ingest.fault: fault injection needs faults = true", "fault injection is off")
        });
    }
}

/// Kinds of faults without their settings.
#[derive(Clone, Copy, PartialEq)]
enum KindName {
    Off,
    Stuck,
    Garbage,
    Miscalibrated,
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
const KINDS: [(&str, KindName); 7] = [
    ("off", KindName::Off),
    ("stuck", KindName::Stuck),
    ("garbage", KindName::Garbage),
    ("miscalibrated", KindName::Miscalibrated),
    ("slow", KindName::Slow),
    ("delayed", KindName::Delayed),
    ("intermittent", KindName::Intermittent),
];

fn fault(section: &mut Section<'_, '_>, span: &Range<usize>) -> Option<Fault> {
    let (mut sensor, mut name) = (Sensor::All, KindName::Off);
    let (mut from_s, mut until_s) = (0.0, MAX_TIME_S);
    let mut valid = require(section, span, &["sensor", "kind", "from_s", "until_s"]);
    valid &= section.choice("sensor", SENSORS, &mut sensor);
    let kind_valid = section.choice("kind", KINDS, &mut name) && section.has("kind");
    let times_valid = section.number("from_s", 0.0..=MAX_TIME_S, &mut from_s)
        & section.number("until_s", 0.0..=MAX_TIME_S, &mut until_s);
    if valid && times_valid && until_s <= from_s {
        let title = format!("ingest.fault.until_s = {until_s} must be more than from_s = {from_s}");
        let span = section.span("until_s").unwrap_or_default();
        section.report(Problem {
            context: section.span("from_s").map(|span| (span, "starts here".into())),
            ..Problem::new(span, title, format!("expected more than {from_s}"))
        });
    }
    let kind = if kind_valid { kind(section, span, name, sensor) } else { allow_kind_keys(section) };
    kind.filter(|_| valid && times_valid).map(|kind| Fault { sensor, kind, from_s, until_s })
}

/// Reads the keys of a fault kind.
fn kind(section: &mut Section<'_, '_>, span: &Range<usize>, name: KindName, sensor: Sensor) -> Option<FaultKind> {
    let (mut seed, mut factor, mut offset) = (1, 1.0, [0.0; 3]);
    let (mut every, mut delay_s, mut share) = (2, 0.0, 0.0);
    let (valid, kind) = match name {
        KindName::Off => (true, FaultKind::Off),
        KindName::Stuck => (true, FaultKind::Stuck),
        KindName::Garbage => (section.unsigned("seed", &mut seed), FaultKind::Garbage { seed }),
        KindName::Miscalibrated => {
            let mut valid = section.number("factor", -1e6..=1e6, &mut factor);
            if sensor == Sensor::All {
                valid &= require(section, span, &["factor"]);
            } else {
                valid &= section.vector("offset", &mut offset);
                if !(section.has("factor") || section.has("offset")) {
                    valid &= require(section, span, &["offset"]);
                }
            }
            (valid, FaultKind::Miscalibrated { factor, offset })
        }
        KindName::Slow => {
            let valid = require(section, span, &["every"]) & section.integer("every", 2..=100_000, &mut every);
            (valid, FaultKind::Slow { every })
        }
        KindName::Delayed => {
            let valid =
                require(section, span, &["delay_s"]) & section.number("delay_s", 0.001..=MAX_DELAY_S, &mut delay_s);
            (valid, FaultKind::Delayed { delay_s })
        }
        KindName::Intermittent => {
            let valid = require(section, span, &["share"])
                & section.number("share", 0.0..=1.0, &mut share)
                & section.unsigned("seed", &mut seed);
            (valid, FaultKind::Intermittent { share, seed })
        }
    };
    valid.then_some(kind)
}

/// Accepts the keys of every kind, so that an unknown kind causes no second problem.
fn allow_kind_keys(section: &mut Section<'_, '_>) -> Option<FaultKind> {
    for key in ["seed", "factor", "offset", "every", "delay_s", "share"] {
        section.allow(key);
    }
    None
}

/// Returns `true` if all keys are present. Otherwise reports the first missing one.
fn require(section: &mut Section<'_, '_>, span: &Range<usize>, keys: &[&str]) -> bool {
    let missing = keys.iter().find(|key| !section.has(key));
    if let Some(key) = missing {
        let title = format!("ingest.fault: {key} is missing");
        section.report(Problem::new(span.clone(), title, format!("expected {key}")));
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
    fn every_kind_is_read_with_its_keys() {
        let entry =
            |sensor, rest: &str| format!("[[ingest.fault]]\nsensor = {sensor:?}\nfrom_s = 1\nuntil_s = 2.5\n{rest}\n");
        let fault = |sensor, kind| Fault { sensor, kind, from_s: 1.0, until_s: 2.5 };
        let cases = [
            ("gyro", "kind = \"off\"", fault(Sensor::Gyro, FaultKind::Off)),
            ("accel", "kind = \"stuck\"", fault(Sensor::Accel, FaultKind::Stuck)),
            ("mag", "kind = \"garbage\"\nseed = 7", fault(Sensor::Mag, FaultKind::Garbage { seed: 7 })),
            (
                "gnss",
                "kind = \"miscalibrated\"\noffset = [1, 2, 3]",
                fault(Sensor::Gnss, FaultKind::Miscalibrated { factor: 1.0, offset: [1.0, 2.0, 3.0] }),
            ),
            (
                "all",
                "kind = \"miscalibrated\"\nfactor = -2",
                fault(Sensor::All, FaultKind::Miscalibrated { factor: -2.0, offset: [0.0; 3] }),
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
    fn faults_without_permission_are_rejected_with_remedy() {
        let text = "name = \"a\"\n[[ingest.fault]]\nsensor = \"gyro\"\nkind = \"off\"\nfrom_s = 1\nuntil_s = 2\n";
        for text in [text.to_owned(), format!("faults = false\n{text}")] {
            let line = if text.starts_with("faults") { ":3:1\n" } else { ":2:1\n" };
            let shown = problems(&text);
            for expected in [line, "write faults = true at the top of the file", "remove the faults", "1 problem"] {
                assert!(shown.contains(expected), "{expected:?} is not in\n{shown}");
            }
        }
        assert!(problems(&format!("faults = 1\n{text}")).ends_with("1 problem"), "one cause, one problem");
        assert!(Launch::parse("launch.toml", &format!("faults = true\n{text}")).is_ok());
        assert!(Launch::parse("launch.toml", "faults = true").is_ok());
    }

    #[test]
    fn each_invalid_entry_is_reported_at_its_location() {
        let complete = ["sensor = \"gyro\"", "kind = \"off\"", "from_s = 1", "until_s = 2"];
        let with = |index: usize, line: &str| {
            let mut lines = complete.map(str::to_owned);
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
            (with(1, "kind = \"miscalibrated\""), ":2:1\n", "ingest.fault: offset is missing"),
            (with(1, "kind = \"miscalibrated\"\noffset = 1"), ":5:10\n", "an array of 3 finite numbers"),
            (with(1, "kind = \"garbage\"\nseed = -1"), ":5:8\n", "found -1"),
            ("faults = true\ningest.fault = [3]".to_owned(), ":2:17\n", "expected a table, found an integer"),
            ("faults = true\ningest.fault = 3".to_owned(), ":2:16\n", "expected an array of tables, found an integer"),
        ];
        for (text, location, expected) in cases {
            let shown = problems(&text);
            assert!(shown.contains(location) && shown.contains(expected), "{location}{expected}:\n{shown}");
            assert!(shown.ends_with("1 problem"), "{expected}:\n{shown}");
        }
        let all = with(0, "sensor = \"all\"\noffset = [0, 0, 0]").replace("off\"", "miscalibrated\"\nfactor = 2");
        assert!(problems(&all).contains("unknown key \"offset\""), "the four sensors have no common unit");
    }

    #[test]
    fn surplus_faults_are_rejected_at_the_first_one() {
        let entry = "[[ingest.fault]]\nsensor = \"gyro\"\nkind = \"off\"\nfrom_s = 1\nuntil_s = 2\n";
        let with_faults = |count| format!("faults = true\n{}", entry.repeat(count));
        assert_eq!(Launch::parse("launch.toml", &with_faults(MAX_FAULTS)).unwrap().ingest.faults.len(), MAX_FAULTS);
        let shown = problems(&with_faults(MAX_FAULTS + 2));
        assert!(shown.contains("66 entries, expected at most 64"), "{shown}");
        assert!(shown.contains(&format!(":{}:1\n", 2 + 5 * MAX_FAULTS)), "{shown}");
    }
}
