//! Flight recordings: MCAP files that third-party readers can open, regardless of kills, swaps and
//! full disks.
use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use crate::common::{Run, Running, System, data, is_alive, plumb, python::python, signal, wait_for};
use rustix::process::Signal;
use serde_json::Value;

/// Returns the contents of a flight as read by the `mcap` package in `tests/foreign/flight.py`.
fn read_with_mcap(python: &Path, flight: &Path, attitudes: Option<&Path>) -> Value {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foreign/flight.py");
    let output = Command::new(python).arg(script).arg(flight).args(attitudes).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Returns the exit code and the report of `plumb info`.
fn info(flight: &Path) -> (Option<i32>, Value) {
    let output = plumb(&["info", "--json", flight.to_str().unwrap()]).output().unwrap();
    let fail = || panic!("{}", String::from_utf8_lossy(&output.stderr));
    let first = output.stdout.split(|byte| *byte == b'\n').next().unwrap();
    (output.status.code(), serde_json::from_slice(first).unwrap_or_else(|_| fail()))
}

/// Returns the only flight in a folder.
fn flight_in(folder: &Path) -> PathBuf {
    let all: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(all.len(), 1, "{all:?}");
    all[0].clone()
}

fn count(found: &Value, topic: &str, what: &str) -> u64 {
    found["topics"][topic][what].as_u64().unwrap_or_else(|| panic!("no {what} of {topic} in {found}"))
}

/// Checks that every tick has all its messages and that the messages equal the rows of `--out`.
fn assert_every_tick(found: &Value, ticks: u64) {
    for topic in ["/imu", "/gyro", "/accel", "/fused", "/attitude"] {
        assert_eq!(count(found, topic, "ticks"), ticks, "{topic}");
    }
    for (topic, one) in found["topics"].as_object().unwrap() {
        assert_eq!(one["bad_stamps"], 0, "{topic}: {one}");
    }
    assert_eq!(count(found, "/tf", "messages"), count(found, "/attitude", "messages"));
    assert_eq!(found["topics"]["/imu"]["schema"], "plumbline.v1.ImuSample");
    assert_eq!(found["topics"]["/tf"]["schema"], "foxglove.FrameTransform");
    assert_eq!(found["topics"]["/pose"]["schema"], "foxglove.PoseInFrame");
    let compared = &found["compared"];
    assert_eq!((compared["rows"].as_u64(), compared["equal"].as_u64()), (Some(ticks), Some(ticks)), "{compared}");
    assert!(compared["max_tf_error"].as_f64().unwrap() < 1e-15, "{compared}");
}

#[recorded::test]
fn gnss_fixes_are_recorded_as_map_locations() {
    let (Some(python), Some(data)) = (python(), data()) else { return };
    let system = System::new("");
    let flights = system.path("flights");
    let recording = data.join("flights/apm_plane_log2_imu.csv.gz");
    let source = ["--replay", recording.to_str().unwrap(), "--speed", "max"];
    system.run(&[&source[..], &["--record", flights.to_str().unwrap()]].concat()).assert_complete();
    let found = read_with_mcap(python, &flight_in(&flights), None);
    assert_eq!(found["topics"]["/location"]["schema"], "foxglove.LocationFix");
    assert_eq!(count(&found, "/location", "messages"), count(&found, "/gnss", "messages"));
    let text = fs::read_to_string(data.join("flights/apm_plane_log2_gnss.csv")).unwrap();
    let rows: Vec<Vec<f64>> =
        text.lines().skip(1).map(|row| row.split(',').map(|number| number.parse().unwrap()).collect()).collect();
    for (place, row) in found["places"].as_array().unwrap().iter().zip([&rows[0], &rows[rows.len() - 1]]) {
        for (found, expected) in place.as_array().unwrap().iter().zip(&row[4..7]) {
            assert!((found.as_f64().unwrap() - expected).abs() < 1e-9, "{place} and {row:?}");
        }
    }
}

#[test]
fn recording_is_complete_despite_kill_and_swap() {
    let Some(python) = python() else { return };
    let system = System::new("");
    let (flights, out) = (system.path("flights"), system.path("out.csv"));
    let running = system.start(&["--record", flights.to_str().unwrap(), "--out", out.to_str().unwrap()]);
    system.wait_until_running();
    signal(running.service("gyro"), Signal::KILL);
    wait_for("another incarnation", || system.ps().iter().any(|one| one["service"] == "gyro" && one["restarts"] == 1));
    system.wait_until_running();
    let swap = system.swap(&["fuser", "vqf"]);
    assert_eq!(swap["outcome"], "committed", "{swap}");
    system.wait_until_running();
    running.interrupt();
    let run = running.wait();
    run.assert_complete();
    let recording = &run.json["recording"];
    assert_eq!((&recording["missed"], &recording["error"]), (&0.into(), &Value::Null), "{recording}");
    let flight = flight_in(&flights);
    assert_eq!(recording["file"].as_str(), flight.to_str());

    let found = read_with_mcap(python, &flight, Some(&out));
    assert_every_tick(&found, run.number("/ticks_out") as u64);
    let metadata = &found["metadata"]["plumbline"];
    assert_eq!(
        (metadata["system"].as_str(), metadata["version"].as_str()),
        (Some(&*system.name), Some(env!("CARGO_PKG_VERSION")))
    );
    assert_eq!(found["metadata"]["end"]["reason"], "ended normally");
    let launch = fs::read_to_string(system.path("launch.toml")).unwrap();
    assert_eq!(found["attachments"]["launch.toml"].as_str(), Some(&*launch));
    let config: Value = serde_json::from_str(found["attachments"]["config.json"].as_str().unwrap()).unwrap();
    assert_eq!(
        (&config["launch"]["fuser"]["stage"], &config["rate_hz"]),
        (&"multiple-model".into(), &1000.0.into()),
        "{config}"
    );
    let report: Value = serde_json::from_str(found["attachments"]["report.json"].as_str().unwrap()).unwrap();
    assert_eq!(report["ticks_out"], run.json["ticks_out"]);

    let (code, info_report) = info(&flight);
    assert_eq!(
        (code, &info_report["incomplete"], &info_report["missed"]),
        (Some(0), &Value::Null, &serde_json::json!({})),
        "{info_report}"
    );
    for topic in info_report["topics"].as_array().unwrap() {
        let read_back = &found["topics"][topic["topic"].as_str().unwrap()]["messages"];
        assert_eq!(topic["messages"].as_u64(), Some(read_back.as_u64().unwrap_or(0)), "{topic}");
    }
    println!("{} messages, {} bytes", recording["messages"], recording["bytes"]);
}

#[test]
fn recording_at_max_speed_is_complete() {
    let Some(python) = python() else { return };
    let system = System::new("");
    let (flights, out) = (system.path("flights"), system.path("out.csv"));
    let [flights_at, out_at] = [&flights, &out].map(|path| path.to_str().unwrap());
    let run = system.run(&["--record", flights_at, "--out", out_at, "--speed", "max", "--for", "20s"]);
    run.assert_complete();
    assert_eq!(run.json["recording"]["missed"], 0, "{}", run.json);
    assert_every_tick(&read_with_mcap(python, &flight_in(&flights), Some(&out)), 20_000);
}

#[test]
fn killed_recorder_leaves_readable_file() {
    let Some(python) = python() else { return };
    let system = System::new("");
    let running = system.start(&[]);
    system.wait_until_running();
    let flight = system.path("flight.mcap");
    let mut record = plumb(&["record", "--system", &system.name, "--out", flight.to_str().unwrap()]);
    let mut recorder = record.stdout(Stdio::null()).spawn().unwrap();
    wait_for("the file", || flight.exists());
    let echo =
        plumb(&["topic", "echo", "attitude", "--json", "--count", "1", "--system", &system.name]).output().unwrap();
    let tick = serde_json::from_slice::<Value>(&echo.stdout).unwrap()["tick"].as_u64().unwrap();
    // The file can be read while it is being written. A tick seen on the bus soon appears in the
    // file.
    wait_for("the tick to be in the file", || {
        let found = read_with_mcap(python, &flight, None);
        found["topics"]["/attitude"]["last_tick"].as_u64() > Some(tick)
    });
    assert!(is_alive(recorder.id()));
    recorder.kill().unwrap();
    recorder.wait().unwrap();
    let found = read_with_mcap(python, &flight, None);
    assert_eq!((&found["complete"], &found["complete_records"]), (&false.into(), &true.into()), "{found}");
    let (code, info_report) = info(&flight);
    assert_eq!((code, info_report["incomplete"].as_str()), (Some(1), Some("the file ends early")), "{info_report}");
    let attitudes =
        info_report["topics"].as_array().unwrap().iter().find(|topic| topic["topic"] == "/attitude").unwrap();
    assert_eq!(attitudes["messages"], found["topics"]["/attitude"]["messages"]);
    assert_eq!(info_report["metadata"]["plumbline"]["system"].as_str(), Some(&*system.name));
    // The killed recorder must not have affected the system.
    running.interrupt();
    running.wait().assert_complete();
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn full_disk_ends_recording_with_complete_chunk() {
    let Some(python) = python() else { return };
    let namespace = ["--map-root-user", "--mount"];
    let allowed = Command::new("unshare").args(namespace).arg("true").output();
    if !allowed.as_ref().is_ok_and(|output| output.status.success()) {
        return eprintln!("skipped: no private mount namespace available: {allowed:?}");
    }
    let system = System::new("");
    let (disk, result) = (system.path("disk"), system.path("result.mcap"));
    fs::create_dir(&disk).unwrap();
    let up = system.command(&["--record", disk.to_str().unwrap(), "--for", "4s"]);
    let up: Vec<_> = [up.get_program()].into_iter().chain(up.get_args()).map(|word| word.to_str().unwrap()).collect();
    // The mount is visible only to the processes of this command.
    let script = "mount -t tmpfs -o size=1m full \"$1\" && disk=$1 && shift && result=$1 && shift && \"$@\"; code=$?; cp \"$disk\"/*.mcap \"$result\"; exit $code";
    let mut command = Command::new("unshare");
    command.args(namespace).args(["sh", "-c", script, "sh"]).args([&disk, &result]).args(up);
    let run = Run::from_output(command.output().unwrap());
    assert_eq!((run.number("/ticks_out"), run.number("/lost")), (4000.0, 0.0), "{}", run.json);
    assert_eq!(run.code, Some(1), "{}", run.stderr);
    let error = run.json["error"].as_str().unwrap();
    assert!(error.contains("No space left on device") && error.contains("with a complete chunk"), "{error}");
    assert_eq!(run.stderr.matches(error).count(), 2, "once during the run, once at the end: {}", run.stderr);
    let found = read_with_mcap(python, &result, None);
    assert_eq!((&found["complete"], &found["complete_records"]), (&false.into(), &true.into()), "{found}");
    let recorded = run.number("/recording/messages");
    let read: u64 = found["topics"]
        .as_object()
        .unwrap()
        .iter()
        .filter(|(topic, _)| !["/tf", "/pose"].contains(&&***topic))
        .map(|(_, one)| one["messages"].as_u64().unwrap())
        .sum();
    assert_eq!((recorded > 0.0, recorded), (true, read as f64), "{found}");
}

#[test]
fn separate_recorder_stops_and_reports_its_messages() {
    let system = System::new("");
    let running = system.start(&[]);
    system.wait_until_running();
    let flight = system.path("flight.mcap");
    let at = flight.to_str().unwrap();
    let record = |more: &[&str]| {
        let output = plumb(&["record", "--json", "--system", &system.name, "--out", at]).args(more).output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        (output.status.code(), serde_json::from_slice::<Value>(&output.stdout).unwrap(), stderr)
    };
    let (code, summary, stderr) = record(&["--topics", "imu,attitude", "--for", "1s"]);
    assert_eq!((code, &summary["error"], &summary["missed"]), (Some(0), &Value::Null, &0.into()), "{summary} {stderr}");
    let topics: Vec<_> =
        summary["topics"].as_array().unwrap().iter().map(|one| one["topic"].as_str().unwrap()).collect();
    assert_eq!(topics, ["imu", "attitude"]);
    assert!(summary["topics"].as_array().unwrap().iter().all(|one| one["messages"].as_u64() > Some(0)), "{summary}");

    let before = fs::read(&flight).unwrap();
    let (code, summary, _) = record(&["--for", "1s"]);
    assert_eq!(code, Some(2), "{summary}");
    assert!(summary["error"].as_str().unwrap().contains("already exists"), "{summary}");
    assert!(fs::read(&flight).unwrap() == before, "the existing file was changed");

    let full_flight = system.path("full.mcap");
    let mut command = plumb(&["record", "--json", "--system", &system.name, "--out", full_flight.to_str().unwrap()]);
    let recorder = Running::spawn({
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    });
    wait_for("the recorder to write", || fs::metadata(&full_flight).is_ok_and(|file| file.len() > 100_000));
    running.interrupt();
    running.wait().assert_complete();
    let summary = recorder.wait();
    assert_eq!((summary.code, &summary.json["missed"]), (Some(0), &0.into()), "{}", summary.stderr);
    assert_eq!(info(&full_flight).1["end_reason"], "the system ended");
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn recording_in_process_is_rejected() {
    let system = System::new("");
    let flights = system.path("flights");
    let run = system.run(&["--in-process", "--record", flights.to_str().unwrap(), "--for", "1s"]);
    assert_eq!((run.code, flights.exists()), (Some(2), false), "{}", run.stderr);
    assert!(run.json["error"].as_str().unwrap().contains("no bus to record"), "{}", run.json);
}
