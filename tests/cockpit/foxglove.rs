//! Clients that use the Foxglove WebSocket protocol: received values, access control and limits.
use std::{
    collections::BTreeMap,
    fs,
    io::{BufRead as _, BufReader},
    net::TcpStream,
    path::Path,
    process::{Command, Stdio},
    thread,
    time::Duration,
};

use super::{
    access::{UPGRADE, connect, get},
    browser::{PACKAGES, run},
    page::{View, row, with_cockpit},
};
use crate::common::{System, data, plumb, python::python, remote::free_port, signal, wait_for};
use rustix::process::Signal;
use serde_json::Value;

fn client(python: &Path, port: u16, protocol: &str, what: &str) -> Command {
    let mut command = Command::new(python);
    command.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foreign/foxglove.py"));
    command.arg(format!("ws://127.0.0.1:{port}/foxglove")).args([protocol, what]).stdout(Stdio::piped());
    command
}

fn wait_for_port(port: u16) {
    wait_for("the cockpit", || TcpStream::connect(("127.0.0.1", port)).is_ok());
}

/// Returns the quaternion x, y, z, w of an attitude in the viewers' frames.
///
/// The frames differ from the native ones by a quarter turn about up.
fn for_viewers([w, x, y, z]: [f64; 4]) -> [f64; 4] {
    let s = 0.5_f64.sqrt();
    [s * (x + y), s * (y - x), s * (z + w), s * (w - z)]
}

#[test]
fn official_client_receives_recorded_attitude() {
    let Some(packages) = &*PACKAGES else { return };
    let (system, port) = with_cockpit("");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    system.wait_until_running();
    wait_for_port(port);
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut client = Command::new("node");
    client.arg(root.join("tests/foreign/foxglove.mjs")).arg(packages).arg(root.join("services/cockpit/page"));
    let summary: Value = serde_json::from_str(&run(client.arg(format!("127.0.0.1:{port}")).arg("3")).unwrap()).unwrap();
    running.interrupt();
    running.wait().assert_complete();
    assert_eq!(summary["errors"], Value::Array(vec![]));
    assert_eq!(summary["info"]["name"], format!("plumbline {}", system.name));
    for (topic, schema) in [("/tf", "foxglove.FrameTransform"), ("/attitude", "plumbline.v1.AttitudeOutput")] {
        assert_eq!(summary["schemas"][topic], format!("protobuf {schema}"));
        assert!(summary["messages"][topic].as_u64() > Some(20), "{summary}");
    }
    let attitude = &summary["attitude"];
    let quaternion: Vec<f64> = serde_json::from_value(attitude["quaternion"].clone()).unwrap();
    assert_eq!(quaternion, row(&out, attitude["tick"].as_u64().unwrap())[1..5]);
}

