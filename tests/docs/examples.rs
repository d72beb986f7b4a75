//! Every example in the documentation is run, unless [`exceptions`](super::exceptions) lists it.
//!
//! An example is an indented or fenced block of a Markdown file. Its language is the word after the
//! fence, or follows from its first line. The shell lines of a file run in order in a separate
//! folder. Blocks fenced as `text` are skipped.
use std::{
    env,
    fmt::Write as _,
    fs::{self, File},
    io::{BufRead, BufReader, Read},
    net::TcpListener,
    os::unix::fs::symlink,
    path::Path,
    process::{Child, ChildStdout, Command, Stdio},
};

use super::{
    exceptions::{
        FLIGHT_FROM_LOG, FOLDERS_WITHOUT_EXAMPLES, LOG, MAY_FAIL, NEEDS_SYSTEM, NOT_EXAMPLES, NOT_RUN, UNLIMITED,
    },
    markdown::{self, Block},
    root,
};
use crate::common::{Run, Running, System, data, python::python, signal, wait_for, walk::Walk};
use rustix::process::Signal;

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

    /// Returns the language, or `None` if the block is not an example.
    ///
    /// # Panics
    ///
    /// Panics if the language of the block is unknown and the block is not a listed exception.
    fn example_language(&self) -> Option<Language> {
        let first = self.first_line();
        let is_listed = NOT_EXAMPLES.iter().any(|(beginning, _)| first.starts_with(beginning));
        match self.language.as_str() {
            "text" => return None,
            _ if is_listed => return None,
            "toml" => return Some(Language::Toml),
            "python" => return Some(Language::Python),
            "sh" | "bash" | "shell" => return Some(Language::Shell),
            _ => {}
        }
        let word = first.split_whitespace().next().unwrap_or_default();
        if first.starts_with('[') {
            return Some(Language::Toml);
        }
        if ["import", "from"].contains(&word) {
            return Some(Language::Python);
        }
        let is_shell =
            ["plumb", "python3"].contains(&word) || NOT_RUN.iter().any(|(beginning, _)| first.starts_with(beginning));
        assert!(is_shell, "{}: block is neither an example nor listed in exceptions.rs:\n{}", self.location, self.text);
        Some(Language::Shell)
    }
}

/// Returns the Markdown files that may contain examples, each with its blocks.
fn files() -> Vec<(String, Vec<Block>)> {
    let has_examples = |file: &str| !FOLDERS_WITHOUT_EXAMPLES.iter().any(|(folder, _)| file.starts_with(folder));
    let files = markdown::files().into_iter().filter(|(file, _)| has_examples(file));
    files.map(|(file, text)| (file.clone(), markdown::blocks(&file, &text))).collect()
}

/// Returns all blocks of a language.
fn examples(language: &Language) -> Vec<Block> {
    let blocks = files().into_iter().flat_map(|(_, blocks)| blocks);
    blocks.filter(|block| block.example_language().as_ref() == Some(language)).collect()
}

fn free_endpoint() -> String {
    format!("tcp/{}", TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap())
}

/// Folder in which the examples of a file run.
struct Scratch {
    system: System,
    /// Texts that occur in examples, each with its replacement. A replacement is, for example, a
    /// unique name or port.
    replacements: Vec<(String, String)>,
    /// Running systems with their names, in start order.
    running: Vec<(String, Running)>,
    has_log: bool,
}

