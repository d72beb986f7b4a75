//! Services that are killed, that freeze or that cannot start.
//!
//! Every tick is published once, in order, with the bytes of an undisturbed run.
use std::{
    collections::BTreeSet,
    fs,
    path::Path,
    time::{Duration, Instant},
};

use crate::common::{Run, Running, System, copy_program, signal, wait_for};
use rustix::process::Signal;

/// Runs `launch` and disturbs the run.
///
/// Compares the output with that of an undisturbed run with the same number of ticks.
fn assert_undisturbed(launch: &str, arguments: &[&str], disturb: impl FnOnce(&Running)) -> Run {
    let system = System::new(launch);
    let out = system.path("out.csv");
    let running = system.start(&[&["--out", out.to_str().unwrap()], arguments].concat());
    running.all_services();
    disturb(&running);
    system.wait_until_running();
    system.stop_and_assert_undisturbed(running, &out, launch)
}

fn restarts(run: &Run, service: &str) -> u64 {
    let services = run.json["services"].as_array().unwrap();
    services.iter().find(|one| one["name"] == service).unwrap()["restarts"].as_u64().unwrap()
}

/// Asserts that a service was restarted once for each process that the test has ended.
///
/// On a busy machine the supervisor may also report a process as silent and kill it. This can be a
/// process that is still dying from the signal of the test.
fn assert_restarts(run: &Run, service: &str, ended: &[u32]) {
    let announced = format!("{service}: process ");
    let silent_pid = |line: &str| {
        let (pid, rest) = line.strip_prefix(&announced)?.split_once(' ')?;
        ["has reported no health", "has not opened"]
            .iter()
            .any(|how| rest.starts_with(how))
            .then_some(pid.parse().ok()?)
    };
    let pids: BTreeSet<u32> = run.stderr.lines().filter_map(silent_pid).chain(ended.iter().copied()).collect();
    assert_eq!(restarts(run, service), pids.len() as u64, "{service}: {ended:?}: {}", run.stderr);
}

/// Kills `count` incarnations of a service, each after a pause of `pause_ms`, and returns their
/// process IDs. No incarnation is killed twice.
fn kill_repeatedly(running: &Running, service: &str, count: usize, pause_ms: u64) -> Vec<u32> {
    let mut killed = Vec::new();
    for _ in 0..count {
        pause(pause_ms);
        wait_for("the next incarnation", || killed.last() != Some(&running.service(service)));
        let pid = running.service(service);
        signal(pid, Signal::KILL);
        killed.push(pid);
    }
    killed
}

fn pause(ms: u64) {
    std::thread::sleep(Duration::from_millis(ms));
}

#[test]
fn random_kills_change_no_byte() {
    let output = crate::common::plumb(&["bench", "kills", "--count", "20", "--json"]).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{stderr}");
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    println!("{report}");
    assert_eq!((report["lost"].as_u64(), report["duplicated"].as_u64()), (Some(0), Some(0)));
    assert_eq!(report["same_bytes"], true);
    assert!(report["kills"].as_u64() >= Some(15), "{report}");
}

#[test]
fn killed_source_resumes_at_its_tick() {
    let mut killed = Vec::new();
    let run = assert_undisturbed("", &[], |running| killed = kill_repeatedly(running, "ingest", 3, 600));
    assert_restarts(&run, "ingest", &killed);
}

#[test]
fn service_terminated_from_outside_is_restarted() {
    let mut terminated = Vec::new();
    let run = assert_undisturbed("", &[], |running| {
        for service in ["ingest", "gyro", "accel", "fuser", "course"] {
            // Waits without reading /proc, because reading the entry of a dying process delays its
            // parent.
            pause(600);
            let pid = running.service(service);
            signal(pid, Signal::TERM);
            terminated.push((service, pid));
        }
        pause(600);
    });
    for (service, pid) in terminated {
        let ended = format!("{service}: process ");
        let is_end = |line: &&str| line.starts_with(&ended) && line.contains("as after a SIGTERM");
        assert_eq!(run.stderr.lines().filter(is_end).count(), 1, "{service}: {}", run.stderr);
        assert_restarts(&run, service, &[pid]);
    }
}

