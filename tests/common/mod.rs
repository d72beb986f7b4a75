//! Test systems: real processes with unique system names, so that tests can run in parallel.

pub(crate) mod python;
pub(crate) mod remote;
pub(crate) mod site;
pub(crate) mod terminal;
pub(crate) mod walk;

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

/// System under test: its name, folder and launch file.
pub(crate) struct System {
    pub(crate) name: String,
    pub(crate) folder: TempDir,
    /// `plumb`, or the executable with the faulty course service.
    pub(crate) executable: PathBuf,
}

/// Result of a run: exit code, JSON report and messages on standard error.
pub(crate) struct Run {
    pub(crate) code: Option<i32>,
    pub(crate) json: Value,
    pub(crate) stderr: String,
}

/// Services of the data path.
const PATH: &str = r#"["ingest", "gyro", "accel", "fuser", "course"]"#;

/// Returns the services that `plumb ps` prints, or an empty list if the system does not respond.
pub(crate) fn services(system: &str) -> Vec<Value> {
    let output = plumb(&["ps", "--json", "--system", system]).output().unwrap();
    let status: Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
    status["services"].as_array().cloned().unwrap_or_default()
}

impl System {
    /// Creates a system with a unique name and the launch file `text`.
    ///
    /// Unless `text` sets them, three keys differ from their defaults. The topic buffer and the
    /// lateness are longer, because tests must not depend on the duration of a restart on a busy
    /// machine. `services` contains only the services of the data path.
    pub(crate) fn new(text: &str) -> Self {
        let defaults = [("buffer_s", "6.0"), ("lateness_s", "4.0"), ("services", PATH)]
            .map(|(key, value)| if text.contains(key) { String::new() } else { format!("{key} = {value}\n") });
        Self::from_launch(&(defaults.concat() + text))
    }

    /// Creates a system with the launch file `text`, preceded by a line with the name.
    pub(crate) fn from_launch(text: &str) -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let name = format!("test-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::SeqCst));
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("launch.toml"), format!("name = \"{name}\"\n{text}")).unwrap();
        Self { name, folder, executable: program() }
    }

    /// Creates a system with a faulty course service. The launch file names the fault.
    pub(crate) fn with_faults(text: &str) -> Self {
        Self { executable: faulty_executable(), ..Self::new(text) }
    }

    /// Appends `text` to the launch file.
    pub(crate) fn append_launch(&self, text: &str) {
        let file = self.path("launch.toml");
        fs::write(&file, fs::read_to_string(&file).unwrap() + text).unwrap();
    }

    pub(crate) fn path(&self, file: &str) -> PathBuf {
        self.folder.path().join(file)
    }

    pub(crate) fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(&self.executable);
        command.args(["up", "--launch"]).arg(self.path("launch.toml")).args(arguments).arg("--json");
        // The state saved for the next start must stay in the test's folder.
        command.env("XDG_STATE_HOME", self.folder.path()).env_remove("STATE_DIRECTORY");
        command
    }

    /// Starts `plumb up` without waiting for it.
    pub(crate) fn start(&self, arguments: &[&str]) -> Running {
        Running::spawn(self.command(arguments))
    }

    /// Starts `plumb up` in a separate process group, as an interactive shell does.
    pub(crate) fn start_in_process_group(&self, arguments: &[&str]) -> Running {
        let mut command = self.command(arguments);
        command.process_group(0);
        Running::spawn(command)
    }

    /// Runs `plumb up` until it exits.
    pub(crate) fn run(&self, arguments: &[&str]) -> Run {
        let run = Run::from_output(self.command(arguments).output().unwrap());
        assert_eq!(self.leftovers(), Vec::<String>::new(), "files left behind: {}", run.stderr);
        run
    }

    /// Waits until every service is running.
    pub(crate) fn wait_until_running(&self) {
        self.wait_for_states(&["running"]);
    }

    /// Waits until every service is ready to receive. Messages sent by a device before that are
    /// lost.
    pub(crate) fn wait_until_ready(&self) {
        self.wait_for_states(&["ready", "running"]);
    }

    fn wait_for_states(&self, states: &[&str]) {
        wait_for(&format!("every service to be {}", states.join(" or ")), || {
            let ps = self.ps();
            ps.len() >= 5 && ps.iter().all(|one| one["state"].as_str().is_some_and(|state| states.contains(&state)))
        });
    }

    /// Returns the status of the services, or an empty list if the system does not respond.
    pub(crate) fn ps(&self) -> Vec<Value> {
        services(&self.name)
    }

    /// Requests a swap and returns the report.
    pub(crate) fn swap_once(&self, arguments: &[&str]) -> Value {
        let output = plumb(&[&["swap", "--json", "--system", &self.name], arguments].concat()).output().unwrap();
        let fail = || panic!("{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap_or_else(|_| fail())
    }

    /// Requests a swap and repeats it if the report asks for a retry, for example after a machine
    /// stall.
    pub(crate) fn swap(&self, arguments: &[&str]) -> Value {
        let asks_for_retry = |report: &Value| {
            report["reason"].as_str().is_some_and(|why| why.contains("retry") || why.contains("is in progress"))
        };
        let mut report = self.swap_once(arguments);
        for _ in 0..5 {
            if !asks_for_retry(&report) {
                break;
            }
            println!("{report}");
            std::thread::sleep(Duration::from_millis(200));
            report = self.swap_once(arguments);
        }
        report
    }

    /// Interrupts the system and checks its report and its output file `out`.
    ///
    /// Nothing may be lost or left behind, and the bytes must equal those of an undisturbed run of
    /// `launch`.
    pub(crate) fn stop_and_assert_undisturbed(&self, running: Running, out: &Path, launch: &str) -> Run {
        running.interrupt();
        let run = running.wait();
        run.assert_complete();
        run.assert_undisturbed_output(out, launch);
        assert_eq!(self.leftovers(), Vec::<String>::new());
        run
    }

    /// Returns the names of the files in `/dev/shm` and `/tmp` that belong to the system.
    pub(crate) fn leftovers(&self) -> Vec<String> {
        let dotted = format!("plumbline.{}.", self.name);
        let folder_name = format!("plumbline.{}", self.name);
        let names = |path: &str| -> Vec<String> {
            fs::read_dir(path)
                .unwrap()
                .flatten()
                .map(|entry| entry.file_name().to_string_lossy().into_owned())
                .collect()
        };
        let mut leftovers = names("/dev/shm");
        leftovers.extend(names("/tmp"));
        leftovers.retain(|name| name.starts_with(&dotted) || *name == folder_name);
        leftovers
    }
}

