//! What the report and the file of attitudes lack is said, counted and the exit code, and the attitude itself is never the price.
use std::{fs, io, io::Write, process::Command, thread, time::Duration};

use crate::common::{Run, Running, System, attitudes, lives, plumb, signal, until};
use rustix::process::Signal;
use serde_json::Value;

fn pause(ms: u64) {
    thread::sleep(Duration::from_millis(ms));
}

/// It failed, and says why: to people, and to scripts the same.
fn assert_failed(run: &Run, why: &str) {
    assert_eq!(run.code, Some(1), "{}", run.people);
    let error = run.json["error"].as_str().unwrap_or_else(|| panic!("no error in {}", run.json));
    assert!(error.contains(why) && run.people.contains(error), "no {why:?}: {}\n{}", run.json, run.people);
}

fn json(arguments: &[&str], system: &System) -> Value {
    let output = plumb(arguments).args(["--json", "--system", &system.name]).output().unwrap();
    serde_json::from_slice(&output.stdout).unwrap()
}

/// What the doctor says about the report and the file.
fn record(system: &System) -> Value {
    let doctor = json(&["doctor", "--seconds", "0.2"], system);
    doctor["checks"].as_array().unwrap().iter().find(|check| check["check"] == "record").unwrap().clone()
}

#[test]
fn what_a_frozen_supervisor_misses_is_counted_apart_from_what_is_lost() {
    let system = System::new("buffer_s = 2.0\nlateness_s = 1.0\n");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    system.all_run();
    assert_eq!(record(&system)["result"], "ok");
    signal(running.pid(), Signal::STOP);
    // Longer than buffer_s.
    let seen = json(&["topic", "hz", "attitude", "--seconds", "4"], &system);
    signal(running.pid(), Signal::CONT);
    assert!(seen["messages"].as_u64() > Some(3000), "{seen}");
    assert_eq!((seen["lost"].as_u64(), seen["missed"].as_u64()), (Some(0), Some(0)), "on the bus: {seen}");
    system.all_run();
    until("the supervisor to notice", || record(&system)["result"] == "warning");
    running.interrupt();
    let run = running.wait();
    assert_failed(&run, "missing from the report's figures and the --out file");
    let not_recorded = run.number("/not_recorded");
    assert_eq!((run.number("/lost"), run.number("/ticks_in")), (0.0, run.number("/ticks_out")), "{}", run.json);
    let t_s: Vec<_> = attitudes(&out).iter().map(|(t_s, _)| *t_s).collect();
    assert_eq!(t_s.len() as f64, run.number("/ticks_out") - not_recorded);
    let gaps: Vec<_> = t_s.windows(2).map(|pair| ((pair[1] - pair[0]) * 1000.0).round() - 1.0).collect();
    assert_eq!(gaps.iter().copied().filter(|missing| *missing > 0.0).collect::<Vec<_>>(), [not_recorded]);
    println!("4 s frozen: {not_recorded} of {} attitudes are not recorded", run.number("/ticks_out"));
}

#[test]
fn a_run_that_lost_ticks_says_so_and_ends_with_1() {
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
    system.all_run();
    lose(&running);
    let run = running.wait();
    assert!(run.number("/lost") > 100.0, "{}", run.json);
    assert_failed(&run, &format!("{} of {} ticks were lost", run.number("/lost"), run.number("/ticks_in")));

    let mut quiet = plumb(&["up"]);
    quiet.arg(system.path("launch.toml"));
    let running = Running::of(quiet);
    system.all_run();
    lose(&running);
    let output = running.output();
    assert_eq!((output.status.code(), output.stdout.len()), (Some(1), 0));
    assert!(String::from_utf8_lossy(&output.stderr).contains("ticks were lost"));
}

#[test]
fn a_disk_that_is_full_costs_the_file_and_nothing_else() {
    for how in [&[][..], &["--in-process"]] {
        let system = System::new("");
        let run = system.run(&[&["--out", "/dev/full", "--for", "3s"], how].concat());
        assert_eq!((run.number("/ticks_out"), run.number("/lost")), (3000.0, 0.0), "{}", run.json);
        assert_failed(&run, "writing /dev/full: No space left on device");
        let said = run.people.matches("writing /dev/full").count();
        assert_eq!(said, 2, "once while it runs, once at the end: {}", run.people);
    }
}

#[test]
fn a_file_that_fills_its_disk_ends_with_a_whole_line() {
    let namespace = ["--map-root-user", "--mount"];
    let allowed = Command::new("unshare").args(namespace).arg("true").output();
    if !allowed.as_ref().is_ok_and(|output| output.status.success()) {
        return eprintln!("skipped: no file systems of one's own here: {allowed:?}");
    }
    let system = System::new("");
    let disk = system.path("disk");
    fs::create_dir(&disk).unwrap();
    let out = disk.join("out.csv");
    let (up, result) = (system.command(&["--out", out.to_str().unwrap(), "--for", "4s"]), system.path("result.csv"));
    let up: Vec<_> = [up.get_program()].into_iter().chain(up.get_args()).map(|word| word.to_str().unwrap()).collect();
    // The disk is there for these processes only.
    let script = "mount -t tmpfs -o size=100k full \"$1\" && shift && out=$1 && shift && result=$1 && shift && \"$@\"; code=$?; cp \"$out\" \"$result\"; exit $code";
    let mut command = Command::new("unshare");
    command.args(namespace).args(["sh", "-c", script, "sh"]);
    command.args([&disk, &out, &result]).args(up);
    let running = Running::of(command);
    until("the system to run", || !system.ps().is_empty());
    until("the disk to be full", || record(&system)["result"] == "problem");
    let run = running.wait();
    assert_eq!((run.number("/ticks_out"), run.number("/lost")), (4000.0, 0.0), "{}", run.json);
    assert_failed(&run, "No space left on device");
    let text = fs::read_to_string(&result).unwrap();
    assert!(text.ends_with('\n') && text.len() > 50_000, "{} bytes", text.len());
    let written = attitudes(&result);
    assert!(written.iter().zip(1..).all(|((t_s, _), tick)| (t_s * 1000.0 - f64::from(tick)).abs() < 1.5), "a gap");
    assert_eq!(system.remains(), Vec::<String>::new());
}

#[test]
fn a_terminal_that_stands_still_is_not_waited_for() {
    let system = System::new("");
    let out = system.path("out.csv");
    let (mut reader, mut terminal) = io::pipe().unwrap();
    rustix::io::ioctl_fionbio(&terminal, true).unwrap();
    while terminal.write(&[b'.'; 4096]).is_ok() {}
    rustix::io::ioctl_fionbio(&terminal, false).unwrap();
    let running = Running::telling(system.command(&["--out", out.to_str().unwrap()]), terminal);
    system.all_run();
    let gyro = running.service("gyro");
    signal(gyro, Signal::KILL);
    until("another incarnation", || system.ps().iter().any(|one| one["service"] == "gyro" && one["restarts"] == 1));
    let services = running.services();
    running.interrupt();
    until("the services to end", || !services.iter().any(|(_, pid)| lives(*pid)));
    let people = thread::spawn(move || io::read_to_string(&mut reader).unwrap());
    let run = running.wait();
    run.assert_whole();
    run.assert_bytes(&out, "");
    let people = people.join().unwrap();
    assert!(people.contains("(restart 1)") && people.contains(" in, "), "{people}");
    assert_eq!(system.remains(), Vec::<String>::new());
}
