//! Stages of the user's own, as `plumb stage new` writes them: swapped in and out of a running system, killed, frozen, judged.
use std::{
    fs::{self, File},
    path::{Path, PathBuf},
    process::Command,
};

use crate::common::{Running, System, attitudes, signal, until};
use rustix::{
    fs::{FlockOperation, flock},
    process::Signal,
};
use serde_json::Value;

/// A Python with iceoryx2, made once for all tests; `None`, said, where it cannot be had.
fn python() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("own-stage-venv");
    let (ready, python) = (folder.join("ready"), folder.join("bin/python"));
    let lock = File::create(folder.with_extension("lock")).unwrap();
    flock(&lock, FlockOperation::LockExclusive).unwrap();
    if ready.exists() {
        return Some(python);
    }
    let requirements = concat!(env!("CARGO_MANIFEST_DIR"), "/crates/own_stage/templates/python/requirements.txt");
    let mut make = Command::new("python3");
    make.args(["-m", "venv", "--clear"]).arg(&folder);
    let mut install = Command::new(&python);
    install.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-r", requirements]);
    for command in [&mut make, &mut install] {
        let said = match command.output() {
            Ok(output) if output.status.success() => continue,
            Ok(output) => String::from_utf8_lossy(&output.stderr).trim_end().to_owned(),
            Err(cause) => cause.to_string(),
        };
        eprintln!("skipped: no Python with iceoryx2: {command:?}: {said}");
        return None;
    }
    File::create(ready).unwrap();
    Some(python)
}

const SIM: &str = "[ingest.sim]\nrate_hz = 200\n";

/// A system with a stage in Python beside its launch file.
fn system_with_stage(python: &Path, rest: &str) -> System {
    let python = python.to_str().unwrap();
    let own = format!("[stages.my-fuser]\nslot = \"fuser\"\ncommand = [{python:?}, \"my-fuser/my_fuser.py\"]\n");
    let system = System::new(&format!("{rest}\n{own}"));
    written("python", &system.path("my-fuser"), &[]);
    system
}

fn written(language: &str, folder: &Path, arguments: &[&str]) {
    written_as("my-fuser", language, folder, arguments);
}

