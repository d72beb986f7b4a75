//! Files of a running system that somebody removes: who runs goes on, and once a service dies all start anew.
use std::{fs, path::PathBuf, time::Duration};

use crate::common::{Running, System, plumb, signal, until};
use rustix::process::Signal;

/// What carries the system's name and ends so; of its folder, which does not end in a kind, everything.
pub(crate) fn files(system: &System, kind: &str) -> Vec<PathBuf> {
    let all = system.remains().into_iter().map(|name| PathBuf::from("/dev/shm").join(name));
    all.filter(|path| path.to_str().unwrap().ends_with(kind)).collect()
}

pub(crate) fn remove(paths: &[PathBuf]) {
    assert!(!paths.is_empty());
    for path in paths {
        let removed = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
        // What its owner has removed meanwhile is gone, too.
        assert!(removed.is_ok() || !path.exists(), "{}: {removed:?}", path.display());
    }
}

fn pids(running: &Running) -> Vec<u32> {
    running.all_services().into_iter().map(|(_, pid)| pid).collect()
}

/// Removes files of one kind after the other, and each time kills a service.
fn starts_anew_and_loses_nothing(cases: &[(&str, &str)]) {
    let system = System::new("");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    system.all_run();
    for (kind, service) in cases {
        std::thread::sleep(Duration::from_millis(1200));
        let before = pids(&running);
        // Of this one system's name alone, where it is its folder that is meant.
        remove(&files(&system, if *kind == "folder" { &system.name } else { kind }));
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
    let times = run.people.matches("restarting every service from its checkpoint").count();
    assert_eq!(times, cases.len(), "{}", run.people);
}

#[test]
fn a_system_whose_files_are_removed_starts_anew_when_a_service_dies_and_loses_nothing() {
    // All of them, as logind does.
    starts_anew_and_loses_nothing(&[("", "fuser"), ("", "ingest"), ("", "course")]);
}

#[test]
fn a_system_of_whose_files_some_are_removed_starts_anew_when_a_service_dies_and_loses_nothing() {
    starts_anew_and_loses_nothing(&[(".data", "gyro"), ("folder", "accel")]);
}

#[test]
fn a_system_whose_files_are_removed_is_not_taken_for_dead_and_starts_anew_when_a_stage_is_swapped() {
    let system = System::new("");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    system.all_run();
    let before = pids(&running);
    // All but the folder with the supervisor's socket.
    let segments: Vec<_> = files(&system, "").into_iter().filter(|path| !path.is_dir()).collect();
    remove(&segments);
    for fix in [&[][..], &["--fix"]] {
        let doctor = plumb(&[&["doctor", "--json", "--system", &system.name], fix].concat()).output().unwrap();
        let said = String::from_utf8(doctor.stdout).unwrap();
        assert_eq!(doctor.status.code(), Some(1), "{said}");
        assert!(said.contains("were removed while it runs") && !said.contains("is not running"), "{said}");
    }
    assert_eq!(system.ps().len(), 5, "the doctor has left it alone");
    let look = plumb(&["topic", "hz", "imu", "--count", "1", "--system", &system.name]).output().unwrap();
    let said = String::from_utf8(look.stderr).unwrap();
    assert!(said.contains("its files were removed while it is running"), "{said}");

    let refused = system.ask_swap(&["fuser", "multiple-model"]);
    let reason = refused["reason"].as_str().unwrap();
    assert!(reason.contains("its files were removed") || reason.contains("every service is restarting"), "{reason}");
    until("everybody to start anew", || {
        running.services().iter().filter(|(_, pid)| !before.contains(pid)).count() == 5
    });
    system.all_run();
    assert_eq!(system.swap(&["fuser", "multiple-model"])["outcome"], "committed");
    let run = system.assert_ends_undisturbed(running, &out, "");
    assert_eq!(run.people.matches("restarting every service from its checkpoint").count(), 1, "{}", run.people);
}

#[test]
fn who_removes_files_again_and_again_ends_the_system_with_a_report_that_says_so() {
    let system = System::new("");
    let running = system.start(&[]);
    system.all_run();
    for round in 1..=4 {
        let before = pids(&running);
        remove(&files(&system, ""));
        signal(running.service("gyro"), Signal::KILL);
        if round < 4 {
            until("everybody to start anew", || {
                running.services().iter().filter(|(_, pid)| !before.contains(pid)).count() == 5
            });
            system.all_run();
        }
    }
    let run = running.wait();
    assert_eq!(run.code, Some(1), "{}", run.people);
    let error = run.json["error"].as_str().unwrap();
    assert!(error.contains("4 times within 60 s"), "{error}");
    assert_eq!(run.people.matches("restarting every service from its checkpoint").count(), 3, "{}", run.people);
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
