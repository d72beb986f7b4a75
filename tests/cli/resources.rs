//! Missing resources and permissions: messages state the cause and the remedy.
use std::{
    fs::{self, File},
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use rustix::process::Signal;

use crate::common::{Run, Running, System, copy_program, plumb, program, signal, wait_for};

/// User ID of `nobody`.
const OTHER_USER: &str = "65534";

/// Returns a command that runs the shell commands in `shell` and then `command`.
fn after_shell(shell: &str, command: &Command) -> Command {
    let mut wrapped = Command::new("sh");
    wrapped.args(["-c", &format!("{shell} && exec \"$@\""), "sh"]);
    wrapped.arg(command.get_program()).args(command.get_args());
    wrapped
}

/// Returns the command with a private `/dev/shm` of this size.
///
/// If mount namespaces are unavailable, prints that the test is skipped, and returns `None`.
fn with_shared_memory(size: &str, command: &Command) -> Option<Command> {
    let mount = format!("mount -t tmpfs -o size={size} tmpfs /dev/shm");
    let isolated = |command: &Command| {
        let inner = after_shell(&mount, command);
        let mut unshared = Command::new("unshare");
        unshared.args(["--mount", "--"]).arg(inner.get_program()).args(inner.get_args());
        unshared
    };
    match isolated(&Command::new("true")).output() {
        Ok(tried) if tried.status.success() => Some(isolated(command)),
        tried => {
            eprintln!("skipped: no private mount namespace available: {tried:?}");
            None
        }
    }
}

fn stderr_text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn assert_message(message: &str, parts: &[&str]) {
    assert!(parts.iter().all(|part| message.contains(part)), "not all of {parts:?} in: {message}");
    for internal in ["InternalFailure", "ServiceConfigCouldNotBeCreated", "is not running"] {
        assert!(!message.contains(internal), "{internal} in: {message}");
    }
}

#[test]
fn open_file_limit_is_raised_or_reported() {
    let system = System::new("");
    let run = Run::from_output(after_shell("ulimit -Sn 40", &system.command(&["--for", "300ms"])).output().unwrap());
    run.assert_complete();
    let rejected = after_shell("ulimit -n 100", &system.command(&["--for", "300ms"])).output().unwrap();
    assert_eq!(rejected.status.code(), Some(1));
    assert_message(&stderr_text(&rejected), &["256 open files", "only 100 are allowed", "ulimit -n 4096"]);
    assert_eq!(system.leftovers(), Vec::<String>::new());

    let running = system.start(&[]);
    system.wait_until_running();
    let topic_list = plumb(&["topic", "list", "--system", &system.name, "--for", "0.1"]);
    let rejected = after_shell("ulimit -n 30", &topic_list).output().unwrap();
    assert_eq!(rejected.status.code(), Some(1));
    assert_message(&stderr_text(&rejected), &["only 30 are allowed", "ulimit -n 4096"]);
    let accepted = after_shell("ulimit -Sn 30", &topic_list).output().unwrap();
    assert!(accepted.status.success(), "{}", stderr_text(&accepted));
    drop(running);
}

#[test]
fn insufficient_shared_memory_is_rejected_before_start() {
    let system = System::new("");
    let Some(mut command) = with_shared_memory("3M", &system.command(&["--for", "300ms"])) else { return };
    let rejected = command.output().unwrap();
    assert_eq!(rejected.status.code(), Some(1));
    assert_message(
        &stderr_text(&rejected),
        &["MiB of shared memory, but 3.0 MiB of 3.0 MiB are free", "size=1G /dev/shm", "--shm-size"],
    );
}

#[test]
fn service_recovers_after_shared_memory_runs_out() {
    let system = System::new("[restart]\non_limit = \"retry\"\nbackoff_max_s = 0.1");
    let Some(command) = with_shared_memory("32M", &system.command(&[])) else { return };
    let log = system.path("log");
    let running = Running::spawn(after_shell(&format!("exec 2> {}", log.display()), &command));
    running.all_services();
    let is_logged = |what: &str| fs::read_to_string(&log).is_ok_and(|text| text.contains(what));
    wait_for("ticks", || is_logged("tick "));
    let filler = PathBuf::from(format!("/proc/{}/root/dev/shm/filler", running.pid()));
    fill(&filler);
    signal(running.service("gyro"), Signal::KILL);
    wait_for("the cause and the remedy", || is_logged("of 32.0 MiB are free in /dev/shm; make room"));
    fs::remove_file(filler).unwrap();
    wait_for("all services to run", || running.services().len() == 5);
    running.interrupt();
    running.wait();
    assert_message(&fs::read_to_string(&log).unwrap(), &["--shm-size=1g"]);
}

/// Fills the file system that contains `path`.
fn fill(path: &Path) {
    let mut file = File::create(path).unwrap();
    while std::io::Write::write_all(&mut file, &[1; 4096]).is_ok() {}
}

#[test]
fn system_of_other_user_is_reported_with_owner() {
    if !rustix::process::geteuid().is_root() {
        return eprintln!("skipped: only root can run commands as another user");
    }
    let system = System::new("");
    let running = system.start(&[]);
    system.wait_until_running();
    // The executable is copied to /tmp, because other users may lack access to its folder.
    let folder = PathBuf::from("/tmp").join(&system.name);
    fs::create_dir(&folder).unwrap();
    fs::set_permissions(&folder, fs::Permissions::from_mode(0o755)).unwrap();
    let copy = folder.join("plumb");
    copy_program(&program(), &copy);
    for arguments in [["ps"].as_slice(), &["top", "--count", "1"], &["swap", "fuser", "vqf"], &["topic", "list"]] {
        let mut command = Command::new("setpriv");
        command.args(["--reuid", OTHER_USER, "--regid", OTHER_USER, "--clear-groups"]).arg(&copy).args(arguments);
        let rejected = command.args(["--system", &system.name]).current_dir("/").output().unwrap();
        assert_eq!(rejected.status.code(), Some(1), "{arguments:?}");
        assert_message(&stderr_text(&rejected), &["belongs to user 0", "sudo -u"]);
    }
    fs::remove_dir_all(folder).unwrap();
    drop(running);
}
