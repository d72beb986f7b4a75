//! Swaps that replace a failed stage, and swaps requested before the first tick.
use std::{collections::HashSet, fs, path::Path, process::Stdio, time::Duration};

use crate::common::{
    Run, Running, System, assert_valid_attitudes, attitudes, faulty_executable, plumb, signal, wait_for,
};
use bus::{Bus, Publisher, SystemName};
use messages::SensorReading;
use rustix::process::Signal;
use serde_json::Value;

/// Creates a system with a course stage that has the same fault in every incarnation.
fn system_with_failing_stage(buffer: &str, fault: &str, rule: &str) -> System {
    let stage =
        |name: &str| format!("[stages.{name}]\nslot = \"course\"\ncommand = [{:?}, \"{name}\"]\n", faulty_executable());
    let stages = [stage("dies-when-ready"), stage("dies-at-once")].concat();
    let rule = format!("[restart]\nlimit = 2\nbackoff_s = 0.01\n{rule}\n");
    System::with_faults(&format!("{buffer}[course]\nstage = \"{fault}\"\n{stages}{rule}"))
}

fn service_status(system: &System, slot: &str) -> Value {
    system.ps().into_iter().find(|one| one["service"] == slot).unwrap_or_default()
}

fn restarts(system: &System, slot: &str) -> u64 {
    service_status(system, slot)["restarts"].as_u64().unwrap_or(0)
}

/// Checks that `stage` runs in the slot and publishes ticks.
fn assert_publishes(system: &System, slot: &str, stage: &str) {
    let ticks = || service_status(system, slot)["ticks"].as_u64().unwrap_or(0);
    let before = ticks();
    wait_for("ticks to be published again", || ticks() > before + 500);
    let now = service_status(system, slot);
    assert_eq!((&now["stage"], &now["state"]), (&stage.into(), &"running".into()), "{now}");
}

fn stop(running: Running) -> Run {
    running.interrupt();
    running.wait()
}

/// Checks that every line of `out` is a line of an undisturbed run with the same number of ticks.
fn assert_lines_of_undisturbed_run(run: &Run, out: &Path) {
    let system = System::new("");
    let undisturbed = system.path("undisturbed.csv");
    let duration = format!("{}s", run.number("/ticks_in") / 1000.0);
    let arguments = ["--in-process", "--speed", "max", "--for", &duration, "--out", undisturbed.to_str().unwrap()];
    system.run(&arguments).assert_complete();
    let [expected, found] = [undisturbed.as_path(), out].map(|path| fs::read_to_string(path).unwrap());
    let expected: HashSet<_> = expected.lines().collect();
    let other = found.lines().find(|line| !expected.contains(line));
    assert_eq!(other, None, "a line that an undisturbed run does not have: {}", run.stderr);
}

#[test]
fn swap_replaces_retrying_stage_without_loss() {
    let buffer = "buffer_s = 30\nlateness_s = 20\n";
    let system = system_with_failing_stage(buffer, "dies-when-ready", "on_limit = \"retry\"\nbackoff_max_s = 0.2");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    wait_for("the restart limit", || restarts(&system, "course") >= 4);
    let report = system.swap(&["course", "angles"]);
    println!("{report}");
    assert_eq!((&report["outcome"], &report["lost"]), (&"committed".into(), &0.into()), "{report}");
    assert_publishes(&system, "course", "angles");
    // The slot can then be swapped as usual.
    assert_eq!(system.swap(&["course", "track"])["outcome"], "committed");
    assert_eq!(system.swap(&["course", "angles"])["outcome"], "committed");
    let run = system.stop_and_assert_undisturbed(running, &out, "");
    assert!(run.stderr.contains("replace its stage with `plumb swap course STAGE`"), "{}", run.stderr);
}

#[test]
fn swap_replaces_failed_stage_and_counts_loss() {
    let system =
        system_with_failing_stage("buffer_s = 2.0\nlateness_s = 1.0\n", "dies-when-ready", "on_limit = \"degrade\"");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    wait_for("the slot to fail", || service_status(&system, "course")["state"] == "failed");
    // The wait is longer than the time that the topic buffers cover, so ticks are lost.
    std::thread::sleep(Duration::from_secs(4));
    let report = system.swap(&["course", "angles"]);
    println!("{report}");
    assert_eq!(report["outcome"], "committed", "{report}");
    let lost = report["lost"].as_u64().unwrap();
    assert!(lost > 0, "{report}");
    assert_publishes(&system, "course", "angles");
    let run = stop(running);
    // Ticks may have been lost before the swap was requested.
    assert!(run.number("/lost") >= lost as f64, "{}", run.stderr);
    assert_eq!(run.number("/ticks_in"), run.number("/ticks_out") + run.number("/lost"));
    assert_eq!(run.number("/duplicated"), 0.0, "{}", run.stderr);
    assert_lines_of_undisturbed_run(&run, &out);
}

