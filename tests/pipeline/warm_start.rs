//! A stop of the whole system: the gyro's bias is there at the next start, although the body moves.
use std::{fs, os::unix::fs::symlink, path::PathBuf};

use super::orchestrated::{BUFFER, Bench, LAUNCH, RATE_HZ, readings};
use crate::common::{Run, System, until};
use messages::{FusedState, HASH_START, SensorReading, hash};
use scenario::{SensorErrors, Motion};
use serde_json::{Value, json};

/// As fast as the readings come: they say themselves when they were taken.
const SENT_HZ: f64 = 2000.0;
/// Two seconds of readings.
const START: usize = 2 * RATE_HZ as usize;
/// Standard deviation of a bias that is known, rad/s: as S1's slow motion lets it be told from the gyro's scale.
const KNOWN_RAD_S: f64 = 7e-4;
/// Of the gyro, on each axis.
const BIAS_DEG_S: f64 = 0.1;
/// What is wrong with the bias at most: after a warm start from the first tick on, and at least after a cold one, °/s.
const WARM_DEG_S: f64 = 0.02;
const COLD_DEG_S: f64 = 0.05;

/// A body that never rests.
fn moving(seconds: u64) -> Vec<SensorReading> {
    readings(Motion::S1, SensorErrors { gyro_bias_rad_s: BIAS_DEG_S.to_radians(), ..SensorErrors::S1 }, seconds * RATE_HZ as u64)
}

