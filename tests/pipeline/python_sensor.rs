//! A sensor of one's own in Python: what it sends is what ingest takes, bit for bit.
use std::{
    fs,
    io::{BufRead, BufReader},
    path::Path,
    process::{Child, Command, Stdio},
    sync::mpsc,
    thread,
};

use crate::common::{System, python::python, signal, until};
use bus::{Bus, SystemName};
use messages::{Message, ReceiverReading, SensorReading, TakenReading};
use rustix::process::Signal;
use serde_json::Value;

const FROM_THE_BUS: &str = "[ingest]\nsource = \"bus\"\nbus.rate_hz = 200\n";

/// The program that feeds a system until it is ended. Its lines are read as they come: a full pipe would hold it up.
struct Feeder {
    child: Child,
    said: mpsc::Receiver<String>,
}

impl Feeder {
    fn start(python: &Path, system: &str) -> Self {
        let here = Path::new(env!("CARGO_MANIFEST_DIR"));
        let mut command = Command::new(python);
        command.arg(here.join("tests/foreign/sensor.py")).arg(system).env("PYTHONPATH", here.join("crates/sdk/python"));
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let (tell, said) = mpsc::channel();
        thread::spawn(move || lines.map_while(Result::ok).try_for_each(|line| tell.send(line)));
        Self { child, said }
    }

    /// The next line; it ends the test where there is none.
    fn line(&self) -> String {
        self.said.recv().unwrap()
    }

    /// Ends it; what it has still said.
    fn end(mut self) -> Vec<Value> {
        drop(self.child.stdin.take());
        let lines = self.said.iter().map(|line| serde_json::from_str(&line).unwrap()).collect();
        assert!(self.child.wait().unwrap().success());
        lines
    }
}

/// A feeder that has joined the system, and what it said of that.
fn joined(python: &Path, system: &System) -> (Feeder, Value) {
    let mut begun = None;
    until("the topic", || {
        let feeder = Feeder::start(python, &system.name);
        let line = feeder.line();
        match serde_json::from_str(&line) {
            Ok(said) => begun = Some((feeder, said)),
            Err(_) => assert!(line.contains(&system.name), "{line}"),
        }
        begun.is_some()
    });
    begun.unwrap()
}

fn bits(value: &Value) -> Option<[u64; 3]> {
    let numbers: Vec<_> = value.as_array()?.iter().map(|number| number.as_u64().unwrap()).collect();
    Some(numbers.try_into().unwrap())
}

#[test]
fn what_python_sends_is_what_ingest_takes_bit_for_bit() {
    let Some(python) = python() else { return };
    let system = System::new(FROM_THE_BUS);
    let running = system.start(&["--readings"]);
    let (feeder, said) = joined(python, &system);
    assert_eq!(said["capacity"], 1200, "buffer_s is 6");
    let layouts = [SensorReading::layout(), ReceiverReading::layout()].map(|layout| layout.to_string());
    assert_eq!(said["layouts"], serde_json::json!(layouts));
    assert_eq!(said["places"], serde_json::json!([SensorReading::TOPIC.index, ReceiverReading::TOPIC.index]));
    let bus = Bus::join(&SystemName::new(&system.name).unwrap(), "test").unwrap();
    let readings = bus.subscriber::<TakenReading>(1200).unwrap();
    bus.wake_all();
    let mut taken: Vec<TakenReading> = Vec::new();
    let mut sent: Vec<Value> = Vec::new();
    until("readings", || {
        sent.push(serde_json::from_str(&feeder.line()).unwrap());
        while let Some(reading) = readings.receive().unwrap() {
            taken.push(reading);
        }
        taken.len() > 400
    });
    drop((readings, bus));
    sent.extend(feeder.end());
    let first = sent.iter().position(|one| one["t"] == taken[0].t_sensor_ns).unwrap();
    for (taken, sent) in taken.iter().zip(&sent[first..]) {
        assert_eq!(sent["t"], taken.t_sensor_ns, "none is left out");
        assert_eq!(bits(&sent["rate"]), Some(taken.rate_rad_s.map(f64::to_bits)));
        assert_eq!(bits(&sent["force"]), Some(taken.force_m_s2.map(f64::to_bits)));
        assert_eq!(bits(&sent["field"]), (taken.brings & 1 != 0).then(|| taken.field_ut.map(f64::to_bits)));
    }
    // A fix goes with the reading that ingest takes next.
    let is_with_fix = |reading: &&TakenReading| reading.brings & 2 != 0;
    let fixes: Vec<_> = taken.iter().filter(is_with_fix).map(|fix| Some(fix.velocity_m_s.map(f64::to_bits))).collect();
    let velocities: Vec<_> = sent.iter().map(|one| bits(&one["velocity"])).filter(Option::is_some).collect();
    assert!(fixes.len() > 5 && fixes.iter().all(|fix| velocities.contains(fix)), "{fixes:?} of {velocities:?}");
    let places = taken.iter().filter(is_with_fix).map(|fix| (fix.latitude_rad, fix.velocity_sd_m_s));
    assert!(places.clone().all(|place| place == (0.9, 0.3)));
    running.interrupt();
    let run = running.wait();
    assert_eq!(run.code, Some(0), "{}", run.people);
    assert_eq!(system.remains(), Vec::<String>::new());
}

