//! Keys of a launch file and their allowed values.

use crate::{
    GyroSamples, Launch, LaunchError, OnLimit, Problems, Restart, Service, Slot, Source,
    cockpit::cockpit,
    external_stage::external_stages,
    fault,
    gateway::{Gateway, Tls},
    gateway_section::gateway,
    live_sources::{RATE_RANGE_HZ, live_sources},
    model::{Gnss, Ingest, MAX_TOPIC_MESSAGES, Replay, StateFile, system_name},
    north,
    output::output,
    problem::{Problem, quoted},
    promotion_rule::promotion_rules,
    sensors::{calibration, mounting},
    slot_stage::stage_config,
    split,
    toml_reader::{self, Section},
};
use scenario::{Motion, PARAMETERS, Parameter, ScenarioError};
use std::{fs, path::Path};
use toml::{Spanned, de::DeTable};

impl Launch {
    /// Reads and checks a launch file.
    ///
    /// Relative paths in `state_file`, `ingest.replay` and `gateway` become relative to the launch
    /// file's folder.
    ///
    /// # Errors
    ///
    /// Returns an error if the file cannot be read or contains problems.
    pub fn read(path: &Path) -> Result<Self, LaunchError> {
        let text =
            fs::read_to_string(path).map_err(|cause| LaunchError::Unreadable { path: path.to_path_buf(), cause })?;
        let absolute =
            std::path::absolute(path).map_err(|cause| LaunchError::Unreadable { path: path.to_path_buf(), cause })?;
        let mut launch = Self::parse_in(absolute.parent(), &path.display().to_string(), &text)?;
        let Replay { file, gnss, .. } = &mut launch.ingest.replay;
        if let Some(folder) = path.parent() {
            if let StateFile::File(file) = &mut launch.state_file {
                *file = folder.join(&*file);
            }
            if !file.as_os_str().is_empty() {
                *file = folder.join(&*file);
            }
            if let Gnss::File(file) = gnss {
                *file = folder.join(&*file);
            }
            let Gateway { tls, access, .. } = &mut launch.gateway;
            let certificates = tls.iter_mut().flat_map(|Tls { ca, cert, key }| [ca, cert, key]);
            certificates.chain(access).for_each(|file| *file = folder.join(&*file));
        }
        Ok(launch)
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
        let (table, syntax_errors) = DeTable::parse_recoverable(text);
        let mut list: Vec<_> = syntax_errors.iter().map(|error| Problem::syntax(error, text)).collect();
        if list.is_empty() {
            toml_reader::read_root(table.get_ref(), &mut list, |section| launch.read_keys(section, folder));
        }
        if list.is_empty() {
            return Ok(launch);
        }
        list.sort_by_key(|problem| problem.span.start);
        Err(Problems { file_name: file_name.into(), text: text.into(), list })
    }

