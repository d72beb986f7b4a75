//! Background systems: `plumb up --detach`, `plumb logs` and `plumb down`.
use std::{fs, os::unix::fs::PermissionsExt, process::Output};

use crate::common::{System, plumb, wait_for};

/// Ends the system on drop, even if a test fails.
struct Background<'a>(&'a System);

impl Background<'_> {
    fn run(&self, arguments: &[&str]) -> Output {
        let mut command = plumb(arguments);
        command.env("XDG_STATE_HOME", self.0.folder.path()).env_remove("STATE_DIRECTORY");
        command.current_dir(self.0.folder.path()).output().unwrap()
    }
}

impl Drop for Background<'_> {
    fn drop(&mut self) {
        self.run(&["down"]);
    }
}

fn text(output: &Output) -> String {
    String::from_utf8([&output.stdout[..], &output.stderr].concat()).unwrap()
}

#[test]
fn detached_system_runs_until_down() {
    let system = System::new("");
    let background = Background(&system);
    let started = background.run(&["up", "--detach"]);
    assert_eq!(started.status.code(), Some(0), "{}", text(&started));
    assert!(text(&started).contains("runs in the background"), "{}", text(&started));
    assert_eq!(background.run(&["ps"]).status.code(), Some(0));
    let by_launch = plumb(&["ps", "--json", "--launch"]).arg(system.path("launch.toml")).output().unwrap();
    assert!(by_launch.status.success() && text(&by_launch).contains("\"fuser\""), "{}", text(&by_launch));
    let second = background.run(&["up", "--detach"]);
    assert_eq!(second.status.code(), Some(1));
    assert!(text(&second).contains("is already running"), "{}", text(&second));
    let down = background.run(&["down", "--json"]);
    assert_eq!(down.status.code(), Some(0), "{}", text(&down));
    assert_eq!(background.run(&["ps"]).status.code(), Some(1));
    wait_for("the files to be removed", || system.leftovers().is_empty());
    let failing = background.run(&["up", "--detach", "--out", "missing/out.csv"]);
    assert_eq!(failing.status.code(), Some(1));
    assert!(text(&failing).contains("has ended during its start"), "{}", text(&failing));
    let again = background.run(&["down"]);
    assert_eq!(again.status.code(), Some(1));
    assert!(text(&again).contains("is not running"), "{}", text(&again));
}

#[test]
fn invalid_launch_file_names_no_system() {
    let system = System::from_launch("bufer_s = 1\n");
    let background = Background(&system);
    for command in
        [&["ps"][..], &["down"], &["logs"], &["doctor"], &["top"], &["topic", "list"], &["swap", "fuser", "wz"]]
    {
        let output = background.run(command);
        assert_eq!(output.status.code(), Some(3), "{command:?}: {}", text(&output));
        assert!(text(&output).contains("unknown key \"bufer_s\""), "{command:?}: {}", text(&output));
    }
    let named = background.run(&["ps", "--system", &system.name]);
    assert!(named.status.code() == Some(1) && text(&named).contains(&system.name), "{}", text(&named));
}

#[test]
fn log_of_detached_system_is_printed_to_its_end() {
    let system = System::new("");
    let background = Background(&system);
    let missing = background.run(&["logs"]);
    assert!(missing.status.code() == Some(1) && text(&missing).contains("no log of"), "{}", text(&missing));
    let started = background.run(&["up", "--detach", "--for", "2s"]);
    assert_eq!(started.status.code(), Some(0), "{}", text(&started));
    let mode = fs::metadata(system.path(&format!("plumbline/{}.log", system.name))).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o600, "the log contains the token of the cockpit");
    let log = background.run(&["logs", "--follow"]);
    assert_eq!(log.status.code(), Some(0), "{}", text(&log));
    // The report is the last message of a run.
    assert!(text(&log).contains("2000 in, 2000 out, 0 lost"), "{}", text(&log));
}