#[test]
fn program_upgrade_does_not_affect_running_system() {
    let mut system = System::new("");
    let (installed, another) = (system.path("plumb"), system.path("another"));
    copy_program(&system.executable, &installed);
    // The upgrade replaces the executable with a program that is not a service.
    copy_program(Path::new("/bin/false"), &another);
    system.executable = installed.clone();
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    running.all_services();
    system.wait_until_running();
    fs::rename(&another, &installed).unwrap();
    let killed_gyro = kill_repeatedly(&running, "gyro", 1, 300);
    let report = system.swap(&["fuser", "vqf"]);
    assert_eq!(report["outcome"], "committed", "{report}");
    fs::remove_file(&installed).unwrap();
    let killed_course = kill_repeatedly(&running, "course", 1, 300);
    pause(300);
    system.wait_until_running();
    running.interrupt();
    let run = running.wait();
    run.assert_complete();
    assert_restarts(&run, "gyro", &killed_gyro);
    assert_restarts(&run, "course", &killed_course);
}

#[test]
fn kill_in_lockstep_changes_no_byte() {
    let launch = "[ingest.sim]\nscenario = \"cruise\"";
    let mut killed = Vec::new();
    let run = assert_undisturbed(launch, &["--speed", "40"], |running| {
        for service in ["fuser", "gyro", "ingest", "course", "accel"] {
            killed.push((service, kill_repeatedly(running, service, 1, 300)));
        }
    });
    for (service, killed) in killed {
        assert_restarts(&run, service, &killed);
    }
}

#[test]
fn kill_near_the_end_loses_nothing() {
    let arguments = ["--speed", "20"];
    for service in ["ingest", "gyro", "accel", "fuser", "course"] {
        for end_comes_first in [false, true] {
            let system = System::new("");
            let out = system.path("out.csv");
            let running = system.start(&[&["--out", out.to_str().unwrap()], &arguments[..]].concat());
            running.all_services();
            let pid = running.service(service);
            system.wait_until_running();
            pause(100);
            if end_comes_first {
                running.interrupt();
            }
            signal(pid, Signal::KILL);
            system.stop_and_assert_undisturbed(running, &out, "");
        }
    }
}

#[test]
fn two_services_killed_together_lose_nothing() {
    assert_undisturbed("", &[], |running| {
        for pair in [["gyro", "fuser"], ["fuser", "course"], ["accel", "course"]] {
            pause(700);
            pair.map(|service| running.service(service)).into_iter().for_each(|pid| signal(pid, Signal::KILL));
        }
    });
}

#[test]
fn kills_with_frozen_subscriber_lose_nothing() {
    assert_undisturbed("", &[], |running| {
        for [first, second] in [["accel", "fuser"], ["gyro", "fuser"], ["ingest", "fuser"], ["accel", "fuser"]] {
            pause(700);
            signal(running.service("course"), Signal::STOP);
            pause(100);
            signal(running.service(first), Signal::KILL);
            pause(120);
            signal(running.service(second), Signal::KILL);
            pause(700);
        }
    });
}

#[test]
fn frozen_service_is_killed_and_restarted() {
    let run = assert_undisturbed("", &[], |running| {
        for service in ["gyro", "accel", "fuser", "course"] {
            pause(300);
            let pid = running.service(service);
            signal(pid, Signal::STOP);
            wait_for("the frozen process to be replaced", || running.service(service) != pid);
        }
    });
    assert!(run.stderr.contains("has reported no health for"), "{}", run.stderr);
    let stopped = |line: &str| line.split_once("(kernel state before: ").is_some_and(|(_, state)| state.contains(" T"));
    assert!(run.stderr.lines().any(stopped), "{}", run.stderr);
}

/// Kills a service and freezes its next incarnation as soon as the incarnation exists.
fn kill_and_freeze_successor(running: &Running, service: &str) -> u32 {
    let killed = running.service(service);
    signal(killed, Signal::KILL);
    let deadline = Instant::now() + Duration::from_secs(60);
    // Polls without pausing, because the first health message follows within milliseconds.
    while Instant::now() < deadline {
        if let Some((_, pid)) = running.services().into_iter().find(|(name, pid)| name == service && *pid != killed) {
            signal(pid, Signal::STOP);
            return pid;
        }
    }
    panic!("{service} was not restarted");
}

