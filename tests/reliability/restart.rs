//! Services that die, freeze or cannot live: every tick comes out once, in order, with the bytes of an undisturbed run.
use std::{
    fs,
    path::Path,
    time::{Duration, Instant},
};

use crate::common::{Run, Running, System, copied, signal, until};
use rustix::process::Signal;

/// Runs `launch`, disturbs it, ends it, and holds what came out against an undisturbed run of as many ticks.
fn assert_undisturbed(launch: &str, arguments: &[&str], disturb: impl FnOnce(&Running)) -> Run {
    let system = System::new(launch);
    let out = system.path("out.csv");
    let running = system.start(&[&["--out", out.to_str().unwrap()], arguments].concat());
    running.all_services();
    disturb(&running);
    system.all_run();
    system.assert_ends_undisturbed(running, &out, launch)
}

fn restarts(run: &Run, service: &str) -> u64 {
    let services = run.json["services"].as_array().unwrap();
    services.iter().find(|one| one["name"] == service).unwrap()["restarts"].as_u64().unwrap()
}

/// Kills as many lives of a service, with pauses of `pause_ms`: none twice, however long the machine takes for the next.
fn kill_lives(running: &Running, service: &str, count: usize, pause_ms: u64) {
    let mut dead = None;
    for _ in 0..count {
        pause(pause_ms);
        until("the next life", || Some(running.service(service)) != dead);
        let pid = running.service(service);
        signal(pid, Signal::KILL);
        dead = Some(pid);
    }
}

fn pause(ms: u64) {
    std::thread::sleep(Duration::from_millis(ms));
}

#[test]
fn kills_at_random_moments_lose_nothing_and_change_no_byte() {
    let output = crate::common::plumb(&["bench", "kills", "--count", "20", "--json"]).output().unwrap();
    let people = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{people}");
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    println!("{report}");
    assert_eq!((report["lost"].as_u64(), report["duplicated"].as_u64()), (Some(0), Some(0)));
    assert_eq!(report["same_bytes"], true);
    assert!(report["kills"].as_u64() >= Some(15), "{report}");
}

#[test]
fn a_source_that_is_killed_goes_on_at_the_tick_where_it_died() {
    let run = assert_undisturbed("", &[], |running| {
        kill_lives(running, "ingest", 3, 600);
    });
    assert_eq!(restarts(&run, "ingest"), 3);
}

#[test]
fn a_service_that_somebody_else_asks_to_end_goes_on_and_that_is_said() {
    let services = ["ingest", "gyro", "accel", "fuser", "course"];
    let run = assert_undisturbed("", &[], |running| {
        for service in services {
            // Without a look at /proc meanwhile: whoever is in the folder of a dying process holds up its parent.
            pause(600);
            signal(running.service(service), Signal::TERM);
        }
        pause(600);
    });
    for service in services {
        let told = |how: &str| {
            let ended = format!("{service}: process ");
            run.people.lines().filter(|line| line.starts_with(&ended) && line.contains(how)).count() as u64
        };
        assert_eq!(told("as after a SIGTERM"), 1, "{service}: {}", run.people);
        // On a machine with too much to do one may be silent for so long that the supervisor kills it.
        assert_eq!(restarts(&run, service), 1 + told("was killed by signal 9"), "{service}: {}", run.people);
    }
}

#[test]
fn an_upgrade_of_the_program_under_a_running_system_changes_nothing_until_its_next_start() {
    let mut system = System::new("");
    let (installed, another) = (system.path("plumb"), system.path("another"));
    copied(&system.executable, &installed);
    // Whatever is installed there now, it is no service.
    copied(Path::new("/bin/false"), &another);
    system.executable = installed.clone();
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    running.all_services();
    system.all_run();
    fs::rename(&another, &installed).unwrap();
    kill_lives(&running, "gyro", 1, 300);
    let report = system.swap(&["fuser", "vqf"]);
    assert_eq!(report["outcome"], "committed", "{report}");
    fs::remove_file(&installed).unwrap();
    kill_lives(&running, "course", 1, 300);
    pause(300);
    system.all_run();
    running.interrupt();
    let run = running.wait();
    run.assert_whole();
    assert_eq!((restarts(&run, "gyro"), restarts(&run, "course")), (1, 1));
}