/// Copies a program in a separate process.
///
/// If this process wrote the copy itself, a child started at the same time by another test thread
/// would inherit the open file, and the copy could not be executed.
pub(crate) fn copy_program(program: &Path, to: &Path) {
    assert!(Command::new("cp").arg(program).arg(to).status().unwrap().success());
}

/// Running system. It is terminated when dropped.
pub(crate) struct Running {
    child: Option<Child>,
    /// Names of the services found so far, by process id.
    known_services: RefCell<HashMap<u32, String>>,
}

impl Running {
    pub(crate) fn spawn(command: Command) -> Self {
        Self::spawn_with_stderr(command, Stdio::piped())
    }

    /// Starts the command with the given standard error stream.
    pub(crate) fn spawn_with_stderr(mut command: Command, stderr: impl Into<Stdio>) -> Self {
        let child = command.stdout(Stdio::piped()).stderr(stderr).spawn().unwrap();
        Self { child: Some(child), known_services: RefCell::default() }
    }

    pub(crate) fn pid(&self) -> u32 {
        self.child.as_ref().unwrap().id()
    }

    /// Returns the standard input of the process. Can be called only once.
    pub(crate) fn stdin(&mut self) -> ChildStdin {
        self.child.as_mut().unwrap().stdin.take().unwrap()
    }

    /// Returns the name and process id of each live service.
    pub(crate) fn services(&self) -> Vec<(String, u32)> {
        let mut known = self.known_services.borrow_mut();
        children_of(self.pid())
            .into_iter()
            .filter(|pid| is_alive(*pid))
            .filter_map(|pid| {
                // The command line is read only once, because reading /proc of a dying process
                // delays its parent.
                if let Some(name) = known.get(&pid) {
                    return Some((name.clone(), pid));
                }
                let name = service_of(pid)?;
                known.insert(pid, name.clone());
                Some((name, pid))
            })
            .collect()
    }

