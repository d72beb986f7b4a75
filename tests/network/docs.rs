//! Every example in the documentation runs, or is on a list that says why it does not.
//!
//! An example is an indented or fenced block of a Markdown file. What it is written in is seen from its first line; the lines of a shell run
//! one after the other in a folder of the file's own, with a system of the default launch file beside them where they ask one.
use std::{
    env,
    fmt::Write as _,
    fs::{self, File},
    io::{BufRead, BufReader, Read},
    net::TcpListener,
    path::{Path, PathBuf},
    process::{Child, ChildStdout, Command, Stdio},
};

use crate::common::{Run, Running, System, data, plumb, python::python, signal, wait_for};
use rustix::process::Signal;

/// Lines of a shell that do not run here, by how they begin, and why.
const LEFT_OUT: [(&str, &str); 35] = [
    ("cargo ", "builds, tests and measures this very tree, for minutes"),
    ("rustup ", "changes the toolchain of whoever tests"),
    ("export CARGO_TARGET_", "is for a compiler of another machine"),
    ("sudo apt ", "installs packages"),
    ("sudo install ", "changes the machine; deploy/trial does it in namespaces"),
    ("sudo systemd-sysusers", "changes the machine; deploy/trial does it in namespaces"),
    ("sudo systemctl ", "changes the machine; deploy/trial does it in namespaces"),
    ("sudo -u plumbline ", "needs the user that the installation makes; deploy/trial asks as that user"),
    ("systemctl ", "needs a system under systemd; deploy/trial has one"),
    ("scp ", "needs another machine"),
    ("plumb station --connect quic/192.168.1.5", "needs a router at that address; `certificates` has one here"),
    ("plumb topic hz attitude --remote alpha", "needs a router and a vehicle elsewhere; `certificates` has both here"),
    ("plumb swap fuser vqf --remote alpha", "needs a router and a vehicle elsewhere; `certificates` has both here"),
    (
        "plumb swap --remote alpha fuser vqf",
        "needs a vehicle elsewhere and an operator's keys; `certificates` has both here",
    ),
    ("plumb view", "serves a page until it is interrupted; `cockpit` looks at it in a browser"),
    ("plumb up --source 'serial:", "needs a device; `drivers` makes one"),
    ("plumb up --source 'mavlink:", "waits for an autopilot; `sources` has one of pymavlink"),
    ("plumb up --source 'iio:", "needs devices; `sources` makes one of each"),
    ("plumb up mine.toml --source 'serial:", "needs a device; `serial_tutorial` makes one"),
    ("python3 examples/serial_imu.py", "is the device; `serial_tutorial` starts it"),
    ("plumb score flights/*.mcap --reference", "needs the truth of that flight; `serial_tutorial` has it"),
    ("python3 my_imu.py |", "needs the reader's program; `sources` sends such lines"),
    ("plumb bridge ros", "needs a router of ROS 2; `bridge` has one"),
    ("plumb up --replay flights/NAME", "needs the name of a flight; `reliability` flies one again"),
    ("plumb calibrate accel", "needs a recording in six positions; `cli` makes one"),
    ("plumb calibrate mag", "needs a magnetometer that is turned about; `cli` takes one of BROAD"),
    ("plumb calibrate mounting", "needs a recording of two poses; `cli` makes one"),
    ("plumb calibrate clock", "needs a magnetometer that is turned to and fro; `cli` takes one of BROAD"),
    ("plumb calibrate gyro --live", "needs a sensor at rest; `cli` feeds one"),
    ("plumb score flight.bin", "needs a log of ArduPilot; tools/import reads one"),
    ("plumb import flight.bin", "needs a log of ArduPilot; tools/import reads one"),
    ("plumb score walk.mcap", "needs an MCAP file; tools/import reads some"),
    ("plumb score bag/", "needs a bag of ROS 2; tools/import reads some"),
    ("plumb import bag/", "needs a bag of ROS 2; tools/import reads some"),
    (
        "plumb stage test my-fuser",
        "holds a stage in Python against the whole kit, for minutes; `own_stage` does it with stages in C",
    ),
];

/// Blocks that are no examples, by how their first line begins, and what they are.
const NO_EXAMPLES: [(&str, &str); 12] = [
    ("┌── gyro", "a drawing"),
    ("plumbline: simulation s1", "what a terminal shows"),
    ("launch.toml        what runs", "the tree"),
    ("sensor, receiver ─►", "a drawing"),
    ("topics ─► gateway", "a drawing"),
    ("flight.ulg: ULog", "what a terminal shows"),
    ("RMSE, degrees", "what a terminal shows"),
    ("gyro: 1 rest", "what a terminal shows"),
    ("checkpoints of the fuser ─►", "a drawing"),
    ("let mut sensor", "a part of examples/driver.rs, which is built with the tests"),
    ("scrape_configs:", "a piece of Prometheus' configuration; `cockpit` reads what it would"),
    ("request_id:", "the fields of a message; tests/foreign/client.py sends it"),
];

