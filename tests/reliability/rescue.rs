//! A slot whose stage has failed gets another by a swap, and a swap that comes before the first tick waits for it.
use std::{collections::HashSet, fs, path::Path, process::Stdio, time::Duration};

use crate::common::{Run, Running, System, assert_sound, attitudes, faulty, plumb, signal, until};
use bus::{Bus, Publisher, SystemName};
use messages::SensorReading;
use rustix::process::Signal;
use serde_json::Value;

/// A system whose course stage has this fault from its first incarnation on.
fn failing(buffer: &str, fault: &str, rule: &str) -> System {
    let stage = |name: &str| format!("[stages.{name}]\nslot = \"course\"\ncommand = [{:?}, \"{name}\"]\n", faulty());
    let stages = [stage("dies-when-ready"), stage("dies-at-once")].concat();
    let rule = format!("[restart]\nlimit = 2\nbackoff_s = 0.01\n{rule}\n");
    System::with_faults(&format!("{buffer}[course]\nstage = \"{fault}\"\n{stages}{rule}"))
}

fn standing(system: &System, slot: &str) -> Value {
    system.ps().into_iter().find(|one| one["service"] == slot).unwrap_or_default()
}

fn restarts(system: &System, slot: &str) -> u64 {
    standing(system, slot)["restarts"].as_u64().unwrap_or(0)
}

/// The slot is filled by `stage`, which publishes one tick after the other.
fn assert_flows(system: &System, slot: &str, stage: &str) {
    let ticks = || standing(system, slot)["ticks"].as_u64().unwrap_or(0);
    let before = ticks();
    until("ticks to flow again", || ticks() > before + 500);
    let now = standing(system, slot);
    assert_eq!((&now["stage"], &now["state"]), (&stage.into(), &"running".into()), "{now}");
}

fn ended(running: Running) -> Run {
    running.interrupt();
    running.wait()
}

/// Every line of `out` is a line of an undisturbed run of as many ticks.
fn assert_no_other_lines(run: &Run, out: &Path) {
    let system = System::new("");
    let undisturbed = system.path("undisturbed.csv");
    let duration = format!("{}s", run.number("/ticks_in") / 1000.0);
    let arguments = ["--in-process", "--speed", "max", "--for", &duration, "--out", undisturbed.to_str().unwrap()];
    system.run(&arguments).assert_whole();
    let [expected, found] = [undisturbed.as_path(), out].map(|path| fs::read_to_string(path).unwrap());
    let expected: HashSet<_> = expected.lines().collect();
    let other = found.lines().find(|line| !expected.contains(line));
    assert_eq!(other, None, "a line that an undisturbed run does not have: {}", run.people);
}

#[test]
fn a_slot_that_is_held_is_rescued_by_a_swap_and_nothing_is_lost_that_the_topics_hold() {
    let buffer = "buffer_s = 30\nlateness_s = 20\n";
    let system = failing(buffer, "dies-when-ready", "on_limit = \"retry\"\nbackoff_max_s = 0.2");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    until("the limit", || restarts(&system, "course") >= 4);
    let report = system.swap(&["course", "angles"]);
    println!("{report}");
    assert_eq!((&report["outcome"], &report["lost"]), (&"committed".into(), &0.into()), "{report}");
    assert_flows(&system, "course", "angles");
    // The stage in the slot is one like any other.
    assert_eq!(system.swap(&["course", "track"])["outcome"], "committed");
    assert_eq!(system.swap(&["course", "angles"])["outcome"], "committed");
    let run = system.assert_ends_undisturbed(running, &out, "");
    assert!(run.people.contains("replace its stage with `plumb swap course STAGE`"), "{}", run.people);
}

#[test]
fn a_slot_that_has_failed_is_rescued_by_a_swap_and_what_is_lost_is_counted() {
    let system = failing("buffer_s = 2.0\nlateness_s = 1.0\n", "dies-when-ready", "on_limit = \"degrade\"");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    until("the slot to be left", || standing(&system, "course")["state"] == "failed");
    // Longer than the topics hold.
    std::thread::sleep(Duration::from_secs(4));
    let report = system.swap(&["course", "angles"]);
    println!("{report}");
    assert_eq!(report["outcome"], "committed", "{report}");
    let lost = report["lost"].as_u64().unwrap();
    assert!(lost > 0, "{report}");
    assert_flows(&system, "course", "angles");
    let run = ended(running);
    // Some may have been lost before the swap was asked for.
    assert!(run.number("/lost") >= lost as f64, "{}", run.people);
    assert_eq!(run.number("/ticks_in"), run.number("/ticks_out") + run.number("/lost"));
    assert_eq!(run.number("/duplicated"), 0.0, "{}", run.people);
    assert_no_other_lines(&run, &out);
}

