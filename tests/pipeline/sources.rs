//! Live sources end to end.
//!
//! Attitudes are computed from bytes in device formats. If third-party encoders are installed, they
//! produce these bytes. `plumb doctor` reports device faults.
use std::{
    fs::{self, File, OpenOptions},
    io::{BufRead, BufReader, Read, Write},
    net::{TcpListener, TcpStream, UdpSocket},
    path::Path,
    process::{Child, Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use prost::Message as _;
use rustix::{
    fs::{CWD, Mode, mkfifoat},
    process::Signal,
};
use serde_json::Value;
use wire::v1;
use xsens_mti::prelude::{BusId, Frame, MessageId, PayloadLength};

use super::drivers::open_serial_device;
use crate::common::{Run, Running, System, attitudes, inclination_deg, plumb, python::python, signal, wait_for};

const GRAVITY_M_S2: f64 = 9.80665;
const LEVEL: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

/// Background thread that repeats an action until this value is dropped.
struct BackgroundTask {
    is_stopped: Arc<AtomicBool>,
    thread: Option<thread::JoinHandle<()>>,
}

impl BackgroundTask {
    /// Calls `each` repeatedly with the number of the call as its argument. Stops when `each`
    /// returns `false` or the task is dropped.
    fn start(pause: Duration, each: impl FnMut(u64) -> bool + Send + 'static) -> Self {
        Self::start_on_thread(pause, || each)
    }

    /// Like `start`, but creates the action on the background thread.
    fn start_on_thread<F: FnMut(u64) -> bool>(pause: Duration, create: impl FnOnce() -> F + Send + 'static) -> Self {
        let is_stopped = Arc::new(AtomicBool::new(false));
        let stopped = is_stopped.clone();
        let thread = thread::spawn(move || {
            let mut each = create();
            for n in 0.. {
                if stopped.load(Ordering::SeqCst) || !each(n) {
                    return;
                }
                thread::sleep(pause);
            }
        });
        Self { is_stopped, thread: Some(thread) }
    }
}

impl Drop for BackgroundTask {
    fn drop(&mut self) {
        self.is_stopped.store(true, Ordering::SeqCst);
        self.thread.take().into_iter().for_each(|thread| drop(thread.join()));
    }
}

/// Device simulated by third-party software.
struct Device(Child);

impl Device {
    /// Starts the device. If the device is a server, waits until it is ready. Returns `None` if no
    /// suitable Python is available.
    fn start(kind: &str, port: u16, serves: bool) -> Option<Self> {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foreign/devices.py");
        let mut command = Command::new(python()?);
        let mut child = command
            .arg(script)
            .args([kind, &port.to_string()])
            .env("MAVLINK20", "1")
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        if serves {
            let mut line = String::new();
            BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
            assert_eq!(line, "ready\n");
        }
        Some(Self(child))
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn free_udp_port() -> u16 {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

fn free_tcp_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

fn ticks(system: &System, service: &str) -> u64 {
    let of_service = system.ps().into_iter().find(|entry| entry["service"] == service);
    of_service.map_or(0, |entry| entry["ticks"].as_u64().unwrap())
}

fn wait_for_ticks(system: &System, count: u64) {
    wait_for("attitudes", || ticks(system, "course") >= count);
}

/// Stops the system and asserts that its attitudes are level.
fn stop_and_assert_level(running: Running, out: &Path) -> Run {
    running.interrupt();
    let run = running.wait();
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    let attitudes = attitudes(out);
    assert!(attitudes.windows(2).all(|pair| pair[1].0 > pair[0].0), "the timestamps do not increase");
    let worst = attitudes.iter().map(|(_, q)| inclination_deg(*q, LEVEL)).fold(0.0, f64::max);
    assert!(worst < 0.2, "inclination {worst}°");
    run
}

/// Kills the drivers process and waits for its restart.
fn kill_drivers(system: &System, running: &Running) {
    signal(running.service("drivers"), Signal::KILL);
    let restarts =
        || system.ps().into_iter().find(|entry| entry["service"] == "drivers").map(|entry| entry["restarts"].as_u64());
    wait_for("a restart", || restarts().flatten() == Some(1));
}

/// Asserts that a replay of the only flight in the folder writes the same attitudes.
fn assert_replay_is_identical(flights: &Path, out: &Path) {
    let flight = fs::read_dir(flights).unwrap().next().unwrap().unwrap().path();
    let replayed = out.with_file_name("replayed.csv");
    let mut command = plumb(&["up", "--speed", "max", "--json"]);
    command.arg("--replay").arg(flight).arg("--out").arg(&replayed).current_dir(flights);
    let run = Run::from_output(command.output().unwrap());
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    assert!(fs::read(out).unwrap() == fs::read(&replayed).unwrap(), "the bytes differ: {}", run.stderr);
}

/// Returns the findings of `plumb doctor` about the source, with their remedies.
fn source_findings(system: &System) -> Vec<String> {
    let output = plumb(&["doctor", "--for", "200ms", "--json", "--system", &system.name]).output().unwrap();
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let checks = report["checks"].as_array().unwrap().iter().filter(|check| check["check"] == "source");
    checks.map(|check| format!("{} → {}", check["found"], check["remedy"])).collect()
}

fn wait_for_finding(system: &System, what: &str) {
    let mut found = Vec::new();
    wait_for(what, || {
        found = source_findings(system);
        found.iter().any(|finding| finding.contains(what))
    });
}

/// Waits for a fix on the topic `receiver` and returns it.
fn wait_for_fix(system: &System) -> Value {
    let mut fix = Value::Null;
    wait_for("a fix", || {
        let echo = plumb(&["topic", "echo", "receiver", "--count", "1", "--json", "--system", &system.name]);
        let output = { echo }.output().unwrap();
        let line = String::from_utf8(output.stdout).unwrap();
        fix = line.lines().next().and_then(|line| serde_json::from_str(line).ok()).unwrap_or(Value::Null);
        fix != Value::Null
    });
    fix
}

fn assert_fix(fix: &Value, velocity_m_s: [f64; 3], has_altitude: bool) {
    let near = |found: &Value, expected: f64| (found.as_f64().unwrap() - expected).abs() < 2e-3;
    for (found, expected) in fix["velocity_m_s"].as_array().unwrap().iter().zip(velocity_m_s) {
        assert!(near(found, expected), "{fix}");
    }
    assert!(near(&fix["latitude_rad"], 48.1f64.to_radians()), "{fix}");
    assert!(near(&fix["longitude_rad"], 11.5f64.to_radians()), "{fix}");
    assert!(!has_altitude || near(&fix["altitude_m"], 520.0), "{fix}");
}

/// Encodes a reading of a level device that rotates at 10 °/s.
fn witmotion_cycle(_: u64) -> Vec<u8> {
    let frame = |kind: u8, numbers: [i16; 4]| {
        let mut bytes = vec![0x55, kind];
        numbers.iter().for_each(|number| bytes.extend(number.to_le_bytes()));
        bytes.push(sum(&bytes));
        bytes
    };
    let rate = (10.0 / 2000.0 * 32_768.0) as i16;
    [frame(0x51, [0, 0, 2048, 0]), frame(0x52, [0, 0, rate, 0]), frame(0x53, [1, 2, 3, 4])].concat()
}

fn xsens_message(n: u64) -> Vec<u8> {
    let three =
        |id: u16, numbers: [f32; 3]| [&id.to_be_bytes()[..], &[12], &numbers.map(f32::to_be_bytes).concat()].concat();
    let time = [&[0x10, 0x60, 4][..], &(50 * n as u32).to_be_bytes()].concat();
    let data = [time, three(0x8020, [0.0, 0.0, 10f32.to_radians()]), three(0x4020, [0.0, 0.0, 9.81])].concat();
    let mut bytes = vec![0; 4 + data.len() + 1];
    let mut frame = Frame::new_unchecked(&mut bytes[..]);
    frame.set_preamble();
    frame.set_bus_id(BusId::MASTER);
    frame.set_message_id(MessageId(0x36));
    frame.set_payload_length(PayloadLength::new_standard(data.len() as u8).unwrap());
    frame.payload_mut().unwrap().copy_from_slice(&data);
    let sum = frame.compute_checksum_byte().unwrap();
    frame.set_checksum(sum).unwrap();
    bytes
}

fn rvc_frame(n: u64) -> Vec<u8> {
    // The yaw angle advances by 0.1° every 10 ms.
    let yaw = ((10 * n as i64 + 18_000).rem_euclid(36_000) - 18_000) as i16;
    let numbers = [yaw, 0, 0, 0, 0, 1000].map(i16::to_le_bytes).concat();
    let covered = [&[n as u8][..], &numbers, &[0; 3]].concat();
    [&[0xaa, 0xaa][..], &covered, &[sum(&covered)]].concat()
}

fn sum(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |sum, byte| sum.wrapping_add(*byte))
}

#[test]
fn serial_sensors_are_read_with_one_command() {
    type Encode = fn(u64) -> Vec<u8>;
    let sensors: [(&str, u32, Encode); 3] =
        [("witmotion", 200, witmotion_cycle), ("xsens", 200, xsens_message), ("rvc", 100, rvc_frame)];
    for (format, rate_hz, encode) in sensors {
        let system = System::new("");
        let out = system.path("out.csv");
        let port = system.path("imu");
        let mut device = open_serial_device(&port);
        let line = format!("serial:{}?format={format}&baud=115200&rate_hz={rate_hz}", port.display());
        let running = system.start(&["--source", &line, "--out", out.to_str().unwrap()]);
        let pause = Duration::from_secs(1) / rate_hz;
        let task = BackgroundTask::start(pause, move |n| device.write_all(&encode(n)).is_ok());
        wait_for_ticks(&system, 300);
        assert_eq!(source_findings(&system), Vec::<String>::new(), "{format}");
        running.interrupt();
        drop(task);
        let run = stop_and_assert_level(running, &out);
        assert_eq!(run.number("/lost"), 0.0, "{format}");
        // If a format has no timestamps, the time of a sample is computed from its number. Samples
        // that arrive together are therefore evenly spaced.
        let attitudes = attitudes(&out);
        let half = &attitudes[attitudes.len() / 2..];
        let longest = half.windows(2).map(|pair| pair[1].0 - pair[0].0).fold(0.0, f64::max);
        assert!(longest < 0.05, "{format}: interval of {longest} s");
        let [(first_s, first), (last_s, last)] = [half[0], half[half.len() - 1]];
        let rate_deg_s = yaw_change_deg(first, last) / (last_s - first_s);
        assert!((rate_deg_s - 10.0).abs() < 0.2, "{format}: yaw rate {rate_deg_s} °/s");
    }
}

/// Returns the rotation about the vertical in degrees, between −180 and 180.
fn yaw_change_deg(from: [f64; 4], to: [f64; 4]) -> f64 {
    let yaw = |[w, x, y, z]: [f64; 4]| (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z));
    (yaw(to) - yaw(from)).sin_cos().0.atan2((yaw(to) - yaw(from)).cos()).to_degrees()
}

#[test]
fn autopilot_over_mavlink_delivers_imu_and_fixes() {
    let port = free_udp_port();
    let Some(_device) = Device::start("mavlink", port, false) else { return };
    let system = System::new("");
    let out = system.path("out.csv");
    let line = format!("mavlink:udpin:127.0.0.1:{port}?rate_hz=200");
    let flights = system.path("flights");
    let recorded = ["--record", flights.to_str().unwrap(), "--out", out.to_str().unwrap()];
    let running = system.start(&[&["--source", &line][..], &recorded].concat());
    wait_for_ticks(&system, 300);
    assert_fix(&wait_for_fix(&system), [5.0 / 2f64.sqrt(), 5.0 / 2f64.sqrt(), 0.0], true);
    assert_eq!(source_findings(&system), Vec::<String>::new());
    kill_drivers(&system, &running);
    wait_for_ticks(&system, 600);
    stop_and_assert_level(running, &out);
    assert_replay_is_identical(&flights, &out);
}

#[test]
fn receivers_add_fixes_to_any_source() {
    for format in ["ubx", "nmea"] {
        let (imu, gnss) = (free_udp_port(), free_tcp_port());
        let Some(_device) = Device::start(format, gnss, true) else { return };
        let receiver = format!("tcp:127.0.0.1:{gnss}?format={format}");
        let system = System::new("");
        let out = system.path("out.csv");
        let line = format!("udp:127.0.0.1:{imu}?rate_hz=200");
        let running = system.start(&["--source", &line, "--receiver", &receiver, "--out", out.to_str().unwrap()]);
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let task = BackgroundTask::start(Duration::from_millis(5), move |n| {
            let _ = socket.send_to(format!("{},0,0,0.1,0,0,9.8", n as f64 / 200.0).as_bytes(), ("127.0.0.1", imu));
            true
        });
        wait_for_ticks(&system, 100);
        assert_fix(&wait_for_fix(&system), [5.0 / 2f64.sqrt(), 5.0 / 2f64.sqrt(), 0.0], format == "ubx");
        drop(task);
        stop_and_assert_level(running, &out);
    }
}

#[test]
fn receiver_adds_fixes_to_user_defined_source() {
    let gnss = free_tcp_port();
    let Some(_device) = Device::start("ubx", gnss, true) else { return };
    let system = System::new(&format!(
        "[ingest]\nsource = \"bus\"\nbus.rate_hz = 200\nreceiver = {{ endpoint = \"tcp:127.0.0.1:{gnss}\" }}\n"
    ));
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    let name = system.name.clone();
    let task = BackgroundTask::start_on_thread(Duration::from_millis(5), move || {
        let mut sensor = None;
        move |n| {
            if sensor.is_none() {
                sensor = driver::Sensor::open(&name).ok();
            }
            let send =
                |sensor: &mut driver::Sensor| sensor.send(n as i64 * 5_000_000, [0.0, 0.0, 0.1], [0.0, 0.0, 9.8], None);
            let _ = sensor.as_mut().map(send);
            true
        }
    });
    wait_for_ticks(&system, 100);
    assert_fix(&wait_for_fix(&system), [5.0 / 2f64.sqrt(), 5.0 / 2f64.sqrt(), 0.0], true);
    drop(task);
    stop_and_assert_level(running, &out);
}

#[test]
fn tcp_lines_are_mapped_with_names_units_and_axes() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let system = System::new("");
    let out = system.path("out.csv");
    let line = format!("tcp:{}?rate_hz=200", listener.local_addr().unwrap());
    let map = ["--map", "t=ms,gx=wx,gy=wy,gz=wz,ax=fx,ay=fy,az=fz", "--units", "deg/s,g,ms", "--frame", "frd"];
    let running = system.start(&[&["--source", &line, "--out", out.to_str().unwrap()][..], &map].concat());
    // The source reconnects after a lost connection.
    for round in 1..=2 {
        let (mut stream, _) = listener.accept().unwrap();
        writeln!(stream, "ms;fx;fy;fz;wx;wy;wz;temperature").unwrap();
        let task = BackgroundTask::start(Duration::from_millis(5), move |n| {
            writeln!(stream, "{},5;0;0;-1;0;0;5,7;21", 5 * n).is_ok()
        });
        wait_for_ticks(&system, 200 * round);
        drop(task);
    }
    let run = stop_and_assert_level(running, &out);
    assert_eq!(run.number("/lost"), 0.0);
}

/// Variant of text: its name, the lines before the rows, and the row with the given number.
///
/// The rows are those of a level body that rotates at 0.1 rad/s. The time of a row is 5 ms times
/// its number.
type TextVariant = (&'static str, Vec<&'static str>, fn(u64) -> String);

/// Returns variants of text that files may have.
fn text_variants() -> [TextVariant; 7] {
    fn seconds(n: u64) -> String {
        format!("{}.{:03}", n / 200, n % 200 * 5)
    }
    [
        ("plain", vec!["t_s,gx,gy,gz,ax,ay,az"], |n| format!("{},0,0,0.1,0,0,9.8", seconds(n))),
        ("names in a comment", vec!["# ax ay az gx gy gz t"], |n| format!("0 0 9.8  0 0 0.1 {}", seconds(n))),
        ("names behind a per cent sign", vec!["% t\tgx\tgy\tgz\tax\tay\taz\tid"], |n| {
            format!("{}\t0\t0\t0.1\t0\t0\t9.8\tx", seconds(n))
        }),
        ("decimal commas", vec!["// walk", "t;gx;gy;gz;ax;ay;az"], |n| {
            format!("{};0;0;0,1;0;0;9,8", seconds(n).replace('.', ","))
        }),
        (
            "units in the names",
            vec!["ms (ms),x", "t (ms)|gx (mdeg/s)|gy (mdeg/s)|gz (mdeg/s)|ax (mg)|ay (mg)|az (mg)"],
            |n| format!("{}|0|0|5729.578|0|0|1000|", 5 * n),
        ),
        ("a line of units", vec!["t,gx,gy,gz,ax,ay,az", "us,deg/s,deg/s,deg/s,g,g,g"], |n| {
            format!("{},\"0\",0,5.729578,0,0,1", 5000 * n)
        }),
        ("times of day", vec!["time,gx,gy,gz,ax,ay,az"], |n| {
            let (minutes, seconds) = (n / 200 / 60, n / 200 % 60);
            format!("10:{minutes:02}:{seconds:02}.{:03},0,0,0.1,0,0,9.8", n % 200 * 5)
        }),
    ]
}

#[test]
fn live_sources_read_the_text_variants_of_files() {
    // All variants are read from files by the same rules.
    for (name, header, row) in text_variants() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.csv");
        fs::write(&file, header.join("\n") + "\n" + &(0..100).map(|n| row(n) + "\n").collect::<String>()).unwrap();
        let output = plumb(&["info"]).arg(&file).output().unwrap();
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(text.contains("100 samples at 200.0 Hz"), "{name}: {text}{}", String::from_utf8_lossy(&output.stderr));
    }
    thread::scope(|scope| {
        for kind in ["tcp", "udp", "serial"] {
            scope.spawn(move || assert_reads_text_variants(kind));
        }
    });
}

/// Sends all variants of text to one system, and asserts that every row becomes a tick.
fn assert_reads_text_variants(kind: &str) {
    let system = System::new("");
    let out = system.path("out.csv");
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let (udp, port) = (free_udp_port(), system.path("imu"));
    let mut device = open_serial_device(&port);
    let endpoint = match kind {
        "tcp" => listener.local_addr().unwrap().to_string(),
        "udp" => format!("127.0.0.1:{udp}"),
        _ => port.display().to_string(),
    };
    let line = format!("{kind}:{endpoint}?rate_hz=200");
    let running = system.start(&["--source", &line, "--out", out.to_str().unwrap()]);
    let mut stream = (kind == "tcp").then(|| listener.accept().unwrap().0);
    let mut send = |line: &str| match (&mut stream, kind) {
        (Some(stream), _) => writeln!(stream, "{line}").unwrap(),
        (None, "udp") => _ = socket.send_to(line.as_bytes(), ("127.0.0.1", udp)),
        (None, _) => writeln!(device, "{line}").unwrap(),
    };
    let mut n = 0;
    let mut send_rows = |row: fn(u64) -> String, header: &[&str], count: u64| {
        header.iter().for_each(|line| send(line));
        let mut due = Instant::now();
        for _ in 0..count {
            send(&row(n));
            n += 1;
            due += Duration::from_millis(5);
            thread::sleep(due.saturating_duration_since(Instant::now()));
        }
    };
    let variants = text_variants();
    // Lines that arrive before the port is open are lost.
    wait_for("the first ticks", || {
        send_rows(variants[0].2, &[], 10);
        ticks(&system, "course") > 0
    });
    // The variants follow each other without a pause, because a pause looks like a wrong rate.
    let expected = ticks(&system, "ingest") + 80 * variants.len() as u64;
    for (_, header, row) in variants {
        send_rows(row, &header, 80);
    }
    wait_for(&format!("every row over {kind}"), || ticks(&system, "ingest") >= expected);
    assert_eq!(source_findings(&system), Vec::<String>::new(), "{kind}");
    let run = stop_and_assert_level(running, &out);
    assert_eq!(run.number("/lost"), 0.0, "{kind}");
    // A new variant restarts the clock of the source, so its first interval is not known.
    let attitudes = attitudes(&out);
    let steps = attitudes[20..].windows(2).filter(|pair| pair[1].0 - pair[0].0 < 0.02);
    let (mut count, mut yaw_rad, mut duration_s) = (0, 0.0, 0.0);
    for pair in steps {
        count += 1;
        yaw_rad += yaw_change_deg(pair[0].1, pair[1].1).to_radians();
        duration_s += pair[1].0 - pair[0].0;
    }
    assert!(count > 500, "{kind}: {count} of {} attitudes follow another one", attitudes.len());
    let rate_rad_s = yaw_rad / duration_s;
    assert!((rate_rad_s - 0.1).abs() < 1e-3, "{kind}: yaw rate {rate_rad_s} rad/s");
}

#[test]
fn stdin_in_one_process_or_as_protobuf_equals_csv() {
    let vector = |[x, y, z]: [f64; 3]| Some(v1::Vector3 { x, y, z });
    let (mut lines, mut messages) = (String::from("t_s,gx,gy,gz,ax,ay,az,mx,my,mz\n"), Vec::new());
    for n in 0..5000_i64 {
        let (rate, force, field) = ([0.0, (n as f64 * 0.01).sin(), 0.1], [0.3, 0.0, 9.75], [20.0, 0.5, -40.0]);
        let [[gx, gy, gz], [ax, ay, az], [mx, my, mz]] = [rate, force, field];
        lines += &format!("{},{gx},{gy},{gz},{ax},{ay},{az},{mx},{my},{mz}\n", n as f64 / 200.0);
        let measurement = v1::Measurement {
            t_ns: Some(n * 5_000_000),
            rate_rad_s: vector(rate),
            force_m_s2: vector(force),
            field_ut: vector(field),
            ..v1::Measurement::default()
        };
        measurement.encode_length_delimited(&mut messages).unwrap();
    }
    let output = |source: &str, input: &[u8], mode: &[&str]| {
        let system = System::new("");
        let (file, out) = (system.path("input"), system.path("out.csv"));
        fs::write(&file, input).unwrap();
        let mut command = system.command(&[&["--source", source, "--out", out.to_str().unwrap()], mode].concat());
        command.stdin(File::open(&file).unwrap());
        Running::spawn(command).wait().assert_complete();
        fs::read(out).unwrap()
    };
    let in_process: &[&str] = &["--in-process"];
    let from_lines = output("stdin?rate_hz=200", lines.as_bytes(), &[]);
    for (source, input, mode) in [
        ("stdin?rate_hz=200&format=protobuf", &*messages, &[][..]),
        ("stdin?rate_hz=200&format=protobuf", &*messages, in_process),
        // The last line has no newline.
        ("stdin?rate_hz=200", lines.trim_end().as_bytes(), in_process),
    ] {
        assert!(from_lines == output(source, input, mode), "{source} {mode:?}: the bytes differ");
    }
}

#[test]
fn problem_of_stdin_in_one_process_is_reported() {
    let run = |source: &str, input: &str| {
        let system = System::new("");
        fs::write(system.path("input"), input).unwrap();
        let mut command = system.command(&["--in-process", "--source", source]);
        command.stdin(File::open(system.path("input")).unwrap());
        Running::spawn(command).wait()
    };
    let without_time = run("stdin", &format!("gx,gy,gz,ax,ay,az\n{}", "0,0,0,0,0,9.8\n".repeat(50)));
    assert_eq!(without_time.code, Some(0), "{}", without_time.stderr);
    assert!(without_time.stderr.contains("1000 Hz is assumed"), "{}", without_time.stderr);
    let garbage = run("stdin?rate_hz=50", &"no measurement\n".repeat(200));
    assert_eq!(garbage.code, Some(1), "{}", garbage.stderr);
    for words in ["standard input yielded no reading", "name the columns with map"] {
        assert!(garbage.stderr.contains(words), "no {words:?} in:\n{}", garbage.stderr);
    }
    let system = System::new("ingest.receiver.endpoint = \"tcp:127.0.0.1:9\"\n");
    let mut command = system.command(&["--in-process", "--source", "stdin"]);
    command.stdin(Stdio::null());
    let receiver = Running::spawn(command).wait();
    assert_eq!(receiver.code, Some(2), "{}", receiver.stderr);
    assert!(receiver.stderr.contains("omit --in-process or the receiver"), "{}", receiver.stderr);
}

/// Creates the files of an industrial I/O device and returns the FIFO for its records.
fn iio_device(root: &Path) -> File {
    let device = root.join("iio:device0");
    fs::create_dir_all(device.join("scan_elements")).unwrap();
    fs::create_dir_all(device.join("buffer")).unwrap();
    let write = |name: &str, text: &str| fs::write(device.join(name), format!("{text}\n")).unwrap();
    for (name, text) in [
        ("name", "bmi160"),
        ("buffer/enable", "0"),
        ("buffer/length", "2"),
        ("current_timestamp_clock", "realtime"),
        ("sampling_frequency", "25"),
        ("in_anglvel_scale", "0.001"),
        ("in_accel_scale", "0.01"),
        // The device is mounted upside down.
        ("in_mount_matrix", "1, 0, 0; 0, -1, 0; 0, 0, -1"),
    ] {
        write(name, text);
    }
    let vectors =
        ["in_anglvel", "in_accel"].into_iter().flat_map(|name| ["x", "y", "z"].map(|axis| format!("{name}_{axis}")));
    for (index, name) in vectors.chain(["in_timestamp".into()]).enumerate() {
        write(&format!("scan_elements/{name}_en"), "0");
        write(&format!("scan_elements/{name}_type"), if index < 6 { "le:s16/16>>0" } else { "le:s64/64>>0" });
        write(&format!("scan_elements/{name}_index"), &index.to_string());
    }
    let fifo = root.join("dev/iio:device0");
    fs::create_dir_all(fifo.parent().unwrap()).unwrap();
    mkfifoat(CWD, &fifo, Mode::RUSR | Mode::WUSR).unwrap();
    OpenOptions::new().read(true).write(true).open(fifo).unwrap()
}

#[test]
fn iio_device_is_enabled_and_read() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let mut records = iio_device(root);
    let text = format!("root = \"{0}\"\ndev = \"{0}/dev\"\nrate_hz = 200\n", root.display());
    let system = System::new(&format!("[ingest.iio]\n{text}"));
    let out = system.path("out.csv");
    let running = system.start(&["--source", "iio:bmi160", "--out", out.to_str().unwrap()]);
    let task = BackgroundTask::start(Duration::from_millis(5), move |n| {
        let numbers: [i16; 6] = [0, 0, -100, 0, 0, -981];
        let mut record = numbers.map(i16::to_le_bytes).concat();
        record.resize(16, 0);
        record.extend((1_000_000_000 + n as i64 * 5_000_000).to_le_bytes());
        records.write_all(&record).is_ok()
    });
    wait_for_ticks(&system, 300);
    kill_drivers(&system, &running);
    wait_for_ticks(&system, 600);
    let content = |name: &str| fs::read_to_string(root.join("iio:device0").join(name)).unwrap();
    assert_eq!(
        ["buffer/enable", "sampling_frequency", "current_timestamp_clock"].map(content),
        ["1", "200", "monotonic"]
    );
    let run = stop_and_assert_level(running, &out);
    drop(task);
    assert_eq!(run.number("/lost"), 0.0);
    // The timestamps come from the kernel.
    assert!((attitudes(&out)[0].0 - 1.0).abs() < 1.0);
}

