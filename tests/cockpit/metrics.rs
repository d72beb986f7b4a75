//! Metrics for Prometheus, compared with other outputs of the system.
use std::{collections::BTreeSet, path::Path, process::Command};

use super::page::{row, with_cockpit};
use crate::common::{System, python::python, signal, wait_for};
use rustix::process::Signal;
use serde_json::Value;

/// Samples of `/metrics`: name, labels and value.
struct Metrics(Vec<(String, Value, f64)>);

impl Metrics {
    /// Reads `/metrics`; `None` while the port refuses connections.
    fn read(python: &Path, port: u16) -> Option<Self> {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foreign/metrics.py");
        let output = Command::new(python).arg(script).arg(format!("http://127.0.0.1:{port}/metrics")).output().unwrap();
        if !output.status.success() {
            let message = String::from_utf8_lossy(&output.stderr);
            assert!(message.contains("Connection refused"), "{message}");
            return None;
        }
        let read: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(read["content_type"], "text/plain; version=0.0.4; charset=utf-8");
        let samples: Vec<(String, Value, f64)> = serde_json::from_value(read["samples"].clone()).unwrap();
        assert_eq!(read["lines"], samples.len(), "each line is a sample");
        assert_eq!((&read["unread"], &read["without_help"]), (&Value::Array(vec![]), &Value::Array(vec![])));
        let names: BTreeSet<_> = samples.iter().map(|(name, labels, _)| format!("{name}{labels}")).collect();
        assert_eq!(names.len(), samples.len(), "no duplicate samples");
        Some(Self(samples))
    }

    fn value(&self, name: &str, label: &str, value: &str) -> Option<f64> {
        let found = self.0.iter().find(|(own, labels, _)| own == name && (label.is_empty() || labels[label] == value));
        found.map(|(_, _, value)| *value)
    }

    fn service_value(&self, name: &str, service: &str) -> Option<f64> {
        self.value(name, "service", service)
    }

    fn unlabelled_value(&self, name: &str) -> Option<f64> {
        self.value(name, "", "")
    }
}

/// Waits until the metrics satisfy the condition.
fn wait_for_metrics(what: &str, python: &Path, port: u16, is: impl Fn(&Metrics) -> bool) -> Metrics {
    let mut metrics = None;
    wait_for(what, || {
        metrics = Metrics::read(python, port).filter(&is);
        metrics.is_some()
    });
    metrics.unwrap()
}

fn ps_value(system: &System, service: &str, name: &str) -> f64 {
    let ps = system.ps();
    let one = ps.iter().find(|one| one["service"] == service).unwrap_or_else(|| panic!("no {service}: {ps:?}"));
    one[name].as_f64().unwrap()
}

const PATH: [&str; 5] = ["ingest", "gyro", "accel", "fuser", "course"];

#[test]
fn prometheus_metrics_match_plumb_ps() {
    let Some(python) = python() else { return };
    let (system, port) = with_cockpit("");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    system.wait_until_running();

    let before = PATH.map(|service| ps_value(&system, service, "ticks"));
    let ticks = "plumbline_service_ticks_total";
    let is_later = |metrics: &Metrics| {
        let exported = PATH.map(|service| metrics.service_value(ticks, service));
        exported.iter().zip(before).all(|(exported, before)| exported.is_some_and(|exported| exported > before))
            && metrics.service_value("plumbline_service_cpu_ratio", "gyro").is_some()
            && metrics.service_value("plumbline_service_latency_seconds", "fuser").is_some()
            && metrics.unlabelled_value("plumbline_attitude_roll_radians").is_some()
    };
    let metrics = wait_for_metrics("the metrics", python, port, is_later);
    for service in PATH {
        let now = ps_value(&system, service, "ticks");
        let exported = metrics.service_value(ticks, service).unwrap();
        assert!(exported <= now, "{service}: {exported} of {now} ticks");
        assert_eq!(metrics.service_value("plumbline_service_lost_ticks_total", service), Some(0.0), "{service}");
        assert_eq!(metrics.service_value("plumbline_service_restarts_total", service), Some(0.0), "{service}");
        assert_eq!(metrics.service_value("plumbline_service_up", service), Some(1.0), "{service}");
        let resident = metrics.service_value("plumbline_service_resident_bytes", service).unwrap();
        assert!(resident > 100_000.0, "{service}: {resident} bytes");
    }
    assert_eq!(metrics.value("plumbline_build_info", "system", &system.name), Some(1.0));
    assert_eq!(metrics.value("plumbline_build_info", "version", env!("CARGO_PKG_VERSION")), Some(1.0));
    assert_eq!(metrics.value("plumbline_connection_state", "state", "live"), Some(1.0));
    assert_eq!(metrics.value("plumbline_connection_state", "state", "ended"), Some(0.0));
    assert_eq!(metrics.service_value("plumbline_service_ticks_total", "supervisor"), None);
    let [median, most] =
        ["0.5", "1"].map(|q| metrics.value("plumbline_attitude_latency_seconds", "quantile", q).unwrap());
    assert!(median > 0.0 && median <= most, "{median} s, {most} s");
    let age_s = metrics.unlabelled_value("plumbline_attitude_age_seconds").unwrap();
    assert!(age_s > 0.0, "{age_s}");

    let dashboard = include_str!("../../deploy/grafana/plumbline.json");
    let words = dashboard.split(|letter: char| !letter.is_ascii_alphanumeric() && letter != '_');
    let queried: BTreeSet<_> = words.filter(|word| word.starts_with("plumbline_")).collect();
    let available: BTreeSet<_> = metrics.0.iter().map(|(name, _, _)| name.as_str()).collect();
    let missing: Vec<_> = queried.difference(&available).copied().collect();
    // A course with an arbitrary zero direction has no standard deviation, and unknown values are
    // omitted.
    assert_eq!(missing, ["plumbline_attitude_course_sd_radians"], "the dashboard queries missing metrics");
    assert!(queried.len() > 15, "{queried:?}");

    // After a kill, the restart is counted and the tick counters continue.
    signal(running.service("gyro"), Signal::KILL);
    let restarts = |metrics: &Metrics| metrics.service_value("plumbline_service_restarts_total", "gyro") == Some(1.0);
    let later = wait_for_metrics("the restart", python, port, restarts);
    assert_eq!(ps_value(&system, "gyro", "restarts"), 1.0);
    assert_eq!(later.service_value("plumbline_service_lost_ticks_total", "course"), Some(0.0));
    let grown = [&metrics, &later].map(|one| one.service_value(ticks, "course").unwrap());
    assert!(grown[1] > grown[0], "{grown:?}");

    running.interrupt();
    running.wait().assert_complete();
    for metrics in [metrics, later] {
        let row = row(&out, metrics.unlabelled_value("plumbline_attitude_tick").unwrap() as u64);
        let [w, x, y, z] = [row[1], row[2], row[3], row[4]];
        let pitch_rad = (2.0 * (y * z + w * x)).asin();
        let roll_rad = (2.0 * (w * y - x * z)).atan2(1.0 - 2.0 * (x * x + y * y));
        for (name, rad) in [("pitch", pitch_rad), ("roll", roll_rad)] {
            let exported = metrics.unlabelled_value(&format!("plumbline_attitude_{name}_radians")).unwrap();
            assert!((exported - rad).abs() < 1e-9, "{name}: {exported} of {rad}");
        }
    }
}
