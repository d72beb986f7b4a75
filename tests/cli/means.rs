//! What a machine is short of, or who may not: cause and remedy where people see it.
use std::{
    fs::{self, File},
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use rustix::process::Signal;

use crate::common::{Run, Running, System, copied, plumb, signal, until};

/// The user `nobody`.
const NOBODY: &str = "65534";

/// The command after shell commands.
fn after(shell: &str, command: &Command) -> Command {
    let mut wrapped = Command::new("sh");
    wrapped.args(["-c", &format!("{shell} && exec \"$@\""), "sh"]);
    wrapped.arg(command.get_program()).args(command.get_args());
    wrapped
}

/// The command with shared memory of its own, of this size; says that a test is skipped where that cannot be had.
fn in_memory_of(size: &str, command: &Command) -> Option<Command> {
    let mount = format!("mount -t tmpfs -o size={size} tmpfs /dev/shm");
    let apart = |command: &Command| {
        let inner = after(&mount, command);
        let mut unshared = Command::new("unshare");
        unshared.args(["--mount", "--"]).arg(inner.get_program()).args(inner.get_args());
        unshared
    };
    match apart(&Command::new("true")).output() {
        Ok(tried) if tried.status.success() => Some(apart(command)),
        tried => {
            eprintln!("skipped: no shared memory of one's own here: {tried:?}");
            None
        }
    }
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn assert_says(people: &str, parts: &[&str]) {
    assert!(parts.iter().all(|part| people.contains(part)), "not all of {parts:?} in: {people}");
    for riddle in ["InternalFailure", "ServiceConfigCouldNotBeCreated", "is not running"] {
        assert!(!people.contains(riddle), "{riddle} in: {people}");
    }
}

#[test]
fn more_files_are_allowed_where_they_may_be_and_too_few_are_refused_with_the_number() {
    let system = System::new("");
    let run = Run::of(after("ulimit -Sn 40", &system.command(&["--for", "300ms"])).output().unwrap());
    run.assert_whole();
    let refused = after("ulimit -n 100", &system.command(&["--for", "300ms"])).output().unwrap();
    assert_eq!(refused.status.code(), Some(1));
    assert_says(&said(&refused), &["256 open files", "only 100 are allowed", "ulimit -n 4096"]);
    assert_eq!(system.remains(), Vec::<String>::new());

    let running = system.start(&[]);
    system.all_run();
    let look = plumb(&["topic", "list", "--system", &system.name, "--seconds", "0.1"]);
    let refused = after("ulimit -n 30", &look).output().unwrap();
    assert_eq!(refused.status.code(), Some(1));
    assert_says(&said(&refused), &["only 30 are allowed", "ulimit -n 4096"]);
    let looked = after("ulimit -Sn 30", &look).output().unwrap();
    assert!(looked.status.success(), "{}", said(&looked));
    drop(running);
}

#[test]
fn too_little_shared_memory_is_refused_before_anything_starts() {
    let system = System::new("");
    let Some(mut command) = in_memory_of("3M", &system.command(&["--for", "300ms"])) else { return };
    let refused = command.output().unwrap();
    assert_eq!(refused.status.code(), Some(1));
    assert_says(
        &said(&refused),
        &["MiB of shared memory, but 3.0 MiB of 3.0 MiB are free", "size=1G /dev/shm", "--shm-size"],
    );
}

#[test]
fn shared_memory_that_runs_out_is_named_and_what_failed_comes_back_once_there_is_some() {
    let system = System::new("[restart]\non_limit = \"retry\"\nbackoff_max_s = 0.1");
    let Some(command) = in_memory_of("32M", &system.command(&[])) else { return };
    let log = system.path("log");
    let running = Running::of(after(&format!("exec 2> {}", log.display()), &command));
    running.all_services();
    let heard = |what: &str| fs::read_to_string(&log).is_ok_and(|text| text.contains(what));
    until("ticks", || heard("tick "));
    let filler = PathBuf::from(format!("/proc/{}/root/dev/shm/filler", running.pid()));
    fill(&filler);
    signal(running.service("gyro"), Signal::KILL);
    until("the cause and the remedy", || heard("of 32.0 MiB are free in /dev/shm; make room"));
    fs::remove_file(filler).unwrap();
    until("everybody to run", || running.services().len() == 5);
    running.interrupt();
    running.wait();
    assert_says(&fs::read_to_string(&log).unwrap(), &["--shm-size=1g"]);
}

/// Writes until there is no more room.
fn fill(path: &Path) {
    let mut file = File::create(path).unwrap();
    while std::io::Write::write_all(&mut file, &[1; 4096]).is_ok() {}
}

#[test]
fn who_asks_another_users_system_is_told_whose_it_is() {
    if !rustix::process::geteuid().is_root() {
        return eprintln!("skipped: only root can be somebody else");
    }
    let system = System::new("");
    let running = system.start(&[]);
    system.all_run();
    // Where the executable is, others may not be allowed to look.
    let folder = PathBuf::from("/tmp").join(&system.name);
    fs::create_dir(&folder).unwrap();
    fs::set_permissions(&folder, fs::Permissions::from_mode(0o755)).unwrap();
    let copy = folder.join("plumb");
    copied(Path::new(env!("CARGO_BIN_EXE_plumb")), &copy);
    for question in [["ps"].as_slice(), &["top", "--count", "1"], &["swap", "fuser", "vqf"], &["topic", "list"]] {
        let mut command = Command::new("setpriv");
        command.args(["--reuid", NOBODY, "--regid", NOBODY, "--clear-groups"]).arg(&copy).args(question);
        let refused = command.args(["--system", &system.name]).current_dir("/").output().unwrap();
        assert_eq!(refused.status.code(), Some(1), "{question:?}");
        assert_says(&said(&refused), &["belongs to user 0", "sudo -u"]);
    }
    fs::remove_dir_all(folder).unwrap();
    drop(running);
}
