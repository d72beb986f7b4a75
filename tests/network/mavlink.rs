//! A ground station by another project hears the attitude that the system gives.
use std::{
    io::{BufRead, BufReader},
    net::UdpSocket,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::LazyLock,
};

use rustix::process::Signal;
use serde_json::Value;

use crate::common::{
    System, attitudes,
    beyond::{free_port, with_gateway},
    python::python,
    signal,
};

static PYTHON: LazyLock<Option<PathBuf>> =
    LazyLock::new(|| python("ground-station-venv", "pymavlink", &["pymavlink==2.4.50"]));
/// Of a number with 24 bits.
const ROUNDED: f64 = 1e-6;

/// A ground station, which listens when this returns.
fn ground_station(port: u16, count: usize) -> Option<(Child, BufReader<std::process::ChildStdout>)> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foreign/ground_station.py");
    let mut command = Command::new(PYTHON.as_ref()?);
    let mut child = command
        .arg(script)
        .args([port.to_string(), count.to_string()])
        .env("MAVLINK20", "1")
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap());
    let mut line = String::new();
    lines.read_line(&mut line).unwrap();
    assert_eq!(line, "ready\n");
    Some((child, lines))
}

fn free_udp_port() -> u16 {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

fn numbers<const N: usize>(message: &Value, names: [&str; N]) -> [f64; N] {
    names.map(|name| message[name].as_f64().unwrap_or_else(|| panic!("no {name} in {message}")))
}

/// Of forward, right, down in north, east, down, by way of the rotation's matrix: rows and columns are exchanged and the third negated.
fn in_ned([w, x, y, z]: [f64; 4]) -> [[f64; 3]; 3] {
    let ours = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ];
    let (place, sign) = ([1, 0, 2], [1.0, 1.0, -1.0]);
    [0, 1, 2].map(|row| [0, 1, 2].map(|column| sign[row] * sign[column] * ours[place[row]][place[column]]))
}

/// Yaw, pitch and roll of aircraft, of a rotation body to north, east, down.
fn angles(r: &[[f64; 3]; 3]) -> [f64; 3] {
    [r[2][1].atan2(r[2][2]), (-r[2][0]).asin(), r[1][0].atan2(r[0][0])]
}

fn matrix([w, x, y, z]: [f64; 4]) -> [[f64; 3]; 3] {
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

fn is_near<const N: usize>(a: &[f64; N], b: &[f64; N]) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() < 4.0 * ROUNDED)
}

#[test]
fn a_ground_station_hears_the_attitudes_that_the_system_gives() {
    const COUNT: usize = 60;
    let port = free_udp_port();
    let Some((mut station, lines)) = ground_station(port, COUNT) else { return };
    let system = with_gateway(free_port(), "");
    let endpoint = format!("endpoint = \"udpout:127.0.0.1:{port}\"");
    system.add(&format!("[gateway.mavlink]\n{endpoint}\nsystem = 7\nrate_hz = 25\nvehicle = \"boat\"\n"));
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    // A gateway that is killed goes on.
    let mut messages = Vec::new();
    for line in lines.lines() {
        messages.push(serde_json::from_str::<Value>(&line.unwrap()).unwrap());
        if messages.len() == COUNT {
            signal(running.service("gateway"), Signal::KILL);
        }
    }
    assert!(station.wait().unwrap().success());
    running.interrupt();
    let run = running.wait();
    assert_eq!((run.code, run.number("/lost")), (Some(0), 0.0), "{}", run.people);
    let of = |kind: &str| messages.iter().filter(|message| message["mavpackettype"] == kind).collect::<Vec<_>>();
    let heartbeat = of("HEARTBEAT")[0];
    assert_eq!(numbers(heartbeat, ["system", "component", "type", "autopilot"]), [7.0, 1.0, 11.0, 0.0]);

    // Each is an attitude that was given, and they come in its order.
    let mut given = attitudes(&out).into_iter().map(|(t_s, q)| (t_s, in_ned(q)));
    let mut times_s = Vec::new();
    for message in of("ATTITUDE_QUATERNION") {
        let heard = matrix(numbers(message, ["q1", "q2", "q3", "q4"]));
        let found = given.find(|(_, r)| r.iter().zip(&heard).all(|(a, b)| is_near(a, b)));
        let (t_s, rotation) = found.unwrap_or_else(|| panic!("nobody gave {message}"));
        let of_same = |other: &&&Value| {
            other["time_boot_ms"] == message["time_boot_ms"]
                && is_near(&numbers(other, ["roll", "pitch", "yaw"]), &angles(&rotation))
        };
        assert!(of("ATTITUDE").iter().any(|other| of_same(&other)), "no angles with {message}");
        times_s.push(t_s);
    }
    assert!(times_s.len() >= COUNT);
    // Every 0.04 s, but where the gateway was killed.
    let intervals: Vec<_> = times_s.windows(2).map(|pair| ((pair[1] - pair[0]) * 1000.0).round()).collect();
    let usual = intervals.iter().filter(|interval_ms| **interval_ms == 40.0).count();
    assert!(usual + 3 >= intervals.len(), "{intervals:?}");
}

#[test]
fn who_is_told_nothing_of_an_unknown_place_says_so() {
    for (text, said) in [
        ("endpoint = \"udpin:127.0.0.1:14550\"", "as \"udpout:192.168.1.4:14550\""),
        ("rate_hz = 10", "\"endpoint\" is missing"),
        ("endpoint = \"udpout:127.0.0.1:14550\"\nvehicle = \"bote\"", "unknown value \"bote\""),
    ] {
        let run = System::new(&format!("[gateway.mavlink]\n{text}\n")).run(&["--for", "0.1s"]);
        assert_eq!(run.code, Some(3), "{}", run.people);
        assert!(run.people.contains(said), "{}", run.people);
    }
}
