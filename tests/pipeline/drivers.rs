//! Live sources: what comes on standard input, in datagrams or over a serial line becomes attitudes.
use std::{
    fs::{self, File},
    io::{self, Read, Write},
    net::UdpSocket,
    path::{Path, PathBuf},
    process::Stdio,
    thread::sleep,
    time::Duration,
};

use crate::common::{Run, Running, System, assert_sound, attitudes, inclination_deg, signal, until};
use rustix::process::Signal;
use serde_json::Value;

const HEADER: &str = "t_s,gx,gy,gz,ax,ay,az\n";

/// A turning body at 200 Hz, so many samples.
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

/// What a replay of the file as fast as possible writes.
fn replayed(file: &Path) -> Vec<u8> {
    let system = System::new(&launch(""));
    let out = system.path("out.csv");
    let run = system.run(&["--replay", file.to_str().unwrap(), "--speed", "max", "--out", out.to_str().unwrap()]);
    run.assert_whole();
    fs::read(out).unwrap()
}

fn piped(system: &System, arguments: &[&str], input: impl Into<Stdio>) -> Running {
    let mut command = system.command(arguments);
    command.stdin(input);
    Running::of(command)
}

fn status(system: &System, service: &str) -> Option<Value> {
    system.ps().into_iter().find(|one| one["service"] == service)
}

/// A system that runs and what it says to people as it does.
struct Told {
    running: Running,
    said: PathBuf,
}

impl Told {
    fn start(system: &System, arguments: &[&str]) -> Self {
        let said = system.path("said");
        let running = Running::telling(system.command(arguments), File::create(&said).unwrap());
        Self { running, said }
    }

    fn await_saying(&self, what: &str) {
        self.await_times(what, 1);
    }

    fn await_times(&self, what: &str, count: usize) {
        until(what, || fs::read_to_string(&self.said).unwrap().matches(what).count() >= count);
    }

    fn end(self) -> Run {
        self.running.interrupt();
        let run = self.running.wait();
        assert_eq!(run.code, Some(0), "{}", fs::read_to_string(self.said).unwrap());
        run
    }
}

pub(crate) fn restarts(run: &Run) -> u64 {
    let services = run.json["services"].as_array().unwrap();
    services.iter().find(|one| one["name"] == "drivers").unwrap()["restarts"].as_u64().unwrap()
}

#[test]
fn a_recording_on_standard_input_gives_the_bytes_of_its_replay_and_ends_the_run() {
    let system = System::new(&launch(""));
    let (file, out) = (system.path("flight.csv"), system.path("out.csv"));
    // The last line has no end.
    fs::write(&file, recording(60_000).trim_end()).unwrap();
    let run = piped(&system, &["--source", "stdin", "--out", out.to_str().unwrap()], File::open(&file).unwrap()).wait();
    run.assert_whole();
    assert_eq!(run.number("/ticks_out"), 60_000.0);
    assert!(fs::read(out).unwrap() == replayed(&file), "the bytes differ");
    assert_eq!(system.remains(), Vec::<String>::new());
}

#[test]
fn a_pipe_that_is_faster_than_the_path_loses_nothing_whatever_is_frozen_meanwhile() {
    let system = System::new(&launch("ingest.source = \"stdin\""));
    let (file, out) = (system.path("flight.csv"), system.path("out.csv"));
    fs::write(&file, recording(60_000)).unwrap();
    let mut running = piped(&system, &["--out", out.to_str().unwrap()], Stdio::piped());
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
    run.assert_whole();
    assert!(fs::read(out).unwrap() == replayed(&file), "the bytes differ");
}

#[test]
fn the_end_can_be_asked_for_in_ticks() {
    let system = System::new(&launch(""));
    let file = system.path("flight.csv");
    fs::write(&file, recording(5_000)).unwrap();
    let run = piped(&system, &["--source", "stdin", "--for", "2s"], File::open(&file).unwrap()).wait();
    run.assert_whole();
    assert_eq!(run.number("/ticks_out"), 400.0);
}