#[test]
fn python_client_receives_60_attitudes_per_second() {
    let Some(python) = python() else { return };
    let (system, port) = with_cockpit("");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    system.wait_until_running();
    wait_for_port(port);
    let mut child = client(python, port, "foxglove.sdk.v1", "6").spawn().unwrap();
    thread::sleep(Duration::from_secs(2));
    signal(running.service("accel"), Signal::KILL);
    let summary: Value = serde_json::from_reader(child.stdout.take().unwrap()).unwrap();
    assert!(child.wait().unwrap().success());
    running.interrupt();
    running.wait().assert_complete();

    assert_eq!(summary["bad"], Value::Array(vec![]));
    assert_eq!((&summary["protocol"], &summary["info"]["op"]), (&"foxglove.sdk.v1".into(), &"serverInfo".into()));
    assert_eq!(summary["info"]["name"], format!("plumbline {}", system.name));
    for (topic, schema) in [
        ("/tf", "foxglove.FrameTransform"),
        ("/pose", "foxglove.PoseInFrame"),
        ("/location", "foxglove.LocationFix"),
        ("/attitude", "plumbline.v1.AttitudeOutput"),
        ("/event", "plumbline.v1.SystemEvent"),
    ] {
        assert_eq!(summary["schemas"][topic], schema, "{topic}");
    }
    let messages: BTreeMap<String, u64> = serde_json::from_value(summary["messages"].clone()).unwrap();
    for topic in ["/tf", "/pose", "/attitude", "/fused", "/gyro", "/accel", "/imu", "/health"] {
        assert!(messages.get(topic) > Some(&100), "{topic}: {messages:?}");
    }
    let max_per_second: BTreeMap<String, u64> = serde_json::from_value(summary["max_per_second"].clone()).unwrap();
    println!("{messages:?}, at most {max_per_second:?}");
    assert!(
        max_per_second.iter().all(|(topic, max_per_second)| *max_per_second <= 60 || topic == "/event"),
        "{max_per_second:?}"
    );

    // The events must be complete, because the limit of 60 messages per second does not apply to
    // them.
    let events: Vec<u64> = serde_json::from_value(summary["events"].clone()).unwrap();
    assert!(events.len() >= 2 && events.windows(2).all(|pair| pair[1] == pair[0] + 1), "{events:?}");

    let rows: Vec<[f64; 9]> = serde_json::from_value(summary["rows"].clone()).unwrap();
    assert!(rows.len() > 100 && messages["/tf"].abs_diff(messages["/attitude"]) <= 1, "{} rows", rows.len());
    for [tick, quaternion @ .., x, y, z, w] in rows {
        let written = row(&out, tick as u64);
        assert_eq!(quaternion, written[1..5], "tick {tick}");
        let off = for_viewers(quaternion).into_iter().zip([x, y, z, w]).map(|(own, received)| (own - received).abs());
        assert!(off.fold(0.0, f64::max) < 1e-15, "tick {tick}");
    }
    assert_eq!(summary["poses_differ"], 0);
    // Messages are stamped with the time of their publication.
    let [now, newest] = ["now_ns", "newest_ns"].map(|name| summary[name].as_f64().unwrap() * 1e-9);
    assert!(newest <= now && newest > now - 30.0, "{newest} s of {now} s");
    let narrow = &summary["narrow"];
    assert_eq!((&narrow["topics"], &narrow["late"]), (&serde_json::json!(["/tf"]), &0.into()), "{narrow}");
    assert!(narrow["messages"].as_u64() > Some(10), "{narrow}");
}

#[recorded::test]
fn receiver_position_is_published_as_location() {
    let (Some(python), Some(data)) = (python(), data()) else { return };
    let (system, port) = with_cockpit("");
    let recording = data.join("flights/apm_plane_log2_imu.csv.gz");
    let running = system.start(&["--replay", recording.to_str().unwrap(), "--speed", "1"]);
    system.wait_until_running();
    wait_for_port(port);
    let mut child = client(python, port, "foxglove.sdk.v1", "4").spawn().unwrap();
    let summary: Value = serde_json::from_reader(child.stdout.take().unwrap()).unwrap();
    assert!(child.wait().unwrap().success());
    running.interrupt();
    running.wait().assert_complete();
    let places: Vec<[f64; 3]> = serde_json::from_value(summary["places"].clone()).unwrap();
    assert!(places.len() > 3, "{places:?}");
    let text = fs::read_to_string(data.join("flights/apm_plane_log2_gnss.csv")).unwrap();
    let rows: Vec<Vec<f64>> =
        text.lines().skip(1).map(|row| row.split(',').map(|number| number.parse().unwrap()).collect()).collect();
    for place in places {
        let is = |row: &Vec<f64>| row[4..7].iter().zip(place).all(|(own, received)| (own - received).abs() < 1e-9);
        assert!(rows.iter().any(is), "no receiver was at {place:?}");
    }
}

#[test]
fn restarted_system_starts_new_session_for_clients() {
    let Some(python) = python() else { return };
    let system = System::new("");
    let running = system.start(&[]);
    system.wait_until_running();
    let port = free_port();
    let mut command = plumb(&["view", "--system", &system.name, "--listen", &format!("127.0.0.1:{port}")]);
    command.env("XDG_STATE_HOME", system.path("")).env_remove("STATE_DIRECTORY");
    let view = View::start(command);
    let mut child = client(python, port, "foxglove.websocket.v1", "another-session").spawn().unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let mut next_line = || -> Value { serde_json::from_str(&lines.next().unwrap().unwrap()).unwrap() };
    let first = next_line()["session"].clone();
    assert!(next_line()["tick"].as_u64() > Some(1000));
    running.interrupt();
    running.wait().assert_complete();
    let restarted = system.start(&[]);
    let mut last = next_line();
    while last["infos"].is_null() {
        last = next_line();
    }
    assert!(child.wait().unwrap().success());
    let infos = last["infos"].as_array().unwrap();
    assert_eq!((infos.len(), &infos[0]["sessionId"]), (2, &first), "{last}");
    assert!(infos[1]["op"] == "serverInfo" && infos[1]["sessionId"] != first, "{last}");
    let ticks: Vec<u64> = serde_json::from_value(last["ticks"].clone()).unwrap();
    assert!(ticks.len() >= 10 && ticks.windows(2).all(|pair| pair[0] < pair[1]), "{ticks:?}");
    view.stop();
    restarted.interrupt();
    restarted.wait().assert_complete();
}

