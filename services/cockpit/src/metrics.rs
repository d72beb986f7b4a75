//! How the system is, as Prometheus reads it.
//!
//! Input: the last standing, the newest attitude and the gyro's bias. Output: the text format 0.0.4 of Prometheus: names with base units,
//! each family with what it means. Time: ages by CLOCK_MONOTONIC. Failure: what is not known is left out, never 0.

use std::fmt::Write as _;

use messages::Flags;
use wire::v1::{CourseReference, LatencyUs, ServiceStanding, standing::State};

use crate::hub::LatestState;

/// What the text is.
pub(crate) const CONTENT_TYPE: &str = "text/plain; version=0.0.4; charset=utf-8";
/// Services that are told of, and letters of a label, at most.
const MAX_SERVICES: usize = 64;
const MAX_LABEL: usize = 128;
/// What a service does, in a word, while it does its work.
const WORKING_STATES: [&str; 3] = ["ready", "running", "finished"];
/// The process that starts the services; it has no ticks of its own.
const SUPERVISOR: &str = "supervisor";

/// The text of a system of this name, at `now_ns` of CLOCK_MONOTONIC.
pub(crate) fn render(system: &str, newest: &LatestState, now_ns: u64) -> String {
    let mut text = Exposition(String::new());
    system_info(&mut text, system, newest);
    if newest.standing.state() == State::Live {
        services(&mut text, &newest.standing.services);
        attitude_path(&mut text, newest, now_ns);
    }
    text.0
}

/// Whose figures these are.
fn system_info(text: &mut Exposition, system: &str, LatestState { standing, .. }: &LatestState) {
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
    let connected_states = states.iter().filter(|_| standing.state() != State::Unspecified);
    let samples = connected_states.map(|(state, label)| (&label[..], f64::from(u8::from(*state == standing.state()))));
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
    let all: Vec<_> = all.iter().filter_map(|one| Some((one, one.status.as_ref()?))).take(MAX_SERVICES).collect();
    let names: Vec<_> = all.iter().map(|(_, status)| [("service", status.service.as_str())]).collect();
    let labelled = || names.iter().map(|name| &name[..]).zip(&all);
    let with_ticks = || labelled().filter(|(_, (_, status))| status.service != SUPERVISOR);

    let up = labelled().map(|(name, (_, status))| (name, f64::from(u8::from(WORKING_STATES.contains(&status.state.as_str())))));
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
    let samples = with_ticks().map(|(name, (_, status))| (name, f64::from(status.restarts)));
    text.counter("plumbline_service_restarts_total", "Times the service was started again.", samples);
    let samples = with_ticks().map(|(name, (_, status))| (name, status.ticks as f64));
    text.counter("plumbline_service_ticks_total", "Ticks that the service has published.", samples);
    let samples = with_ticks().map(|(name, (_, status))| (name, status.lost as f64));
    text.counter("plumbline_service_lost_ticks_total", "Ticks that never came to the service.", samples);
    let samples = with_ticks().map(|(name, (_, status))| (name, status.troubles.len() as f64));
    text.gauge("plumbline_service_troubles", "What is wrong with what the service reads: how many things.", samples);
    let samples = labelled().filter_map(|(name, (one, _))| Some((name, one.rate_hz?)));
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
    let samples = labelled().filter_map(|(name, (one, _))| Some((name, one.cpu_percent? / 100.0)));
    text.gauge("plumbline_service_cpu_ratio", "Share of one core over the last second.", samples);
    let samples = labelled().filter_map(|(name, (one, _))| Some((name, (one.resident_mib? * 1_048_576.0).round())));
    text.gauge("plumbline_service_resident_bytes", "Resident memory of the process.", samples);
}

