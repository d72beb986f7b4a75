//! `plumb calibrate`: what it prints is pasted into a launch file and helps; what it cannot tell it refuses.
use std::{
    fmt::Write as _,
    fs::{self, File},
    io::{Read, Write as _},
    path::{Path, PathBuf},
    process::{Output, Stdio},
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};

use flate2::read::MultiGzDecoder;
use rustix::process::Signal;
use serde_json::Value;

use crate::common::{Running, System, data, on_a_terminal, plumb, signal, until};

const HEADER: &str = "t_s,gx,gy,gz,ax,ay,az\n";
const GYRO_BIAS_RAD_S: [f64; 3] = [0.02, -0.03, 0.01];
const ACCEL_BIAS_M_S2: [f64; 3] = [0.4, -0.3, 0.2];
const ACCEL_SCALE: [f64; 3] = [1.03, 0.98, 1.01];
const HARD_IRON_UT: [f64; 3] = [30.0, -20.0, 15.0];

/// Raw is true / scale + bias.
fn spoilt(exact: [f64; 3], scale: [f64; 3], bias: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| exact[i] / scale[i] + bias[i])
}

/// A unit with these errors at 100 Hz that rests for three seconds with gravity in each of these directions; between them it is waved about.
fn resting(ups: &[[f64; 3]]) -> String {
    let mut text = String::from(HEADER);
    for row in 0..400 * ups.len() {
        let (up, within, t_s) = (ups[row / 400], row % 400, row as f64 * 0.01);
        // What a sensor trembles by, and a hand.
        let tremble = |rad_s: f64| 0.01 * (rad_s * t_s).sin();
        let hand = if within < 300 { 0.0 } else { 3.0 * (9.0 * t_s).sin() };
        let rate = std::array::from_fn(|i| 0.1 * tremble(31.0 + 7.0 * i as f64) + hand);
        let force = std::array::from_fn(|i| 9.806_65 * up[i] + tremble(137.0 + 11.0 * i as f64) + hand);
        let [p, q, r] = spoilt(rate, [1.0; 3], GYRO_BIAS_RAD_S);
        let [x, y, z] = spoilt(force, ACCEL_SCALE, ACCEL_BIAS_M_S2);
        writeln!(text, "{t_s:.2},{p},{q},{r},{x},{y},{z}").unwrap();
    }
    text
}

const SIX: [[f64; 3]; 6] =
    [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]];

fn written(system: &System, name: &str, text: &str) -> String {
    fs::write(system.path(name), text).unwrap();
    system.path(name).to_str().unwrap().to_owned()
}

fn calibrate(arguments: &[&str]) -> Output {
    plumb(&["calibrate"]).args(arguments).output().unwrap()
}

