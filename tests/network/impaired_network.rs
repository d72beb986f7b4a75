//! Network with delay, packet loss and an outage, and a station that stops reading.
//!
//! The system on board is not affected, and the station counts exactly the samples that it missed.
use std::{
    fs,
    io::{BufRead, BufReader, Write},
    path::{Path, PathBuf},
    process::{Child, ChildStdin, ChildStdout, Command, Stdio},
    thread,
    time::Duration,
};

use crate::common::{
    Run, Running, System, plumb,
    remote::{number, ticks, topic},
    signal, wait_for_within,
};
use rustix::process::Signal;
use serde_json::Value;

const BOARD: &str = "10.78.0.1";
const STATION: &str = "10.78.0.2";
/// Duration of an outage. It exceeds Zenoh's lease of 3 s, so Zenoh closes the silent connection.
const OUTAGE: Duration = Duration::from_secs(12);

/// Timeout for receiving further samples over an open connection.
const SAMPLE_TIMEOUT: Duration = Duration::from_secs(60);
/// Timeout for a reconnection.
///
/// A handshake needs a dozen packets in sequence. With a delay of 300 ms and 20 % packet loss it
/// may fail several times, each time after 10 s.
const RECONNECT_TIMEOUT: Duration = Duration::from_secs(240);

/// Two network namespaces joined by a link; removed on drop.
struct Link {
    namespaces: [String; 2],
    packets: Option<(Child, ChildStdin, BufReader<ChildStdout>)>,
}

impl Link {
    fn create() -> Result<Self, String> {
        let namespaces = ["board", "station"].map(|end| format!("plumb-{}-{end}", std::process::id()));
        let mut link = Self { namespaces, packets: None };
        link.namespaces.iter().try_for_each(|name| run("ip", &["netns", "add", name]))?;
        let [board, station] = &link.namespaces;
        let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/network/link.py");
        let mut command = Command::new("python3");
        command.arg(program).args([board, &format!("{BOARD}/24"), station, &format!("{STATION}/24")]);
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().map_err(|error| format!("python3: {error}"))?;
        let (input, output) = (child.stdin.take().unwrap(), BufReader::new(child.stdout.take().unwrap()));
        let mut packets = (child, input, output);
        let mut ready = String::new();
        packets.2.read_line(&mut ready).unwrap();
        if ready.is_empty() {
            let exited = packets.0.wait_with_output().unwrap();
            return Err(String::from_utf8_lossy(&exited.stderr).into_owned());
        }
        link.packets = Some(packets);
        Ok(link)
    }

    /// Sets the delay per direction and the share of lost packets, and returns the packet counts so
    /// far.
    fn set_impairment(&mut self, delay_s: f64, loss: f64) -> Value {
        let (_, input, output) = self.packets.as_mut().unwrap();
        writeln!(input, "{delay_s} {loss}").unwrap();
        let mut line = String::new();
        output.read_line(&mut line).unwrap();
        serde_json::from_str(&line).unwrap()
    }

    fn set_state(&self, state: &str) {
        run("ip", &["-n", &self.namespaces[0], "link", "set", "wire", state]).unwrap();
    }

    fn in_namespace(&self, end: usize, inner: &Command) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.namespaces[end]]).arg(inner.get_program()).args(inner.get_args());
        command
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        if let Some((mut child, input, _)) = self.packets.take() {
            drop(input);
            let _ = child.wait();
        }
        for name in &self.namespaces {
            let _ = run("ip", &["netns", "del", name]);
        }
    }
}

fn run(program: &str, arguments: &[&str]) -> Result<(), String> {
    let output = Command::new(program).args(arguments).output().map_err(|error| format!("{program}: {error}"))?;
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    if output.status.success() { Ok(()) } else { Err(format!("{program} {}: {stderr}", arguments.join(" "))) }
}

/// Creates the keys for a listening vehicle and a viewer.
fn keys(folder: &Path) {
    for arguments in [&["init"][..], &["vehicle", "boat", "--host", BOARD], &["viewer", "wall"]] {
        let output = plumb(&["keys"]).args(arguments).arg("--dir").arg(folder).output().unwrap();
        assert!(output.status.success(), "{output:?}");
    }
}

fn boat(keys: &Path) -> System {
    let file = |name: &str| keys.join("vehicle.boat").join(name);
    System::new(&format!(
        "services = [\"ingest\", \"gyro\", \"accel\", \"fuser\", \"course\", \"gateway\"]\n[gateway]\nvehicle = \"boat\"\nlisten = [\"quic/{BOARD}:7447\"]\naccess = {:?}\ntls = {{ ca = {:?}, cert = {:?}, key = {:?} }}\nrates = {{ imu = \"all\", gyro = \"all\", fused = \"all\", attitude = \"all\" }}\n",
        file("access.json5"),
        file("ca.pem"),
        file("cert.pem"),
        file("key.pem")
    ))
}

