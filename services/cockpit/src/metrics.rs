//! Metrics of the system in the text format of Prometheus, version 0.0.4.
//!
//! Input: the last status, the newest attitude and the gyro bias.
//! Output: metric families with base units in their names and a help text.
//! Time: ages are measured on CLOCK_MONOTONIC.
//! Failure: unknown values are omitted instead of exported as 0.

use std::fmt::Write as _;

use messages::Flags;
use wire::v1::{CourseReference, LatencyUs, ServiceReport, system_status::State};

use crate::hub::LatestState;

/// Media type of the text.
pub(crate) const CONTENT_TYPE: &str = "text/plain; version=0.0.4; charset=utf-8";
/// Maximum number of services exported.
const MAX_SERVICES: usize = 64;
/// Maximum length of a label value, in characters.
const MAX_LABEL: usize = 128;
/// Service states that count as up.
const WORKING_STATES: [&str; 3] = ["ready", "running", "finished"];
/// Name of the supervisor, which publishes no ticks.
const SUPERVISOR: &str = "supervisor";

/// Renders the metrics of a system. `now_ns` is the time on CLOCK_MONOTONIC.
pub(crate) fn render(system: &str, newest: &LatestState, now_ns: u64) -> String {
    let mut text = Exposition(String::new());
    system_info(&mut text, system, newest);
    if newest.status.state() == State::Live {
        services(&mut text, &newest.status.services);
        attitude_path(&mut text, newest, now_ns);
    }
    text.0
}

/// Writes the metrics of the program version, of the connection and of the source.
fn system_info(text: &mut Exposition, system: &str, LatestState { status, .. }: &LatestState) {
    let build = [("version", env!("CARGO_PKG_VERSION")), ("system", system)];
    text.gauge("plumbline_build_info", "Version of the exporting program and name of the system.", [(&build[..], 1.0)]);
    let states = [
        (State::Connecting, [("state", "connecting")]),
        (State::Live, [("state", "live")]),
        (State::Ended, [("state", "ended")]),
        (State::Recording, [("state", "recording")]),
    ];
    let connected_states = states.iter().filter(|_| status.state() != State::Unspecified);
    let samples = connected_states.map(|(state, label)| (&label[..], f64::from(u8::from(*state == status.state()))));
    text.gauge(
        "plumbline_connection_state",
        "1 for the current state of the connection to the system, 0 for the others.",
        samples,
    );
    let source = [("source", status.source.as_str())];
    let source = (!status.source.is_empty()).then_some((&source[..], 1.0));
    text.gauge("plumbline_source_info", "Source of the system's samples.", source);
    let declared = Some((&[][..], status.rate_hz)).filter(|(_, rate_hz)| *rate_hz > 0.0);
    text.gauge("plumbline_source_rate_hertz", "Declared tick rate of the source.", declared);
}

/// Writes the state, the counters and the resource usage of each service.
fn services(text: &mut Exposition, all: &[ServiceReport]) {
    let all: Vec<_> = all.iter().filter_map(|one| Some((one, one.status.as_ref()?))).take(MAX_SERVICES).collect();
    let names: Vec<_> = all.iter().map(|(_, status)| [("service", status.service.as_str())]).collect();
    let labelled = || names.iter().map(|name| &name[..]).zip(&all);
    let with_ticks = || labelled().filter(|(_, (_, status))| status.service != SUPERVISOR);

    let up = labelled()
        .map(|(name, (_, status))| (name, f64::from(u8::from(WORKING_STATES.contains(&status.state.as_str())))));
    text.gauge("plumbline_service_up", "1 while the service is ready, running or finished, otherwise 0.", up);
    let stages: Vec<_> = all
        .iter()
        .filter(|(_, status)| !status.stage.is_empty())
        .map(|(_, status)| [("service", status.service.as_str()), ("stage", status.stage.as_str())])
        .collect();
    let samples = stages.iter().map(|labels| (&labels[..], 1.0));
    text.gauge("plumbline_service_stage_info", "Stage that owns the service's slot.", samples);
    let samples = with_ticks().map(|(name, (_, status))| (name, f64::from(status.restarts)));
    text.counter("plumbline_service_restarts_total", "Restarts of the service.", samples);
    let samples = with_ticks().map(|(name, (_, status))| (name, status.ticks as f64));
    text.counter("plumbline_service_ticks_total", "Ticks published by the service.", samples);
    let samples = with_ticks().map(|(name, (_, status))| (name, status.lost as f64));
    text.counter("plumbline_service_lost_ticks_total", "Ticks that the service did not receive.", samples);
    let samples = with_ticks().map(|(name, (_, status))| (name, status.diagnostics.len() as f64));
    text.gauge("plumbline_service_diagnostics", "Active diagnostics of the service's inputs.", samples);
    let samples = labelled().filter_map(|(name, (one, _))| Some((name, one.rate_hz?)));
    text.gauge("plumbline_service_rate_hertz", "Rate of published ticks.", samples);
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
        "Time from the last input of a tick to the service's output, over the last second.",
        samples,
    );
    let samples = labelled().filter_map(|(name, (one, _))| Some((name, one.cpu_percent? / 100.0)));
    text.gauge("plumbline_service_cpu_ratio", "CPU usage over the last second, as a share of one core.", samples);
    let samples = labelled().filter_map(|(name, (one, _))| Some((name, (one.resident_mib? * 1_048_576.0).round())));
    text.gauge("plumbline_service_resident_bytes", "Resident memory of the process.", samples);
}

