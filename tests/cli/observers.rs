//! Observation of a running system: commands show its state and do not disturb it.
use std::{
    fs,
    io::{BufRead, BufReader, Read},
    path::PathBuf,
    process::{Child, Command, Output, Stdio},
    time::{Duration, Instant},
};

use crate::common::{Running, System, is_alive, plumb, signal, wait_for};
use graph::{Service, Topic};
use messages::{Layout, Message};
use rustix::process::Signal;
use serde_json::Value;

/// Timeout for waiting until a system reaches a state. It elapses only if a test fails.
const TIMEOUT: Duration = Duration::from_secs(30);

/// Returns a `plumb` command for a system, with JSON output.
fn json_command(system: &System, arguments: &[&str]) -> Command {
    let mut command = plumb(arguments);
    command.args(["--json", "--system", &system.name]);
    command
}

fn run_json(system: &System, arguments: &[&str]) -> Output {
    json_command(system, arguments).output().unwrap()
}

/// Returns the JSON values on the lines of standard output.
fn lines(output: &Output) -> Vec<Value> {
    let text = String::from_utf8(output.stdout.clone()).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|_| panic!("no JSON: {line}"))).collect()
}

/// Runs a command that must succeed and returns the JSON value on its only line.
fn query(system: &System, arguments: &[&str]) -> Value {
    let output = run_json(system, arguments);
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", stderr_text(&output));
    let [value] = lines(&output).try_into().unwrap();
    value
}

/// Repeats a command until its value satisfies `holds`.
///
/// A busy machine may distort the rates and states in a single snapshot, so the command is
/// repeated.
fn query_until(system: &System, arguments: &[&str], holds: impl Fn(&Value) -> bool) -> Value {
    lines_until(system, arguments, |lines| holds(&lines[0])).remove(0)
}

fn lines_until(system: &System, arguments: &[&str], hold: impl Fn(&[Value]) -> bool) -> Vec<Value> {
    let deadline = Instant::now() + TIMEOUT;
    loop {
        let lines = lines(&run_json(system, arguments));
        if !lines.is_empty() && hold(&lines) {
            return lines;
        }
        assert!(Instant::now() < deadline, "{arguments:?}: {lines:?}");
    }
}

fn stderr_text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Returns `true` if every service is running.
fn is_running(system: &System) -> bool {
    let services = system.ps();
    !services.is_empty() && services.iter().all(|one| one["state"] == "running")
}

/// Starts a system and waits until it publishes attitudes.
fn start_system(system: &System, arguments: &[&str]) -> Running {
    let running = system.start(arguments);
    let publishes = |hz: &Output| lines(hz).iter().any(|hz| hz["messages"] == 2);
    wait_for("attitudes", || {
        publishes(&run_json(system, &["topic", "hz", "attitude", "--count", "2", "--for", "0.2"])) && is_running(system)
    });
    running
}

fn number(value: &Value, key: &str) -> f64 {
    value[key].as_f64().unwrap_or_else(|| panic!("no {key} in {value}"))
}

fn layout(topic: &str) -> Layout {
    messages::layout(Topic::from_name(topic).unwrap())
}

/// Observer process. It is killed when dropped.
struct Observer(Child);

impl Observer {
    fn start(system: &System, arguments: &[&str]) -> Self {
        let mut command = json_command(system, arguments);
        Self(command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap())
    }

    fn pid(&self) -> u32 {
        self.0.id()
    }

    /// Waits until the observer subscribes to the topic.
    fn wait_until_reading(&self, system: &System, topic: &str) {
        wait_for("the observer to subscribe", || {
            let info = query(system, &["topic", "info", topic, "--for", "0.01"]);
            info["subscribers"].as_array().unwrap().iter().any(|port| port["pid"] == self.pid())
        });
    }

    fn first_line(&mut self) -> String {
        let mut line = String::new();
        BufReader::new(self.0.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
        line
    }

    fn output(mut self) -> Output {
        let (mut stdout, mut stderr) = (Vec::new(), Vec::new());
        self.0.stdout.take().unwrap().read_to_end(&mut stdout).unwrap();
        self.0.stderr.take().unwrap().read_to_end(&mut stderr).unwrap();
        Output { status: self.0.wait().unwrap(), stdout, stderr }
    }
}

impl Drop for Observer {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn every_command_shows_the_running_system() {
    let system = System::new("buffer_s = 2.0\nlateness_s = 1.0\n");
    let running = start_system(&system, &[]);

