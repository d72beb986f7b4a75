//! Flights: what a running system does is in an MCAP file that readers of others open, whatever is killed, swapped or full meanwhile.
use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use crate::common::{Run, Running, System, data, lives, plumb, python::python, signal, until};
use rustix::process::Signal;
use serde_json::Value;

/// What a reader of others finds in a flight.
fn read_by_others(python: &Path, flight: &Path, attitudes: Option<&Path>) -> Value {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foreign/flight.py");
    let output = Command::new(python).arg(script).arg(flight).args(attitudes).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// What `plumb info` says.
fn info(flight: &Path) -> (Option<i32>, Value) {
    let output = plumb(&["info", "--json", flight.to_str().unwrap()]).output().unwrap();
    let said = || panic!("{}", String::from_utf8_lossy(&output.stderr));
    let first = output.stdout.split(|byte| *byte == b'\n').next().unwrap();
    (output.status.code(), serde_json::from_slice(first).unwrap_or_else(|_| said()))
}

/// The only flight in a folder.
fn flight_in(folder: &Path) -> PathBuf {
    let all: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(all.len(), 1, "{all:?}");
    all[0].clone()
}

fn count(found: &Value, topic: &str, what: &str) -> u64 {
    found["topics"][topic][what].as_u64().unwrap_or_else(|| panic!("no {what} of {topic} in {found}"))
}

/// Every message of every tick is there, and the numbers are those of `--out`.
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
    assert_eq!((compared["rows"].as_u64(), compared["same"].as_u64()), (Some(ticks), Some(ticks)), "{compared}");
    assert!(compared["tf_off"].as_f64().unwrap() < 1e-15, "{compared}");
}

#[test]
fn where_a_receiver_was_is_on_the_map_of_viewers() {
    let (Some(python), Some(data)) = (python(), data()) else { return };
    let system = System::new("");
    let flights = system.path("flights");
    let recording = data.join("flights/apm_plane_log2_imu.csv.gz");
    let source = ["--replay", recording.to_str().unwrap(), "--speed", "max"];
    system.run(&[&source[..], &["--record", flights.to_str().unwrap()]].concat()).assert_whole();
    let found = read_by_others(python, &flight_in(&flights), None);
    assert_eq!(found["topics"]["/location"]["schema"], "foxglove.LocationFix");
    assert_eq!(count(&found, "/location", "messages"), count(&found, "/gnss", "messages"));
    let text = fs::read_to_string(data.join("flights/apm_plane_log2_gnss.csv")).unwrap();
    let rows: Vec<Vec<f64>> =
        text.lines().skip(1).map(|row| row.split(',').map(|number| number.parse().unwrap()).collect()).collect();
    for (place, row) in found["places"].as_array().unwrap().iter().zip([&rows[0], &rows[rows.len() - 1]]) {
        for (found, told) in place.as_array().unwrap().iter().zip(&row[4..7]) {
            assert!((found.as_f64().unwrap() - told).abs() < 1e-9, "{place} and {row:?}");
        }
    }
}

