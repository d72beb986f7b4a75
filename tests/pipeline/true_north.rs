//! True north: the conversion of a magnetic course gives the same result in every process, after a
//! restart and on any day.
use std::{
    fs,
    io::{BufRead, BufReader, Write},
    net::TcpListener,
    path::{Path, PathBuf},
    process::Stdio,
    sync::mpsc,
    thread::{self, sleep},
    time::Duration,
};

use crate::common::{System, data, signal, wait_for};
use rustix::process::Signal;
use serde_json::Value;

const POSITION: &str = "position = { latitude_deg = 80, longitude_deg = 0 }";

fn launch(course: &str) -> String {
    format!("[course]\n{course}\n")
}

/// Returns the course and its reference in each line.
fn courses(path: &Path) -> Vec<(f64, String)> {
    let text = fs::read_to_string(path).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("t_s,qw,qx,qy,qz,course_rad,course_reference"));
    let course = |line: &str| {
        let fields: Vec<_> = line.split(',').collect();
        (fields[5].parse().unwrap(), fields[6].to_owned())
    };
    lines.map(course).collect()
}

/// Runs a launch file and returns the system with the path of its output.
fn run_output(launch: &str, arguments: &[&str]) -> (System, PathBuf) {
    let system = System::new(launch);
    let out = system.path("out.csv");
    let run = system.run(&[arguments, &["--out", out.to_str().unwrap(), "--columns", "course"]].concat());
    run.assert_complete();
    (system, out)
}

#[test]
fn magnetic_course_is_corrected_by_local_declination() {
    let arguments = ["--source", "sim:s3?seed=3", "--for", "15s", "--speed", "max"];
    let (_magnetic, magnetic) = run_output("", &arguments);
    let north = launch(&format!("north = \"true\"\ndate = 2025-01-01\n{POSITION}"));
    let (_true, true_) = run_output(&north, &arguments);
    let (_alone, alone) = run_output(&north, &[&arguments[..], &["--in-process"]].concat());
    assert!(fs::read(&true_).unwrap() == fs::read(alone).unwrap(), "one process and five differ");
    let pairs: Vec<_> = courses(&magnetic).into_iter().zip(courses(&true_)).collect();
    assert!(pairs.iter().filter(|((_, reference), _)| reference == "magnetic").count() > 10_000);
    for ((course_rad, reference), (true_rad, found_reference)) in pairs {
        let rotation_deg = (true_rad - course_rad).to_degrees().rem_euclid(360.0);
        let (expected_deg, expected) = if reference == "magnetic" { (1.28, "true") } else { (0.0, &*reference) };
        assert_eq!(found_reference, expected);
        assert!((rotation_deg - expected_deg).abs() < 0.01, "{rotation_deg}");
    }
}

#[recorded::test]
fn declination_follows_newest_fix_and_survives_restart() {
    let Some(data) = data() else { return };
    let file = data.join("flights/apm_plane_log2_imu.csv.gz");
    let arguments = ["--replay", file.to_str().unwrap(), "--for", "200s", "--speed"];
    let (_magnetic, magnetic) = run_output("", &[&arguments[..], &["max", "--in-process"]].concat());
    // The position in the launch file is on the other side of the earth, but fixes take precedence
    // over it.
    let north = launch(&format!("north = \"true\"\ndate = 2026-06-01\n{POSITION}"));
    let (_alone, alone) = run_output(&north, &[&arguments[..], &["max", "--in-process"]].concat());
    let system = System::new(&north);
    let out = system.path("out.csv");
    let to = ["40", "--out", out.to_str().unwrap(), "--columns", "course"];
    let running = system.start(&[&arguments[..], &to[..]].concat());
    wait_for("the first 5000 ticks", || {
        let course = system.ps().into_iter().find(|entry| entry["service"] == "course");
        course.is_some_and(|course| course["ticks"].as_u64() > Some(5000))
    });
    signal(running.service("course"), Signal::KILL);
    let run = running.wait();
    run.assert_complete();
    let restarts = run.json["services"].as_array().unwrap().iter().find(|entry| entry["name"] == "course").unwrap();
    assert_eq!(restarts["restarts"], 1);
    assert!(fs::read(out).unwrap() == fs::read(&alone).unwrap(), "the bytes differ");
    let (magnetic, true_) = (courses(&magnetic), courses(&alone));
    let last = magnetic.iter().zip(&true_).rev().find(|((_, reference), _)| reference == "magnetic").unwrap();
    let rotation_deg = (last.1.0 - last.0.0).to_degrees().rem_euclid(360.0);
    // At 37.96° S, 144.76° E, the declination is 11.91° east according to another implementation of
    // the model.
    assert!((rotation_deg - 11.91).abs() < 0.01 && last.1.1 == "true", "{rotation_deg}");
}

