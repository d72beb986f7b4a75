//! How the system is, as Prometheus reads it.
//!
//! Input: the last standing, the newest attitude and the gyro's bias. Output: the text format 0.0.4 of Prometheus: names with base units,
//! each family with what it means. Time: ages by CLOCK_MONOTONIC. Failure: what is not known is left out, never 0.

use std::fmt::Write as _;

use messages::Flags;
use wire::v1::{CourseReference, LatencyUs, ServiceStanding, standing::State};

use crate::hub::Newest;

/// What the text is.
pub(crate) const CONTENT_TYPE: &str = "text/plain; version=0.0.4; charset=utf-8";
/// Services that are told of, and letters of a label, at most.
const SERVICES_MAX: usize = 64;
const LABEL_MAX: usize = 128;
/// What a service does, in a word, while it does its work.
const UP: [&str; 3] = ["ready", "running", "finished"];
/// The process that starts the services; it has no ticks of its own.
const SUPERVISOR: &str = "supervisor";

/// The text of a system of this name, at `now_ns` of CLOCK_MONOTONIC.
pub(crate) fn text(system: &str, newest: &Newest, now_ns: u64) -> String {
    let mut text = Exposition(String::new());
    about(&mut text, system, newest);
    if newest.standing.state() == State::Live {
        services(&mut text, &newest.standing.services);
        path(&mut text, newest, now_ns);
    }
    text.0
}

/// Whose figures these are.
fn about(text: &mut Exposition, system: &str, Newest { standing, .. }: &Newest) {
    let build = [("version", env!("CARGO_PKG_VERSION")), ("system", system)];
    text.gauge(
        "plumbline_build_info",
        "Version of the program that answers, and the system's name.",
        [(&build[..], 1.0)],
    );
    let states = [
        (State::Connecting, [("state", "connecting")]),
        (State::Live, [("state", "live")]),
        (State::Ended, [("state", "ended")]),
        (State::Recording, [("state", "recording")]),
    ];
    let known = states.iter().filter(|_| standing.state() != State::Unspecified);
    let samples = known.map(|(state, label)| (&label[..], f64::from(u8::from(*state == standing.state()))));
    text.gauge(
        "plumbline_connection_state",
        "1 for what the system is to this program, 0 for what it is not.",
        samples,
    );
    let source = [("source", standing.source.as_str())];
    let source = (!standing.source.is_empty()).then_some((&source[..], 1.0));
    text.gauge("plumbline_source_info", "What the system is fed with.", source);
    let declared = Some((&[][..], standing.rate_hz)).filter(|(_, rate_hz)| *rate_hz > 0.0);
    text.gauge("plumbline_source_rate_hertz", "Ticks a second of the source's time, as declared.", declared);
}

/// What each service does and costs.
fn services(text: &mut Exposition, all: &[ServiceStanding]) {
    let all: Vec<_> = all.iter().filter_map(|one| Some((one, one.status.as_ref()?))).take(SERVICES_MAX).collect();
    let names: Vec<_> = all.iter().map(|(_, status)| [("service", status.service.as_str())]).collect();
    let each = || names.iter().map(|name| &name[..]).zip(&all);
    let counted = || each().filter(|(_, (_, status))| status.service != SUPERVISOR);

    let up = each().map(|(name, (_, status))| (name, f64::from(u8::from(UP.contains(&status.state.as_str())))));
    text.gauge(
        "plumbline_service_up",
        "1 while the service does its work, 0 while it starts, is silent or has ended.",
        up,
    );
    let stages: Vec<_> = all
        .iter()
        .filter(|(_, status)| !status.stage.is_empty())
        .map(|(_, status)| [("service", status.service.as_str()), ("stage", status.stage.as_str())])
        .collect();
    let samples = stages.iter().map(|labels| (&labels[..], 1.0));
    text.gauge("plumbline_service_stage_info", "The stage that fills the service's slot.", samples);
    let samples = counted().map(|(name, (_, status))| (name, f64::from(status.restarts)));
    text.counter("plumbline_service_restarts_total", "Times the service was started again.", samples);
    let samples = counted().map(|(name, (_, status))| (name, status.ticks as f64));
    text.counter("plumbline_service_ticks_total", "Ticks that the service has published.", samples);
    let samples = counted().map(|(name, (_, status))| (name, status.lost as f64));
    text.counter("plumbline_service_lost_ticks_total", "Ticks that never came to the service.", samples);
    let samples = counted().map(|(name, (_, status))| (name, status.troubles.len() as f64));
    text.gauge("plumbline_service_troubles", "What is wrong with what the service reads: how many things.", samples);
    let samples = each().filter_map(|(name, (one, _))| Some((name, one.rate_hz?)));
    text.gauge("plumbline_service_rate_hertz", "Ticks published a second.", samples);
    let quantiles: Vec<_> = all
        .iter()
        .filter_map(|(one, status)| Some((status.service.as_str(), one.latency_us.as_ref()?)))
        .flat_map(|(service, latency_us)| {
            quantiles(latency_us).map(|(quantile, s)| ([("service", service), ("quantile", quantile)], s))
        })
        .collect();
    let samples = quantiles.iter().map(|(labels, s)| (&labels[..], *s));
    text.gauge(
        "plumbline_service_latency_seconds",
        "From the last input of a tick to the service's output, over the last second.",
        samples,
    );
    let samples = each().filter_map(|(name, (one, _))| Some((name, one.cpu_percent? / 100.0)));
    text.gauge("plumbline_service_cpu_ratio", "Share of one core over the last second.", samples);
    let samples = each().filter_map(|(name, (one, _))| Some((name, (one.resident_mib? * 1_048_576.0).round())));
    text.gauge("plumbline_service_resident_bytes", "Resident memory of the process.", samples);
}