    let is_at_rate = |one: &Value| one["rate_hz"].as_f64().is_some_and(|rate_hz| (500.0..1500.0).contains(&rate_hz));
    let published: Vec<_> = Service::PATH.iter().map(|service| service.output().unwrap().name()).collect();
    let list = query_until(&system, &["topic", "list"], |list| {
        let mut topics =
            list["topics"].as_array().unwrap().iter().filter(|one| published.contains(&one["topic"].as_str().unwrap()));
        topics.all(is_at_rate)
    });
    let topics = list["topics"].as_array().unwrap();
    for topic in published.iter().copied() {
        let one = topics.iter().find(|one| one["topic"] == topic).unwrap_or_else(|| panic!("no {topic}"));
        assert_eq!(one["type"], layout(topic).name);
        assert_eq!((one["buffer"].as_u64(), one["publishers"].as_array().unwrap().len()), (Some(2000), 1), "{one}");
        assert!(one["subscribers"].as_array().unwrap().iter().all(|port| port["alive"] == true), "{one}");
    }

    let info = query(&system, &["topic", "info", "fused"]);
    let fused = messages::FusedState::layout();
    assert_eq!(info["fingerprint"], format!("{:016x}", fused.fingerprint()));
    assert_eq!(
        (info["publishers"][0]["name"].as_str(), info["subscribers"][0]["name"].as_str()),
        (Some("fuser"), Some("course"))
    );
    let fields = info["fields"].as_array().unwrap();
    let bias = fields.iter().find(|field| field["name"] == "bias_rad_s").unwrap();
    assert_eq!(
        (bias["unit"].as_str(), bias["offset"].as_u64(), bias["type"].as_str()),
        (Some("rad/s"), Some(120), Some("[f64; 3]"))
    );
    assert!(bias["meaning"].as_str().unwrap().starts_with("Gyro bias, rad/s"), "{bias}");

    let echo = run_json(&system, &["topic", "echo", "imu", "--count", "3", "--every", "3"]);
    let messages = lines(&echo);
    let ticks: Vec<_> = messages.iter().map(|message| message["tick"].as_u64().unwrap()).collect();
    assert!(ticks.windows(2).all(|pair| pair[1] == pair[0] + 3) && ticks.len() == 3, "{ticks:?}");
    let names: Vec<_> = messages[0].as_object().unwrap().keys().cloned().collect();
    let mut expected: Vec<_> = layout("imu").fields.iter().map(|field| field.name.to_owned()).collect();
    expected.sort();
    assert_eq!(names, expected);
    assert_eq!(messages[0]["flags"], serde_json::json!(["rate-instant"]));

    let hz = query_until(&system, &["topic", "hz", "attitude", "--for", "1"], is_at_rate);
    assert_eq!((hz["lost"].as_u64(), hz["measured_by"].as_str()), (Some(0), Some("sent")));
    let interval = |name| number(&hz["interval_ms"], name);
    assert!(0.0 <= interval("min") && interval("min") <= interval("mean") && interval("mean") <= interval("max"));

    let bw = query(&system, &["topic", "bw", "attitude", "--count", "500"]);
    assert_eq!(bw["messages"], 500);
    assert!((number(&bw, "bytes_per_s") / number(&bw, "rate_hz") - 224.0).abs() < 1e-6, "{bw}");

    let snapshots = lines_until(&system, &["top", "--count", "2", "--interval", "500ms"], |snapshots| {
        let rows = |snapshot: &Value| snapshot["services"].as_array().unwrap()[..5].to_vec();
        snapshots.iter().flat_map(rows).all(|one| one["state"] == "running" && is_at_rate(&one))
    });
    assert_eq!(snapshots.len(), 2);
    for snapshot in &snapshots {
        let services = snapshot["services"].as_array().unwrap();
        let names: Vec<_> = services.iter().map(|one| one["service"].as_str().unwrap()).collect();
        assert_eq!(names, ["ingest", "gyro", "accel", "fuser", "course", "supervisor"]);
        for one in &services[..5] {
            assert_eq!(one["lost"], 0, "{one}");
            assert!(number(one, "resident_mib") > 1.0 && number(one, "cpu_percent") > 0.0, "{one}");
            let latency = &one["latency_us"];
            assert!(
                number(latency, "p50") <= number(latency, "p99") && number(latency, "p99") <= number(latency, "max")
            );
        }
        assert!(number(&snapshot["latency_us"], "p50") > 0.0, "{snapshot}");
    }

