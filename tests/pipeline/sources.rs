//! Live sources end to end: bytes as devices send them, encoded by other projects where one does, become attitudes; what is wrong with a device
//! is named by `plumb doctor`.
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
    time::Duration,
};

use prost::Message as _;
use rustix::{
    fs::{CWD, Mode, mkfifoat},
    process::Signal,
};
use serde_json::Value;
use wire::v1;
use xsens_mti::prelude::{BusId, Frame, MessageId, PayloadLength};

use super::drivers::plugged_in;
use crate::common::{Run, Running, System, attitudes, inclination_deg, plumb, python::python, signal, until};

const GRAVITY_M_S2: f64 = 9.80665;
const LEVEL: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

/// Something that is done until it is dropped.
struct Doing {
    ends: Arc<AtomicBool>,
    thread: Option<thread::JoinHandle<()>>,
}

impl Doing {
    /// `each` is called with its number until it says that nobody listens any more.
    fn start(pause: Duration, each: impl FnMut(u64) -> bool + Send + 'static) -> Self {
        Self::made(pause, || each)
    }

    /// What is called is made by the thread that calls it.
    fn made<F: FnMut(u64) -> bool>(pause: Duration, make: impl FnOnce() -> F + Send + 'static) -> Self {
        let ends = Arc::new(AtomicBool::new(false));
        let ended = ends.clone();
        let thread = thread::spawn(move || {
            let mut each = make();
            for n in 0.. {
                if ended.load(Ordering::SeqCst) || !each(n) {
                    return;
                }
                thread::sleep(pause);
            }
        });
        Self { ends, thread: Some(thread) }
    }
}

impl Drop for Doing {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::SeqCst);
        self.thread.take().into_iter().for_each(|thread| drop(thread.join()));
    }
}

/// A program of another project that speaks for a device.
struct Device(Child);

impl Device {
    /// None where there is no Python for it. One that serves is ready when this returns.
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
    let of_service = system.ps().into_iter().find(|one| one["service"] == service);
    of_service.map_or(0, |one| one["ticks"].as_u64().unwrap())
}

fn await_ticks(system: &System, count: u64) {
    until("attitudes", || ticks(system, "course") >= count);
}

/// Ends the run, whose attitudes must be level.
fn end_level(running: Running, out: &Path) -> Run {
    running.interrupt();
    let run = running.wait();
    assert_eq!(run.code, Some(0), "{}", run.people);
    let told = attitudes(out);
    assert!(told.windows(2).all(|pair| pair[1].0 > pair[0].0), "the times grow");
    let worst = told.iter().map(|(_, q)| inclination_deg(*q, LEVEL)).fold(0.0, f64::max);
    assert!(worst < 0.2, "inclined by {worst}°");
    run
}

/// Kills the process that reads the device, and waits for the next one.
fn kill_drivers(system: &System, running: &Running) {
    signal(running.service("drivers"), Signal::KILL);
    let restarts =
        || system.ps().into_iter().find(|one| one["service"] == "drivers").map(|one| one["restarts"].as_u64());
    until("a restart", || restarts().flatten() == Some(1));
}

/// The only flight in the folder gives the attitudes that it gave.
fn assert_flown_again(flights: &Path, out: &Path) {
    let flight = fs::read_dir(flights).unwrap().next().unwrap().unwrap().path();
    let again = out.with_file_name("again.csv");
    let mut command = plumb(&["up", "--speed", "max", "--json"]);
    command.arg("--replay").arg(flight).arg("--out").arg(&again).current_dir(flights);
    let run = Run::of(command.output().unwrap());
    assert_eq!(run.code, Some(0), "{}", run.people);
    assert!(fs::read(out).unwrap() == fs::read(&again).unwrap(), "the same bytes: {}", run.people);
}

