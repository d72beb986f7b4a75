//! Attitude and readings over MAVLink and ROS 2, checked with independent implementations. A
//! stalled receiver must not affect the system.
use std::{
    io::{BufRead, BufReader, Write},
    net::UdpSocket,
    path::Path,
    process::{Child, Command, Stdio},
    time::Duration,
};

use crate::common::{
    System, attitudes, plumb,
    python::python,
    remote::{endpoint, free_port, with_gateway},
    signal, wait_for,
    walk::Walk,
};
use bridges::ros_messages::encode_imu;
use messages::{AttitudeOutput, ImuSample};
use rustix::process::Signal;
use serde_json::{Value, json};
use zenoh::{Config, Session, Wait, qos::CongestionControl};

const TUMBLE: &str = "ingest.sim.scenario = \"tumble\"";
/// Offset of MAV_STATE in a heartbeat frame, in bytes.
const STATE: usize = 17;
/// Offset of the message ID in a frame, in bytes. Heartbeats have the ID 0.
const MESSAGE: usize = 7;
const BOOT: u8 = 1;
const ACTIVE: u8 = 4;
const CRITICAL: u8 = 5;

fn bridge(system: &System, port: u16, more: &[&str]) -> Child {
    let to = format!("udpout:127.0.0.1:{port}");
    let mut command = plumb(&["bridge", "mavlink", "--json", "--system", &system.name, "--to", &to]);
    command.args(more).stdout(Stdio::piped()).spawn().unwrap()
}

/// Starts a program of tests/foreign and waits until it prints `ready`. Returns the function that
/// reads its next line.
fn start_foreign(python: &Path, script: &str, arguments: &[&str]) -> (Child, impl FnMut() -> String + use<>) {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foreign").join(script);
    let mut command = Command::new(python);
    command.arg(script).args(arguments).env("MAVLINK20", "1").stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut program = command.spawn().unwrap();
    let mut lines = BufReader::new(program.stdout.take().unwrap()).lines();
    let mut next_line = move || lines.next().expect("the program exited early").unwrap();
    assert_eq!(next_line(), "ready");
    (program, next_line)
}

/// Passes the path of an attitude file to a program of tests/foreign and returns its report.
fn foreign_report(mut program: Child, out: &Path, mut next_line: impl FnMut() -> String) -> Value {
    writeln!(program.stdin.take().unwrap(), "{}", out.display()).unwrap();
    let report = serde_json::from_str(&next_line()).unwrap();
    assert!(program.wait().unwrap().success());
    report
}

/// Waits for a bridge and returns its report.
fn final_report(bridge: Child) -> Value {
    let output = bridge.wait_with_output().unwrap();
    assert!(output.status.success(), "{output:?}");
    serde_json::from_slice(&output.stdout).unwrap()
}

fn ticks(system: &System) -> u64 {
    let course = system.ps().into_iter().find(|entry| entry["service"] == "course");
    course.map_or(0, |entry| entry["ticks"].as_u64().unwrap())
}