/// What scripts are told of a calibration that there is.
fn calibrated(arguments: &[&str]) -> Value {
    let output = calibrate(&[arguments, &["--json"]].concat());
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn block(arguments: &[&str]) -> String {
    calibrated(arguments)["block"].as_str().unwrap().to_owned()
}

fn vector(report: &Value, pointer: &str) -> Vec<f64> {
    report.pointer(pointer).and_then(Value::as_array).unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

/// It ended with this code and said these words to people, and as an error to scripts.
fn assert_refused(arguments: &[&str], code: i32, said: &[&str]) {
    let output = calibrate(&[arguments, &["--json"]].concat());
    let people = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {people}");
    said.iter().for_each(|words| assert!(people.contains(words), "no {words:?} in:\n{people}"));
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(json["error"].is_string() && json.get("block").is_none(), "{json}");
}

/// A recording of BROAD as text; and the same with errors.
fn broad(folder: &Path) -> (String, String) {
    let mut exact = String::new();
    let file = folder.join("broad/02_undisturbed_slow_rotation_B.csv.gz");
    MultiGzDecoder::new(File::open(file).unwrap()).read_to_string(&mut exact).unwrap();
    let mut lines = exact.lines();
    let mut raw = format!("{}\n", lines.next().unwrap());
    for line in lines {
        let fields: Vec<_> = line.split(',').collect();
        let three = |first: usize| std::array::from_fn(|i| fields[first + i].parse().unwrap());
        let sensors = [
            spoilt(three(1), [1.0; 3], GYRO_BIAS_RAD_S),
            spoilt(three(4), ACCEL_SCALE, ACCEL_BIAS_M_S2),
            spoilt(three(7), [1.0; 3], HARD_IRON_UT),
        ];
        let numbers = sensors.concat().iter().map(f64::to_string).collect::<Vec<_>>().join(",");
        writeln!(raw, "{},{numbers},{}", fields[0], fields[10..].join(",")).unwrap();
    }
    (exact, raw)
}

#[test]
fn what_is_printed_is_pasted_and_the_recording_is_as_good_as_it_was() {
    let Some(data) = data() else { return };
    let system = System::new("");
    let (exact, raw) = broad(&data);
    let (exact, raw) = (written(&system, "exact.csv", &exact), written(&system, "raw.csv", &raw));
    let six = written(&system, "six.csv", &resting(&SIX));
    let pieces = [block(&["gyro", &raw]), block(&["accel", &six]), block(&["mag", &raw])];
    let error_deg = |text: &str, file: &str| {
        let run = System::new(text).run(&["--replay", file, "--speed", "max", "--in-process"]);
        run.assert_whole();
        run.number("/error_deg/inclination_rmse")
    };
    let (without, with, calibrated) = (error_deg("", &exact), error_deg("", &raw), error_deg(&pieces.concat(), &raw));
    println!("inclination {without}° as it is, {with}° with errors, {calibrated}° calibrated");
    assert!(with > without + 1.5 && calibrated < without + 0.1, "{without} {with} {calibrated}");
    let delay_ms = vector(&calibrated_clock(&system, &pieces.concat(), &raw), "/values/0/value")[0];
    assert!((delay_ms - 13.0).abs() < 2.0, "{delay_ms} ms");
}

/// The magnetometer's delay, with the calibrations that were found before.
fn calibrated_clock(system: &System, pieces: &str, file: &str) -> Value {
    let launch = written(system, "calibrated.toml", pieces);
    let clock = calibrated(&["clock", file, "--launch", &launch]);
    let whole = written(system, "whole.toml", &(pieces.to_owned() + clock["block"].as_str().unwrap()));
    let checked = plumb(&["config", "check", &whole]).output().unwrap();
    assert!(checked.status.success(), "{}", String::from_utf8_lossy(&checked.stderr));
    clock
}

#[test]
fn people_are_told_the_errors_and_scripts_the_same() {
    let system = System::new("");
    let six = written(&system, "six.csv", &resting(&SIX));
    let report = calibrated(&["accel", &six]);
    for (pointer, truth) in [("/values/0/value", ACCEL_BIAS_M_S2), ("/values/1/value", ACCEL_SCALE)] {
        let found = vector(&report, pointer);
        assert!(found.iter().zip(truth).all(|(a, b)| (a - b).abs() < 2e-3), "{pointer}: {found:?}");
    }
    let output = calibrate(&["accel", &six]);
    let text = String::from_utf8(output.stdout).unwrap();
    for words in ["6 rests in 6 positions", "coverage 100 %", " ± ", "before", "after", "[ingest.calibration.accel]"] {
        assert!(text.contains(words), "no {words:?} in:\n{text}");
    }
    assert!(text.ends_with(&format!("{}\n", report["block"].as_str().unwrap())), "{text}");
}

#[test]
fn a_mounting_is_pasted_in_place_of_the_one_there_is() {
    let system = System::new("");
    let (sin, cos) = 0.7f64.sin_cos();
    // Forward, left, up: level, and nose down, so that x points down.
    let poses = written(&system, "poses.csv", &resting(&[[0.0, 0.0, 1.0], [-sin, 0.0, cos]]));
    let accel = written(&system, "six.csv", &resting(&SIX));
    let accel = written(&system, "accel.toml", &block(&["accel", &accel]));
    let report = calibrated(&["mounting", &poses, "--launch", &accel]);
    let names: Vec<_> = report["notes"].as_array().unwrap().iter().map(|note| note.as_str().unwrap()).collect();
    assert!(names.iter().any(|note| note.contains("\"x-forward-y-left\", 0.")), "{names:?}");
    let pasted = written(&system, "pasted.toml", report["block"].as_str().unwrap());
    assert!(plumb(&["config", "check", &pasted]).output().unwrap().status.success());
}

#[test]
fn another_systems_file_is_read_by_its_columns_and_units() {
    let system = System::new("");
    let ours = resting(&SIX[..3]);
    let mut theirs = String::from("ms,wx,wy,wz,fx,fy,fz\n");
    for line in ours.lines().skip(1) {
        let n: Vec<f64> = line.split(',').map(|field| field.parse().unwrap()).collect();
        let [p, q, r] = [n[1], n[2], n[3]].map(f64::to_degrees);
        writeln!(theirs, "{},{p},{q},{r},{},{},{}", n[0] * 1e3, n[4], n[5], n[6]).unwrap();
    }
    let (ours, theirs) = (written(&system, "ours.csv", &ours), written(&system, "theirs.csv", &theirs));
    let map = "t=ms,gx=wx,gy=wy,gz=wz,ax=fx,ay=fy,az=fz";
    let read = calibrated(&["gyro", &theirs, "--map", map, "--units", "ms,deg/s,m/s2"]);
    let found = vector(&read, "/values/0/value");
    assert!(found.iter().zip(GYRO_BIAS_RAD_S).all(|(a, b)| (a - b).abs() < 1e-4), "{found:?}");
    assert_eq!(read["block"], calibrated(&["gyro", &ours])["block"]);
}

#[test]
fn a_flight_is_calibrated_by_its_readings_and_not_by_what_was_made_of_them() {
    let six = resting(&SIX);
    let system = System::new("[ingest.calibration.accel]\nbias = [1, 1, 1]\n");
    let file = written(&system, "six.csv", &six);
    let flights = system.path("flights");
    system.run(&["--replay", &file, "--speed", "max", "--record", flights.to_str().unwrap()]).assert_whole();
    let flight: PathBuf = fs::read_dir(&flights).unwrap().next().unwrap().unwrap().path();
    assert_eq!(block(&["accel", flight.to_str().unwrap()]), block(&["accel", &file]));
}

#[test]
fn thin_coverage_is_refused_with_what_is_missing() {
    let system = System::new("");
    let five = written(&system, "five.csv", &resting(&SIX[..5]));
    assert_refused(&["accel", &five], 1, &["83 %", "missing: 2 s of rest in each position: x down;"]);
    assert_refused(&["mag", &five], 1, &["0 %", "a magnetometer sample"]);
    assert_refused(&["clock", &five], 1, &["a magnetometer sample"]);
    let one = written(&system, "one.csv", &resting(&SIX[..1]));
    assert_refused(&["mounting", &one], 1, &["50 %", "a second pose"]);
    assert_refused(&["gyro", &one], 1, &["missing: ", "do not touch it"]);
    assert_refused(&["gyro", "sim:s1?duration_s=20"], 1, &["0 %", "do not touch it"]);
    assert_refused(&["gyro", "nowhere.csv"], 3, &["nowhere.csv", "check the path"]);
    assert_eq!(calibrate(&["gyro"]).status.code(), Some(2));
    assert_eq!(calibrate(&["mag", &five, "--field-ut", "5"]).status.code(), Some(2));
    assert_eq!(calibrate(&["gyro", &five, "--live"]).status.code(), Some(2));
}

/// A unit at rest on standard input, as fast as a sensor gives it, until the system or the test ends.
fn fed<T>(running: &mut Running, test: impl FnOnce(&Running) -> T) -> T {
    /// The test is over, however it ended.
    struct Over<'a>(&'a AtomicBool);
    impl Drop for Over<'_> {
        fn drop(&mut self) {
            self.0.store(true, Ordering::SeqCst);
        }
    }
    let ended = AtomicBool::new(false);
    let mut input = running.stdin();
    let (sensor, running) = (&ended, &*running);
    std::thread::scope(|scope| {
        scope.spawn(move || {
            let rows = resting(&[[0.0, 0.0, 1.0]]);
            let rests: Vec<_> = rows.lines().skip(1).take(300).map(|line| line.split_once(',').unwrap().1).collect();
            let mut t_ms = 0;
            while !sensor.load(Ordering::SeqCst) {
                let lines = (0..10).map(|i| {
                    format!(
                        "{}.{:02},{}\n",
                        (t_ms + 10 * i) / 1000,
                        (t_ms + 10 * i) % 1000 / 10,
                        rests[(t_ms / 10 + i) % 300]
                    )
                });
                if input.write_all(lines.collect::<String>().as_bytes()).is_err() {
                    return;
                }
                t_ms += 100;
                // A tenth of a second of the sensor's time in a fiftieth.
                std::thread::sleep(Duration::from_millis(20));
            }
        });
        let _over = Over(&ended);
        test(running)
    })
}