/// Commands that run until they are interrupted, unless they are told how long.
const ENDLESS: [&str; 6] =
    ["plumb station", "plumb shadow", "plumb top", "plumb topic echo", "plumb topic hz", "plumb topic bw"];

/// Commands that ask a system of this machine.
const ASKING: [&str; 5] = ["plumb swap", "plumb shadow", "plumb ps", "plumb top", "plumb station"];

/// Ends with 1 while the machine has a problem, whoever's that is.
const MAY_FAIL: &str = "plumb doctor";

/// A log of PX4, as examples name it: one of the recordings, where those are.
const LOG: &str = "flight.ulg";
/// What an example makes of it.
const MADE_OF_LOG: &str = "flights/*.mcap";

/// A block of a Markdown file.
struct Block {
    place: String,
    text: String,
}

#[derive(PartialEq)]
enum Language {
    Toml,
    Python,
    Shell,
}

impl Block {
    fn first_line(&self) -> &str {
        self.text.lines().next().unwrap_or_default().trim_start()
    }

    /// What it is written in; `None` for a block that is no example.
    fn language(&self) -> Option<Language> {
        let first = self.first_line();
        let word = first.split_whitespace().next().unwrap_or_default();
        if first.starts_with('[') {
            return Some(Language::Toml);
        }
        if ["import", "from"].contains(&word) {
            return Some(Language::Python);
        }
        let is_listed = NO_EXAMPLES.iter().any(|(begins, _)| first.starts_with(begins));
        let is_shell = word == "plumb" || LEFT_OUT.iter().any(|(begins, _)| first.starts_with(begins));
        assert!(is_shell || is_listed, "{}: neither run nor listed:\n{}", self.place, self.text);
        is_shell.then_some(Language::Shell)
    }
}

/// The Markdown files, by name.
fn files() -> Vec<(String, Vec<Block>)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let docs = fs::read_dir(root.join("docs")).unwrap().map(|entry| entry.unwrap().path());
    let docs = docs.filter(|path| path.extension().is_some_and(|extension| extension == "md"));
    let mut paths: Vec<PathBuf> = ["README.md", "ARCHITECTURE.md"].map(|file| root.join(file)).into();
    paths.extend(docs);
    paths.sort();
    let name = |path: &Path| path.strip_prefix(root).unwrap().display().to_string();
    paths.iter().map(|path| (name(path), blocks(&name(path), &fs::read_to_string(path).unwrap()))).collect()
}

/// The blocks of a Markdown text: indented after an empty line, or between fences.
fn blocks(file: &str, text: &str) -> Vec<Block> {
    let mut blocks: Vec<Block> = Vec::new();
    let (mut fenced, mut indented, mut after_empty) = (false, false, true);
    for (number, line) in (1..).zip(text.lines()) {
        let fence = line.starts_with("```");
        let inside = if fenced { !fence } else { line.starts_with("    ") && (indented || after_empty) };
        if fence || inside && !fenced && !indented {
            if !(fence && fenced) {
                blocks.push(Block { place: format!("{file}:{number}"), text: String::new() });
            }
            fenced ^= fence;
        }
        indented = !fenced && (inside || indented && line.is_empty());
        after_empty = line.is_empty();
        if let Some(block) = blocks.last_mut().filter(|_| inside || indented) {
            writeln!(block.text, "{}", if fenced { line } else { line.get(4..).unwrap_or_default() }).unwrap();
        }
    }
    blocks
}

fn free_endpoint() -> String {
    format!("tcp/{}", TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap())
}

/// Where the examples of a file run, and what stands there for names that only one on a machine can have.
struct Scratch {
    system: System,
    here: Vec<(String, String)>,
    /// Systems under way, by the names they were given, in the order of their starts.
    running: Vec<(String, Running)>,
    /// Where [`LOG`] comes from.
    log: Option<PathBuf>,
}