#[test]
fn in_lockstep_a_killed_service_costs_time_and_nothing_else() {
    let launch = "[ingest.sim]\nscenario = \"cruise\"";
    let run = assert_undisturbed(launch, &["--speed", "40"], |running| {
        for service in ["fuser", "gyro", "ingest", "course", "accel"] {
            pause(300);
            signal(running.service(service), Signal::KILL);
        }
    });
    assert!(["fuser", "gyro", "ingest", "course", "accel"].iter().all(|service| restarts(&run, service) == 1));
}

#[test]
fn who_dies_just_before_the_end_or_after_it_was_asked_for_still_gives_what_came_in() {
    let arguments = ["--speed", "20"];
    for service in ["ingest", "gyro", "accel", "fuser", "course"] {
        for end_comes_first in [false, true] {
            let system = System::new("");
            let out = system.path("out.csv");
            let running = system.start(&[&["--out", out.to_str().unwrap()], &arguments[..]].concat());
            running.all_services();
            let pid = running.service(service);
            system.all_run();
            pause(100);
            if end_comes_first {
                running.interrupt();
            }
            signal(pid, Signal::KILL);
            system.assert_ends_undisturbed(running, &out, "");
        }
    }
}

#[test]
fn two_neighbours_killed_at_once_go_on() {
    assert_undisturbed("", &[], |running| {
        for pair in [["gyro", "fuser"], ["fuser", "course"], ["accel", "course"]] {
            pause(700);
            pair.map(|service| running.service(service)).into_iter().for_each(|pid| signal(pid, Signal::KILL));
        }
    });
}

#[test]
fn services_that_die_one_after_another_while_a_reader_stands_still_go_on() {
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
fn a_service_that_freezes_is_killed_and_goes_on() {
    let run = assert_undisturbed("", &[], |running| {
        for service in ["gyro", "accel", "fuser", "course"] {
            pause(300);
            let pid = running.service(service);
            signal(pid, Signal::STOP);
            until("the frozen one to be replaced", || running.service(service) != pid);
        }
    });
    assert!(run.people.contains("has reported no health for"), "{}", run.people);
}

/// Kills a service, and stops its next incarnation as soon as there is one.
fn kill_and_freeze_the_next(running: &Running, service: &str) -> u32 {
    let killed = running.service(service);
    signal(killed, Signal::KILL);
    let deadline = Instant::now() + Duration::from_secs(60);
    // Without a pause: it says its first word within milliseconds.
    while Instant::now() < deadline {
        if let Some((_, pid)) = running.services().into_iter().find(|(name, pid)| name == service && *pid != killed) {
            signal(pid, Signal::STOP);
            return pid;
        }
    }
    panic!("{service} was not started again");
}

/// `PLUMBLINE_FREEZES=50` does it more often.
#[test]
fn a_next_life_that_freezes_before_its_first_word_is_replaced_before_anything_is_lost() {
    let freezes = std::env::var("PLUMBLINE_FREEZES").map_or(10, |count| count.parse().unwrap());
    let run = assert_undisturbed("", &[], |running| {
        for service in ["ingest", "gyro", "accel", "fuser", "course"].iter().cycle().take(freezes) {
            let frozen = kill_and_freeze_the_next(running, service);
            until("the frozen one to be replaced", || running.service(service) != frozen);
            pause(300);
        }
    });
    let early = run.people.matches("has not opened its topics for").count();
    println!("{freezes} next lives were stopped, {early} of them before their first word");
    assert!(early > 0, "all were stopped too late: {}", run.people);
}

#[test]
fn a_machine_that_stands_still_and_goes_on_costs_no_service_its_life() {
    let run = assert_undisturbed("", &[], |running| {
        // The last is longer than what the topics hold.
        for stands_still_ms in [900, 900, 3000] {
            pause(500);
            let services = running.all_services();
            // The supervisor goes on first, as it may on a machine that was suspended.
            let pids: Vec<_> = [running.pid()].into_iter().chain(services.iter().map(|(_, pid)| *pid)).collect();
            pids.iter().rev().for_each(|pid| signal(*pid, Signal::STOP));
            pause(stands_still_ms);
            for pid in pids {
                signal(pid, Signal::CONT);
                pause(30);
            }
        }
    });
    assert!(["ingest", "gyro", "accel", "fuser", "course"].iter().all(|service| restarts(&run, service) == 0));
}

#[test]
fn a_service_that_cannot_start_yet_is_waited_for_where_the_rule_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let there = folder.path().join("there");
    let command = format!("test -e {} && exec {} hosted none", there.display(), crate::common::faulty().display());
    let rule = "limit = 1\nbackoff_s = 0.01\nbackoff_max_s = 0.1\non_limit = \"retry\"";
    let stage = format!("slot = \"course\"\ncommand = [\"sh\", \"-c\", {command:?}]");
    let system = System::new(&format!("[course]\nstage = \"late\"\n[stages.late]\n{stage}\n[restart]\n{rule}"));
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    // It is asked how it is while it starts.
    until("the third attempt", || system.ps().iter().any(|one| one["restarts"].as_u64() >= Some(2)));
    std::fs::write(there, "").unwrap();
    system.all_run();
    system.assert_ends_undisturbed(running, &out, "");
}