/// What comes out of the path, and what is found of what goes in.
fn attitude_path(text: &mut Exposition, LatestState { standing, attitude, bias_rad_s }: &LatestState, now_ns: u64) {
    let warnings = standing.warnings.len() as f64;
    text.gauge(
        "plumbline_input_warnings",
        "What the judge of the input has found: how many things.",
        unlabelled(Some(warnings)),
    );
    let latencies = standing.latency_us.as_ref().map(quantiles).into_iter().flatten();
    let latencies: Vec<_> = latencies.map(|(quantile, s)| ([("quantile", quantile)], s)).collect();
    let samples = latencies.iter().map(|(labels, s)| (&labels[..], *s));
    let help = "From a sample's birth at ingest to its attitude, over the last second.";
    text.gauge("plumbline_attitude_latency_seconds", help, samples);

    let header = attitude.as_ref().and_then(|attitude| attitude.header.as_ref());
    let age_s = header.map(|header| now_ns.saturating_sub(header.t_sent_ns) as f64 * 1e-9);
    text.gauge("plumbline_attitude_age_seconds", "Time since the newest attitude was published.", unlabelled(age_s));
    text.gauge("plumbline_attitude_tick", "The newest attitude's tick.", unlabelled(header.map(|header| header.tick as f64)));
    let resets = attitude.as_ref().map(|attitude| attitude.reset_counter as f64);
    text.counter("plumbline_attitude_resets_total", "Times the attitude or the course was set anew.", unlabelled(resets));

    // Before the accelerometer was heard an attitude is only a start.
    let is_unaligned = header.is_none_or(|header| Flags(header.flags).any(Flags::UNALIGNED));
    let aligned = attitude.as_ref().filter(|_| !is_unaligned);
    let angle = |angle: fn(&wire::v1::AttitudeOutput) -> f64| unlabelled(aligned.map(angle));
    text.gauge("plumbline_attitude_roll_radians", "Right side down.", angle(|attitude| attitude.roll_rad));
    text.gauge("plumbline_attitude_pitch_radians", "Nose up.", angle(|attitude| attitude.pitch_rad));
    text.gauge("plumbline_attitude_yaw_radians", "Counter-clockwise from above.", angle(|attitude| attitude.yaw_rad));
    let reference = aligned.and_then(|attitude| match attitude.course_reference() {
        CourseReference::Unspecified => None,
        CourseReference::Arbitrary => Some([("reference", "arbitrary")]),
        CourseReference::Magnetic => Some([("reference", "magnetic")]),
        CourseReference::True => Some([("reference", "true")]),
    });
    let course = reference.as_ref().zip(aligned).map(|(label, attitude)| (&label[..], attitude.course_rad));
    text.gauge("plumbline_attitude_course_radians", "Course, clockwise from above, from the reference.", course);
    let help = "Standard deviation of the inclination.";
    let inclination_sd_rad = aligned.map(|attitude| attitude.inclination_sd_rad).filter(|sd_rad| is_known(*sd_rad));
    text.gauge("plumbline_attitude_inclination_sd_radians", help, unlabelled(inclination_sd_rad));
    let course_sd_rad = aligned.map(|attitude| attitude.course_sd_rad).filter(|sd_rad| is_known(*sd_rad));
    text.gauge("plumbline_attitude_course_sd_radians", "Standard deviation of the course.", unlabelled(course_sd_rad));

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
fn unlabelled(value: Option<f64>) -> Option<(Labels<'static>, f64)> {
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
                labels.iter().map(|(label, value)| format!("{label}=\"{}\"", escape_label(value))).collect();
            let labels = if labels.is_empty() { String::new() } else { format!("{{{}}}", labels.join(",")) };
            let _ = writeln!(self.0, "{name}{labels} {value}");
        }
    }
}