#[test]
fn swap_replaces_failed_stage_in_every_slot() {
    let system = System::new("lateness_s = 0.3\n[restart]\nmin_uptime_s = 60\nlimit = 0\non_limit = \"degrade\"");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    system.wait_until_running();
    std::thread::sleep(Duration::from_millis(1500));
    for (slot, stage) in [("fuser", "vqf"), ("gyro", "rk4"), ("accel", "inclinometer-matrix"), ("course", "track")] {
        signal(running.service(slot), Signal::KILL);
        wait_for("the slot to fail", || service_status(&system, slot)["state"] == "failed");
        let report = system.swap(&[slot, stage]);
        println!("{report}");
        assert_eq!((&report["outcome"], &report["lost"]), (&"committed".into(), &0.into()), "{report}");
        assert!(report["jump_deg"].as_f64().unwrap() < 5.0, "{report}");
        assert_publishes(&system, slot, stage);
    }
    let run = stop(running);
    run.assert_complete();
    assert!(run.line("flags").contains("swapped"), "{}", run.stderr);
    assert_valid_attitudes(&attitudes(&out));
}

#[test]
fn replacement_that_fails_leaves_slot_unchanged() {
    for rule in ["on_limit = \"retry\"\nbackoff_max_s = 0.2", "on_limit = \"degrade\""] {
        let system = system_with_failing_stage("", "dies-when-ready", rule);
        let running = system.start(&[]);
        wait_for("the restart limit", || restarts(&system, "course") >= 2);
        let report = system.swap_once(&["course", "dies-at-once"]);
        assert_eq!(report["outcome"], "aborted", "{report}");
        assert!(report["reason"].as_str().unwrap().contains("on purpose"), "{report}");
        assert_eq!(service_status(&system, "course")["stage"], "dies-when-ready");
        assert_eq!(system.swap(&["course", "angles"])["outcome"], "committed");
        assert_publishes(&system, "course", "angles");
        stop(running);
        assert_eq!(system.leftovers(), Vec::<String>::new());
    }
}

#[test]
fn swap_before_first_tick_waits_for_it() {
    // Requests the swap as early as possible.
    let system = System::new("");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    wait_for("the control socket", || !system.ps().is_empty());
    let report = system.swap(&["course", "angles"]);
    assert_eq!((&report["outcome"], &report["lost"]), (&"committed".into(), &0.into()), "{report}");
    system.wait_until_running();
    system.stop_and_assert_undisturbed(running, &out, "");

    // The source stays silent for longer than every timeout of a swap.
    let system = System::new("[ingest]\nsource = \"bus\"\n[ingest.bus]\nrate_hz = 200");
    let running = system.start(&[]);
    wait_for("every service", || system.ps().iter().filter(|one| one["state"] == "ready").count() == 5);
    let mut client = plumb(&["swap", "fuser", "vqf", "--json", "--system", &system.name]);
    let mut client = client.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    std::thread::sleep(Duration::from_secs(2));
    assert!(client.try_wait().unwrap().is_none(), "the request was answered before the first tick");
    let bus = Bus::join(&SystemName::new(&system.name).unwrap(), "test").unwrap();
    let sensor: Publisher<SensorReading> = bus.publisher(400).unwrap();
    let mut count = 0;
    wait_for("the report", || {
        count += 1;
        let reading = SensorReading {
            t_sensor_ns: count * 5_000_000,
            rate_rad_s: [0.0; 3],
            force_m_s2: [0.0, 0.0, 9.8],
            field_ut: [f64::NAN; 3],
        };
        sensor.send(&reading).unwrap();
        sensor.wake();
        client.try_wait().unwrap().is_some()
    });
    let report: Value = serde_json::from_slice(&client.wait_with_output().unwrap().stdout).unwrap();
    assert_eq!((&report["outcome"], &report["lost"]), (&"committed".into(), &0.into()), "{report}");
    drop((sensor, bus));
    stop(running).assert_complete();
}