    let doctor = query_until(&system, &["doctor", "--for", "1"], |doctor| {
        doctor["checks"].as_array().unwrap().iter().all(|check| check["result"] != "problem")
    });
    let checks = doctor["checks"].as_array().unwrap();
    let found = |check: &str, words: &str| {
        checks.iter().any(|one| one["check"] == check && one["found"].as_str().unwrap().contains(words))
    };
    assert!(found("rates", "expected 1000.0 Hz") && found("services", "fuser running"), "{doctor}");
    assert!(found("flags", "rate-instant on ") && found("gravity", "the body moves"), "{doctor}");

    running.interrupt();
    running.wait().assert_complete();
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn rate_is_shown_every_second_and_at_the_end() {
    let system = System::new("");
    let running = start_system(&system, &[]);
    for verb in ["hz", "bw"] {
        let output = plumb(&["topic", verb, "attitude", "--for", "2", "--system", &system.name]).output().unwrap();
        let printed = String::from_utf8(output.stdout).unwrap();
        let lines: Vec<_> = printed.lines().collect();
        assert!((1..=2).contains(&lines.len()) && lines.iter().all(|line| line.starts_with("attitude: ")), "{printed}");
    }
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn killed_or_frozen_observer_costs_no_tick() {
    let system = System::new("buffer_s = 4.0\nlateness_s = 2.0\n");
    let running = start_system(&system, &[]);
    for (round, topic) in ["imu", "fused", "attitude", "gyro", "imu", "health"].iter().enumerate() {
        let observers: Vec<_> =
            [&["topic", "hz", topic][..], &["topic", "echo", topic], &["top", "--interval", "0.05"]]
                .iter()
                .map(|verb| Observer::start(&system, verb))
                .collect();
        std::thread::sleep(Duration::from_millis(40 + 60 * round as u64));
        observers.iter().for_each(|observer| signal(observer.pid(), Signal::KILL));
    }
    let frozen_observers: Vec<_> =
        (0..bus::MAX_OBSERVERS - 1).map(|_| Observer::start(&system, &["topic", "hz", "imu"])).collect();
    frozen_observers.iter().for_each(|observer| observer.wait_until_reading(&system, "imu"));
    frozen_observers.iter().for_each(|observer| signal(observer.pid(), Signal::STOP));
    // The wait is longer than `buffer_s`, so the buffers of the frozen observers overflow.
    std::thread::sleep(Duration::from_millis(6000));
    let restarted = running.service("fuser");
    signal(restarted, Signal::KILL);
    let has_restarted = |(service, pid): &(String, u32)| service == "fuser" && *pid != restarted;
    wait_for("the fuser to restart", || running.services().iter().any(has_restarted) && is_running(&system));
    std::thread::sleep(Duration::from_millis(500));
    for observer in frozen_observers {
        signal(observer.pid(), Signal::CONT);
        std::thread::sleep(Duration::from_millis(300));
        signal(observer.pid(), Signal::INT);
        let output = observer.output();
        let hz = &lines(&output)[0];
        assert!(hz["missed"].as_u64() > Some(1000), "messages missed while frozen: {hz}");
        assert_eq!(hz["lost"], 0, "{hz}");
    }
    running.interrupt();
    let run = running.wait();
    run.assert_complete();
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn excess_observer_is_rejected() {
    let system = System::new("");
    let running = start_system(&system, &[]);
    let top = Observer::start(&system, &["top"]);
    top.wait_until_reading(&system, "attitude");
    let observers: Vec<_> = (1..bus::MAX_OBSERVERS)
        .map(|_| {
            let mut observer = Observer::start(&system, &["topic", "echo", "imu"]);
            observer.first_line();
            observer
        })
        .collect();
    let rejected = run_json(&system, &["topic", "hz", "imu", "--count", "1"]);
    assert_eq!(rejected.status.code(), Some(1));
    assert!(stderr_text(&rejected).contains("4 observers are attached already"), "{}", stderr_text(&rejected));
    let mut pids: Vec<_> = [&top].into_iter().chain(&observers).map(Observer::pid).collect();
    let stderr = stderr_text(&rejected);
    let mut named: Vec<u32> = serde_json::from_str(stderr.rsplit("processes ").next().unwrap()).unwrap();
    pids.sort_unstable();
    named.sort_unstable();
    assert_eq!(named, pids, "{stderr}");
    let doctor = run_json(&system, &["doctor"]);
    let check = lines(&doctor)[0]["checks"].as_array().unwrap().last().unwrap().clone();
    // The observers take their places in any order.
    let is_killed = |pid: &u32| check["remedy"].as_str().unwrap().starts_with(&format!("`kill {pid}`"));
    assert!(pids.iter().any(is_killed), "{check}, observers {pids:?}");
    drop((observers, top));
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn ctrl_c_stops_observer_with_summary() {
    let system = System::new("");
    let running = start_system(&system, &[]);
    for verb in [&["topic", "hz", "imu"][..], &["topic", "bw", "imu"]] {
        let observer = Observer::start(&system, verb);
        observer.wait_until_reading(&system, "imu");
        std::thread::sleep(Duration::from_millis(300));
        signal(observer.pid(), Signal::INT);
        let output = observer.output();
        assert_eq!(output.status.code(), Some(0), "{}", stderr_text(&output));
        assert!(number(&lines(&output)[0], "messages") > 0.0);
    }
    let mut echo = Observer::start(&system, &["topic", "echo", "imu"]);
    echo.first_line();
    signal(echo.pid(), Signal::INT);
    let output = echo.output();
    assert_eq!(output.status.code(), Some(0));
    assert!(stderr_text(&output).contains("lost on the bus 0"), "{}", stderr_text(&output));
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn observer_stops_with_its_system() {
    let system = System::new("");
    let running = start_system(&system, &[]);
    let observer = Observer::start(&system, &["topic", "hz", "imu"]);
    observer.wait_until_reading(&system, "imu");
    running.interrupt();
    running.wait().assert_complete();
    let output = observer.output();
    assert_eq!(output.status.code(), Some(0), "{}", stderr_text(&output));
    assert!(stderr_text(&output).contains("has ended"), "{}", stderr_text(&output));
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn frozen_observer_does_not_affect_next_system() {
    let system = System::new("");
    let killed = start_system(&system, &[]);
    let observer = Observer::start(&system, &["topic", "hz", "imu"]);
    observer.wait_until_reading(&system, "imu");
    signal(observer.pid(), Signal::STOP);
    signal(killed.pid(), Signal::KILL);
    drop(killed);
    let running = start_system(&system, &[]);
    signal(observer.pid(), Signal::CONT);
    let output = observer.output();
    assert_eq!(output.status.code(), Some(0), "{}", stderr_text(&output));
    assert!(stderr_text(&output).contains("has ended"), "{}", stderr_text(&output));
    let hz = query(&system, &["topic", "hz", "imu", "--count", "100"]);
    assert_eq!((hz["messages"].as_u64(), hz["lost"].as_u64()), (Some(100), Some(0)), "{hz}");
    running.interrupt();
    running.wait().assert_complete();
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn missing_system_is_reported_and_doctor_still_runs() {
    let system = System::new("");
    for verb in [&["topic", "list"][..], &["topic", "hz", "imu"], &["top", "--count", "1"]] {
        let output = run_json(&system, verb);
        assert_eq!(output.status.code(), Some(1), "{verb:?}");
        let [object] = lines(&output).try_into().unwrap();
        assert!(object["error"].as_str().unwrap().contains("is not running"), "{object}");
        assert!(stderr_text(&output).contains("is not running"), "{}", stderr_text(&output));
    }
    let unknown = run_json(&system, &["topic", "hz"]);
    assert_eq!(unknown.status.code(), Some(2));
    let doctor = query(&system, &["doctor"]);
    let checks: Vec<_> =
        doctor["checks"].as_array().unwrap().iter().map(|one| one["check"].as_str().unwrap()).collect();
    assert!(
        ["shared-memory", "open-files", "clock-monotonic", "leftovers", "system"].iter().all(|it| checks.contains(it))
    );
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

/// Returns the doctor's `leftovers` check.
fn leftovers(output: &Output) -> Value {
    let [doctor] = lines(output).try_into().unwrap();
    let checks = doctor["checks"].as_array().unwrap();
    checks.iter().find(|check| check["check"] == "leftovers").unwrap().clone()
}

#[test]
fn doctor_removes_leftovers_of_killed_system() {
    let (dead, living) = (System::new(""), System::new(""));
    let (killed, running) = (start_system(&dead, &[]), start_system(&living, &[]));
    // This test takes the lock that every process of a system holds, so the test counts as a
    // process that has not ended.
    let member = fs::File::open(format!("/dev/shm/plumbline.{}.members", dead.name)).unwrap();
    rustix::fs::flock(&member, rustix::fs::FlockOperation::LockShared).unwrap();
    // The supervisor is frozen, so that it cannot restart the killed services.
    signal(killed.pid(), Signal::STOP);
    let services = killed.all_services();
    services.iter().for_each(|(_, pid)| signal(*pid, Signal::KILL));
    signal(killed.pid(), Signal::KILL);
    drop(killed);
    wait_for("the killed services to exit", || !services.iter().any(|(_, pid)| is_alive(*pid)));

    let lingering = run_json(&dead, &["doctor", "--fix"]);
    let check = leftovers(&lingering);
    assert_eq!((lingering.status.code(), check["result"].as_str()), (Some(1), Some("problem")), "{check}");
    assert!(check["remedy"].as_str().unwrap().contains(&format!("kill -KILL {}", std::process::id())), "{check}");
    let left = dead.leftovers();
    assert!(left.len() > 10, "files of a live process were removed: {left:?}");
    drop(member);

    let found = run_json(&dead, &["doctor"]);
    let check = leftovers(&found);
    assert_eq!((found.status.code(), check["result"].as_str()), (Some(1), Some("problem")), "{check}");
    assert_eq!(check["remedy"], format!("`plumb doctor --fix --system {}`", dead.name));
    assert_eq!(dead.leftovers(), left, "doctor without --fix removes nothing");
    let fixed = run_json(&dead, &["doctor", "--fix"]);
    let check = leftovers(&fixed);
    assert_eq!((fixed.status.code(), check["result"].as_str()), (Some(0), Some("ok")), "{check}");
    assert_eq!(dead.leftovers(), Vec::<String>::new());
    assert_eq!(leftovers(&run_json(&dead, &["doctor"]))["found"], "none");

    // The supervisor periodically removes the leftovers of killed observers, possibly before `plumb
    // doctor` finds them.
    let after_an_observer = |arguments: &[&str]| {
        let observer = Observer::start(&living, &["topic", "hz", "imu"]);
        observer.wait_until_reading(&living, "imu");
        signal(observer.pid(), Signal::KILL);
        drop(observer);
        run_json(&living, arguments)
    };
    wait_for("doctor to find the observer's leftovers", || {
        leftovers(&after_an_observer(&["doctor", "--for", "0.1"]))["result"] == "warning"
    });
    wait_for("doctor to remove the observer's leftovers", || {
        let fixed = after_an_observer(&["doctor", "--fix", "--for", "1"]);
        fixed.status.success() && leftovers(&fixed)["found"].as_str().unwrap().ends_with("removed")
    });
    running.interrupt();
    running.wait().assert_complete();
}

/// Writes a recording of sensors at rest at 100 Hz, with specific forces close to `force` in m/s².
fn write_rest_recording(system: &System, force: f64) -> PathBuf {
    let path = system.path("rest.csv");
    let row = |i: u32| {
        let noise = f64::from(i * 7919 % 101) * 1e-5;
        format!("{:.2},{noise},{},0.001,{noise},{},{}\n", f64::from(i) * 0.01, -noise, 2.0 * noise, force + noise)
    };
    fs::write(&path, "t_s,gx,gy,gz,ax,ay,az\n".to_owned() + &(0..6000).map(row).collect::<String>()).unwrap();
    path
}

#[test]
fn doctor_checks_sensors_at_rest() {
    for (force, code, result) in [(9.81, 0, "ok"), (1.0, 1, "problem")] {
        let system = System::new("");
        let recording = write_rest_recording(&system, force);
        let running = start_system(&system, &["--replay", recording.to_str().unwrap(), "--speed", "1"]);
        let output = run_json(&system, &["doctor", "--for", "1.5"]);
        let [doctor] = lines(&output).try_into().unwrap();
        let checks = doctor["checks"].as_array().unwrap();
        let named = |name: &str| checks.iter().find(|check| check["check"] == name).unwrap();
        assert_eq!((named("gravity")["result"].as_str(), output.status.code()), (Some(result), Some(code)), "{doctor}");
        assert!(named("gravity")["found"].as_str().unwrap().ends_with("at rest"), "{doctor}");
        assert_eq!(named("gyro-at-rest")["result"], "ok", "{doctor}");
        assert!(named("rates")["found"].as_str().unwrap().contains("expected 100.0 Hz"), "{doctor}");
        running.interrupt();
        running.wait();
    }
}