    pub(crate) fn service(&self, name: &str) -> u32 {
        let mut found = None;
        wait_for("the service to start", || {
            found = self.services().into_iter().find(|(service, _)| service == name);
            found.is_some()
        });
        found.unwrap().1
    }

    /// Interrupts the supervisor, like Ctrl-C.
    pub(crate) fn interrupt(&self) {
        signal(self.pid(), Signal::INT);
    }

    /// Waits until all services have started and returns their names and process ids.
    pub(crate) fn all_services(&self) -> Vec<(String, u32)> {
        wait_for("five services", || self.services().len() == 5);
        self.services()
    }

    pub(crate) fn has_exited(&mut self) -> bool {
        self.child.as_mut().unwrap().try_wait().unwrap().is_some()
    }

    pub(crate) fn wait(self) -> Run {
        Run::from_output(self.output())
    }

    pub(crate) fn output(mut self) -> Output {
        self.child.take().unwrap().wait_with_output().unwrap()
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        if let Some(child) = self.child.take() {
            signal(child.id(), Signal::TERM);
            // A failed test may have left the process frozen.
            signal(child.id(), Signal::CONT);
            // The output must be read, because a full pipe would block the process forever.
            child.wait_with_output().unwrap();
        }
    }
}

impl Run {
    pub(crate) fn from_output(output: Output) -> Self {
        let stdout = String::from_utf8(output.stdout).unwrap();
        let json = stdout.lines().last().map_or(Value::Null, |line| serde_json::from_str(line).unwrap());
        Self { code: output.status.code(), json, stderr: String::from_utf8(output.stderr).unwrap() }
    }

    pub(crate) fn number(&self, pointer: &str) -> f64 {
        let value = self.json.pointer(pointer).and_then(Value::as_f64);
        value.unwrap_or_else(|| panic!("no {pointer} in {}\n{}", self.json, self.stderr))
    }

    /// Checks that the run succeeded and every tick was published exactly once.
    pub(crate) fn assert_complete(&self) {
        assert_eq!(self.code, Some(0), "{}", self.stderr);
        assert_eq!((self.number("/lost"), self.number("/duplicated")), (0.0, 0.0), "{}", self.stderr);
        assert_eq!(self.number("/ticks_in"), self.number("/ticks_out"));
    }

    /// Checks that `out` equals the output of an undisturbed run of `launch`.
    ///
    /// The undisturbed run is done in one process, with the same number of ticks. The source must
    /// be a simulation at 1 kHz.
    pub(crate) fn assert_undisturbed_output(&self, out: &Path, launch: &str) {
        let system = System::new(launch);
        let (duration, undisturbed) =
            (format!("{}s", self.number("/ticks_out") / 1000.0), system.path("undisturbed.csv"));
        let path = undisturbed.to_str().unwrap();
        system.run(&["--in-process", "--speed", "max", "--for", &duration, "--out", path]).assert_complete();
        assert!(fs::read(out).unwrap() == fs::read(undisturbed).unwrap(), "the bytes differ: {}", self.stderr);
    }

    /// Returns the line of the report that starts with `word`.
    pub(crate) fn line(&self, word: &str) -> &str {
        self.stderr.lines().find(|line| line.starts_with(word)).unwrap_or_else(|| panic!("no {word}: {}", self.stderr))
    }
}

/// Returns the program under test, which is `plumb` of this build.
///
/// The variable `PLUMBLINE_PROGRAM` can name another file, such as a packaged program for another
/// processor.
pub(crate) fn program() -> PathBuf {
    std::env::var_os("PLUMBLINE_PROGRAM").map_or_else(|| env!("CARGO_BIN_EXE_plumb").into(), PathBuf::from)
}

pub(crate) fn plumb(arguments: &[&str]) -> Command {
    let mut command = Command::new(program());
    command.args(arguments).stdin(Stdio::null());
    command
}

/// Returns the commands in a message, which are between backquotes.
pub(crate) fn commands(message: &str) -> Vec<&str> {
    message.split('`').skip(1).step_by(2).collect()
}

