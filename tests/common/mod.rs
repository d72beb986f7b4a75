//! Systems for tests: real processes, each under a name of its own, so that tests run in parallel and never meet.

pub(crate) mod beyond;
pub(crate) mod python;
pub(crate) mod site;
pub(crate) mod terminal;

use std::{
    cell::RefCell,
    collections::HashMap,
    fs,
    os::unix::process::CommandExt,
    path::{Path, PathBuf},
    process::{Child, ChildStdin, Command, Output, Stdio},
    sync::atomic::{AtomicU32, Ordering},
    time::{Duration, Instant},
};

use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    process::{Pid, PidfdFlags, Signal, kill_process, pidfd_open},
};
use serde_json::Value;
use tempfile::TempDir;

/// A system of a test: its name, its folder, its launch file.
pub(crate) struct System {
    pub(crate) name: String,
    pub(crate) folder: TempDir,
    /// `plumb`, or the executable whose services have faults.
    pub(crate) executable: PathBuf,
}

/// How a run ended.
pub(crate) struct Run {
    pub(crate) code: Option<i32>,
    pub(crate) json: Value,
    pub(crate) people: String,
}

impl System {
    /// A system whose launch file is `text` with a name that nobody else has. Unless that says otherwise its topics hold more than usual and
    /// its readers wait for longer: how long a machine with much to do takes for a restart is not what a test is about.
    pub(crate) fn new(text: &str) -> Self {
        let patience = [("buffer_s", 6.0), ("lateness_s", 4.0)]
            .map(|(key, value)| if text.contains(key) { String::new() } else { format!("{key} = {value:?}\n") });
        Self::written(&(patience.concat() + text))
    }

