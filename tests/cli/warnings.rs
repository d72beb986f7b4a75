//! Input warnings. Implausible input is reported with a change to the launch file, and making this
//! change removes the warning.
use std::{fmt::Write as _, fs};

use crate::common::{Run, System, plumb, wait_for};
use serde_json::Value;

const GRAVITY_M_S2: f64 = 9.806_65;

/// Row of a recording, in the units of the recording format.
#[derive(Clone, Copy)]
struct Row {
    t_s: f64,
    rate: [f64; 3],
    force: [f64; 3],
    field: [f64; 3],
}

/// Mistake applied to each row.
type Change = fn(Row) -> Row;

fn with_force_in_g(row: Row) -> Row {
    Row { force: row.force.map(|x| x / GRAVITY_M_S2), ..row }
}

fn with_rate_in_degrees(row: Row) -> Row {
    Row { rate: row.rate.map(f64::to_degrees), ..row }
}

/// Returns samples at 100 Hz from a body that rocks about its x axis.
fn rows(seconds: u32) -> impl Iterator<Item = Row> {
    (0..100 * seconds).map(|row| {
        let t_s = f64::from(row) * 0.01;
        let angle = 0.6 * (1.3 * t_s).sin();
        let (rate, (sin, cos)) = (0.6 * 1.3 * (1.3 * t_s).cos(), angle.sin_cos());
        // A real sensor has noise on every axis.
        let [p, q, r] = [31.0, 37.0, 41.0].map(|rad_s| 1e-3 * (rad_s * t_s).sin());
        Row {
            t_s,
            rate: [rate, p, q],
            force: [r, sin * 9.81, cos * 9.81],
            field: [p, 20.0 * cos - 44.0 * sin, -20.0 * sin - 44.0 * cos],
        }
    })
}