impl Scratch {
    fn new() -> Self {
        let root = root();
        let system = System::new("");
        let [own, base, board] = [free_endpoint(), free_endpoint(), free_endpoint()];
        let name = &system.name;
        let replacements = [
            ("name = \"plumbline\"", format!("name = \"{name}\"")),
            ("\"base\"", format!("\"{name}-base\"")),
            ("\"board\"", format!("\"{name}-board\"")),
            ("tcp/127.0.0.1:7447", own.clone()),
            ("tcp/127.0.0.1:7451", board),
            ("tcp/127.0.0.1:7452", base),
            ("--remote plumbline", format!("--remote {name} --connect {own}")),
            ("plumb station", format!("plumb station --connect {own}")),
            // Shorter durations.
            ("--for 10s", "--for 1s".into()),
            ("--for 1m", "--for 2s".into()),
            // Placeholder paths, which a reader of the documentation has to replace.
            ("/path/to/plumbline", root.display().to_string()),
            ("/etc/plumbline/launch.toml", "launch.toml".into()),
        ];
        let replacements = replacements.map(|(text, replacement)| (text.into(), replacement)).into();
        let log = data().map(|data| data.join("logs/px4_sample.ulg"));
        if let Some(log) = &log {
            fs::copy(log, system.path(LOG)).unwrap();
        }
        let scratch = Self { replacements, system, running: Vec::new(), has_log: log.is_some() };
        for file in ["launch.toml", "deploy/split/base.toml", "deploy/split/board.toml"] {
            let text = fs::read_to_string(root.join(file)).unwrap();
            scratch.write(file, &scratch.replace(&text));
        }
        symlink(root.join("samples"), scratch.system.path("samples")).unwrap();
        scratch.write_recordings();
        scratch
    }

    fn write(&self, file: &str, text: &str) {
        let path = self.system.path(file);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }

    /// Writes the recordings that examples name. Each recording covers a few seconds at rest.
    fn write_recordings(&self) {
        let mut text = String::from("t_s,gx,gy,gz,ax,ay,az,mx,my,mz,qw,qx,qy,qz,mov\n");
        for tick in 0..1000 {
            writeln!(text, "{},0,0,0,0,0,9.81,0,20,-40,1,0,0,0,1", f64::from(tick) * 0.01).unwrap();
        }
        self.write("flight.csv", &text);
        self.write("broad/trial.csv", &text);
        let phone = |header: &str, step: u32, columns: &str| {
            (0..300).fold(format!("{header}\n"), |text, row| text + &format!("{},{columns}\n", row * step))
        };
        self.write("phone.csv", &phone("time,wx,wy,wz,fx,fy,fz", 10, "0,0,1,0,0,1"));
        // The clock goes back once.
        let [first, second] = [phone("millis,wx,wy,wz,fx,fy,fz", 10, "0,0,0,0,0,9.8"), phone("", 10, "0,0,0,0,0,9.8")];
        self.write("log.csv", &(first + second.trim_start()));
        self.write("Gyroscope.csv", &phone("seconds,x,y,z", 1, "0,0,0.1"));
        self.write("Accelerometer.csv", &phone("seconds,x,y,z", 1, "0,0,9.8"));
        let compress = "gzip -k broad/trial.csv flight.csv && rm broad/trial.csv && cp flight.csv.gz flight_imu.csv.gz";
        assert!(self.command("sh").args(["-c", compress]).status().unwrap().success());
    }

    fn replace(&self, text: &str) -> String {
        self.replacements.iter().fold(text.to_owned(), |text, (from, to)| text.replace(from, to))
    }

    /// Returns a command in this folder, with `plumb` on the path.
    fn command(&self, program: impl AsRef<std::ffi::OsStr>) -> Command {
        let plumb = Path::new(env!("CARGO_BIN_EXE_plumb")).parent().unwrap().to_owned();
        let path = env::join_paths([plumb].into_iter().chain(env::split_paths(&env::var_os("PATH").unwrap())));
        let mut command = Command::new(program);
        command.current_dir(self.system.folder.path()).env("PATH", path.unwrap()).stdin(Stdio::null());
        command
    }

    /// Starts a system in the background.
    fn start(&mut self, line: &str) {
        let launch_file =
            line.split_whitespace().find_map(|word| Path::new(word).file_stem().filter(|_| word.ends_with(".toml")));
        let suffix = launch_file.map_or(String::new(), |file| format!("-{}", file.display()));
        let name = format!("{}{suffix}", self.system.name);
        let mut command = self.command("sh");
        command.args(["-c", &format!("exec {line}")]);
        self.running.push((name.clone(), Running::spawn(command)));
        wait_for("the system to respond", || !services(&name).is_empty());
    }

    /// Waits until every service of every system runs.
    fn wait_until_running(&self) {
        for (name, _) in &self.running {
            let is_running = |service: &serde_json::Value| service["state"] == "running";
            wait_for("every service to run", || {
                let services = services(name);
                !services.is_empty() && services.iter().all(is_running)
            });
        }
    }