fn written_as(name: &str, language: &str, folder: &Path, arguments: &[&str]) {
    let mut command = crate::common::plumb(&["stage", "new", name, "--lang", language, "--dir"]);
    let output = command.arg(folder).args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

fn ask(system: &System, arguments: &[&str]) -> Value {
    let output = crate::common::plumb(arguments).args(["--json", "--system", &system.name]).output().unwrap();
    serde_json::from_slice(&output.stdout).unwrap_or(Value::Null)
}

/// Exchanges the fuser.
fn swapped(system: &System, to: &str) -> Value {
    exchanged(system, "fuser", to)
}

/// Exchanges what fills a slot. Where the machine is too slow for the change of hands it is taken back with nothing lost, and asked for
/// again.
fn exchanged(system: &System, slot: &str, to: &str) -> Value {
    for _ in 0..20 {
        let report = ask(system, &["swap", slot, to]);
        println!("{report}");
        assert_eq!((report["lost"].as_u64(), report["duplicated"].as_u64()), (Some(0), Some(0)), "{report}");
        if report["outcome"] == "committed" {
            assert_eq!(service(system, slot)["stage"], to);
            return report;
        }
    }
    panic!("{to} never took over");
}

fn service(system: &System, name: &str) -> Value {
    let services = ask(system, &["ps"]);
    services.as_array().and_then(|all| all.iter().find(|one| one["service"] == name).cloned()).unwrap_or_default()
}

fn fuser(system: &System) -> Value {
    service(system, "fuser")
}

fn fuser_pid(system: &System) -> u32 {
    fuser(system)["pid"].as_u64().unwrap() as u32
}

fn started(system: &System, arguments: &[&str]) -> Running {
    let running = system.start(arguments);
    let runs = |one: &Value| one["state"] == "running";
    until("the system to run", || {
        ask(system, &["ps"]).as_array().is_some_and(|all| all.len() == 5 && all.iter().all(runs))
    });
    running
}

/// Ticks of 5 ms, each once and in order.
fn assert_in_order(path: &Path) -> usize {
    let attitudes = attitudes(path);
    crate::common::assert_sound(&attitudes);
    for (tick, (t_s, _)) in attitudes.iter().enumerate() {
        assert!((t_s - tick as f64 * 0.005).abs() < 1e-6, "tick {tick} at {t_s} s");
    }
    attitudes.len()
}

#[test]
fn a_stage_in_python_is_swapped_in_and_out_and_nothing_is_lost() {
    let Some(python) = python() else { return };
    let system = system_with_stage(&python, SIM);
    let out = system.path("out.csv");
    let running = started(&system, &["--out", out.to_str().unwrap()]);
    for (from, to) in [("wz", "my-fuser"), ("my-fuser", "vqf"), ("vqf", "my-fuser"), ("my-fuser", "wz")] {
        let report = swapped(&system, to);
        assert_eq!(report["from"], from, "{report}");
        assert!((0.0..5.0).contains(&report["jump_deg"].as_f64().unwrap()), "{report}");
    }
    let wrong = ask(&system, &["swap", "fuser", "my-fuser", "--set", "gain=3"]);
    assert_eq!(wrong["outcome"], "aborted", "{wrong}");
    running.interrupt();
    let run = running.wait();
    run.assert_whole();
    assert!(run.people.contains("`gain` of my-fuser: no such parameter"), "{}", run.people);
    assert_eq!(assert_in_order(&out) as f64, run.number("/ticks_out"));
    assert_eq!(system.remains(), Vec::<String>::new());
}

/// The bytes that come out of 2000 ticks with the stage in Python, and what people were told.
fn bytes(python: &Path, disturb: impl FnOnce(&System)) -> (Vec<u8>, String) {
    let system = system_with_stage(python, &format!("{SIM}[fuser]\nstage = \"my-fuser\"\n"));
    let out = system.path("out.csv");
    let running = started(&system, &["--for", "10s", "--out", out.to_str().unwrap()]);
    disturb(&system);
    let run = running.wait();
    run.assert_whole();
    assert_eq!(assert_in_order(&out), 2000);
    assert_eq!(system.remains(), Vec::<String>::new());
    (fs::read(out).unwrap(), run.people)
}

#[test]
fn a_stage_in_python_that_is_killed_frozen_or_exchanged_for_itself_changes_no_byte() {
    let Some(python) = python() else { return };
    let (undisturbed, _) = bytes(&python, |_| {});
    let (disturbed, people) = bytes(&python, |system| {
        for how in [Signal::KILL, Signal::STOP] {
            let pid = fuser_pid(system);
            signal(pid, how);
            until("another life", || fuser(system)["state"] == "running" && fuser_pid(system) != pid);
        }
        assert_eq!(fuser(system)["restarts"], 2);
        assert_eq!(swapped(system, "my-fuser")["jump_deg"], 0.0);
    });
    assert!(people.contains("was ended by signal 9") && people.contains("has said nothing for"), "{people}");
    let lines = |bytes: &[u8]| String::from_utf8_lossy(bytes).lines().map(str::to_owned).collect::<Vec<_>>();
    let differing = lines(&undisturbed).into_iter().zip(lines(&disturbed)).find(|(one, other)| one != other);
    assert!(disturbed == undisturbed, "the bytes differ: {differing:?}\n{people}");
}

#[test]
fn a_stage_in_python_that_cannot_live_ends_the_system_where_that_is_configured() {
    let Some(python) = python() else { return };
    let rest =
        format!("{SIM}[fuser]\nstage = \"my-fuser\"\n[restart]\nsettled_s = 60\nlimit = 0\non_limit = \"stop\"\n");
    let system = system_with_stage(&python, &rest);
    let running = started(&system, &[]);
    signal(fuser_pid(&system), Signal::KILL);
    let run = running.wait();
    assert_eq!(run.code, Some(1), "{}", run.people);
    assert!(run.people.contains("was ended by signal 9; the system was stopped"), "{}", run.people);
    assert_eq!(system.remains(), Vec::<String>::new());
}

#[test]
fn a_stage_in_python_tells_its_difference_as_a_shadow() {
    let Some(python) = python() else { return };
    let system = system_with_stage(&python, SIM);
    let running = started(&system, &[]);
    let mut command =
        crate::common::plumb(&["shadow", "fuser", "my-fuser", "--json", "--for", "3", "--system", &system.name]);
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let said = String::from_utf8(output.stdout).unwrap();
    let difference: Value = serde_json::from_str(said.lines().last().unwrap()).unwrap();
    let rms_deg = difference["rms_deg"]["angle"].as_f64().unwrap();
    assert!(difference["ticks"].as_u64() > Some(50) && (1e-6..5.0).contains(&rms_deg), "{difference}");
    running.interrupt();
    running.wait().assert_whole();
}

/// `plumb stage test` of a stage beside its own launch file: whether it passes, and the checks that failed.
fn judged(name: &str, launch: &Path) -> (bool, Vec<String>) {
    let output = crate::common::plumb(&["stage", "test", name, "--json", "--launch"]).arg(launch).output().unwrap();
    let said = String::from_utf8(output.stdout).unwrap();
    let reports: Value = serde_json::from_str(said.lines().last().unwrap()).unwrap();
    let checks = reports[0]["checks"].as_array().unwrap();
    println!("{name}: {} checks", checks.len());
    let failed = checks.iter().filter(|check| check["passed"] == false);
    (output.status.success(), failed.map(|check| check["name"].as_str().unwrap().to_owned()).collect())
}

#[test]
fn a_new_stage_in_python_passes_its_own_tests_and_is_judged_sound_in_every_slot() {
    let Some(python) = python() else { return };
    let parent = tempfile::tempdir().unwrap();
    for slot in ["gyro", "accel", "fuser", "course"] {
        let (name, folder) = (format!("my-{slot}"), parent.path().join(slot));
        written_as(&name, "python", &folder, &["--slot", slot]);
        let output = Command::new(&python).args(["-m", "unittest"]).current_dir(&folder).output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success() && said.contains("OK"), "{said}");
        std::os::unix::fs::symlink(python.parent().unwrap().parent().unwrap(), folder.join(".venv")).unwrap();
        assert_eq!(judged(&name, &folder.join("launch.toml")), (true, Vec::new()), "{name}");
        let mut again = crate::common::plumb(&["stage", "new", &name, "--lang", "python", "--dir"]);
        assert_eq!(again.arg(&folder).output().unwrap().status.code(), Some(2), "what is there is left as it is");
    }
}

