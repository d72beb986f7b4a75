//! Files of a running system that somebody removes: who runs goes on, and once a service dies all start anew.
use std::{fs, path::PathBuf, time::Duration};

use crate::common::{Running, System, signal, until};
use rustix::process::Signal;

/// What carries the system's name and ends so; of its folder, which does not end in a kind, everything.
fn files(system: &System, kind: &str) -> Vec<PathBuf> {
    let all = system.remains().into_iter().map(|name| PathBuf::from("/dev/shm").join(name));
    all.filter(|path| path.to_str().unwrap().ends_with(kind)).collect()
}

fn remove(paths: &[PathBuf]) {
    assert!(!paths.is_empty());
    for path in paths {
        if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) }.unwrap();
    }
}

fn pids(running: &Running) -> Vec<u32> {
    running.all_services().into_iter().map(|(_, pid)| pid).collect()
}

#[test]
fn a_system_whose_files_are_removed_starts_anew_when_a_service_dies_and_loses_nothing() {
    let system = System::new("");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    system.all_run();
    // All of them, as logind does; then of one kind only.
    for (kind, service) in
        [("", "fuser"), ("", "ingest"), ("", "course"), (".data", "gyro"), (system.name.as_str(), "accel")]
    {
        std::thread::sleep(Duration::from_millis(1200));
        let before = pids(&running);
        remove(&files(&system, kind));
        std::thread::sleep(Duration::from_millis(300));
        assert_eq!(pids(&running), before, "whoever lives goes on");
        signal(running.service(service), Signal::KILL);
        until("everybody to start anew", || {
            running.services().iter().filter(|(_, pid)| !before.contains(pid)).count() == 5
        });
        system.all_run();
    }
    let run = system.assert_ends_undisturbed(running, &out, "");
    println!("{} longest latency {} µs", run.json["ticks_out"], run.number("/latency_us/max"));
    assert_eq!(run.people.matches("every service starts anew from its checkpoint").count(), 5, "{}", run.people);
}

#[test]
fn who_removes_files_is_told_of_before_a_service_dies_and_another_system_of_the_name_is_left_alone() {
    let system = System::new("");
    let running = system.start(&[]);
    system.all_run();
    remove(&files(&system, ""));
    std::thread::sleep(Duration::from_millis(2500));
    // It cannot be seen any more, so somebody starts it again.
    let next = system.start(&[]);
    system.all_run();
    running.interrupt();
    let run = running.wait();
    assert_eq!(run.code, Some(0), "{}", run.people);
    assert_eq!(run.people.matches("somebody removes files of this system").count(), 1, "{}", run.people);
    assert!(run.people.contains("RemoveIPC=no"), "{}", run.people);
    assert_eq!(system.ps().len(), 5, "the other one still answers");
    next.interrupt();
    next.wait().assert_whole();
    assert_eq!(system.remains(), Vec::<String>::new());
}