/// A body at rest: its gyro's bias is soon known.
fn still(seconds: u64) -> Vec<SensorReading> {
    let reading = |count: u64| {
        let t_s = count as f64 / RATE_HZ;
        SensorReading {
            t_sensor_ns: (t_s * 1e9).round() as i64,
            // Sensors that repeat themselves to the last bit are dead.
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

/// A system on the bus; `top` is said above its tables.
fn system(top: &str, below: &str) -> System {
    System::new(&format!("{top}{LAUNCH}gyro_samples = \"instants\"\n{below}"))
}

/// Where the state is kept by itself.
fn state_file(system: &System) -> PathBuf {
    system.path("plumbline").join(format!("{}.state", system.name))
}

fn body(file: &PathBuf) -> Option<Value> {
    serde_json::from_str(fs::read_to_string(file).ok()?.lines().nth(1)?).ok()
}

/// Gives the file another content with the right checksum.
fn rewrite(file: &PathBuf, body: &Value) {
    let body = format!("{body}\n");
    fs::write(file, format!("plumbline state 2 {:016x}\n{body}", hash(HASH_START, body.as_bytes()))).unwrap();
}

/// The errors of the bias over the first two seconds of a run in motion: largest, and last.
fn start(bench: &Bench) -> (f64, f64) {
    let fused = bench.bus.subscriber::<FusedState>(BUFFER).unwrap();
    bench.send_at(SENT_HZ, &moving(2), |_| {});
    let mut errors = Vec::new();
    until("two seconds of attitudes", || {
        while let Some(state) = fused.receive().unwrap() {
            errors.push(error_deg_s(state.bias_rad_s));
        }
        errors.len() >= START
    });
    (errors.iter().copied().fold(0.0, f64::max), errors[START - 1])
}

#[test]
fn the_bias_outlives_a_kill_of_the_supervisor_and_a_cold_start_does_without() {
    let bench = Bench::of(system("", ""), &[]);
    let system = bench.killed_once_it_knows();
    let file = state_file(&system);

    let bench = Bench::of(system, &[]);
    let (largest, last) = start(&bench);
    println!("warm: bias wrong by {largest:.4} °/s at most, {last:.4} °/s after 2 s");
    assert!(largest < WARM_DEG_S, "{largest} °/s");
    let (system, run) = bench.ended();
    assert!(run.line("warm start: gyro bias within ").ends_with(file.to_str().unwrap()), "{}", run.people);
    // What an orderly end leaves is newer than what was found there.
    assert!(
        error_deg_s(serde_json::from_value(body(&file).unwrap()["prior"]["bias_rad_s"]["mean"].clone()).unwrap())
            < WARM_DEG_S
    );

    // A scale that was known is there for the next run and for the one after, whether or not this one has found it anew.
    let mut known = body(&file).unwrap();
    known["prior"]["gyro_scale"] = json!({ "mean": [0.002, -0.001, 0.0005], "sd": 5e-4 });
    rewrite(&file, &known);
    let bench = Bench::of(system, &[]);
    start(&bench);
    let (system, run) = bench.ended();
    assert!(run.line("warm start: gyro bias within ").contains(" and gyro scale, written "), "{}", run.people);
    assert!(body(&file).unwrap()["prior"]["gyro_scale"]["mean"].is_array(), "{:?}", body(&file));

    let good = fs::read_to_string(&file).unwrap();
    let bench = Bench::of(system, &["--cold"]);
    let (_, last) = start(&bench);
    println!("cold: bias wrong by {last:.4} °/s after 2 s");
    assert!(last > COLD_DEG_S, "{last} °/s");
    let (mut system, run) = bench.ended();
    assert!(!run.people.contains(" start: "), "{}", run.people);

    type Spoil = fn(&mut Value);
    let spoilt: [(Spoil, &str); 5] = [
        (
            |body| body["kept"]["since_boot_s"] = (-1e7).into(),
            "days old, too old",
        ),
        (|body| body["kept"]["since_boot_s"] = 1e9.into(), "it is from the future"),
        (|body| body["kept"]["boot"] = "another".into(), "its age is unknown"),
        (|body| body["sensors"] = 1.into(), "it is from other sensors"),
        (|body| body["prior"]["bias_rad_s"]["sd"] = (-1.0).into(), "it is damaged"),
    ];
    for (spoil, said) in spoilt {
        fs::write(&file, &good).unwrap();
        let mut body = body(&file).unwrap();
        if said.contains("unknown") {
            body["kept"]["is_set"] = false.into();
        }
        spoil(&mut body);
        rewrite(&file, &body);
        let run;
        (system, run) = Bench::of(system, &[]).ended();
        let line = run.line("cold start: ");
        assert!(line.contains(said) && line.contains(file.to_str().unwrap()), "{said}: {line}");
    }
}

#[test]
fn a_file_that_is_not_this_programs_is_named_and_stays_as_it_is() {
    let launch = system("state_file = \"kept\"\n", "");
    let (kept, target) = (launch.path("kept"), launch.path("target"));
    fs::write(&target, "plumbline state 2 0\n{}\n").unwrap();
    symlink(&target, &kept).unwrap();
    let (launch, run) = Bench::of(launch, &[]).ended();
    assert!(run.line("state file ").contains("it is a symbolic link"), "{}", run.people);
    assert!(fs::symlink_metadata(&kept).unwrap().is_symlink());
    fs::remove_file(&kept).unwrap();
    fs::write(&kept, "my notes\n").unwrap();
    let bench = Bench::of(launch, &[]);
    bench.send_at(SENT_HZ, &still(10), |_| {});
    let (launch, run) = bench.ended();
    assert!(run.line("state file ").contains("it is not a state file; it is left unchanged"), "{}", run.people);
    assert_eq!(fs::read_to_string(&kept).unwrap(), "my notes\n");
    drop(launch);
}

#[test]
fn a_simulation_and_a_replay_do_not_depend_on_what_an_earlier_run_has_left() {
    let kept = |launch: &System| fs::write(launch.path("kept"), "plumbline state 2 0\n{}\n").unwrap();
    let out = |launch: &System, arguments: &[&str]| {
        let out = launch.path("out.csv");
        let run = launch.run(&[arguments, &["--out", out.to_str().unwrap()]].concat());
        run.assert_whole();
        assert!(!run.people.contains("state file") && !run.people.contains(" start: "), "{}", run.people);
        fs::read(out).unwrap()
    };
    let (plain, with_file) = (System::new(""), System::new("state_file = \"kept\"\n"));
    kept(&with_file);
    let recording = plain.path("recording.csv");
    let rows = moving(4).into_iter().map(|reading| {
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
        assert_eq!(fs::read_to_string(with_file.path("kept")).unwrap(), "plumbline state 2 0\n{}\n", "{arguments:?}");
    }
}

impl Bench {
    /// Lets it fly until it has kept a bias that is well known, and kills it.
    fn killed_once_it_knows(self) -> System {
        let file = state_file(&self.system);
        let sd_rad_s =
            || body(&file).and_then(|body| body["prior"]["bias_rad_s"]["sd"].as_f64()).unwrap_or(f64::INFINITY);
        for part in moving(120).chunks(1000) {
            self.send_at(SENT_HZ, part, |_| {});
            if sd_rad_s() < KNOWN_RAD_S {
                break;
            }
        }
        until("a bias that is known", || sd_rad_s() < KNOWN_RAD_S);
        self.killed()
    }

    /// Ends it in order.
    fn ended(mut self) -> (System, Run) {
        let running = self.running.take().unwrap();
        running.interrupt();
        let run = running.wait();
        assert_eq!(run.code, Some(0), "{}", run.people);
        (self.system, run)
    }
}
