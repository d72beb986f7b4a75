//! `plumb calibrate`: its launch-file blocks reduce the sensor errors, and insufficient data are
//! rejected.
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

use crate::common::{Running, System, data, plumb, run_on_terminal, signal, wait_for};

const HEADER: &str = "t_s,gx,gy,gz,ax,ay,az\n";
const GYRO_BIAS_RAD_S: [f64; 3] = [0.02, -0.03, 0.01];
const ACCEL_BIAS_M_S2: [f64; 3] = [0.4, -0.3, 0.2];
const ACCEL_SCALE: [f64; 3] = [1.03, 0.98, 1.01];
const HARD_IRON_UT: [f64; 3] = [30.0, -20.0, 15.0];

/// Applies sensor errors: raw = true / scale + bias.
fn with_sensor_errors(exact: [f64; 3], scale: [f64; 3], bias: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| exact[i] / scale[i] + bias[i])
}

/// Returns a recording at 100 Hz from a sensor unit with errors.
///
/// The unit rests for three seconds in each of the positions given by the up directions `ups`. It
/// is moved between these rests.
fn resting(ups: &[[f64; 3]]) -> String {
    let mut text = String::from(HEADER);
    for row in 0..400 * ups.len() {
        let (up, within, t_s) = (ups[row / 400], row % 400, row as f64 * 0.01);
        // The unit has sensor noise at rest, and is moved by hand between the rests.
        let noise = |rad_s: f64| 0.01 * (rad_s * t_s).sin();
        let motion = if within < 300 { 0.0 } else { 3.0 * (9.0 * t_s).sin() };
        let rate = std::array::from_fn(|i| 0.1 * noise(31.0 + 7.0 * i as f64) + motion);
        let force = std::array::from_fn(|i| 9.806_65 * up[i] + noise(137.0 + 11.0 * i as f64) + motion);
        let [p, q, r] = with_sensor_errors(rate, [1.0; 3], GYRO_BIAS_RAD_S);
        let [x, y, z] = with_sensor_errors(force, ACCEL_SCALE, ACCEL_BIAS_M_S2);
        writeln!(text, "{t_s:.2},{p},{q},{r},{x},{y},{z}").unwrap();
    }
    text
}

const SIX: [[f64; 3]; 6] =
    [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]];

fn write_file(system: &System, name: &str, text: &str) -> String {
    fs::write(system.path(name), text).unwrap();
    system.path(name).to_str().unwrap().to_owned()
}

fn calibrate(arguments: &[&str]) -> Output {
    plumb(&["calibrate"]).args(arguments).output().unwrap()
}

/// Runs a calibration that must succeed and returns its JSON report.
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

/// Checks that a calibration fails with this exit code and message, and that the report has no
/// launch-file block.
fn assert_fails(arguments: &[&str], code: i32, expected: &[&str]) {
    let output = calibrate(&[arguments, &["--json"]].concat());
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {stderr}");
    expected.iter().for_each(|words| assert!(stderr.contains(words), "no {words:?} in:\n{stderr}"));
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(json["error"].is_string() && json.get("block").is_none(), "{json}");
}

/// Returns two versions of the text of a BROAD recording: unchanged, and with sensor errors.
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
            with_sensor_errors(three(1), [1.0; 3], GYRO_BIAS_RAD_S),
            with_sensor_errors(three(4), ACCEL_SCALE, ACCEL_BIAS_M_S2),
            with_sensor_errors(three(7), [1.0; 3], HARD_IRON_UT),
        ];
        let numbers = sensors.concat().iter().map(f64::to_string).collect::<Vec<_>>().join(",");
        writeln!(raw, "{},{numbers},{}", fields[0], fields[10..].join(",")).unwrap();
    }
    (exact, raw)
}