/// What the doctor found wrong with the source, with the remedies.
fn source_troubles(system: &System) -> Vec<String> {
    let output = plumb(&["doctor", "--seconds", "0.2", "--json", "--system", &system.name]).output().unwrap();
    let said: Value = serde_json::from_slice(&output.stdout).unwrap();
    let checks = said["checks"].as_array().unwrap().iter().filter(|check| check["check"] == "source");
    checks.map(|check| format!("{} → {}", check["found"], check["remedy"])).collect()
}

fn await_trouble(system: &System, what: &str) {
    let mut found = Vec::new();
    until(what, || {
        found = source_troubles(system);
        found.iter().any(|trouble| trouble.contains(what))
    });
}

/// A fix as it is on the topic `receiver`, once there is one.
fn await_fix(system: &System) -> Value {
    let mut fix = Value::Null;
    until("a fix", || {
        let echo = plumb(&["topic", "echo", "receiver", "--count", "1", "--json", "--system", &system.name]);
        let output = { echo }.output().unwrap();
        let line = String::from_utf8(output.stdout).unwrap();
        fix = line.lines().next().and_then(|line| serde_json::from_str(line).ok()).unwrap_or(Value::Null);
        fix != Value::Null
    });
    fix
}

fn assert_fix(fix: &Value, velocity_m_s: [f64; 3], has_altitude: bool) {
    let near = |found: &Value, wanted: f64| (found.as_f64().unwrap() - wanted).abs() < 2e-3;
    for (found, wanted) in fix["velocity_m_s"].as_array().unwrap().iter().zip(velocity_m_s) {
        assert!(near(found, wanted), "{fix}");
    }
    assert!(near(&fix["latitude_rad"], 48.1f64.to_radians()), "{fix}");
    assert!(near(&fix["longitude_rad"], 11.5f64.to_radians()), "{fix}");
    assert!(!has_altitude || near(&fix["altitude_m"], 520.0), "{fix}");
}

/// What the `n`th reading of a device says that lies level and turns by 10 °/s.
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
    // Each 10 ms 0.1° further.
    let yaw = ((10 * n as i64 + 18_000).rem_euclid(36_000) - 18_000) as i16;
    let numbers = [yaw, 0, 0, 0, 0, 1000].map(i16::to_le_bytes).concat();
    let covered = [&[n as u8][..], &numbers, &[0; 3]].concat();
    [&[0xaa, 0xaa][..], &covered, &[sum(&covered)]].concat()
}

fn sum(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |sum, byte| sum.wrapping_add(*byte))
}

#[test]
fn sensors_on_a_serial_line_need_one_command() {
    type Sends = fn(u64) -> Vec<u8>;
    let sensors: [(&str, u32, Sends); 3] =
        [("witmotion", 200, witmotion_cycle), ("xsens", 200, xsens_message), ("rvc", 100, rvc_frame)];
    for (format, rate_hz, sent) in sensors {
        let system = System::new("");
        let out = system.path("out.csv");
        let port = system.path("imu");
        let mut device = plugged_in(&port);
        let line = format!("serial:{}?format={format}&baud=115200&rate_hz={rate_hz}", port.display());
        let running = system.start(&["--source", &line, "--out", out.to_str().unwrap()]);
        let pause = Duration::from_secs(1) / rate_hz;
        let doing = Doing::start(pause, move |n| device.write_all(&sent(n)).is_ok());
        await_ticks(&system, 300);
        assert_eq!(source_troubles(&system), Vec::<String>::new(), "{format}");
        running.interrupt();
        drop(doing);
        let run = end_level(running, &out);
        assert_eq!(run.number("/lost"), 0.0, "{format}");
        // Those with no time of their own are counted, and what comes together is spread evenly.
        let told = attitudes(&out);
        let half = &told[told.len() / 2..];
        let longest = half.windows(2).map(|pair| pair[1].0 - pair[0].0).fold(0.0, f64::max);
        assert!(longest < 0.05, "{format}: an interval of {longest} s");
        let [(first_s, first), (last_s, last)] = [half[0], half[half.len() - 1]];
        let rate_deg_s = heading_deg(first, last) / (last_s - first_s);
        assert!((rate_deg_s - 10.0).abs() < 0.2, "{format}: it turns by {rate_deg_s} °/s");
    }
}