#[test]
fn doctor_reports_device_fault_that_is_announced_once() {
    // The baud rate is wrong: bytes arrive, but no valid message.
    let system = System::new("");
    let port = system.path("imu");
    let mut device = open_serial_device(&port);
    let line = format!("serial:{}?format=witmotion&rate_hz=200", port.display());
    let running = system.start(&["--source", &line]);
    let garbage = BackgroundTask::start(Duration::from_millis(5), move |n| {
        let noise: Vec<u8> =
            (0..33).map(|i| (n.wrapping_mul(2_654_435_761).wrapping_add(i * 97) >> 3) as u8 | 0x80).collect();
        device.write_all(&noise).is_ok()
    });
    wait_for_finding(&system, "but no witmotion message");
    assert!(source_findings(&system).iter().any(|finding| finding.contains("baud")), "no remedy with baud");
    // The device is unplugged.
    drop(garbage);
    wait_for_finding(&system, "it is retried automatically");
    running.interrupt();
    let run = running.wait();
    assert_eq!(run.stderr.matches("but no witmotion message").count(), 1, "{}", run.stderr);
}

#[test]
fn second_datagram_sender_is_reported_and_ignored() {
    let port = free_udp_port();
    let system = System::new("");
    let out = system.path("out.csv");
    let running =
        system.start(&["--source", &format!("udp:127.0.0.1:{port}?rate_hz=200"), "--out", out.to_str().unwrap()]);
    let sender = |force: &'static str| {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        BackgroundTask::start(Duration::from_millis(5), move |n| {
            let _ = socket.send_to(format!("{},0,0,0.1,{force}", n as f64 / 200.0).as_bytes(), ("127.0.0.1", port));
            true
        })
    };
    let first = sender("0,0,9.8");
    wait_for_ticks(&system, 100);
    let second = sender("9.8,0,0");
    wait_for_finding(&system, "datagrams from another sender");
    wait_for_ticks(&system, 400);
    drop(second);
    stop_and_assert_level(running, &out);
    drop(first);
}