impl Scratch {
    fn new() -> Self {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let system = System::new("");
        let [own, base, board] = [free_endpoint(), free_endpoint(), free_endpoint()];
        let name = &system.name;
        let here = [
            ("name = \"plumbline\"", format!("name = \"{name}\"")),
            ("\"base\"", format!("\"{name}-base\"")),
            ("\"board\"", format!("\"{name}-board\"")),
            ("tcp/127.0.0.1:7447", own.clone()),
            ("tcp/127.0.0.1:7451", board),
            ("tcp/127.0.0.1:7452", base),
            ("--remote plumbline", format!("--remote {name} --connect {own}")),
            ("plumb station", format!("plumb station --connect {own}")),
            // What need not last.
            ("--seconds 10", "--seconds 1".into()),
            ("--seconds 60", "--seconds 2".into()),
            // What is the reader's to fill in.
            ("/path/to/plumbline", root.display().to_string()),
            ("/etc/plumbline/launch.toml", "launch.toml".into()),
        ];
        let here = here.map(|(there, here)| (there.into(), here)).into();
        let log = data().map(|data| data.join("logs/px4_sample.ulg"));
        if let Some(log) = &log {
            fs::copy(log, system.path(LOG)).unwrap();
        }
        let scratch = Self { here, system, running: Vec::new(), log };
        for file in ["launch.toml", "deploy/split/base.toml", "deploy/split/board.toml"] {
            let text = fs::read_to_string(root.join(file)).unwrap();
            scratch.write(file, &scratch.here(&text));
        }
        scratch.record();
        scratch
    }

    fn write(&self, file: &str, text: &str) {
        let path = self.system.path(file);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }

    /// The recordings that examples name: ten seconds at rest, with every column.
    fn record(&self) {
        let mut text = String::from("t_s,gx,gy,gz,ax,ay,az,mx,my,mz,qw,qx,qy,qz,mov\n");
        for tick in 0..1000 {
            writeln!(text, "{},0,0,0,0,0,9.81,0,20,-40,1,0,0,0,1", f64::from(tick) * 0.01).unwrap();
        }
        self.write("flight.csv", &text);
        self.write("broad/trial.csv", &text);
        let of_phone = |head: &str, step: u32, columns: &str| {
            (0..300).fold(format!("{head}\n"), |text, row| text + &format!("{},{columns}\n", row * step))
        };
        self.write("phone.csv", &of_phone("time,wx,wy,wz,fx,fy,fz", 10, "0,0,1,0,0,1"));
        self.write("Gyroscope.csv", &of_phone("seconds,x,y,z", 1, "0,0,0.1"));
        self.write("Accelerometer.csv", &of_phone("seconds,x,y,z", 1, "0,0,9.8"));
        let compress = "gzip -k broad/trial.csv flight.csv && rm broad/trial.csv && cp flight.csv.gz flight_imu.csv.gz";
        assert!(self.command("sh").args(["-c", compress]).status().unwrap().success());
    }

    /// A text of the documentation with the names that hold here.
    fn here(&self, text: &str) -> String {
        self.here.iter().fold(text.to_owned(), |text, (there, here)| text.replace(there, here))
    }

    /// A command in this folder, with `plumb` on the path.
    fn command(&self, program: impl AsRef<std::ffi::OsStr>) -> Command {
        let plumb = Path::new(env!("CARGO_BIN_EXE_plumb")).parent().unwrap().to_owned();
        let path = env::join_paths([plumb].into_iter().chain(env::split_paths(&env::var_os("PATH").unwrap())));
        let mut command = Command::new(program);
        command.current_dir(self.system.folder.path()).env("PATH", path.unwrap()).stdin(Stdio::null());
        command
    }

    /// Starts what `plumb up` in the documentation starts.
    fn start(&mut self, line: &str) {
        let named =
            line.split_whitespace().find_map(|word| Path::new(word).file_stem().filter(|_| word.ends_with(".toml")));
        let name = named.map_or(String::new(), |file| format!("-{}", file.display()));
        let name = format!("{}{name}", self.system.name);
        let mut command = self.command("sh");
        command.args(["-c", &format!("exec {line}")]);
        self.running.push((name.clone(), Running::spawn(command)));
        wait_for("the system to answer", || !standings(&name).is_empty());
    }

    /// Waits until every service of every system runs.
    fn all_run(&self) {
        for (name, _) in &self.running {
            let runs = |one: &serde_json::Value| one["state"] == "running";
            wait_for("every service to run", || !standings(name).is_empty() && standings(name).iter().all(runs));
        }
    }

    fn run(&mut self, place: &str, line: &str) {
        let command = line.split(" #").next().unwrap_or_default().trim();
        let ends = ["--replay", "--for", "--source stdin"].iter().any(|words| command.contains(words));
        if command.starts_with("plumb up") && !ends {
            return self.start(command);
        }
        if ASKING.iter().any(|asking| command.starts_with(asking)) && self.running.is_empty() {
            self.start("plumb up");
        }
        self.all_run();
        println!("{place}: {command}");
        let mut child = self.command("sh");
        child.args(["-c", &format!("exec {command}")]).stdout(Stdio::piped());
        let errors = self.system.path("stderr.txt");
        let mut child = child.stderr(File::create(&errors).unwrap()).spawn().unwrap();
        let mut out = BufReader::new(child.stdout.take().unwrap());
        let endless = ENDLESS.iter().any(|endless| command.starts_with(endless)) && !command.contains("--seconds");
        let mut printed = if endless { interrupted(&mut child, &mut out) } else { String::new() };
        out.read_to_string(&mut printed).unwrap();
        let (status, said) = (child.wait().unwrap(), fs::read_to_string(errors).unwrap());
        let failed = !status.success() && !command.starts_with(MAY_FAIL);
        assert!(!failed, "{place}: {command}: {status}\n{printed}{said}");
        assert!(!(printed + &said).trim().is_empty(), "{place}: {command} says nothing");
    }