#[test]
fn a_flight_has_every_tick_though_services_are_killed_and_a_stage_is_swapped() {
    let Some(python) = python() else { return };
    let system = System::new("");
    let (flights, out) = (system.path("flights"), system.path("out.csv"));
    let running = system.start(&["--record", flights.to_str().unwrap(), "--out", out.to_str().unwrap()]);
    system.all_run();
    signal(running.service("gyro"), Signal::KILL);
    until("another incarnation", || system.ps().iter().any(|one| one["service"] == "gyro" && one["restarts"] == 1));
    system.all_run();
    let swap = system.swap(&["fuser", "vqf"]);
    assert_eq!(swap["outcome"], "committed", "{swap}");
    system.all_run();
    running.interrupt();
    let run = running.wait();
    run.assert_whole();
    let recording = &run.json["recording"];
    assert_eq!((&recording["missed"], &recording["error"]), (&0.into(), &Value::Null), "{recording}");
    let flight = flight_in(&flights);
    assert_eq!(recording["file"].as_str(), flight.to_str());

    let found = read_by_others(python, &flight, Some(&out));
    assert_every_tick(&found, run.number("/ticks_out") as u64);
    let said = &found["metadata"]["plumbline"];
    assert_eq!(
        (said["system"].as_str(), said["version"].as_str()),
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

    let (code, ours) = info(&flight);
    assert_eq!((code, &ours["incomplete"], &ours["missed"]), (Some(0), &Value::Null, &serde_json::json!({})), "{ours}");
    for topic in ours["topics"].as_array().unwrap() {
        let theirs = &found["topics"][topic["topic"].as_str().unwrap()]["messages"];
        assert_eq!(topic["messages"].as_u64(), Some(theirs.as_u64().unwrap_or(0)), "{topic}");
    }
    println!("{} messages, {} bytes", recording["messages"], recording["bytes"]);
}

#[test]
fn a_flight_as_fast_as_it_goes_is_whole_as_well() {
    let Some(python) = python() else { return };
    let system = System::new("");
    let (flights, out) = (system.path("flights"), system.path("out.csv"));
    let [flights_at, out_at] = [&flights, &out].map(|path| path.to_str().unwrap());
    let run = system.run(&["--record", flights_at, "--out", out_at, "--speed", "max", "--for", "20s"]);
    run.assert_whole();
    assert_eq!(run.json["recording"]["missed"], 0, "{}", run.json);
    assert_every_tick(&read_by_others(python, &flight_in(&flights), Some(&out)), 20_000);
}

#[test]
fn a_recorder_that_is_killed_leaves_a_file_that_opens_with_what_was_flown() {
    let Some(python) = python() else { return };
    let system = System::new("");
    let running = system.start(&[]);
    system.all_run();
    let flight = system.path("flight.mcap");
    let mut record = plumb(&["record", "--system", &system.name, "--out", flight.to_str().unwrap()]);
    let mut recorder = record.stdout(Stdio::null()).spawn().unwrap();
    until("the file", || flight.exists());
    let echo =
        plumb(&["topic", "echo", "attitude", "--json", "--count", "1", "--system", &system.name]).output().unwrap();
    let tick = serde_json::from_slice::<Value>(&echo.stdout).unwrap()["tick"].as_u64().unwrap();
    // While it is written, it is read: of what was seen, all is there soon.
    until("the tick to be in the file", || {
        let found = read_by_others(python, &flight, None);
        found["topics"]["/attitude"]["last_tick"].as_u64() > Some(tick)
    });
    assert!(lives(recorder.id()));
    recorder.kill().unwrap();
    recorder.wait().unwrap();
    let found = read_by_others(python, &flight, None);
    assert_eq!((&found["whole"], &found["whole_records"]), (&false.into(), &true.into()), "{found}");
    let (code, ours) = info(&flight);
    assert_eq!((code, ours["incomplete"].as_str()), (Some(1), Some("the file ends early")), "{ours}");
    let attitudes = ours["topics"].as_array().unwrap().iter().find(|topic| topic["topic"] == "/attitude").unwrap();
    assert_eq!(attitudes["messages"], found["topics"]["/attitude"]["messages"]);
    assert_eq!(ours["metadata"]["plumbline"]["system"].as_str(), Some(&*system.name));
    // Nothing of it was the system's business.
    running.interrupt();
    running.wait().assert_whole();
    assert_eq!(system.remains(), Vec::<String>::new());
}

#[test]
fn a_disk_that_fills_ends_the_flight_with_a_whole_chunk_and_costs_no_tick() {
    let Some(python) = python() else { return };
    let namespace = ["--map-root-user", "--mount"];
    let allowed = Command::new("unshare").args(namespace).arg("true").output();
    if !allowed.as_ref().is_ok_and(|output| output.status.success()) {
        return eprintln!("skipped: no file systems of one's own here: {allowed:?}");
    }
    let system = System::new("");
    let (disk, result) = (system.path("disk"), system.path("result.mcap"));
    fs::create_dir(&disk).unwrap();
    let up = system.command(&["--record", disk.to_str().unwrap(), "--for", "4s"]);
    let up: Vec<_> = [up.get_program()].into_iter().chain(up.get_args()).map(|word| word.to_str().unwrap()).collect();
    // The disk is there for these processes only.
    let script = "mount -t tmpfs -o size=1m full \"$1\" && disk=$1 && shift && result=$1 && shift && \"$@\"; code=$?; cp \"$disk\"/*.mcap \"$result\"; exit $code";
    let mut command = Command::new("unshare");
    command.args(namespace).args(["sh", "-c", script, "sh"]).args([&disk, &result]).args(up);
    let run = Run::of(command.output().unwrap());
    assert_eq!((run.number("/ticks_out"), run.number("/lost")), (4000.0, 0.0), "{}", run.json);
    assert_eq!(run.code, Some(1), "{}", run.people);
    let error = run.json["error"].as_str().unwrap();
    assert!(error.contains("No space left on device") && error.contains("with a complete chunk"), "{error}");
    assert_eq!(run.people.matches(error).count(), 2, "once while it runs, once at the end: {}", run.people);
    let found = read_by_others(python, &result, None);
    assert_eq!((&found["whole"], &found["whole_records"]), (&false.into(), &true.into()), "{found}");
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
fn a_recorder_beside_a_system_ends_when_it_is_asked_to_and_says_what_it_has() {
    let system = System::new("");
    let running = system.start(&[]);
    system.all_run();
    let flight = system.path("flight.mcap");
    let at = flight.to_str().unwrap();
    let record = |more: &[&str]| {
        let output = plumb(&["record", "--json", "--system", &system.name, "--out", at]).args(more).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        (output.status.code(), serde_json::from_slice::<Value>(&output.stdout).unwrap(), said)
    };
    let (code, summary, said) = record(&["--topics", "imu,attitude", "--for", "1s"]);
    assert_eq!((code, &summary["error"], &summary["missed"]), (Some(0), &Value::Null, &0.into()), "{summary} {said}");
    let topics: Vec<_> =
        summary["topics"].as_array().unwrap().iter().map(|one| one["topic"].as_str().unwrap()).collect();
    assert_eq!(topics, ["imu", "attitude"]);
    assert!(summary["topics"].as_array().unwrap().iter().all(|one| one["messages"].as_u64() > Some(0)), "{summary}");

    let before = fs::read(&flight).unwrap();
    let (code, summary, _) = record(&["--for", "1s"]);
    assert_eq!(code, Some(2), "{summary}");
    assert!(summary["error"].as_str().unwrap().contains("already exists"), "{summary}");
    assert!(fs::read(&flight).unwrap() == before, "what was there has changed");

    let whole = system.path("whole.mcap");
    let mut command = plumb(&["record", "--json", "--system", &system.name, "--out", whole.to_str().unwrap()]);
    let recorder = Running::of({
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    });
    until("the recorder to write", || fs::metadata(&whole).is_ok_and(|file| file.len() > 100_000));
    running.interrupt();
    running.wait().assert_whole();
    let summary = recorder.wait();
    assert_eq!((summary.code, &summary.json["missed"]), (Some(0), &0.into()), "{}", summary.people);
    assert_eq!(info(&whole).1["end_reason"], "the system ended");
    assert_eq!(system.remains(), Vec::<String>::new());
}

#[test]
fn without_a_bus_there_is_nothing_to_record() {
    let system = System::new("");
    let flights = system.path("flights");
    let run = system.run(&["--in-process", "--record", flights.to_str().unwrap(), "--for", "1s"]);
    assert_eq!((run.code, flights.exists()), (Some(2), false), "{}", run.people);
    assert!(run.json["error"].as_str().unwrap().contains("no bus to record"), "{}", run.json);
}