#[test]
fn mavlink_bridge_matches_attitude_file_in_pymavlink() {
    let Some(python) = python() else { return };
    let mut walk = Walk::start("integrator, MAVLink");
    let system = System::new(TUMBLE);
    let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let (station, mut next_line) = start_foreign(python, "ground_station.py", &[&port.to_string(), "300"]);

    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    system.wait_until_running();
    walk.step("start a system");
    let bridge = bridge(&system, port, &["--rate-hz", "100", "--system-id", "7"]);
    assert_eq!(next_line(), "received");
    walk.step("start the bridge, receive 300 attitudes in pymavlink");
    system.stop_and_assert_undisturbed(running, &out, TUMBLE);
    let sent = final_report(bridge);
    let report = foreign_report(station, &out, next_line);
    println!("{sent}\n{report}");

    assert!(report["compared"].as_u64().unwrap() >= 300 && report["lost"] == 0 && report["unmatched"] == 0, "{report}");
    assert_eq!(report["steps_ms"], json!([10]), "100 of 1000 Hz");
    let beats = report["heartbeats"].as_array().unwrap();
    let companion = |state: u8| json!([7, 191, 18, 8, state]);
    assert!(beats.iter().all(|beat| *beat == companion(ACTIVE) || *beat == companion(BOOT)), "{report}");
    assert!(beats.contains(&companion(ACTIVE)), "{report}");
    assert!(report["odometry"].as_u64().unwrap() >= 300 && report["unequal_odometry"] == 0, "{report}");
    assert_eq!((&report["unknown_is_nan"], &report["variances"]), (&json!(true), &json!(true)), "{report}");
    // The earth frame is MAV_FRAME_LOCAL_FRD, because the course does not refer to true north. The
    // body frame is MAV_FRAME_BODY_FRD.
    assert_eq!(report["frames"], json!([[20, 12, 0, 0]]));
    assert_eq!((&report["positions"], &sent["fixes"]), (&json!([]), &json!(0)), "simulated fixes have no position");
    let number = |name: &str| report[name].as_f64().unwrap();
    assert!(number("quaternion_rad") < 1e-6 && number("angles_rad") < 1e-6, "beyond single precision: {report}");
    // Between two attitudes, the fuser applies corrections in addition to the measured rotation.
    // These corrections are usually small, but larger during the initial levelling.
    assert!(number("fastest_rad_s") > 0.5, "{report}");
    assert!(number("usual_rate_rad_s") < 0.006 && number("rate_rad_s") < 0.06, "{report}");
    assert_eq!((&sent["unaligned"], &sent["invalid"]), (&json!(0), &json!(0)), "{sent}");
}

#[test]
fn mavlink_bridge_sends_fixes_with_position_in_pymavlink() {
    let Some(python) = python() else { return };
    let system = System::new("ingest.source = \"bus\"\ningest.bus.rate_hz = 100");
    let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let (station, mut next_line) = start_foreign(python, "ground_station.py", &[&port.to_string(), "20", "3"]);

    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    let mut opened = None;
    wait_for("the system to accept readings", || {
        opened = driver::Sensor::open(&system.name).ok().zip(driver::Receiver::open(&system.name).ok());
        opened.is_some()
    });
    let (mut sensor, mut receiver) = opened.unwrap();
    let bridge = bridge(&system, port, &[]);
    std::thread::scope(|scope| {
        let received = scope.spawn(|| assert_eq!(next_line(), "received"));
        let mut fixes = 0;
        for reading in 0i64.. {
            if received.is_finished() {
                break;
            }
            if reading % 50 == 0 {
                let metadata = driver::FixMetadata {
                    latitude_rad: Some(48.1f64.to_radians()),
                    longitude_rad: Some(-11.5f64.to_radians()),
                    altitude_m: Some(520.0 + f64::from(fixes)),
                    ..driver::FixMetadata::default()
                };
                receiver.send([1.0, -2.0, 0.5], metadata).unwrap();
                fixes += 1;
            }
            sensor.send(reading * 10_000_000, [0.0; 3], [0.0, 0.0, 9.81], None).unwrap();
            std::thread::sleep(Duration::from_millis(10));
        }
    });
    running.interrupt();
    let run = running.wait();
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    let sent = final_report(bridge);
    let report = foreign_report(station, &out, next_line);
    println!("{sent}\n{report}");

    let positions = report["positions"].as_array().unwrap();
    assert!(positions.len() >= 3 && sent["fixes"].as_u64().unwrap() >= 3, "{sent} {report}");
    let number = |position: &Value, name: &str| position[name].as_i64().unwrap();
    let first_mm = number(&positions[0], "alt");
    for position in positions {
        let found = ["lat", "lon", "vx", "vy", "vz", "hdg"].map(|name| number(position, name));
        // The heading is unknown, because the direction of north is unknown.
        assert_eq!(found, [481_000_000, -115_000_000, -200, 100, -50, 65_535], "{position}");
        assert_eq!(number(position, "relative_alt"), number(position, "alt") - first_mm, "{position}");
    }
    assert!(number(&positions[2], "relative_alt") >= 2000 && first_mm >= 520_000, "{report}");
}