#[test]
fn dates_of_unknown_order_in_datagrams_are_reported() {
    let port = free_udp_port();
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let _sender = BackgroundTask::start(Duration::from_millis(5), move |n| {
        let line = format!("11/05/2026 10:00:{:06.3},0,0,0.1,0,0,9.8", n as f64 / 200.0 % 60.0);
        let _ = socket.send_to(line.as_bytes(), ("127.0.0.1", port));
        true
    });
    let source = format!("udp:127.0.0.1:{port}?rate_hz=200&columns=t,gx,gy,gz,ax,ay,az");
    let system = System::new("");
    let running = system.start(&["--source", &source]);
    wait_for_finding(&system, "write the year first");
    running.interrupt();
    running.wait();
    // The remedy without a program is to leave t out of map.
    let system = System::new("");
    let running = system.start(&["--source", &format!("{source}&map=gx=gx,gy=gy,gz=gz,ax=ax,ay=ay,az=az")]);
    wait_for_ticks(&system, 100);
    assert_eq!(source_findings(&system), Vec::<String>::new());
    running.interrupt();
    assert_eq!(running.wait().code, Some(0));
}

#[test]
fn unreachable_host_is_reported_and_retried() {
    let port = free_tcp_port();
    let system = System::new("");
    let out = system.path("out.csv");
    let running =
        system.start(&["--source", &format!("tcp:127.0.0.1:{port}?rate_hz=200"), "--out", out.to_str().unwrap()]);
    wait_for_finding(&system, "start the program that listens there");
    let listener = TcpListener::bind(("127.0.0.1", port)).unwrap();
    let (mut stream, _): (TcpStream, _) = listener.accept().unwrap();
    let task = BackgroundTask::start(Duration::from_millis(5), move |n| {
        writeln!(stream, "{},0,0,0.1,0,0,{GRAVITY_M_S2}", n as f64 / 200.0).is_ok()
    });
    wait_for_ticks(&system, 100);
    wait_for("no findings", || source_findings(&system).is_empty());
    stop_and_assert_level(running, &out);
    drop(task);
}

