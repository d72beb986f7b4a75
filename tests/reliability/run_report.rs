//! Attitudes that are missing from the report or the output file.
//!
//! The run counts and reports them and exits with code 1. The published attitude is never affected.
use std::{fs, io, io::Write, process::Command, thread, time::Duration};

use crate::common::{Run, Running, System, attitudes, is_alive, plumb, signal, wait_for};
use rustix::process::Signal;
use serde_json::Value;

fn pause(ms: u64) {
    thread::sleep(Duration::from_millis(ms));
}

/// Checks that the run failed with the same error in the report and on standard error.
fn assert_failure(run: &Run, cause: &str) {
    assert_eq!(run.code, Some(1), "{}", run.stderr);
    let error = run.json["error"].as_str().unwrap_or_else(|| panic!("no error in {}", run.json));
    assert!(error.contains(cause) && run.stderr.contains(error), "no {cause:?}: {}\n{}", run.json, run.stderr);
}

fn json(arguments: &[&str], system: &System) -> Value {
    let output = plumb(arguments).args(["--json", "--system", &system.name]).output().unwrap();
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Returns the check `record` of `plumb doctor`, which concerns the report and the output file.
fn record(system: &System) -> Value {
    let doctor = json(&["doctor", "--for", "200ms"], system);
    let checks = doctor["checks"].as_array().unwrap();
    checks.iter().find(|check| check["check"] == "record").unwrap_or_else(|| panic!("no record: {doctor}")).clone()
}

#[test]
fn ticks_missed_by_frozen_supervisor_are_not_lost() {
    let system = System::new("buffer_s = 2.0\nlateness_s = 1.0\n");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    system.wait_until_running();
    assert_eq!(record(&system)["result"], "ok");
    signal(running.pid(), Signal::STOP);
    // The measurement is longer than `buffer_s`, so the frozen supervisor misses ticks.
    let rates = json(&["topic", "hz", "attitude", "--for", "4s"], &system);
    signal(running.pid(), Signal::CONT);
    assert!(rates["messages"].as_u64() > Some(3000), "{rates}");
    assert_eq!((rates["lost"].as_u64(), rates["missed"].as_u64()), (Some(0), Some(0)), "on the bus: {rates}");
    system.wait_until_running();
    wait_for("the supervisor to report the gap", || record(&system)["result"] == "warning");
    running.interrupt();
    let run = running.wait();
    assert_failure(&run, "missing from the report's figures and the --out file");
    let not_recorded = run.number("/not_recorded");
    assert_eq!((run.number("/lost"), run.number("/ticks_in")), (0.0, run.number("/ticks_out")), "{}", run.json);
    let t_s: Vec<_> = attitudes(&out).iter().map(|(t_s, _)| *t_s).collect();
    assert_eq!(t_s.len() as f64, run.number("/ticks_out") - not_recorded);
    let gaps: Vec<_> = t_s.windows(2).map(|pair| ((pair[1] - pair[0]) * 1000.0).round() - 1.0).collect();
    assert_eq!(gaps.iter().copied().filter(|missing| *missing > 0.0).collect::<Vec<_>>(), [not_recorded]);
    println!("4 s frozen: {not_recorded} of {} attitudes are not recorded", run.number("/ticks_out"));
}

#[test]
fn lost_ticks_are_reported_with_exit_code_1() {
    let launch = "buffer_s = 0.5\nlateness_s = 0.2\n[restart]\nsilence_s = 10.0";
    let lose = |running: &Running| {
        pause(700);
        let course = running.service("course");
        signal(course, Signal::STOP);
        pause(1500);
        signal(course, Signal::CONT);
        pause(500);
        running.interrupt();
    };
    let system = System::new(launch);
    let running = system.start(&[]);
    system.wait_until_running();
    lose(&running);
    let run = running.wait();
    assert!(run.number("/lost") > 100.0, "{}", run.json);
    assert_failure(&run, &format!("{} of {} ticks were lost", run.number("/lost"), run.number("/ticks_in")));

    let mut quiet = plumb(&["up", "--launch"]);
    quiet.arg(system.path("launch.toml"));
    let running = Running::spawn(quiet);
    system.wait_until_running();
    lose(&running);
    let output = running.output();
    assert_eq!((output.status.code(), output.stdout.len()), (Some(1), 0));
    assert!(String::from_utf8_lossy(&output.stderr).contains("ticks were lost"));
}

#[test]
fn full_disk_fails_output_file_only() {
    for how in [&[][..], &["--in-process"]] {
        let system = System::new("");
        let run = system.run(&[&["--out", "/dev/full", "--for", "3s"], how].concat());
        assert_eq!((run.number("/ticks_out"), run.number("/lost")), (3000.0, 0.0), "{}", run.json);
        assert_failure(&run, "writing /dev/full: No space left on device");
        let messages = run.stderr.matches("writing /dev/full").count();
        assert_eq!(messages, 2, "once during the run, once at the end: {}", run.stderr);
    }
}

#[test]
fn file_filling_its_disk_ends_with_complete_line() {
    let namespace = ["--map-root-user", "--mount"];
    let allowed = Command::new("unshare").args(namespace).arg("true").output();
    if !allowed.as_ref().is_ok_and(|output| output.status.success()) {
        return eprintln!("skipped: no private mount namespace available: {allowed:?}");
    }
    let system = System::new("");
    let disk = system.path("disk");
    fs::create_dir(&disk).unwrap();
    let out = disk.join("out.csv");
    let (up, result) = (system.command(&["--out", out.to_str().unwrap(), "--for", "12s"]), system.path("result.csv"));
    let up: Vec<_> = [up.get_program()].into_iter().chain(up.get_args()).map(|word| word.to_str().unwrap()).collect();
    // The mount is visible only to the processes of this command.
    let script = "mount -t tmpfs -o size=100k full \"$1\" && shift && out=$1 && shift && result=$1 && shift && \"$@\"; code=$?; cp \"$out\" \"$result\"; exit $code";
    let mut command = Command::new("unshare");
    command.args(namespace).args(["sh", "-c", script, "sh"]);
    command.args([&disk, &out, &result]).args(up);
    let running = Running::spawn(command);
    system.wait_until_running();
    wait_for("the disk to be full", || record(&system)["result"] == "problem");
    let run = running.wait();
    assert_eq!((run.number("/ticks_out"), run.number("/lost")), (12_000.0, 0.0), "{}", run.json);
    assert_failure(&run, "No space left on device");
    let text = fs::read_to_string(&result).unwrap();
    assert!(text.ends_with('\n') && text.len() > 50_000, "{} bytes", text.len());
    let written = attitudes(&result);
    assert!(written.iter().zip(1..).all(|((t_s, _), tick)| (t_s * 1000.0 - f64::from(tick)).abs() < 1.5), "a gap");
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn blocked_terminal_does_not_delay_system() {
    let system = System::new("");
    let out = system.path("out.csv");
    let (mut reader, mut terminal) = io::pipe().unwrap();
    rustix::io::ioctl_fionbio(&terminal, true).unwrap();
    while terminal.write(&[b'.'; 4096]).is_ok() {}
    rustix::io::ioctl_fionbio(&terminal, false).unwrap();
    let running = Running::spawn_with_stderr(system.command(&["--out", out.to_str().unwrap()]), terminal);
    system.wait_until_running();
    let gyro = running.service("gyro");
    signal(gyro, Signal::KILL);
    wait_for("another incarnation", || system.ps().iter().any(|one| one["service"] == "gyro" && one["restarts"] == 1));
    let services = running.services();
    running.interrupt();
    wait_for("the services to end", || !services.iter().any(|(_, pid)| is_alive(*pid)));
    let output = thread::spawn(move || io::read_to_string(&mut reader).unwrap());
    let run = running.wait();
    run.assert_complete();
    run.assert_undisturbed_output(&out, "");
    let output = output.join().unwrap();
    assert!(output.contains("(restart 1)") && output.contains(" in, "), "{output}");
    assert_eq!(system.leftovers(), Vec::<String>::new());
}