#[test]
fn ros_bridge_matches_attitude_file_in_rosbags() {
    let Some(python) = python() else { return };
    let mut walk = Walk::start("integrator, ROS 2");
    let system = System::new(TUMBLE);
    let port = free_port();
    let (node, mut next_line) = start_foreign(python, "ros_node.py", &[&port.to_string(), "200", "200", "0"]);

    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    system.wait_until_running();
    walk.step("start a system");
    let to = format!("tcp/127.0.0.1:{port}");
    let mut bridge = plumb(&["bridge", "ros", "--json", "--system", &system.name, "--connect", &to]);
    let bridge = bridge.args(["--domain", "7", "--frame-id", "body", "--parent-frame-id", "odom"]);
    let bridge = bridge.stdout(Stdio::piped()).spawn().unwrap();
    assert_eq!(next_line(), "received");
    walk.step("start the bridge, receive 200 messages in rosbags");
    system.stop_and_assert_undisturbed(running, &out, TUMBLE);
    let sent = final_report(bridge);
    let report = foreign_report(node, &out, next_line);
    println!("{sent}\n{report}");

    assert_eq!((&sent["invalid"], &sent["dropped"]), (&json!(0), &json!(0)), "{sent}");
    // The hash in the key equals the one that the Python package rosbags computes from the message
    // definition.
    let of_type = format!("sensor_msgs::msg::dds_::Imu_/{}", report["hash"].as_str().unwrap());
    assert_eq!(report["key"], format!("7/imu/data/{of_type}"));
    let (tf, diagnostics) = (&report["tf"], &report["diagnostics"]);
    for (found, topic, type_name) in [
        (tf, "tf", "tf2_msgs::msg::dds_::TFMessage_"),
        (diagnostics, "diagnostics", "diagnostic_msgs::msg::dds_::DiagnosticArray_"),
    ] {
        assert_eq!(found["key"], format!("7/{topic}/{type_name}/{}", found["hash"].as_str().unwrap()));
        assert_eq!((&found["complete"], &found["numbers_follow"]), (&json!(true), &json!(true)), "{found}");
    }
    let tokens: Vec<(String, String)> = serde_json::from_value(report["tokens"].clone()).unwrap();
    let mut expected_tokens = vec![("NN", "%/%/plumbline".to_owned())];
    for (topic, key) in [("imu/data", &report["key"]), ("tf", &tf["key"]), ("diagnostics", &diagnostics["key"])] {
        let of_type = key.as_str().unwrap().strip_prefix(&format!("7/{topic}/")).unwrap();
        expected_tokens.push(("MP", format!("%{}/{of_type}/::,10:,:,:,,", topic.replace('/', "%"))));
    }
    expected_tokens.push(("MP", format!("%imu%mag/{MAGNETIC_FIELD}/::,10:,:,:,,")));
    assert_eq!(report["different_publishers"], 3, "{report}");
    for kind in ["PUT", "DELETE"] {
        for (start, end) in &expected_tokens {
            let matches = |key: &str| key.split('/').nth(5) == Some(*start) && key.ends_with(end.as_str());
            assert!(tokens.iter().any(|(of, key)| of == kind && matches(key)), "{kind} {end}: {tokens:?}");
        }
    }
    assert_eq!((&tf["frames"], &tf["unequal"]), (&json!([["odom", "body"]]), &json!(0)), "{tf}");
    assert_eq!(tf["translations"], json!([[0.0, 0.0, 0.0]]));
    // The simulation has no noise, so the gyro repeats its values and is considered stuck.
    let attitude = assert_diagnostics(&diagnostics["statuses"], &system.name);
    assert!(attitude["level"] == 2 && attitude["message"].as_str().unwrap().contains("rate-stuck"), "{attitude}");
    for name in ["complete", "covariances", "numbers_follow"] {
        assert_eq!(report[name], true, "{name}: {report}");
    }
    assert_eq!(report["publisher"], json!([16, 1, 33]), "{report}");
    let number = |name: &str| report[name].as_f64().unwrap();
    assert!(number("max_difference") < 1e-15 && (number("step_ms") - 10.0).abs() < 0.5, "{report}");
    assert!(number("fastest_rad_s") > 0.5 && number("rate_error_rad_s") < 0.05, "{report}");
    assert!((number("force_m_s2") - 9.81).abs() < 0.1 && number("early_s") > 0.0, "{report}");
}

