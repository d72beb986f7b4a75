//! Live sources: attitudes are computed from readings provided by standard input, datagrams, serial
//! ports and user-defined programs.
use std::{
    fs::{self, File},
    io::{self, Read, Write},
    net::UdpSocket,
    path::{Path, PathBuf},
    process::Stdio,
    thread::sleep,
    time::Duration,
};

use crate::common::{Run, Running, System, assert_valid_attitudes, attitudes, inclination_deg, signal, wait_for};
use rustix::process::Signal;
use serde_json::Value;

const HEADER: &str = "t_s,gx,gy,gz,ax,ay,az\n";

/// Returns a CSV recording of a rotating body at 200 Hz.
fn recording(count: usize) -> String {
    let line = |i: usize| {
        let t_s = i as f64 / 200.0;
        let rate_rad_s = 0.4 * (0.7 * t_s).sin();
        format!("{t_s},{rate_rad_s},0.05,-0.1,{},0.2,9.7\n", 0.3 * (1.3 * t_s).cos())
    };
    HEADER.chars().chain((0..count).map(line).collect::<String>().chars()).collect()
}

fn launch(more: &str) -> String {
    format!("{more}\n[ingest.stdin]\nrate_hz = 200\n[ingest.replay]\ngnss = \"off\"\n")
}

/// Returns the output of a replay at full speed.
fn replay_output(file: &Path) -> Vec<u8> {
    let system = System::new(&launch(""));
    let out = system.path("out.csv");
    let run = system.run(&["--replay", file.to_str().unwrap(), "--speed", "max", "--out", out.to_str().unwrap()]);
    run.assert_complete();
    fs::read(out).unwrap()
}

fn start_with_stdin(system: &System, arguments: &[&str], input: impl Into<Stdio>) -> Running {
    let mut command = system.command(arguments);
    command.stdin(input);
    Running::spawn(command)
}

fn status(system: &System, service: &str) -> Option<Value> {
    system.ps().into_iter().find(|entry| entry["service"] == service)
}

/// Running system. Its standard error is written to a file, so that it can be read during the run.
struct LoggedSystem {
    running: Running,
    stderr: PathBuf,
}

impl LoggedSystem {
    fn start(system: &System, arguments: &[&str]) -> Self {
        let stderr = system.path("stderr.txt");
        let running = Running::spawn_with_stderr(system.command(arguments), File::create(&stderr).unwrap());
        Self { running, stderr }
    }

    fn wait_for_line(&self, what: &str) {
        self.wait_for_lines(what, 1);
    }

    fn wait_for_lines(&self, what: &str, count: usize) {
        wait_for(what, || fs::read_to_string(&self.stderr).unwrap().matches(what).count() >= count);
    }

    fn stop(self) -> Run {
        self.running.interrupt();
        let run = self.running.wait();
        assert_eq!(run.code, Some(0), "{}", fs::read_to_string(self.stderr).unwrap());
        run
    }
}

pub(crate) fn restarts(run: &Run) -> u64 {
    let services = run.json["services"].as_array().unwrap();
    services.iter().find(|entry| entry["name"] == "drivers").unwrap()["restarts"].as_u64().unwrap()
}