#[test]
fn a_service_that_cannot_live_ends_the_system_with_its_name() {
    let system = System::new("[restart]\nmin_uptime_s = 60\nbackoff_s = 0\nlimit = 2");
    let running = system.start(&["--for", "60s"]);
    let mut last = 0;
    for _ in 0..3 {
        until("another incarnation", || running.service("gyro") != last);
        last = running.service("gyro");
        signal(last, Signal::KILL);
    }
    let run = running.wait();
    assert_eq!(run.code, Some(1), "{}", run.people);
    let said = format!("service gyro (process {last}) was killed by signal 9; the system was stopped");
    assert!(run.people.contains(&said), "{}", run.people);
    assert!(run.json["error"].as_str().unwrap().starts_with(&said), "{}", run.json);
    assert_eq!(restarts(&run, "gyro"), 2);
    assert_eq!(system.remains(), Vec::<String>::new());
}

#[test]
fn without_an_accelerometer_a_degraded_system_goes_on_and_says_so() {
    let system =
        System::new("buffer_s = 1.0\nlateness_s = 0.3\n[restart]\nmin_uptime_s = 60\nlimit = 0\non_limit = \"degrade\"");
    let running = system.start(&["--for", "4s"]);
    running.all_services();
    pause(1000);
    signal(running.service("accel"), Signal::KILL);
    let run = running.wait();
    assert_eq!(run.code, Some(0), "{}", run.people);
    assert_eq!((run.number("/ticks_out"), run.number("/lost")), (4000.0, 0.0), "{}", run.people);
    assert!(run.line("flags").contains("accel-missing"), "{}", run.people);
    assert!(run.people.contains("restart limit reached, not restarted"), "{}", run.people);
}

#[test]
fn where_a_slot_is_held_a_service_that_cannot_live_is_tried_again() {
    let launch = "[restart]\nmin_uptime_s = 60\nlimit = 0\nbackoff_max_s = 0.1\non_limit = \"retry\"";
    let run = assert_undisturbed(launch, &[], |running| {
        kill_lives(running, "fuser", 4, 400);
    });
    assert_eq!(restarts(&run, "fuser"), 4);
}