/// `plumb station` at the far end of the link; killed on drop.
struct Station {
    child: Option<Child>,
    tables: PathBuf,
}

impl Station {
    fn start(link: &Link, keys: &Path, tables: PathBuf) -> Self {
        let mut command = plumb(&["station", "--json", "--connect", &format!("quic/{BOARD}:7447"), "--keys"]);
        command.arg(keys.join("viewer.wall")).arg("--csv").arg(&tables);
        let mut command = link.in_namespace(1, &command);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        Self { child: Some(command.spawn().unwrap()), tables }
    }

    fn signal(&self, kind: Signal) {
        signal(self.child.as_ref().unwrap().id(), kind);
    }

    /// Returns the size of the attitude table in bytes.
    fn table_bytes(&self) -> u64 {
        fs::metadata(self.tables.join("boat/attitude.csv")).map_or(0, |file| file.len())
    }

    /// Waits until more attitudes have been written.
    fn wait_for_more(&self, limit: Duration, what: &str) {
        let before = self.table_bytes();
        wait_for_within(limit, what, || self.table_bytes() > before);
    }

    /// Interrupts the station and returns its report.
    fn stop(mut self) -> Value {
        self.signal(Signal::INT);
        let output = self.child.take().unwrap().wait_with_output().unwrap();
        serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{output:?}"))
    }
}

impl Drop for Station {
    fn drop(&mut self) {
        if let Some(child) = &mut self.child {
            child.kill().unwrap();
            child.wait().unwrap();
        }
    }
}

fn latency(run: &Run) -> String {
    let us = |quantile: &str| run.number(&format!("/latency_us/{quantile}"));
    format!("{:.0} µs p50, {:.0} µs p99 in {} ticks", us("p50"), us("p99"), run.number("/ticks_out"))
}

#[test]
fn impaired_network_does_not_affect_output() {
    let folder = tempfile::tempdir().unwrap();
    let mut link = match Link::create() {
        Ok(link) => link,
        Err(error) => return eprintln!("skipped: cannot create network namespaces: {error}"),
    };
    keys(folder.path());
    let baseline_system = boat(folder.path());
    let baseline = Running::spawn(link.in_namespace(0, &baseline_system.command(&["--for", "15s"]))).wait();
    baseline.assert_complete();

    let system = boat(folder.path());
    let out = system.path("out.csv");
    let running = Running::spawn(link.in_namespace(0, &system.command(&["--out", out.to_str().unwrap()])));
    crate::common::remote::endpoint(&system);
    let station = Station::start(&link, folder.path(), system.path("tables"));
    station.wait_for_more(SAMPLE_TIMEOUT, "attitudes");

    println!("unimpaired link: {}", link.set_impairment(0.3, 0.2));
    thread::sleep(Duration::from_secs(2));
    station.wait_for_more(SAMPLE_TIMEOUT, "attitudes despite delay and loss");
    thread::sleep(Duration::from_secs(6));
    println!("300 ms and 20 %: {}", link.set_impairment(0.3, 0.2));
    link.set_state("down");
    thread::sleep(OUTAGE);
    link.set_state("up");
    station.wait_for_more(RECONNECT_TIMEOUT, "attitudes after the outage");
    println!("300 ms and 20 %, after an outage of {} s: {}", OUTAGE.as_secs(), link.set_impairment(0.0, 0.0));
    station.wait_for_more(SAMPLE_TIMEOUT, "attitudes over the unimpaired link");
    station.signal(Signal::STOP);
    thread::sleep(Duration::from_secs(5));
    station.signal(Signal::CONT);
    station.wait_for_more(SAMPLE_TIMEOUT, "attitudes after the station resumed");

    running.interrupt();
    let run = running.wait();
    run.assert_complete();
    run.assert_undisturbed_output(&out, "");
    println!("without a station: {}\nimpaired network: {}", latency(&baseline), latency(&run));

    let tables = station.tables.join("boat");
    let report = station.stop();
    println!("{report}");
    let vehicle = &report["vehicles"][0];
    assert_eq!(number(vehicle, "rejected"), 0, "{vehicle}");
    for name in ["imu", "gyro", "fused", "attitude"] {
        let topic = topic(vehicle, name);
        let ticks = ticks(&tables.join(format!("{name}.csv")));
        let (first, last) = (*ticks.first().unwrap(), *ticks.last().unwrap());
        let missing = last + 1 - first - ticks.len() as u64;
        assert!(missing > 1000 && ticks.is_sorted(), "{topic}");
        assert_eq!(missing, number(topic, "lost_samples") + number(topic, "dropped"), "{topic}");
    }
}
