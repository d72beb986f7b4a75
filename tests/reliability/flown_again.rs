//! A flight that is flown again gives the bytes of the flight: readings, swaps and what it began with come from its recording.
use std::{
    fs,
    path::{Path, PathBuf},
    process::{Child, Stdio},
};

use super::damage;
use crate::common::{Run, Running, System, plumb, signal, until};
use rustix::process::Signal;
use serde_json::Value;

/// Sensors of every kind, and faults of some.
const LAUNCH: &str = "faults = true\n[ingest.sim]\nscenario = \"cruise\"\nrate_hz = 500\nseed = 3\n\
    [[ingest.fault]]\nsensor = \"gyro\"\nkind = \"off\"\nfrom_s = 1.0\nuntil_s = 1.3\n\
    [[ingest.fault]]\nsensor = \"all\"\nkind = \"intermittent\"\nshare = 0.7\nseed = 5\nfrom_s = 2.0\nuntil_s = 2.5\n\
    [[ingest.fault]]\nsensor = \"accel\"\nkind = \"garbage\"\nseed = 9\nfrom_s = 4.0\nuntil_s = 4.4\n";

struct Flown {
    out: PathBuf,
    flight: PathBuf,
    run: Run,
}

impl Flown {
    fn begin(system: &System, arguments: &[&str]) -> (Running, PathBuf) {
        let (flights, out) = (system.path("flights"), system.path("out.csv"));
        let own = ["--record", flights.to_str().unwrap(), "--out", out.to_str().unwrap()];
        let running = system.start(&[&own, arguments].concat());
        system.all_run();
        (running, flights)
    }

    fn end(system: &System, running: Running, flights: &Path) -> Self {
        running.interrupt();
        let run = running.wait();
        let files: Vec<_> = fs::read_dir(flights).unwrap().map(|entry| entry.unwrap().path()).collect();
        assert_eq!(files.len(), 1, "{}", run.people);
        Self { out: system.path("out.csv"), flight: files[0].clone(), run }
    }

    /// Nothing was lost, and nothing told that it may be flown again otherwise. On a machine that stands still for seconds the recorder misses
    /// messages, and swaps are taken back.
    fn is_certain(&self) -> bool {
        let again = self.again(&[]);
        let doubts = again.people.contains("may differ from the flight");
        let whole = self.run.code == Some(0) && !doubts;
        if !whole {
            println!("{}{}", self.run.people, again.people);
        }
        whole
    }

    fn again(&self, arguments: &[&str]) -> Run {
        let folder = tempfile::tempdir().unwrap();
        let own = ["up", "--speed", "max", "--json", "--replay", self.flight.to_str().unwrap()];
        let mut command = plumb(&[&own, arguments].concat());
        command.current_dir(folder.path());
        Run::of(command.output().unwrap())
    }

    /// Flies it again without its launch file.
    fn assert_same_again(&self) -> Run {
        let folder = tempfile::tempdir().unwrap();
        let again = folder.path().join("again.csv");
        let run = self.again(&["--out", again.to_str().unwrap()]);
        run.assert_whole();
        let [flown, again] = [&self.out, &again].map(|path| fs::read_to_string(path).unwrap());
        let lines = || flown.lines().zip(again.lines()).enumerate();
        let first = lines().find(|(_, (flown, again))| flown != again);
        assert_eq!(first, None, "{}\n{}", self.run.people, run.people);
        assert_eq!(flown.len(), again.len());
        assert_eq!(self.run.line("digest"), run.line("digest"), "{}", run.people);
        run
    }
}

/// Starts a shadow, which computes when this returns.
fn shadow(system: &System, slot: &str, stage: &str) -> Child {
    let said = system.path(&format!("shadow-{stage}"));
    let mut command = plumb(&["shadow", "--json", "--system", &system.name, slot, stage]);
    let child = command.stdout(fs::File::create(&said).unwrap()).stderr(Stdio::null()).spawn().unwrap();
    until("the shadow to say how far it is", || fs::metadata(&said).unwrap().len() > 0);
    child
}

/// Kills the process that owns the slot; the one before may still be on its way out after a swap.
fn kill(system: &System, service: &str) {
    let own = || system.ps().into_iter().find(|one| one["service"] == service).unwrap_or_default();
    let before = own();
    signal(before["pid"].as_u64().unwrap() as u32, Signal::KILL);
    until("a restart", || own()["restarts"].as_u64() > before["restarts"].as_u64());
    system.all_run();
}

