//! Injection of sensor faults: `[[ingest.fault]]`.

use std::ops::{Range, RangeInclusive};

use toml::Spanned;

use crate::{
    description::Key,
    keys::{Kind, Named, choices, keys},
    kind::{By, NATURAL, Tables, Vector, choice},
    live_sources::RATE_RANGE_HZ,
    problem::Problem,
    toml_reader::Section,
};

/// Maximum number of faults.
pub const MAX_FAULTS: usize = 64;
/// Maximum number of readings held back by [`FaultKind::Delayed`]. It covers the longest delay at
/// the highest rate.
pub const MAX_DELAYED_READINGS: usize = (*DELAY_S.end() * *RATE_RANGE_HZ.end()) as usize;

/// Allowed delays, s.
const DELAY_S: RangeInclusive<f64> = 0.001..=2.0;
/// Allowed start and end of a fault, s. The maximum is 11 days.
const TIME_S: RangeInclusive<f64> = 0.0..=1e6;

keys! {
    /// Fault of a sensor during a time interval.
    #[derive(Copy)]
    pub struct Fault {
        /// Affected sensor.
        sensor: Sensor = Sensor::Gyro, choice(), example r#""gyro""#;
        /// Effect on the sensor.
        kind: FaultKind = FaultKind::Off, By(fault_kind), example r#""stuck""#;
        /// Start since the first reading, in the source's time.
        from_s: f64 = 0.0, TIME_S, unit "s", example "10.0";
        /// End (exclusive) since the first reading, in the source's time.
        until_s: f64 = *TIME_S.end(), TIME_S, unit "s", example "12.0";
    }
}

choices! {
    /// Sensor to which a fault applies.
    #[derive(Eq)]
    #[serde(rename_all = "lowercase")]
    pub enum Sensor {
        /// The body rate.
        Gyro = "gyro",
        /// The specific force.
        Accel = "accel",
        /// The magnetic field.
        Mag = "mag",
        /// The satellite receiver.
        Gnss = "gnss",
        /// All four sensors. If a fault removes all of them, the reading itself is omitted.
        All = "all",
    }
}

choices! {
    /// Effect of a fault on a sensor.
    #[serde(rename_all = "lowercase")]
    pub enum FaultKind {
        /// No output.
        Off = "off",
        /// The last output is repeated.
        Stuck = "stuck",
        /// Impossible values: NaN, infinities, 1e300, arbitrary bits.
        Garbage = "garbage" {
            /// Seed of the random values.
            seed: u64 = 1, NATURAL;
        },
        /// Output of factor · value + offset.
        Miscalibrated = "miscalibrated" {
            /// Factor. 1 has no effect.
            factor: f64 = 1.0, -1e6..=1e6;
            /// Offset in the sensor's units: rad/s, m/s² or µT. For a receiver, the velocity offset
            /// east, north and up, m/s. Not allowed for the sensor "all", because the sensors have
            /// no common unit.
            offset: [f64; 3] = [0.0; 3], Vector;
        },
        /// Only every n-th value is output. In between, a gyro or accelerometer repeats the last
        /// value, like a sensor that is read faster than it samples.
        Slow = "slow" {
            /// n: only every n-th value is output.
            every: u64 = 0, 2..=100_000;
        },
        /// Values are output late.
        Delayed = "delayed" {
            /// Delay.
            delay_s: f64 = f64::NAN, DELAY_S, unit "s";
        },
        /// Only randomly selected values are output.
        Intermittent = "intermittent" {
            /// Share of values that are output.
            share: f64 = f64::NAN, 0.0..=1.0;
            /// Seed of the random selection.
            seed: u64 = 1, NATURAL;
        },
    }
}

/// Kind of the key `fault`.
pub(crate) const FAULTS: Tables<Fault> = Tables { read: fault, check: require_permission };

/// Checks the number of faults. If faults are not allowed, reports a single problem for all of
/// them.
fn require_permission(section: &mut Section<'_, '_>, faults: &[Spanned<Fault>]) {
    if let Some(surplus) = faults.get(MAX_FAULTS) {
        let title = format!("ingest.fault: {} entries, expected at most {MAX_FAULTS}", faults.len());
        section.report(Problem::new(surplus.span(), title, "one too many"));
    }
    let is_forbidden = section.root().get("faults").is_none_or(|value| value.get_ref().as_bool() == Some(false));
    if let Some(span) = section.span("fault").filter(|_| is_forbidden) {
        section.report(Problem {
            help: Some("to inject faults, write faults = true at the top of the file".into()),
            note: Some("on a vehicle, remove the faults instead".into()),
            ..Problem::new(span, "ingest.fault: fault injection needs faults = true", "fault injection is off")
        });
    }
}

fn fault(section: &mut Section<'_, '_>, span: Range<usize>) -> Option<Fault> {
    let before = section.problem_count();
    let mut fault = Fault::default();
    fault.read_keys(section);
    require(section, &span, &["sensor", "kind", "from_s", "until_s"]);
    let Fault { sensor, kind, from_s, until_s } = fault;
    if section.problem_count() == before && until_s <= from_s {
        let title = format!("ingest.fault.until_s = {until_s} must be more than from_s = {from_s}");
        section.report(Problem {
            context: section.span("from_s").map(|span| (span, "starts here".into())),
            ..Problem::new(section.span("until_s").unwrap_or_default(), title, format!("expected more than {from_s}"))
        });
    }
    match kind {
        FaultKind::Off | FaultKind::Stuck | FaultKind::Garbage { .. } => {}
        FaultKind::Miscalibrated { .. } if sensor == Sensor::All => {
            section.exclude("offset");
            require(section, &span, &["factor"]);
        }
        FaultKind::Miscalibrated { .. } if section.has("factor") => {}
        FaultKind::Miscalibrated { .. } => require(section, &span, &["offset"]),
        FaultKind::Slow { .. } => require(section, &span, &["every"]),
        FaultKind::Delayed { .. } => require(section, &span, &["delay_s"]),
        FaultKind::Intermittent { .. } => require(section, &span, &["share"]),
    }
    (section.problem_count() == before).then_some(fault)
}

/// Reads `kind` and the keys of that kind.
fn fault_kind(section: &mut Section<'_, '_>, key: Key, out: &mut FaultKind) {
    choice().read(section, key, out);
    if section.is_description() || section.is_set(key.name) {
        return section
            .variants(key.name, out, FaultKind::NAMES.iter().copied(), |section, kind| kind.read_keys(section));
    }
    // If the kind is unknown or missing, the keys of every kind are accepted, so that only the
    // kind itself is reported.
    section.allow(|section| FaultKind::NAMES.iter().for_each(|(_, kind)| kind.clone().read_keys(section)));
}

/// Reports the first missing key.
fn require(section: &mut Section<'_, '_>, span: &Range<usize>, keys: &[&str]) {
    if let Some(key) = section.missing(keys) {
        let title = format!("ingest.fault: {key} is missing");
        section.report(Problem::new(span.clone(), title, format!("expected {key}")));
    }
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