    /// A system whose launch file is `text` from its second line on; the first is the name.
    pub(crate) fn written(text: &str) -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let name = format!("test-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::SeqCst));
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("launch.toml"), format!("name = \"{name}\"\n{text}")).unwrap();
        Self { name, folder, executable: env!("CARGO_BIN_EXE_plumb").into() }
    }

    /// A system of the executable whose course service has the fault that the launch file names.
    pub(crate) fn with_faults(text: &str) -> Self {
        Self { executable: faulty(), ..Self::new(text) }
    }

    /// Puts more at the end of the launch file.
    pub(crate) fn add(&self, text: &str) {
        let file = self.path("launch.toml");
        fs::write(&file, fs::read_to_string(&file).unwrap() + text).unwrap();
    }

    pub(crate) fn path(&self, file: &str) -> PathBuf {
        self.folder.path().join(file)
    }

    pub(crate) fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(&self.executable);
        command.arg("up").arg(self.path("launch.toml")).args(arguments).arg("--json");
        // What a system keeps for its next start is the test's own.
        command.env("XDG_STATE_HOME", self.folder.path()).env_remove("STATE_DIRECTORY");
        command
    }

    /// Starts `plumb up` and does not wait for it.
    pub(crate) fn start(&self, arguments: &[&str]) -> Running {
        Running::of(self.command(arguments))
    }

    /// Starts `plumb up` as a shell does: in a process group of its own, which Ctrl-C goes to.
    pub(crate) fn start_as_a_shell_does(&self, arguments: &[&str]) -> Running {
        let mut command = self.command(arguments);
        command.process_group(0);
        Running::of(command)
    }

    /// Runs `plumb up` to its end.
    pub(crate) fn run(&self, arguments: &[&str]) -> Run {
        let run = Run::of(self.command(arguments).output().unwrap());
        assert_eq!(self.remains(), Vec::<String>::new(), "left behind: {}", run.people);
        run
    }

    /// Waits until the system answers that every service runs.
    pub(crate) fn all_run(&self) {
        self.all_are(&["running"]);
    }

    /// Waits until every service listens: what a device says before that, nobody gets.
    pub(crate) fn all_listen(&self) {
        self.all_are(&["ready", "running"]);
    }

    fn all_are(&self, states: &[&str]) {
        until(&format!("every service to be {}", states.join(" or ")), || {
            let ps = self.ps();
            ps.len() >= 5 && ps.iter().all(|one| one["state"].as_str().is_some_and(|state| states.contains(&state)))
        });
    }

    /// How its services are; none where it does not answer.
    pub(crate) fn ps(&self) -> Vec<Value> {
        let output = plumb(&["ps", "--json", "--system", &self.name]).output().unwrap();
        serde_json::from_slice(&output.stdout).unwrap_or_default()
    }

    /// Asks for a swap; what is answered.
    pub(crate) fn ask_swap(&self, arguments: &[&str]) -> Value {
        let output = plumb(&[&["swap", "--json", "--system", &self.name], arguments].concat()).output().unwrap();
        let said = || panic!("{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap_or_else(|_| said())
    }

    /// The same, and again where the answer asks for that, as where the machine stood still meanwhile.
    pub(crate) fn swap(&self, arguments: &[&str]) -> Value {
        let asks_for_more = |report: &Value| {
            report["reason"].as_str().is_some_and(|why| why.contains("ask again") || why.contains("still under way"))
        };
        let mut report = self.ask_swap(arguments);
        for _ in 0..5 {
            if !asks_for_more(&report) {
                break;
            }
            println!("{report}");
            std::thread::sleep(Duration::from_millis(200));
            report = self.ask_swap(arguments);
        }
        report
    }

    /// Ends the system, which has written `out`: nothing is lost or left behind, and the bytes are those of an undisturbed run of `launch`.
    pub(crate) fn assert_ends_undisturbed(&self, running: Running, out: &Path, launch: &str) -> Run {
        running.interrupt();
        let run = running.wait();
        run.assert_whole();
        run.assert_bytes(out, launch);
        assert_eq!(self.remains(), Vec::<String>::new());
        run
    }

    /// Shared memory and files that carry the system's name.
    pub(crate) fn remains(&self) -> Vec<String> {
        let dotted = format!("plumbline.{}.", self.name);
        let folder = format!("plumbline.{}", self.name);
        let names = |path: &str| -> Vec<String> {
            fs::read_dir(path)
                .unwrap()
                .flatten()
                .map(|entry| entry.file_name().to_string_lossy().into_owned())
                .collect()
        };
        let mut remains = names("/dev/shm");
        remains.extend(names("/tmp"));
        remains.retain(|name| name.starts_with(&dotted) || *name == folder);
        remains
    }
}

/// Copies a program, by a process of its own: what another test starts meanwhile would have the copy open, which could not be run then.
pub(crate) fn copied(program: &Path, to: &Path) {
    assert!(Command::new("cp").arg(program).arg(to).status().unwrap().success());
}

/// A system that runs. It ends with the test.
pub(crate) struct Running {
    child: Option<Child>,
    /// The services that have been seen, by their processes.
    seen: RefCell<HashMap<u32, String>>,
}

impl Running {
    pub(crate) fn of(command: Command) -> Self {
        Self::telling(command, Stdio::piped())
    }

    /// What it says to people goes to `stderr`.
    pub(crate) fn telling(mut command: Command, stderr: impl Into<Stdio>) -> Self {
        let child = command.stdout(Stdio::piped()).stderr(stderr).spawn().unwrap();
        Self { child: Some(child), seen: RefCell::default() }
    }

    pub(crate) fn pid(&self) -> u32 {
        self.child.as_ref().unwrap().id()
    }

    /// Where its standard input is written, once.
    pub(crate) fn stdin(&mut self) -> ChildStdin {
        self.child.as_mut().unwrap().stdin.take().unwrap()
    }

    /// The processes of the services that live, by name.
    pub(crate) fn services(&self) -> Vec<(String, u32)> {
        let mut seen = self.seen.borrow_mut();
        children_of(self.pid())
            .into_iter()
            .filter(|pid| lives(*pid))
            .filter_map(|pid| {
                // Each is looked at until it says what it is: whoever is in the folder of a dying process holds up its parent.
                if let Some(name) = seen.get(&pid) {
                    return Some((name.clone(), pid));
                }
                let line = fs::read(format!("/proc/{pid}/cmdline")).ok()?;
                let words: Vec<_> = line.split(|byte| *byte == 0).map(String::from_utf8_lossy).collect();
                let name = (words.get(1)? == "service").then(|| words[2].to_string())?;
                seen.insert(pid, name.clone());
                Some((name, pid))
            })
            .collect()
    }