    /// Ends the systems in the order of their starts: each ends well.
    fn end(self) {
        self.all_run();
        for (name, running) in self.running {
            running.interrupt();
            let run = Run::from_output(running.output());
            assert_eq!(run.code, Some(0), "{name}: {}", run.stderr);
        }
    }
}

/// What a command that does not end printed first; then it is interrupted.
fn interrupted(child: &mut Child, out: &mut BufReader<ChildStdout>) -> String {
    let mut line = String::new();
    out.read_line(&mut line).unwrap();
    signal(child.id(), Signal::INT);
    line
}

fn standings(name: &str) -> Vec<serde_json::Value> {
    let output = plumb(&["ps", "--json", "--system", name]).output().unwrap();
    serde_json::from_slice(&output.stdout).unwrap_or_default()
}

/// A line of a shell, without what may be left out of it: `[--json]`.
fn usual(line: &str) -> String {
    let mut parts = line.split(" [-");
    let first = parts.next().unwrap_or_default().to_owned();
    parts.fold(first, |line, part| line + part.split_once(']').map_or("", |(_, rest)| rest))
}

#[test]
fn what_is_left_out_is_in_the_documentation() {
    let all: Vec<_> = files().into_iter().flat_map(|(_, blocks)| blocks).collect();
    for (begins, why) in LEFT_OUT {
        let is_there = all.iter().any(|block| block.text.lines().any(|line| line.starts_with(begins)));
        assert!(is_there, "no line begins with {begins:?} any more ({why})");
    }
    for (begins, why) in NO_EXAMPLES {
        let is_there = all.iter().any(|block| block.first_line().starts_with(begins));
        assert!(is_there, "no block begins with {begins:?} any more ({why})");
    }
}

#[test]
fn every_piece_of_a_launch_file_is_one() {
    let scratch = Scratch::new();
    let launch = fs::read_to_string(scratch.system.path("launch.toml")).unwrap();
    let above = launch.split("\n[").next().unwrap();
    for block in files().into_iter().flat_map(|(_, blocks)| blocks).filter(|it| it.language() == Some(Language::Toml)) {
        scratch.write("piece.toml", &format!("{above}\n{}", scratch.here(&block.text)));
        let output = scratch.command("plumb").args(["config", "check", "piece.toml"]).output().unwrap();
        assert!(output.status.success(), "{}: {}", block.place, String::from_utf8_lossy(&output.stderr));
    }
}

#[test]
fn every_line_of_a_shell_runs() {
    for (file, blocks) in files() {
        let mut scratch = Scratch::new();
        if file == "docs/split.md" {
            scratch.run(&file, "plumb keys init --router 192.168.1.5");
        }
        for block in blocks.iter().filter(|block| block.language() == Some(Language::Shell)) {
            let has_log = scratch.log.is_some();
            let lacks_log = |line: &str| !has_log && (line.contains(LOG) || line.contains(MADE_OF_LOG));
            let is_left_out =
                |line: &&str| lacks_log(line) || LEFT_OUT.iter().any(|(begins, _)| line.starts_with(begins));
            for line in block.text.lines().filter(|line| !line.is_empty() && !is_left_out(line)) {
                let line = scratch.here(&usual(line));
                scratch.run(&block.place, &line);
            }
        }
        scratch.end();
    }
}

#[test]
fn every_client_in_python_prints_what_arrives() {
    let Some(python) = python() else { return };
    let mut scratch = Scratch::new();
    scratch.start("plumb up");
    scratch.all_run();
    // What feeds a system is a part of examples/sensor.py, which has a test of its own.
    let is_client = |block: &Block| block.language() == Some(Language::Python) && block.text.contains("import zenoh");
    for block in files().into_iter().flat_map(|(_, blocks)| blocks).filter(is_client) {
        scratch.write("client.py", &scratch.here(&block.text));
        let mut client = scratch.command(python).args(["-u", "client.py"]).stdout(Stdio::piped()).spawn().unwrap();
        let mut out = BufReader::new(client.stdout.take().unwrap());
        let mut printed = String::new();
        for _ in 0..3 {
            out.read_line(&mut printed).unwrap();
        }
        signal(client.id(), Signal::KILL);
        client.wait().unwrap();
        let lines = printed.lines().filter(|line| line.contains("AttitudeOutputBatch")).count();
        assert_eq!(lines, 3, "{}: {printed}", block.place);
    }
    scratch.end();
}