/// The environment variable `PLUMBLINE_FREEZES` sets the number of freezes.
#[test]
fn successor_frozen_at_start_is_replaced_without_loss() {
    let freezes = std::env::var("PLUMBLINE_FREEZES").map_or(10, |count| count.parse().unwrap());
    let run = assert_undisturbed("", &[], |running| {
        for service in ["ingest", "gyro", "accel", "fuser", "course"].iter().cycle().take(freezes) {
            let frozen = kill_and_freeze_successor(running, service);
            wait_for("the frozen process to be replaced", || running.service(service) != frozen);
            pause(300);
        }
    });
    let early = run.stderr.matches("has not opened its topics for").count();
    println!("{freezes} incarnations were stopped, {early} of them before their first health message");
    assert!(early > 0, "all were stopped too late: {}", run.stderr);
}

#[test]
fn machine_stall_restarts_no_service() {
    let run = assert_undisturbed("", &[], |running| {
        // The last stall is longer than the time that the topic buffers cover.
        for stall_ms in [900, 900, 3000] {
            pause(500);
            let services = running.all_services();
            // The supervisor resumes first, as can happen when a machine wakes up.
            let pids: Vec<_> = [running.pid()].into_iter().chain(services.iter().map(|(_, pid)| *pid)).collect();
            pids.iter().rev().for_each(|pid| signal(*pid, Signal::STOP));
            pause(stall_ms);
            for pid in pids {
                signal(pid, Signal::CONT);
                pause(30);
            }
        }
    });
    assert!(["ingest", "gyro", "accel", "fuser", "course"].iter().all(|service| restarts(&run, service) == 0));
}

#[test]
fn stage_that_cannot_start_yet_is_retried() {
    let folder = tempfile::tempdir().unwrap();
    let marker = folder.path().join("marker");
    let command =
        format!("test -e {} && exec {} hosted none", marker.display(), crate::common::faulty_executable().display());
    let rule = "limit = 1\nbackoff_s = 0.01\nbackoff_max_s = 0.1\non_limit = \"retry\"";
    let stage = format!("slot = \"course\"\ncommand = [\"sh\", \"-c\", {command:?}]");
    let system = System::new(&format!("[course]\nstage = \"late\"\n[stages.late]\n{stage}\n[restart]\n{rule}"));
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    // The status must be available during the start as well.
    wait_for("the third attempt", || system.ps().iter().any(|one| one["restarts"].as_u64() >= Some(2)));
    std::fs::write(marker, "").unwrap();
    system.wait_until_running();
    system.stop_and_assert_undisturbed(running, &out, "");
}

#[test]
fn restart_limit_stops_system_and_names_service() {
    let system = System::new("[restart]\nmin_uptime_s = 60\nbackoff_s = 0\nlimit = 2");
    let running = system.start(&["--for", "60s"]);
    let mut last = 0;
    for _ in 0..3 {
        wait_for("another incarnation", || running.service("gyro") != last);
        last = running.service("gyro");
        signal(last, Signal::KILL);
    }
    let run = running.wait();
    assert_eq!(run.code, Some(1), "{}", run.stderr);
    let message = format!("service gyro (process {last}) was killed by signal 9; the system was stopped");
    assert!(run.stderr.contains(&message), "{}", run.stderr);
    assert!(run.json["error"].as_str().unwrap().starts_with(&message), "{}", run.json);
    assert_eq!(restarts(&run, "gyro"), 2);
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn degraded_system_without_accel_runs_and_flags_it() {
    let system = System::new(
        "buffer_s = 1.0\nlateness_s = 0.3\n[restart]\nmin_uptime_s = 60\nlimit = 0\non_limit = \"degrade\"",
    );
    let running = system.start(&["--for", "4s"]);
    running.all_services();
    pause(1000);
    signal(running.service("accel"), Signal::KILL);
    let run = running.wait();
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    assert_eq!((run.number("/ticks_out"), run.number("/lost")), (4000.0, 0.0), "{}", run.stderr);
    assert!(run.line("flags").contains("accel-missing"), "{}", run.stderr);
    assert!(run.stderr.contains("restart limit reached, not restarted"), "{}", run.stderr);
}

#[test]
fn retry_rule_restarts_service_beyond_limit() {
    let launch = "[restart]\nmin_uptime_s = 60\nlimit = 0\nbackoff_max_s = 0.1\non_limit = \"retry\"";
    let mut killed = Vec::new();
    let run = assert_undisturbed(launch, &[], |running| killed = kill_repeatedly(running, "fuser", 4, 400));
    assert_restarts(&run, "fuser", &killed);
}