#[test]
fn each_slot_that_has_failed_is_rescued_by_another_kind_of_stage() {
    let system = System::new("lateness_s = 0.3\n[restart]\nmin_uptime_s = 60\nlimit = 0\non_limit = \"degrade\"");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    system.all_run();
    std::thread::sleep(Duration::from_millis(1500));
    for (slot, stage) in [("fuser", "vqf"), ("gyro", "rk4"), ("accel", "inclinometer-matrix"), ("course", "track")] {
        signal(running.service(slot), Signal::KILL);
        until("the slot to be left", || standing(&system, slot)["state"] == "failed");
        let report = system.swap(&[slot, stage]);
        println!("{report}");
        assert_eq!((&report["outcome"], &report["lost"]), (&"committed".into(), &0.into()), "{report}");
        assert!(report["jump_deg"].as_f64().unwrap() < 5.0, "{report}");
        assert_flows(&system, slot, stage);
    }
    let run = ended(running);
    run.assert_whole();
    assert!(run.line("flags").contains("swapped"), "{}", run.people);
    assert_sound(&attitudes(&out));
}

#[test]
fn who_dies_in_the_place_of_another_leaves_the_slot_as_it_was() {
    for rule in ["on_limit = \"retry\"\nbackoff_max_s = 0.2", "on_limit = \"degrade\""] {
        let system = failing("", "dies-when-ready", rule);
        let running = system.start(&[]);
        until("the limit", || restarts(&system, "course") >= 2);
        let report = system.ask_swap(&["course", "dies-at-once"]);
        assert_eq!(report["outcome"], "aborted", "{report}");
        assert!(report["reason"].as_str().unwrap().contains("on purpose"), "{report}");
        assert_eq!(standing(&system, "course")["stage"], "dies-when-ready");
        assert_eq!(system.swap(&["course", "angles"])["outcome"], "committed");
        assert_flows(&system, "course", "angles");
        ended(running);
        assert_eq!(system.remains(), Vec::<String>::new());
    }
}

#[test]
fn a_swap_before_the_first_tick_waits_for_it() {
    // Asked as early as it may be.
    let system = System::new("");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    until("the door", || !system.ps().is_empty());
    let report = system.swap(&["course", "angles"]);
    assert_eq!((&report["outcome"], &report["lost"]), (&"committed".into(), &0.into()), "{report}");
    system.all_run();
    system.assert_ends_undisturbed(running, &out, "");

    // Of a source that is silent for longer than any step of a swap may take.
    let system = System::new("[ingest]\nsource = \"bus\"\n[ingest.bus]\nrate_hz = 200");
    let running = system.start(&[]);
    until("every service", || system.ps().iter().filter(|one| one["state"] == "ready").count() == 5);
    let mut asking = plumb(&["swap", "fuser", "vqf", "--json", "--system", &system.name]);
    let mut asking = asking.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    std::thread::sleep(Duration::from_secs(2));
    assert!(asking.try_wait().unwrap().is_none(), "it was answered before there was a tick");
    let bus = Bus::join(&SystemName::new(&system.name).unwrap(), "test").unwrap();
    let sensor: Publisher<SensorReading> = bus.publisher(400).unwrap();
    let mut count = 0;
    until("the answer", || {
        count += 1;
        let reading = SensorReading {
            t_sensor_ns: count * 5_000_000,
            rate_rad_s: [0.0; 3],
            force_m_s2: [0.0, 0.0, 9.8],
            field_ut: [f64::NAN; 3],
        };
        sensor.send(&reading).unwrap();
        sensor.wake();
        asking.try_wait().unwrap().is_some()
    });
    let report: Value = serde_json::from_slice(&asking.wait_with_output().unwrap().stdout).unwrap();
    assert_eq!((&report["outcome"], &report["lost"]), (&"committed".into(), &0.into()), "{report}");
    drop((sensor, bus));
    ended(running).assert_whole();
}
