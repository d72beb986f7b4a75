//! Swaps that fail, one by one: the old stage stays and no byte changes.
use std::{process::Stdio, time::Duration};

use crate::common::{Running, System, children_of, faulty, lives, plumb, signal, until};
use rustix::process::Signal;
use serde_json::Value;

/// A system in whose launch file `fault` is a stage.
fn system(fault: &str) -> System {
    let stage = format!("[stages.{fault}]\nslot = \"course\"\ncommand = [{:?}, \"{fault}\"]\n", faulty());
    System::with_faults(&format!("[restart]\nsilence_s = 2\n{stage}"))
}

fn ask(system: &System, arguments: &[&str]) -> Value {
    let output = plumb(&[arguments, &["--json", "--system", &system.name]].concat()).output().unwrap();
    serde_json::from_slice(&output.stdout).unwrap_or(Value::Null)
}

fn stage_in(system: &System, slot: &str) -> String {
    let services = ask(system, &["ps"]);
    let one = services.as_array().unwrap().iter().find(|one| one["service"] == slot).unwrap();
    one["stage"].as_str().unwrap().to_owned()
}

fn started(system: &System, arguments: &[&str]) -> Running {
    let running = system.start(arguments);
    let all = |services: &Value| services.as_array().is_some_and(|all| all.iter().all(|one| one["state"] == "running"));
    until("the system to run", || all(&ask(system, &["ps"])));
    running
}

/// Asks for the swap, sees it aborted for this reason, and holds the bytes of the whole run against an undisturbed one.
fn assert_aborted(fault: &str, reason: &str) {
    let system = system(fault);
    let out = system.path("out.csv");
    let running = started(&system, &["--out", out.to_str().unwrap()]);
    let report = system.ask_swap(&["course", fault]);
    assert_eq!(report["outcome"], "aborted", "{report}");
    assert!(report["reason"].as_str().unwrap().contains(reason), "{report}");
    assert_eq!(stage_in(&system, "course"), "angles");
    until("the candidate to be gone", || children_of(running.pid()).len() == 5);
    // The slot is free again.
    assert_eq!(system.swap(&["course", "angles"])["outcome"], "committed");
    system.assert_ends_undisturbed(running, &out, "");
}

#[test]
fn a_candidate_that_dies_at_once() {
    assert_aborted("dies-at-once", "on purpose");
}

#[test]
fn a_candidate_that_dies_before_it_is_ready() {
    assert_aborted("dies-before-ready", "on purpose");
}

#[test]
fn a_candidate_that_dies_when_it_is_ready() {
    assert_aborted("dies-when-ready", "on purpose");
}

#[test]
fn a_candidate_of_another_layout() {
    assert_aborted("other-layout", "the layout on the bus differs");
}

#[test]
fn a_candidate_that_never_becomes_ready() {
    assert_aborted("never-ready", "did not open its topics");
}

#[test]
fn a_candidate_that_hangs() {
    assert_aborted("hangs-when-ready", "the new stage exited");
}

#[test]
fn a_candidate_that_falls_behind() {
    assert_aborted("falls-behind", "behind");
}

#[test]
fn a_candidate_that_misses_the_commitment() {
    assert_aborted("misses-the-commit", "was not confirmed in time");
}

#[test]
fn a_candidate_that_gives_what_is_not_a_number() {
    assert_aborted("gives-nan", "an invalid output");
}

#[test]
fn an_active_stage_that_freezes_anywhere_near_its_last_tick_costs_no_tick() {
    let system = System::new("");
    let out = system.path("out.csv");
    let running = started(&system, &["--out", out.to_str().unwrap()]);
    let active = |slot: &str| {
        let services = ask(&system, &["ps"]);
        services.as_array().unwrap().iter().find(|one| one["service"] == slot).unwrap()["pid"].as_u64().unwrap() as u32
    };
    // The decision falls some 130 ms after the request, and the tick 50 ms after the decision; where exactly is chance.
    for (slot, stage, delay_ms) in [
        ("course", "angles", 135),
        ("fuser", "multiple-model", 150),
        ("course", "angles", 165),
        ("gyro", "mobius", 165),
        ("accel", "projector", 165),
        ("course", "angles", 180),
        ("fuser", "multiple-model", 195),
    ] {
        let frozen = active(slot);
        let asking = plumb(&["swap", slot, stage, "--json", "--system", &system.name]);
        let asking = { asking }.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        std::thread::sleep(Duration::from_millis(delay_ms));
        signal(frozen, Signal::STOP);
        let report: Value = serde_json::from_slice(&asking.wait_with_output().unwrap().stdout).unwrap();
        println!("frozen {delay_ms} ms after the request: {report}");
        until("the frozen one to be gone", || !lives(frozen));
        system.all_run();
    }
    system.assert_ends_undisturbed(running, &out, "");
}

#[test]
fn a_stage_that_ignores_its_end_is_killed_once_it_owns_nothing() {
    let system = system("ignores-sigterm");
    let running = started(&system, &[]);
    assert_eq!(system.swap(&["course", "ignores-sigterm"])["outcome"], "committed");
    until("the old stage to be gone", || children_of(running.pid()).len() == 5);
    assert_eq!(system.swap(&["course", "angles"])["outcome"], "committed");
    until("the stubborn one to be gone", || children_of(running.pid()).len() == 5);
    running.interrupt();
    running.wait().assert_whole();
}

#[test]
fn a_supervisor_that_dies_in_any_phase_of_a_swap_leaves_nothing_and_the_next_start_is_clean() {
    let system = System::new("");
    // Starting, catching up, shadowing, committing, retiring; where exactly is chance, which any moment must bear.
    for delay_ms in [2, 20, 60, 120, 170, 210, 240, 280, 400] {
        let running = started(&system, &[]);
        let mut asking = plumb(&["swap", "fuser", "vqf", "--system", &system.name]);
        let mut asking = asking.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        std::thread::sleep(Duration::from_millis(delay_ms));
        let children = children_of(running.pid());
        signal(running.pid(), Signal::KILL);
        running.output();
        asking.wait().unwrap();
        until("its services to end", || !children.iter().any(|pid| lives(*pid)));
        until("what is left to be removed", || system.remains().is_empty());
    }
    system.run(&["--for", "1s"]).assert_whole();
}

#[test]
fn a_stage_that_hangs_does_not_outlive_its_supervisor() {
    let system = system("hangs-when-ready");
    let running = started(&system, &[]);
    let mut asking = plumb(&["swap", "course", "hangs-when-ready", "--system", &system.name]);
    let mut asking = asking.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    until("the candidate to start", || children_of(running.pid()).len() == 6);
    // It hangs by then, and has not been silent for long enough to be killed.
    std::thread::sleep(Duration::from_millis(250));
    let children = children_of(running.pid());
    assert_eq!(children.len(), 6);
    signal(running.pid(), Signal::KILL);
    running.output();
    asking.wait().unwrap();
    until("its services to end", || !children.iter().any(|pid| lives(*pid)));
    until("what is left to be removed", || system.remains().is_empty());
}