/// What comes out of the path, and what is found of what goes in.
fn path(text: &mut Exposition, Newest { standing, attitude, bias_rad_s }: &Newest, now_ns: u64) {
    let warnings = standing.warnings.len() as f64;
    text.gauge(
        "plumbline_input_warnings",
        "What the judge of the input has found: how many things.",
        bare(Some(warnings)),
    );
    let latencies = standing.latency_us.as_ref().map(quantiles).into_iter().flatten();
    let latencies: Vec<_> = latencies.map(|(quantile, s)| ([("quantile", quantile)], s)).collect();
    let samples = latencies.iter().map(|(labels, s)| (&labels[..], *s));
    let help = "From a sample's birth at ingest to its attitude, over the last second.";
    text.gauge("plumbline_attitude_latency_seconds", help, samples);

    let header = attitude.as_ref().and_then(|attitude| attitude.header.as_ref());
    let age_s = header.map(|header| now_ns.saturating_sub(header.t_sent_ns) as f64 * 1e-9);
    text.gauge("plumbline_attitude_age_seconds", "Time since the newest attitude was published.", bare(age_s));
    text.gauge("plumbline_attitude_tick", "The newest attitude's tick.", bare(header.map(|header| header.tick as f64)));
    let resets = attitude.as_ref().map(|attitude| attitude.reset_counter as f64);
    text.counter("plumbline_attitude_resets_total", "Times the attitude or the course was set anew.", bare(resets));

    // Before the accelerometer was heard an attitude is only a start.
    let is_start = header.is_none_or(|header| Flags(header.flags).any(Flags::UNALIGNED));
    let known = attitude.as_ref().filter(|_| !is_start);
    let angle = |angle: fn(&wire::v1::AttitudeOutput) -> f64| bare(known.map(angle));
    text.gauge("plumbline_attitude_roll_radians", "Right side down.", angle(|attitude| attitude.roll_rad));
    text.gauge("plumbline_attitude_pitch_radians", "Nose up.", angle(|attitude| attitude.pitch_rad));
    text.gauge("plumbline_attitude_yaw_radians", "Counter-clockwise from above.", angle(|attitude| attitude.yaw_rad));
    let reference = known.and_then(|attitude| match attitude.course_reference() {
        CourseReference::Unspecified => None,
        CourseReference::Arbitrary => Some([("reference", "arbitrary")]),
        CourseReference::Magnetic => Some([("reference", "magnetic")]),
        CourseReference::True => Some([("reference", "true")]),
    });
    let course = reference.as_ref().zip(known).map(|(label, attitude)| (&label[..], attitude.course_rad));
    text.gauge("plumbline_attitude_course_radians", "Course, clockwise from above, from the reference.", course);
    let help = "Standard deviation of the inclination.";
    let inclination_sd_rad = known.map(|attitude| attitude.inclination_sd_rad).filter(|sd_rad| is_known(*sd_rad));
    text.gauge("plumbline_attitude_inclination_sd_radians", help, bare(inclination_sd_rad));
    let course_sd_rad = known.map(|attitude| attitude.course_sd_rad).filter(|sd_rad| is_known(*sd_rad));
    text.gauge("plumbline_attitude_course_sd_radians", "Standard deviation of the course.", bare(course_sd_rad));

    // A stage that does not estimate it says zero.
    let bias = bias_rad_s.filter(|bias| bias.iter().any(|part| *part != 0.0));
    let axes = [[("axis", "x")], [("axis", "y")], [("axis", "z")]];
    let samples = bias.iter().flat_map(|bias| axes.iter().zip(bias)).map(|(axis, bias_rad_s)| (&axis[..], *bias_rad_s));
    text.gauge("plumbline_gyro_bias_radians_per_second", "Estimated bias of the gyro, body axes.", samples);
}

