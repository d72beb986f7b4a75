//! Swaps of stages in a running system.
//!
//! No tick is lost or duplicated, and the old stage stays if the swap fails.
use std::{
    io::{BufRead as _, BufReader},
    time::Duration,
};

use crate::common::{Running, System, children_of, service_of, signal, wait_for};
use rustix::process::Signal;
use serde_json::Value;

fn ps(system: &System) -> Vec<Value> {
    system.ps()
}

/// Returns the name of the stage in the slot.
fn stage_in(system: &System, slot: &str) -> String {
    let mut stage = None;
    // After a stall the machine may not respond immediately.
    wait_for("the system to respond", || {
        let services = ps(system);
        let one = services.iter().find(|one| one["service"] == slot);
        stage = one.and_then(|one| one["stage"].as_str().map(str::to_owned));
        stage.is_some()
    });
    stage.unwrap()
}

/// Starts the system and waits until it runs.
fn start_system(system: &System, arguments: &[&str]) -> Running {
    let running = system.start(arguments);
    system.wait_until_running();
    running
}

fn assert_committed(report: &Value) {
    assert_eq!(report["outcome"], "committed", "{report}");
    assert_eq!((report["lost"].as_u64(), report["duplicated"].as_u64()), (Some(0), Some(0)), "{report}");
}

