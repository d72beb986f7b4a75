//! The attitude in the protocols of others: what arrives there is ours, and who does not take it is not felt on board.
use std::{
    io::{BufRead, BufReader, Write},
    net::UdpSocket,
    path::Path,
    process::{Child, Command, Stdio},
};

use crate::common::{System, attitudes, beyond::free_port, plumb, python::python, signal, until};
use rustix::process::Signal;
use serde_json::{Value, json};

const TUMBLE: &str = "ingest.sim.scenario = \"tumble\"";
/// A heartbeat's place of MAV_STATE, and a frame's of its message, its system and its component.
const STATE: usize = 17;
const MESSAGE: usize = 7;
const BOOT: u8 = 1;
const ACTIVE: u8 = 4;
const CRITICAL: u8 = 5;

fn bridge(system: &System, port: u16, more: &[&str]) -> Child {
    let to = format!("udpout:127.0.0.1:{port}");
    let mut command = plumb(&["bridge", "mavlink", "--json", "--system", &system.name, "--to", &to]);
    command.args(more).stdout(Stdio::piped()).spawn().unwrap()
}

/// What it says at its end.
fn ended(bridge: Child) -> Value {
    let output = bridge.wait_with_output().unwrap();
    assert!(output.status.success(), "{output:?}");
    serde_json::from_slice(&output.stdout).unwrap()
}

fn ticks(system: &System) -> u64 {
    let course = system.ps().into_iter().find(|one| one["service"] == "course");
    course.map_or(0, |one| one["ticks"].as_u64().unwrap())
}

#[test]
fn pymavlink_hears_the_attitude_that_the_system_writes() {
    let Some(python) = python() else { return };
    let system = System::new(TUMBLE);
    let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foreign/ground_station.py");
    let mut station = Command::new(python);
    let station = station.arg(script).args([&port.to_string(), "300"]).env("MAVLINK20", "1");
    let mut station = station.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(station.stdout.take().unwrap()).lines();
    let mut said = move || lines.next().expect("the station has ended").unwrap();
    assert_eq!(said(), "ready");

    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    system.all_run();
    let bridge = bridge(&system, port, &["--rate-hz", "100", "--system-id", "7", "--component-id", "191"]);
    assert_eq!(said(), "heard");
    system.assert_ends_undisturbed(running, &out, TUMBLE);
    let sent = ended(bridge);
    writeln!(station.stdin.take().unwrap(), "{}", out.display()).unwrap();
    let heard: Value = serde_json::from_str(&said()).unwrap();
    println!("{sent}\n{heard}");
    assert!(station.wait().unwrap().success());

    assert!(heard["compared"].as_u64().unwrap() >= 300 && heard["lost"] == 0 && heard["unmatched"] == 0, "{heard}");
    assert_eq!(heard["steps_ms"], json!([10]), "100 of 1000 Hz");
    let beats = heard["heartbeats"].as_array().unwrap();
    let companion = |state: u8| json!([7, 191, 18, 8, state]);
    assert!(beats.iter().all(|beat| *beat == companion(ACTIVE) || *beat == companion(BOOT)), "{heard}");
    assert!(beats.contains(&companion(ACTIVE)), "{heard}");
    let number = |name: &str| heard[name].as_f64().unwrap();
    assert!(number("quaternion_rad") < 1e-6 && number("angles_rad") < 1e-6, "single precision: {heard}");
    // From one attitude to the next there is what the stage corrects, too: little as a rule, more where it eases its first level.
    assert!(number("fastest_rad_s") > 0.5, "{heard}");
    assert!(number("usual_rate_rad_s") < 0.006 && number("rate_rad_s") < 0.06, "{heard}");
    assert_eq!((&sent["unaligned"], &sent["invalid"]), (&json!(0), &json!(0)), "{sent}");
}