#[test]
fn replayed_live_flight_uses_its_recorded_date() {
    let source = "[ingest]\nsource = \"bus\"\nbus.rate_hz = 100\n";
    let system = System::new(&format!("{source}{}", launch("north = \"true\"")));
    let (out, flights) = (system.path("out.csv"), system.path("flights"));
    let to = ["--out", out.to_str().unwrap(), "--columns", "course", "--record", flights.to_str().unwrap()];
    let running = system.start(&to);
    let mut opened = None;
    wait_for("the topics", || {
        opened = driver::Sensor::open(&system.name).ok().zip(driver::Receiver::open(&system.name).ok());
        opened.is_some()
    });
    let (mut sensor, mut receiver) = opened.unwrap();
    let mut t = 0;
    wait_for("ticks", || {
        t += 1;
        if t % 100 == 0 {
            let metadata = driver::FixMetadata {
                latitude_rad: Some(0.9),
                longitude_rad: Some(-1.2),
                ..driver::FixMetadata::default()
            };
            receiver.send([0.0; 3], metadata).unwrap();
        }
        let rate_rad_s = [0.001 * f64::from(t % 7), 0.0, 0.1];
        sensor.send(i64::from(t) * 10_000_000, rate_rad_s, [0.0, 0.01, 9.8], Some([0.0, 20.0, -40.0])).unwrap();
        sleep(Duration::from_millis(2));
        let course = system.ps().into_iter().find(|entry| entry["service"] == "course");
        course.is_some_and(|course| course["ticks"].as_u64() >= Some(300))
    });
    running.interrupt();
    running.wait().assert_complete();
    let flight = fs::read_dir(flights).unwrap().next().unwrap().unwrap().path();
    let replayed = system.path("replayed.csv");
    let replay =
        ["up", "--replay", flight.to_str().unwrap(), "--out", replayed.to_str().unwrap(), "--columns", "course"];
    let output = crate::common::plumb(&[&replay[..], &["--speed", "max"]].concat())
        .current_dir(system.folder.path().join(".."))
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(fs::read(&replayed).unwrap() == fs::read(&out).unwrap(), "the bytes differ");
    let courses = courses(&replayed);
    assert!(courses.iter().any(|(_, reference)| reference == "magnetic"), "no magnetic course before the first fix");
    assert_eq!(courses.last().unwrap().1, "true");
}

/// Returns an NMEA sentence for 48.1° N, 11.5° E, with its checksum.
fn recommended_minimum() -> String {
    let text = "GPRMC,101010.00,A,4806.00000,N,01130.00000,E,0.02,0.0,010626,,,A";
    format!("${text}*{:02X}\r\n", text.bytes().fold(0, |sum, byte| sum ^ byte))
}

#[test]
fn receiver_provides_position_for_declination() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let receiver = format!("receiver = {{ endpoint = \"tcp:{}\", format = \"nmea\" }}", listener.local_addr().unwrap());
    let source = format!("[ingest]\nsource = \"bus\"\nbus.rate_hz = 100\n{receiver}\n");
    let system = System::new(&format!("{source}{}", launch("north = \"true\"\ndate = 2026-06-01")));
    let running = system.start(&[]);
    let (mut line, _) = listener.accept().unwrap();
    let mut sensor = None;
    wait_for("the topic", || {
        sensor = driver::Sensor::open(&system.name).ok();
        sensor.is_some()
    });
    let mut sensor = sensor.unwrap();
    let mut echo = crate::common::plumb(&["topic", "echo", "attitude", "--json", "--system", &system.name])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let found_reference = BufReader::new(echo.stdout.take().unwrap());
    let (sender, attitudes) = mpsc::channel();
    thread::spawn(move || found_reference.lines().map_while(Result::ok).try_for_each(|line| sender.send(line)));
    let (mut t, mut last) = (0, Value::Null);
    wait_for("a true course", || {
        t += 1;
        if t % 20 == 0 {
            line.write_all(recommended_minimum().as_bytes()).unwrap();
        }
        let rate_rad_s = [0.001 * f64::from(t % 7), 0.0, 0.1];
        sensor.send(i64::from(t) * 10_000_000, rate_rad_s, [0.0, 0.01, 9.8], Some([0.0, 20.0, -40.0])).unwrap();
        last = attitudes.try_iter().last().map_or(Value::Null, |line| serde_json::from_str(&line).unwrap());
        last["course_reference"] == "true"
    });
    echo.kill().unwrap();
    echo.wait().unwrap();
    // The declination is 4.30° east according to another implementation of the model.
    let declination_deg = last["declination_rad"].as_f64().unwrap().to_degrees();
    assert!((declination_deg - 4.30).abs() < 0.01, "{declination_deg}");
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn repeatable_source_without_date_is_rejected() {
    let run = System::new(&launch("north = \"true\"")).run(&["--for", "1s"]);
    assert_eq!(run.code, Some(3), "{}", run.stderr);
    assert!(run.stderr.contains("set its date in [course]"), "{}", run.stderr);
}