#[test]
fn recording_on_stdin_equals_replay_and_ends_run() {
    let system = System::new(&launch(""));
    let (file, out) = (system.path("flight.csv"), system.path("out.csv"));
    // The last line has no line end.
    fs::write(&file, recording(60_000).trim_end()).unwrap();
    let run =
        start_with_stdin(&system, &["--source", "stdin", "--out", out.to_str().unwrap()], File::open(&file).unwrap())
            .wait();
    run.assert_complete();
    assert_eq!(run.number("/ticks_out"), 60_000.0);
    assert!(fs::read(out).unwrap() == replay_output(&file), "the bytes differ");
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn fast_pipe_loses_nothing_while_services_freeze() {
    let system = System::new(&launch("ingest.source = \"stdin\""));
    let (file, out) = (system.path("flight.csv"), system.path("out.csv"));
    fs::write(&file, recording(60_000)).unwrap();
    let mut running = start_with_stdin(&system, &["--out", out.to_str().unwrap()], Stdio::piped());
    let mut input = running.stdin();
    let text = fs::read(&file).unwrap();
    for (part, service) in text.chunks(text.len() / 4 + 1).zip(["ingest", "fuser", "course", "ingest"]) {
        let pid = running.service(service);
        signal(pid, Signal::STOP);
        std::thread::scope(|scope| {
            scope.spawn(|| input.write_all(part).unwrap());
            sleep(Duration::from_millis(200));
            signal(pid, Signal::CONT);
        });
    }
    drop(input);
    let run = running.wait();
    run.assert_complete();
    assert!(fs::read(out).unwrap() == replay_output(&file), "the bytes differ");
}

#[test]
fn duration_limits_stdin_in_ticks() {
    let system = System::new(&launch(""));
    let file = system.path("flight.csv");
    fs::write(&file, recording(5_000)).unwrap();
    let run = start_with_stdin(&system, &["--source", "stdin", "--for", "2s"], File::open(&file).unwrap()).wait();
    run.assert_complete();
    assert_eq!(run.number("/ticks_out"), 400.0);
}

#[test]
fn killed_or_frozen_drivers_restart_and_resume() {
    let system = System::new(&launch(""));
    let out = system.path("out.csv");
    let mut running = start_with_stdin(&system, &["--source", "stdin", "--out", out.to_str().unwrap()], Stdio::piped());
    let mut input = running.stdin();
    // A restarted process must read the column names again, so the header is sent first.
    writeln!(input, "gx,gy,gz,ax,ay,az,t_s").unwrap();
    let mut t = 0;
    let mut feed = |until_ticks: f64| {
        wait_for("ticks", || {
            t += 1;
            writeln!(input, "0,0,0.1,0,0,9.8,{}", f64::from(t) / 200.0).unwrap();
            sleep(Duration::from_millis(1));
            status(&system, "course").is_some_and(|course| course["ticks"].as_f64().unwrap() >= until_ticks)
        });
    };
    feed(50.0);
    for (end_ticks, disturbance) in [(100.0, Signal::KILL), (200.0, Signal::STOP)] {
        let before = running.service("drivers");
        signal(before, disturbance);
        wait_for("another drivers process", || {
            running.services().iter().any(|(name, pid)| name == "drivers" && *pid != before)
        });
        feed(end_ticks);
    }
    drop(input);
    let run = running.wait();
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    assert_eq!((run.number("/lost"), restarts(&run)), (0.0, 2));
    let attitudes = attitudes(&out);
    assert_valid_attitudes(&attitudes);
    assert!(
        attitudes.iter().all(|(_, q)| inclination_deg(*q, [1.0, 0.0, 0.0, 0.0]) < 0.1),
        "the attitude is not level"
    );
}

#[test]
fn datagrams_become_attitudes_on_host_clock() {
    let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let system = System::new(&launch(""));
    let out = system.path("out.csv");
    let line = format!("udp:{port}?rate_hz=200");
    let running = system.start(&["--source", &line, "--out", out.to_str().unwrap()]);
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let mut t = 0;
    wait_for("attitudes", || {
        t += 1;
        // Datagrams sent before the port is open are lost.
        let _ = socket.send_to(format!("{},0,0,0.1,0,0,9.8", 7000.0 + t as f64 / 200.0).as_bytes(), port);
        sleep(Duration::from_millis(5));
        status(&system, "course").is_some_and(|course| course["ticks"].as_u64() >= Some(300))
    });
    running.interrupt();
    let run = running.wait();
    run.assert_complete();
    let times: Vec<_> = attitudes(&out).into_iter().map(|(t_s, _)| t_s).collect();
    let pairs = times.windows(2).map(|pair| pair[1] - pair[0]);
    assert!(pairs.clone().all(|dt_s| dt_s > 0.0));
    assert!(times[0] != 7000.005, "the timestamps are those of the device");
}

#[test]
fn occupied_port_is_reported_and_opened_when_free() {
    let taken = UdpSocket::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap();
    let system = System::new("");
    let logged = LoggedSystem::start(&system, &["--source", &format!("udp:{port}?rate_hz=100")]);
    logged.wait_for_line("set another `listen`; it is retried automatically");
    drop(taken);
    logged.wait_for_line(&format!("drivers: resolved: cannot read datagrams to {port}"));
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let mut t = 0;
    wait_for("readings", || {
        t += 1;
        let _ = socket.send_to(format!("{},0,0,0.1,0,0,9.8", t as f64 / 100.0).as_bytes(), port);
        sleep(Duration::from_millis(5));
        status(&system, "ingest").is_some_and(|ingest| ingest["ticks"].as_u64() >= Some(20))
    });
    logged.stop();
}

/// Serial device with a path in the test's folder.
///
/// The path is removed before the device is closed, because the kernel may reuse `/dev/pts/N` for
/// another test.
pub(crate) struct SerialDevice {
    device: File,
    port: PathBuf,
}

impl Drop for SerialDevice {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.port);
    }
}

impl Read for SerialDevice {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        self.device.read(bytes)
    }
}

impl Write for SerialDevice {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.device.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.device.flush()
    }
}

