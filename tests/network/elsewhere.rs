//! `plumb topic --remote`: what is seen on board is seen from elsewhere, what was lost on the way is told, and what cannot be known is not
//! made up.
use std::{
    io::{BufRead, BufReader, Read},
    process::{Child, Output, Stdio},
};

use crate::common::{
    Running, System,
    beyond::{endpoint, free_port, gateway, with_gateway},
    plumb, signal,
    terminal::OnTerminal,
    until,
};
use rustix::process::Signal;
use serde_json::Value;

/// A vehicle in flight and where its gateway is.
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

    fn ask(&self, arguments: &[&str]) -> Output {
        plumb(arguments).args(["--remote", "boat", "--connect", &self.endpoint]).output().unwrap()
    }

    /// What a verb says to scripts: the JSON on each line.
    fn lines(&self, arguments: &[&str]) -> Vec<Value> {
        let output = self.ask(&[arguments, &["--json"]].concat());
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", said(&output));
        let text = String::from_utf8(output.stdout).unwrap();
        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    }

    fn answer(&self, arguments: &[&str]) -> Value {
        let [answer] = self.lines(arguments).try_into().unwrap();
        answer
    }

    /// The same on board.
    fn on_board(&self, arguments: &[&str]) -> Value {
        let output = plumb(arguments).args(["--json", "--system", &self.system.name]).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", said(&output));
        serde_json::from_slice(&output.stdout).unwrap()
    }

    fn end(self) {
        self.running.interrupt();
        self.running.wait().assert_whole();
    }
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn number(value: &Value, key: &str) -> f64 {
    value.pointer(key).and_then(Value::as_f64).unwrap_or_else(|| panic!("no {key} in {value}"))
}

/// Names of an object's fields, but those that only an observer elsewhere has.
fn names(value: &Value) -> Vec<&String> {
    value.as_object().unwrap().keys().filter(|name| *name != "delivery").collect()
}

#[test]
fn the_attitude_is_in_the_frame_of_the_launch_file_on_board_and_elsewhere() {
    let vehicle = Vehicle::start("[output]\nframe = \"ned-frd\"\nquaternion = \"xyzw\"\n");
    let echo = ["topic", "echo", "attitude", "--count", "1"];
    let [on_board, elsewhere] = [vehicle.on_board(&echo), vehicle.answer(&echo)];
    for message in [&on_board, &elsewhere] {
        assert_eq!((message["frame"].as_str(), message["quaternion_order"].as_str()), (Some("ned-frd"), Some("xyzw")));
        let [x, y, z, w] = [0, 1, 2, 3].map(|i| number(&message["quaternion"], &format!("/{i}")));
        let yaw = number(message, "/yaw_rad");
        let of_quaternion = (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z));
        let apart = |a: f64, b: f64| (a - b).sin().abs().max(1.0 - (a - b).cos());
        assert!(apart(yaw, of_quaternion) < 1e-9, "about down: {message}");
        // Clockwise from above, as the course is.
        assert!(apart(yaw, number(message, "/course_rad")) < 1e-9, "{message}");
    }
    let fused = vehicle.answer(&["topic", "echo", "fused", "--count", "1"]);
    assert!(fused.get("frame").is_none(), "{fused}");
    vehicle.end();
}