/// How far it has turned about the vertical, less than half a turn.
fn heading_deg(from: [f64; 4], to: [f64; 4]) -> f64 {
    let yaw = |[w, x, y, z]: [f64; 4]| (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z));
    (yaw(to) - yaw(from)).sin_cos().0.atan2((yaw(to) - yaw(from)).cos()).to_degrees()
}

#[test]
fn an_autopilot_as_pymavlink_speaks_for_it_gives_its_imu_and_its_receiver() {
    let port = free_udp_port();
    let Some(_device) = Device::start("mavlink", port, false) else { return };
    let system = System::new("");
    let out = system.path("out.csv");
    let line = format!("mavlink:udpin:127.0.0.1:{port}?rate_hz=200");
    let flights = system.path("flights");
    let recorded = ["--record", flights.to_str().unwrap(), "--out", out.to_str().unwrap()];
    let running = system.start(&[&["--source", &line][..], &recorded].concat());
    await_ticks(&system, 300);
    assert_fix(&await_fix(&system), [5.0 / 2f64.sqrt(), 5.0 / 2f64.sqrt(), 0.0], true);
    assert_eq!(source_troubles(&system), Vec::<String>::new());
    kill_drivers(&system, &running);
    await_ticks(&system, 600);
    end_level(running, &out);
    assert_flown_again(&flights, &out);
}

#[test]
fn receivers_as_pyubx2_and_pynmeagps_speak_for_them_stand_beside_any_source() {
    for format in ["ubx", "nmea"] {
        let (imu, gnss) = (free_udp_port(), free_tcp_port());
        let Some(_device) = Device::start(format, gnss, true) else { return };
        let receiver = format!("tcp:127.0.0.1:{gnss}?format={format}");
        let system = System::new("");
        let out = system.path("out.csv");
        let line = format!("udp:127.0.0.1:{imu}?rate_hz=200");
        let running = system.start(&["--source", &line, "--receiver", &receiver, "--out", out.to_str().unwrap()]);
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let doing = Doing::start(Duration::from_millis(5), move |n| {
            let _ = socket.send_to(format!("{},0,0,0.1,0,0,9.8", n as f64 / 200.0).as_bytes(), ("127.0.0.1", imu));
            true
        });
        await_ticks(&system, 100);
        assert_fix(&await_fix(&system), [5.0 / 2f64.sqrt(), 5.0 / 2f64.sqrt(), 0.0], format == "ubx");
        drop(doing);
        end_level(running, &out);
    }
}

