//! A network that delays, loses packets, is cut and is not read from is not felt on board, and what the far end has missed it knows exactly.
use std::{
    fs,
    io::{BufRead, BufReader, Write},
    path::{Path, PathBuf},
    process::{Child, ChildStdin, ChildStdout, Command, Stdio},
    thread,
    time::Duration,
};

use crate::common::{
    Run, Running, System,
    beyond::{number, ticks, topic},
    plumb, signal, until_within,
};
use rustix::process::Signal;
use serde_json::Value;

const BOARD: &str = "10.78.0.1";
const STATION: &str = "10.78.0.2";
/// Longer than Zenoh believes in a connection from which nothing comes (its lease, 3 s).
const CUT: Duration = Duration::from_secs(12);

/// What is connected sends on.
const MORE: Duration = Duration::from_secs(60);
/// A handshake through 300 ms and 20 % loss may be given up after 10 s, and again: each needs a dozen packets in turn.
const RECONNECTED: Duration = Duration::from_secs(240);

/// Two network namespaces and the link between them; they go with the test.
struct Link {
    namespaces: [String; 2],
    packets: Option<(Child, ChildStdin, BufReader<ChildStdout>)>,
}

impl Link {
    fn lay() -> Result<Self, String> {
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
            let said = packets.0.wait_with_output().unwrap();
            return Err(String::from_utf8_lossy(&said.stderr).into_owned());
        }
        link.packets = Some(packets);
        Ok(link)
    }

    /// Delay in each direction and share of packets lost from now on; what became of the packets before.
    fn roughen(&mut self, delay_s: f64, loss: f64) -> Value {
        let (_, input, output) = self.packets.as_mut().unwrap();
        writeln!(input, "{delay_s} {loss}").unwrap();
        let mut line = String::new();
        output.read_line(&mut line).unwrap();
        serde_json::from_str(&line).unwrap()
    }

    fn set(&self, state: &str) {
        run("ip", &["-n", &self.namespaces[0], "link", "set", "wire", state]).unwrap();
    }

    fn within(&self, end: usize, inner: &Command) -> Command {
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
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    if output.status.success() { Ok(()) } else { Err(format!("{program} {}: {said}", arguments.join(" "))) }
}

/// The keys of a vehicle that listens itself, and of one who looks.
fn keys(folder: &Path) {
    for arguments in [&["init"][..], &["vehicle", "boat", "--host", BOARD], &["viewer", "wall"]] {
        let made = plumb(&["keys"]).args(arguments).arg("--dir").arg(folder).output().unwrap();
        assert!(made.status.success(), "{made:?}");
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

/// `plumb station` beyond the link, which goes when the test does.
struct Station {
    child: Option<Child>,
    tables: PathBuf,
}

impl Station {
    fn start(link: &Link, keys: &Path, tables: PathBuf) -> Self {
        let mut command = plumb(&["station", "--json", "--connect", &format!("quic/{BOARD}:7447"), "--keys"]);
        command.arg(keys.join("viewer.wall")).arg("--csv").arg(&tables);
        let mut command = link.within(1, &command);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        Self { child: Some(command.spawn().unwrap()), tables }
    }

    fn signal(&self, how: Signal) {
        signal(self.child.as_ref().unwrap().id(), how);
    }

    /// How much of the attitudes' table is written.
    fn written(&self) -> u64 {
        fs::metadata(self.tables.join("boat/attitude.csv")).map_or(0, |file| file.len())
    }

    /// Waits until more has arrived.
    fn await_more(&self, limit: Duration, what: &str) {
        let before = self.written();
        until_within(limit, what, || self.written() > before);
    }

    /// Ends it as Ctrl-C does; what it has seen.
    fn end(mut self) -> Value {
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
fn delay_loss_a_cut_and_a_reader_that_does_not_read_are_not_felt_on_board() {
    let folder = tempfile::tempdir().unwrap();
    let mut link = match Link::lay() {
        Ok(link) => link,
        Err(why) => return eprintln!("skipped: no network of one's own here: {why}"),
    };
    keys(folder.path());
    let alone = boat(folder.path());
    let nobody_looks = Running::of(link.within(0, &alone.command(&["--for", "15s"]))).wait();
    nobody_looks.assert_whole();

    let system = boat(folder.path());
    let out = system.path("out.csv");
    let running = Running::of(link.within(0, &system.command(&["--out", out.to_str().unwrap()])));
    crate::common::beyond::endpoint(&system);
    let station = Station::start(&link, folder.path(), system.path("tables"));
    station.await_more(MORE, "attitudes");

    println!("a sound link: {}", link.roughen(0.3, 0.2));
    thread::sleep(Duration::from_secs(2));
    station.await_more(MORE, "attitudes through delay and loss");
    thread::sleep(Duration::from_secs(6));
    println!("300 ms and 20 %: {}", link.roughen(0.3, 0.2));
    link.set("down");
    thread::sleep(CUT);
    link.set("up");
    station.await_more(RECONNECTED, "attitudes after the cut");
    println!("300 ms and 20 %, cut for {} s and back: {}", CUT.as_secs(), link.roughen(0.0, 0.0));
    station.await_more(MORE, "attitudes through a sound link");
    station.signal(Signal::STOP);
    thread::sleep(Duration::from_secs(5));
    station.signal(Signal::CONT);
    station.await_more(MORE, "attitudes after it slept");

    running.interrupt();
    let run = running.wait();
    run.assert_whole();
    run.assert_bytes(&out, "");
    println!("nobody looks: {}\na rough network: {}", latency(&nobody_looks), latency(&run));

    let tables = station.tables.join("boat");
    let report = station.end();
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