/// Writes the newest attitude, its latency and the number of input warnings.
fn attitude_path(text: &mut Exposition, LatestState { status, attitude, bias_rad_s }: &LatestState, now_ns: u64) {
    let warnings = status.warnings.len() as f64;
    text.gauge("plumbline_input_warnings", "Warnings of the input check.", unlabelled(Some(warnings)));
    let latencies = status.latency_us.as_ref().map(quantiles).into_iter().flatten();
    let latencies: Vec<_> = latencies.map(|(quantile, s)| ([("quantile", quantile)], s)).collect();
    let samples = latencies.iter().map(|(labels, s)| (&labels[..], *s));
    let help = "Time from the reception of a sample at ingest to its attitude, over the last second.";
    text.gauge("plumbline_attitude_latency_seconds", help, samples);

    let header = attitude.as_ref().and_then(|attitude| attitude.header.as_ref());
    let age_s = header.map(|header| now_ns.saturating_sub(header.t_sent_ns) as f64 * 1e-9);
    text.gauge("plumbline_attitude_age_seconds", "Time since the newest attitude was published.", unlabelled(age_s));
    text.gauge(
        "plumbline_attitude_tick",
        "Tick of the newest attitude.",
        unlabelled(header.map(|header| header.tick as f64)),
    );
    let resets = attitude.as_ref().map(|attitude| attitude.reset_counter as f64);
    text.counter("plumbline_attitude_resets_total", "Resets of the attitude or the course.", unlabelled(resets));

    // The attitude is not exported until the accelerometer has aligned it, because it is only an
    // initial value before that.
    let is_unaligned = header.is_none_or(|header| Flags(header.flags).any(Flags::UNALIGNED));
    let aligned = attitude.as_ref().filter(|_| !is_unaligned);
    let angle = |angle: fn(&wire::v1::AttitudeOutput) -> f64| unlabelled(aligned.map(angle));
    text.gauge(
        "plumbline_attitude_roll_radians",
        "Roll, right side down positive.",
        angle(|attitude| attitude.roll_rad),
    );
    text.gauge("plumbline_attitude_pitch_radians", "Pitch, nose up positive.", angle(|attitude| attitude.pitch_rad));
    text.gauge(
        "plumbline_attitude_yaw_radians",
        "Yaw, counter-clockwise from above positive.",
        angle(|attitude| attitude.yaw_rad),
    );
    let reference = aligned.and_then(|attitude| match attitude.course_reference() {
        CourseReference::Unspecified => None,
        CourseReference::Arbitrary => Some([("reference", "arbitrary")]),
        CourseReference::Magnetic => Some([("reference", "magnetic")]),
        CourseReference::True => Some([("reference", "true")]),
    });
    let course = reference.as_ref().zip(aligned).map(|(label, attitude)| (&label[..], attitude.course_rad));
    text.gauge(
        "plumbline_attitude_course_radians",
        "Course from the reference, clockwise from above positive.",
        course,
    );
    let help = "Standard deviation of the inclination.";
    let inclination_sd_rad = aligned.map(|attitude| attitude.inclination_sd_rad).filter(|sd_rad| is_known(*sd_rad));
    text.gauge("plumbline_attitude_inclination_sd_radians", help, unlabelled(inclination_sd_rad));
    let course_sd_rad = aligned.map(|attitude| attitude.course_sd_rad).filter(|sd_rad| is_known(*sd_rad));
    text.gauge("plumbline_attitude_course_sd_radians", "Standard deviation of the course.", unlabelled(course_sd_rad));

    // A stage that does not estimate the bias publishes zeros, so a zero bias is not exported.
    let bias = bias_rad_s.filter(|bias| bias.iter().any(|part| *part != 0.0));
    let axes = [[("axis", "x")], [("axis", "y")], [("axis", "z")]];
    let samples = bias.iter().flat_map(|bias| axes.iter().zip(bias)).map(|(axis, bias_rad_s)| (&axis[..], *bias_rad_s));
    text.gauge("plumbline_gyro_bias_radians_per_second", "Estimated bias of the gyro, body axes.", samples);
}

/// Returns `true` if the standard deviation is below π. The value π stands for an unknown angle.
fn is_known(sd_rad: f64) -> bool {
    sd_rad < std::f64::consts::PI
}