#[test]
fn every_verb_shows_from_elsewhere_what_it_shows_on_board_and_says_what_it_cannot_know() {
    let vehicle = Vehicle::start("rates = { imu = \"all\" }");

    let list = vehicle.answer(&["topic", "list"]);
    let topics: Vec<_> = list.as_array().unwrap().iter().map(|one| one["topic"].as_str().unwrap()).collect();
    assert_eq!(topics, ["imu", "gnss", "fused", "attitude", "difference", "control", "health"], "what it sends");
    let on_board = vehicle.on_board(&["topic", "list"]);
    let of =
        |list: &Value, topic: &str| list.as_array().unwrap().iter().find(|one| one["topic"] == topic).unwrap().clone();
    for topic in ["imu", "fused", "attitude"] {
        let (here, there) = (of(&list, topic), of(&on_board, topic));
        assert_eq!((names(&here), &here["type"]), (names(&there), &there["type"]));
        assert!(["publishers", "subscribers", "buffer"].iter().all(|unknown| here[unknown].is_null()), "{here}");
    }
    assert!((30.0..70.0).contains(&number(&of(&list, "attitude"), "/rate_hz")), "50 of 1000 Hz: {list}");
    let text = vehicle.ask(&["topic", "list"]);
    let text = String::from_utf8(text.stdout).unwrap();
    assert!(text.contains("what boat sends") && text.contains("buffers are known on board only"), "{text}");

    let (info, on_board) = (vehicle.answer(&["topic", "info", "fused"]), vehicle.on_board(&["topic", "info", "fused"]));
    assert_eq!(
        (names(&info), &info["fields"], &info["size"]),
        (names(&on_board), &on_board["fields"], &on_board["size"])
    );
    assert!(info["fingerprint"].is_null() && info["publishers"].is_null(), "{info}");

    let messages = vehicle.lines(&["topic", "echo", "imu", "--count", "3", "--every", "5"]);
    let ticks: Vec<_> = messages.iter().map(|message| message["tick"].as_u64().unwrap()).collect();
    assert!(ticks.len() == 3 && ticks.windows(2).all(|pair| pair[1] == pair[0] + 5), "{ticks:?}");
    let on_board = vehicle.on_board(&["topic", "echo", "imu", "--count", "1"]);
    assert_eq!((names(&messages[0]), &messages[0]["flags"]), (names(&on_board), &on_board["flags"]));

    let hz = vehicle.answer(&["topic", "hz", "imu", "--seconds", "2"]);
    println!("{hz}");
    assert!((500.0..1500.0).contains(&number(&hz, "/rate_hz")), "{hz}");
    assert_eq!(
        (hz["measured_by"].as_str(), hz["lost"].as_u64(), hz["missed"].as_u64()),
        (Some("sent"), Some(0), Some(0))
    );
    assert_eq!((number(&hz, "/delivery/decimated"), number(&hz, "/delivery/dropped")), (0.0, 0.0), "{hz}");

    let bw = vehicle.answer(&["topic", "bw", "attitude", "--count", "60"]);
    println!("{bw}");
    assert_eq!((names(&bw), bw["messages"].as_u64()), (names(&hz), Some(60)));
    // A message has 224 bytes on board; over the network come its envelope with it, and no zeros.
    let bytes = number(&bw, "/bytes_per_s") / number(&bw, "/rate_hz");
    assert!((100.0..400.0).contains(&bytes), "{bw}");
    // Of each 20 ticks 19 stay on board, and none of them is missed.
    assert!((19.0 * 40.0..=19.0 * 80.0).contains(&number(&bw, "/delivery/decimated")), "{bw}");
    assert_eq!((bw["lost"].as_u64(), bw["missed"].as_u64()), (Some(0), Some(0)), "{bw}");
    vehicle.end();
}

#[test]
fn an_unknown_vehicle_or_topic_is_said_with_the_remedy() {
    let vehicle = Vehicle::start("");
    let unknown =
        plumb(&["topic", "hz", "attitude", "--remote", "buoy", "--connect", &vehicle.endpoint]).output().unwrap();
    assert_eq!((unknown.status.code(), unknown.stdout.len()), (Some(1), 0));
    let text = said(&unknown);
    assert!(
        text.contains("the vehicle \"buoy\"") && text.contains("within 5 s") && text.contains("`plumb station`"),
        "{text}"
    );

    let nowhere = format!("tcp/127.0.0.1:{}", free_port());
    let nobody = plumb(&["topic", "list", "--remote", "boat", "--connect", &nowhere]).output().unwrap();
    assert_eq!(nobody.status.code(), Some(1));
    assert!(said(&nobody).contains(&nowhere) && said(&nobody).contains("no process listens there"), "{}", said(&nobody));

    for verb in ["echo", "hz", "bw", "info"] {
        let unknown = vehicle.ask(&["topic", verb, "altitude"]);
        assert_eq!(unknown.status.code(), Some(2), "{}", said(&unknown));
        assert!(said(&unknown).contains("there are sensor, receiver, imu"), "{}", said(&unknown));
        let unsent = vehicle.ask(&["topic", verb, "imu"]);
        assert_eq!(unsent.status.code(), Some(1), "{}", said(&unsent));
        assert!(said(&unsent).contains("does not publish `imu`, only gnss, fused, attitude"), "{}", said(&unsent));
        assert!(said(&unsent).contains("[gateway.rates]"), "{}", said(&unsent));
    }
    // What is on board only does not quietly look at another system.
    for verb in ["top", "doctor"] {
        assert_eq!(vehicle.ask(&[verb]).status.code(), Some(2), "{verb}");
    }
    vehicle.end();
}