fn committed(system: &System, arguments: &[&str]) {
    let report = system.swap(arguments);
    assert_eq!((&report["outcome"], &report["lost"]), (&"committed".into(), &0.into()), "{report}");
}

/// Swaps of all slots, one taken back and one refused, a shadow promoted and one cancelled, and a kill of each service.
fn disturb(system: &System) {
    kill(system, "fuser");
    committed(system, &["fuser", "aided"]);
    kill(system, "ingest");
    committed(system, &["gyro", "rk4"]);
    kill(system, "gyro");
    let mut cancelled = shadow(system, "fuser", "madgwick");
    signal(cancelled.id(), Signal::INT);
    cancelled.wait().unwrap();
    committed(system, &["fuser", "wz"]);
    let mut promoted = shadow(system, "accel", "inclinometer-matrix");
    committed(system, &["accel", "inclinometer-matrix"]);
    promoted.wait().unwrap();
    kill(system, "accel");
    committed(system, &["course", "track"]);
    kill(system, "course");
    committed(system, &["gyro", "mobius"]);
}

/// A flight of which nothing was missed and nothing is in doubt.
fn certain(launch: &str, arguments: &[&str], disturb: impl Fn(&System, &Running)) -> (Flown, System) {
    let fly = || {
        let system = System::new(launch);
        let (running, flights) = Flown::begin(&system, arguments);
        disturb(&system, &running);
        (Flown::end(&system, running, &flights), system)
    };
    (0..5).map(|_| fly()).find(|(flown, _)| flown.is_certain()).expect("the machine to go on for the time of a flight")
}

#[test]
fn a_live_flight_with_kills_swaps_and_faults_is_flown_again_to_the_same_bytes() {
    let (flown, _system) = certain(LAUNCH, &[], |system, _| disturb(system));
    flown.assert_same_again();
}

#[test]
fn a_flight_in_lockstep_with_kills_swaps_and_faults_is_flown_again_to_the_same_bytes() {
    let (flown, _system) = certain(LAUNCH, &["--speed", "3"], |system, _| disturb(system));
    flown.assert_same_again();
}

#[test]
fn a_flight_after_a_warm_start_begins_again_with_what_it_had() {
    let state = tempfile::tempdir().unwrap();
    let file = state.path().join("state");
    let launch = format!("state_file = {file:?}\n[ingest.sim]\nscenario = \"s1\"\nrate_hz = 500\n");
    let system = System::new(&launch);
    let running = system.start(&[]);
    until("something to be known of the sensors", || file.exists());
    running.interrupt();
    running.wait().assert_whole();
    let (flown, _system) = certain(&launch, &[], |_, _| ());
    flown.run.line("warm start");
    flown.assert_same_again();
}

#[test]
fn a_flight_whose_files_were_removed_in_flight_is_flown_again_to_the_same_bytes() {
    let (flown, _system) = certain(LAUNCH, &[], |system, running| {
        let before = running.all_services();
        damage::remove(&damage::files(system, ""));
        signal(running.service("fuser"), Signal::KILL);
        until("everybody to start anew", || {
            running.services().iter().filter(|service| !before.contains(service)).count() == 5
        });
        system.all_run();
        committed(system, &["fuser", "vqf"]);
    });
    assert_eq!(flown.run.people.matches("restarting every service").count(), 1, "{}", flown.run.people);
    flown.assert_same_again();
}

#[test]
fn of_a_flight_in_which_a_slot_was_nobodys_it_is_told_from_which_tick_on_it_may_differ() {
    let rule = "[restart]\nmin_uptime_s = 60\nlimit = 0\non_limit = \"degrade\"\n";
    let system = System::new(&format!("lateness_s = 0.3\n{LAUNCH}{rule}"));
    let (running, flights) = Flown::begin(&system, &[]);
    signal(running.service("course"), Signal::KILL);
    let is_left = |one: &Value| one["service"] == "course" && one["state"] == "failed";
    until("the slot to be left", || system.ps().iter().any(is_left));
    let report = system.swap(&["course", "track"]);
    assert_eq!(report["outcome"], "committed", "{report}");
    let again = Flown::end(&system, running, &flights).again(&[]);
    let told = "the replayed attitude may differ from the flight: the slot `course` had no owner";
    assert!(again.people.contains(told), "{}", again.people);
}
