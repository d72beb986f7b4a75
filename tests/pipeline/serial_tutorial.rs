//! Steps of the serial-port tutorial: a bare IMU is calibrated, and its recorded flight is scored.
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
    common::{Running, System, plumb, signal, wait_for, walk::Walk},
    pipeline::drivers::restarts,
};

/// Number of simulated seconds per second of real time.
const SPEED: &str = "4";

/// Process that is terminated on drop.
struct TerminatedProcess(Child);

impl Drop for TerminatedProcess {
    fn drop(&mut self) {
        if matches!(self.0.try_wait(), Ok(None)) {
            signal(self.0.id(), Signal::TERM);
            let _ = self.0.wait();
        }
    }
}

/// Simulated sensor unit that moves as specified.
struct MovingUnit(TerminatedProcess);

impl MovingUnit {
    fn start(port: &Path, motion: &str, more: &[&str]) -> Self {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/serial_imu.py");
        let mut command = Command::new("python3");
        Self(TerminatedProcess(
            command.arg(script).arg(port).args([motion, "--speed", SPEED]).args(more).spawn().unwrap(),
        ))
    }
}

/// Returns a system with additional launch settings.
///
/// The simulated unit keeps sending while no process reads its data, so a restart of the drivers
/// process would lose readings. The silence limit of 3 s prevents the restart of a process that is
/// merely late.
fn system_with(settings: &str) -> System {
    System::new(&format!("restart.silence_s = 3.0\n{settings}"))
}

fn source(port: &Path) -> String {
    let columns = "columns=t,gx,gy,gz,ax,ay,az,mx,my,mz&units=s,deg/s,g,uT";
    format!("serial:{}?rate_hz=100&clock=device&{columns}", port.display())
}

/// Order in which a motion and `plumb calibrate` start.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Motion {
    First,
    Second,
}

/// Runs `plumb calibrate` while the unit moves and returns the block for the launch file.
fn calibrate(system: &System, port: &Path, kind: &str, motion: &str, order: Motion) -> String {
    let first = (order == Motion::First).then(|| {
        let unit = MovingUnit::start(port, motion, &[]);
        wait_for("the readings of the unit", || {
            system.ps().iter().any(|service| service["service"] == "drivers" && service["state"] == "running")
        });
        unit
    });
    let launch = system.path("launch.toml");
    let mut command = plumb(&["calibrate", kind, "--live", "--for", "40s", "--json", "--launch"]);
    command.arg(launch);
    let mut process = TerminatedProcess(command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap());
    let mut stderr = BufReader::new(process.0.stderr.take().unwrap());
    let (mut text, mut report) = (String::new(), String::new());
    stderr.read_line(&mut text).unwrap();
    assert!(text.contains("reading sensors of"), "{kind}: {text}");
    let _unit = first.unwrap_or_else(|| MovingUnit::start(port, motion, &[]));
    stderr.read_to_string(&mut text).unwrap();
    process.0.stdout.take().unwrap().read_to_string(&mut report).unwrap();
    assert_eq!(process.0.wait().unwrap().code(), Some(0), "{kind}: {text}");
    let report: Value = serde_json::from_str(&report).unwrap();
    println!("{report}");
    report["block"].as_str().unwrap().to_owned()
}

/// Returns the rotation angle of a mounting, degrees.
fn mounting_deg(block: &str) -> f64 {
    let w = block.split_once('[').and_then(|(_, rest)| rest.split_once("= [")).unwrap().1;
    2.0 * w.split(',').next().unwrap().trim().parse::<f64>().unwrap().acos().to_degrees()
}

/// Stops a run and asserts that nothing was lost and the drivers were not restarted.
fn stop(running: Running) {
    running.interrupt();
    let run = running.wait();
    assert_eq!((run.code, run.number("/lost"), restarts(&run)), (Some(0), 0.0, 0), "{}", run.stderr);
}

/// Records a drive with additional launch settings. Returns the heading and inclination errors,
/// degrees.
fn drive(settings: &str) -> [f64; 2] {
    let system = system_with(settings);
    let (port, truth, flights) = (system.path("imu"), system.path("truth.csv"), system.path("flights"));
    let running = system.start(&["--source", &source(&port), "--record", flights.to_str().unwrap()]);
    system.wait_until_ready();
    let mut unit = MovingUnit::start(&port, "drive", &["--truth", truth.to_str().unwrap()]);
    wait_for("the drive to end", || unit.0.0.try_wait().unwrap().is_some());
    stop(running);
    let flight: PathBuf = fs::read_dir(&flights).unwrap().next().unwrap().unwrap().path();
    let output =
        plumb(&["score", "--json", "--reference"]).arg(&truth).arg(&flight).current_dir(&flights).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let scores: Value = serde_json::from_slice(&output.stdout).unwrap();
    println!("{scores}");
    ["heading", "inclination"].map(|error| scores["stages"][0]["mean"][error].as_f64().unwrap())
}

#[test]
fn bare_serial_imu_is_calibrated_and_its_flight_scored() {
    let mut walk = Walk::start("maker");
    let system = system_with("");
    let port = system.path("imu");
    let running = system.start(&["--source", &source(&port)]);
    system.wait_until_ready();
    walk.step("start a system with a serial unit");
    let motions =
        [("gyro", "rest", Motion::First), ("accel", "sides", Motion::Second), ("mag", "turns", Motion::First)];
    let [gyro, accel, mag] = motions.map(|(kind, motion, order)| {
        let block = calibrate(&system, &port, kind, motion, order);
        walk.step(&format!("calibrate {kind}"));
        block
    });
    stop(running);
    let sensors = [gyro, accel, mag].concat();

    // The mounting is estimated with calibrated sensors.
    let system = system_with(&sensors);
    let port = system.path("imu");
    let running = system.start(&["--source", &source(&port)]);
    system.wait_until_ready();
    let [mounting, again] = [Motion::Second, Motion::First].map(|order| {
        let block = calibrate(&system, &port, "mounting", "poses", order);
        walk.step(&format!("determine the mounting, motion {order:?}"));
        block
    });
    let angle_deg = |block: &str| mounting_deg(block) - mounting_deg(&mounting);
    assert!(angle_deg(&again).abs() < 0.5, "{mounting}{again}");
    stop(running);

    let settings = format!("{sensors}{mounting}");
    let [raw, calibrated] = thread::scope(|scope| {
        let threads = ["", &settings].map(|settings| scope.spawn(move || drive(settings)));
        threads.map(|thread| thread.join().unwrap())
    });
    walk.step("record and score a drive, with and without the calibration");
    println!("heading and inclination: {raw:?}° raw, {calibrated:?}° calibrated");
    assert!(raw.iter().all(|error_deg| *error_deg > 2.0), "{raw:?}");
    assert!(calibrated.iter().all(|error_deg| *error_deg < 1.5), "{calibrated:?}");
}