    fn read_keys(&mut self, section: &mut Section<'_, '_>, folder: Option<&Path>) {
        section.parsed("name", r#"1 to 32 of a-z, 0-9, "_" and "-""#, system_name, &mut self.name);
        let all_known = services(section, &mut self.services);
        let buffer_valid = section.number("buffer_s", 0.1..=60.0, &mut self.buffer_s);
        let lateness_valid = section.number("lateness_s", 0.01..=60.0, &mut self.lateness_s);
        if buffer_valid && lateness_valid && self.lateness_s >= self.buffer_s {
            section.report(lateness_problem(self, section));
        }
        section.parsed("state_file", r#""auto", "off" or a path"#, state_file, &mut self.state_file);
        section.section("output", |section| output(section, &mut self.output));
        section.section("gateway", |section| gateway(section, &mut self.gateway));
        section.section("cockpit", |section| cockpit(section, &mut self.cockpit));
        section.section("restart", |section| restart(section, &mut self.restart));
        let allowed = !section.boolean("faults", &mut self.faults) || self.faults;
        section.section("ingest", |section| {
            ingest(section, &mut self.ingest);
            fault::faults(section, allowed, &mut self.ingest.faults);
        });
        self.add_drivers();
        if all_known && !self.gateway.is_split() {
            require_complete_path(section, &self.services);
            require_gateway_service(section);
        } else if all_known {
            split::validate(self, section).into_iter().for_each(|problem| section.report(problem));
        }
        if buffer_valid && let Some(problem) = buffer_problem(self, section) {
            section.report(problem);
        }
        external_stages(section, folder, self);
        promotion_rules(section, self);
        for slot in Slot::ALL {
            let mut config = self.stage(slot).clone();
            section.section(slot.name(), |section| {
                stage_config(section, slot, &self.stages, &mut config);
                if slot == Slot::Course {
                    north::north(section, &mut self.north);
                }
            });
            *self.stage_mut(slot) = config;
        }
    }
}

/// Reads `services` and returns `true` if every name is known.
fn services(section: &mut Section<'_, '_>, out: &mut Vec<Service>) -> bool {
    let allowed = Service::LISTED.map(|service| (service.name(), service));
    let Some(listed) = section.choices("services", &allowed) else { return true };
    let all_known = listed.iter().all(Option::is_some);
    let listed: Vec<_> = listed.into_iter().flatten().collect();
    for (index, service) in listed.iter().enumerate() {
        if let Some(first) = listed[..index].iter().find(|earlier| earlier.get_ref() == service.get_ref()) {
            let title = format!("services: \"{}\" is listed twice", service.get_ref());
            section.report(Problem {
                context: Some((first.span(), "first listed here".into())),
                ..Problem::new(service.span(), title, "listed again")
            });
        }
    }
    *out = listed.into_iter().map(Spanned::into_inner).collect();
    all_known
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

/// Reports a `[gateway]` section that has no effect because the gateway service is not started. If
/// the key `services` is present, the gateway was left out on purpose, and nothing is reported.
fn require_gateway_service(section: &mut Section<'_, '_>) {
    if let Some(span) = section.span("gateway").filter(|_| !section.has("services")) {
        let started = Service::LISTED.map(Service::name);
        section.report(Problem {
            help: Some(format!("at the top of the file: services = [{}]", quoted(&started))),
            note: Some("to ignore the section on purpose, set services without \"gateway\"".into()),
            ..Problem::new(span, "gateway: the service is not started", "no effect")
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
    let rate_hz = launch.ingest.declared_rate_hz()?;
    let max_s = MAX_TOPIC_MESSAGES as f64 / rate_hz;
    (launch.buffer_s > max_s).then(|| {
        let title = format!("buffer_s = {} at {rate_hz} Hz is more than a topic can hold", launch.buffer_s);
        let span = section.span("buffer_s").unwrap_or_default();
        let note = format!("a topic holds at most {MAX_TOPIC_MESSAGES} messages");
        Problem { note: Some(note), ..Problem::new(span, title, format!("expected at most {max_s:.1}")) }
    })
}

fn restart(section: &mut Section<'_, '_>, out: &mut Restart) {
    section.number("silence_s", 0.2..=60.0, &mut out.silence_s);
    section.number("min_uptime_s", 0.0..=60.0, &mut out.min_uptime_s);
    section.number("backoff_s", 0.0..=60.0, &mut out.backoff_s);
    section.number("backoff_max_s", 0.0..=600.0, &mut out.backoff_max_s);
    section.unsigned("limit", &mut out.limit);
    let policies = [("stop", OnLimit::Stop), ("degrade", OnLimit::Degrade), ("retry", OnLimit::Retry)];
    section.choice("on_limit", policies, &mut out.on_limit);
}

pub(crate) fn ingest(section: &mut Section<'_, '_>, out: &mut Ingest) {
    section.choice("source", Source::NAMES, &mut out.source);
    section.section("sim", |section| {
        section.choice("scenario", Motion::NAMES.map(named_value), &mut out.sim.scenario);
        section.number("rate_hz", RATE_RANGE_HZ, &mut out.sim.rate_hz);
        section.unsigned("seed", &mut out.sim.seed);
        for Parameter { name, min, max, .. } in &PARAMETERS {
            let mut value = 0.0;
            if section.has(name) && section.number(name, *min..=*max, &mut value) {
                out.sim.set.insert((*name).into(), value);
            } else {
                section.allow(name);
            }
        }
        let error = out.sim.scenario().err();
        if let Some((error, key)) = error.and_then(|error| match &error {
            ScenarioError::NotApplicable { key, .. } => Some((error.to_string(), *key)),
            _ => None,
        }) {
            section.report(Problem::new(section.span(key).unwrap_or_default(), error, "not in this scenario"));
        }
    });
    let (mut file_valid, mut file_span) = (true, None);
    section.section("replay", |section| {
        file_valid = section.parsed("file", "a path", |path| Some(path.into()), &mut out.replay.file);
        file_span = section.span("file");
        section.choice("gyro_samples", GyroSamples::ALL, &mut out.replay.gyro_samples);
        section.boolean("mag", &mut out.replay.mag);
        section.parsed("gnss", r#""auto", "off" or a path"#, gnss, &mut out.replay.gnss);
    });
    live_sources(section, out);
    section.section("limits", |section| {
        section.number("rate_max_deg_s", 1.0..=100_000.0, &mut out.limits.rate_max_deg_s);
        section.number("force_max_g", 0.1..=10_000.0, &mut out.limits.force_max_g);
        section.number("gap_s", 0.001..=10.0, &mut out.limits.gap_s);
        section.number("stuck_s", 0.01..=60.0, &mut out.limits.stuck_s);
        section.number("field_max_ut", 1.0..=1e6, &mut out.limits.field_max_ut);
    });

    section.section("calibration", |section| {
        calibration(section, "gyro", &mut out.calibration.gyro);
        calibration(section, "accel", &mut out.calibration.accel);
        calibration(section, "mag", &mut out.calibration.mag);
    });
    mounting(section, &mut out.mounting);

    if out.source == Source::Replay && file_valid && out.replay.file.as_os_str().is_empty() {
        let span = file_span.or_else(|| section.span("source")).unwrap_or_default();
        section.report(Problem {
            help: Some(r#"set a recording: file = "flight.csv.gz" in [ingest.replay]"#.into()),
            ..Problem::new(span, "ingest.replay.file: a replay needs a file, but none is set", "no file to replay")
        });
    }
}

fn state_file(text: &str) -> Option<StateFile> {
    match text {
        "" => None,
        "auto" => Some(StateFile::Auto),
        "off" => Some(StateFile::Off),
        path => Some(StateFile::File(path.into())),
    }
}

fn gnss(text: &str) -> Option<Gnss> {
    match text {
        "" => None,
        "auto" => Some(Gnss::Auto),
        "off" => Some(Gnss::Off),
        path => Some(Gnss::File(path.into())),
    }
}

fn named_value(name: &'static str) -> (&'static str, String) {
    (name, name.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BusSource, Limits, Sim, StageConfig};
    use attitude::{
        accel::Accelerometer,
        course::Course,
        frames::{Frame, QuaternionOrder},
        fuser::Fuser,
        gyro::Gyro,
    };
    use std::collections::BTreeMap;

    fn problems(text: &str) -> String {
        Launch::parse("launch.toml", text).unwrap_err().to_string()
    }

    #[test]
    fn empty_file_gives_the_default() {
        assert_eq!(Launch::parse("x", ""), Ok(Launch::default()));
        assert_eq!(Launch::parse("x", "[ingest]\n[ingest.sim]\n[gyro]\n"), Ok(Launch::default()));
    }

    #[test]
    fn default_values_are_valid() {
        let launch = Launch::default();
        assert!(system_name(&launch.name).is_some());
        assert!(launch.lateness_s < launch.buffer_s);
        assert!(Motion::from_name(&launch.ingest.sim.scenario).is_some());
        assert!(Gyro::NAMES.contains(&launch.gyro.stage.as_str()));
        assert!(Accelerometer::NAMES.contains(&launch.accel.stage.as_str()));
        assert!(Fuser::NAMES.contains(&launch.fuser.stage.as_str()));
        assert!(Course::NAMES.contains(&launch.course.stage.as_str()));
    }

    #[test]
    fn every_key_is_read() {
        let text = r#"
            name = "wing-2_b"
            services = ["course", "fuser", "accel", "gyro", "ingest"]
            buffer_s = 60
            lateness_s = 0.01
            state_file = "imu.state"
            output = { frame = "ned-frd", quaternion = "xyzw" }
            restart = { silence_s = 1, min_uptime_s = 2, backoff_s = 3, backoff_max_s = 4, limit = 5, on_limit = "retry" }
            faults = true
            gyro.stage = "rk4"
            accel = { stage = "projector" }
            [ingest]
            source = "replay"
            [ingest.sim]
            scenario = "tumble"
            rate_hz = 1_0_000
            seed = 0x7fff_ffff_ffff_ffff
            gyro_bias_deg_s = 0
            accel_noise_g = 10.0
            [ingest.replay]
            file = "flight.csv.gz"
            gyro_samples = "instants"
            mag = false
            gnss = "gnss.csv"
            [ingest.bus]
            rate_hz = 1
            gyro_samples = "instants"
            [ingest.limits]
            rate_max_deg_s = 1e5
            force_max_g = 0.1
            gap_s = 0.001
            stuck_s = 60
            field_max_ut = 100
            [fuser]
            stage = "wz-closed"
            [course]
            stage = "angles"
            set.declination_deg = -3.5
            north = "true"
        "#;
        let stage = |name: &str| StageConfig { stage: name.into(), set: BTreeMap::new() };
        let expected = Launch {
            name: "wing-2_b".into(),
            services: Service::PATH.into_iter().rev().collect(),
            buffer_s: 60.0,
            lateness_s: 0.01,
            state_file: StateFile::File("imu.state".into()),
            output: crate::Output { frame: Frame::NedFrd, quaternion: QuaternionOrder::Xyzw },
            restart: Restart {
                silence_s: 1.0,
                min_uptime_s: 2.0,
                backoff_s: 3.0,
                backoff_max_s: 4.0,
                limit: 5,
                on_limit: OnLimit::Retry,
            },
            faults: true,
            gateway: Gateway::default(),
            cockpit: crate::Cockpit::default(),
            ingest: Ingest {
                source: Source::Replay,
                sim: Sim {
                    scenario: "tumble".into(),
                    rate_hz: 10_000.0,
                    seed: i64::MAX.unsigned_abs(),
                    set: [("gyro_bias_deg_s".into(), 0.0), ("accel_noise_g".into(), 10.0)].into(),
                },
                replay: Replay {
                    file: "flight.csv.gz".into(),
                    gyro_samples: GyroSamples::Instants,
                    mag: false,
                    gnss: Gnss::File("gnss.csv".into()),
                },
                bus: BusSource { rate_hz: 1.0, gyro_samples: GyroSamples::Instants },
                limits: Limits {
                    rate_max_deg_s: 100_000.0,
                    force_max_g: 0.1,
                    gap_s: 0.001,
                    stuck_s: 60.0,
                    field_max_ut: 100.0,
                },
                ..Launch::default().ingest
            },
            stages: BTreeMap::new(),
            watch: Vec::new(),
            gyro: stage("rk4"),
            accel: stage("projector"),
            fuser: stage("wz-closed"),
            course: StageConfig { stage: "angles".into(), set: [("declination_deg".into(), -3.5)].into() },
            north: crate::NorthReference { is_true: true, ..Default::default() },
        };
        assert_eq!(Launch::parse("launch.toml", text), Ok(expected));
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
  = note: allowed: "name", "services", "buffer_s", "lateness_s", "state_file", "output", "gateway", "cockpit", "restart", "faults", "ingest", "stages", "watch", "gyro", "accel", "fuser", "course"

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
