//! Warm start: the gyro bias from an earlier run is available at the start, even if the body moves.
use std::{fs, os::unix::fs::symlink, path::PathBuf};

use super::bus_source::{BUFFER_MESSAGES, BUS_LAUNCH, Bench, RATE_HZ, readings};
use crate::common::{Run, System, wait_for};
use messages::{FusedState, HASH_START, SensorReading, hash};
use scenario::{Motion, SensorErrors};
use serde_json::{Value, json};

/// Rate at which readings are sent, Hz. Their timestamps correspond to the nominal rate.
const SEND_RATE_HZ: f64 = 2000.0;
/// Number of readings in 2 s.
const START_READINGS: usize = 2 * RATE_HZ as usize;
/// Standard deviation in rad/s below which the bias in the state file counts as known. The limit
/// allows for the slow rotation in S1, in which the bias is hard to separate from the scale error.
const KNOWN_BIAS_SD_RAD_S: f64 = 7e-4;
/// Gyro bias on each axis, °/s.
const BIAS_DEG_S: f64 = 0.1;
/// Maximum bias error during a warm start, °/s.
const MAX_WARM_ERROR_DEG_S: f64 = 0.02;
/// Minimum bias error after a cold start, °/s.
const MIN_COLD_ERROR_DEG_S: f64 = 0.05;

/// Returns readings of a moving body.
fn readings_in_motion(seconds: u64) -> Vec<SensorReading> {
    readings(
        Motion::S1,
        SensorErrors { gyro_bias_rad_s: BIAS_DEG_S.to_radians(), ..SensorErrors::S1 },
        seconds * RATE_HZ as u64,
    )
}

/// Returns readings of a body at rest, from which the gyro bias is found quickly.
fn readings_at_rest(seconds: u64) -> Vec<SensorReading> {
    let reading = |count: u64| {
        let t_s = count as f64 / RATE_HZ;
        SensorReading {
            t_sensor_ns: (t_s * 1e9).round() as i64,
            // Constant values would be flagged as a stuck sensor.
            rate_rad_s: [1e-4 * (300.0 * t_s).sin(); 3],
            force_m_s2: [0.01 * (400.0 * t_s).sin(), 0.0, 9.81],
            field_ut: [f64::NAN; 3],
        }
    };
    (0..seconds * RATE_HZ as u64).map(reading).collect()
}

fn error_deg_s(bias_rad_s: [f64; 3]) -> f64 {
    bias_rad_s.map(|x| (x.to_degrees() - BIAS_DEG_S).abs()).into_iter().fold(0.0, f64::max)
}

/// Returns a system fed over the bus. In the launch file, `top` precedes the tables and `below`
/// follows them.
fn system(top: &str, below: &str) -> System {
    System::new(&format!("{top}{BUS_LAUNCH}gyro_samples = \"instants\"\n{below}"))
}

/// Returns the default path of the state file.
fn state_file(system: &System) -> PathBuf {
    system.path("plumbline").join(format!("{}.state", system.name))
}

fn body(file: &PathBuf) -> Option<Value> {
    serde_json::from_str(fs::read_to_string(file).ok()?.lines().nth(1)?).ok()
}

/// Replaces the body of the state file and updates the file's checksum.
fn rewrite(file: &PathBuf, body: &Value) {
    let body = format!("{body}\n");
    fs::write(file, format!("plumbline state 2 {:016x}\n{body}", hash(HASH_START, body.as_bytes()))).unwrap();
}

/// Returns the largest and the last bias error during the first two seconds in motion, °/s.
fn start_errors_deg_s(bench: &Bench) -> (f64, f64) {
    let fused = bench.bus.subscriber::<FusedState>(BUFFER_MESSAGES).unwrap();
    bench.send_at(SEND_RATE_HZ, &readings_in_motion(2), |_| {});
    let mut errors = Vec::new();
    wait_for("2 s of attitudes", || {
        while let Some(state) = fused.receive().unwrap() {
            errors.push(error_deg_s(state.bias_rad_s));
        }
        errors.len() >= START_READINGS
    });
    (errors.iter().copied().fold(0.0, f64::max), errors[START_READINGS - 1])
}