#[test]
fn a_bad_stage_in_python_fails_the_checks_that_are_made_for_its_mistakes() {
    let Some(python) = python() else { return };
    let system = system_with_stage(&python, "");
    let change = |file: &str, from: &str, to: &str| {
        let path = system.path("my-fuser").join(file);
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.contains(from), "{file}: {from}");
        fs::write(path, text.replace(from, to)).unwrap();
    };
    // It forgets its heading, divides nothing by nothing without an inclination, and goes on when another owns the slot.
    change("my_fuser.py", "= attitude, started > 0.5", "= plumbline.Attitude(attitude.up), started > 0.5");
    change(
        "my_fuser.py",
        "return plumbline.Fused(",
        "return plumbline.Fused(bias_rad_s=(0.0 if input.inclination else math.nan,) * 3, attitude=",
    );
    change("my_fuser.py", "attitude=self.attitude, rate_rad_s,", "attitude=self.attitude, rate_rad_s=rate_rad_s,");
    change("plumbline/rules.py", "if term is None or not term[2]:", "if term is None:");
    let (passed, failed) = judged("my-fuser", &system.path("launch.toml"));
    assert!(!passed);
    for check in [
        "a run goes on from a checkpoint bit for bit",
        "outputs are finite and rotations under free fall",
        "it publishes nothing but what it owns",
    ] {
        assert!(failed.iter().any(|failed| failed == check), "{check} passed; failed: {failed:?}");
    }
    assert!(failed.len() < 10, "{failed:?}");
}

