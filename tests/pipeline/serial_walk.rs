//! The walk of the tutorial: from a bare IMU on a serial line through its calibration to a recorded flight that scores.
use std::{
    fs,
    io::{BufRead, BufReader, Read},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread,
};

use rustix::process::Signal;
use serde_json::Value;

use crate::{
    common::{Running, System, plumb, signal, until},
    pipeline::drivers::restarts,
};

/// Seconds of the unit in one of the clock.
const SPEED: &str = "4";

/// A process that ends with its owner.
struct Ended(Child);

impl Drop for Ended {
    fn drop(&mut self) {
        if matches!(self.0.try_wait(), Ok(None)) {
            signal(self.0.id(), Signal::TERM);
            let _ = self.0.wait();
        }
    }
}

/// What a hand does with the unit.
struct Moved(Ended);

impl Moved {
    fn start(port: &Path, motion: &str, more: &[&str]) -> Self {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/serial_imu.py");
        let mut command = Command::new("python3");
        Self(Ended(command.arg(script).arg(port).args([motion, "--speed", SPEED]).args(more).spawn().unwrap()))
    }
}

/// A system with these pieces of a launch file. The unit sends whether or not anybody reads, so drivers that are late must not be started again.
fn patient(pieces: &str) -> System {
    System::new(&format!("restart.silence_s = 3.0\n{pieces}"))
}

fn source(port: &Path) -> String {
    let columns = "columns=t,gx,gy,gz,ax,ay,az,mx,my,mz&units=s,deg/s,g,uT";
    format!("serial:{}?rate_hz=100&clock=device&{columns}", port.display())
}

/// The piece of a launch file, found while the unit is moved: from when it is read, so that the first pose is the first that is seen.
fn piece(system: &System, port: &Path, what: &str, motion: &str) -> String {
    let arguments = ["calibrate", what, "--live", "--for", "40s", "--json", "--system", &system.name];
    let mut calibrate = plumb(&arguments);
    let mut calibrate = Ended(calibrate.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap());
    let mut people = BufReader::new(calibrate.0.stderr.take().unwrap());
    let (mut said, mut report) = (String::new(), String::new());
    people.read_line(&mut said).unwrap();
    assert!(said.contains("from now on"), "{what}: {said}");
    let _moved = Moved::start(port, motion, &[]);
    people.read_to_string(&mut said).unwrap();
    calibrate.0.stdout.take().unwrap().read_to_string(&mut report).unwrap();
    assert_eq!(calibrate.0.wait().unwrap().code(), Some(0), "{what}: {said}");
    let report: Value = serde_json::from_str(&report).unwrap();
    println!("{report}");
    report["block"].as_str().unwrap().to_owned()
}

/// Ends a run in which nothing was lost and no driver was started again.
fn ended(running: Running) {
    running.interrupt();
    let run = running.wait();
    assert_eq!((run.code, run.number("/lost"), restarts(&run)), (Some(0), 0.0, 0), "{}", run.people);
}

/// Drives with these pieces of a launch file; the errors of the flight against the truth, degrees: heading, inclination.
fn driven(pieces: &str) -> [f64; 2] {
    let system = patient(pieces);
    let (port, truth, flights) = (system.path("imu"), system.path("truth.csv"), system.path("flights"));
    let running = system.start(&["--source", &source(&port), "--record", flights.to_str().unwrap()]);
    system.all_listen();
    let mut moved = Moved::start(&port, "drive", &["--truth", truth.to_str().unwrap()]);
    until("the end of the drive", || moved.0.0.try_wait().unwrap().is_some());
    ended(running);
    let flight: PathBuf = fs::read_dir(&flights).unwrap().next().unwrap().unwrap().path();
    let output =
        plumb(&["score", "--json", "--reference"]).arg(&truth).arg(&flight).current_dir(&flights).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let scores: Value = serde_json::from_slice(&output.stdout).unwrap();
    println!("{scores}");
    ["heading", "inclination"].map(|error| scores["stages"][0]["mean"][error].as_f64().unwrap())
}

#[test]
fn a_bare_imu_on_a_serial_line_is_calibrated_and_its_flight_scores() {
    let system = patient("");
    let port = system.path("imu");
    let running = system.start(&["--source", &source(&port)]);
    system.all_listen();
    let [gyro, accel, mag] = [("gyro", "rest"), ("accel", "sides"), ("mag", "turns")]
        .map(|(what, motion)| piece(&system, &port, what, motion));
    ended(running);
    let sensors = [gyro, accel, mag].concat();

    // How it sits is found of calibrated sensors.
    let system = patient(&sensors);
    let port = system.path("imu");
    let running = system.start(&["--source", &source(&port)]);
    system.all_listen();
    let mounting = piece(&system, &port, "mounting", "poses");
    ended(running);

    let pieces = format!("{sensors}{mounting}");
    let [raw, calibrated] = thread::scope(|scope| {
        let drives = ["", &pieces].map(|pieces| scope.spawn(move || driven(pieces)));
        drives.map(|drive| drive.join().unwrap())
    });
    println!("heading and inclination: {raw:?}° raw, {calibrated:?}° calibrated");
    assert!(raw.iter().all(|error_deg| *error_deg > 2.0), "{raw:?}");
    assert!(calibrated.iter().all(|error_deg| *error_deg < 1.5), "{calibrated:?}");
}