/// Type name and hash of `sensor_msgs/msg/MagneticField` in keys and liveliness tokens.
const MAGNETIC_FIELD: &str =
    "sensor_msgs::msg::dds_::MagneticField_/RIHS01_e80f32f56a20486c9923008fc1a1db07bbb273cbbf6a5b3bfa00835ee00e4dff";

#[test]
fn ros_bridge_publishes_field_in_tesla_without_tf() {
    let Some(python) = python() else { return };
    let system = System::new("ingest.sim.scenario = \"s3\"\ningest.sim.field_noise_ut = 0");
    let port = free_port();
    let (node, mut next_line) = start_foreign(python, "ros_node.py", &[&port.to_string(), "100", "0", "50"]);
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    system.wait_until_running();
    let to = format!("tcp/127.0.0.1:{port}");
    let mut bridge = plumb(&["bridge", "ros", "--json", "--system", &system.name, "--connect", &to]);
    let bridge =
        bridge.args(["--domain", "7", "--frame-id", "body", "--no-tf"]).stdout(Stdio::piped()).spawn().unwrap();
    assert_eq!(next_line(), "received");
    running.interrupt();
    running.wait().assert_complete();
    let sent = final_report(bridge);
    let report = foreign_report(node, &out, next_line);
    println!("{sent}\n{report}");

    let mag = &report["mag"];
    assert_eq!(mag["key"], format!("7/imu/mag/{MAGNETIC_FIELD}"));
    assert!(MAGNETIC_FIELD.ends_with(mag["hash"].as_str().unwrap()), "{mag}");
    assert_eq!((&mag["complete"], &mag["numbers_follow"]), (&json!(true), &json!(true)), "{mag}");
    assert_eq!((&mag["frames"], &mag["covariance_is_unknown"]), (&json!(["body"]), &json!(true)), "{mag}");
    // The simulated magnetic field has 20 µT to the north and 44 µT downwards.
    let [east, north, up] = [0, 1, 2].map(|axis| mag["mean_t"][axis].as_f64().unwrap());
    assert!((north - 20e-6).abs() < 2e-6 && (up + 44e-6).abs() < 2e-6 && east.abs() < 2e-6, "{mag}");
    assert!(mag["compared"].as_u64().unwrap() >= 20 && mag["spread_t"].as_f64().unwrap() < 5e-6, "{mag}");
    // The simulated noise keeps the sensors from being flagged as stuck. While the forward axis is
    // near the vertical, the attitude has a warning.
    let attitude = assert_diagnostics(&report["diagnostics"]["statuses"], &system.name);
    assert!([json!(0), json!(1)].contains(&attitude["level"]), "{attitude}");
    let tokens = report["tokens"].as_array().unwrap();
    assert!(report["tf"].is_null() && !tokens.iter().any(|token| token[1].as_str().unwrap().contains("TFMessage")));
    assert!(sent["fields"].as_u64().unwrap() >= 50 && sent["diagnostics"].as_u64().unwrap() >= 2, "{sent}");
}

/// Checks the diagnostic statuses of a running system, except the level of the status `attitude`.
/// Returns the status `attitude`.
fn assert_diagnostics<'a>(statuses: &'a Value, system: &str) -> &'a Value {
    let statuses = statuses.as_array().unwrap();
    let status = |name: &str| {
        let status = statuses.iter().find(|status| status["name"] == format!("plumbline: {name}"));
        status.unwrap_or_else(|| panic!("no {name} in {statuses:?}"))
    };
    assert!(statuses.iter().all(|status| status["hardware_id"] == system), "{statuses:?}");
    let attitude = status("attitude");
    let value = |key: &str| attitude["values"][key].as_str().unwrap().parse::<f64>().unwrap();
    assert!(value("age_s") < 1.0 && value("rate_hz") > 0.0 && value("tick") > 0.0, "{attitude}");
    for (service, has_stage) in [("ingest", false), ("gyro", true), ("accel", true), ("fuser", true), ("course", true)]
    {
        let status = status(service);
        assert_eq!((&status["level"], &status["message"]), (&json!(0), &json!("running")), "{status}");
        assert_eq!(status["values"]["stage"].is_string(), has_stage, "{status}");
    }
    attitude
}