#[test]
fn a_stage_that_talks_without_end_is_not_held_up_and_its_last_words_are_shown() {
    let own = format!("[stages.talks]\nslot = \"course\"\ncommand = [{:?}, \"talks\"]\n", crate::common::faulty());
    let system = System::new(&format!("{SIM}[course]\nstage = \"talks\"\n{own}"));
    let out = system.path("out.csv");
    let running = started(&system, &["--out", out.to_str().unwrap()]);
    let course = || service(&system, "course");
    // More than any pipe holds: 1 MiB at once, and 4 KiB with each tick.
    until("400 ticks", || course()["ticks"].as_u64() > Some(400));
    let first = course();
    assert_eq!(first["restarts"], 0, "{first}");
    signal(first["pid"].as_u64().unwrap() as u32, Signal::KILL);
    until("another life", || course()["restarts"] == 1 && course()["state"] == "running");
    running.interrupt();
    let run = running.wait();
    run.assert_whole();
    assert!(run.people.contains("bytes are left out)\nxxx"), "{}", run.people);
    assert_eq!(assert_in_order(&out) as f64, run.number("/ticks_out"));
    assert_eq!(system.remains(), Vec::<String>::new());
}

#[test]
fn what_no_program_can_do_is_said() {
    let launch = format!("{SIM}[fuser]\nstage = \"mine\"\n[stages.mine]\nslot = \"fuser\"\n");
    let system = System::new(&format!("{launch}command = [\"/nowhere/mine\"]\n"));
    let run = system.run(&[]);
    assert_eq!(run.code, Some(3), "{}", run.people);
    assert!(run.people.contains("there is no file /nowhere/mine"), "{}", run.people);
    let system = System::new(&format!("{launch}command = [\"no-such-program\", \"x\"]\n"));
    let run = system.run(&["--in-process"]);
    assert!(run.people.contains("`mine` is a program of its own"), "{}", run.people);
    let run = system.run(&[]);
    assert_eq!(run.code, Some(1), "{}", run.people);
    assert!(run.people.contains("starting the service fuser (no-such-program x): No such file"), "{}", run.people);
    let system = System::new(&format!(
        "{launch}command = [\"sh\", \"-c\", \"echo I cannot >&2; exit 3\"]\n[restart]\nlimit = 1"
    ));
    let run = system.run(&[]);
    assert_eq!(run.code, Some(1), "{}", run.people);
    assert!(run.people.contains("ended with code 3") && run.people.contains("I cannot"), "{}", run.people);
    let output = crate::common::plumb(&["stage", "new", "My Fuser", "--lang", "python"]).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
}

#[test]
fn a_new_stage_in_rust_builds_conforms_and_is_swapped_in_and_out_in_every_slot() {
    const SLOTS: [(&str, &str); 4] =
        [("gyro", "mobius"), ("accel", "projector"), ("fuser", "wz"), ("course", "angles")];
    let stage = |slot: &str| format!("[stages.my-{slot}]\nslot = \"{slot}\"\ncommand = [\"./my-{slot}-program\"]\n");
    let system = System::new(&SLOTS.map(|(slot, _)| stage(slot)).concat());
    let source = env!("CARGO_MANIFEST_DIR");
    // What was built for this test is not built again, as far as it is the same.
    let target = Path::new(env!("CARGO_BIN_EXE_plumb")).parent().unwrap().parent().unwrap();
    for (slot, _) in SLOTS {
        let name = format!("my-{slot}");
        let folder = system.path(&name);
        written_as(&name, "rust", &folder, &["--slot", slot, "--source", source]);
        fs::copy(Path::new(source).join("Cargo.lock"), folder.join("Cargo.lock")).unwrap();
        for verb in ["test", "build"] {
            let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
            command.args([verb, "--release", "--offline"]).current_dir(&folder).env("CARGO_TARGET_DIR", target);
            let output = command.output().unwrap();
            let said = [output.stdout, output.stderr].map(|said| String::from_utf8_lossy(&said).into_owned()).concat();
            assert!(output.status.success() && !said.contains("warning"), "{said}");
        }
        fs::copy(target.join("release").join(&name), system.path(&format!("{name}-program"))).unwrap();
    }
    let running = started(&system, &[]);
    for (slot, ours) in SLOTS {
        let name = format!("my-{slot}");
        assert_eq!(judged(&name, &system.path("launch.toml")), (true, Vec::new()), "{name}");
        exchanged(&system, slot, &format!("my-{slot}"));
        exchanged(&system, slot, ours);
    }
    running.interrupt();
    running.wait().assert_whole();
    assert_eq!(system.remains(), Vec::<String>::new());
}
