//! User-defined sensors in Python. Their readings must reach ingest bit for bit.
use std::{
    fs,
    io::{BufRead, BufReader},
    path::Path,
    process::{Child, Command, Stdio},
    sync::mpsc,
    thread,
};

use crate::common::{System, python::python, signal, wait_for};
use bus::{Bus, SystemName};
use messages::{Message, ReceiverReading, SensorReading, TakenReading};
use rustix::process::Signal;
use serde_json::Value;

const FROM_THE_BUS: &str = "[ingest]\nsource = \"bus\"\nbus.rate_hz = 200\n";

/// Program that publishes to a system until its standard input is closed. A thread reads the
/// program's output, so that a full pipe does not block the program.
struct Feeder {
    child: Child,
    lines: mpsc::Receiver<String>,
}

impl Feeder {
    fn start(python: &Path, system: &str) -> Self {
        let here = Path::new(env!("CARGO_MANIFEST_DIR"));
        let mut command = Command::new(python);
        command.arg(here.join("tests/foreign/sensor.py")).arg(system).env("PYTHONPATH", here.join("crates/sdk/python"));
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let stdout_lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let (sender, receiver) = mpsc::channel();
        thread::spawn(move || stdout_lines.map_while(Result::ok).try_for_each(|line| sender.send(line)));
        Self { child, lines: receiver }
    }

    /// Returns the next line of output.
    fn line(&self) -> String {
        self.lines.recv().unwrap()
    }

    /// Stops the program and returns the rest of its output.
    fn stop(mut self) -> Vec<Value> {
        drop(self.child.stdin.take());
        let lines = self.lines.iter().map(|line| serde_json::from_str(&line).unwrap()).collect();
        assert!(self.child.wait().unwrap().success());
        lines
    }
}

/// Starts a feeder that joins the system, and returns it with its first line of output.
fn join(python: &Path, system: &System) -> (Feeder, Value) {
    let mut joined = None;
    wait_for("the topic", || {
        let feeder = Feeder::start(python, &system.name);
        let line = feeder.line();
        match serde_json::from_str(&line) {
            Ok(start) => joined = Some((feeder, start)),
            Err(_) => assert!(line.contains(&system.name), "{line}"),
        }
        joined.is_some()
    });
    joined.unwrap()
}

fn bits(value: &Value) -> Option<[u64; 3]> {
    let numbers: Vec<_> = value.as_array()?.iter().map(|number| number.as_u64().unwrap()).collect();
    Some(numbers.try_into().unwrap())
}

