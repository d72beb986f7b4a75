//! User-defined stages as written by `plumb stage new`: swapped in and out, killed, frozen and
//! tested.
use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
    thread,
};

use crate::common::{
    Running, System, attitudes, children_of, copy_program, faulty_executable, plumb, signal, wait_for,
};
use rustix::process::Signal;
use serde_json::Value;

const SIM: &str = "[ingest.sim]\nrate_hz = 200\n";
const SLOTS: [(&str, &str); 4] =
    [("gyro", "mobius"), ("accel", "projector"), ("fuser", "multiple-model"), ("course", "angles")];

fn write_stage(name: &str, language: &str, folder: &Path, arguments: &[&str]) {
    let mut command = plumb(&["stage", "new", name, "--lang", language, "--dir"]);
    let output = command.arg(folder).args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Writes a stage and compiles it if necessary. Returns its command as written in the launch file.
fn build_stage(system: &System, name: &str, compiler: &str, slot: &str) -> String {
    let folder = system.path(name);
    let module = name.replace('-', "_");
    if compiler == "python3" {
        write_stage(name, "python", &folder, &["--slot", slot]);
        return format!("[\"python3\", \"{name}/{module}.py\"]");
    }
    write_stage(name, "c", &folder, &["--slot", slot]);
    let (language, standard) = if compiler == "cc" { ("c", "-std=c99") } else { ("c++", "-std=c++11") };
    let warnings = ["-Wall", "-Wextra", "-Werror", "-pedantic"];
    let mut command = Command::new(compiler);
    command
        .args(["-O2", standard, "-x", language])
        .args(warnings)
        .args(["-o", name])
        .arg(format!("{module}.c"))
        .arg("-lm");
    let output = command.current_dir(&folder).output().unwrap();
    assert!(output.status.success(), "{compiler}: {}", String::from_utf8_lossy(&output.stderr));
    format!("[\"{name}/{name}\"]")
}

/// Creates a system, writes the fuser `my-fuser` to its folder and adds this stage to its launch
/// file.
fn system_with_stage(compiler: &str, rest: &str) -> System {
    let system = System::new("");
    let command = build_stage(&system, "my-fuser", compiler, "fuser");
    system.append_launch(&format!("{rest}\n[stages.my-fuser]\nslot = \"fuser\"\ncommand = {command}\n"));
    system
}

fn query(system: &System, arguments: &[&str]) -> Value {
    let output = plumb(arguments).args(["--json", "--system", &system.name]).output().unwrap();
    serde_json::from_slice(&output.stdout).unwrap_or(Value::Null)
}

/// Swaps the stage of a slot. Repeats the swap if it is aborted because the machine is too slow. An
/// aborted swap must lose no tick.
fn swap_stage(system: &System, slot: &str, to: &str) -> Value {
    for _ in 0..20 {
        let report = query(system, &["swap", slot, to]);
        println!("{report}");
        assert_eq!((report["lost"].as_u64(), report["duplicated"].as_u64()), (Some(0), Some(0)), "{report}");
        if report["outcome"] == "committed" {
            assert_eq!(service(system, slot)["stage"], to);
            return report;
        }
    }
    panic!("{to} did not take over");
}

fn service(system: &System, name: &str) -> Value {
    system.ps().into_iter().find(|one| one["service"] == name).unwrap_or_default()
}

fn pid(system: &System, slot: &str) -> u32 {
    service(system, slot)["pid"].as_u64().unwrap_or(0) as u32
}

fn start_system(system: &System, arguments: &[&str]) -> Running {
    let running = system.start(arguments);
    system.wait_until_running();
    running
}

/// Checks that the ticks are 5 ms apart, complete and in order. Returns their number.
fn assert_in_order(path: &Path) -> usize {
    let attitudes = attitudes(path);
    crate::common::assert_valid_attitudes(&attitudes);
    for (tick, (t_s, _)) in attitudes.iter().enumerate() {
        assert!((t_s - tick as f64 * 0.005).abs() < 1e-6, "tick {tick} at {t_s} s");
    }
    attitudes.len()
}

#[test]
fn stage_in_any_language_swaps_without_loss() {
    for compiler in ["python3", "cc", "c++"] {
        let system = system_with_stage(compiler, SIM);
        let out = system.path("out.csv");
        let running = start_system(&system, &["--out", out.to_str().unwrap()]);
        for (from, to) in
            [("multiple-model", "my-fuser"), ("my-fuser", "vqf"), ("vqf", "my-fuser"), ("my-fuser", "multiple-model")]
        {
            let report = swap_stage(&system, "fuser", to);
            assert_eq!(report["from"], from, "{report}");
            assert!((0.0..5.0).contains(&report["jump_deg"].as_f64().unwrap()), "{report}");
        }
        for wrong in ["gain=3", "time_constant_s=0"] {
            let wrong = query(&system, &["swap", "fuser", "my-fuser", "--set", wrong]);
            assert_eq!(wrong["outcome"], "aborted", "{wrong}");
        }
        running.interrupt();
        let run = running.wait();
        run.assert_complete();
        for text in
            ["unknown parameter; available: time_constant_s", "time_constant_s: expected 0.01 to 1000 s, found 0"]
        {
            assert!(run.stderr.contains(text), "{text}: {}", run.stderr);
        }
        assert_eq!(assert_in_order(&out) as f64, run.number("/ticks_out"));
        assert_eq!(system.leftovers(), Vec::<String>::new());
    }
}

/// Runs a system in which the fuser is the stage built with `compiler`. `arguments` are added to
/// the command line.
///
/// Calls `end`, which may stop the system, and waits for the run to end. Returns the output file,
/// the number of ticks and the messages on standard error.
fn output_bytes(compiler: &str, arguments: &[&str], end: impl FnOnce(&System, &Running)) -> (Vec<u8>, usize, String) {
    let system = system_with_stage(compiler, &format!("{SIM}[fuser]\nstage = \"my-fuser\"\n"));
    let out = system.path("out.csv");
    let running = system.start(&[&["--out", out.to_str().unwrap()], arguments].concat());
    end(&system, &running);
    let run = running.wait();
    run.assert_complete();
    let ticks = assert_in_order(&out);
    assert_eq!(system.leftovers(), Vec::<String>::new());
    (fs::read(out).unwrap(), ticks, run.stderr)
}

#[test]
fn killed_or_frozen_stage_changes_no_byte() {
    thread::scope(|scope| {
        for compiler in ["python3", "cc"] {
            scope.spawn(move || assert_output_unaffected_by_faults(compiler));
        }
    });
}

fn assert_output_unaffected_by_faults(compiler: &str) {
    let (disturbed, ticks, stderr) = output_bytes(compiler, &[], |system, running| {
        system.wait_until_running();
        for (program, how) in [(false, Signal::KILL), (true, Signal::KILL), (false, Signal::STOP), (true, Signal::STOP)]
        {
            let fuser = pid(system, "fuser");
            signal(if program { children_of(fuser)[0] } else { fuser }, how);
            wait_for("another incarnation", || {
                let now = service(system, "fuser");
                now["state"] == "running" && now["pid"] != fuser
            });
        }
        // A busy machine may have caused more restarts.
        assert!(service(system, "fuser")["restarts"].as_u64() >= Some(4));
        assert_eq!(swap_stage(system, "fuser", "my-fuser")["jump_deg"], 0.0);
        running.interrupt();
    });
    let duration = format!("{}ms", 5 * ticks);
    let undisturbed = ["--in-process", "--speed", "max", "--for", &duration];
    let (undisturbed, ..) = output_bytes(compiler, &undisturbed, |_, _| {});
    for text in
        ["was killed by signal 9", "ended with signal: 9 (SIGKILL) on the request", "has reported no health for"]
    {
        assert!(stderr.contains(text), "{text}: {stderr}");
    }
    let lines = |bytes: &[u8]| String::from_utf8_lossy(bytes).lines().map(str::to_owned).collect::<Vec<_>>();
    let differing = lines(&undisturbed).into_iter().zip(lines(&disturbed)).find(|(one, other)| one != other);
    assert!(disturbed == undisturbed, "the bytes differ: {differing:?}\n{stderr}");
}

#[test]
fn program_ends_with_its_service() {
    let system = system_with_stage("cc", &format!("{SIM}[fuser]\nstage = \"my-fuser\"\n"));
    let running = start_system(&system, &[]);
    let mut programs = Vec::new();
    for how in [Signal::KILL, Signal::TERM] {
        let fuser = pid(&system, "fuser");
        programs.push(children_of(fuser)[0]);
        signal(fuser, how);
        wait_for("another incarnation", || {
            ![0, fuser].contains(&pid(&system, "fuser")) && service(&system, "fuser")["state"] == "running"
        });
    }
    programs.push(children_of(pid(&system, "fuser"))[0]);
    running.interrupt();
    running.wait().assert_complete();
    wait_for("no program to be left", || programs.iter().all(|program| !crate::common::is_alive(*program)));
}

#[test]
fn stage_that_missed_input_does_not_take_over() {
    // The topics hold less than a second. A busy machine may delay health messages.
    let system = System::new("buffer_s = 0.7\nlateness_s = 0.3\n");
    let command = build_stage(&system, "my-fuser", "python3", "fuser");
    let launch = "[ingest.sim]\nrate_hz = 400\n[restart]\nsilence_s = 20\n";
    system.append_launch(&format!("{launch}[stages.my-fuser]\nslot = \"fuser\"\ncommand = {command}\n"));
    let program = system.path("my-fuser/my_fuser.py");
    let text = fs::read_to_string(&program).unwrap();
    fs::write(&program, format!("import time\ntime.sleep(2)\n{text}")).unwrap();
    let running = start_system(&system, &[]);
    // A busy machine may abort the swap for another reason.
    wait_for("a swap to be aborted because of missed ticks", || {
        let report = query(&system, &["swap", "fuser", "my-fuser"]);
        println!("{report}");
        assert_eq!(report["outcome"], "aborted", "{report}");
        report["reason"].as_str().is_some_and(|reason| reason.contains("ticks of its input"))
    });
    running.interrupt();
    running.wait().assert_complete();
}

/// Stage program that starts a process in another session and never responds. It writes both
/// process identifiers to a file.
const HUNG_PROGRAM: &str = "\
import os, time
child = os.fork()
if child == 0:
    os.setsid()
else:
    with open('pids', 'a') as file: file.write(f'{os.getpid()} {child} ')
time.sleep(3600)
";

#[test]
fn hung_program_and_its_children_end_with_the_system() {
    let system = System::new(&format!(
        "{SIM}[fuser]\nstage = \"hung\"\n[restart]\nlimit = 100\n\
         [stages.hung]\nslot = \"fuser\"\ncommand = [\"python3\", \"hung.py\"]\n"
    ));
    fs::write(system.path("hung.py"), HUNG_PROGRAM).unwrap();
    let pids = || -> Vec<u32> {
        let text = fs::read_to_string(system.path("pids")).unwrap_or_default();
        text.split_whitespace().map(|pid| pid.parse().unwrap()).collect()
    };
    let running = system.start(&[]);
    // The program of a stage is started twice: first by the supervisor, then by the service.
    wait_for("the service to start the program", || pids().len() >= 4);
    running.interrupt();
    running.wait();
    wait_for("no process to be left", || pids().into_iter().all(|pid| !crate::common::is_alive(pid)));
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn replay_starts_no_program_of_an_untrusted_flight() {
    let system = system_with_stage("python3", &format!("{SIM}[fuser]\nstage = \"my-fuser\"\n"));
    let run = system.run(&["--for", "1s", "--record", system.path("flights").to_str().unwrap()]);
    let flight = fs::read_dir(system.path("flights")).unwrap().next().unwrap().unwrap().path();
    println!("{:?}", run.code);
    let (program, trace) = (system.path("my-fuser/my_fuser.py"), system.path("started"));
    let text = fs::read_to_string(&program).unwrap();
    fs::write(&program, format!("open({:?}, 'w').close()\n{text}", trace.to_str().unwrap())).unwrap();
    let replay = |arguments: &[&str]| {
        let mut command = plumb(&["up", "--speed", "max", "--json", "--replay", flight.to_str().unwrap()]);
        let output = command.args(arguments).current_dir(trace.parent().unwrap()).output().unwrap();
        (output.status.code(), String::from_utf8(output.stderr).unwrap(), trace.exists())
    };
    // `launch.toml` of the current folder is not used either.
    let (code, stderr, started) = replay(&[]);
    assert_eq!((code, started), (Some(2), false), "{stderr}");
    assert!(stderr.contains("`python3 my-fuser/my_fuser.py`") && stderr.contains("--trust-programs"), "{stderr}");
    let (_, stderr, started) = replay(&["--trust-programs"]);
    assert!(started, "{stderr}");
    fs::remove_file(&trace).unwrap();
    let launch = system.path("launch.toml");
    let (_, stderr, started) = replay(&["--launch", launch.to_str().unwrap()]);
    assert!(started, "{stderr}");
}

#[test]
fn external_stage_reports_difference_as_shadow() {
    // The low rate lets a stage in Python keep up on a busy machine.
    let system = system_with_stage("python3", "[ingest.sim]\nrate_hz = 50\n");
    let running = start_system(&system, &[]);
    let shadowed = |seconds: &str| -> Value {
        let arguments = ["shadow", "fuser", "my-fuser", "--json", "--for", seconds, "--system", &system.name];
        let output = plumb(&arguments).output().unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        let last: Value = text.lines().last().and_then(|line| serde_json::from_str(line).ok()).unwrap_or_default();
        println!("{last}");
        // A shadow that is aborted must report the reason and lose no tick.
        let ended = (&last["outcome"], &last["lost"], &last["duplicated"]) == (&"aborted".into(), &0.into(), &0.into());
        assert!(output.status.success() || ended, "{text}{}", String::from_utf8_lossy(&output.stderr));
        last
    };
    // On a busy machine, the program takes longer to start, so the test retries with longer
    // shadows.
    let mut shadows = ["3", "10", "30"].into_iter().map(shadowed);
    let difference = shadows.find(|difference| difference["ticks"].as_u64() > Some(50)).unwrap();
    let rms_deg = difference["rms_deg"]["angle"].as_f64().unwrap();
    assert!((1e-6..5.0).contains(&rms_deg), "{difference}");
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn watch_promotes_external_stage() {
    let near = "promote_below_deg = 20\npromote_after_s = 0.5\nrollback_above_deg = 20.1\nrollback_after_s = 60";
    let watch = format!("[[watch]]\nslot = \"fuser\"\nstage = \"my-fuser\"\nmeasure = \"angle\"\n{near}\n");
    let system = system_with_stage("cc", &format!("{SIM}{watch}"));
    let running = start_system(&system, &[]);
    wait_for("the promotion", || service(&system, "fuser")["stage"] == "my-fuser");
    running.interrupt();
    let run = running.wait();
    run.assert_complete();
    assert!(run.stderr.contains("watch fuser: promoting my-fuser"), "{}", run.stderr);
}

/// Returns the inclination error of each requested fuser, degrees.
fn inclination_errors_deg(system: &System, arguments: &[&str]) -> Vec<f64> {
    let launch = system.path("launch.toml");
    let mut command = plumb(&["score", "sim:s1?duration_s=30", "--json", "--launch", launch.to_str().unwrap()]);
    let output = command.args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let scores: Value = serde_json::from_slice(&output.stdout).unwrap();
    let stages = scores["stages"].as_array().unwrap();
    stages.iter().map(|stage| stage["mean"]["inclination"].as_f64().unwrap()).collect()
}

#[test]
fn templates_in_all_languages_score_equally() {
    let [python, c] = ["python3", "cc"].map(|compiler| system_with_stage(compiler, SIM));
    let arguments = ["--fuser", "wz", "--fuser", "my-fuser", "--set", "my-fuser.time_constant_s=3"];
    let (of_python, of_c) = (inclination_errors_deg(&python, &arguments), inclination_errors_deg(&c, &arguments));
    assert!((of_python[1] - of_c[1]).abs() < 1e-9 && of_python[0] == of_c[0], "{of_python:?} {of_c:?}");
    assert_ne!(inclination_errors_deg(&c, &["--fuser", "my-fuser"])[0], of_c[1]);
    for system in [&python, &c] {
        let mut command = plumb(&["score", "sim:s1?duration_s=2", "--json", "--fuser", "my-fuser", "--launch"]);
        let output = command.arg(system.path("launch.toml")).output().unwrap();
        let scores: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert!(scores["stages"][0]["ns_per_update"].as_f64().is_some_and(|ns| ns > 100.0), "{scores}");
    }
    // Four seconds are enough for only some of the checks in each group.
    let mut short = plumb(&["stage", "test", "my-fuser", "--for", "4s", "--json", "--launch"]);
    let short = short.arg(python.path("launch.toml")).output().unwrap();
    let reports: Value = serde_json::from_slice(&short.stdout).unwrap();
    let left_out = reports["reports"][0]["left_out"].as_array().unwrap();
    assert!(left_out.len() >= 3 && left_out.iter().all(|part| part["count"].as_u64() > Some(0)), "{reports}");
    let stderr = String::from_utf8_lossy(&short.stderr);
    assert!(short.status.success() && stderr.contains("to run all: --complete"), "{stderr}{reports}");
    let list = plumb(&["stage", "list", "--launch"]).arg(c.path("launch.toml")).output().unwrap();
    let list = String::from_utf8(list.stdout).unwrap();
    assert!(list.contains("  my-fuser\n    time_constant_s: 0.01 to 1000 s, default 1. Time constant"), "{list}");
}

/// Runs `plumb stage test`. Returns `true` if the stage passed, and the names of the failed checks.
fn test_stage(name: &str, launch: &Path) -> (bool, Vec<String>) {
    let output = plumb(&["stage", "test", name, "--complete", "--json", "--launch"]).arg(launch).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    let reports: Value = serde_json::from_str(text.lines().last().unwrap_or_default())
        .unwrap_or_else(|_| panic!("{}", String::from_utf8_lossy(&output.stderr)));
    let checks = reports["reports"][0]["checks"].as_array().unwrap();
    println!("{name}: {} checks", checks.len());
    let failed = checks.iter().filter(|check| check["passed"] == false);
    (output.status.success(), failed.map(|check| check["name"].as_str().unwrap().to_owned()).collect())
}

#[test]
#[ignore = "long: all conformance checks four times, each tick in another process"]
fn new_c_stage_conforms_in_every_slot() {
    let system = System::new("");
    for (slot, _) in SLOTS {
        let name = format!("my-{slot}");
        let command = build_stage(&system, &name, "cc", slot);
        system.append_launch(&format!("[stages.{name}]\nslot = \"{slot}\"\ncommand = {command}\n"));
    }
    for (slot, _) in SLOTS {
        let result = test_stage(&format!("my-{slot}"), &system.path("launch.toml"));
        assert_eq!(result, (true, Vec::new()), "{slot}");
    }
}

#[test]
fn new_python_stage_passes_its_tests_in_every_slot() {
    let parent = tempfile::tempdir().unwrap();
    for (slot, _) in SLOTS {
        let (name, folder) = (format!("my-{slot}"), parent.path().join(slot));
        write_stage(&name, "python", &folder, &["--slot", slot]);
        let output = Command::new("python3").args(["-m", "unittest"]).current_dir(&folder).output().unwrap();
        let text = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success() && text.contains("OK"), "{text}");
        let mut again = plumb(&["stage", "new", &name, "--lang", "python", "--dir"]);
        assert_eq!(again.arg(&folder).output().unwrap().status.code(), Some(2), "existing folder is not overwritten");
    }
}

#[test]
fn stage_with_defects_fails_their_checks() {
    let system = system_with_stage("cc", "");
    let path = system.path("my-fuser/my_fuser.c");
    let mut text = fs::read_to_string(&path).unwrap();
    // The first change makes the stage keep a value outside its state. The second makes the output
    // NaN if the input has no inclination.
    for (from, to) in [
        (
            "state.attitude = plumbline_rotated(",
            "static double ticks; state.attitude.z_rad += 1e-9 * ticks++; state.attitude = plumbline_rotated(",
        ),
        (
            "output->attitude = state.attitude;",
            "output->attitude = state.attitude; output->bias_rad_s[0] = input->has_inclination ? 0.0 : NAN;",
        ),
    ] {
        assert!(text.contains(from), "{from}");
        text = text.replace(from, to);
    }
    fs::write(&path, text).unwrap();
    let compile = ["-O2", "-o", "my-fuser", "my_fuser.c", "-lm"];
    assert!(Command::new("cc").args(compile).current_dir(system.path("my-fuser")).status().unwrap().success());
    let (passed, failed) = test_stage("my-fuser", &system.path("launch.toml"));
    assert!(!passed);
    for check in ["a restored run is bit-identical", "outputs are valid under accelerometer outage"] {
        assert!(failed.iter().any(|failed| failed == check), "{check} passed; failed: {failed:?}");
    }
}

/// Creates a system with a faulty external course stage.
fn system_with_fault(fault: &str, rest: &str) -> System {
    let own =
        format!("[stages.own]\nslot = \"course\"\ncommand = [{:?}, \"hosted\", {fault:?}]\n", faulty_executable());
    System::new(&format!("{SIM}[course]\nstage = \"own\"\n{own}{rest}"))
}

#[test]
fn endless_output_is_drained_and_its_end_shown() {
    let system = system_with_fault("prints-endlessly", "");
    let out = system.path("out.csv");
    let running = start_system(&system, &["--out", out.to_str().unwrap()]);
    let course = || service(&system, "course");
    // The stage writes more than a pipe can hold: 1 MiB at one step and 4 KiB at every other step.
    wait_for("400 ticks", || course()["ticks"].as_u64() > Some(400));
    let first = course();
    assert_eq!(first["restarts"], 0, "{first}");
    signal(pid(&system, "course"), Signal::KILL);
    wait_for("another incarnation", || course()["restarts"] == 1 && course()["state"] == "running");
    running.interrupt();
    let run = running.wait();
    run.assert_complete();
    assert!(run.stderr.contains("earlier bytes omitted)\n") && run.stderr.contains("xxx"), "{}", run.stderr);
    assert_eq!(assert_in_order(&out) as f64, run.number("/ticks_out"));
}

#[test]
fn invalid_output_resets_stage_and_is_flagged() {
    let run = system_with_fault("gives-nan", "").run(&["--for", "2s"]);
    run.assert_complete();
    assert!(run.line("flags").contains("reset"), "{}", run.stderr);
}

#[test]
fn errors_of_python_stage_are_printed_up_to_a_limit() {
    let system = system_with_stage("python3", &format!("{SIM}[fuser]\nstage = \"my-fuser\"\n"));
    let path = system.path("my-fuser/my_fuser.py");
    let text = fs::read_to_string(&path).unwrap();
    let line = "        attitude, started = self.state\n";
    assert!(text.contains(line));
    let failure = "        if started:\n            raise RuntimeError(\"on purpose\")\n";
    fs::write(&path, text.replace(line, &format!("{line}{failure}"))).unwrap();
    let run = system.run(&["--in-process", "--for", "2s"]);
    assert!(run.line("flags").contains("reset"), "{}", run.stderr);
    assert_eq!(run.stderr.matches("RuntimeError: on purpose").count(), 10, "{}", run.stderr);
    assert!(run.stderr.contains("further errors of the stage are not printed"), "{}", run.stderr);
}

#[test]
fn permanent_failure_stops_system_if_configured() {
    // With these limits, a program that exits has enough time to report the reason.
    let rule = "[restart]\nsilence_s = 2\nmin_uptime_s = 60\nlimit = 1\nbackoff_s = 0\non_limit = \"stop\"\n";
    for (fault, text) in [
        ("gives-nan-always", "`own` returned a course outside [0, 2π), also after a reset"),
        ("dies", "on the request to step"),
        ("hangs", "has not responded to the request to step for"),
    ] {
        let run = system_with_fault(fault, rule).run(&["--for", "60s"]);
        assert_eq!(run.code, Some(1), "{fault}: {}", run.stderr);
        assert!(run.stderr.contains(text) && run.stderr.contains("the system was stopped"), "{fault}: {}", run.stderr);
    }
}

#[test]
fn program_errors_are_reported() {
    let launch = format!("{SIM}[fuser]\nstage = \"mine\"\n[stages.mine]\nslot = \"fuser\"\n");
    let with =
        |command: &str| System::new(&format!("{launch}command = {command}\n[restart]\nlimit = 1\nbackoff_s = 0\n"));
    let cases = [
        ("[\"/nowhere/mine\"]", 3, "file /nowhere/mine does not exist"),
        ("[\"no-such-program\", \"x\"]", 3, "\"no-such-program\" is not in PATH"),
        (
            "[\"sh\", \"-c\", \"echo I cannot >&2; exit 3\"]",
            1,
            "ended with exit status: 3 on the request to describe itself",
        ),
    ];
    for (command, code, text) in cases {
        for arguments in [&["--in-process"][..], &[]] {
            let run = with(command).run(arguments);
            assert_eq!(run.code, Some(code), "{command}: {}", run.stderr);
            assert!(run.stderr.contains(text), "{command}: {}", run.stderr);
        }
    }
    let other = format!("[{:?}, \"hosted\", \"none\"]", faulty_executable());
    let run = with(&other).run(&["--in-process"]);
    assert!(run.stderr.contains("it is a stage of the slot course, not of fuser"), "{}", run.stderr);
    let output = plumb(&["stage", "new", "My Fuser", "--lang", "python"]).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
}

/// Build options. The mathematical crates are fully optimised and the conformance checks slightly.
/// All other crates are not optimised.
const BUILD_OPTIONS: [&str; 5] = [
    "profile.release.package.'*'.opt-level=0",
    "profile.release.package.attitude.opt-level=3",
    "profile.release.package.libm.opt-level=3",
    "profile.release.package.scenario.opt-level=3",
    "profile.release.package.conformance.opt-level=1",
];

#[test]
#[ignore = "long: builds four programs and what they need"]
fn new_rust_stage_conforms_and_swaps_in_every_slot() {
    let stage = |slot: &str| format!("[stages.my-{slot}]\nslot = \"{slot}\"\ncommand = [\"./my-{slot}-program\"]\n");
    let system = System::new(&SLOTS.map(|(slot, _)| stage(slot)).concat());
    let source = env!("CARGO_MANIFEST_DIR");
    // Reuses the target folder of this test run.
    let target: PathBuf = Path::new(env!("CARGO_BIN_EXE_plumb")).parent().unwrap().parent().unwrap().into();
    let build = |slot: &str| {
        let name = format!("my-{slot}");
        let folder = system.path(&name);
        write_stage(&name, "rust", &folder, &["--slot", slot, "--source", source]);
        fs::copy(Path::new(source).join("Cargo.lock"), folder.join("Cargo.lock")).unwrap();
        for verb in ["test", "build"] {
            let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
            command
                .args([verb, "--release", "--offline"])
                .args(BUILD_OPTIONS.iter().flat_map(|option| ["--config", option]));
            command.current_dir(&folder).env("CARGO_TARGET_DIR", &target);
            let output = command.output().unwrap();
            let text = [output.stdout, output.stderr].map(|text| String::from_utf8_lossy(&text).into_owned()).concat();
            assert!(output.status.success() && !text.contains("warning"), "{text}");
        }
        copy_program(&target.join("release").join(&name), &system.path(&format!("{name}-program")));
    };
    // Cargo builds one stage at a time, so one stage is tested while the next is built.
    thread::scope(|scope| {
        for (slot, _) in SLOTS {
            let build = &build;
            scope.spawn(move || build(slot));
        }
    });
    let running = start_system(&system, &[]);
    for (slot, ours) in SLOTS {
        swap_stage(&system, slot, &format!("my-{slot}"));
        swap_stage(&system, slot, ours);
    }
    running.interrupt();
    running.wait().assert_complete();
    assert_eq!(system.leftovers(), Vec::<String>::new());
}
