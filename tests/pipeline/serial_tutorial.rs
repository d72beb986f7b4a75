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
    common::{Running, System, plumb, signal, wait_for},
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

/// Simulated unit that moves as specified.
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

/// Runs `plumb calibrate` while the unit moves and returns the block for the launch file.
///
/// The motion starts once the calibration has begun to read, so that the first pose is observed
/// completely.
fn calibrate(system: &System, port: &Path, kind: &str, motion: &str) -> String {
    let arguments = ["calibrate", kind, "--live", "--for", "40s", "--json", "--system", &system.name];
    let mut command = plumb(&arguments);
    let mut process = TerminatedProcess(command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap());
    let mut stderr = BufReader::new(process.0.stderr.take().unwrap());
    let (mut text, mut report) = (String::new(), String::new());
    stderr.read_line(&mut text).unwrap();
    assert!(text.contains("reading sensors of"), "{kind}: {text}");
    let _unit = MovingUnit::start(port, motion, &[]);
    stderr.read_to_string(&mut text).unwrap();
    process.0.stdout.take().unwrap().read_to_string(&mut report).unwrap();
    assert_eq!(process.0.wait().unwrap().code(), Some(0), "{kind}: {text}");
    let report: Value = serde_json::from_str(&report).unwrap();
    println!("{report}");
    report["block"].as_str().unwrap().to_owned()
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
    let system = system_with("");
    let port = system.path("imu");
    let running = system.start(&["--source", &source(&port)]);
    system.wait_until_ready();
    let [gyro, accel, mag] = [("gyro", "rest"), ("accel", "sides"), ("mag", "turns")]
        .map(|(kind, motion)| calibrate(&system, &port, kind, motion));
    stop(running);
    let sensors = [gyro, accel, mag].concat();

    // The mounting is estimated with calibrated sensors.
    let system = system_with(&sensors);
    let port = system.path("imu");
    let running = system.start(&["--source", &source(&port)]);
    system.wait_until_ready();
    let mounting = calibrate(&system, &port, "mounting", "poses");
    stop(running);

    let settings = format!("{sensors}{mounting}");
    let [raw, calibrated] = thread::scope(|scope| {
        let threads = ["", &settings].map(|settings| scope.spawn(move || drive(settings)));
        threads.map(|thread| thread.join().unwrap())
    });
    println!("heading and inclination: {raw:?}° raw, {calibrated:?}° calibrated");
    assert!(raw.iter().all(|error_deg| *error_deg > 2.0), "{raw:?}");
    assert!(calibrated.iter().all(|error_deg| *error_deg < 1.5), "{calibrated:?}");
}