/// A label's value as it stands between quotes.
fn escape_label(value: &str) -> String {
    let mut text = String::new();
    for letter in value.chars().take(MAX_LABEL) {
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
    fn complete() -> LatestState {
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
        LatestState { standing, attitude: Some(attitude), bias_rad_s: Some([0.001, 0.0, -0.002]) }
    }

    fn lines(newest: &LatestState) -> Vec<String> {
        render("a\"b\\c\nd", newest, 3_500_000_000).lines().map(str::to_owned).collect()
    }

    fn names(newest: &LatestState) -> BTreeSet<String> {
        let named = |line: &String| Some(line.strip_prefix("# TYPE ")?.split(' ').next()?.to_owned());
        lines(newest).iter().filter_map(named).collect()
    }

    #[test]
    fn samples_have_base_units_and_labels_are_escaped() {
        let lines = lines(&complete());
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
    fn unknown_values_are_omitted_instead_of_0() {
        let about = ["plumbline_build_info"].map(String::from).into();
        assert_eq!(names(&LatestState::default()), about, "before anything is known");
        let mut ended = complete();
        ended.standing.state = State::Ended.into();
        assert!(names(&ended).iter().all(|name| !name.contains("attitude") && !name.contains("service")), "{ended:?}");
        let mut sparse = complete();
        sparse.bias_rad_s = Some([0.0; 3]);
        sparse.standing.services[0].cpu_percent = None;
        sparse.standing.services[1].cpu_percent = None;
        sparse.standing.services[0].latency_us = Some(LatencyUs { p50: f64::NAN, p99: f64::INFINITY, max: 1.0 });
        if let Some(attitude) = &mut sparse.attitude {
            attitude.course_sd_rad = std::f64::consts::PI;
        }
        let left: BTreeSet<_> = names(&complete()).difference(&names(&sparse)).cloned().collect();
        let unknown = [
            "plumbline_attitude_course_sd_radians",
            "plumbline_gyro_bias_radians_per_second",
            "plumbline_service_cpu_ratio",
        ];
        assert_eq!(left, unknown.map(String::from).into());
        assert!(!lines(&sparse).iter().any(|line| line.ends_with("NaN") || line.ends_with("inf")));
        let supervisor = |line: &&String| line.contains("_total") && line.contains(SUPERVISOR);
        assert_eq!(lines(&complete()).iter().find(supervisor), None, "it counts no ticks");
        if let Some(header) = sparse.attitude.as_mut().and_then(|attitude| attitude.header.as_mut()) {
            header.flags = Flags::UNALIGNED.0;
        }
        assert!(!names(&sparse).contains("plumbline_attitude_roll_radians"), "a start is no attitude");
    }

    #[test]
    fn text_length_is_bounded() {
        let mut many = complete();
        many.standing.services = vec![service(&"x".repeat(10_000), &"y".repeat(10_000)); 10_000];
        let length = render(&"\n".repeat(10_000), &many, 0).len();
        assert!(length < 512 * 1024, "{length} bytes");
    }

    #[test]
    fn dashboard_queries_match_exported_metrics() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/grafana/plumbline.json");
        let dashboard: serde_json::Value = serde_json::from_str(&fs::read_to_string(file).unwrap()).unwrap();
        let panels = dashboard["panels"].as_array().unwrap();
        let targets = panels.iter().flat_map(|panel| panel["targets"].as_array().into_iter().flatten());
        let expressions: Vec<_> = targets.map(|target| target["expr"].as_str().unwrap()).collect();
        let is_name = |letter: char| letter.is_ascii_alphanumeric() || letter == '_';
        let words = expressions.iter().flat_map(|expression| expression.split(|letter| !is_name(letter)));
        let queried: BTreeSet<_> = words.filter(|word| word.starts_with("plumbline_")).map(str::to_owned).collect();
        let exported = names(&complete());
        let missing: Vec<_> = queried.difference(&exported).collect();
        assert!(missing.is_empty(), "not in /metrics: {missing:?}");
        let unqueried: Vec<_> = exported.difference(&queried).filter(|name| !name.ends_with("_info")).collect();
        assert!(unqueried.is_empty(), "in no panel: {unqueried:?}");
        assert!(expressions.len() > 15 && panels.iter().all(|panel| panel["title"].is_string()));
    }
}
