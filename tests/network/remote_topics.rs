//! `plumb topic --remote` shows the same values as `plumb topic` on board, and also counts network
//! losses. Values unknown to a remote observer are null.
use std::{
    io::{BufRead, BufReader, Read},
    process::{Child, Output, Stdio},
};

use crate::common::{
    Running, System, plumb,
    remote::{endpoint, free_port, gateway, with_gateway},
    signal,
    terminal::TerminalProgram,
    wait_for,
};
use rustix::process::Signal;
use serde_json::Value;

/// Running vehicle and the endpoint of its gateway.
struct Vehicle {
    system: System,
    running: Running,
    endpoint: String,
}

impl Vehicle {
    fn start(more: &str) -> Self {
        let system = with_gateway(free_port(), &format!("vehicle = \"boat\"\n{more}"));
        let running = system.start(&[]);
        let endpoint = endpoint(&system);
        Self { system, running, endpoint }
    }

    fn run(&self, arguments: &[&str]) -> Output {
        plumb(arguments).args(["--remote", "boat", "--connect", &self.endpoint]).output().unwrap()
    }

    /// Returns the JSON values that a command prints, one per line.
    fn run_json_lines(&self, arguments: &[&str]) -> Vec<Value> {
        let output = self.run(&[arguments, &["--json"]].concat());
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", stderr(&output));
        let text = String::from_utf8(output.stdout).unwrap();
        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    }

    fn run_json(&self, arguments: &[&str]) -> Value {
        let [value] = self.run_json_lines(arguments).try_into().unwrap();
        value
    }

    /// Returns the JSON output of a command on board.
    fn run_json_on_board(&self, arguments: &[&str]) -> Value {
        let output = plumb(arguments).args(["--json", "--system", &self.system.name]).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", stderr(&output));
        serde_json::from_slice(&output.stdout).unwrap()
    }

    fn stop(self) {
        self.running.interrupt();
        self.running.wait().assert_complete();
    }
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn number(value: &Value, key: &str) -> f64 {
    value.pointer(key).and_then(Value::as_f64).unwrap_or_else(|| panic!("no {key} in {value}"))
}

/// Returns the field names of an object, except `delivery`, which only remote observers have.
fn names(value: &Value) -> Vec<&String> {
    value.as_object().unwrap().keys().filter(|name| *name != "delivery").collect()
}

#[test]
fn output_frame_is_same_on_board_and_remotely() {
    let vehicle = Vehicle::start("[output]\nframe = \"ned-frd\"\nquaternion = \"xyzw\"\n");
    let echo = ["topic", "echo", "attitude", "--count", "1"];
    let [on_board, remote] = [vehicle.run_json_on_board(&echo), vehicle.run_json(&echo)];
    for message in [&on_board, &remote] {
        assert_eq!((message["frame"].as_str(), message["quaternion_order"].as_str()), (Some("ned-frd"), Some("xyzw")));
        let [x, y, z, w] = [0, 1, 2, 3].map(|i| number(&message["quaternion"], &format!("/{i}")));
        let yaw = number(message, "/yaw_rad");
        let quaternion_yaw = (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z));
        let angle_difference = |a: f64, b: f64| (a - b).sin().abs().max(1.0 - (a - b).cos());
        assert!(angle_difference(yaw, quaternion_yaw) < 1e-9, "yaw about down: {message}");
        // Yaw is clockwise seen from above, like the course.
        assert!(angle_difference(yaw, number(message, "/course_rad")) < 1e-9, "{message}");
    }
    let fused = vehicle.run_json(&["topic", "echo", "fused", "--count", "1"]);
    assert!(fused.get("frame").is_none(), "{fused}");
    vehicle.stop();
}