/// Runs `plumb` in a terminal of 24 lines and 80 columns.
pub(crate) fn output_on_terminal(arguments: &[&str]) -> Output {
    let script = format!("stty rows 24 cols 80; exec {} {}", program().display(), arguments.join(" "));
    Command::new("script").args(["-qec", &script, "/dev/null"]).stdin(Stdio::null()).output().unwrap()
}

/// Returns the output of a `plumb` command in a terminal of 24 lines and 80 columns. The command
/// must succeed.
pub(crate) fn run_on_terminal(arguments: &[&str]) -> String {
    let output = output_on_terminal(arguments);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{text}");
    text
}

/// Returns the executable that contains the faulty course service.
pub(crate) fn faulty_executable() -> PathBuf {
    example("faulty")
}

/// Returns the executable of an example, which is built with the tests.
pub(crate) fn example(name: &str) -> PathBuf {
    let file = PathBuf::from(env!("CARGO_BIN_EXE_plumb")).with_file_name("examples").join(name);
    assert!(file.is_file(), "{} does not exist; run cargo build --release --examples", file.display());
    file
}

pub(crate) fn signal(pid: u32, signal: Signal) {
    // The process may have exited.
    let _ = kill_process(Pid::from_raw(pid as i32).unwrap(), signal);
}

/// Returns `true` if the process exists and has not exited.
pub(crate) fn is_alive(pid: u32) -> bool {
    let process = Pid::from_raw(pid as i32).and_then(|pid| pidfd_open(pid, PidfdFlags::empty()).ok());
    // A pidfd becomes readable when the process exits, even before the process is reaped.
    process.is_some_and(|fd| poll(&mut [PollFd::new(&fd, PollFlags::IN)], Some(&Timespec::default())) == Ok(0))
}

pub(crate) fn children_of(pid: u32) -> Vec<u32> {
    let text = fs::read_to_string(format!("/proc/{pid}/task/{pid}/children")).unwrap_or_default();
    text.split_whitespace().map(|pid| pid.parse().unwrap()).collect()
}

/// Returns the name of the service that a process runs, or `None` for any other process.
///
/// The word `service` is not always the first argument, because the command line of an emulated
/// process starts with the emulator.
pub(crate) fn service_of(pid: u32) -> Option<String> {
    let line = fs::read(format!("/proc/{pid}/cmdline")).ok()?;
    let mut words = line.split(|byte| *byte == 0);
    words.find(|word| *word == b"service")?;
    words.next().map(|name| String::from_utf8_lossy(name).into_owned())
}

/// Waits for a condition that must become true. The timeout elapses only if a test fails.
pub(crate) fn wait_for(what: &str, done: impl FnMut() -> bool) {
    wait_for_within(Duration::from_secs(60), what, done);
}

/// Waits for a condition with a specific timeout.
pub(crate) fn wait_for_within(limit: Duration, what: &str, mut done: impl FnMut() -> bool) {
    let deadline = Instant::now() + limit;
    while !done() {
        assert!(Instant::now() < deadline, "timed out waiting for {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Returns the folder with the recordings. If it is missing, prints that the test is skipped and
/// returns `None`.
pub(crate) fn data() -> Option<PathBuf> {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = std::env::var_os("PLUMBLINE_DATA").map_or_else(|| here.join("../shared/data"), PathBuf::from);
    if folder.is_dir() {
        return Some(folder);
    }
    assert!(std::env::var_os("PLUMBLINE_DATA").is_none(), "no recordings at {}", folder.display());
    eprintln!("skipped: no recordings at {}; set PLUMBLINE_DATA to their folder", folder.display());
    None
}

/// Returns `t_s` and the quaternion of each line of an `--out` file.
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

/// Checks that the attitudes are finite and of unit length, and that their times increase.
pub(crate) fn assert_valid_attitudes(attitudes: &[(f64, [f64; 4])]) {
    for pair in attitudes.windows(2) {
        assert!(pair[1].0 > pair[0].0, "time does not increase: {pair:?}");
    }
    for (t_s, q) in attitudes {
        let norm = q.iter().map(|x| x * x).sum::<f64>().sqrt();
        assert!((norm - 1.0).abs() < 1e-12, "quaternion norm {norm} at {t_s} s");
    }
}

/// Returns the angle between the up vectors of two attitudes in degrees.
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