#[test]
fn a_node_of_rmw_zenoh_hears_the_attitude_as_rosbags_reads_it() {
    let Some(python) = python() else { return };
    let system = System::new(TUMBLE);
    let port = free_port();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foreign/ros_node.py");
    let mut node = Command::new(python);
    let node = node.arg(script).args([&port.to_string(), "200"]);
    let mut node = node.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(node.stdout.take().unwrap()).lines();
    let mut said = move || lines.next().expect("the node has ended").unwrap();
    assert_eq!(said(), "ready");

    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    system.all_run();
    let to = format!("tcp/127.0.0.1:{port}");
    let mut bridge = plumb(&["bridge", "ros", "--json", "--system", &system.name, "--connect", &to]);
    let bridge = bridge.args(["--domain", "7", "--frame-id", "body"]).stdout(Stdio::piped()).spawn().unwrap();
    assert_eq!(said(), "heard");
    system.assert_ends_undisturbed(running, &out, TUMBLE);
    let sent = ended(bridge);
    writeln!(node.stdin.take().unwrap(), "{}", out.display()).unwrap();
    let heard: Value = serde_json::from_str(&said()).unwrap();
    println!("{sent}\n{heard}");
    assert!(node.wait().unwrap().success());

    assert_eq!((&sent["invalid"], &sent["dropped"]), (&json!(0), &json!(0)), "{sent}");
    // What rosbags computes of the definition is the hash in the key.
    let of_type = format!("sensor_msgs::msg::dds_::Imu_/{}", heard["hash"].as_str().unwrap());
    assert_eq!(heard["key"], format!("7/imu/data/{of_type}"));
    let tokens: Vec<(String, String)> = serde_json::from_value(heard["tokens"].clone()).unwrap();
    for kind in ["PUT", "DELETE"] {
        for (begins, ends) in [("NN", "%/%/plumbline"), ("MP", &format!("%imu%data/{of_type}/::,10:,:,:,,"))] {
            let is_it = |key: &str| key.split('/').nth(5) == Some(begins) && key.ends_with(ends);
            assert!(tokens.iter().any(|(of, key)| of == kind && is_it(key)), "{kind} {begins}: {tokens:?}");
        }
    }
    for name in ["whole", "covariances", "numbers_follow"] {
        assert_eq!(heard[name], true, "{name}: {heard}");
    }
    assert_eq!(heard["sender"], json!([16, 1, 33]), "{heard}");
    let number = |name: &str| heard[name].as_f64().unwrap();
    assert!(number("furthest") < 1e-15 && (number("step_ms") - 10.0).abs() < 0.5, "{heard}");
    assert!(number("fastest_rad_s") > 0.5 && number("rate_off_rad_s") < 0.05, "{heard}");
    assert!((number("force_m_s2") - 9.81).abs() < 0.1 && number("early_s") > 0.0, "{heard}");
}

#[test]
fn a_node_of_rmw_zenoh_gives_the_readings_of_a_system() {
    let Some(python) = python() else { return };
    let port = free_port();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foreign/ros_imu.py");
    let mut node = Command::new(python);
    let node = node.arg(script).arg(port.to_string()).stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut node = node.spawn().unwrap();
    let mut input = node.stdin.take().unwrap();
    let mut lines = BufReader::new(node.stdout.take().unwrap()).lines();
    let mut said = move || lines.next().expect("the node has ended").unwrap();
    assert_eq!(said(), "ready");

    let system = System::new("ingest.source = \"bus\"\ningest.bus.rate_hz = 200");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    let to = format!("tcp/127.0.0.1:{port}");
    let arguments = ["--system", &system.name, "--connect", &to, "--domain", "7", "--topic", "/vehicle/imu"];
    until("the system to take readings", || driver::Sensor::open(&system.name).is_ok());
    let mut bridge = plumb(&["bridge", "ros-sensor", "--json", "--mag", "vehicle/mag"]);
    let bridge = bridge.args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    writeln!(input, "begin").unwrap();
    until("attitudes", || ticks(&system) > 600);
    writeln!(input, "end").unwrap();
    let sent: Value = serde_json::from_str(&said()).unwrap();
    signal(bridge.id(), Signal::INT);
    let taken = ended(bridge);
    println!("{sent}\n{taken}");
    writeln!(input, "go").unwrap();
    assert!(node.wait().unwrap().success());
    running.interrupt();
    let run = running.wait();
    assert_eq!((run.code, run.number("/lost")), (Some(0), 0.0), "{}", run.people);

    // All that came since the bridge was there: good ones taken, damaged ones counted.
    let [imus, messages] = ["imus", "messages"].map(|name| sent[name].as_f64().unwrap());
    let [readings, refused, unheard, fields] =
        ["readings", "rejected", "undelivered", "fields"].map(|name| taken[name].as_f64().unwrap());
    assert_eq!(run.number("/ticks_in"), readings);
    assert!(unheard == 0.0 && readings <= imus && readings + refused <= messages, "{sent} {taken}");
    assert!((refused / readings - (messages - imus) / imus).abs() < 0.02 && fields > readings / 5.0, "{sent} {taken}");
    let tokens: Vec<(String, String)> = serde_json::from_value(sent["tokens"].clone()).unwrap();
    for of_type in
        ["%vehicle%imu/sensor_msgs::msg::dds_::Imu_/RIHS01_", "%vehicle%mag/sensor_msgs::msg::dds_::MagneticField_/"]
    {
        let is_it = |key: &str| key.split('/').nth(5) == Some("MS") && key.contains(of_type);
        assert!(tokens.iter().any(|(kind, key)| kind == "PUT" && is_it(key)), "{of_type}: {tokens:?}");
    }
    // It leans to the right by 20°, and turns by 10 °/s.
    let told = attitudes(&out);
    let last = &told[told.len() / 2..];
    let up = |[w, x, y, z]: [f64; 4]| [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)];
    let lean = 20f64.to_radians();
    let wanted = [-lean.sin(), 0.0, lean.cos()];
    let off = |q| up(q).iter().zip(wanted).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    let worst = last.iter().map(|(_, q)| off(*q)).fold(0.0, f64::max);
    assert!(worst < 0.01, "up is off by {worst}");
    let yaw = |[w, x, y, z]: [f64; 4]| (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z));
    let [(first_s, first), (last_s, end)] = [last[0], last[last.len() - 1]];
    let rate_deg_s = (yaw(end) - yaw(first)).to_degrees().rem_euclid(360.0) / (last_s - first_s);
    assert!((rate_deg_s - 10.0).abs() < 0.5, "it turns by {rate_deg_s} °/s");
}