    pub(crate) fn service(&self, name: &str) -> u32 {
        let mut found = None;
        until("the service to start", || {
            found = self.services().into_iter().find(|(service, _)| service == name);
            found.is_some()
        });
        found.unwrap().1
    }

    /// As Ctrl-C does.
    pub(crate) fn interrupt(&self) {
        signal(self.pid(), Signal::INT);
    }

    /// The processes of the services, once all are there.
    pub(crate) fn all_services(&self) -> Vec<(String, u32)> {
        until("five services", || self.services().len() == 5);
        self.services()
    }

    pub(crate) fn has_ended(&mut self) -> bool {
        self.child.as_mut().unwrap().try_wait().unwrap().is_some()
    }

    pub(crate) fn wait(self) -> Run {
        Run::of(self.output())
    }

    pub(crate) fn output(mut self) -> Output {
        self.child.take().unwrap().wait_with_output().unwrap()
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        if let Some(child) = self.child.take() {
            signal(child.id(), Signal::TERM);
            // A test that failed may have left it frozen.
            signal(child.id(), Signal::CONT);
            // What it says is taken, or it could wait for that for ever.
            child.wait_with_output().unwrap();
        }
    }
}

impl Run {
    pub(crate) fn of(output: Output) -> Self {
        let scripts = String::from_utf8(output.stdout).unwrap();
        let json = scripts.lines().last().map_or(Value::Null, |line| serde_json::from_str(line).unwrap());
        Self { code: output.status.code(), json, people: String::from_utf8(output.stderr).unwrap() }
    }

    pub(crate) fn number(&self, pointer: &str) -> f64 {
        let value = self.json.pointer(pointer).and_then(Value::as_f64);
        value.unwrap_or_else(|| panic!("no {pointer} in {}\n{}", self.json, self.people))
    }

    /// Everything came out once.
    pub(crate) fn assert_whole(&self) {
        assert_eq!(self.code, Some(0), "{}", self.people);
        assert_eq!((self.number("/lost"), self.number("/duplicated")), (0.0, 0.0), "{}", self.people);
        assert_eq!(self.number("/ticks_in"), self.number("/ticks_out"));
    }

    /// What it wrote to `out` is what an undisturbed run of `launch` in one process gives in as many ticks; the source is a simulation at
    /// 1 kHz.
    pub(crate) fn assert_bytes(&self, out: &Path, launch: &str) {
        let system = System::new(launch);
        let (duration, undisturbed) =
            (format!("{}s", self.number("/ticks_out") / 1000.0), system.path("undisturbed.csv"));
        let to = undisturbed.to_str().unwrap();
        system.run(&["--in-process", "--speed", "max", "--for", &duration, "--out", to]).assert_whole();
        assert!(fs::read(out).unwrap() == fs::read(undisturbed).unwrap(), "the bytes differ: {}", self.people);
    }

    /// The line of the report that starts with `word`.
    pub(crate) fn line(&self, word: &str) -> &str {
        self.people.lines().find(|line| line.starts_with(word)).unwrap_or_else(|| panic!("no {word}: {}", self.people))
    }
}

pub(crate) fn plumb(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_plumb"));
    command.args(arguments).stdin(Stdio::null());
    command
}

/// What `plumb` writes to a terminal of 24 lines and 80 columns.
pub(crate) fn on_a_terminal(arguments: &[&str]) -> String {
    let script = format!("stty rows 24 cols 80; exec {} {}", env!("CARGO_BIN_EXE_plumb"), arguments.join(" "));
    let output = Command::new("script").args(["-qec", &script, "/dev/null"]).stdin(Stdio::null()).output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{text}");
    text
}