#[recorded::test]
fn pasted_calibration_restores_accuracy() {
    let Some(data) = data() else { return };
    let system = System::new("");
    let (exact, raw) = broad(&data);
    let (exact, raw) = (write_file(&system, "exact.csv", &exact), write_file(&system, "raw.csv", &raw));
    let six = write_file(&system, "six.csv", &resting(&SIX));
    let blocks = [block(&["gyro", &raw]), block(&["accel", &six]), block(&["mag", &raw])];
    let error_deg = |text: &str, file: &str| {
        let run = System::new(text).run(&["--replay", file, "--speed", "max", "--in-process"]);
        run.assert_complete();
        run.number("/error_deg/inclination_rmse")
    };
    let (without, with, calibrated) = (error_deg("", &exact), error_deg("", &raw), error_deg(&blocks.concat(), &raw));
    println!("inclination {without}° without errors, {with}° with errors, {calibrated}° calibrated");
    assert!(with > without + 1.5 && calibrated < without + 0.1, "{without} {with} {calibrated}");
    let delay_ms = vector(&calibrated_clock(&system, &blocks.concat(), &raw), "/values/0/value")[0];
    assert!((delay_ms - 13.0).abs() < 2.0, "{delay_ms} ms");
}

/// Measures the magnetometer delay with the given calibrations and returns the report.
fn calibrated_clock(system: &System, blocks: &str, file: &str) -> Value {
    let launch = write_file(system, "calibrated.toml", blocks);
    let clock = calibrated(&["clock", file, "--launch", &launch]);
    let launch_with_clock =
        write_file(system, "with-clock.toml", &(blocks.to_owned() + clock["block"].as_str().unwrap()));
    let checked = plumb(&["config", "check", "--launch", &launch_with_clock]).output().unwrap();
    assert!(checked.status.success(), "{}", String::from_utf8_lossy(&checked.stderr));
    clock
}

