//! Which keys there are, and what each may be.

use crate::{
    GyroSamples, Launch, LaunchError, OnLimit, Problems, Restart, Service, Source,
    cockpit::cockpit,
    fault,
    filling::filling,
    gateway::{Gateway, Tls},
    gateway_section::gateway,
    live::{RATES_HZ, live},
    model::{Gnss, Ingest, Replay, StateFile, TOPIC_MESSAGES_MAX, system_name},
    north,
    output::output,
    problem::{Problem, quoted},
    program::programs,
    sensors::{calibration, mounting},
    split,
    walk::{self, Section},
    watch::watches,
};
use scenario::{Motion, PARAMETERS, Parameter, ScenarioError};
use std::{fs, path::Path};
use toml::{Spanned, de::DeTable};

impl Launch {
    /// Reads a launch file. A relative file of `state_file`, `ingest.replay` or `gateway` is taken from the launch file's folder.
    pub fn read(path: &Path) -> Result<Self, LaunchError> {
        let text =
            fs::read_to_string(path).map_err(|cause| LaunchError::Unreadable { path: path.to_path_buf(), cause })?;
        let place =
            std::path::absolute(path).map_err(|cause| LaunchError::Unreadable { path: path.to_path_buf(), cause })?;
        let mut launch = Self::parse_in(place.parent(), &path.display().to_string(), &text)?;
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

    /// The launch a text declares; `file_name` is what problems call it. An absent key takes its default.
    ///
    /// A text that is not TOML is not looked into further: what its tables hold is then a guess.
    pub fn parse(file_name: &str, text: &str) -> Result<Self, Problems> {
        Self::parse_in(None, file_name, text)
    }

    fn parse_in(folder: Option<&Path>, file_name: &str, text: &str) -> Result<Self, Problems> {
        let mut launch = Self::default();
        let (table, syntax_errors) = DeTable::parse_recoverable(text);
        let mut list: Vec<_> = syntax_errors.iter().map(|error| Problem::syntax(error, text)).collect();
        if list.is_empty() {
            walk::root(table.get_ref(), &mut list, |section| launch.take(section, folder));
        }
        if list.is_empty() {
            return Ok(launch);
        }
        list.sort_by_key(|problem| problem.span.start);
        Err(Problems { file_name: file_name.into(), text: text.into(), list })
    }

    fn take(&mut self, section: &mut Section<'_, '_>, folder: Option<&Path>) {
        section.text("name", r#"1 to 32 of a-z, 0-9, "_" and "-""#, system_name, &mut self.name);
        let all_known = services(section, &mut self.services);
        let buffer_taken = section.number("buffer_s", 0.1..=60.0, &mut self.buffer_s);
        let lateness_taken = section.number("lateness_s", 0.01..=60.0, &mut self.lateness_s);
        if buffer_taken && lateness_taken && self.lateness_s >= self.buffer_s {
            section.report(lateness_problem(self, section));
        }
        section.text("state_file", r#""auto", "off" or a path"#, state_file, &mut self.state_file);
        section.section("output", |section| output(section, &mut self.output));
        section.section("gateway", |section| gateway(section, &mut self.gateway));
        section.section("cockpit", |section| cockpit(section, &mut self.cockpit));
        section.section("restart", |section| restart(section, &mut self.restart));
        let allowed = !section.flag("faults", &mut self.faults) || self.faults;
        section.section("ingest", |section| {
            ingest(section, &mut self.ingest);
            fault::script(section, allowed, &mut self.ingest.faults);
        });
        self.add_drivers();
        if all_known && !self.gateway.is_split() {
            whole(section, &self.services);
            gateway_starts(section);
        } else if all_known {
            split::problems(self, section).into_iter().for_each(|problem| section.report(problem));
        }
        if buffer_taken && let Some(problem) = buffer_problem(self, section) {
            section.report(problem);
        }
        programs(section, folder, self);
        watches(section, self);
        for slot in Service::SLOTS {
            let Self { stages, gyro, accel, fuser, course, north, .. } = &mut *self;
            let out = match slot {
                Service::Ingest | Service::Gateway | Service::Drivers | Service::Cockpit => continue,
                Service::Gyro => gyro,
                Service::Accel => accel,
                Service::Fuser => fuser,
                Service::Course => course,
            };
            section.section(slot.name(), |section| {
                filling(section, slot, stages, out);
                if slot == Service::Course {
                    north::north(section, north);
                }
            });
        }
    }
}

/// Whether every name was known.
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

/// A system on one host has every service of the data path.
fn whole(section: &mut Section<'_, '_>, services: &[Service]) {
    let missing: Vec<_> =
        Service::PATH.into_iter().filter(|service| !services.contains(service)).map(Service::name).collect();
    if let Some(span) = section.span("services").filter(|_| !missing.is_empty()) {
        section.report(Problem {
            note: Some("every service of the data path runs exactly once, here or behind [gateway.import]".into()),
            ..Problem::new(span, format!("services: {} missing", quoted(&missing)), "incomplete")
        });
    }
}

/// What is said of the gateway is for one that is started. Who lists the services without it has left it out.
fn gateway_starts(section: &mut Section<'_, '_>) {
    if let Some(span) = section.span("gateway").filter(|_| !section.has("services")) {
        let started = Service::LISTED.map(Service::name);
        section.report(Problem {
            help: Some(format!("at the top of the file: services = [{}]", quoted(&started))),
            note: Some("a list of services without \"gateway\" leaves it out".into()),
            ..Problem::new(span, "gateway: it is not among the services that are started", "nothing goes out")
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
    Problem { note: Some("a join can wait only for what the topics still hold".into()), ..problem }
}

/// A recording's rate is not known here; its buffers are cut to the limit.
pub(crate) fn buffer_problem(launch: &Launch, section: &Section<'_, '_>) -> Option<Problem> {
    let rate_hz = launch.ingest.declared_rate_hz()?;
    let most_s = TOPIC_MESSAGES_MAX as f64 / rate_hz;
    (launch.buffer_s > most_s).then(|| {
        let title = format!("buffer_s = {} at {rate_hz} Hz is more than a topic can hold", launch.buffer_s);
        let place = section.span("buffer_s").unwrap_or_default();
        let note = format!("a topic holds {TOPIC_MESSAGES_MAX} messages at most");
        Problem { note: Some(note), ..Problem::new(place, title, format!("expected at most {most_s:.1}")) }
    })
}

fn restart(section: &mut Section<'_, '_>, out: &mut Restart) {
    section.number("silence_s", 0.2..=60.0, &mut out.silence_s);
    section.number("settled_s", 0.0..=60.0, &mut out.settled_s);
    section.number("backoff_s", 0.0..=60.0, &mut out.backoff_s);
    section.number("backoff_max_s", 0.0..=600.0, &mut out.backoff_max_s);
    section.natural("limit", &mut out.limit);
    let policies = [("stop", OnLimit::Stop), ("degrade", OnLimit::Degrade), ("hold", OnLimit::Hold)];
    section.choice("on_limit", policies, &mut out.on_limit);
}

pub(crate) fn ingest(section: &mut Section<'_, '_>, out: &mut Ingest) {
    section.choice("source", Source::NAMES, &mut out.source);
    section.section("sim", |section| {
        section.choice("scenario", Motion::NAMES.map(named), &mut out.sim.scenario);
        section.number("rate_hz", RATES_HZ, &mut out.sim.rate_hz);
        section.natural("seed", &mut out.sim.seed);
        for Parameter { name, least, most, .. } in &PARAMETERS {
            let mut value = 0.0;
            if section.has(name) && section.number(name, *least..=*most, &mut value) {
                out.sim.set.insert((*name).into(), value);
            } else {
                section.knows(name);
            }
        }
        let refused = out.sim.scenario().err();
        if let Some((error, key)) = refused.and_then(|error| match &error {
            ScenarioError::Lacks { key, .. } => Some((error.to_string(), *key)),
            _ => None,
        }) {
            section.report(Problem::new(section.span(key).unwrap_or_default(), error, "not in this scenario"));
        }
    });
    let (mut file_taken, mut file_span) = (true, None);
    section.section("replay", |section| {
        file_taken = section.text("file", "a path", |path| Some(path.into()), &mut out.replay.file);
        file_span = section.span("file");
        section.choice("gyro_samples", GyroSamples::ALL, &mut out.replay.gyro_samples);
        section.flag("mag", &mut out.replay.mag);
        section.text("gnss", r#""auto", "off" or a path"#, gnss, &mut out.replay.gnss);
    });
    live(section, out);
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

    if out.source == Source::Replay && file_taken && out.replay.file.as_os_str().is_empty() {
        let span = file_span.or_else(|| section.span("source")).unwrap_or_default();
        section.report(Problem {
            help: Some(r#"name a recording: file = "flight.csv.gz" in [ingest.replay]"#.into()),
            ..Problem::new(span, "ingest.replay.file: a replay needs a file, none is named", "no file to replay")
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

fn named(name: &'static str) -> (&'static str, String) {
    (name, name.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BusSource, Limits, Sim, Stage};
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
    fn an_empty_file_is_the_default() {
        assert_eq!(Launch::parse("x", ""), Ok(Launch::default()));
        assert_eq!(Launch::parse("x", "[ingest]\n[ingest.sim]\n[gyro]\n"), Ok(Launch::default()));
    }

    #[test]
    fn the_defaults_are_allowed_values() {
        let launch = Launch::default();
        assert!(system_name(&launch.name).is_some());
        assert!(launch.lateness_s < launch.buffer_s);
        assert!(Motion::named(&launch.ingest.sim.scenario).is_some());
        assert!(Gyro::NAMES.contains(&launch.gyro.stage.as_str()));
        assert!(Accelerometer::NAMES.contains(&launch.accel.stage.as_str()));
        assert!(Fuser::NAMES.contains(&launch.fuser.stage.as_str()));
        assert!(Course::NAMES.contains(&launch.course.stage.as_str()));
    }

    #[test]
    fn every_key_is_taken() {
        let text = r#"
            name = "wing-2_b"
            services = ["course", "fuser", "accel", "gyro", "ingest"]
            buffer_s = 60
            lateness_s = 0.01
            state_file = "imu.state"
            output = { frame = "ned-frd", quaternion = "xyzw" }
            restart = { silence_s = 1, settled_s = 2, backoff_s = 3, backoff_max_s = 4, limit = 5, on_limit = "hold" }
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
        let stage = |name: &str| Stage { stage: name.into(), set: BTreeMap::new() };
        let expected = Launch {
            name: "wing-2_b".into(),
            services: Service::PATH.into_iter().rev().collect(),
            buffer_s: 60.0,
            lateness_s: 0.01,
            state_file: StateFile::File("imu.state".into()),
            output: crate::Output { frame: Frame::NedFrd, quaternion: QuaternionOrder::Xyzw },
            restart: Restart {
                silence_s: 1.0,
                settled_s: 2.0,
                backoff_s: 3.0,
                backoff_max_s: 4.0,
                limit: 5,
                on_limit: OnLimit::Hold,
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
            course: Stage { stage: "angles".into(), set: [("declination_deg".into(), -3.5)].into() },
            north: crate::North { is_true: true, ..Default::default() },
        };
        assert_eq!(Launch::parse("launch.toml", text), Ok(expected));
    }

    #[test]
    fn two_problems_are_shown_at_once_as_rustc_shows_them() {
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
    fn each_problem_points_at_its_place() {
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
                &["services: \"course\" missing", ":1:12\n", "^ incomplete", "every service of the data path runs"],
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
        for (text, parts) in cases {
            let shown = problems(text);
            for part in *parts {
                assert!(shown.contains(part), "{part:?} is not in\n{shown}");
            }
            assert!(shown.ends_with("launch.toml: 1 problem"), "{shown}");
        }
    }

    #[test]
    fn a_refused_value_causes_no_second_problem() {
        assert!(problems("buffer_s = 0.2\nlateness_s = 100").ends_with("1 problem"));
        assert!(problems("ingest.source = \"replay\"\ningest.replay.file = 7").ends_with("1 problem"));
    }

    #[test]
    fn every_syntax_error_is_shown_and_nothing_guessed_from_the_rest() {
        let shown = problems("name = \"abc\nbufer_s = 1\n[gyro\nstage = \"none\"\n");
        assert!(shown.contains(":1:12\n") && shown.contains(":3:6\n"), "{shown}");
        assert!(shown.ends_with("launch.toml: 2 problems"), "{shown}");
    }

    #[test]
    fn a_relative_file_lies_beside_the_launch_file() {
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
    fn a_file_that_cannot_be_read_is_named() {
        let error = Launch::read(Path::new("/nowhere/launch.toml")).unwrap_err();
        assert!(matches!(error, LaunchError::Unreadable { .. }));
        assert!(error.to_string().starts_with("reading the launch file /nowhere/launch.toml: "), "{error}");
        assert!(error.to_string().contains("check that it exists"), "{error}");
    }

    #[test]
    fn a_buffer_that_no_topic_can_hold_is_refused() {
        let text = "buffer_s = 60.0\n[ingest.sim]\nrate_hz = 10000\n";
        let shown = Launch::parse("launch.toml", text).unwrap_err().to_string();
        for said in ["launch.toml:1:12", "expected at most 6.6", "65536 messages"] {
            assert!(shown.contains(said), "{said}: {shown}");
        }
    }
}