#[test]
fn ros_sensor_bridge_feeds_readings_to_system() {
    let Some(python) = python() else { return };
    let port = free_port();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foreign/ros_imu.py");
    let mut node = Command::new(python);
    let node = node.arg(script).arg(port.to_string()).stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut node = node.spawn().unwrap();
    let mut input = node.stdin.take().unwrap();
    let mut lines = BufReader::new(node.stdout.take().unwrap()).lines();
    let mut next_line = move || lines.next().expect("the node exited early").unwrap();
    assert_eq!(next_line(), "ready");

    let system = System::new("ingest.source = \"bus\"\ningest.bus.rate_hz = 200");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    let to = format!("tcp/127.0.0.1:{port}");
    let arguments = ["--system", &system.name, "--connect", &to, "--domain", "7", "--topic", "/vehicle/imu"];
    wait_for("the system to accept readings", || driver::Sensor::open(&system.name).is_ok());
    let mut bridge = plumb(&["bridge", "ros-sensor", "--json", "--mag", "vehicle/mag"]);
    let bridge = bridge.args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    writeln!(input, "begin").unwrap();
    wait_for("attitudes", || ticks(&system) > 600);
    writeln!(input, "end").unwrap();
    let sent: Value = serde_json::from_str(&next_line()).unwrap();
    signal(bridge.id(), Signal::INT);
    let received = final_report(bridge);
    println!("{sent}\n{received}");
    writeln!(input, "go").unwrap();
    assert!(node.wait().unwrap().success());
    running.interrupt();
    let run = running.wait();
    assert_eq!((run.code, run.number("/lost")), (Some(0), 0.0), "{}", run.stderr);

    // Every valid reading sent after the bridge joined must be delivered. Damaged readings must be
    // counted.
    let [imus, messages] = ["imus", "messages"].map(|name| sent[name].as_f64().unwrap());
    let [readings, rejected, undelivered, fields] =
        ["readings", "rejected", "undelivered", "fields"].map(|name| received[name].as_f64().unwrap());
    assert_eq!(run.number("/ticks_in"), readings);
    assert!(undelivered == 0.0 && readings <= imus && readings + rejected <= messages, "{sent} {received}");
    assert!(
        (rejected / readings - (messages - imus) / imus).abs() < 0.02 && fields > readings / 5.0,
        "{sent} {received}"
    );
    let tokens: Vec<(String, String)> = serde_json::from_value(sent["tokens"].clone()).unwrap();
    for of_type in
        ["%vehicle%imu/sensor_msgs::msg::dds_::Imu_/RIHS01_", "%vehicle%mag/sensor_msgs::msg::dds_::MagneticField_/"]
    {
        let matches = |key: &str| key.split('/').nth(5) == Some("MS") && key.contains(of_type);
        assert!(tokens.iter().any(|(kind, key)| kind == "PUT" && matches(key)), "{of_type}: {tokens:?}");
    }
    // The body leans to the right by 20° and rotates at 10 °/s.
    let attitudes = attitudes(&out);
    let second_half = &attitudes[attitudes.len() / 2..];
    let up = |[w, x, y, z]: [f64; 4]| [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)];
    let lean = 20f64.to_radians();
    let expected = [-lean.sin(), 0.0, lean.cos()];
    let up_error = |q| up(q).iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    let worst = second_half.iter().map(|(_, q)| up_error(*q)).fold(0.0, f64::max);
    assert!(worst < 0.01, "error of the up vector: {worst}");
    let yaw = |[w, x, y, z]: [f64; 4]| (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z));
    let [(first_s, first), (last_s, end)] = [second_half[0], second_half[second_half.len() - 1]];
    let rate_deg_s = (yaw(end) - yaw(first)).to_degrees().rem_euclid(360.0) / (last_s - first_s);
    assert!((rate_deg_s - 10.0).abs() < 0.5, "yaw rate {rate_deg_s} °/s");
}