#[test]
fn drivers_that_are_killed_or_frozen_are_started_again_and_go_on() {
    let system = System::new(&launch(""));
    let out = system.path("out.csv");
    let mut running = piped(&system, &["--source", "stdin", "--out", out.to_str().unwrap()], Stdio::piped());
    let mut input = running.stdin();
    // Who goes on in the midst of it has to know the columns.
    writeln!(input, "gx,gy,gz,ax,ay,az,t_s").unwrap();
    let mut t = 0;
    let mut feed = |until_ticks: f64| {
        until("ticks", || {
            t += 1;
            writeln!(input, "0,0,0.1,0,0,9.8,{}", f64::from(t) / 200.0).unwrap();
            sleep(Duration::from_millis(1));
            status(&system, "course").is_some_and(|course| course["ticks"].as_f64().unwrap() >= until_ticks)
        });
    };
    feed(50.0);
    for (at, disturbance) in [(100.0, Signal::KILL), (200.0, Signal::STOP)] {
        let before = running.service("drivers");
        signal(before, disturbance);
        until("another process", || running.services().iter().any(|(name, pid)| name == "drivers" && *pid != before));
        feed(at);
    }
    drop(input);
    let run = running.wait();
    assert_eq!(run.code, Some(0), "{}", run.people);
    assert_eq!((run.number("/lost"), restarts(&run)), (0.0, 2));
    let told = attitudes(&out);
    assert_sound(&told);
    assert!(told.iter().all(|(_, q)| inclination_deg(*q, [1.0, 0.0, 0.0, 0.0]) < 0.1), "it stands level");
}

#[test]
fn datagrams_with_and_without_a_header_become_attitudes_on_the_time_of_this_machine() {
    let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let system = System::new(&launch(""));
    let out = system.path("out.csv");
    let line = format!("udp:{port}?rate_hz=200");
    let running = system.start(&["--source", &line, "--out", out.to_str().unwrap()]);
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let mut t = 0;
    until("attitudes", || {
        t += 1;
        // Until the port is open nobody hears it.
        let _ = socket.send_to(format!("{},0,0,0.1,0,0,9.8", 7000.0 + t as f64 / 200.0).as_bytes(), port);
        sleep(Duration::from_millis(5));
        status(&system, "course").is_some_and(|course| course["ticks"].as_u64() >= Some(300))
    });
    running.interrupt();
    let run = running.wait();
    run.assert_whole();
    let times: Vec<_> = attitudes(&out).into_iter().map(|(t_s, _)| t_s).collect();
    let pairs = times.windows(2).map(|pair| pair[1] - pair[0]);
    assert!(pairs.clone().all(|dt_s| dt_s > 0.0));
    assert!(times[0] != 7000.005, "the device's own time");
}

#[test]
fn a_port_that_is_taken_is_told_with_the_remedy_and_opened_once_it_is_free() {
    let taken = UdpSocket::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap();
    let system = System::new("");
    let told = Told::start(&system, &["--source", &format!("udp:{port}?rate_hz=100")]);
    told.await_saying("stop it, or set another `listen`; it is retried automatically");
    drop(taken);
    told.await_saying(&format!("drivers: resolved: cannot read datagrams to {port}"));
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let mut t = 0;
    until("readings", || {
        t += 1;
        let _ = socket.send_to(format!("{},0,0,0.1,0,0,9.8", t as f64 / 100.0).as_bytes(), port);
        sleep(Duration::from_millis(5));
        status(&system, "ingest").is_some_and(|ingest| ingest["ticks"].as_u64() >= Some(20))
    });
    told.end();
}

/// A device on a serial line, which the drivers read by a name of the test's own. That goes before the device does: the kernel's name, `/dev/pts/N`, may be
/// another test's as soon as it is free.
pub(crate) struct Plugged {
    device: File,
    port: PathBuf,
}

impl Drop for Plugged {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.port);
    }
}

impl Read for Plugged {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        self.device.read(bytes)
    }
}

impl Write for Plugged {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.device.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.device.flush()
    }
}

pub(crate) fn plugged_in(port: &Path) -> Plugged {
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
    let device = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    grantpt(&device).unwrap();
    unlockpt(&device).unwrap();
    let name = ptsname(&device, Vec::new()).unwrap().into_string().unwrap();
    std::os::unix::fs::symlink(name, port).unwrap();
    Plugged { device: device.into(), port: port.into() }
}