#[test]
fn without_a_router_of_ros_the_bridge_says_so() {
    let system = System::new(TUMBLE);
    let running = system.start(&[]);
    system.all_run();
    let to = format!("tcp/127.0.0.1:{}", free_port());
    let output = plumb(&["bridge", "ros", "--system", &system.name, "--connect", &to]).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(1) && said.contains(&to), "{said}");
    running.interrupt();
    running.wait().assert_whole();
}

#[test]
fn nobody_who_listens_and_a_bridge_that_stands_still_are_not_felt_and_what_is_old_is_not_sent() {
    let system = System::new(TUMBLE);
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    system.all_run();
    let sockets = [(); 2].map(|()| UdpSocket::bind("127.0.0.1:0").unwrap());
    let ports = sockets.each_ref().map(|socket| socket.local_addr().unwrap().port());
    let bridges = ports.map(|port| bridge(&system, port, &["--rate-hz", "1000"]));
    for socket in &sockets {
        let mut bytes = [0; 300];
        until("an attitude", || socket.recv(&mut bytes).is_ok() && bytes[MESSAGE] != 0);
    }
    // One is there and reads no more, the other one goes.
    let [_frozen, gone] = sockets;
    drop(gone);
    let stopped = &bridges[1];
    signal(stopped.id(), Signal::STOP);
    let before = ticks(&system);
    until("two seconds of ticks", || ticks(&system) > before + 2000);
    signal(stopped.id(), Signal::CONT);
    let before = ticks(&system);
    until("a second of ticks", || ticks(&system) > before + 1000);
    system.assert_ends_undisturbed(running, &out, TUMBLE);
    let [frozen, stopped] = bridges.map(ended);
    println!("{frozen}\n{stopped}");
    for sent in [&frozen, &stopped] {
        assert!(sent["attitudes"].as_u64().unwrap() > 100, "{sent}");
    }
    assert!(stopped["stale"].as_u64().unwrap() > 500, "{stopped}");
}

#[test]
fn a_heartbeat_tells_that_attitudes_have_not_begun_are_sent_or_have_stopped() {
    let system = System::new("ingest.source = \"stdin\"\ningest.stdin.rate_hz = 100");
    let mut command = system.command(&[]);
    command.stdin(Stdio::piped());
    let mut running = crate::common::Running::of(command);
    let mut input = running.stdin();
    let station = UdpSocket::bind("127.0.0.1:0").unwrap();
    until("the system to answer", || !system.ps().is_empty());
    let bridge = bridge(&system, station.local_addr().unwrap().port(), &[]);
    let mut attitudes = 0;
    let mut heartbeat = || {
        let mut bytes = [0; 300];
        loop {
            let length = station.recv(&mut bytes).unwrap();
            match bytes[MESSAGE] {
                0 => return (bytes[..length][STATE], attitudes),
                _ => attitudes += 1,
            }
        }
    };
    assert_eq!(heartbeat(), (BOOT, 0));
    // Then nothing more comes, and the source does not end.
    for row in 0..500 {
        writeln!(input, "{},0,0,0,0,0,9.81", f64::from(row) * 0.01).unwrap();
    }
    input.flush().unwrap();
    until("a heartbeat after attitudes", || {
        let (state, attitudes) = heartbeat();
        assert!([BOOT, ACTIVE, CRITICAL].contains(&state));
        state == CRITICAL && attitudes > 0
    });
    drop(input);
    running.wait().assert_whole();
    let sent = ended(bridge);
    println!("{sent}");
    assert!(sent["heartbeats"].as_u64().unwrap() >= 2, "{sent}");
}