/// Number of magnetic fields that the bridge reads for one reading of rate and force.
const MAX_FIELDS: u64 = 1000;

/// Opens a Zenoh router, to which the bridges connect.
fn open_router(port: u16) -> Session {
    let mut config = Config::default();
    for (key, value) in [
        ("mode", "\"router\"".to_owned()),
        ("listen/endpoints", format!("[\"tcp/127.0.0.1:{port}\"]")),
        ("scouting/multicast/enabled", "false".into()),
    ] {
        config.insert_json5(key, &value).unwrap();
    }
    zenoh::open(config).wait().unwrap()
}

#[test]
fn ros_sensor_bridge_limits_fields_per_reading() {
    let system = System::new("ingest.source = \"bus\"\ningest.bus.rate_hz = 100");
    let running = system.start(&[]);
    wait_for("the system to accept readings", || driver::Sensor::open(&system.name).is_ok());
    let port = free_port();
    let router = open_router(port);
    let to = format!("tcp/127.0.0.1:{port}");
    let mut bridge = plumb(&["bridge", "ros-sensor", "--json", "--topic", "imu", "--mag", "mag"]);
    let bridge = bridge.args(["--system", &system.name, "--connect", &to]);
    let bridge = bridge.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    wait_for("the bridge to subscribe", || {
        let tokens = router.liveliness().get("@ros2_lv/0/**/MS/**").wait().unwrap();
        tokens.iter().count() == 2
    });
    let put = |topic: &str, name: &str, bytes: Vec<u8>| {
        let key = format!("0/{topic}/sensor_msgs::msg::dds_::{name}_/RIHS01_0");
        router.put(key, bytes).congestion_control(CongestionControl::Block).wait().unwrap();
    };
    // More malformed fields than the bridge buffers. They arrive before the readings.
    (0..5000).for_each(|_| put("mag", "MagneticField", Vec::new()));
    let attitude: AttitudeOutput = bytemuck::Zeroable::zeroed();
    let sample = ImuSample { force_m_s2: [0.0, 0.0, 9.81], ..bytemuck::Zeroable::zeroed() };
    for reading in 0..3 {
        put("imu", "Imu", encode_imu(&attitude, &sample, reading * 10_000_000, "body").unwrap());
    }
    wait_for("three ticks", || ticks(&system) == 3);
    signal(bridge.id(), Signal::INT);
    let received = final_report(bridge);
    assert_eq!((&received["readings"], &received["rejected"]), (&json!(3), &json!(3 * MAX_FIELDS)), "{received}");
    running.interrupt();
    running.wait().assert_complete();
}

/// Command that the bridges suggest if there is no router.
const START_ROUTER: &str = "ros2 run rmw_zenoh_cpp rmw_zenohd";

/// Runs a bridge to ROS 2 that cannot start, and returns its messages.
fn failing_ros_bridge(system: &System, kind: &str, to: &str) -> String {
    let output = plumb(&["bridge", kind, "--system", &system.name, "--connect", to]).output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    stderr
}

