//! Reading of a launch file, and the checks that concern several sections.

use crate::{
    Launch, LaunchError, Problems, Service, Source,
    description::SectionDescription,
    model::MAX_BUFFER_S,
    problem::{Problem, quoted},
    split,
    toml_reader::{self, Section},
};
use std::{fs, path::Path};
use toml::de::DeTable;

/// Maximum number of messages that a topic of the data path holds for a subscriber: 15 MB for the
/// largest message type.
pub const MAX_TOPIC_MESSAGES: usize = 65_536;
/// Minimum number of messages that a topic of the data path holds for a subscriber. Without it, the
/// buffer of a slow sensor would be too small for the burst of messages after a stall.
pub const MIN_TOPIC_MESSAGES: usize = 256;

/// Returns the maximum of the key `buffer_s` at a rate, s.
pub fn max_buffer_s(rate_hz: f64) -> f64 {
    MAX_BUFFER_S.min(MAX_TOPIC_MESSAGES as f64 / rate_hz)
}

impl Launch {
    /// Reads and checks a launch file.
    ///
    /// Relative paths in the file are resolved against the folder of the file.
    ///
    /// # Errors
    ///
    /// Returns an error if the file cannot be read or contains problems.
    pub fn read(path: &Path) -> Result<Self, LaunchError> {
        let unreadable = |cause| LaunchError::Unreadable { path: path.to_path_buf(), cause };
        let text = fs::read_to_string(path).map_err(unreadable)?;
        Ok(Self::parse_in(path.parent(), &foreign::path(path).to_string(), &text)?)
    }

    /// Parses and checks the text of a launch file. `file_name` is the name shown in problems.
    ///
    /// Absent keys take their defaults. If the text is not valid TOML, only the syntax errors are
    /// reported.
    ///
    /// # Errors
    ///
    /// Returns all problems of the text.
    pub fn parse(file_name: &str, text: &str) -> Result<Self, Problems> {
        Self::parse_in(None, file_name, text)
    }

    fn parse_in(folder: Option<&Path>, file_name: &str, text: &str) -> Result<Self, Problems> {
        let mut launch = Self::default();
        launch.merge(folder, file_name, text)?;
        Ok(launch)
    }

    /// Overwrites the values of the keys that `text` contains. Paths in `text` are relative to
    /// `folder`.
    pub(crate) fn merge(&mut self, folder: Option<&Path>, file_name: &str, text: &str) -> Result<(), Problems> {
        let (table, syntax_errors) = DeTable::parse_recoverable(text);
        let mut list: Vec<_> = syntax_errors.iter().map(|error| Problem::syntax(error, text)).collect();
        if list.is_empty() {
            list = toml_reader::read_root(table.get_ref(), folder, |section| self.read_all(section));
        }
        if list.is_empty() {
            return Ok(());
        }
        list.sort_by_key(|problem| problem.span.start);
        Err(Problems { file_name: file_name.into(), text: text.into(), list })
    }

    /// Reads all sections and checks them against each other.
    pub(crate) fn read_all(&mut self, section: &mut Section<'_, '_>) {
        self.read_keys(section);
        self.add_drivers();
        if section.are_valid(&["buffer_s", "lateness_s"]) && self.lateness_s >= self.buffer_s {
            section.report(lateness_problem(self, section));
        }
        if section.are_valid(&["services"]) && self.gateway.is_split() {
            split::validate(self, section).into_iter().for_each(|problem| section.report(problem));
        } else if section.are_valid(&["services"]) {
            require_complete_path(section, &self.services);
        }
        if section.are_valid(&["buffer_s"])
            && let Some(problem) = buffer_problem(self, section)
        {
            section.report(problem);
        }
    }
}

/// Returns the description of every section, in the order of the declarations.
pub fn describe() -> Vec<SectionDescription> {
    toml_reader::describe(&DeTable::new(), |section| Launch::default().read_all(section))
}

/// Reports missing services of the data path in a system on one host.
fn require_complete_path(section: &mut Section<'_, '_>, services: &[Service]) {
    let missing: Vec<_> =
        Service::PATH.into_iter().filter(|service| !services.contains(service)).map(Service::name).collect();
    if let Some(span) = section.span("services").filter(|_| !missing.is_empty()) {
        section.report(Problem {
            note: Some(
                "every service of the data path must run exactly once, here or on the host of [gateway.import]".into(),
            ),
            ..Problem::new(span, format!("services: {} missing", quoted(&missing)), "incomplete")
        });
    }
}

fn lateness_problem(launch: &Launch, section: &Section<'_, '_>) -> Problem {
    let title = format!("lateness_s = {} must be less than buffer_s = {}", launch.lateness_s, launch.buffer_s);
    let (buffer, lateness) = (section.span("buffer_s"), section.span("lateness_s"));
    let problem = match (lateness, buffer) {
        (Some(lateness), buffer) => Problem {
            context: buffer.map(|buffer| (buffer, "the topics hold this much".into())),
            ..Problem::new(lateness, title, format!("expected less than {}", launch.buffer_s))
        },
        (None, buffer) => {
            Problem::new(buffer.unwrap_or_default(), title, format!("expected more than {}", launch.lateness_s))
        }
    };
    Problem { note: Some("a join can only wait for messages that the topics still hold".into()), ..problem }
}