#[test]
fn remote_topic_commands_match_on_board_output() {
    let vehicle = Vehicle::start("rates = { imu = \"all\" }");

    let list = vehicle.run_json(&["topic", "list"]);
    let topics: Vec<_> =
        list["topics"].as_array().unwrap().iter().map(|entry| entry["topic"].as_str().unwrap()).collect();
    assert_eq!(
        topics,
        ["imu", "gnss", "fused", "attitude", "difference", "control", "health"],
        "topics published by the gateway"
    );
    let on_board = vehicle.run_json_on_board(&["topic", "list"]);
    let find = |list: &Value, topic: &str| {
        list["topics"].as_array().unwrap().iter().find(|entry| entry["topic"] == topic).unwrap().clone()
    };
    for topic in ["imu", "fused", "attitude"] {
        let (remote, local) = (find(&list, topic), find(&on_board, topic));
        assert_eq!((names(&remote), &remote["type"]), (names(&local), &local["type"]));
        assert!(["publishers", "subscribers", "buffer"].iter().all(|unknown| remote[unknown].is_null()), "{remote}");
    }
    assert!((30.0..70.0).contains(&number(&find(&list, "attitude"), "/rate_hz")), "50 of 1000 Hz: {list}");
    let text = vehicle.run(&["topic", "list"]);
    let text = String::from_utf8(text.stdout).unwrap();
    assert!(
        text.contains("topics of boat as received here") && text.contains("buffers are known on board only"),
        "{text}"
    );

    let (info, on_board) =
        (vehicle.run_json(&["topic", "info", "fused"]), vehicle.run_json_on_board(&["topic", "info", "fused"]));
    assert_eq!(
        (names(&info), &info["fields"], &info["size"]),
        (names(&on_board), &on_board["fields"], &on_board["size"])
    );
    assert!(info["fingerprint"].is_null() && info["publishers"].is_null(), "{info}");

    let messages = vehicle.run_json_lines(&["topic", "echo", "imu", "--count", "3", "--every", "5"]);
    let ticks: Vec<_> = messages.iter().map(|message| message["tick"].as_u64().unwrap()).collect();
    assert!(ticks.len() == 3 && ticks.windows(2).all(|pair| pair[1] == pair[0] + 5), "{ticks:?}");
    let on_board = vehicle.run_json_on_board(&["topic", "echo", "imu", "--count", "1"]);
    assert_eq!((names(&messages[0]), &messages[0]["flags"]), (names(&on_board), &on_board["flags"]));

    let hz = vehicle.run_json(&["topic", "hz", "imu", "--for", "2"]);
    println!("{hz}");
    assert!((500.0..1500.0).contains(&number(&hz, "/rate_hz")), "{hz}");
    assert_eq!(
        (hz["measured_by"].as_str(), hz["lost"].as_u64(), hz["missed"].as_u64()),
        (Some("sent"), Some(0), Some(0))
    );
    assert_eq!((number(&hz, "/delivery/decimated"), number(&hz, "/delivery/dropped")), (0.0, 0.0), "{hz}");

    let bw = vehicle.run_json(&["topic", "bw", "attitude", "--count", "60"]);
    println!("{bw}");
    assert_eq!((names(&bw), bw["messages"].as_u64()), (names(&hz), Some(60)));
    // On board, a message has 224 bytes. Over the network, an envelope is added, but zero values
    // are not sent.
    let bytes = number(&bw, "/bytes_per_s") / number(&bw, "/rate_hz");
    assert!((100.0..400.0).contains(&bytes), "{bw}");
    // Decimation on board omits 19 of 20 ticks. Omitted ticks do not count as missed.
    assert!((19.0 * 40.0..=19.0 * 80.0).contains(&number(&bw, "/delivery/decimated")), "{bw}");
    assert_eq!((bw["lost"].as_u64(), bw["missed"].as_u64()), (Some(0), Some(0)), "{bw}");
    vehicle.stop();
}

#[test]
fn unknown_vehicle_or_topic_is_reported_with_remedy() {
    let vehicle = Vehicle::start("");
    let unknown =
        plumb(&["topic", "hz", "attitude", "--remote", "buoy", "--connect", &vehicle.endpoint]).output().unwrap();
    assert_eq!((unknown.status.code(), unknown.stdout.len()), (Some(1), 0));
    let text = stderr(&unknown);
    assert!(
        text.contains("vehicle \"buoy\" did not reply")
            && text.contains("within 5 s")
            && text.contains("`plumb station`"),
        "{text}"
    );

    let unused = format!("tcp/127.0.0.1:{}", free_port());
    let unreachable = plumb(&["topic", "list", "--remote", "boat", "--connect", &unused]).output().unwrap();
    assert_eq!(unreachable.status.code(), Some(1));
    assert!(
        stderr(&unreachable).contains(&unused) && stderr(&unreachable).contains("no process listens there"),
        "{}",
        stderr(&unreachable)
    );

    for verb in ["echo", "hz", "bw", "info"] {
        let unknown = vehicle.run(&["topic", verb, "altitude"]);
        assert_eq!(unknown.status.code(), Some(2), "{}", stderr(&unknown));
        assert!(stderr(&unknown).contains("expected one of sensor, receiver, imu"), "{}", stderr(&unknown));
        let unpublished = vehicle.run(&["topic", verb, "imu"]);
        assert_eq!(unpublished.status.code(), Some(1), "{}", stderr(&unpublished));
        assert!(stderr(&unpublished).contains("does not publish `imu`"), "{}", stderr(&unpublished));
        assert!(stderr(&unpublished).contains("[gateway.rates]"), "{}", stderr(&unpublished));
    }
    // Commands that work only on board reject --remote.
    for verb in ["top", "doctor"] {
        assert_eq!(vehicle.run(&[verb]).status.code(), Some(2), "{verb}");
    }
    vehicle.stop();
}