    /// Runs a shell line and returns what it prints to standard output, or starts a system in the
    /// background.
    ///
    /// A command must succeed and print something.
    fn run(&mut self, location: &str, line: &str) -> String {
        let command = line.split(" #").next().unwrap_or_default().trim();
        let is_limited = ["--replay", "--for", "--source stdin"].iter().any(|option| command.contains(option));
        if command.starts_with("plumb up") && !is_limited {
            self.start(command);
            return String::new();
        }
        let begins = |list: &[&str]| list.iter().any(|beginning| command.starts_with(beginning));
        if begins(NEEDS_SYSTEM) && self.running.is_empty() {
            self.start("plumb up");
        }
        self.wait_until_running();
        println!("{location}: {command}");
        let mut child = self.command("sh");
        child.args(["-c", &format!("exec {command}")]).stdout(Stdio::piped());
        let stderr = self.system.path("stderr.txt");
        let mut child = child.stderr(File::create(&stderr).unwrap()).spawn().unwrap();
        let mut stdout = BufReader::new(child.stdout.take().unwrap());
        let is_unlimited = begins(UNLIMITED) && !command.contains("--for");
        let mut printed = if is_unlimited { first_line_then_interrupt(&mut child, &mut stdout) } else { String::new() };
        stdout.read_to_string(&mut printed).unwrap();
        let (status, messages) = (child.wait().unwrap(), fs::read_to_string(stderr).unwrap());
        assert!(status.success() || begins(MAY_FAIL), "{location}: {command}: {status}\n{printed}{messages}");
        assert!(!(printed.clone() + &messages).trim().is_empty(), "{location}: {command} prints nothing");
        printed
    }

    /// Runs the shell examples of a file. If a Python block is a complete stage, writes it to the
    /// folder that `plumb stage new` has created, as the documentation asks its readers to do.
    fn run_examples(&mut self, file: &str, blocks: &[Block]) {
        let mut walk = Walk::start(file);
        let mut printed = String::new();
        for block in blocks {
            if block.location.starts_with("docs/tutorials/") && block.first_line().starts_with("RMSE, degrees") {
                assert_eq!(without_cost(&block.text), without_cost(&printed), "{}", block.location);
            }
            if block.text.contains("plumbline.run(MyFuser)") {
                self.write("my-fuser/my_fuser.py", &block.text);
            }
            if block.example_language() != Some(Language::Shell) {
                continue;
            }
            for line in block.text.lines().filter(|line| !line.is_empty()) {
                let lacks_log = !self.has_log && (line.contains(LOG) || line.contains(FLIGHT_FROM_LOG));
                if !lacks_log && !NOT_RUN.iter().any(|(beginning, _)| line.starts_with(beginning)) {
                    let line = self.replace(&without_optional_arguments(line));
                    printed = self.run(&block.location, &line);
                    walk.step(line.split(" #").next().unwrap_or_default().trim());
                }
            }
        }
    }

    /// Interrupts the systems in start order and checks that each exits successfully.
    fn stop(self) {
        self.wait_until_running();
        for (name, running) in self.running {
            running.interrupt();
            let run = Run::from_output(running.output());
            assert_eq!(run.code, Some(0), "{name}: {}", run.stderr);
        }
    }
}

/// Reads the first line of a command's output, then interrupts the command. Returns the line.
fn first_line_then_interrupt(child: &mut Child, stdout: &mut BufReader<ChildStdout>) -> String {
    let mut line = String::new();
    stdout.read_line(&mut line).unwrap();
    signal(child.id(), Signal::INT);
    line
}

/// Returns the services of a system; empty if it does not respond.
fn services(name: &str) -> Vec<serde_json::Value> {
    crate::common::services(name)
}

/// Returns the words of each line of a score table and of the lines below the table.
///
/// The time per update, which is the last word of a row, is removed.
fn without_cost(text: &str) -> Vec<Vec<&str>> {
    let words = |line| str::split_whitespace(line).collect::<Vec<_>>();
    let lines = text.lines().map(words).filter(|words| !words.is_empty());
    let without_number = |mut words: Vec<_>| {
        words.pop_if(|word: &mut &str| word.parse::<u32>().is_ok());
        words
    };
    lines.map(without_number).collect()
}