fn quantiles(latency_us: &LatencyUs) -> [(&'static str, f64); 3] {
    [("0.5", latency_us.p50), ("0.99", latency_us.p99), ("1", latency_us.max)].map(|(name, us)| (name, us / 1e6))
}

/// Names and values of the labels of a sample.
type Labels<'l> = &'l [(&'l str, &'l str)];

/// Returns a sample without labels, or `None` if the value is unknown.
fn unlabelled(value: Option<f64>) -> Option<(Labels<'static>, f64)> {
    value.map(|value| (&[][..], value))
}

/// Text in the exposition format.
struct Exposition(String);

impl Exposition {
    /// Writes a gauge: a metric family with values that can rise and fall.
    fn gauge<'l>(&mut self, name: &str, help: &str, samples: impl IntoIterator<Item = (Labels<'l>, f64)>) {
        self.family(name, "gauge", help, samples);
    }

    /// Writes a counter: a metric family with values that only rise, except for a reset to zero.
    fn counter<'l>(&mut self, name: &str, help: &str, samples: impl IntoIterator<Item = (Labels<'l>, f64)>) {
        self.family(name, "counter", help, samples);
    }

    /// Writes a metric family with its finite samples, or nothing if it has no finite sample.
    fn family<'l>(&mut self, name: &str, kind: &str, help: &str, samples: impl IntoIterator<Item = (Labels<'l>, f64)>) {
        let mut samples = samples.into_iter().filter(|(_, value)| value.is_finite()).peekable();
        if samples.peek().is_none() {
            return;
        }
        // Writing to a string cannot fail.
        let _ = writeln!(self.0, "# HELP {name} {help}\n# TYPE {name} {kind}");
        for (labels, value) in samples {
            let labels: Vec<_> =
                labels.iter().map(|(label, value)| format!("{label}=\"{}\"", escape_label(value))).collect();
            let labels = if labels.is_empty() { String::new() } else { format!("{{{}}}", labels.join(",")) };
            let _ = writeln!(self.0, "{name}{labels} {value}");
        }
    }
}

/// Escapes a label value and truncates it to [`MAX_LABEL`] characters.
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

    use wire::v1::{AttitudeOutput, Header, ServiceStatus, SystemStatus};

    use super::*;

    fn latency() -> Option<LatencyUs> {
        Some(LatencyUs { p50: 40.0, p99: 90.0, max: 250.0 })
    }

    fn service(name: &str, stage: &str) -> ServiceReport {
        let status = ServiceStatus {
            service: name.into(),
            stage: stage.into(),
            state: "running".into(),
            restarts: 1,
            ticks: 5000,
            ..ServiceStatus::default()
        };
        ServiceReport {
            status: Some(status),
            rate_hz: Some(1000.0),
            latency_us: latency(),
            cpu_percent: Some(12.5),
            resident_mib: Some(2.5),
        }
    }

    /// Returns a state in which every value is known.
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
        let status = SystemStatus {
            state: State::Live.into(),
            source: "sim s1".into(),
            rate_hz: 1000.0,
            services: vec![service("fuser", "wz"), ServiceReport { rate_hz: None, ..service(SUPERVISOR, "") }],
            latency_us: latency(),
            ..SystemStatus::default()
        };
        LatestState { status, attitude: Some(attitude), bias_rad_s: Some([0.001, 0.0, -0.002]) }
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
        let expected = ["plumbline_build_info"].map(String::from).into();
        assert_eq!(names(&LatestState::default()), expected, "before the first status");
        let mut ended = complete();
        ended.status.state = State::Ended.into();
        assert!(names(&ended).iter().all(|name| !name.contains("attitude") && !name.contains("service")), "{ended:?}");
        let mut sparse = complete();
        sparse.bias_rad_s = Some([0.0; 3]);
        sparse.status.services[0].cpu_percent = None;
        sparse.status.services[1].cpu_percent = None;
        sparse.status.services[0].latency_us = Some(LatencyUs { p50: f64::NAN, p99: f64::INFINITY, max: 1.0 });
        if let Some(attitude) = &mut sparse.attitude {
            attitude.course_sd_rad = std::f64::consts::PI;
        }
        let omitted: BTreeSet<_> = names(&complete()).difference(&names(&sparse)).cloned().collect();
        let unknown = [
            "plumbline_attitude_course_sd_radians",
            "plumbline_gyro_bias_radians_per_second",
            "plumbline_service_cpu_ratio",
        ];
        assert_eq!(omitted, unknown.map(String::from).into());
        assert!(!lines(&sparse).iter().any(|line| line.ends_with("NaN") || line.ends_with("inf")));
        let supervisor = |line: &&String| line.contains("_total") && line.contains(SUPERVISOR);
        assert_eq!(lines(&complete()).iter().find(supervisor), None, "the supervisor counts no ticks");
        if let Some(header) = sparse.attitude.as_mut().and_then(|attitude| attitude.header.as_mut()) {
            header.flags = Flags::UNALIGNED.0;
        }
        assert!(!names(&sparse).contains("plumbline_attitude_roll_radians"), "an unaligned attitude is omitted");
    }

    #[test]
    fn text_length_is_bounded() {
        let mut many = complete();
        many.status.services = vec![service(&"x".repeat(10_000), &"y".repeat(10_000)); 10_000];
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