#[test]
fn a_running_system_is_calibrated_while_a_bar_shows_the_coverage() {
    let launch = "[ingest]\nsource = \"stdin\"\ncalibration.gyro.bias = [1, 1, 1]\n[ingest.stdin]\nrate_hz = 100\n";
    let system = System::new(launch);
    let mut command = system.command(&[]);
    command.stdin(Stdio::piped());
    let mut running = Running::of(command);
    fed(&mut running, |running| {
        system.all_run();
        let arguments = ["gyro", "--live", "--system", &system.name];
        let found = vector(&calibrated(&arguments), "/values/0/value");
        // The unit's own, whatever the system takes it for.
        assert!(found.iter().zip(GYRO_BIAS_RAD_S).all(|(a, b)| (a - b).abs() < 1e-3), "{found:?}");
        let shown = on_a_terminal(&[&["calibrate"], &arguments[..]].concat());
        assert!(shown.contains(" % ") && shown.contains("s of rest"), "{shown}");
        assert!(shown.contains("[ingest.calibration.gyro]"), "{shown}");

        assert_refused(&[&arguments[..], &["--for", "200ms"]].concat(), 1, &["missing: "]);
        let mut ended = plumb(&["calibrate", "accel", "--live", "--system", &system.name]);
        let ended = ended.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        // It catches the signal before it sits at the topic.
        until("the observer", || {
            let about = ["topic", "info", "sensor", "--seconds", "0.05", "--json", "--system", &system.name];
            let info = String::from_utf8(plumb(&about).output().unwrap().stdout).unwrap();
            info.contains(&format!("{}", ended.id()))
        });
        signal(ended.id(), Signal::INT);
        let ended = ended.wait_with_output().unwrap();
        let people = String::from_utf8_lossy(&ended.stderr);
        assert_eq!(ended.status.code(), Some(1), "{people}");
        assert!(people.contains("2 s of rest in each position: x up"), "{people}");
        running.interrupt();
    });
    let run = running.wait();
    assert_eq!(run.code, Some(0), "{}", run.people);
    assert_eq!(system.remains(), Vec::<String>::new());
}

#[test]
fn a_system_that_publishes_no_readings_is_refused_with_the_remedy() {
    let system = System::new("");
    let running = system.start(&[]);
    system.all_run();
    let arguments = ["gyro", "--live", "--system", &system.name];
    assert_refused(&arguments, 1, &["plumb up --readings"]);
    running.interrupt();
    assert_eq!(running.wait().code, Some(0));
    let with = system.start(&["--readings"]);
    system.all_run();
    assert_refused(&[&arguments[..], &["--for", "1s"]].concat(), 1, &["0 %", "do not touch it"]);
    with.interrupt();
    assert_eq!(with.wait().code, Some(0));
    assert_refused(&arguments, 1, &[&system.name]);
}
