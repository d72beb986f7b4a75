//! Every file of a system is its user's alone, whatever befalls it; what others have put under its name is named and not touched.
use std::{
    fs,
    os::unix::{
        fs::{MetadataExt, PermissionsExt, symlink},
        process::CommandExt,
    },
    path::{Path, PathBuf},
    process::{Command, Output},
};

use crate::common::{System, plumb, signal, until};
use rustix::process::Signal;

/// A user who owns nothing of a system.
const NOBODY: u32 = 65534;

/// A file or folder that carries the system's name.
#[derive(Debug)]
struct Found {
    path: PathBuf,
    mode: u32,
    is_dir: bool,
}

/// Every one, as it was when it was looked at.
fn found(system: &System) -> Vec<Found> {
    let mut open: Vec<PathBuf> = system
        .remains()
        .iter()
        .flat_map(|name| [Path::new("/dev/shm").join(name), Path::new("/tmp").join(name)])
        .collect();
    let mut all = Vec::new();
    while let Some(path) = open.pop() {
        // What goes while it is looked at is nobody's any more.
        let Ok(metadata) = fs::symlink_metadata(&path) else { continue };
        let is_dir = metadata.is_dir();
        if is_dir {
            open.extend(fs::read_dir(&path).into_iter().flatten().flatten().map(|entry| entry.path()));
        }
        all.push(Found { path, mode: metadata.mode() & 0o7777, is_dir });
    }
    all
}

/// Group and others may do nothing with any file, and enter no folder; what is below a folder that they may not enter is out of reach.
fn assert_own(system: &System, when: &str) {
    let all = found(system);
    let folder = PathBuf::from(format!("/dev/shm/plumbline.{}", system.name));
    for what in [".wake", ".members", ".global_mgmt", ".data", ".connection", "/control"] {
        assert!(all.iter().any(|one| one.path.to_string_lossy().ends_with(what)), "{when}: no {what} in {all:?}");
    }
    let is_below = |one: &Found| one.is_dir && one.path.starts_with(&folder) && one.path != folder;
    let open: Vec<_> = all.iter().filter(|one| one.mode & 0o077 != 0 && !is_below(one)).collect();
    assert!(open.is_empty(), "{when}: {open:?}");
}

/// Runs a line of the shell as a user who owns nothing of the system; only root can.
fn as_nobody(line: &str) -> Option<Output> {
    if fs::metadata("/proc/self").unwrap().uid() != 0 {
        eprintln!("skipped: only root can be another user");
        return None;
    }
    Some(Command::new("sh").args(["-c", line]).current_dir("/").uid(NOBODY).gid(NOBODY).output().unwrap())
}

/// What another user can read, write, lock, cut or remove. No try makes a file: one that its owner has just removed is not reached.
fn reached_by_nobody(system: &System) -> String {
    let files: Vec<_> = found(system).iter().map(|one| format!("'{}'", one.path.display())).collect();
    let tries = "test -r $f && echo reads $f; test -w $f && echo writes $f; (flock -n 9) 9< $f && echo locks $f; \
                 dd if=/dev/null of=$f conv=nocreat && echo cuts $f; rm $f && echo removes $f";
    let output = as_nobody(&format!("for f in {}; do {tries}; done 2>/dev/null", files.join(" ")));
    output.map_or_else(String::new, |output| String::from_utf8(output.stdout).unwrap())
}

#[test]
fn every_file_is_the_owners_alone_after_start_kill_and_swap() {
    let system = System::new("");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    system.all_run();
    assert_own(&system, "after the start");
    assert_eq!(reached_by_nobody(&system), "");

    let gyro = running.service("gyro");
    signal(gyro, Signal::KILL);
    until("another incarnation", || running.service("gyro") != gyro);
    system.all_run();
    assert_own(&system, "after a kill");

    let swap = plumb(&["swap", "fuser", "vqf", "--json", "--system", &system.name]).output().unwrap();
    assert!(swap.status.success(), "{swap:?}");
    let observer = plumb(&["topic", "echo", "attitude", "--count", "2", "--system", &system.name]).output().unwrap();
    assert!(observer.status.success(), "{observer:?}");
    assert_own(&system, "after a swap and an observer");
    assert_eq!(reached_by_nobody(&system), "");
    running.interrupt();
    running.wait().assert_whole();
    assert_eq!(system.remains(), Vec::<String>::new());
}

#[test]
fn nobody_else_keeps_a_service_from_being_restarted() {
    let system = System::new("");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    system.all_run();
    let segment = found(&system)
        .into_iter()
        .map(|one| one.path)
        .find(|path| path.extension().is_some_and(|it| it == "global_mgmt"));
    // A version that iceoryx2 does not know.
    as_nobody(&format!("printf '\\377\\377\\377\\377\\377\\377' | dd of={} conv=notrunc", segment.unwrap().display()));
    signal(running.service("gyro"), Signal::KILL);
    until("another incarnation", || system.ps().iter().any(|one| one["service"] == "gyro" && one["restarts"] == 1));
    system.all_run();
    system.assert_ends_undisturbed(running, &out, "");
}

#[test]
fn a_link_in_the_place_of_the_page_is_named_and_its_target_is_left_alone() {
    let system = System::new("");
    let (page, target) = (PathBuf::from(format!("/dev/shm/plumbline.{}.wake", system.name)), system.path("target"));
    let contents = "what somebody needs\n".repeat(1000);
    fs::write(&target, &contents).unwrap();
    symlink(&target, &page).unwrap();
    let fix = ["doctor", "--fix", "--system", &system.name];
    for command in [&mut system.command(&["--for", "1s"]), plumb(&fix).arg("--json"), &mut plumb(&fix)] {
        let output = command.output().unwrap();
        let said = [output.stdout, output.stderr].concat();
        let said = String::from_utf8(said).unwrap();
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(
            said.contains("it is a symbolic link") && said.contains(&format!("rm -r {}", page.display())),
            "{said}"
        );
        assert_eq!(fs::read_link(&page).unwrap(), target);
        assert_eq!(fs::read_to_string(&target).unwrap(), contents);
    }
    fs::remove_file(&page).unwrap();
    system.run(&["--for", "100ms"]).assert_whole();
}

#[test]
fn the_folder_of_another_user_is_neither_used_nor_removed() {
    if as_nobody("true").is_none() {
        return;
    }
    let system = System::new("");
    let folder = PathBuf::from(format!("/dev/shm/plumbline.{}", system.name));
    as_nobody(&format!("mkdir -m 777 {0} && echo x > {0}/control && chmod 666 {0}/control", folder.display()));
    for command in [&mut system.command(&["--for", "1s"]), &mut plumb(&["ps", "--system", &system.name])] {
        let output = command.output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{said}");
        let why = "it belongs to user 65534, not to user 0";
        assert!(said.contains(why) && said.contains("sudo -u '#65534' plumb"), "{said}");
        assert_eq!(fs::read_to_string(folder.join("control")).unwrap(), "x\n");
    }
    fs::set_permissions(&folder, fs::Permissions::from_mode(0o700)).unwrap();
    fs::remove_dir_all(&folder).unwrap();
}
