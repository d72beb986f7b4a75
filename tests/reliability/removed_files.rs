//! The files of a running system are removed or damaged.
//!
//! Running services continue. When one of them exits, all services restart on a new bus.
use std::{
    fs,
    os::unix::fs::{FileExt, PermissionsExt},
    path::{Path, PathBuf},
    time::Duration,
};

use crate::common::{Running, System, plumb, signal, wait_for};
use rustix::process::Signal;

/// Returns the files of the system in `/dev/shm` that have names ending in `kind`.
///
/// An empty `kind` selects all files, and the name of the system selects only the system's folder.
pub(crate) fn files(system: &System, kind: &str) -> Vec<PathBuf> {
    let all = system.leftovers().into_iter().map(|name| PathBuf::from("/dev/shm").join(name));
    all.filter(|path| path.to_str().unwrap().ends_with(kind)).collect()
}

pub(crate) fn remove(paths: &[PathBuf]) {
    assert!(!paths.is_empty());
    for path in paths {
        let removed = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
        // The owner may have removed the file in the meantime.
        assert!(removed.is_ok() || !path.exists(), "{}: {removed:?}", path.display());
    }
}

fn pids(running: &Running) -> Vec<u32> {
    running.all_services().into_iter().map(|(_, pid)| pid).collect()
}

/// Removes one kind of file after another and kills a service after each removal.
fn assert_restarts_without_loss(cases: &[(&str, &str)]) {
    let system = System::new("");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    system.wait_until_running();
    for (kind, service) in cases {
        std::thread::sleep(Duration::from_millis(1200));
        let before = pids(&running);
        remove(&files(&system, if *kind == "folder" { &system.name } else { kind }));
        std::thread::sleep(Duration::from_millis(300));
        assert_eq!(pids(&running), before, "running services continue");
        signal(running.service(service), Signal::KILL);
        wait_for("all services to restart", || {
            running.services().iter().filter(|(_, pid)| !before.contains(pid)).count() == 5
        });
        system.wait_until_running();
    }
    let run = system.stop_and_assert_undisturbed(running, &out, "");
    println!("{} longest latency {} µs", run.json["ticks_out"], run.number("/latency_us/max"));
    let times = run.stderr.matches("restarting every service from its checkpoint").count();
    assert_eq!(times, cases.len(), "{}", run.stderr);
}

#[test]
fn system_with_removed_files_restarts_without_loss() {
    // Removes all files, as logind does with RemoveIPC=yes.
    assert_restarts_without_loss(&[("", "fuser"), ("", "ingest"), ("", "course")]);
}

#[test]
fn system_with_some_files_removed_restarts_without_loss() {
    assert_restarts_without_loss(&[(".data", "gyro"), ("folder", "accel")]);
}

#[test]
fn system_with_removed_files_restarts_on_swap() {
    let system = System::new("");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    system.wait_until_running();
    let before = pids(&running);
    // The folder contains the supervisor's socket and is kept.
    let without_folder: Vec<_> = files(&system, "").into_iter().filter(|path| !path.is_dir()).collect();
    remove(&without_folder);
    for fix in [&[][..], &["--fix"]] {
        let doctor = plumb(&[&["doctor", "--json", "--system", &system.name], fix].concat()).output().unwrap();
        let text = String::from_utf8(doctor.stdout).unwrap();
        assert_eq!(doctor.status.code(), Some(1), "{text}");
        assert!(text.contains("were removed while it runs") && !text.contains("is not running"), "{text}");
    }
    assert_eq!(system.ps().len(), 5, "doctor must not affect the running system");
    let observer = plumb(&["topic", "hz", "imu", "--count", "1", "--system", &system.name]).output().unwrap();
    let text = String::from_utf8(observer.stderr).unwrap();
    assert!(text.contains("its files were removed while it is running"), "{text}");

    let rejected = system.swap_once(&["fuser", "multiple-model"]);
    let reason = rejected["reason"].as_str().unwrap();
    assert!(reason.contains("its files were removed") || reason.contains("every service is restarting"), "{reason}");
    wait_for("all services to restart", || {
        running.services().iter().filter(|(_, pid)| !before.contains(pid)).count() == 5
    });
    system.wait_until_running();
    assert_eq!(system.swap(&["fuser", "multiple-model"])["outcome"], "committed");
    let run = system.stop_and_assert_undisturbed(running, &out, "");
    assert_eq!(run.stderr.matches("restarting every service from its checkpoint").count(), 1, "{}", run.stderr);
}