/// `plumb topic echo`, which goes when the test does.
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
fn a_gateway_that_is_killed_is_followed_into_its_next_life() {
    let vehicle = Vehicle::start("");
    let mut echo = Echo::start(&vehicle);
    let mut lines = BufReader::new(echo.0.stdout.take().unwrap()).lines();
    let mut tick = || -> u64 {
        let message: Value = serde_json::from_str(&lines.next().unwrap().unwrap()).unwrap();
        message["tick"].as_u64().unwrap()
    };
    tick();
    signal(gateway(&vehicle.system).unwrap()["pid"].as_u64().unwrap() as u32, Signal::KILL);
    until("the next gateway", || {
        gateway(&vehicle.system).is_some_and(|one| one["restarts"] == 1 && one["address"].is_string())
    });
    let attitudes = vehicle.on_board(&["topic", "echo", "attitude", "--count", "1"]);
    let restarted = attitudes["tick"].as_u64().unwrap();
    while tick() <= restarted {}
    signal(echo.0.id(), Signal::INT);
    let mut summary = String::new();
    echo.0.stderr.take().unwrap().read_to_string(&mut summary).unwrap();
    assert!(summary.contains("lost on the bus 0") && summary.contains("gateway restarts 1"), "{summary}");
    vehicle.end();
}

#[test]
fn an_observation_ends_when_its_vehicle_stays_away() {
    let vehicle = Vehicle::start("");
    let mut echo = Echo::start(&vehicle);
    let mut lines = BufReader::new(echo.0.stdout.take().unwrap()).lines();
    lines.next().unwrap().unwrap();
    vehicle.end();
    assert!(lines.all(|line| line.is_ok()));
    let mut summary = String::new();
    echo.0.stderr.take().unwrap().read_to_string(&mut summary).unwrap();
    assert!(summary.contains("vehicle \"boat\" has been unreachable for 10 s"), "{summary}");
    assert_eq!(echo.0.wait().unwrap().code(), Some(0));
}

#[test]
fn a_station_shows_every_vehicle_on_a_terminal_of_80_columns_and_one_in_detail() {
    let vehicle = Vehicle::start("");
    let port = free_port();
    let other = with_gateway(port, "vehicle = \"car\"\n");
    let other_runs = other.start(&[]);
    let ends = [vehicle.endpoint.clone(), endpoint(&other)];
    let command = plumb(&["station", "--connect", &ends[0], "--connect", &ends[1]]);
    let mut terminal = OnTerminal::start(command, (24, 80));
    let line_of = |text: &str, name: &str| {
        let line = text.lines().find(|line| line.starts_with(&format!("│{name} "))).map(str::to_owned);
        line.unwrap_or_default().trim_end_matches(['│', ' ']).to_owned()
    };
    terminal.shows_that("both vehicles live", |text| {
        ["boat", "car"].iter().all(|name| line_of(text, name).ends_with("live"))
    });
    let bar = |text: &str| text.lines().next().unwrap_or_default().to_owned();
    let text =
        terminal.shows_that("the boat in detail", |text| bar(text).starts_with("boat  live  lost 0  latency p50"));
    for words in ["horizon", "attitude, enu-rfu", "last minute", "lost messages", "topics of boat", "course"] {
        assert!(text.contains(words), "{words:?}: {text}");
    }
    // Arrow down, then up again.
    terminal.press("\u{1b}[B");
    terminal.shows(&["topics of car"]);
    terminal.press("\u{1b}[A");
    terminal.shows(&["topics of boat"]);
    vehicle.end();
    let text = terminal.shows(&["ended: its gateway is unreachable"]);
    assert!(line_of(&text, "car").ends_with("live"), "{text}");
    terminal.press("q");
    assert_eq!(terminal.ends().code(), Some(0));
    until("the terminal to be given back", || terminal.is_given_back());
    other_runs.interrupt();
    other_runs.wait().assert_whole();
}