#[test]
fn a_receiver_stands_beside_a_program_of_ones_own() {
    let gnss = free_tcp_port();
    let Some(_device) = Device::start("ubx", gnss, true) else { return };
    let system = System::new(&format!(
        "[ingest]\nsource = \"bus\"\nbus.rate_hz = 200\nreceiver = {{ endpoint = \"tcp:127.0.0.1:{gnss}\" }}\n"
    ));
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    let name = system.name.clone();
    let doing = Doing::made(Duration::from_millis(5), move || {
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
    await_ticks(&system, 100);
    assert_fix(&await_fix(&system), [5.0 / 2f64.sqrt(), 5.0 / 2f64.sqrt(), 0.0], true);
    drop(doing);
    end_level(running, &out);
}

#[test]
fn lines_of_another_program_over_a_connection_have_their_names_units_and_axes() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let system = System::new("");
    let out = system.path("out.csv");
    let line = format!("tcp:{}?rate_hz=200", listener.local_addr().unwrap());
    let map = ["--map", "t=ms,gx=wx,gy=wy,gz=wz,ax=fx,ay=fy,az=fz", "--units", "deg/s,g,ms", "--frame", "frd"];
    let running = system.start(&[&["--source", &line, "--out", out.to_str().unwrap()][..], &map].concat());
    // A connection that is lost is made again.
    for round in 1..=2 {
        let (mut stream, _) = listener.accept().unwrap();
        writeln!(stream, "ms;fx;fy;fz;wx;wy;wz;temperature").unwrap();
        let doing =
            Doing::start(Duration::from_millis(5), move |n| writeln!(stream, "{},5;0;0;-1;0;0;5,7;21", 5 * n).is_ok());
        await_ticks(&system, 200 * round);
        drop(doing);
    }
    let run = end_level(running, &out);
    assert_eq!(run.number("/lost"), 0.0);
}

#[test]
fn messages_of_the_schema_on_standard_input_give_what_the_lines_give() {
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
    let of = |source: &str, input: &[u8]| {
        let system = System::new("");
        let (file, out) = (system.path("input"), system.path("out.csv"));
        fs::write(&file, input).unwrap();
        let mut command = system.command(&["--source", source, "--out", out.to_str().unwrap()]);
        command.stdin(File::open(&file).unwrap());
        Running::of(command).wait().assert_whole();
        fs::read(out).unwrap()
    };
    let found = of("stdin?rate_hz=200&format=protobuf", &messages);
    assert!(found == of("stdin?rate_hz=200", lines.as_bytes()), "the bytes differ");
}

/// A device of industrial I/O as the kernel makes it, whose records come through a FIFO.
fn iio_device(root: &Path) -> File {
    let device = root.join("iio:device0");
    fs::create_dir_all(device.join("scan_elements")).unwrap();
    fs::create_dir_all(device.join("buffer")).unwrap();
    let put = |name: &str, text: &str| fs::write(device.join(name), format!("{text}\n")).unwrap();
    for (name, text) in [
        ("name", "bmi160"),
        ("buffer/enable", "0"),
        ("buffer/length", "2"),
        ("current_timestamp_clock", "realtime"),
        ("sampling_frequency", "25"),
        ("in_anglvel_scale", "0.001"),
        ("in_accel_scale", "0.01"),
        // Mounted upside down.
        ("in_mount_matrix", "1, 0, 0; 0, -1, 0; 0, 0, -1"),
    ] {
        put(name, text);
    }
    let vectors =
        ["in_anglvel", "in_accel"].into_iter().flat_map(|name| ["x", "y", "z"].map(|axis| format!("{name}_{axis}")));
    for (index, name) in vectors.chain(["in_timestamp".into()]).enumerate() {
        put(&format!("scan_elements/{name}_en"), "0");
        put(&format!("scan_elements/{name}_type"), if index < 6 { "le:s16/16>>0" } else { "le:s64/64>>0" });
        put(&format!("scan_elements/{name}_index"), &index.to_string());
    }
    let fifo = root.join("dev/iio:device0");
    fs::create_dir_all(fifo.parent().unwrap()).unwrap();
    mkfifoat(CWD, &fifo, Mode::RUSR | Mode::WUSR).unwrap();
    OpenOptions::new().read(true).write(true).open(fifo).unwrap()
}

#[test]
fn a_device_of_industrial_io_is_switched_on_and_read() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let mut records = iio_device(root);
    let text = format!("root = \"{0}\"\ndev = \"{0}/dev\"\nrate_hz = 200\n", root.display());
    let system = System::new(&format!("[ingest.iio]\n{text}"));
    let out = system.path("out.csv");
    let running = system.start(&["--source", "iio:bmi160", "--out", out.to_str().unwrap()]);
    let doing = Doing::start(Duration::from_millis(5), move |n| {
        let numbers: [i16; 6] = [0, 0, -100, 0, 0, -981];
        let mut record = numbers.map(i16::to_le_bytes).concat();
        record.resize(16, 0);
        record.extend((1_000_000_000 + n as i64 * 5_000_000).to_le_bytes());
        records.write_all(&record).is_ok()
    });
    await_ticks(&system, 300);
    kill_drivers(&system, &running);
    await_ticks(&system, 600);
    let said = |name: &str| fs::read_to_string(root.join("iio:device0").join(name)).unwrap();
    assert_eq!(["buffer/enable", "sampling_frequency", "current_timestamp_clock"].map(said), ["1", "200", "monotonic"]);
    let run = end_level(running, &out);
    drop(doing);
    assert_eq!(run.number("/lost"), 0.0);
    // The times are the kernel's.
    assert!((attitudes(&out)[0].0 - 1.0).abs() < 1.0);
}