/// Returns a problem if `buffer_s` exceeds the capacity of a topic. The rate of a recording is not
/// known yet, so the buffers of a replay are limited when it starts.
pub(crate) fn buffer_problem(launch: &Launch, section: &Section<'_, '_>) -> Option<Problem> {
    let rate_hz = match launch.ingest.source {
        Source::Replay => return None,
        _ => launch.ingest.nominal_rate_hz(),
    };
    let max_s = max_buffer_s(rate_hz);
    (launch.buffer_s > max_s).then(|| {
        let title = format!("buffer_s = {} at {rate_hz} Hz is more than a topic can hold", launch.buffer_s);
        let span = section.span("buffer_s").unwrap_or_default();
        let note = format!("a topic holds at most {MAX_TOPIC_MESSAGES} messages");
        Problem { note: Some(note), ..Problem::new(span, title, format!("expected at most {max_s:.1}")) }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::StateFile;

    fn problems(text: &str) -> String {
        Launch::parse("launch.toml", text).unwrap_err().to_string()
    }

    #[test]
    fn empty_file_gives_the_default() {
        assert_eq!(Launch::parse("x", ""), Ok(Launch::default()));
        assert_eq!(Launch::parse("x", "[ingest]\n[ingest.sim]\n[gyro]\n"), Ok(Launch::default()));
    }

    #[test]
    fn problems_are_displayed_like_those_of_rustc() {
        let shown = problems("bufer_s = 2.0\n[fuser]\nstage = \"wz-opn\"\n");
        let expected = r#"error: unknown key "bufer_s"
 --> launch.toml:1:1
  |
1 | bufer_s = 2.0
  | ^^^^^^^ not known here
  |
  = help: did you mean "buffer_s"?
  = note: allowed: "name", "services", "buffer_s", "lateness_s", "state_file", "restart", "faults", "output", "gateway", "cockpit", "ingest", "stages", "watch", "gyro", "accel", "fuser", "course"

error: fuser.stage: unknown value "wz-opn"
 --> launch.toml:3:9
  |
3 | stage = "wz-opn"
  |         ^^^^^^^^ not known here
  |
  = help: did you mean "wz-open"?
  = note: allowed: "multiple-model", "wz", "wz-closed", "wz-open", "madgwick", "madgwick-improved", "levelling", "levelling-unified", "levelling-pi", "aided", "vqf"

launch.toml: 2 problems"#;
        assert_eq!(shown, expected);
    }

    #[test]
    fn each_problem_points_at_its_location() {
        let cases: &[(&str, &[&str])] = &[
            (
                "[ingest.sim]\nrate = 100",
                &["unknown key \"rate\" in [ingest.sim]", ":2:1\n", "| ^^^^ not", "did you mean \"rate_hz\"?"],
            ),
            ("[igest]\n", &["unknown key \"igest\"", ":1:2\n", "|  ^^^^^ not", "did you mean \"ingest\"?"]),
            ("[gyro]\nstage = \"kalman\"", &[":2:9\n", "allowed: \"mobius\", \"mobius-coning\", \"rk4\", \"euler\""]),
            ("[ingest]\nsource = \"Sim\"", &["ingest.source", ":2:10\n", "^^^^^ not", "did you mean \"sim\"?"]),
            ("buffer_s = \"1\"", &["buffer_s: expected a number, found a string", ":1:12\n", "^^^ expected a number"]),
            ("name = 3", &["name: expected a string, found an integer", ":1:8\n", "^ expected a string"]),
            ("ingest.sim.seed = 1.5", &["expected an integer, found a float", ":1:19\n", "^^^ expected an integer"]),
            ("course = 3", &["course: expected a table, found an integer", ":1:10\n"]),
            ("ingest = true", &["ingest: expected a table, found a boolean", ":1:10\n", "^^^^ expected a table"]),
            ("[[gyro]]", &["gyro: expected a table, found an array", ":1:1\n", "^^^^^^^^ expected a table"]),
            ("services = 1979-05-27", &["expected an array, found a date or time", ":1:12\n", "^^^^^^^^^^ expected"]),
            ("ingest.sim.rate_hz = 0", &["rate_hz: expected 1 to 10000, found 0", ":1:22\n", "^ expected 1 to 10000"]),
            ("ingest.limits.gap_s = nan", &["expected 0.001 to 10, found nan", ":1:23\n", "^^^ expected 0.001"]),
            ("ingest.limits.stuck_s = -inf", &["expected 0.01 to 60, found -inf", ":1:25\n", "^^^^ expected 0.01"]),
            (
                "course.set.declination = 3",
                &["unknown key \"declination\" in [course.set]", ":1:12\n", "did you mean \"declination_deg\"?"],
            ),
            ("course.set.declination_deg = 181", &["declination_deg: expected -180 to 180, found 181", ":1:30\n"]),
            ("ingest.replay.mag = 1", &["ingest.replay.mag: expected true or false, found an integer", ":1:21\n"]),
            ("ingest.sim.seed = -1", &["expected 0 to 9223372036854775807, found -1", ":1:19\n", "^^ expected 0"]),
            ("ingest.sim.seed = 9223372036854775808", &["found 9223372036854775808", ":1:19\n"]),
            (
                "buffer_s = 1\nlateness_s = 1.0",
                &["lateness_s = 1 must be less than buffer_s = 1", ":2:14\n", "- the topics hold", "^^^ expected less"],
            ),
            ("buffer_s = 0.5", &["lateness_s = 1 must be less", ":1:12\n", "^^^ expected more than 1"]),
            (
                "services = [\"ingest\", \"gyro\", \"accel\", \"fuser\"]",
                &["services: \"course\" missing", ":1:12\n", "^ incomplete", "every service of the data path must run"],
            ),
            (
                "services = [\"ingest\", \"gyro\", \"accel\", \"fuser\", \"gyro\", \"course\"]",
                &["services: \"gyro\" is listed twice", ":1:49\n", "------ first listed here", "^^^^^^ listed again"],
            ),
            ("services = [\"gyr\"]", &["unknown value \"gyr\"", ":1:13\n", "^^^^^ not", "did you mean \"gyro\"?"]),
            ("name = \"Plumb Line\"", &["found \"Plumb Line\"", ":1:8\n", "^^^^^^^^^^^^ expected 1 to 32 of a-z"]),
            ("name = \"\"", &["name: expected 1 to 32", ":1:8\n", "^^ expected"]),
            (
                "ingest.source = \"replay\"",
                &["a replay needs a file", ":1:17\n", "^^^^^^^^ no file", "file = \"flight"],
            ),
            (
                "ingest = { source = \"replay\", replay.file = \"\" }",
                &["a replay needs a file", ":1:45\n", "^^ no file"],
            ),
            ("[gyro\n", &["not valid TOML: unclosed table", ":1:6\n", "^ expected `]`"]),
            ("name = \"a\"\nname = \"b\"", &["not valid TOML: duplicate key", ":2:1\n", "^^^^ here"]),
        ];
        for (text, fragments) in cases {
            let shown = problems(text);
            for fragment in *fragments {
                assert!(shown.contains(fragment), "{fragment:?} is not in\n{shown}");
            }
            assert!(shown.ends_with("launch.toml: 1 problem"), "{shown}");
        }
    }

    #[test]
    fn invalid_value_causes_no_second_problem() {
        assert!(problems("buffer_s = 0.2\nlateness_s = 100").ends_with("1 problem"));
        assert!(problems("ingest.source = \"replay\"\ningest.replay.file = 7").ends_with("1 problem"));
    }

    #[test]
    fn syntax_errors_are_shown_without_further_problems() {
        let shown = problems("name = \"abc\nbufer_s = 1\n[gyro\nstage = \"none\"\n");
        assert!(shown.contains(":1:12\n") && shown.contains(":3:6\n"), "{shown}");
        assert!(shown.ends_with("launch.toml: 2 problems"), "{shown}");
    }

    #[test]
    fn relative_file_is_resolved_from_launch_file_folder() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("launch.toml");
        fs::write(&path, "state_file = \"imu.state\"").unwrap();
        assert_eq!(Launch::read(&path).unwrap().state_file, StateFile::File(folder.path().join("imu.state")));
        for (file, expected) in [("a.csv", folder.path().join("a.csv")), ("/b.csv", "/b.csv".into()), ("", "".into())] {
            fs::write(&path, format!("ingest.replay.file = {file:?}")).unwrap();
            assert_eq!(Launch::read(&path).unwrap().ingest.replay.file, expected);
        }
    }

    #[test]
    fn unreadable_file_is_reported_with_its_path() {
        let error = Launch::read(Path::new("/nowhere/launch.toml")).unwrap_err();
        assert!(matches!(error, LaunchError::Unreadable { .. }));
        assert!(error.to_string().starts_with("reading the launch file /nowhere/launch.toml: "), "{error}");
        assert!(error.to_string().contains("check that it exists"), "{error}");
    }

    #[test]
    fn buffer_larger_than_a_topic_is_rejected() {
        let text = "buffer_s = 60.0\n[ingest.sim]\nrate_hz = 10000\n";
        let shown = Launch::parse("launch.toml", text).unwrap_err().to_string();
        for expected in ["launch.toml:1:12", "expected at most 6.6", "65536 messages"] {
            assert!(shown.contains(expected), "{expected}: {shown}");
        }
    }
}