#[test]
fn errors_are_shown_as_text_and_json() {
    let system = System::new("");
    let six = write_file(&system, "six.csv", &resting(&SIX));
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
fn mounting_replaces_existing_one() {
    let system = System::new("");
    let (sin, cos) = 0.7f64.sin_cos();
    // The body axes are forward, left, up. The unit is first level, then nose down, so that x
    // points partly down.
    let poses = write_file(&system, "poses.csv", &resting(&[[0.0, 0.0, 1.0], [-sin, 0.0, cos]]));
    let accel = write_file(&system, "six.csv", &resting(&SIX));
    let accel = write_file(&system, "accel.toml", &block(&["accel", &accel]));
    let report = calibrated(&["mounting", &poses, "--launch", &accel]);
    let names: Vec<_> = report["notes"].as_array().unwrap().iter().map(|note| note.as_str().unwrap()).collect();
    assert!(names.iter().any(|note| note.contains("\"x-forward-y-left\", 0.")), "{names:?}");
    let pasted = write_file(&system, "pasted.toml", report["block"].as_str().unwrap());
    assert!(plumb(&["config", "check", "--launch", &pasted]).output().unwrap().status.success());
}

#[test]
fn foreign_file_is_read_by_map_and_units() {
    let system = System::new("");
    let ours = resting(&SIX[..3]);
    let mut theirs = String::from("ms,wx,wy,wz,fx,fy,fz\n");
    for line in ours.lines().skip(1) {
        let n: Vec<f64> = line.split(',').map(|field| field.parse().unwrap()).collect();
        let [p, q, r] = [n[1], n[2], n[3]].map(f64::to_degrees);
        writeln!(theirs, "{},{p},{q},{r},{},{},{}", n[0] * 1e3, n[4], n[5], n[6]).unwrap();
    }
    let (ours, theirs) = (write_file(&system, "ours.csv", &ours), write_file(&system, "theirs.csv", &theirs));
    let map = "t=ms,gx=wx,gy=wy,gz=wz,ax=fx,ay=fy,az=fz";
    let read = calibrated(&["gyro", &theirs, "--map", map, "--units", "ms,deg/s,m/s2"]);
    let found = vector(&read, "/values/0/value");
    assert!(found.iter().zip(GYRO_BIAS_RAD_S).all(|(a, b)| (a - b).abs() < 1e-4), "{found:?}");
    assert_eq!(read["block"], calibrated(&["gyro", &ours])["block"]);
}

#[test]
fn flight_is_calibrated_from_raw_readings() {
    let six = resting(&SIX);
    let system = System::new("[ingest.calibration.accel]\nbias = [1, 1, 1]\n");
    let file = write_file(&system, "six.csv", &six);
    let flights = system.path("flights");
    system.run(&["--replay", &file, "--speed", "max", "--record", flights.to_str().unwrap()]).assert_complete();
    let flight: PathBuf = fs::read_dir(&flights).unwrap().next().unwrap().unwrap().path();
    assert_eq!(block(&["accel", flight.to_str().unwrap()]), block(&["accel", &file]));
}

#[test]
fn low_coverage_is_rejected_with_missing_poses() {
    let system = System::new("");
    let five = write_file(&system, "five.csv", &resting(&SIX[..5]));
    assert_fails(&["accel", &five], 1, &["83 %", "missing: 2 s of rest in each position: x down;"]);
    assert_fails(&["mag", &five], 1, &["0 %", "a magnetometer sample"]);
    assert_fails(&["clock", &five], 1, &["a magnetometer sample"]);
    let one = write_file(&system, "one.csv", &resting(&SIX[..1]));
    assert_fails(&["mounting", &one], 1, &["50 %", "a second pose"]);
    assert_fails(&["gyro", &one], 1, &["missing: ", "do not touch it"]);
    assert_fails(&["gyro", "sim:s1?duration_s=20"], 1, &["0 %", "do not touch it"]);
    assert_fails(&["gyro", "nowhere.csv"], 3, &["nowhere.csv", "check the path"]);
    assert_eq!(calibrate(&["gyro"]).status.code(), Some(2));
    assert_eq!(calibrate(&["mag", &five, "--field-ut", "5"]).status.code(), Some(2));
    assert_eq!(calibrate(&["gyro", &five, "--live"]).status.code(), Some(2));
}

/// Returns a recording of two minutes at 50 Hz from a sensor unit at rest. The white noise is 0.05
/// °/√s for the gyro and 0.002 m/s/√s for the accelerometer. The unit is moved from 60 to 62 s.
fn noisy_rest() -> String {
    let mut text = String::from(HEADER);
    // Numbers of a linear congruential generator, uniform from −√3 to √3.
    let mut state = 1u64;
    let mut noise = || {
        state = 16_807 * state % 2_147_483_647;
        3f64.sqrt() * (2.0 * state as f64 / 2_147_483_647.0 - 1.0)
    };
    for row in 0..6000 {
        let t_s = f64::from(row) * 0.02;
        let motion = if (60.0..62.0).contains(&t_s) { (9.0 * t_s).sin() } else { 0.0 };
        let [p, q, r] = [0; 3].map(|_| 0.05f64.to_radians() * 50f64.sqrt() * noise() + motion);
        let [x, y, z] = [0; 3].map(|_| 0.002 * 50f64.sqrt() * noise());
        writeln!(text, "{t_s:.2},{p},{q},{r},{x},{y},{}", z + 9.806_65).unwrap();
    }
    text
}

#[test]
fn noise_at_rest_is_measured_drawn_and_written() {
    let system = System::new("");
    let recording = write_file(&system, "rest.csv", &noisy_rest());
    let figure = system.path("noise.svg");
    let report = calibrated(&["noise", &recording, "--plot", figure.to_str().unwrap()]);
    for (sensor, truth) in [(0, 0.05), (1, 0.002)] {
        for axis in 0..3 {
            let found = report.pointer(&format!("/sensors/{sensor}/axes/{axis}")).unwrap();
            let value = found["random_walk"]["value"].as_f64().unwrap();
            assert!((value / truth - 1.0).abs() < 0.2, "{found}");
            assert_eq!(found["bias_walk"]["result"], "not_determined", "{found}");
        }
    }
    let svg = fs::read_to_string(&figure).unwrap();
    for words in ["Allan deviation at rest", "τ, s", "gyro, °/s", "accelerometer, m/s²", ">\n10\n<"] {
        assert!(svg.contains(words), "no {words:?} in {svg}");
    }

    let launch = write_file(
        &system,
        "mine.toml",
        "# my unit\n[fuser] # best\nstage = \"multiple-model\"\nset = { wind_m_s = 3 }\n",
    );
    let output = calibrate(&["noise", &recording, "--write", &launch]);
    let stdout = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    for words in [
        "noise: 2 rests, ",
        "at 50.0 Hz; intervals of 68 % confidence",
        "gyro angle random walk, °/√s",
        "not determined (below ",
        " minutes",
        "motion at 60 to ",
        "on gyro x, limit ",
        "used only the rests at 0 to 59 s, ",
    ] {
        assert!(stdout.contains(words), "no {words:?} in:\n{stdout}");
    }
    let text = fs::read_to_string(&launch).unwrap();
    assert!(text.starts_with("# my unit\n[fuser] # best\n") && text.contains("wind_m_s = 3"), "{text}");
    for name in ["level_noise_deg_sqrt_s = 0.04", "gyro_noise_deg_sqrt_s = 0.04", "accel_noise_m_s_sqrt_s = 0.00"] {
        assert!(text.contains(name), "no {name:?} in {text}");
    }
    assert!(plumb(&["config", "check", "--launch", &launch]).output().unwrap().status.success());

    // The parameters are computed for the fuser stage of the launch file.
    let vqf = write_file(&system, "vqf.toml", "[fuser]\nstage = \"vqf\"\n");
    let output = calibrate(&["noise", &recording, "--write", &vqf]);
    let shown = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    assert!(shown.contains("the fuser vqf has no parameter for noise") && !shown.contains("wrote"), "{shown}");
    assert_eq!(fs::read_to_string(&vqf).unwrap(), "[fuser]\nstage = \"vqf\"\n");
}

#[test]
fn noise_is_rejected_in_motion_and_from_a_system() {
    let system = System::new("");
    let moved = write_file(&system, "moved.csv", &resting(&SIX));
    assert_fails(&["noise", &moved], 1, &["0 rests", "30.0 s of rest", "rest instead of motion at ", "limit "]);
    assert_fails(&["noise", "sim:s1?duration_s=40"], 1, &["rest instead of motion"]);
    assert_fails(&["noise", "--live"], 2, &["recording of a rest", "plumb up --record"]);
    assert_fails(&["gyro", &moved, "--plot", "a.svg"], 2, &["plumb calibrate noise"]);
    let rest = write_file(&system, "rest.csv", &noisy_rest());
    let nowhere = system.path("nowhere/noise.svg");
    assert_fails(&["noise", &rest, "--plot", nowhere.to_str().unwrap()], 1, &["nowhere/noise.svg", "check the folder"]);
}

#[recorded::test]
fn noise_of_a_real_unit_at_rest_is_plausible() {
    let Some(data) = data() else { return };
    let log = data.join("logs/px4_sample.ulg");
    let report = calibrated(&["noise", log.to_str().unwrap()]);
    // A minute of readings determines the random walk of some axes and yields an upper limit for
    // the others.
    let white = |sensor: usize, axis: usize| {
        let found = report.pointer(&format!("/sensors/{sensor}/axes/{axis}/random_walk")).unwrap();
        found["value"].as_f64().or(found["below"].as_f64()).unwrap()
    };
    for axis in 0..3 {
        assert!((0.002..0.01).contains(&white(0, axis)) && (0.0005..0.005).contains(&white(1, axis)), "{report}");
    }
    assert!(report["rests"][0]["start_s"].as_f64().unwrap() > 8.0, "{report}");
    assert!(report["notes"][0].as_str().unwrap().starts_with("motion at 2 to 8 s"), "{report}");
}

/// Runs `test` while a sensor unit repeatedly writes `rows`, which lack times, to standard input.
/// The unit sends 100 rows per second of its time, which passes faster than real time.
pub(super) fn with_live_sensor<T>(running: &mut Running, rows: &[String], test: impl FnOnce(&Running) -> T) -> T {
    /// Stops the sensor when the test returns or panics.
    struct StopOnDrop<'a>(&'a AtomicBool);
    impl Drop for StopOnDrop<'_> {
        fn drop(&mut self) {
            self.0.store(true, Ordering::SeqCst);
        }
    }
    let ended = AtomicBool::new(false);
    let mut input = running.stdin();
    let (sensor, running) = (&ended, &*running);
    std::thread::scope(|scope| {
        scope.spawn(move || {
            let mut t_ms = 0;
            while !sensor.load(Ordering::SeqCst) {
                let lines = (0..10).map(|i| {
                    format!(
                        "{}.{:02},{}\n",
                        (t_ms + 10 * i) / 1000,
                        (t_ms + 10 * i) % 1000 / 10,
                        rows[(t_ms / 10 + i) % rows.len()]
                    )
                });
                if input.write_all(lines.collect::<String>().as_bytes()).is_err() {
                    return;
                }
                t_ms += 100;
                // Real time advances by 0.02 s per 0.1 s of sensor time.
                std::thread::sleep(Duration::from_millis(20));
            }
        });
        let _stop = StopOnDrop(&ended);
        test(running)
    })
}

