//! Permissions: the files of a system are accessible only to the user that runs it.
//!
//! Files that other users create under the system's name are reported and left unchanged.
use std::{
    fs,
    os::unix::{
        fs::{MetadataExt, PermissionsExt, symlink},
        process::CommandExt,
    },
    path::{Path, PathBuf},
    process::{Command, Output},
};

use crate::common::{System, plumb, signal, wait_for};
use rustix::process::Signal;

/// User id that owns no file of any system.
const OTHER_USER: u32 = 65534;

/// File or folder with a name that contains the system's name.
#[derive(Debug)]
struct FileEntry {
    path: PathBuf,
    mode: u32,
    is_dir: bool,
}

/// Returns all files and folders of the system.
fn file_entries(system: &System) -> Vec<FileEntry> {
    let mut open: Vec<PathBuf> = system
        .leftovers()
        .iter()
        .flat_map(|name| [Path::new("/dev/shm").join(name), Path::new("/tmp").join(name)])
        .collect();
    let mut all = Vec::new();
    while let Some(path) = open.pop() {
        // Files can disappear during the listing.
        let Ok(metadata) = fs::symlink_metadata(&path) else { continue };
        let is_dir = metadata.is_dir();
        if is_dir {
            open.extend(fs::read_dir(&path).into_iter().flatten().flatten().map(|entry| entry.path()));
        }
        all.push(FileEntry { path, mode: metadata.mode() & 0o7777, is_dir });
    }
    all
}

/// Checks that group and others have no access to any file of the system.
///
/// Subfolders are not checked, because others cannot reach the entries below a folder that they
/// cannot enter.
fn assert_private(system: &System, when: &str) {
    let all = file_entries(system);
    let folder = PathBuf::from(format!("/dev/shm/plumbline.{}", system.name));
    for what in [".wake", ".members", ".global_mgmt", ".data", ".connection", "/control"] {
        assert!(all.iter().any(|one| one.path.to_string_lossy().ends_with(what)), "{when}: no {what} in {all:?}");
    }
    let is_below = |one: &FileEntry| one.is_dir && one.path.starts_with(&folder) && one.path != folder;
    let open: Vec<_> = all.iter().filter(|one| one.mode & 0o077 != 0 && !is_below(one)).collect();
    assert!(open.is_empty(), "{when}: {open:?}");
}

/// Runs a shell command as another user. Returns `None` unless the test runs as root.
fn run_as_other_user(line: &str) -> Option<Output> {
    if fs::metadata("/proc/self").unwrap().uid() != 0 {
        eprintln!("skipped: only root can run commands as another user");
        return None;
    }
    Some(Command::new("sh").args(["-c", line]).current_dir("/").uid(OTHER_USER).gid(OTHER_USER).output().unwrap())
}

/// Returns the kinds of access that another user has to the files of the system: read, write, lock,
/// truncate or remove. The result is empty if that user has no access.
///
/// No attempt creates a file. A file that its owner has just removed therefore does not count as
/// accessible.
fn access_by_other_user(system: &System) -> String {
    let files: Vec<_> = file_entries(system).iter().map(|one| format!("'{}'", one.path.display())).collect();
    let tries = "test -r $f && echo reads $f; test -w $f && echo writes $f; (flock -n 9) 9< $f && echo locks $f; \
                 dd if=/dev/null of=$f conv=nocreat && echo cuts $f; rm $f && echo removes $f";
    let output = run_as_other_user(&format!("for f in {}; do {tries}; done 2>/dev/null", files.join(" ")));
    output.map_or_else(String::new, |output| String::from_utf8(output.stdout).unwrap())
}

#[test]
fn all_files_stay_private_after_start_kill_and_swap() {
    let system = System::new("");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    system.wait_until_running();
    assert_private(&system, "after the start");
    assert_eq!(access_by_other_user(&system), "");

    let gyro = running.service("gyro");
    signal(gyro, Signal::KILL);
    wait_for("another incarnation", || running.service("gyro") != gyro);
    system.wait_until_running();
    assert_private(&system, "after a kill");

    let swap = plumb(&["swap", "fuser", "vqf", "--json", "--system", &system.name]).output().unwrap();
    assert!(swap.status.success(), "{swap:?}");
    let observer = plumb(&["topic", "echo", "attitude", "--count", "2", "--system", &system.name]).output().unwrap();
    assert!(observer.status.success(), "{observer:?}");
    assert_private(&system, "after a swap and an observer");
    assert_eq!(access_by_other_user(&system), "");
    running.interrupt();
    running.wait().assert_complete();
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn other_user_cannot_prevent_restart() {
    let system = System::new("");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    system.wait_until_running();
    let segment = file_entries(&system)
        .into_iter()
        .map(|one| one.path)
        .find(|path| path.extension().is_some_and(|it| it == "global_mgmt"));
    // The other user writes a version number that iceoryx2 does not know.
    run_as_other_user(&format!(
        "printf '\\377\\377\\377\\377\\377\\377' | dd of={} conv=notrunc",
        segment.unwrap().display()
    ));
    signal(running.service("gyro"), Signal::KILL);
    wait_for("another incarnation", || system.ps().iter().any(|one| one["service"] == "gyro" && one["restarts"] == 1));
    system.wait_until_running();
    system.stop_and_assert_undisturbed(running, &out, "");
}

#[test]
fn symlink_at_shared_state_is_reported_and_not_followed() {
    let system = System::new("");
    let (page, target) = (PathBuf::from(format!("/dev/shm/plumbline.{}.wake", system.name)), system.path("target"));
    let contents = "data of another program\n".repeat(1000);
    fs::write(&target, &contents).unwrap();
    symlink(&target, &page).unwrap();
    let fix = ["doctor", "--fix", "--system", &system.name];
    for command in [&mut system.command(&["--for", "1s"]), plumb(&fix).arg("--json"), &mut plumb(&fix)] {
        let output = command.output().unwrap();
        let text = [output.stdout, output.stderr].concat();
        let text = String::from_utf8(text).unwrap();
        assert_eq!(output.status.code(), Some(1), "{text}");
        assert!(text.contains("it is a symbolic link") && text.contains(page.to_str().unwrap()), "{text}");
        assert_eq!(fs::read_link(&page).unwrap(), target);
        assert_eq!(fs::read_to_string(&target).unwrap(), contents);
    }
    fs::remove_file(&page).unwrap();
    system.run(&["--for", "100ms"]).assert_complete();
}

#[test]
fn folder_of_other_user_is_rejected_and_kept() {
    if run_as_other_user("true").is_none() {
        return;
    }
    let system = System::new("");
    let folder = PathBuf::from(format!("/dev/shm/plumbline.{}", system.name));
    run_as_other_user(&format!("mkdir -m 777 {0} && echo x > {0}/control && chmod 666 {0}/control", folder.display()));
    for command in [&mut system.command(&["--for", "1s"]), &mut plumb(&["ps", "--system", &system.name])] {
        let output = command.output().unwrap();
        let text = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{text}");
        let cause = "it belongs to user 65534, not to user 0";
        assert!(text.contains(cause) && text.contains("sudo -u '#65534' plumb"), "{text}");
        assert_eq!(fs::read_to_string(folder.join("control")).unwrap(), "x\n");
    }
    fs::set_permissions(&folder, fs::Permissions::from_mode(0o700)).unwrap();
    fs::remove_dir_all(&folder).unwrap();
}