const PROTOCOL: &str = "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n";

#[test]
fn pages_from_listed_origins_only_are_accepted() {
    let listed = "https://app.foxglove.dev";
    for origins in [vec![], vec![listed]] {
        let (system, port) = with_cockpit(&format!("cockpit.foxglove_origins = {origins:?}"));
        let running = system.start(&[]);
        system.wait_until_running();
        wait_for_port(port);
        let host = format!("Host: 127.0.0.1:{port}\r\n");
        let from =
            |path: &str, origin: &str| get(port, path, &format!("{host}Origin: {origin}\r\n{PROTOCOL}{UPGRADE}"));
        let expected = if origins.is_empty() { "http/1.1 403" } else { "http/1.1 101" };
        let response = from("/foxglove", listed);
        assert!(response.starts_with(expected), "{response}");
        for (path, origin) in [("/socket", listed), ("/metrics", listed), ("/foxglove", "https://evil.example")] {
            let response = from(path, origin);
            assert!(response.starts_with("http/1.1 403"), "{path}, {origin}: {response}");
        }
        let response = get(port, "/foxglove", &format!("Host: evil.example\r\n{PROTOCOL}{UPGRADE}"));
        assert!(response.starts_with("http/1.1 421"), "{response}");
        let own = from("/foxglove", &format!("http://127.0.0.1:{port}"));
        assert!(own.starts_with("http/1.1 101") && own.contains("sec-websocket-protocol: foxglove.sdk.v1"), "{own}");
        let none = get(port, "/foxglove", &format!("{host}{UPGRADE}"));
        assert!(none.starts_with("http/1.1 400"), "without the subprotocol: {none}");
        running.interrupt();
        running.wait().assert_complete();
    }
}

/// Encodes a client's text frame, with a zero mask.
fn text(content: &str) -> Vec<u8> {
    let length = u16::try_from(content.len()).unwrap();
    let head = if length < 126 { vec![0x81, 0x80 | length as u8] } else { vec![0x81, 0x80 | 126] };
    let more = if length < 126 { vec![] } else { length.to_be_bytes().to_vec() };
    [head, more, vec![0; 4], content.as_bytes().to_vec()].concat()
}

#[test]
fn clients_cost_no_tick_and_excess_is_rejected() {
    use std::io::{Read as _, Write as _};
    let (system, port) = with_cockpit("");
    let running = system.start(&[]);
    system.wait_until_running();
    wait_for_port(port);
    let request = format!("GET /foxglove HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n{PROTOCOL}{UPGRADE}\r\n");
    let all: Vec<_> = (0..14).map(|id| format!("{{\"id\":{id},\"channelId\":{id}}}")).collect();
    let subscribe = text(&format!("{{\"op\":\"subscribe\",\"subscriptions\":[{}]}}", all.join(",")));
    let clients: Vec<_> = (0..8)
        .map(|_| {
            let (mut stream, response) = connect(port, &request);
            assert!(response.starts_with("http/1.1 101"), "{response}");
            stream.write_all(&subscribe).unwrap();
            stream
        })
        .collect();
    let (_, ninth) = connect(port, &request);
    assert!(ninth.starts_with("http/1.1 503"), "{ninth}");
    // Seven clients read all channels for several seconds; the eighth reads nothing.
    thread::scope(|scope| {
        for mut client in clients.iter().take(7) {
            scope.spawn(move || {
                let (mut bytes, mut taken) = (vec![0; 1 << 16], 0);
                while taken < 400_000 {
                    let read = client.read(&mut bytes).unwrap();
                    assert!(read > 0, "dropped after {taken} bytes");
                    taken += read;
                }
            });
        }
    });
    // A client is disconnected if its message exceeds the size limit.
    let mut client = &clients[0];
    client.write_all(&text(&"x".repeat(5000))).unwrap();
    let mut left = Vec::new();
    // The connection may be closed or reset.
    let _ = client.read_to_end(&mut left);
    drop(clients);
    running.interrupt();
    running.wait().assert_complete();
}