#[test]
fn the_program_goes_on_when_the_system_has_begun_anew() {
    let Some(python) = python() else { return };
    let system = System::new(FROM_THE_BUS);
    let running = system.start(&[]);
    let (feeder, _) = joined(python, &system);
    let course_has = |ticks: u64| {
        until("ticks", || {
            let course = system.ps().into_iter().find(|one| one["service"] == "course");
            course.is_some_and(|course| course["ticks"].as_u64() >= Some(ticks))
        });
    };
    course_has(50);
    for name in system.remains() {
        let path = Path::new("/dev/shm").join(name);
        if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) }.unwrap();
    }
    signal(running.service("gyro"), Signal::KILL);
    course_has(300);
    running.interrupt();
    let run = running.wait();
    assert!(run.people.contains("restarting every service"), "{}", run.people);
    // Of another run of the name it joins that one, once it has left the former.
    feeder.said.try_iter().for_each(drop);
    until("the end to be noticed", || feeder.line().contains("gone"));
    let again = system.start(&[]);
    course_has(50);
    feeder.end();
    again.interrupt();
    assert_eq!(again.wait().number("/lost"), 0.0);
    assert_eq!(system.remains(), Vec::<String>::new());
}

/// A program that has fed a system until attitudes came out.
fn feeds(mut program: Command) {
    let system = System::new("[ingest]\nsource = \"bus\"\n");
    let running = system.start(&[]);
    program.arg(&system.name).stderr(Stdio::null());
    let mut child = program.spawn().unwrap();
    until("attitudes", || {
        // Before ingest has opened the topic it says so, and ends.
        if child.try_wait().unwrap().is_some() {
            child = program.spawn().unwrap();
        }
        let course = system.ps().into_iter().find(|one| one["service"] == "course");
        course.is_some_and(|course| course["ticks"].as_u64() >= Some(500))
    });
    child.kill().unwrap();
    child.wait().unwrap();
    running.interrupt();
    running.wait().assert_whole();
    assert_eq!(system.remains(), Vec::<String>::new());
}

#[test]
fn the_examples_are_sensors() {
    feeds(Command::new(crate::common::example("driver")));
    let Some(python) = python() else { return };
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut program = Command::new(python);
    program.arg(here.join("examples/sensor.py")).env("PYTHONPATH", here.join("crates/sdk/python"));
    feeds(program);
}

#[test]
fn a_system_that_takes_no_readings_is_named_with_the_remedy() {
    let Some(python) = python() else { return };
    let system = System::new("");
    assert!(Feeder::start(python, &system.name).line().contains("it does not run; start it with `plumb up`"));
    assert!(Feeder::start(python, "No Name").line().contains("use 1 to 32 of a-z"));
    let running = system.start(&[]);
    system.all_run();
    let said = Feeder::start(python, &system.name).line();
    assert!(said.contains("its topic \"sensor\" is not open; set source = \"bus\" in [ingest]"), "{said}");
    running.interrupt();
    assert_eq!(running.wait().code, Some(0));
    assert_eq!(system.remains(), Vec::<String>::new());
}