/// A standard deviation of an angle of which something is known: π is that of one of which nothing is.
fn is_known(sd_rad: f64) -> bool {
    sd_rad < std::f64::consts::PI
}

fn quantiles(latency_us: &LatencyUs) -> [(&'static str, f64); 3] {
    [("0.5", latency_us.p50), ("0.99", latency_us.p99), ("1", latency_us.max)].map(|(name, us)| (name, us / 1e6))
}

/// A sample without labels.
type Labels<'l> = &'l [(&'l str, &'l str)];

/// A sample without labels, where there is one.
fn bare(value: Option<f64>) -> Option<(Labels<'static>, f64)> {
    value.map(|value| (&[][..], value))
}

/// The text so far.
struct Exposition(String);

impl Exposition {
    /// What goes up and down.
    fn gauge<'l>(&mut self, name: &str, help: &str, samples: impl IntoIterator<Item = (Labels<'l>, f64)>) {
        self.family(name, "gauge", help, samples);
    }

    /// What only grows, until what counts it begins anew.
    fn counter<'l>(&mut self, name: &str, help: &str, samples: impl IntoIterator<Item = (Labels<'l>, f64)>) {
        self.family(name, "counter", help, samples);
    }

    /// A family with the samples that are numbers; nothing where there is none.
    fn family<'l>(&mut self, name: &str, kind: &str, help: &str, samples: impl IntoIterator<Item = (Labels<'l>, f64)>) {
        let mut samples = samples.into_iter().filter(|(_, value)| value.is_finite()).peekable();
        if samples.peek().is_none() {
            return;
        }
        // A text takes everything that is written to it.
        let _ = writeln!(self.0, "# HELP {name} {help}\n# TYPE {name} {kind}");
        for (labels, value) in samples {
            let labels: Vec<_> =
                labels.iter().map(|(label, value)| format!("{label}=\"{}\"", escaped(value))).collect();
            let labels = if labels.is_empty() { String::new() } else { format!("{{{}}}", labels.join(",")) };
            let _ = writeln!(self.0, "{name}{labels} {value}");
        }
    }
}