/// The service with the faults.
pub(crate) fn faulty() -> PathBuf {
    example("faulty")
}

/// An example, which is built with the tests.
pub(crate) fn example(name: &str) -> PathBuf {
    let file = PathBuf::from(env!("CARGO_BIN_EXE_plumb")).with_file_name("examples").join(name);
    assert!(file.is_file(), "{} is not there: cargo build --release --examples", file.display());
    file
}

pub(crate) fn signal(pid: u32, signal: Signal) {
    // A process that is no more needs no signal.
    let _ = kill_process(Pid::from_raw(pid as i32).unwrap(), signal);
}

/// The process is there and has not ended.
pub(crate) fn lives(pid: u32) -> bool {
    let process = Pid::from_raw(pid as i32).and_then(|pid| pidfd_open(pid, PidfdFlags::empty()).ok());
    // It can be read once the process has ended, whether or not that has been reaped.
    process.is_some_and(|fd| poll(&mut [PollFd::new(&fd, PollFlags::IN)], Some(&Timespec::default())) == Ok(0))
}

pub(crate) fn children_of(pid: u32) -> Vec<u32> {
    let text = fs::read_to_string(format!("/proc/{pid}/task/{pid}/children")).unwrap_or_default();
    text.split_whitespace().map(|pid| pid.parse().unwrap()).collect()
}

/// Waits for something that must come; the limit is only there to end a failed test.
pub(crate) fn until(what: &str, done: impl FnMut() -> bool) {
    until_within(Duration::from_secs(60), what, done);
}

/// The same for something that may take longer.
pub(crate) fn until_within(limit: Duration, what: &str, mut done: impl FnMut() -> bool) {
    let deadline = Instant::now() + limit;
    while !done() {
        assert!(Instant::now() < deadline, "waited in vain for {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// The folder of recordings; says that the test is skipped where there is none.
pub(crate) fn data() -> Option<PathBuf> {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = std::env::var_os("PLUMBLINE_DATA").map_or_else(|| here.join("../shared/data"), PathBuf::from);
    if folder.is_dir() {
        return Some(folder);
    }
    assert!(std::env::var_os("PLUMBLINE_DATA").is_none(), "no recordings at {}", folder.display());
    eprintln!("skipped: no recordings at {} (PLUMBLINE_DATA names another place)", folder.display());
    None
}

/// `t_s` and quaternion of each line of an `--out` file.
pub(crate) fn attitudes(path: &Path) -> Vec<(f64, [f64; 4])> {
    let text = fs::read_to_string(path).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("t_s,qw,qx,qy,qz"));
    lines
        .map(|line| {
            let n: Vec<f64> = line.split(',').map(|x| x.parse().unwrap()).collect();
            (n[0], [n[1], n[2], n[3], n[4]])
        })
        .collect()
}

/// Whatever went in: finite, of unit length, time growing.
pub(crate) fn assert_sound(attitudes: &[(f64, [f64; 4])]) {
    for pair in attitudes.windows(2) {
        assert!(pair[1].0 > pair[0].0, "time does not grow: {pair:?}");
    }
    for (t_s, q) in attitudes {
        let norm = q.iter().map(|x| x * x).sum::<f64>().sqrt();
        assert!((norm - 1.0).abs() < 1e-12, "at {t_s} s the quaternion has the length {norm}");
    }
}

/// Angle between the up vectors of two attitudes, degrees.
pub(crate) fn inclination_deg(a: [f64; 4], b: [f64; 4]) -> f64 {
    let up = |[w, x, y, z]: [f64; 4]| [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)];
    let (a, b) = (up(a), up(b));
    let dot: f64 = a.iter().zip(&b).map(|(a, b)| a * b).sum();
    let cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    cross.iter().map(|x| x * x).sum::<f64>().sqrt().atan2(dot).to_degrees()
}

pub(crate) fn rms(values: impl IntoIterator<Item = f64>) -> f64 {
    let (sum, count) = values.into_iter().fold((0.0, 0.0), |(sum, count), x| (sum + x * x, count + 1.0));
    (sum / count).sqrt()
}