#[test]
fn what_is_wrong_with_a_device_is_named_by_the_doctor_and_told_once() {
    // Of another speed: bytes, and no message among them.
    let system = System::new("");
    let port = system.path("imu");
    let mut device = plugged_in(&port);
    let line = format!("serial:{}?format=witmotion&rate_hz=200", port.display());
    let running = system.start(&["--source", &line]);
    let garbage = Doing::start(Duration::from_millis(5), move |n| {
        let noise: Vec<u8> =
            (0..33).map(|i| (n.wrapping_mul(2_654_435_761).wrapping_add(i * 97) >> 3) as u8 | 0x80).collect();
        device.write_all(&noise).is_ok()
    });
    await_trouble(&system, "but no witmotion message");
    assert!(source_troubles(&system).iter().any(|trouble| trouble.contains("baud")), "the remedy");
    // Unplugged.
    drop(garbage);
    await_trouble(&system, "it is retried automatically");
    running.interrupt();
    let run = running.wait();
    assert_eq!(run.people.matches("but no witmotion message").count(), 1, "{}", run.people);
}

#[test]
fn a_second_sender_is_named_and_left_out() {
    let port = free_udp_port();
    let system = System::new("");
    let out = system.path("out.csv");
    let running =
        system.start(&["--source", &format!("udp:127.0.0.1:{port}?rate_hz=200"), "--out", out.to_str().unwrap()]);
    let sender = |force: &'static str| {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        Doing::start(Duration::from_millis(5), move |n| {
            let _ = socket.send_to(format!("{},0,0,0.1,{force}", n as f64 / 200.0).as_bytes(), ("127.0.0.1", port));
            true
        })
    };
    let first = sender("0,0,9.8");
    await_ticks(&system, 100);
    let second = sender("9.8,0,0");
    await_trouble(&system, "datagrams from another sender");
    await_ticks(&system, 400);
    drop(second);
    end_level(running, &out);
    drop(first);
}

#[test]
fn a_host_that_is_not_there_is_named_and_found_when_it_comes() {
    let port = free_tcp_port();
    let system = System::new("");
    let out = system.path("out.csv");
    let running =
        system.start(&["--source", &format!("tcp:127.0.0.1:{port}?rate_hz=200"), "--out", out.to_str().unwrap()]);
    await_trouble(&system, "start the program that listens there");
    let listener = TcpListener::bind(("127.0.0.1", port)).unwrap();
    let (mut stream, _): (TcpStream, _) = listener.accept().unwrap();
    let doing = Doing::start(Duration::from_millis(5), move |n| {
        writeln!(stream, "{},0,0,0.1,0,0,{GRAVITY_M_S2}", n as f64 / 200.0).is_ok()
    });
    await_ticks(&system, 100);
    until("all well", || source_troubles(&system).is_empty());
    end_level(running, &out);
    drop(doing);
}

#[test]
fn a_device_that_falls_silent_is_named() {
    let system = System::new("");
    let port = system.path("imu");
    let mut device = plugged_in(&port);
    let running = system.start(&["--source", &format!("serial:{}?format=rvc&rate_hz=100", port.display())]);
    await_trouble(&system, "is open but sends no data");
    running.interrupt();
    assert_eq!(running.wait().code, Some(0));
    // The other end stayed open.
    let _ = device.read(&mut []);
}