pub(crate) fn open_serial_device(port: &Path) -> SerialDevice {
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
    let device = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    grantpt(&device).unwrap();
    unlockpt(&device).unwrap();
    let name = ptsname(&device, Vec::new()).unwrap().into_string().unwrap();
    std::os::unix::fs::symlink(name, port).unwrap();
    SerialDevice { device: device.into(), port: port.into() }
}

#[test]
fn serial_port_is_reopened_when_device_returns() {
    // Other tests run in parallel and can delay a service. The delayed service must not be
    // restarted.
    let system = System::new("restart.silence_s = 3.0");
    let port = system.path("imu");
    let line = format!("serial:{}?rate_hz=100&baud=230400", port.display());
    let logged = LoggedSystem::start(&system, &["--source", &line]);
    logged.wait_for_line("plug the device in");
    let mut t = 0;
    for round in 1..=2 {
        let mut device = open_serial_device(&port);
        wait_for("readings", || {
            t += 1;
            writeln!(device, "{},0,0,0.1,0,0,9.8", t as f64 / 100.0).unwrap();
            sleep(Duration::from_millis(5));
            status(&system, "ingest").is_some_and(|ingest| ingest["ticks"].as_u64() >= Some(50 * round))
        });
        drop(device);
        logged.wait_for_lines("imu: No such file", 1 + round as usize);
    }
    let run = logged.stop();
    assert_eq!(run.number("/lost"), 0.0);
    assert_eq!(restarts(&run), 0);
}

#[test]
fn user_defined_sensor_follows_restarted_system() {
    let system = System::new("[ingest]\nsource = \"bus\"\nbus.rate_hz = 200\n");
    let running = system.start(&[]);
    let mut opened = None;
    wait_for("the topic", || {
        opened = driver::Sensor::open(&system.name).ok();
        opened.is_some()
    });
    let mut sensor = opened.unwrap();
    assert_eq!(sensor.capacity(), 1200, "buffer_s is 6");
    let mut t = 0;
    let mut feed_until = |ticks: u64| {
        wait_for("ticks", || {
            t += 1;
            // Sending fails while the system restarts.
            let _ = sensor.send(t * 5_000_000, [0.0, 0.0, 0.1], [0.0, 0.0, 9.8], None);
            sleep(Duration::from_millis(5));
            status(&system, "course").is_some_and(|course| course["ticks"].as_u64() >= Some(ticks))
        });
    };
    feed_until(50);
    for name in system.leftovers() {
        let path = Path::new("/dev/shm").join(name);
        if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) }.unwrap();
    }
    signal(running.service("gyro"), Signal::KILL);
    feed_until(300);
    running.interrupt();
    let run = running.wait();
    assert!(run.number("/ticks_out") >= 300.0, "{}", run.stderr);
    assert!(run.stderr.contains("restarting every service"), "{}", run.stderr);
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn user_defined_sensor_does_not_block_next_system() {
    let system = System::new("[ingest]\nsource = \"bus\"\nbus.rate_hz = 200\n");
    let mut running = system.start(&[]);
    let mut opened = None;
    wait_for("the topic", || {
        opened = driver::Sensor::open(&system.name).ok();
        opened.is_some()
    });
    let mut sensor = opened.unwrap();
    let mut t = 0;
    let mut feed_until_ticks = || {
        wait_for("ticks", || {
            t += 1;
            // Sending fails between the end of a system and the start of the next one.
            let _ = sensor.send(t * 5_000_000, [0.0, 0.0, 0.1], [0.0, 0.0, 9.8], None);
            sleep(Duration::from_millis(5));
            status(&system, "course").is_some_and(|course| course["ticks"].as_u64() >= Some(50))
        });
    };
    for kind in [Signal::KILL, Signal::INT, Signal::KILL] {
        feed_until_ticks();
        signal(running.pid(), kind);
        running.wait();
        running = system.start(&[]);
    }
    feed_until_ticks();
    running.interrupt();
    let run = running.wait();
    assert_eq!((run.code, run.number("/lost")), (Some(0), 0.0), "{}", run.stderr);
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn invalid_source_is_rejected_before_start() {
    for (arguments, code, message) in [
        (["--source", "serail:/dev/ttyUSB0"], 3, "did you mean \"serial\"?"),
        (["--source", "stdin?format=xml"], 3, "allowed: \"csv\", \"protobuf\""),
        (["--source", "serial"], 3, "set port = "),
        (["--receiver", "tpc:gnss:1"], 3, "\"tcp:HOST:PORT\""),
        (["--receiver", "tcp:gnss:1"], 2, "--receiver needs a device as source"),
        (["--map", "gx=wx"], 2, "add --replay or --source"),
    ] {
        let run = System::new("").run(&arguments);
        assert_eq!(run.code, Some(code), "{}", run.stderr);
        assert!(run.stderr.contains(message), "{}", run.stderr);
    }
}
