//! Problematic inputs, as reported by users of comparable projects, are read or are refused with a
//! working remedy.
use std::{
    fs,
    io::Write,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
};

use flate2::{Compression, write::GzEncoder};
use serde_json::Value;

use crate::common::{System, attitudes, data, plumb, python, rms};

/// Column mapping for most of the inputs.
const MAP: &str = "gx=wx,gy=wy,gz=wz,ax=fx,ay=fy,az=fz";
const ROWS: usize = 400;

fn input(name: &str) -> Option<PathBuf> {
    Some(data()?.join("reports").join(name)).filter(|path| path.exists())
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn run(command: &str, file: &Path, arguments: &[&str]) -> Output {
    plumb(&[command]).arg(file).args(arguments).output().unwrap()
}

/// Imports a file. Returns the times of its rows in seconds, and the summary.
fn imported(system: &System, file: &Path, arguments: &[&str]) -> (Vec<f64>, String) {
    let out = system.path("imported_imu.csv");
    let output = run("import", file, &[arguments, &["-o", out.to_str().unwrap()]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let rows = fs::read_to_string(&out).unwrap();
    let times = rows.lines().skip(1).map(|row| row.split(',').next().unwrap().parse().unwrap()).collect();
    (times, text(&output.stdout) + &text(&output.stderr))
}

/// Returns the number of ticks of a replay, and its standard error.
fn replayed(system: &System, file: &Path, arguments: &[&str]) -> (usize, String) {
    let out = system.path("out.csv");
    let replay = ["--replay", file.to_str().unwrap(), "--in-process", "--speed", "max", "--out", out.to_str().unwrap()];
    let run = system.run(&[&replay, arguments].concat());
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    (attitudes(&out).len(), run.stderr)
}

/// Scores a file. Returns the JSON and standard error.
fn scored(file: &Path, arguments: &[&str]) -> (Value, String) {
    let output = run("score", file, &[arguments, &["--json"]].concat());
    let stderr = text(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{stderr}");
    (serde_json::from_slice(&output.stdout).unwrap(), stderr)
}

fn error_deg(scores: &Value, stage: usize, key: &str) -> f64 {
    let path = format!("/stages/{stage}/trials/0/{key}");
    scores.pointer(&path).and_then(Value::as_f64).unwrap_or_else(|| panic!("no {key}: {scores}"))
}

/// Asserts that `import`, `score`, `info` and `up --replay` read a file with these arguments. The
/// file must have [`ROWS`] rows at 50 Hz, and the first row must be at `first_s`.
fn assert_read(system: &System, file: &Path, arguments: &[&str], first_s: f64, note: &str) {
    let (times, summary) = imported(system, file, arguments);
    assert_eq!((times.len(), times[0]), (ROWS, first_s), "{summary}");
    assert!(times.windows(2).all(|pair| (pair[1] - pair[0] - 0.02).abs() < 1e-6), "{summary}");
    assert!(summary.contains(note), "no {note:?} in {summary}");
    let (ticks, stderr) = replayed(system, file, arguments);
    assert!(ticks == ROWS && stderr.contains(note), "{stderr}");
    let (_, stderr) = scored(file, arguments);
    assert!(!stderr.contains("warning"), "{stderr}");
    let info = run("info", file, arguments);
    assert!(text(&info.stdout).contains("400 samples at 50.0 Hz"), "{}", text(&info.stdout));
}

/// Returns the number of ticks, the exit code and the standard error of a system that reads
/// `contents` from standard input.
fn piped(system: &System, contents: &[u8], source: &str) -> (u64, Option<i32>, String) {
    let mut command = system.command(&["--source", source, "--speed", "max"]);
    let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    child.stdin.take().unwrap().write_all(contents).unwrap();
    let output = child.wait_with_output().unwrap();
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    (report["ticks_in"].as_u64().unwrap(), output.status.code(), text(&output.stderr))
}

#[recorded::test]
fn text_of_loggers_is_read_as_files() {
    let system = System::new("");
    let map = |time: &str| format!("t={time},{MAP}");
    for (name, time, units, first_s, note) in [
        ("hash_header.csv", "timestamp", "ns", 1_700_000_000.0, ""),
        ("blanks.txt", "timestamp", "s", 0.0, ""),
        ("cut_tail.csv", "timestamp", "s", 0.0, "skipped 1 malformed row, the first in line 402"),
        ("micros_wrap.csv", "micros", "us", 4_290.967_296, "the counter of the times wrapped once"),
        ("milli_g.csv", "ms", "ms,deg/s,mg", 0.0, ""),
        ("wall_clock.csv", "rtcTime", "s", 47_100.0, ""),
    ] {
        let Some(file) = input(name) else { return };
        assert_read(&system, &file, &["--map", &map(time), "--units", units], first_s, note);
        // A truncated compressed file is read up to the damage.
        let mut gzip = GzEncoder::new(Vec::new(), Compression::default());
        gzip.write_all(&fs::read(&file).unwrap()).unwrap();
        let packed = gzip.finish().unwrap();
        let cut = system.path("cut.csv.gz");
        fs::write(&cut, &packed[..packed.len() * 3 / 4]).unwrap();
        let (times, summary) = imported(&system, &cut, &["--map", &map(time), "--units", units]);
        assert!((150..ROWS).contains(&times.len()) && summary.contains("is damaged"), "{name}: {summary}");
    }
    let Some(file) = input("own_degrees.csv") else { return };
    assert_read(&system, &file, &["--units", "deg/s"], 0.0, "");
}

#[test]
fn cut_last_number_of_a_recording_is_reported() {
    let system = System::new("");
    let rows: String = (0..100).map(|n| format!("{}.{:02},0,0,0.{n:02},0,0,9.80665\n", n / 100, n % 100)).collect();
    let complete = format!("t_s,gx,gy,gz,ax,ay,az\n{rows}");
    let gzip = |text: &str| {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
        encoder.write_all(text.as_bytes()).unwrap();
        encoder.finish().unwrap()
    };
    let fixes = "t_s,ve,vn,vu\n0.1,1,2,0\n0.5,1,2,0.0";
    fs::write(system.path("cut_gnss.csv"), fixes).unwrap();
    let note = "line 101, the last one, has no line end: if the file was cut";
    for (cut, is_reported) in [(0, false), (1, true), (3, true)] {
        let text = &complete[..complete.len() - cut];
        for (name, contents) in [
            ("cut_imu.csv", text.as_bytes().to_vec()),
            ("cut_imu.csv.gz", gzip(text)),
            ("cut_imu.csv.zst", zstd::encode_all(text.as_bytes(), 0).unwrap()),
        ] {
            let file = system.path(name);
            fs::write(&file, contents).unwrap();
            let summary = self::text(&run("info", &file, &[]).stdout);
            assert!(summary.contains("100 samples at 100.0 Hz"), "{name}: {summary}");
            let (ticks, replay) = replayed(&system, &file, &[]);
            let score = self::text(&run("score", &file, &[]).stderr);
            assert_eq!(ticks, 100);
            for message in [&summary, &replay, &score] {
                assert_eq!(message.contains(note), is_reported, "{name} -{cut}: {message}");
            }
            assert!(replay.contains("cut_gnss.csv: line 3, the last one"), "{replay}");
        }
    }
}

#[recorded::test]
fn text_of_loggers_is_read_from_standard_input() {
    let system = System::new("");
    for (name, time, units, rows) in [
        ("hash_header.csv", "timestamp", "ns", ROWS as u64),
        ("blanks.txt", "timestamp", "s", ROWS as u64),
        ("micros_wrap.csv", "micros", "us", ROWS as u64),
        ("milli_g.csv", "ms", "ms,deg/s,mg", ROWS as u64),
        ("wall_clock.csv", "rtcTime", "s", ROWS as u64),
    ] {
        let Some(file) = input(name) else { return };
        let contents = fs::read(&file).unwrap();
        let source = format!("stdin?map=t={time},{MAP}&units={units}&clock=device&rate_hz=50");
        let (ticks, code, stderr) = piped(&system, &contents, &source);
        assert_eq!((ticks, code), (rows, Some(0)), "{name}: {stderr}");
    }
    // The columns are separated by bars, a line below the names contains the units, each row ends
    // with a separator, and the time is a 16-bit counter that wraps.
    let row = |n: u32| format!("{}|0|0|{}|0|0|1|\n", (n * 20 + 60_000) % 65_536, n % 7);
    let contents = "ms|wx|wy|wz|fx|fy|fz\n[ms]|[deg/s]|[deg/s]|[deg/s]|[g]|[g]|[g]\n".to_owned();
    let contents = contents + &(0..400).map(row).collect::<String>();
    let source = format!("stdin?map=t=ms,{MAP}&clock=device&rate_hz=50");
    let (ticks, code, stderr) = piped(&system, contents.as_bytes(), &source);
    assert_eq!((ticks, code), (400, Some(0)), "{stderr}");
    assert!(!stderr.contains("warning"), "{stderr}");
    let (ticks, code, stderr) = piped(&system, b"t,a,b\n0,1,2\n", "stdin?rate_hz=50");
    assert_eq!((ticks, code), (0, Some(1)), "{stderr}");
    assert!(stderr.contains("yielded no reading") && stderr.contains("name the columns with map"), "{stderr}");
}

#[recorded::test]
fn restart_of_the_clock_separates_segments() {
    let system = System::new("");
    let Some(file) = input("reboot.csv") else { return };
    let arguments = ["--map", &format!("t=millis,{MAP}"), "--units", "ms"];
    let (ticks, stderr) = replayed(&system, &file, &arguments);
    assert!(ticks == 300 && stderr.contains("the log has 2 segments"), "{stderr}");
    assert!(stderr.contains("read segment 1, the longest"), "{stderr}");
    let (ticks, stderr) = replayed(&system, &file, &[&arguments[..], &["--segment", "2"]].concat());
    assert!(ticks == 100 && stderr.contains("read segment 2, as requested"), "{stderr}");
    assert!(!stderr.contains("warning: used only"), "a chosen segment is used completely: {stderr}");
    let (scores, _) = scored(&file, &arguments);
    let ticks: Vec<_> = [0, 1].map(|trial| scores.pointer(&format!("/stages/0/trials/{trial}/ticks")).cloned()).into();
    assert_eq!(ticks, [Some(300.into()), Some(100.into())], "each segment is scored");
    let info = text(&run("info", &file, &arguments).stdout);
    assert!(info.contains("1: 300 samples, 6.0 s from 500.000 s; 2: 100 samples"), "{info}");
    let output = run("info", &file, &[&arguments[..], &["--segment", "3"]].concat());
    assert!(text(&output.stderr).contains("no segment 3, expected 1 to 2"), "{}", text(&output.stderr));
}

#[recorded::test]
fn references_and_fixes_of_logs_are_used() {
    let Some(file) = input("old_gps_clock.bin") else { return };
    let system = System::new("");
    imported(&system, &file, &[]);
    let fixes = fs::read_to_string(system.path("imported_gnss.csv")).unwrap();
    let times: Vec<f64> = fixes.lines().skip(1).map(|row| row.split(',').next().unwrap().parse().unwrap()).collect();
    assert_eq!((times[0], times[times.len() - 1].round()), (50.005, 64.0), "{times:?}");
    let (scores, _) = scored(&file, &["--fuser", "multiple-model", "--fuser", "aided"]);
    assert_errors_at_most(&scores, 0, [2.09, 1.75, 1.16]);
    assert_errors_at_most(&scores, 1, [1.56, 1.55, 0.18]);
    let file = input("slow_attitude.bin").unwrap();
    let (scores, stderr) = scored(&file, &[]);
    assert_errors_at_most(&scores, 0, [2.13, 1.85, 1.06]);
    assert!(stderr.contains("140 with reference"), "{stderr}");
}

/// Asserts that the total, heading and inclination errors of a stage do not exceed these values in
/// degrees, which are rounded to hundredths, and are not much smaller, as they would be without
/// reference.
fn assert_errors_at_most(scores: &Value, stage: usize, limits_deg: [f64; 3]) {
    for (name, limit_deg) in ["total", "heading", "inclination"].into_iter().zip(limits_deg) {
        let found_deg = error_deg(scores, stage, name);
        println!("stage {stage}: {name} {found_deg:.3}°, at most {limit_deg}°");
        assert!((0.7 * limit_deg..limit_deg + 0.005).contains(&found_deg), "stage {stage}: {name} {found_deg}");
    }
}

/// Tick of a table that `score --csv` has written.
struct ScoredTick {
    t_s: f64,
    heading_error_deg: f64,
    heading_sd_deg: f64,
    bias_deg_s: [f64; 3],
}

fn scored_ticks(table: &Path) -> Vec<ScoredTick> {
    let text = fs::read_to_string(table).unwrap();
    let mut lines = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let names = lines.next().unwrap();
    let tick = |fields: Vec<&str>| {
        let number = |name: &str| fields[names.iter().position(|it| *it == name).unwrap()].parse::<f64>().unwrap();
        let turns = (number("z_rad") - number("true_z_rad")) / std::f64::consts::TAU;
        ScoredTick {
            t_s: number("t_s"),
            heading_error_deg: 360.0 * (turns - turns.round()),
            heading_sd_deg: number("heading_sd_rad").to_degrees(),
            bias_deg_s: ["bias_x_rad_s", "bias_y_rad_s", "bias_z_rad_s"].map(|name| number(name).to_degrees()),
        }
    };
    lines.map(tick).collect()
}

/// The body of one recording starts near iron and leaves it at 62 s. In the other recording, the
/// bias of the gyro steps at 60 s.
#[recorded::test]
fn heading_and_bias_recover_with_honest_deviation() {
    let (Some(script), Some(python)) = (input("estimator.py"), python::python()) else { return };
    let system = System::new("");
    let output = Command::new(python).arg(script).arg(system.folder.path()).output().unwrap();
    assert!(output.status.success(), "{}", text(&output.stderr));
    for (name, start_bias_deg_s, end_bias_deg_s, settled_s) in [
        ("disturbed_start", [0.115, -0.057, 0.172], [0.115, -0.057, 0.172], 122.0),
        ("bias_step", [0.0; 3], [1.5, -0.8, 1.0], 120.0),
    ] {
        let tables = system.path("tables");
        scored(&system.path(&format!("{name}.csv")), &["--csv", tables.to_str().unwrap()]);
        let ticks = scored_ticks(&tables.join(format!("{name}.csv")));
        let bias_error = |tick: &ScoredTick, truth: [f64; 3]| {
            let errors = tick.bias_deg_s.iter().zip(truth).map(|(found, truth)| (found - truth).abs());
            errors.fold(0.0, f64::max)
        };
        let before = ticks.iter().rfind(|tick| tick.t_s < 60.0).unwrap();
        let biases = [bias_error(before, start_bias_deg_s), bias_error(ticks.last().unwrap(), end_bias_deg_s)];
        let settled: Vec<_> = ticks.iter().filter(|tick| tick.t_s >= settled_s).collect();
        let rms_deg = rms(settled.iter().map(|tick| tick.heading_error_deg));
        let max_deg = settled.iter().map(|tick| tick.heading_error_deg.abs()).fold(0.0, f64::max);
        // An error above three deviations is permitted only for a short time.
        let is_above = |tick: &&ScoredTick| tick.heading_error_deg.abs() > 3.0 * tick.heading_sd_deg;
        let above_s = 0.01 * ticks.iter().filter(is_above).count() as f64;
        let last_sd_deg = ticks.last().unwrap().heading_sd_deg;
        println!(
            "{name}: heading {rms_deg:.2}° rms, {max_deg:.2}° at most, above three deviations for {above_s:.1} s, {last_sd_deg:.2}° at the end, bias {biases:.3?} °/s"
        );
        assert!(rms_deg < 1.0 && max_deg < 3.0 && biases[0] < 0.05 && biases[1] < 0.05, "{name}");
        assert!(above_s < 10.0 && last_sd_deg < 2.0, "{name}: {above_s} s, {last_sd_deg}°");
    }
}

#[recorded::test]
fn raw_counts_with_scales_score_like_si_units() {
    let Some(file) = input("counts.csv") else { return };
    let system = System::new("");
    let launch = system.path("counts.toml");
    let (gyro, accel) = (0.001_065_264_436_03, 0.004_788_403_32);
    let scale =
        |sensor: &str, scale: f64| format!("[ingest.calibration.{sensor}]\nscale = [{scale}, {scale}, {scale}]\n");
    fs::write(&launch, scale("gyro", gyro) + &scale("accel", accel)).unwrap();
    let (scores, stderr) = scored(&file, &["--launch", launch.to_str().unwrap()]);
    let inclination = error_deg(&scores, 0, "inclination");
    println!("counts: inclination {inclination:.3}°");
    assert!(inclination < 0.1 && !stderr.contains("warning"), "{inclination} {stderr}");
}

#[recorded::test]
fn units_of_bags_are_named_and_corrected() {
    let Some(file) = input("field_gauss.mcap") else { return };
    let (_, stderr) = scored(&file, &[]);
    assert!(stderr.contains("field-unit") && stderr.contains("`--units gauss`"), "{stderr}");
    let (scores, stderr) = scored(&file, &["--units", "gauss"]);
    assert!(!stderr.contains("warning") && error_deg(&scores, 0, "heading") < 1.0, "{scores} {stderr}");
    let file = input("zero_stamps.mcap").unwrap();
    let (scores, stderr) = scored(&file, &[]);
    assert!(stderr.contains("timestamps of /imu/data never change"), "{stderr}");
    assert_eq!(scores.pointer("/stages/0/trials/0/ticks").and_then(Value::as_u64), Some(200));
}

#[recorded::test]
fn unsupported_formats_are_named_in_the_same_words() {
    let system = System::new("");
    for (name, words) in [
        ("ros1.bag", "found ROS 1 bag; convert it with `rosbags-convert --src "),
        (
            "dataflash.log",
            "found text form of an ArduPilot log; use the .BIN that it was made from, or convert it with",
        ),
    ] {
        let Some(file) = input(name) else { return };
        let out = system.path("out_imu.csv");
        let commands = [
            plumb(&["score"]).arg(&file).output().unwrap(),
            plumb(&["info"]).arg(&file).output().unwrap(),
            plumb(&["import", "-o"]).arg(&out).arg(&file).output().unwrap(),
            plumb(&["up", "--in-process", "--replay"]).arg(&file).output().unwrap(),
        ];
        for output in commands {
            let stderr = text(&output.stderr);
            assert!(output.status.code() == Some(3) && stderr.contains(words), "{name}: {stderr}");
        }
    }
}