/// A label's value as it stands between quotes.
fn escaped(value: &str) -> String {
    let mut text = String::new();
    for letter in value.chars().take(LABEL_MAX) {
        match letter {
            '\\' => text.push_str("\\\\"),
            '"' => text.push_str("\\\""),
            '\n' => text.push_str("\\n"),
            other => text.push(other),
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use std::{collections::BTreeSet, fs, path::Path};

    use wire::v1::{AttitudeOutput, Header, ServiceStatus, Standing};

    use super::*;

    fn latency() -> Option<LatencyUs> {
        Some(LatencyUs { p50: 40.0, p99: 90.0, max: 250.0 })
    }

    fn service(name: &str, stage: &str) -> ServiceStanding {
        let status = ServiceStatus {
            service: name.into(),
            stage: stage.into(),
            state: "running".into(),
            restarts: 1,
            ticks: 5000,
            ..ServiceStatus::default()
        };
        ServiceStanding {
            status: Some(status),
            rate_hz: Some(1000.0),
            latency_us: latency(),
            cpu_percent: Some(12.5),
            resident_mib: Some(2.5),
        }
    }

    /// Everything is known.
    fn whole() -> Newest {
        let header = Some(Header { tick: 7, t_sent_ns: 1_000_000_000, ..Header::default() });
        let attitude = AttitudeOutput {
            header,
            roll_rad: -0.25,
            course_rad: 3.0,
            course_reference: CourseReference::Magnetic.into(),
            course_sd_rad: 0.02,
            inclination_sd_rad: 0.01,
            ..AttitudeOutput::default()
        };
        let standing = Standing {
            state: State::Live.into(),
            source: "sim s1".into(),
            rate_hz: 1000.0,
            services: vec![service("fuser", "wz"), ServiceStanding { rate_hz: None, ..service(SUPERVISOR, "") }],
            latency_us: latency(),
            ..Standing::default()
        };
        Newest { standing, attitude: Some(attitude), bias_rad_s: Some([0.001, 0.0, -0.002]) }
    }

    fn lines(newest: &Newest) -> Vec<String> {
        text("a\"b\\c\nd", newest, 3_500_000_000).lines().map(str::to_owned).collect()
    }

    fn names(newest: &Newest) -> BTreeSet<String> {
        let named = |line: &String| Some(line.strip_prefix("# TYPE ")?.split(' ').next()?.to_owned());
        lines(newest).iter().filter_map(named).collect()
    }

    #[test]
    fn figures_have_base_units_and_labels_are_escaped() {
        let lines = lines(&whole());
        for line in [
            concat!("plumbline_build_info{version=\"", env!("CARGO_PKG_VERSION"), "\",system=\"a\\\"b\\\\c\\nd\"} 1"),
            "plumbline_connection_state{state=\"live\"} 1",
            "plumbline_connection_state{state=\"ended\"} 0",
            "# TYPE plumbline_service_restarts_total counter",
            "plumbline_service_restarts_total{service=\"fuser\"} 1",
            "plumbline_service_latency_seconds{service=\"fuser\",quantile=\"0.99\"} 0.00009",
            "plumbline_service_cpu_ratio{service=\"supervisor\"} 0.125",
            "plumbline_service_resident_bytes{service=\"fuser\"} 2621440",
            "plumbline_attitude_age_seconds 2.5",
            "plumbline_attitude_roll_radians -0.25",
            "plumbline_attitude_course_radians{reference=\"magnetic\"} 3",
            "plumbline_gyro_bias_radians_per_second{axis=\"z\"} -0.002",
            "plumbline_input_warnings 0",
        ] {
            assert!(lines.iter().any(|one| one == line), "no {line} in {lines:#?}");
        }
    }

    #[test]
    fn what_is_not_known_is_absent_and_never_0() {
        let about = ["plumbline_build_info"].map(String::from).into();
        assert_eq!(names(&Newest::default()), about, "before anything is known");
        let mut ended = whole();
        ended.standing.state = State::Ended.into();
        assert!(names(&ended).iter().all(|name| !name.contains("attitude") && !name.contains("service")), "{ended:?}");
        let mut little = whole();
        little.bias_rad_s = Some([0.0; 3]);
        little.standing.services[0].cpu_percent = None;
        little.standing.services[1].cpu_percent = None;
        little.standing.services[0].latency_us = Some(LatencyUs { p50: f64::NAN, p99: f64::INFINITY, max: 1.0 });
        if let Some(attitude) = &mut little.attitude {
            attitude.course_sd_rad = std::f64::consts::PI;
        }
        let left: BTreeSet<_> = names(&whole()).difference(&names(&little)).cloned().collect();
        let unknown = [
            "plumbline_attitude_course_sd_radians",
            "plumbline_gyro_bias_radians_per_second",
            "plumbline_service_cpu_ratio",
        ];
        assert_eq!(left, unknown.map(String::from).into());
        assert!(!lines(&little).iter().any(|line| line.ends_with("NaN") || line.ends_with("inf")));
        let supervisor = |line: &&String| line.contains("_total") && line.contains(SUPERVISOR);
        assert_eq!(lines(&whole()).iter().find(supervisor), None, "it counts no ticks");
        if let Some(header) = little.attitude.as_mut().and_then(|attitude| attitude.header.as_mut()) {
            header.flags = Flags::UNALIGNED.0;
        }
        assert!(!names(&little).contains("plumbline_attitude_roll_radians"), "a start is no attitude");
    }

    #[test]
    fn the_text_is_bounded_whatever_the_system_says() {
        let mut many = whole();
        many.standing.services = vec![service(&"x".repeat(10_000), &"y".repeat(10_000)); 10_000];
        let length = text(&"\n".repeat(10_000), &many, 0).len();
        assert!(length < 512 * 1024, "{length} bytes");
    }

    #[test]
    fn what_the_dashboard_asks_for_is_there_and_what_is_there_is_asked_for() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/grafana/plumbline.json");
        let dashboard: serde_json::Value = serde_json::from_str(&fs::read_to_string(file).unwrap()).unwrap();
        let panels = dashboard["panels"].as_array().unwrap();
        let targets = panels.iter().flat_map(|panel| panel["targets"].as_array().into_iter().flatten());
        let expressions: Vec<_> = targets.map(|target| target["expr"].as_str().unwrap()).collect();
        let is_name = |letter: char| letter.is_ascii_alphanumeric() || letter == '_';
        let words = expressions.iter().flat_map(|expression| expression.split(|letter| !is_name(letter)));
        let asked: BTreeSet<_> = words.filter(|word| word.starts_with("plumbline_")).map(str::to_owned).collect();
        let there = names(&whole());
        let missing: Vec<_> = asked.difference(&there).collect();
        assert!(missing.is_empty(), "not in /metrics: {missing:?}");
        let unasked: Vec<_> = there.difference(&asked).filter(|name| !name.ends_with("_info")).collect();
        assert!(unasked.is_empty(), "in no panel: {unasked:?}");
        assert!(expressions.len() > 15 && panels.iter().all(|panel| panel["title"].is_string()));
    }
}
