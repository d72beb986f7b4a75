//! Replays of recorded flights yield the same bytes as the flights.
//!
//! The recording contains the readings, the swaps and the initial state.
use std::{
    fs,
    path::{Path, PathBuf},
    process::{Child, Stdio},
};

use super::removed_files;
use crate::common::{Run, Running, System, plumb, signal, wait_for};
use rustix::process::Signal;
use serde_json::Value;

/// Launch file with all sensors, some of them with injected faults.
const LAUNCH: &str = "faults = true\n[ingest.sim]\nscenario = \"cruise\"\nrate_hz = 500\nseed = 3\n\
    [[ingest.fault]]\nsensor = \"gyro\"\nkind = \"off\"\nfrom_s = 1.0\nuntil_s = 1.3\n\
    [[ingest.fault]]\nsensor = \"all\"\nkind = \"intermittent\"\nshare = 0.7\nseed = 5\nfrom_s = 2.0\nuntil_s = 2.5\n\
    [[ingest.fault]]\nsensor = \"accel\"\nkind = \"garbage\"\nseed = 9\nfrom_s = 4.0\nuntil_s = 4.4\n";

struct RecordedFlight {
    out: PathBuf,
    flight: PathBuf,
    run: Run,
}

impl RecordedFlight {
    fn start(system: &System, arguments: &[&str]) -> (Running, PathBuf) {
        let (flights, out) = (system.path("flights"), system.path("out.csv"));
        let record = ["--record", flights.to_str().unwrap(), "--out", out.to_str().unwrap()];
        let running = system.start(&[&record, arguments].concat());
        system.wait_until_running();
        (running, flights)
    }

    fn stop(system: &System, running: Running, flights: &Path) -> Self {
        running.interrupt();
        let run = running.wait();
        let files: Vec<_> = fs::read_dir(flights).unwrap().map(|entry| entry.unwrap().path()).collect();
        assert_eq!(files.len(), 1, "{}", run.stderr);
        Self { out: system.path("out.csv"), flight: files[0].clone(), run }
    }

    /// Returns `true` if nothing was lost and the replay does not warn that its output may differ.
    ///
    /// A flight may be inexact if the machine stalls for seconds, because the recorder then misses
    /// messages and swaps are aborted.
    fn is_exact(&self) -> bool {
        let replay = self.replay(&[]);
        let is_inexact = replay.stderr.contains("may differ from the flight");
        let is_exact = self.run.code == Some(0) && !is_inexact;
        if !is_exact {
            println!("{}{}", self.run.stderr, replay.stderr);
        }
        is_exact
    }

    fn replay(&self, arguments: &[&str]) -> Run {
        let folder = tempfile::tempdir().unwrap();
        let options = ["up", "--speed", "max", "--json", "--replay", self.flight.to_str().unwrap()];
        let mut command = plumb(&[&options, arguments].concat());
        command.current_dir(folder.path());
        Run::from_output(command.output().unwrap())
    }

    /// Replays the flight without a launch file and compares the outputs.
    fn assert_replay_is_identical(&self) -> Run {
        let folder = tempfile::tempdir().unwrap();
        let replay = folder.path().join("replay.csv");
        let run = self.replay(&["--out", replay.to_str().unwrap()]);
        run.assert_complete();
        let [flown, replay] = [&self.out, &replay].map(|path| fs::read_to_string(path).unwrap());
        let lines = || flown.lines().zip(replay.lines()).enumerate();
        let first = lines().find(|(_, (flown, replay))| flown != replay);
        assert_eq!(first, None, "{}\n{}", self.run.stderr, run.stderr);
        assert_eq!(flown.len(), replay.len());
        assert_eq!(self.run.line("digest"), run.line("digest"), "{}", run.stderr);
        run
    }
}

/// Starts a shadow and waits until it reports a difference.
fn start_shadow(system: &System, slot: &str, stage: &str) -> Child {
    let report = system.path(&format!("shadow-{stage}"));
    let mut command = plumb(&["shadow", "--json", "--system", &system.name, slot, stage]);
    let child = command.stdout(fs::File::create(&report).unwrap()).stderr(Stdio::null()).spawn().unwrap();
    wait_for("the shadow to report its difference", || fs::metadata(&report).unwrap().len() > 0);
    child
}

/// Kills the process that owns the slot and waits for its restart.
///
/// After a swap the previous owner may still be exiting, so the process id is taken from `plumb
/// ps`.
fn kill_and_wait(system: &System, service: &str) {
    let status = || system.ps().into_iter().find(|one| one["service"] == service).unwrap_or_default();
    let before = status();
    signal(before["pid"].as_u64().unwrap() as u32, Signal::KILL);
    wait_for("a restart", || status()["restarts"].as_u64() > before["restarts"].as_u64());
    system.wait_until_running();
}

