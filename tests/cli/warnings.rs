//! What cannot be is said of the input, with the remedy to paste, and the remedy helps.
use std::{fmt::Write as _, fs};

use crate::common::{Run, System, plumb, until};
use serde_json::Value;

const GRAVITY_M_S2: f64 = 9.806_65;

/// A row of a recording, in its units.
#[derive(Clone, Copy)]
struct Row {
    t_s: f64,
    rate: [f64; 3],
    force: [f64; 3],
    field: [f64; 3],
}

/// A mistake that is made in each row.
type Change = fn(Row) -> Row;

fn in_g(row: Row) -> Row {
    Row { force: row.force.map(|x| x / GRAVITY_M_S2), ..row }
}

fn in_degrees(row: Row) -> Row {
    Row { rate: row.rate.map(f64::to_degrees), ..row }
}

/// A body that is tilted this way and that about its x axis, seen by sensors of 100 Hz.
fn rows(seconds: u32) -> impl Iterator<Item = Row> {
    (0..100 * seconds).map(|row| {
        let t_s = f64::from(row) * 0.01;
        let angle = 0.6 * (1.3 * t_s).sin();
        let (rate, (sin, cos)) = (0.6 * 1.3 * (1.3 * t_s).cos(), angle.sin_cos());
        // No axis of a real sensor stands still.
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
        let told: Vec<_> = numbers.iter().map(f64::to_string).collect();
        writeln!(text, "{t_s:.3},{}", told.join(",")).unwrap();
    }
    let path = system.path("recording.csv");
    fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

fn warnings(run: &Run) -> Vec<String> {
    run.assert_whole();
    run.json["warnings"].as_array().unwrap().iter().map(|text| text.as_str().unwrap().to_owned()).collect()
}

/// What is said of a recording, by a system with this launch file.
fn said_of(launch: &str, rows: impl Iterator<Item = Row>, how: &[&str]) -> Vec<String> {
    let system = System::new(launch);
    let file = recording(&system, rows);
    let run = system.run(&[&["--replay", &file, "--speed", "max"], how].concat());
    let said = warnings(&run);
    said.iter().for_each(|text| assert!(run.people.contains(&format!("warning: {}", &text[..20])), "{}", run.people));
    said
}

/// The first remedy that goes into a launch file.
fn remedy(said: &str) -> Option<&str> {
    said.split('`').find(|part| part.starts_with("ingest.") && part.contains('='))
}

#[test]
fn forces_in_g_are_named_by_up_and_what_is_pasted_helps() {
    for how in [&[][..], &["--in-process"]] {
        let said = said_of("", rows(20).map(in_g), how);
        assert!(said.len() == 1 && said[0].starts_with("force-unit: the force is "), "{said:?}");
        assert_eq!(said_of(remedy(&said[0]).unwrap(), rows(20).map(in_g), how), Vec::<String>::new(), "{said:?}");
    }
}

#[test]
fn each_mistake_is_named_by_up_and_what_is_pasted_helps() {
    let mistakes: [(&str, Change, &str); 6] = [
        ("rates in °/s", in_degrees, "rate-unit: "),
        ("rates divided twice", |row| Row { rate: row.rate.map(f64::to_radians), ..row }, "rate-unit: "),
        ("a negated gyro", |row| Row { rate: row.rate.map(|x| -x), ..row }, "axes-mismatch: "),
        ("a negated accelerometer", |row| Row { force: row.force.map(|x| -x), ..row }, "upside-down: "),
        ("fields in gauss", |row| Row { field: row.field.map(|x| x / 100.0), ..row }, "field-unit: "),
        ("forces in thousandths of g", |row| Row { force: in_g(row).force.map(|x| x * 1000.0), ..row }, "force-unit: "),
    ];
    for (made, change, name) in mistakes {
        let said = said_of("", rows(20).map(change), &["--in-process"]);
        assert!(said.len() == 1 && said[0].starts_with(name), "{made}: {said:?}");
        let Some(remedy) = remedy(&said[0]) else { panic!("{made}: {said:?}") };
        let after = said_of(remedy, rows(20).map(change), &["--in-process"]);
        assert_eq!(after, Vec::<String>::new(), "{made}: {remedy}");
    }
}

#[test]
fn mistakes_that_no_launch_file_mends_are_named_by_up() {
    let in_nt = |row: Row| Row { field: row.field.map(|x| x * 1000.0), ..row };
    let without_gravity = |row: Row| Row { force: row.force.map(|x| 0.02 * x), ..row };
    let of_one_axis = |row: Row| Row { rate: [row.rate[0], 0.01, row.rate[2]], ..row };
    let clipped = |row: Row| Row { rate: [row.rate[0], 4.0 * row.rate[0].clamp(-0.6, 0.6), row.rate[2]], ..row };
    let twice = rows(20).enumerate().flat_map(|(at, row)| vec![row; 1 + usize::from(at % 10 == 0)]);
    let disordered = |row: Row| Row { t_s: row.t_s - if (row.t_s * 5.0).fract() < 0.04 { 0.035 } else { 0.0 }, ..row };
    for (name, said) in [
        ("time-unit: ", said_of("", rows(20).map(|row| Row { t_s: 1000.0 * row.t_s, ..row }), &["--in-process"])),
        ("field-unit: ", said_of("", rows(20).map(in_nt), &["--in-process"])),
        ("gravity-removed: ", said_of("", rows(20).map(without_gravity), &["--in-process"])),
        ("rate-stuck: ", said_of("", rows(20).map(of_one_axis), &["--in-process"])),
        ("rate-clipped: ", said_of("", rows(20).map(clipped), &["--in-process"])),
        ("timestamps: ", said_of("", twice, &["--in-process"])),
        ("timestamps: ", said_of("", rows(20).map(disordered), &["--in-process"])),
    ] {
        assert!(said.iter().any(|text| text.starts_with(name)), "no {name} in {said:?}");
    }
}

#[test]
fn nothing_is_said_of_what_can_be() {
    assert_eq!(said_of("", rows(20), &[]), Vec::<String>::new());
    let run = System::new("").run(&["--for", "6s", "--speed", "max"]);
    assert_eq!(warnings(&run), Vec::<String>::new(), "{}", run.people);
}

/// What the doctor says of the input of a system that runs.
fn doctors_word(system: &System, seconds: &str) -> Vec<Value> {
    let output = plumb(&["doctor", "--json", "--seconds", seconds, "--system", &system.name]).output().unwrap();
    let doctor: Value = serde_json::from_slice(&output.stdout).unwrap();
    let checks = doctor["checks"].as_array().unwrap();
    checks.iter().filter(|check| check["check"] == "input").cloned().collect()
}

#[test]
fn the_doctor_of_a_running_system_names_each_mistake_with_its_remedy() {
    let system = System::new("");
    let file = recording(&system, rows(200).map(in_g).map(in_degrees));
    let running = system.start(&["--replay", &file]);
    system.all_run();
    let mut said = Vec::new();
    until("the doctor to see enough", || {
        said = doctors_word(&system, "8");
        said.len() == 2
    });
    for (check, name, remedy) in [
        (&said[0], "force-unit: ", "ingest.calibration.accel.scale"),
        (&said[1], "rate-unit: ", "ingest.calibration.gyro.scale"),
    ] {
        assert_eq!(check["result"], "warning");
        assert!(check["found"].as_str().unwrap().starts_with(name), "{check}");
        assert!(check["remedy"].as_str().unwrap().contains(remedy), "{check}");
    }
    running.interrupt();
    let run = running.wait();
    assert_eq!(warnings(&run).len(), 2, "{}", run.people);
}

#[test]
fn the_doctor_says_nothing_of_a_good_system() {
    let replayed = System::new("");
    let file = recording(&replayed, rows(200));
    let simulated = System::new("");
    let systems = [(&replayed, vec!["--replay", &file]), (&simulated, vec!["--source", "sim:s3?seed=1"])];
    let running = systems.map(|(system, arguments)| (system, system.start(&arguments)));
    for (system, running) in running {
        system.all_run();
        let said = doctors_word(system, "8");
        assert!(said.len() == 1 && said[0]["result"] == "ok", "{said:?}");
        running.interrupt();
        assert_eq!(warnings(&running.wait()), Vec::<String>::new());
    }
}