#[test]
fn gyro_bias_survives_killed_supervisor_but_not_cold_start() {
    let bench = Bench::start_system(system("", ""), &[]);
    let system = bench.run_until_known_and_kill();
    let file = state_file(&system);

    let bench = Bench::start_system(system, &[]);
    let (largest, last) = start_errors_deg_s(&bench);
    println!("warm: bias error {largest:.4} °/s at most, {last:.4} °/s after 2 s");
    assert!(largest < MAX_WARM_ERROR_DEG_S, "{largest} °/s");
    let (system, run) = bench.stop_in_order();
    assert!(run.line("warm start: gyro bias within ").ends_with(file.to_str().unwrap()), "{}", run.stderr);
    // The state written during the orderly stop is newer than the state read at the start.
    assert!(
        error_deg_s(serde_json::from_value(body(&file).unwrap()["prior"]["bias_rad_s"]["mean"].clone()).unwrap())
            < MAX_WARM_ERROR_DEG_S
    );

    // A known scale error is kept for later runs, even if a run does not estimate it again.
    let mut known = body(&file).unwrap();
    known["prior"]["gyro_scale"] = json!({ "mean": [0.002, -0.001, 0.0005], "sd": 5e-4 });
    rewrite(&file, &known);
    let bench = Bench::start_system(system, &[]);
    start_errors_deg_s(&bench);
    let (system, run) = bench.stop_in_order();
    assert!(run.line("warm start: gyro bias within ").contains(" and gyro scale, written "), "{}", run.stderr);
    assert!(body(&file).unwrap()["prior"]["gyro_scale"]["mean"].is_array(), "{:?}", body(&file));

    let valid = fs::read_to_string(&file).unwrap();
    let bench = Bench::start_system(system, &["--cold"]);
    let (_, last) = start_errors_deg_s(&bench);
    println!("cold: bias error {last:.4} °/s after 2 s");
    assert!(last > MIN_COLD_ERROR_DEG_S, "{last} °/s");
    let (mut system, run) = bench.stop_in_order();
    assert!(!run.stderr.contains(" start: "), "{}", run.stderr);

    type Corruption = fn(&mut Value);
    let corruptions: [(Corruption, &str); 5] = [
        (|body| body["kept"]["since_boot_s"] = (-1e7).into(), "days old, too old"),
        (|body| body["kept"]["since_boot_s"] = 1e9.into(), "it is from the future"),
        (|body| body["kept"]["boot"] = "another".into(), "its age is unknown"),
        (|body| body["sensors"] = 1.into(), "it is from other sensors"),
        (|body| body["prior"]["bias_rad_s"]["sd"] = (-1.0).into(), "it is damaged"),
    ];
    for (corrupt, reason) in corruptions {
        fs::write(&file, &valid).unwrap();
        let mut body = body(&file).unwrap();
        if reason.contains("unknown") {
            body["kept"]["is_set"] = false.into();
        }
        corrupt(&mut body);
        rewrite(&file, &body);
        let run;
        (system, run) = Bench::start_system(system, &[]).stop_in_order();
        let line = run.line("cold start: ");
        assert!(line.contains(reason) && line.contains(file.to_str().unwrap()), "{reason}: {line}");
    }
}

#[test]
fn foreign_state_file_is_reported_and_left_unchanged() {
    let system = system("state_file = \"state\"\n", "");
    let (state, target) = (system.path("state"), system.path("target"));
    fs::write(&target, "plumbline state 2 0\n{}\n").unwrap();
    symlink(&target, &state).unwrap();
    let (system, run) = Bench::start_system(system, &[]).stop_in_order();
    assert!(run.line("state file ").contains("it is a symbolic link"), "{}", run.stderr);
    assert!(fs::symlink_metadata(&state).unwrap().is_symlink());
    fs::remove_file(&state).unwrap();
    fs::write(&state, "my notes\n").unwrap();
    let bench = Bench::start_system(system, &[]);
    bench.send_at(SEND_RATE_HZ, &readings_at_rest(10), |_| {});
    let (system, run) = bench.stop_in_order();
    assert!(run.line("state file ").contains("it is not a state file; it is left unchanged"), "{}", run.stderr);
    assert_eq!(fs::read_to_string(&state).unwrap(), "my notes\n");
    drop(system);
}

#[test]
fn simulation_and_replay_ignore_state_file() {
    let write_state = |system: &System| fs::write(system.path("state"), "plumbline state 2 0\n{}\n").unwrap();
    let out = |system: &System, arguments: &[&str]| {
        let out = system.path("out.csv");
        let run = system.run(&[arguments, &["--out", out.to_str().unwrap()]].concat());
        run.assert_complete();
        assert!(!run.stderr.contains("state file") && !run.stderr.contains(" start: "), "{}", run.stderr);
        fs::read(out).unwrap()
    };
    let (plain, with_file) = (System::new(""), System::new("state_file = \"state\"\n"));
    write_state(&with_file);
    let recording = plain.path("recording.csv");
    let rows = readings_in_motion(4).into_iter().map(|reading| {
        let ([gx, gy, gz], [ax, ay, az]) = (reading.rate_rad_s, reading.force_m_s2);
        format!("{},{gx},{gy},{gz},{ax},{ay},{az}\n", reading.t_sensor_ns as f64 * 1e-9)
    });
    fs::write(&recording, rows.fold("t_s,gx,gy,gz,ax,ay,az\n".to_owned(), |text, row| text + &row)).unwrap();
    let recording = recording.to_str().unwrap();
    for arguments in [
        &["--replay", recording, "--speed", "1"][..],
        &["--replay", recording, "--speed", "max"],
        &["--for", "4s", "--speed", "max"],
        &["--for", "4s", "--speed", "max", "--in-process"],
    ] {
        assert!(out(&plain, arguments) == out(&with_file, arguments), "{arguments:?}");
        assert_eq!(fs::read_to_string(with_file.path("state")).unwrap(), "plumbline state 2 0\n{}\n", "{arguments:?}");
    }
}

impl Bench {
    /// Runs until the bias in the state file counts as known, then kills the system.
    fn run_until_known_and_kill(self) -> System {
        let file = state_file(&self.system);
        let sd_rad_s =
            || body(&file).and_then(|body| body["prior"]["bias_rad_s"]["sd"].as_f64()).unwrap_or(f64::INFINITY);
        for part in readings_in_motion(120).chunks(1000) {
            self.send_at(SEND_RATE_HZ, part, |_| {});
            if sd_rad_s() < KNOWN_BIAS_SD_RAD_S {
                break;
            }
        }
        wait_for("a known bias", || sd_rad_s() < KNOWN_BIAS_SD_RAD_S);
        self.kill()
    }

    /// Stops the system in an orderly way.
    fn stop_in_order(mut self) -> (System, Run) {
        let running = self.running.take().unwrap();
        running.interrupt();
        let run = running.wait();
        assert_eq!(run.code, Some(0), "{}", run.stderr);
        (self.system, run)
    }
}