#[test]
fn a_serial_line_is_read_and_opened_again_when_the_device_comes_back() {
    // Beside all that else goes on a service may be late, and is not started again for it.
    let system = System::new("restart.silence_s = 3.0");
    let port = system.path("imu");
    let line = format!("serial:{}?rate_hz=100&baud=230400", port.display());
    let told = Told::start(&system, &["--source", &line]);
    told.await_saying("imu: No such file or directory (os error 2); plug the device in");
    let mut t = 0;
    for plugged in 1..=2 {
        let mut device = plugged_in(&port);
        until("readings", || {
            t += 1;
            writeln!(device, "{},0,0,0.1,0,0,9.8", t as f64 / 100.0).unwrap();
            sleep(Duration::from_millis(5));
            status(&system, "ingest").is_some_and(|ingest| ingest["ticks"].as_u64() >= Some(50 * plugged))
        });
        drop(device);
        told.await_times("imu: No such file", 1 + plugged as usize);
    }
    let run = told.end();
    assert_eq!(run.number("/lost"), 0.0);
    assert_eq!(restarts(&run), 0);
}

#[test]
fn a_program_of_ones_own_feeds_a_system_and_goes_on_when_that_has_begun_anew() {
    let system = System::new("[ingest]\nsource = \"bus\"\nbus.rate_hz = 200\n");
    let running = system.start(&[]);
    let mut opened = None;
    until("the topic", || {
        opened = driver::Sensor::open(&system.name).ok();
        opened.is_some()
    });
    let mut sensor = opened.unwrap();
    assert_eq!(sensor.capacity(), 1200, "buffer_s is 6");
    let mut t = 0;
    let mut feed_until = |ticks: u64| {
        until("ticks", || {
            t += 1;
            // While the system begins anew nobody takes it.
            let _ = sensor.send(t * 5_000_000, [0.0, 0.0, 0.1], [0.0, 0.0, 9.8], None);
            sleep(Duration::from_millis(5));
            status(&system, "course").is_some_and(|course| course["ticks"].as_u64() >= Some(ticks))
        });
    };
    feed_until(50);
    for name in system.remains() {
        let path = Path::new("/dev/shm").join(name);
        if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) }.unwrap();
    }
    signal(running.service("gyro"), Signal::KILL);
    feed_until(300);
    running.interrupt();
    let run = running.wait();
    assert!(run.number("/ticks_out") >= 300.0, "{}", run.people);
    assert!(run.people.contains("restarting every service"), "{}", run.people);
    assert_eq!(system.remains(), Vec::<String>::new());
}

#[test]
fn a_program_that_feeds_a_system_holds_up_no_later_one_of_its_name() {
    let system = System::new("[ingest]\nsource = \"bus\"\nbus.rate_hz = 200\n");
    let mut running = system.start(&[]);
    let mut opened = None;
    until("the topic", || {
        opened = driver::Sensor::open(&system.name).ok();
        opened.is_some()
    });
    let mut sensor = opened.unwrap();
    let mut t = 0;
    let mut feed_until_ticks = || {
        until("ticks", || {
            t += 1;
            // Between two systems nobody takes it.
            let _ = sensor.send(t * 5_000_000, [0.0, 0.0, 0.1], [0.0, 0.0, 9.8], None);
            sleep(Duration::from_millis(5));
            status(&system, "course").is_some_and(|course| course["ticks"].as_u64() >= Some(50))
        });
    };
    for how in [Signal::KILL, Signal::INT, Signal::KILL] {
        feed_until_ticks();
        signal(running.pid(), how);
        running.wait();
        running = system.start(&[]);
    }
    feed_until_ticks();
    running.interrupt();
    let run = running.wait();
    assert_eq!((run.code, run.number("/lost")), (Some(0), 0.0), "{}", run.people);
    assert_eq!(system.remains(), Vec::<String>::new());
}

#[test]
fn what_is_wrong_with_a_source_is_said_before_anything_starts() {
    for (arguments, code, said) in [
        (["--source", "serail:/dev/ttyUSB0"], 3, "did you mean \"serial\"?"),
        (["--source", "stdin?format=xml"], 3, "allowed: \"csv\", \"protobuf\""),
        (["--source", "serial"], 3, "set port = "),
        (["--receiver", "tpc:gnss:1"], 3, "\"tcp:HOST:PORT\""),
        (["--receiver", "tcp:gnss:1"], 2, "name a device, too"),
        (["--map", "gx=wx"], 2, "name one of them"),
    ] {
        let run = System::new("").run(&arguments);
        assert_eq!(run.code, Some(code), "{}", run.people);
        assert!(run.people.contains(said), "{}", run.people);
    }
}