/// Removes optional arguments in brackets, such as `[--json]`.
fn without_optional_arguments(line: &str) -> String {
    let mut parts = line.split(" [-");
    let first = parts.next().unwrap_or_default().to_owned();
    parts.fold(first, |line, part| line + part.split_once(']').map_or("", |(_, rest)| rest))
}

/// Runs the shell examples of the files that `is_selected` selects by name.
fn run_shell_examples(is_selected: impl Fn(&str) -> bool) {
    for (file, blocks) in files().into_iter().filter(|(file, _)| is_selected(file)) {
        let mut scratch = Scratch::new();
        scratch.run_examples(&file, &blocks);
        scratch.stop();
    }
}

#[test]
fn every_exception_matches_an_example() {
    let all: Vec<_> = files().into_iter().flat_map(|(_, blocks)| blocks).collect();
    let has_line = |beginning: &str| all.iter().any(|block| block.text.lines().any(|line| line.starts_with(beginning)));
    let has_block = |beginning: &str| all.iter().any(|block| block.first_line().starts_with(beginning));
    let lines = NOT_RUN.iter().filter(|(beginning, _)| !has_line(beginning));
    let blocks = NOT_EXAMPLES.iter().filter(|(beginning, _)| !has_block(beginning));
    let unused: Vec<_> = lines.chain(blocks).map(|(beginning, _)| beginning).collect();
    assert!(unused.is_empty(), "remove from exceptions.rs what no example begins with: {unused:#?}");
}

#[test]
fn code_of_libraries_is_that_of_benchmark() {
    let benchmark = fs::read_to_string(root().join("benches/kernels/libraries.rs")).unwrap();
    let chapter = files().into_iter().find(|(file, _)| file == "docs/reference/libraries.md").unwrap().1;
    let functions: Vec<_> = chapter.iter().filter(|block| block.language == "rust").collect();
    assert_eq!(functions.len(), 5);
    for function in functions {
        assert!(benchmark.contains(&function.text), "{}: differs from benches/kernels/libraries.rs", function.location);
    }
}

#[test]
fn launch_file_examples_are_valid() {
    let scratch = Scratch::new();
    let launch = fs::read_to_string(scratch.system.path("launch.toml")).unwrap();
    let top_level = launch.split("\n[").next().unwrap();
    for block in examples(&Language::Toml) {
        scratch.write("example.toml", &format!("{top_level}\n{}", scratch.replace(&block.text)));
        let output = scratch.command("plumb").args(["config", "check", "--launch", "example.toml"]).output().unwrap();
        assert!(output.status.success(), "{}: {}", block.location, String::from_utf8_lossy(&output.stderr));
    }
}

#[test]
fn shell_examples_of_tutorials_run() {
    run_shell_examples(|file| file.starts_with("docs/tutorials/"));
}

#[test]
fn shell_examples_of_how_to_chapters_run() {
    run_shell_examples(|file| file.starts_with("docs/how-to/"));
}

#[test]
fn shell_examples_of_other_files_run() {
    run_shell_examples(|file| !file.starts_with("docs/tutorials/") && !file.starts_with("docs/how-to/"));
}

#[test]
fn python_clients_print_attitudes() {
    let Some(python) = python() else { return };
    let mut scratch = Scratch::new();
    scratch.start("plumb up");
    scratch.wait_until_running();
    // Programs that feed a system are parts of examples/sensor.py, which another test runs.
    for block in examples(&Language::Python).iter().filter(|block| block.text.contains("import zenoh")) {
        scratch.write("client.py", &scratch.replace(&block.text));
        let mut client = scratch.command(python).args(["-u", "client.py"]).stdout(Stdio::piped()).spawn().unwrap();
        let mut stdout = BufReader::new(client.stdout.take().unwrap());
        let mut printed = String::new();
        for _ in 0..3 {
            stdout.read_line(&mut printed).unwrap();
        }
        signal(client.id(), Signal::KILL);
        client.wait().unwrap();
        let lines = printed.lines().filter(|line| line.contains("AttitudeOutputBatch")).count();
        assert_eq!(lines, 3, "{}: {printed}", block.location);
    }
    scratch.stop();
}