#[test]
fn python_readings_reach_ingest_bit_for_bit() {
    let Some(python) = python() else { return };
    let system = System::new(FROM_THE_BUS);
    let running = system.start(&["--readings"]);
    let (feeder, start) = join(python, &system);
    assert_eq!(start["capacity"], 1200, "buffer_s is 6");
    let layouts = [SensorReading::layout(), ReceiverReading::layout()].map(|layout| layout.to_string());
    assert_eq!(start["layouts"], serde_json::json!(layouts));
    assert_eq!(start["topic_indices"], serde_json::json!([SensorReading::TOPIC.index, ReceiverReading::TOPIC.index]));
    let bus = Bus::join(&SystemName::new(&system.name).unwrap(), "test").unwrap();
    let readings = bus.subscriber::<TakenReading>(1200).unwrap();
    bus.wake_all();
    let mut received: Vec<TakenReading> = Vec::new();
    let mut sent: Vec<Value> = Vec::new();
    wait_for("readings", || {
        sent.push(serde_json::from_str(&feeder.line()).unwrap());
        while let Some(reading) = readings.receive().unwrap() {
            received.push(reading);
        }
        received.len() > 400
    });
    drop((readings, bus));
    sent.extend(feeder.stop());
    let first = sent.iter().position(|entry| entry["t"] == received[0].t_sensor_ns).unwrap();
    for (received, sent) in received.iter().zip(&sent[first..]) {
        assert_eq!(sent["t"], received.t_sensor_ns, "a reading is missing");
        assert_eq!(bits(&sent["rate"]), Some(received.rate_rad_s.map(f64::to_bits)));
        assert_eq!(bits(&sent["force"]), Some(received.force_m_s2.map(f64::to_bits)));
        assert_eq!(bits(&sent["field"]), (received.present & 1 != 0).then(|| received.field_ut.map(f64::to_bits)));
    }
    // Ingest combines a fix with the next reading.
    let is_with_fix = |reading: &&TakenReading| reading.present & 2 != 0;
    let fixes: Vec<_> =
        received.iter().filter(is_with_fix).map(|fix| Some(fix.velocity_m_s.map(f64::to_bits))).collect();
    let velocities: Vec<_> = sent.iter().map(|entry| bits(&entry["velocity"])).filter(Option::is_some).collect();
    assert!(fixes.len() > 5 && fixes.iter().all(|fix| velocities.contains(fix)), "{fixes:?} of {velocities:?}");
    let places = received.iter().filter(is_with_fix).map(|fix| (fix.latitude_rad, fix.velocity_sd_m_s));
    assert!(places.clone().all(|place| place == (0.9, 0.3)));
    running.interrupt();
    let run = running.wait();
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn python_sensor_follows_restarted_system() {
    let Some(python) = python() else { return };
    let system = System::new(FROM_THE_BUS);
    let running = system.start(&[]);
    let (feeder, _) = join(python, &system);
    let course_has = |ticks: u64| {
        wait_for("ticks", || {
            let course = system.ps().into_iter().find(|entry| entry["service"] == "course");
            course.is_some_and(|course| course["ticks"].as_u64() >= Some(ticks))
        });
    };
    course_has(50);
    for name in system.leftovers() {
        let path = Path::new("/dev/shm").join(name);
        if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) }.unwrap();
    }
    signal(running.service("gyro"), Signal::KILL);
    course_has(300);
    running.interrupt();
    let run = running.wait();
    assert!(run.stderr.contains("restarting every service"), "{}", run.stderr);
    // The feeder detaches from the ended run, then joins the next run of the same name.
    feeder.lines.try_iter().for_each(drop);
    wait_for("the end to be noticed", || feeder.line().contains("gone"));
    let again = system.start(&[]);
    course_has(50);
    feeder.stop();
    again.interrupt();
    assert_eq!(again.wait().number("/lost"), 0.0);
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

/// Runs a program as the sensor of a system until attitudes are published.
fn assert_feeds_system(mut program: Command) {
    let system = System::new("[ingest]\nsource = \"bus\"\n");
    let running = system.start(&[]);
    program.arg(&system.name).stderr(Stdio::null());
    let mut child = program.spawn().unwrap();
    wait_for("attitudes", || {
        // The program exits if ingest has not yet opened the topic.
        if child.try_wait().unwrap().is_some() {
            child = program.spawn().unwrap();
        }
        let course = system.ps().into_iter().find(|entry| entry["service"] == "course");
        course.is_some_and(|course| course["ticks"].as_u64() >= Some(500))
    });
    child.kill().unwrap();
    child.wait().unwrap();
    running.interrupt();
    running.wait().assert_complete();
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn example_sensors_feed_a_system() {
    assert_feeds_system(Command::new(crate::common::example("driver")));
    let Some(python) = python() else { return };
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut program = Command::new(python);
    program.arg(here.join("examples/sensor.py")).env("PYTHONPATH", here.join("crates/sdk/python"));
    assert_feeds_system(program);
}

#[test]
fn unavailable_system_is_reported_with_remedy() {
    let Some(python) = python() else { return };
    let system = System::new("");
    assert!(Feeder::start(python, &system.name).line().contains("it is not running; start it with `plumb up`"));
    assert!(Feeder::start(python, "No Name").line().contains("use 1 to 32 characters of a-z"));
    let running = system.start(&[]);
    system.wait_until_running();
    let message = Feeder::start(python, &system.name).line();
    assert!(message.contains("its topic \"sensor\" is not open; set source = \"bus\" in [ingest]"), "{message}");
    running.interrupt();
    assert_eq!(running.wait().code, Some(0));
    assert_eq!(system.leftovers(), Vec::<String>::new());
}