fn assert_committed(system: &System, arguments: &[&str]) {
    let report = system.swap(arguments);
    assert_eq!((&report["outcome"], &report["lost"]), (&"committed".into(), &0.into()), "{report}");
}

/// Kills every service and swaps all slots. The swaps include a swap back, a promoted shadow and a
/// cancelled shadow.
fn disturb(system: &System) {
    kill_and_wait(system, "fuser");
    assert_committed(system, &["fuser", "aided"]);
    kill_and_wait(system, "ingest");
    assert_committed(system, &["gyro", "rk4"]);
    kill_and_wait(system, "gyro");
    let mut cancelled = start_shadow(system, "fuser", "madgwick");
    signal(cancelled.id(), Signal::INT);
    cancelled.wait().unwrap();
    assert_committed(system, &["fuser", "wz"]);
    let mut promoted = start_shadow(system, "accel", "inclinometer-matrix");
    assert_committed(system, &["accel", "inclinometer-matrix"]);
    promoted.wait().unwrap();
    kill_and_wait(system, "accel");
    assert_committed(system, &["course", "track"]);
    kill_and_wait(system, "course");
    assert_committed(system, &["gyro", "mobius"]);
}

/// Records flights until one is complete and can be replayed exactly.
fn record_exact_flight(
    launch: &str,
    arguments: &[&str],
    disturb: impl Fn(&System, &Running),
) -> (RecordedFlight, System) {
    let fly = || {
        let system = System::new(launch);
        let (running, flights) = RecordedFlight::start(&system, arguments);
        disturb(&system, &running);
        (RecordedFlight::stop(&system, running, &flights), system)
    };
    (0..5).map(|_| fly()).find(|(flown, _)| flown.is_exact()).expect("the machine stalled in every flight")
}

#[test]
fn live_flight_with_disturbances_replays_identically() {
    let (flown, _system) = record_exact_flight(LAUNCH, &[], |system, _| disturb(system));
    flown.assert_replay_is_identical();
}

#[test]
fn lockstep_flight_with_disturbances_replays_identically() {
    let (flown, _system) = record_exact_flight(LAUNCH, &["--speed", "3"], |system, _| disturb(system));
    flown.assert_replay_is_identical();
}

#[test]
fn warm_started_flight_replays_from_its_initial_state() {
    let state = tempfile::tempdir().unwrap();
    let file = state.path().join("state");
    let launch = format!("state_file = {file:?}\n[ingest.sim]\nscenario = \"s1\"\nrate_hz = 500\n");
    let system = System::new(&launch);
    let running = system.start(&[]);
    wait_for("the state file", || file.exists());
    running.interrupt();
    running.wait().assert_complete();
    let (flown, _system) = record_exact_flight(&launch, &[], |_, _| ());
    flown.run.line("warm start");
    flown.assert_replay_is_identical();
}

#[test]
fn flight_with_removed_files_replays_identically() {
    let (flown, _system) = record_exact_flight(LAUNCH, &[], |system, running| {
        let before = running.all_services();
        removed_files::remove(&removed_files::files(system, ""));
        signal(running.service("fuser"), Signal::KILL);
        wait_for("all services to restart", || {
            running.services().iter().filter(|service| !before.contains(service)).count() == 5
        });
        system.wait_until_running();
        assert_committed(system, &["fuser", "vqf"]);
    });
    assert_eq!(flown.run.stderr.matches("restarting every service").count(), 1, "{}", flown.run.stderr);
    flown.assert_replay_is_identical();
}

#[test]
fn replay_warns_about_ticks_without_owner() {
    let rule = "[restart]\nmin_uptime_s = 60\nlimit = 0\non_limit = \"degrade\"\n";
    let system = System::new(&format!("lateness_s = 0.3\n{LAUNCH}{rule}"));
    let (running, flights) = RecordedFlight::start(&system, &[]);
    signal(running.service("course"), Signal::KILL);
    let has_failed = |one: &Value| one["service"] == "course" && one["state"] == "failed";
    wait_for("the slot to fail", || system.ps().iter().any(has_failed));
    let report = system.swap(&["course", "track"]);
    assert_eq!(report["outcome"], "committed", "{report}");
    let replay = RecordedFlight::stop(&system, running, &flights).replay(&[]);
    let warning = "the replayed attitude may differ from the flight: the slot `course` had no owner";
    assert!(replay.stderr.contains(warning), "{}", replay.stderr);
}