#[test]
fn running_system_is_calibrated_with_progress_bar() {
    let launch = "[ingest]\nsource = \"stdin\"\ncalibration.gyro.bias = [1, 1, 1]\n[ingest.stdin]\nrate_hz = 100\n";
    let system = System::new(launch);
    let mut command = system.command(&[]);
    command.stdin(Stdio::piped());
    let mut running = Running::spawn(command);
    let rest = resting(&SIX[..1]);
    let rows: Vec<_> = rest.lines().skip(1).take(300).map(|row| row.split_once(',').unwrap().1.to_owned()).collect();
    with_live_sensor(&mut running, &rows, |running| {
        system.wait_until_running();
        let arguments = ["gyro", "--live", "--system", &system.name];
        let found = vector(&calibrated(&arguments), "/values/0/value");
        // The result is the bias of the unit itself, before the calibration in the launch file is
        // applied.
        assert!(found.iter().zip(GYRO_BIAS_RAD_S).all(|(a, b)| (a - b).abs() < 1e-3), "{found:?}");
        let shown = run_on_terminal(&[&["calibrate"], &arguments[..]].concat());
        assert!(shown.contains(" % ") && shown.contains("s of rest"), "{shown}");
        assert!(shown.contains("[ingest.calibration.gyro]"), "{shown}");

        assert_fails(&[&arguments[..], &["--for", "200ms"]].concat(), 1, &["missing: "]);
        let mut ended = plumb(&["calibrate", "accel", "--live", "--system", &system.name]);
        let ended = ended.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        // The observer installs its signal handlers before it subscribes to the topic.
        wait_for("the observer", || {
            let about = ["topic", "info", "sensor", "--for", "0.05", "--json", "--system", &system.name];
            let info = String::from_utf8(plumb(&about).output().unwrap().stdout).unwrap();
            info.contains(&format!("{}", ended.id()))
        });
        signal(ended.id(), Signal::INT);
        let ended = ended.wait_with_output().unwrap();
        let stderr = String::from_utf8_lossy(&ended.stderr);
        assert_eq!(ended.status.code(), Some(1), "{stderr}");
        assert!(stderr.contains("2 s of rest in each position: x up"), "{stderr}");
        running.interrupt();
    });
    let run = running.wait();
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn system_without_readings_is_rejected_with_remedy() {
    let system = System::new("");
    let running = system.start(&[]);
    system.wait_until_running();
    let arguments = ["gyro", "--live", "--system", &system.name];
    assert_fails(&arguments, 1, &["plumb up --readings"]);
    running.interrupt();
    assert_eq!(running.wait().code, Some(0));
    let with = system.start(&["--readings"]);
    system.wait_until_running();
    assert_fails(&[&arguments[..], &["--for", "1s"]].concat(), 1, &["0 %", "do not touch it"]);
    with.interrupt();
    assert_eq!(with.wait().code, Some(0));
    assert_fails(&arguments, 1, &[&system.name]);
}

#[test]
fn written_calibration_equals_the_printed_one() {
    let system = System::new("");
    let recording = write_file(&system, "rest.csv", &resting(&[SIX[0]; 4]));
    let printed = block(&["gyro", &recording]);
    let launch = write_file(&system, "mine.toml", "# my unit\nname = \"mine\" # of mine\n");
    let output = calibrate(&["gyro", &recording, "--write", &launch]);
    let (stdout, stderr) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert_eq!(output.status.code(), Some(0), "{stderr}");
    assert!(stderr.contains("wrote the calibration to") && !stdout.contains("Add to"), "{stderr}{stdout}");
    let text = fs::read_to_string(&launch).unwrap();
    assert!(text.starts_with("# my unit\nname = \"mine\" # of mine\n") && text.ends_with(&printed), "{text}");
    let invalid = write_file(&system, "invalid.toml", "nme = 1\n");
    let output = calibrate(&["gyro", &recording, "--write", &invalid]);
    assert_eq!(output.status.code(), Some(3), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(fs::read_to_string(&invalid).unwrap(), "nme = 1\n");
}
