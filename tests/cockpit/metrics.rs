//! The figures for Prometheus are those of the system.
use std::{collections::BTreeSet, path::Path, process::Command};

use super::page::{row, with_cockpit};
use crate::common::{System, python::python, signal, until};
use rustix::process::Signal;
use serde_json::Value;

/// What /metrics says: each sample with its name and labels.
struct Figures(Vec<(String, Value, f64)>);

impl Figures {
    /// `None` while nobody answers.
    fn read(python: &Path, port: u16) -> Option<Self> {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foreign/metrics.py");
        let output = Command::new(python).arg(script).arg(format!("http://127.0.0.1:{port}/metrics")).output().unwrap();
        if !output.status.success() {
            let said = String::from_utf8_lossy(&output.stderr);
            assert!(said.contains("Connection refused"), "{said}");
            return None;
        }
        let read: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(read["content_type"], "text/plain; version=0.0.4; charset=utf-8");
        let samples: Vec<(String, Value, f64)> = serde_json::from_value(read["samples"].clone()).unwrap();
        assert_eq!(read["lines"], samples.len(), "each line is a sample");
        assert_eq!((&read["unread"], &read["without_help"]), (&Value::Array(vec![]), &Value::Array(vec![])));
        let names: BTreeSet<_> = samples.iter().map(|(name, labels, _)| format!("{name}{labels}")).collect();
        assert_eq!(names.len(), samples.len(), "each is told once");
        Some(Self(samples))
    }

    fn of(&self, name: &str, label: &str, value: &str) -> Option<f64> {
        let found = self.0.iter().find(|(own, labels, _)| own == name && (label.is_empty() || labels[label] == value));
        found.map(|(_, _, figure)| *figure)
    }

    fn of_service(&self, name: &str, service: &str) -> Option<f64> {
        self.of(name, "service", service)
    }

    fn alone(&self, name: &str) -> Option<f64> {
        self.of(name, "", "")
    }
}

/// The figures, once they are such.
fn once(what: &str, python: &Path, port: u16, is: impl Fn(&Figures) -> bool) -> Figures {
    let mut figures = None;
    until(what, || {
        figures = Figures::read(python, port).filter(&is);
        figures.is_some()
    });
    figures.unwrap()
}

fn of_ps(system: &System, service: &str, name: &str) -> f64 {
    let ps = system.ps();
    let one = ps.iter().find(|one| one["service"] == service).unwrap_or_else(|| panic!("no {service}: {ps:?}"));
    one[name].as_f64().unwrap()
}

const PATH: [&str; 5] = ["ingest", "gyro", "accel", "fuser", "course"];

#[test]
fn prometheus_reads_what_plumb_ps_says() {
    let Some(python) = python() else { return };
    let (system, port) = with_cockpit("");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    system.all_run();

    let before = PATH.map(|service| of_ps(&system, service, "ticks"));
    let ticks = "plumbline_service_ticks_total";
    let is_later = |figures: &Figures| {
        let told = PATH.map(|service| figures.of_service(ticks, service));
        told.iter().zip(before).all(|(told, before)| told.is_some_and(|told| told > before))
            && figures.of_service("plumbline_service_cpu_ratio", "gyro").is_some()
            && figures.of_service("plumbline_service_latency_seconds", "fuser").is_some()
            && figures.alone("plumbline_attitude_roll_radians").is_some()
    };
    let figures = once("the figures", python, port, is_later);
    for service in PATH {
        let now = of_ps(&system, service, "ticks");
        let told = figures.of_service(ticks, service).unwrap();
        assert!(told <= now, "{service}: {told} of {now} ticks");
        assert_eq!(figures.of_service("plumbline_service_lost_ticks_total", service), Some(0.0), "{service}");
        assert_eq!(figures.of_service("plumbline_service_restarts_total", service), Some(0.0), "{service}");
        assert_eq!(figures.of_service("plumbline_service_up", service), Some(1.0), "{service}");
        let resident = figures.of_service("plumbline_service_resident_bytes", service).unwrap();
        assert!(resident > 100_000.0, "{service}: {resident} bytes");
    }
    assert_eq!(figures.of("plumbline_build_info", "system", &system.name), Some(1.0));
    assert_eq!(figures.of("plumbline_build_info", "version", env!("CARGO_PKG_VERSION")), Some(1.0));
    assert_eq!(figures.of("plumbline_connection_state", "state", "live"), Some(1.0));
    assert_eq!(figures.of("plumbline_connection_state", "state", "ended"), Some(0.0));
    assert_eq!(figures.of_service("plumbline_service_ticks_total", "supervisor"), None);
    let [median, most] = ["0.5", "1"].map(|q| figures.of("plumbline_attitude_latency_seconds", "quantile", q).unwrap());
    assert!(median > 0.0 && median <= most, "{median} s, {most} s");
    let age_s = figures.alone("plumbline_attitude_age_seconds").unwrap();
    assert!(age_s > 0.0, "{age_s}");

    let dashboard = include_str!("../../deploy/grafana/plumbline.json");
    let words = dashboard.split(|letter: char| !letter.is_ascii_alphanumeric() && letter != '_');
    let asked: BTreeSet<_> = words.filter(|word| word.starts_with("plumbline_")).collect();
    let given: BTreeSet<_> = figures.0.iter().map(|(name, _, _)| name.as_str()).collect();
    let missing: Vec<_> = asked.difference(&given).copied().collect();
    // A course that is counted from nowhere has no deviation, and what is unknown is absent.
    assert_eq!(missing, ["plumbline_attitude_course_sd_radians"], "the dashboard asks for what is not given");
    assert!(asked.len() > 15, "{asked:?}");

    // A service that is killed has been started again once, and the counts go on.
    signal(running.service("gyro"), Signal::KILL);
    let restarts = |figures: &Figures| figures.of_service("plumbline_service_restarts_total", "gyro") == Some(1.0);
    let again = once("the restart", python, port, restarts);
    assert_eq!(of_ps(&system, "gyro", "restarts"), 1.0);
    assert_eq!(again.of_service("plumbline_service_lost_ticks_total", "course"), Some(0.0));
    let grown = [&figures, &again].map(|one| one.of_service(ticks, "course").unwrap());
    assert!(grown[1] > grown[0], "{grown:?}");

    running.interrupt();
    running.wait().assert_whole();
    for figures in [figures, again] {
        let row = row(&out, figures.alone("plumbline_attitude_tick").unwrap() as u64);
        let [w, x, y, z] = [row[1], row[2], row[3], row[4]];
        let pitch_rad = (2.0 * (y * z + w * x)).asin();
        let roll_rad = (2.0 * (w * y - x * z)).atan2(1.0 - 2.0 * (x * x + y * y));
        for (name, rad) in [("pitch", pitch_rad), ("roll", roll_rad)] {
            let told = figures.alone(&format!("plumbline_attitude_{name}_radians")).unwrap();
            assert!((told - rad).abs() < 1e-9, "{name}: {told} of {rad}");
        }
    }
}