#[test]
fn swap_to_every_stage_loses_nothing() {
    let slots: [(&str, &[&str]); 4] = [
        ("gyro", &["mobius-coning", "rk4", "euler", "mobius"]),
        ("accel", &["inclinometer-matrix", "inclinometer-quaternion", "projector"]),
        (
            "fuser",
            &[
                "aided",
                "levelling-pi",
                "levelling-unified",
                "levelling",
                "madgwick",
                "madgwick-improved",
                "wz-closed",
                "wz-open",
                "vqf",
                "wz",
                "multiple-model",
            ],
        ),
        ("course", &["track", "angles"]),
    ];
    let system = System::new("");
    let running = start_system(&system, &[]);
    for (slot, stages) in slots {
        for stage in stages {
            let report = system.swap(&[slot, stage]);
            println!("{report}");
            assert_committed(&report);
            assert!(report["jump_deg"].as_f64().unwrap() < 5.0, "{report}");
            assert_eq!(stage_in(&system, slot), *stage);
        }
    }
    running.interrupt();
    let run = running.wait();
    run.assert_complete();
    assert_eq!((run.number("/lost"), run.number("/duplicated")), (0.0, 0.0));
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn swap_to_same_stage_changes_no_byte() {
    let system = System::new("");
    let out = system.path("out.csv");
    let running = start_system(&system, &["--out", out.to_str().unwrap()]);
    for (slot, stage) in [("fuser", "multiple-model"), ("gyro", "mobius"), ("accel", "projector"), ("course", "angles")]
    {
        let report = system.swap(&[slot, stage]);
        assert_committed(&report);
        assert_eq!(report["jump_deg"], 0.0, "{report}");
    }
    signal(running.service("fuser"), Signal::KILL);
    running.interrupt();
    let run = running.wait();
    run.assert_complete();
    run.assert_undisturbed_output(&out, "");
}

#[test]
fn invalid_swap_is_rejected_and_changes_no_byte() {
    let system = System::new("");
    let out = system.path("out.csv");
    let running = start_system(&system, &["--out", out.to_str().unwrap()]);
    for (arguments, reason) in [
        (&["wing", "wz"][..], "unknown slot `wing`"),
        (&["ingest", "wz"], "unknown slot `ingest`"),
        (&["fusr", "wz"], "did you mean `fuser`?"),
        (&["fuser", "kalman"], "no stage named `kalman`; stages of the slot `fuser`: "),
        (&["fuser", "kalman"], ", madgwick-improved, "),
        (&["fuser", "wz-opne"], "did you mean `wz-open`?"),
        (&["course", "wz"], "`wz` belongs to the slot `fuser`, not `course`"),
        (&["fuser", "wz", "--set", "colour=3"], "unknown parameter"),
        (&["fuser", "wz", "--set", "hard_iron_sd_ut=-3"], "hard_iron_sd_ut"),
    ] {
        let report = system.swap_once(arguments);
        assert_eq!(report["outcome"], "refused", "{report}");
        assert!(report["reason"].as_str().unwrap().contains(reason), "{report}");
    }
    running.interrupt();
    let run = running.wait();
    run.assert_complete();
    run.assert_undisturbed_output(&out, "");
}

/// Returns the processes of a slot: its owner and the candidate, if any.
fn slot_processes(running: &Running, slot: &str) -> Vec<u32> {
    children_of(running.pid()).into_iter().filter(|pid| service_of(*pid).as_deref() == Some(slot)).collect()
}

#[test]
fn kill_of_candidate_or_owner_keeps_old_stage() {
    let system = System::new("");
    let out = system.path("out.csv");
    let running = start_system(&system, &["--out", out.to_str().unwrap()]);
    let owner = running.service("fuser");
    for victim_is_owner in [false, true] {
        let shadow = || {
            let mut command = crate::common::plumb(&["shadow", "fuser", "vqf", "--system", &system.name]);
            command.stdout(std::process::Stdio::null()).stderr(std::process::Stdio::piped()).spawn().unwrap()
        };
        let client = shadow();
        wait_for("a candidate", || slot_processes(&running, "fuser").len() == 2);
        std::thread::sleep(Duration::from_millis(300));
        let second = system.swap_once(&["fuser", "aided"]);
        assert_eq!(second["outcome"], "refused", "two swaps at the same time: {second}");
        let reason = second["reason"].as_str().unwrap();
        assert!(reason.contains("is in progress") && reason.contains("Ctrl-C"), "{reason}");
        let victim =
            slot_processes(&running, "fuser").into_iter().find(|pid| (*pid == owner) == victim_is_owner).unwrap();
        signal(victim, Signal::KILL);
        let text = String::from_utf8(client.wait_with_output().unwrap().stderr).unwrap();
        assert!(text.contains("unchanged (multiple-model)"), "{text}");
        wait_for("one fuser", || slot_processes(&running, "fuser").len() == 1);
        assert_eq!(stage_in(&system, "fuser"), "multiple-model");
    }
    running.interrupt();
    let run = running.wait();
    run.assert_complete();
    run.assert_undisturbed_output(&out, "");
}

#[test]
fn shadow_reports_difference_and_is_promoted_in_place() {
    let system = System::new("");
    let running = start_system(&system, &[]);
    let mut command = crate::common::plumb(&["shadow", "fuser", "wz-open", "--json", "--system", &system.name]);
    let mut shadow = command.stdout(std::process::Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(shadow.stdout.take().unwrap()).lines().map(Result::unwrap);
    wait_for("a candidate", || slot_processes(&running, "fuser").len() == 2);
    let candidate = *slot_processes(&running, "fuser").iter().max().unwrap();
    let mut differences = lines.by_ref().map(|line| serde_json::from_str::<Value>(&line).unwrap());
    let difference = differences.find(|difference| difference["ticks"].as_u64() > Some(100)).unwrap();
    let report = system.swap(&["fuser", "wz-open"]);
    assert_committed(&report);
    assert_eq!(ps(&system).iter().find(|one| one["service"] == "fuser").unwrap()["pid"], candidate);
    lines.for_each(drop);
    shadow.wait().unwrap();
    let angle = |what: &str| difference[what]["angle"].as_f64().unwrap();
    assert!(0.0 < angle("mean_deg") && angle("mean_deg") <= angle("rms_deg") && angle("rms_deg") <= angle("max_deg"));
    running.interrupt();
    running.wait().assert_complete();
}