#[test]
fn doctor_remedy_for_a_wrong_declared_rate_works() {
    let port = free_udp_port();
    let _sender = BackgroundTask::start_on_thread(Duration::from_millis(10), move || {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        move |n| {
            let _ = socket.send_to(format!("{},0,0,0.1,0,0,9.8", n as f64 / 100.0).as_bytes(), ("127.0.0.1", port));
            true
        }
    });
    let mut rate_hz = "500".to_owned();
    for is_wrong in [true, false] {
        let system = System::new("");
        let running = system.start(&["--source", &format!("udp:127.0.0.1:{port}?rate_hz={rate_hz}")]);
        wait_for_ticks(&system, 50);
        if is_wrong {
            wait_for_finding(&system, "set rate_hz = ");
            let found = source_findings(&system).concat();
            let (_, rest) = found.split_once("set rate_hz = ").unwrap();
            rate_hz = rest.chars().take_while(char::is_ascii_digit).collect();
        } else {
            // A wrong rate is reported after 3 s.
            wait_for_ticks(&system, 500);
            assert_eq!(source_findings(&system), Vec::<String>::new(), "rate_hz = {rate_hz}");
        }
        running.interrupt();
        assert_eq!(running.wait().code, Some(0));
    }
}

#[test]
fn silent_device_is_reported() {
    let system = System::new("");
    let port = system.path("imu");
    let mut device = open_serial_device(&port);
    let running = system.start(&["--source", &format!("serial:{}?format=rvc&rate_hz=100", port.display())]);
    wait_for_finding(&system, "is open but sends no data");
    running.interrupt();
    assert_eq!(running.wait().code, Some(0));
    // This read keeps the device open until the end of the test.
    let _ = device.read(&mut []);
}