#[test]
fn repeated_file_removal_stops_system_with_error() {
    let system = System::new("");
    let running = system.start(&[]);
    system.wait_until_running();
    for round in 1..=4 {
        let before = pids(&running);
        remove(&files(&system, ""));
        signal(running.service("gyro"), Signal::KILL);
        if round < 4 {
            wait_for("all services to restart", || {
                running.services().iter().filter(|(_, pid)| !before.contains(pid)).count() == 5
            });
            system.wait_until_running();
        }
    }
    let run = running.wait();
    assert_eq!(run.code, Some(1), "{}", run.stderr);
    let error = run.json["error"].as_str().unwrap();
    assert!(error.contains("4 times within 60 s"), "{error}");
    assert_eq!(run.stderr.matches("restarting every service from its checkpoint").count(), 3, "{}", run.stderr);
}

#[test]
fn file_removal_is_reported_and_spares_successor() {
    let system = System::new("");
    let running = system.start(&[]);
    system.wait_until_running();
    remove(&files(&system, ""));
    std::thread::sleep(Duration::from_millis(2500));
    // The running system is no longer visible, so a user may start it a second time.
    let next = system.start(&[]);
    system.wait_until_running();
    running.interrupt();
    let run = running.wait();
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    assert_eq!(run.stderr.matches("running services continue, but all will restart").count(), 1, "{}", run.stderr);
    assert!(run.stderr.contains("RemoveIPC=no"), "{}", run.stderr);
    assert_eq!(system.ps().len(), 5, "the second system still responds");
    next.interrupt();
    next.wait().assert_complete();
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

/// Overwrites or truncates files that new processes read to join.
fn damage(system: &System, kind: &str, truncates: bool) {
    let folder = PathBuf::from(format!("/dev/shm/plumbline.{}/services", system.name));
    let constant = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let paths: Vec<_> = files(system, kind).into_iter().chain(constant.filter(|_| kind == ".service")).collect();
    assert!(!paths.is_empty());
    for path in paths {
        fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
        let length = if truncates { 0 } else { fs::metadata(&path).unwrap().len() as usize };
        fs::write(&path, vec![0x55; length]).unwrap();
    }
}

#[test]
fn system_with_damaged_files_restarts_without_loss() {
    let system = System::new("");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    system.wait_until_running();
    let cases = [(".service", false, "fuser"), (".service", true, "gyro"), (".global_mgmt", true, "ingest")];
    for (kind, truncates, service) in cases {
        std::thread::sleep(Duration::from_millis(1200));
        let before = pids(&running);
        damage(&system, kind, truncates);
        std::thread::sleep(Duration::from_millis(300));
        assert_eq!(pids(&running), before, "running services continue");
        signal(running.service(service), Signal::KILL);
        wait_for("all services to restart", || {
            running.services().iter().filter(|(_, pid)| !before.contains(pid)).count() == 5
        });
        system.wait_until_running();
        assert_eq!(system.swap(&["course", "track"])["outcome"], "committed");
        assert_eq!(system.swap(&["course", "angles"])["outcome"], "committed");
    }
    running.interrupt();
    let run = running.wait();
    run.assert_complete();
    assert_eq!(system.leftovers(), Vec::<String>::new());
    assert_eq!(run.stderr.matches("was damaged while the system ran").count(), cases.len(), "{}", run.stderr);
}

#[test]
fn overwritten_shared_state_stops_system_with_error() {
    let system = System::new("");
    let running = system.start(&[]);
    system.wait_until_running();
    let state = fs::OpenOptions::new().write(true).open(&files(&system, ".wake")[0]).unwrap();
    state.write_all_at(&[0x55; 4096], 0).unwrap();
    let run = running.wait();
    assert_eq!(run.code, Some(1), "{}", run.stderr);
    let error = run.json["error"].as_str().unwrap();
    assert!(error.contains("the shared state of the system was damaged"), "{error}");
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn missing_control_socket_is_opened_again() {
    let system = System::new("");
    let running = system.start(&[]);
    system.wait_until_running();
    let before = pids(&running);
    let socket = PathBuf::from(format!("/dev/shm/plumbline.{}/control", system.name));
    let replace: [fn(&Path); 2] = [|_| {}, |path| fs::write(path, "").unwrap()];
    for replace in replace {
        fs::remove_file(&socket).unwrap();
        replace(&socket);
        system.wait_until_running();
    }
    assert_eq!(pids(&running), before, "services continue");
    running.interrupt();
    let run = running.wait();
    run.assert_complete();
    assert_eq!(run.stderr.matches("the control socket was removed or replaced").count(), 2, "{}", run.stderr);
    assert_eq!(system.leftovers(), Vec::<String>::new());
}