/// `plumb topic echo`; killed on drop.
struct Echo(Child);

impl Echo {
    fn start(vehicle: &Vehicle) -> Self {
        let mut command = plumb(&["topic", "echo", "attitude", "--json", "--remote", "boat"]);
        command.args(["--connect", &vehicle.endpoint]).stdout(Stdio::piped()).stderr(Stdio::piped());
        Self(command.spawn().unwrap())
    }
}

impl Drop for Echo {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn echo_follows_restarted_gateway() {
    let vehicle = Vehicle::start("");
    let mut echo = Echo::start(&vehicle);
    let mut lines = BufReader::new(echo.0.stdout.take().unwrap()).lines();
    let mut tick = || -> u64 {
        let message: Value = serde_json::from_str(&lines.next().unwrap().unwrap()).unwrap();
        message["tick"].as_u64().unwrap()
    };
    tick();
    signal(gateway(&vehicle.system).unwrap()["pid"].as_u64().unwrap() as u32, Signal::KILL);
    wait_for("the next gateway", || {
        gateway(&vehicle.system).is_some_and(|entry| entry["restarts"] == 1 && entry["address"].is_string())
    });
    let attitudes = vehicle.run_json_on_board(&["topic", "echo", "attitude", "--count", "1"]);
    let restarted = attitudes["tick"].as_u64().unwrap();
    while tick() <= restarted {}
    signal(echo.0.id(), Signal::INT);
    let mut summary = String::new();
    echo.0.stderr.take().unwrap().read_to_string(&mut summary).unwrap();
    assert!(summary.contains("lost on the bus 0") && summary.contains("gateway restarts 1"), "{summary}");
    vehicle.stop();
}

#[test]
fn echo_ends_when_vehicle_stays_unreachable() {
    let vehicle = Vehicle::start("");
    let mut echo = Echo::start(&vehicle);
    let mut lines = BufReader::new(echo.0.stdout.take().unwrap()).lines();
    lines.next().unwrap().unwrap();
    vehicle.stop();
    assert!(lines.all(|line| line.is_ok()));
    let mut summary = String::new();
    echo.0.stderr.take().unwrap().read_to_string(&mut summary).unwrap();
    assert!(summary.contains("vehicle \"boat\" has been unreachable for 10 s"), "{summary}");
    assert_eq!(echo.0.wait().unwrap().code(), Some(0));
}

#[test]
fn station_terminal_shows_fleet_and_selected_vehicle() {
    let vehicle = Vehicle::start("");
    let port = free_port();
    let other = with_gateway(port, "vehicle = \"car\"\n");
    let other_running = other.start(&[]);
    let endpoints = [vehicle.endpoint.clone(), endpoint(&other)];
    let command = plumb(&["station", "--connect", &endpoints[0], "--connect", &endpoints[1]]);
    let mut terminal = TerminalProgram::start(command, (24, 80));
    let line_of = |text: &str, name: &str| {
        let line = text.lines().find(|line| line.starts_with(&format!("│{name} "))).map(str::to_owned);
        line.unwrap_or_default().trim_end_matches(['│', ' ']).to_owned()
    };
    terminal.wait_for_screen("both vehicles live", |text| {
        ["boat", "car"].iter().all(|name| line_of(text, name).ends_with("live"))
    });
    let bar = |text: &str| text.lines().next().unwrap_or_default().to_owned();
    let text =
        terminal.wait_for_screen("the boat in detail", |text| bar(text).starts_with("boat  live  lost 0  latency p50"));
    for words in ["horizon", "attitude, enu-rfu", "last minute", "lost messages", "topics of boat", "course"] {
        assert!(text.contains(words), "{words:?}: {text}");
    }
    // Arrow down, then up again.
    terminal.press("\u{1b}[B");
    terminal.wait_for_text(&["topics of car"]);
    terminal.press("\u{1b}[A");
    terminal.wait_for_text(&["topics of boat"]);
    vehicle.stop();
    let text = terminal.wait_for_text(&["ended: its gateway is unreachable"]);
    assert!(line_of(&text, "car").ends_with("live"), "{text}");
    terminal.press("q");
    assert_eq!(terminal.wait_for_exit().code(), Some(0));
    wait_for("the terminal to be restored", || terminal.is_restored());
    other_running.interrupt();
    other_running.wait().assert_complete();
}