fn recording(system: &System, rows: impl Iterator<Item = Row>) -> String {
    let mut text = String::from("t_s,gx,gy,gz,ax,ay,az,mx,my,mz\n");
    for Row { t_s, rate, force, field } in rows {
        let numbers = [rate, force, field].concat();
        let values: Vec<_> = numbers.iter().map(f64::to_string).collect();
        writeln!(text, "{t_s:.3},{}", values.join(",")).unwrap();
    }
    let path = system.path("recording.csv");
    fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

fn warnings(run: &Run) -> Vec<String> {
    run.assert_complete();
    run.json["warnings"].as_array().unwrap().iter().map(|text| text.as_str().unwrap().to_owned()).collect()
}

/// Returns the warnings from a replay of these rows with this launch file.
fn warnings_for(launch: &str, rows: impl Iterator<Item = Row>, arguments: &[&str]) -> Vec<String> {
    let system = System::new(launch);
    let file = recording(&system, rows);
    let run = system.run(&[&["--replay", &file, "--speed", "max"], arguments].concat());
    let messages = warnings(&run);
    messages
        .iter()
        .for_each(|text| assert!(run.stderr.contains(&format!("warning: {}", &text[..20])), "{}", run.stderr));
    messages
}

/// Returns the first setting of a launch-file key that a warning suggests.
fn remedy(warning: &str) -> Option<&str> {
    warning.split('`').find(|part| part.starts_with("ingest.") && part.contains('='))
}

#[test]
fn forces_in_g_are_reported_and_remedy_works() {
    for arguments in [&[][..], &["--in-process"]] {
        let messages = warnings_for("", rows(20).map(with_force_in_g), arguments);
        assert!(messages.len() == 1 && messages[0].starts_with("force-unit: the force is "), "{messages:?}");
        assert_eq!(
            warnings_for(remedy(&messages[0]).unwrap(), rows(20).map(with_force_in_g), arguments),
            Vec::<String>::new(),
            "{messages:?}"
        );
    }
}

#[test]
fn input_mistakes_are_reported_and_remedies_work() {
    let mistakes: [(&str, Change, &str); 6] = [
        ("rates in °/s", with_rate_in_degrees, "rate-unit: "),
        ("rates divided twice", |row| Row { rate: row.rate.map(f64::to_radians), ..row }, "rate-unit: "),
        ("a negated gyro", |row| Row { rate: row.rate.map(|x| -x), ..row }, "axes-mismatch: "),
        ("a negated accelerometer", |row| Row { force: row.force.map(|x| -x), ..row }, "upside-down: "),
        ("fields in gauss", |row| Row { field: row.field.map(|x| x / 100.0), ..row }, "field-unit: "),
        (
            "forces in thousandths of g",
            |row| Row { force: with_force_in_g(row).force.map(|x| x * 1000.0), ..row },
            "force-unit: ",
        ),
    ];
    for (label, change, name) in mistakes {
        let messages = warnings_for("", rows(20).map(change), &["--in-process"]);
        assert!(messages.len() == 1 && messages[0].starts_with(name), "{label}: {messages:?}");
        let Some(remedy) = remedy(&messages[0]) else { panic!("{label}: {messages:?}") };
        let after = warnings_for(remedy, rows(20).map(change), &["--in-process"]);
        assert_eq!(after, Vec::<String>::new(), "{label}: {remedy}");
    }
}

#[test]
fn mistakes_without_launch_remedy_are_reported() {
    let in_nt = |row: Row| Row { field: row.field.map(|x| x * 1000.0), ..row };
    let without_gravity = |row: Row| Row { force: row.force.map(|x| 0.02 * x), ..row };
    let of_one_axis = |row: Row| Row { rate: [row.rate[0], 0.01, row.rate[2]], ..row };
    let clipped = |row: Row| Row { rate: [row.rate[0], 4.0 * row.rate[0].clamp(-0.6, 0.6), row.rate[2]], ..row };
    let twice = rows(20).enumerate().flat_map(|(index, row)| vec![row; 1 + usize::from(index % 10 == 0)]);
    let disordered = |row: Row| Row { t_s: row.t_s - if (row.t_s * 5.0).fract() < 0.04 { 0.035 } else { 0.0 }, ..row };
    for (name, messages) in [
        ("time-unit: ", warnings_for("", rows(20).map(|row| Row { t_s: 1000.0 * row.t_s, ..row }), &["--in-process"])),
        ("field-unit: ", warnings_for("", rows(20).map(in_nt), &["--in-process"])),
        ("gravity-removed: ", warnings_for("", rows(20).map(without_gravity), &["--in-process"])),
        ("rate-stuck: ", warnings_for("", rows(20).map(of_one_axis), &["--in-process"])),
        ("rate-clipped: ", warnings_for("", rows(20).map(clipped), &["--in-process"])),
        ("timestamps: ", warnings_for("", twice, &["--in-process"])),
        ("timestamps: ", warnings_for("", rows(20).map(disordered), &["--in-process"])),
    ] {
        assert!(messages.iter().any(|text| text.starts_with(name)), "no {name} in {messages:?}");
    }
}

#[test]
fn plausible_input_yields_no_warning() {
    assert_eq!(warnings_for("", rows(20), &[]), Vec::<String>::new());
    let run = System::new("").run(&["--for", "6s", "--speed", "max"]);
    assert_eq!(warnings(&run), Vec::<String>::new(), "{}", run.stderr);
}

/// Returns the doctor's input checks for a running system.
fn doctor_input_checks(system: &System, seconds: &str) -> Vec<Value> {
    let output = plumb(&["doctor", "--json", "--for", seconds, "--system", &system.name]).output().unwrap();
    let doctor: Value = serde_json::from_slice(&output.stdout).unwrap();
    let checks = doctor["checks"].as_array().unwrap();
    checks.iter().filter(|check| check["check"] == "input").cloned().collect()
}

#[test]
fn doctor_reports_input_mistakes_with_remedies() {
    let system = System::new("");
    let file = recording(&system, rows(200).map(with_force_in_g).map(with_rate_in_degrees));
    let running = system.start(&["--replay", &file]);
    system.wait_until_running();
    let mut messages = Vec::new();
    wait_for("the doctor's warnings", || {
        messages = doctor_input_checks(&system, "8");
        messages.len() == 2
    });
    for (check, name, remedy) in [
        (&messages[0], "force-unit: ", "ingest.calibration.accel.scale"),
        (&messages[1], "rate-unit: ", "ingest.calibration.gyro.scale"),
    ] {
        assert_eq!(check["result"], "warning");
        assert!(check["found"].as_str().unwrap().starts_with(name), "{check}");
        assert!(check["remedy"].as_str().unwrap().contains(remedy), "{check}");
    }
    running.interrupt();
    let run = running.wait();
    assert_eq!(warnings(&run).len(), 2, "{}", run.stderr);

    let remedies: Vec<_> = messages.iter().map(|check| remedy(check["remedy"].as_str().unwrap()).unwrap()).collect();
    let corrected = System::new(&remedies.join("\n"));
    let running = corrected.start(&["--replay", &file]);
    corrected.wait_until_running();
    let messages = doctor_input_checks(&corrected, "8");
    assert!(messages.len() == 1 && messages[0]["result"] == "ok", "{remedies:?}: {messages:?}");
    running.interrupt();
    assert_eq!(warnings(&running.wait()), Vec::<String>::new());
}

#[test]
pub(super) fn doctor_remedy_for_force_in_g_at_rest_works() {
    let noise = |row: u32| 1e-4 * f64::from(row % 7);
    let rows: String = (0..20_000u32)
        .map(|row| {
            format!(
                "{}.{:02},{noise},{noise},0,0,{noise},{}\n",
                row / 100,
                row % 100,
                1.0 + noise(row),
                noise = noise(row)
            )
        })
        .collect();
    let gravity_check = |launch: &str| {
        let system = System::new(launch);
        let file = system.path("rest.csv");
        fs::write(&file, format!("t_s,gx,gy,gz,ax,ay,az\n{rows}")).unwrap();
        let running = system.start(&["--replay", file.to_str().unwrap()]);
        system.wait_until_running();
        let mut check = Value::Null;
        wait_for("a body at rest", || {
            let output = plumb(&["doctor", "--json", "--for", "2", "--system", &system.name]).output().unwrap();
            let doctor: Value = serde_json::from_slice(&output.stdout).unwrap();
            let checks = doctor["checks"].as_array().unwrap();
            check = checks.iter().find(|check| check["check"] == "gravity").cloned().unwrap_or_default();
            check["found"].as_str().is_some_and(|found| found.starts_with("mean |f|"))
        });
        running.interrupt();
        running.wait().assert_complete();
        check
    };
    let check = gravity_check("");
    assert_eq!(check["result"], "problem", "{check}");
    let check = gravity_check(remedy(check["remedy"].as_str().unwrap()).unwrap());
    assert_eq!(check["result"], "ok", "{check}");
}

#[test]
fn doctor_accepts_plausible_input() {
    let replayed = System::new("");
    let file = recording(&replayed, rows(200));
    let simulated = System::new("");
    let systems = [(&replayed, vec!["--replay", &file]), (&simulated, vec!["--source", "sim:s3?seed=1"])];
    let running = systems.map(|(system, arguments)| (system, system.start(&arguments)));
    for (system, running) in running {
        system.wait_until_running();
        let messages = doctor_input_checks(system, "8");
        assert!(messages.len() == 1 && messages[0]["result"] == "ok", "{messages:?}");
        running.interrupt();
        assert_eq!(warnings(&running.wait()), Vec::<String>::new());
    }
}