#[test]
fn ros_bridge_without_router_says_how_to_start_it() {
    let system = System::new(TUMBLE);
    let running = system.start(&[]);
    system.wait_until_running();
    let to = format!("tcp/127.0.0.1:{}", free_port());
    let stderr = failing_ros_bridge(&system, "ros", &to);
    assert!(stderr.contains(&to) && stderr.contains("no rmw_zenoh router"), "{stderr}");
    assert!(stderr.contains(START_ROUTER), "{stderr}");
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn ros_bridge_rejects_gateway_in_place_of_router() {
    let system = with_gateway(free_port(), "");
    let running = system.start(&[]);
    system.wait_until_running();
    let to = endpoint(&system);
    let stderr = failing_ros_bridge(&system, "ros", &to);
    let says = |text: &str| stderr.contains(text);
    assert!(says(&to) && says("is not a router") && says(START_ROUTER), "{stderr}");
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn ros_bridge_announces_loss_of_router() {
    let Some(python) = python() else { return };
    let port = free_port();
    let (mut router, mut next_line) = start_foreign(python, "ros_node.py", &[&port.to_string(), "1", "0", "0"]);
    let system = System::new(TUMBLE);
    let running = system.start(&[]);
    system.wait_until_running();
    let to = format!("tcp/127.0.0.1:{port}");
    let mut bridge = plumb(&["bridge", "ros", "--system", &system.name, "--connect", &to, "--domain", "7"]);
    let mut bridge = bridge.stderr(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    assert_eq!(next_line(), "received");
    router.kill().unwrap();
    router.wait().unwrap();
    let line = BufReader::new(bridge.stderr.take().unwrap()).lines().next().unwrap().unwrap();
    assert!(line.contains("lost the rmw_zenoh router") && line.contains(START_ROUTER), "{line}");
    running.interrupt();
    running.wait().assert_complete();
    let output = bridge.wait_with_output().unwrap();
    assert!(output.status.success(), "{output:?}");
}

#[test]
fn stalled_bridge_drops_old_attitudes_without_affecting_system() {
    let system = System::new(TUMBLE);
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    system.wait_until_running();
    let sockets = [(); 2].map(|()| UdpSocket::bind("127.0.0.1:0").unwrap());
    let ports = sockets.each_ref().map(|socket| socket.local_addr().unwrap().port());
    let bridges = ports.map(|port| bridge(&system, port, &["--rate-hz", "1000"]));
    for socket in &sockets {
        let mut bytes = [0; 300];
        wait_for("an attitude", || socket.recv(&mut bytes).is_ok() && bytes[MESSAGE] != 0);
    }
    // One socket stays open but is never read. The second socket is closed.
    let [_stalled, closed] = sockets;
    drop(closed);
    let frozen = &bridges[1];
    signal(frozen.id(), Signal::STOP);
    let before = ticks(&system);
    wait_for("two seconds of ticks", || ticks(&system) > before + 2000);
    signal(frozen.id(), Signal::CONT);
    let before = ticks(&system);
    wait_for("a second of ticks", || ticks(&system) > before + 1000);
    system.stop_and_assert_undisturbed(running, &out, TUMBLE);
    let [stalled, frozen] = bridges.map(final_report);
    println!("{stalled}\n{frozen}");
    for sent in [&stalled, &frozen] {
        assert!(sent["attitudes"].as_u64().unwrap() > 100, "{sent}");
    }
    assert!(frozen["stale"].as_u64().unwrap() > 500, "{frozen}");
}

#[test]
fn mavlink_heartbeat_reports_boot_active_and_critical_states() {
    let system = System::new("ingest.source = \"stdin\"\ningest.stdin.rate_hz = 100");
    let mut command = system.command(&[]);
    command.stdin(Stdio::piped());
    let mut running = crate::common::Running::spawn(command);
    let mut input = running.stdin();
    let station = UdpSocket::bind("127.0.0.1:0").unwrap();
    system.wait_until_ready();
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
    // Sends some readings. Then the source stalls and keeps its connection open.
    for row in 0..500 {
        writeln!(input, "{},0,0,0,0,0,9.81", f64::from(row) * 0.01).unwrap();
    }
    input.flush().unwrap();
    wait_for("a heartbeat after attitudes", || {
        let (state, attitudes) = heartbeat();
        assert!([BOOT, ACTIVE, CRITICAL].contains(&state));
        state == CRITICAL && attitudes > 0
    });
    drop(input);
    running.wait().assert_complete();
    let sent = final_report(bridge);
    println!("{sent}");
    assert!(sent["heartbeats"].as_u64().unwrap() >= 2, "{sent}");
}
