//! What `plumb` says and how it ends: exit codes, messages, signals, and nothing left behind.
use std::{
    fs,
    io::Write,
    os::fd::OwnedFd,
    path::Path,
    process::{Command, Output},
    time::{Duration, Instant},
};

use crate::common::{Run, Running, System, lives, plumb, signal, until};
use flate2::{Compression, write::GzEncoder};
use rustix::{
    fs::{OFlags, fcntl_setfl},
    pipe::pipe,
    process::{Pid, Signal, kill_process_group},
};

/// What the report for scripts says, whatever became of the run.
const REPORT: [&str; 11] = [
    "cpu_s_per_s",
    "duplicated",
    "error",
    "error_deg",
    "latency_us",
    "lost",
    "not_recorded",
    "services",
    "ticks_in",
    "ticks_out",
    "warnings",
];
const RECORDING: &str = "t_s,gx,gy,gz,ax,ay,az\n0.00,0,0,0,0,0,9.8\n0.01,0,0,0,0,0,9.8\n0.02,0,0,0,0,0,9.8\n";
/// A system is given so long to end before the test is taken as failed.
const HANG: Duration = Duration::from_secs(10);

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// It ended so, said each of these on standard error, and on standard output nothing but, where that was asked for, the same for scripts.
fn assert_refused(mut command: Command, code: i32, said: &[&str]) -> String {
    let output = command.output().unwrap();
    let people = text(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{people}");
    if command.get_args().any(|argument| argument == "--json") {
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(sorted(keys(&report)), REPORT);
        assert_eq!((report["error"].as_str(), report["ticks_in"].as_u64()), (Some(people.trim_end()), Some(0)));
    } else {
        assert_eq!(text(&output.stdout), "", "standard output is for scripts");
    }
    for words in said {
        assert!(people.contains(words), "no {words:?} in:\n{people}");
    }
    people
}

fn gzip(text: &str) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(text.as_bytes()).unwrap();
    encoder.finish().unwrap()
}

/// Both ways to run refuse a recording of these bytes, naming it and saying this.
fn assert_recording_refused(name: &str, contents: &[u8], said: &[&str]) {
    let system = System::new("");
    let file = system.path(name);
    fs::write(&file, contents).unwrap();
    for how in [&[][..], &["--in-process"]] {
        let command = system.command(&[&["--replay", file.to_str().unwrap(), "--speed", "max"], how].concat());
        assert_refused(command, 3, &[&[&*format!("reading the recording {}: ", file.display())], said].concat());
        assert_eq!(system.remains(), Vec::<String>::new());
    }
}

#[test]
fn a_value_that_is_no_number_is_shown_with_file_line_column_and_what_was_expected() {
    let bad = RECORDING.replace("0.02,0,0", "0.02,0,0.1.2");
    assert_recording_refused("bad.csv", bad.as_bytes(), &["line 4, column 3 (gy): found \"0.1.2\", expected a number"]);
    assert_recording_refused("bad.csv.gz", &gzip(&bad), &["line 4, column 3 (gy): found \"0.1.2\", expected a number"]);
}

#[test]
fn a_row_that_is_too_short_is_shown() {
    let bad = format!("{RECORDING}0.03,0,0\n");
    assert_recording_refused("bad.csv", bad.as_bytes(), &["line 5, column 4 (gz): found 3 fields, expected 7"]);
}

#[test]
fn columns_that_are_missing_are_named() {
    let bad = RECORDING.replace("ax,ay,az", "ax,my,mz");
    assert_recording_refused("bad.csv", bad.as_bytes(), &["line 1: found no column ay, az, expected all of t_s, gx"]);
}

#[test]
fn a_column_that_nobody_knows_is_shown_with_the_one_meant() {
    let bad = RECORDING.replace("t_s", "ts");
    assert_recording_refused("bad.csv", bad.as_bytes(), &["line 1, column 1: found \"ts\"", "did you mean \"t_s\"?"]);
}

#[test]
fn an_empty_file_is_no_recording() {
    assert_recording_refused("empty.csv", b"", &["line 1: found the end of the file, expected the header line"]);
    assert_recording_refused("empty.csv.gz", &gzip(""), &["line 1: found the end of the file"]);
    let header = RECORDING.lines().next().unwrap().to_owned() + "\n";
    assert_recording_refused("header.csv", header.as_bytes(), &["line 2: found the end of the file, expected a row"]);
}

#[test]
fn bytes_that_are_no_recording_are_refused() {
    assert_recording_refused("noise.csv.gz", &[0x1f, 0x8b, 0xff, 0, 1, 2, 3, 4, 5, 6, 7, 8], &["line 1: found "]);
    assert_recording_refused(
        "noise.csv",
        &[0, 0xff, 0xfe, 0x80, 9],
        &["line 1, column 1: found ", "expected UTF-8 text"],
    );
}

#[test]
fn a_gzip_stream_that_was_cut_is_refused() {
    let whole = gzip(RECORDING);
    let said = ["found the end of the file inside the gzip stream, expected the rest of it; copy the file again"];
    assert_recording_refused("cut.csv.gz", &whole[..whole.len() / 2], &said);
}

#[test]
fn a_recording_that_is_not_there_is_named_with_the_remedy() {
    let system = System::new("");
    let file = system.path("absent.csv");
    let said = [&*format!("opening the recording {}: No such file", file.display()), "check the path"];
    assert_refused(system.command(&["--replay", file.to_str().unwrap()]), 3, &said);
}

/// `plumb up` and `plumb config check` refuse this launch file alike.
fn assert_launch_refused(launch: &str, said: &[&str]) {
    let system = System::written(launch);
    let file = system.path("launch.toml");
    let mut check = plumb(&["config", "check"]);
    check.arg(&file);
    let path = file.display().to_string();
    let said: Vec<_> = said.iter().map(|words| words.replace("launch.toml", &path)).collect();
    let said: Vec<_> = said.iter().map(String::as_str).collect();
    let people = assert_refused(check, 3, &said);
    assert_eq!(assert_refused(system.command(&["--in-process"]), 3, &said), people);
    assert_eq!(assert_refused(system.command(&[]), 3, &said), people);
    assert_eq!(system.remains(), Vec::<String>::new());
}

#[test]
fn a_key_that_nobody_knows_is_underlined_with_the_one_meant() {
    let said = [
        "unknown key \"bufer_s\"",
        "launch.toml:2:1",
        "2 | bufer_s = 2.0\n  | ^^^^^^^",
        "did you mean \"buffer_s\"?",
        "allowed: \"name\", \"services\", \"buffer_s\"",
        "1 problem",
    ];
    assert_launch_refused("bufer_s = 2.0\n", &said);
}

#[test]
fn a_stage_that_is_not_there_is_underlined_with_the_one_meant() {
    let said = [
        "fuser.stage: unknown value \"wz-close\"",
        "launch.toml:3:9",
        "3 | stage = \"wz-close\"\n  |         ^^^^^^^^^^",
        "did you mean \"wz-closed\"?",
        "allowed: \"multiple-model\", \"wz\", \"wz-closed\", \"wz-open\"",
    ];
    assert_launch_refused("[fuser]\nstage = \"wz-close\"\n", &said);
}

#[test]
fn a_value_of_another_type_is_underlined_with_the_type_expected() {
    let said = [
        "ingest.sim.rate_hz: expected a number, found a string",
        "launch.toml:3:11",
        "3 | rate_hz = \"fast\"\n  |           ^^^^^^",
    ];
    assert_launch_refused("[ingest.sim]\nrate_hz = \"fast\"\n", &said);
}

#[test]
fn a_value_out_of_range_is_underlined_with_the_range() {
    let said =
        ["ingest.limits.gap_s: expected 0.001 to 10, found -1", "launch.toml:3:9", "3 | gap_s = -1\n  |         ^^"];
    assert_launch_refused("[ingest.limits]\ngap_s = -1\n", &said);
}

#[test]
fn a_gateway_that_is_set_and_not_started_is_underlined_with_the_remedy() {
    let said = [
        "gateway: the service is not started",
        "launch.toml:2:2",
        "2 | [gateway.rates]\n  |  ^^^^^^^ no effect",
        "services = [\"ingest\", \"gyro\", \"accel\", \"fuser\", \"course\", \"gateway\", \"cockpit\"]",
        "1 problem",
    ];
    assert_launch_refused("[gateway.rates]\nimu = \"all\"\n", &said);
    let left_out =
        "services = [\"ingest\", \"gyro\", \"accel\", \"fuser\", \"course\"]\n[gateway.rates]\nimu = \"all\"\n";
    let output = plumb(&["config", "check"]).arg(System::written(left_out).path("launch.toml")).output().unwrap();
    assert!(output.status.success(), "services without the gateway disables the section: {}", text(&output.stderr));
}

#[test]
fn every_problem_of_a_launch_file_is_shown_at_once() {
    let launch = "buffer_s = 0\n[gyro]\nstage = \"moebius\"\n[ingest]\nsource = \"simulation\"\n";
    let said = ["launch.toml:2:12", "launch.toml:4:9", "did you mean \"mobius\"?", "launch.toml:6:10", "3 problems"];
    assert_launch_refused(launch, &said);
}

#[test]
fn a_file_that_is_not_toml_is_shown_where_it_ceases_to_be() {
    assert_launch_refused("[gyro\n", &["not valid TOML", "launch.toml:2:6"]);
}

#[test]
fn config_check_says_valid_or_why_not() {
    let system = System::new("[fuser]\nstage = \"wz\"\n");
    let file = system.path("launch.toml");
    assert_refused(plumb(&["config", "check", file.to_str().unwrap()]), 0, &["launch.toml is valid"]);
    let absent = system.path("absent.toml");
    let said = [&*format!("reading the launch file {}: No such file", absent.display()), "check that it exists"];
    assert_refused(plumb(&["config", "check", absent.to_str().unwrap()]), 3, &said);
    assert_refused(plumb(&["up", absent.to_str().unwrap()]), 3, &said);
}

#[test]
fn the_launch_file_of_the_repository_is_valid() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("launch.toml");
    assert_refused(plumb(&["config", "check", file.to_str().unwrap()]), 0, &["is valid"]);
}

#[test]
fn wrong_usage_is_told_apart_from_a_wrong_file() {
    assert_refused(plumb(&["up", "--sped", "max"]), 2, &["unexpected argument '--sped'", "--speed"]);
    assert_refused(plumb(&["fly"]), 2, &["fly"]);
    assert_refused(plumb(&["service", "gryo"]), 2, &["unknown service"]);
    for speed in ["fast", "0", "-1", "nan", "inf"] {
        let said = ["--speed", "expected `max` or a number from 0.001 to 1000000"];
        assert_refused(plumb(&["up", &format!("--speed={speed}")]), 2, &said);
    }
    for duration in ["soon", "10x", "s", "-1s", "nan", "0s"] {
        assert_refused(plumb(&["up", &format!("--for={duration}")]), 2, &["--for", "expected "]);
    }
}

#[test]
fn a_script_gets_an_object_from_every_command_that_fails() {
    for (arguments, code, said) in [
        (&["up", "--sped", "max", "--json"][..], 2, "unexpected argument '--sped'"),
        (&["ps", "--system", "nobody-runs-this", "--json"], 1, "nobody-runs-this"),
        (&["score", "no-such-recording.csv", "--json"], 3, "no-such-recording.csv"),
    ] {
        let output = plumb(arguments).output().unwrap();
        let object: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {object}");
        assert!(object["error"].as_str().is_some_and(|error| error.contains(said)), "{arguments:?}: {object}");
    }
    assert!(plumb(&["up", "--help", "--json"]).output().unwrap().status.success());
}

#[test]
fn a_parameter_that_is_not_a_finite_number_is_wrong_usage() {
    for value in ["nan", "-inf", "infinity", "1e999", "three", ""] {
        let mut command = plumb(&["swap", "fuser", "madgwick", "--set"]);
        command.arg(format!("beta={value}"));
        assert_refused(command, 2, &[&format!("beta={value}"), "expected KEY=VALUE with a finite number"]);
    }
}

#[test]
fn a_service_started_by_hand_says_who_starts_it() {
    for service in ["ingest", "gyro", "accel", "fuser", "course"] {
        let said =
            [&*format!("configuration of service {service} on standard input: "), "start services with `plumb up`"];
        assert_refused(plumb(&["service", service]), 1, &said);
    }
}

#[test]
fn an_output_that_cannot_be_written_is_named() {
    let system = System::new("");
    let out = system.path("no/such/folder/out.csv");
    for how in [&[][..], &["--in-process"]] {
        let command = system.command(&[&["--out", out.to_str().unwrap(), "--for", "1s"], how].concat());
        assert_refused(command, 1, &[&format!("writing {}: No such file", out.display())]);
        assert_eq!(system.remains(), Vec::<String>::new());
    }
}

fn keys(object: &serde_json::Value) -> Vec<&str> {
    object.as_object().unwrap().keys().map(String::as_str).collect()
}

fn assert_report(output: &Output, has_error: bool) {
    let scripts = text(&output.stdout);
    assert_eq!(scripts.lines().count(), 1, "{scripts}");
    let json: serde_json::Value = serde_json::from_str(&scripts).unwrap();
    assert_eq!(sorted(keys(&json)), REPORT);
    assert!(json["error"].is_null(), "{json}");
    assert_eq!(sorted(keys(&json["latency_us"])), ["max", "p50", "p99", "p999"]);
    if has_error {
        assert_eq!(sorted(keys(&json["error_deg"])), ["inclination_max", "inclination_rmse"]);
    } else {
        assert!(json["error_deg"].is_null());
    }
    let services = json["services"].as_array().unwrap();
    assert_eq!(services.len(), 5);
    for service in services {
        assert_eq!(sorted(keys(service)), ["name", "pid", "restarts"]);
        assert!(service["pid"].is_u64() && service["restarts"] == 0);
    }
}

fn sorted(mut words: Vec<&str>) -> Vec<&str> {
    words.sort_unstable();
    words
}

#[test]
fn the_report_for_scripts_has_the_keys_that_are_written_down() {
    let system = System::new("");
    let file = system.path("short.csv");
    fs::write(&file, RECORDING).unwrap();
    let simulation = ["--for", "1s", "--speed", "max"];
    let replay = ["--replay", file.to_str().unwrap(), "--speed", "max"];
    for how in [&[][..], &["--in-process"]] {
        assert_report(&system.command(&[&simulation, how].concat()).output().unwrap(), true);
        assert_report(&system.command(&[&replay, how].concat()).output().unwrap(), false);
    }
}

#[test]
fn without_json_nothing_is_on_standard_output() {
    let system = System::new("");
    for how in [&[][..], &["--in-process"]] {
        let mut command = plumb(&["up"]);
        command.arg(system.path("launch.toml")).args(["--for", "1s", "--speed", "max"]).args(how);
        assert_refused(command, 0, &["ticks    1000 in, 1000 out, 0 lost", "digest   "]);
    }
}

/// The only test that runs under the name of the launch file built in: within one process, which needs no name.
#[test]
fn without_a_launch_file_the_one_built_in_runs() {
    let empty = tempfile::tempdir().unwrap();
    let mut command = plumb(&["up", "--in-process", "--for", "2s", "--speed", "max"]);
    command.current_dir(empty.path());
    assert_refused(command, 0, &["plumbline: simulation s1 at 1000 Hz", "ticks    2000 in, 2000 out, 0 lost"]);
}

#[test]
fn plumb_alone_runs_the_launch_file_that_is_here() {
    let system = System::new("");
    let mut command = plumb(&[]);
    command.current_dir(system.folder.path());
    let running = Running::of(command);
    running.all_services();
    until("the bus", || !system.remains().is_empty());
    running.interrupt();
    let output = running.output();
    let people = text(&output.stderr);
    assert_eq!((output.status.code(), text(&output.stdout)), (Some(0), String::new()), "{people}");
    assert!(people.contains(&format!("{}: simulation s1", system.name)), "{people}");
    assert_eq!(system.remains(), Vec::<String>::new());
}

/// Ends a running system by `end`; it reports, and nothing of it is left.
fn assert_ends_clean(how: &str, end: impl Fn(&Running)) {
    let system = System::new("");
    let running = system.start_as_a_shell_does(&[]);
    let services = running.all_services();
    std::thread::sleep(Duration::from_millis(300));
    end(&running);
    let asked = Instant::now();
    let run = running.wait();
    let took = asked.elapsed();
    println!("{how}: ended after {} ms", took.as_millis());
    assert!(took < HANG, "{took:?}");
    run.assert_whole();
    assert!(run.number("/ticks_out") > 0.0, "{}", run.people);
    assert!(services.iter().all(|(_, pid)| !lives(*pid)), "{services:?}");
    assert_eq!(system.remains(), Vec::<String>::new());
}

#[test]
fn ctrl_c_ends_the_system_with_a_report_and_leaves_nothing() {
    assert_ends_clean("Ctrl-C", |running| {
        kill_process_group(Pid::from_raw(running.pid() as i32).unwrap(), Signal::INT).unwrap();
    });
}

#[test]
fn sigterm_ends_the_system_with_a_report_and_leaves_nothing() {
    assert_ends_clean("SIGTERM", |running| signal(running.pid(), Signal::TERM));
}

#[test]
fn ctrl_c_at_any_moment_of_the_start_leaves_nothing() {
    for delay_ms in (0..40).step_by(2) {
        let system = System::new("");
        let running = system.start_as_a_shell_does(&[]);
        until("the system's name", || !system.remains().is_empty());
        std::thread::sleep(Duration::from_millis(delay_ms));
        running.interrupt();
        let asked = Instant::now();
        let run = running.wait();
        println!("Ctrl-C {delay_ms} ms after the start: ended after {} ms", asked.elapsed().as_millis());
        assert_eq!(run.code, Some(0), "{}", run.people);
        assert_eq!(system.remains(), Vec::<String>::new());
    }
}

#[test]
fn ctrl_c_ends_a_replay_at_full_speed_too() {
    let system = System::new("");
    let running = system.start_as_a_shell_does(&["--speed", "max"]);
    let services = running.all_services();
    std::thread::sleep(Duration::from_millis(300));
    running.interrupt();
    let run = running.wait();
    run.assert_whole();
    assert!(services.iter().all(|(_, pid)| !lives(*pid)), "{services:?}");
    assert_eq!(system.remains(), Vec::<String>::new());
}

#[test]
fn a_second_system_of_the_same_name_is_refused_and_the_first_goes_on() {
    let system = System::new("");
    let first = system.start(&[]);
    let services = first.all_services();
    let (pid, name) = (first.pid(), &system.name);
    let said = [
        &*format!("starting the system {name:?}: a system of this name is already running (process {pid})"),
        &format!("stop it (kill {pid})"),
        "set another `name` in launch.toml",
    ];
    assert_refused(system.command(&["--for", "1s"]), 1, &said);
    assert!(services.iter().all(|(_, pid)| lives(*pid)), "{services:?}");
    assert_eq!(first.services(), services);
    std::thread::sleep(Duration::from_millis(200));
    first.interrupt();
    let run = first.wait();
    run.assert_whole();
    assert!(run.number("/ticks_out") > 0.0);
    assert_eq!(system.remains(), Vec::<String>::new());
}

#[test]
fn nothing_outlives_a_supervisor_that_is_killed_and_the_next_start_is_clean() {
    let system = System::new("");
    let running = system.start(&[]);
    let services = running.all_services();
    system.all_run();
    signal(running.pid(), Signal::KILL);
    assert_eq!(running.output().status.code(), None);
    until("the services to end by themselves", || services.iter().all(|(_, pid)| !lives(*pid)));
    until("what is left to be removed", || system.remains().is_empty());
    let run = system.run(&["--for", "1s", "--speed", "max"]);
    run.assert_whole();
    assert_eq!(run.number("/ticks_out"), 1000.0);
}

#[test]
fn a_start_right_after_the_supervisor_was_killed_is_whole() {
    let system = System::new("");
    for _ in 0..5 {
        let first = system.start(&[]);
        first.service("course");
        signal(first.pid(), Signal::KILL);
        let run = Run::of(system.command(&["--for", "200ms"]).output().unwrap());
        run.assert_whole();
        assert_eq!(run.number("/ticks_out"), 200.0);
        drop(first);
    }
    assert_eq!(system.remains(), Vec::<String>::new());
}

#[test]
fn the_attitude_is_not_written_over_the_recording() {
    let system = System::new("");
    let file = system.path("rec.csv");
    let text = "t_s,gx,gy,gz,ax,ay,az\n0,0,0,0,0,0,9.8\n0.01,0,0,0,0,0,9.8\n";
    fs::write(&file, text).unwrap();
    let name = file.to_str().unwrap();
    let run = Run::of(system.command(&["--replay", name, "--out", name]).output().unwrap());
    assert_eq!(run.code, Some(2), "{}", run.people);
    assert_eq!(fs::read_to_string(&file).unwrap(), text);
}

#[test]
fn a_system_that_nobody_listens_to_runs_to_its_end() {
    let system = System::new("");
    let full = fs::File::options().write(true).open("/dev/full").unwrap();
    let output = system.command(&["--for", "1500ms"]).stderr(full).output().unwrap();
    Run::of(output).assert_whole();
}

/// Both ends of a pipe that has no room.
fn full_pipe() -> (OwnedFd, OwnedFd) {
    let (reader, writer) = pipe().unwrap();
    fcntl_setfl(&writer, OFlags::NONBLOCK).unwrap();
    while rustix::io::write(&writer, &[b'x'; 4096]).is_ok() {}
    fcntl_setfl(&writer, OFlags::empty()).unwrap();
    (reader, writer)
}

#[test]
fn a_system_ends_though_nobody_takes_what_it_says_to_people() {
    for how in [&["--for", "1s"] as &[&str], &["--for", "1s", "--in-process"]] {
        let (_reader, writer) = full_pipe();
        let system = System::new("[ingest.sim]\nrate_hz = 200\n");
        let mut running = Running::telling(system.command(how), writer);
        until("the end", || running.has_ended());
        let report: serde_json::Value = serde_json::from_slice(&running.output().stdout).unwrap();
        assert!(report["error"].is_null() && report["ticks_out"].as_u64() > Some(100), "{report}");
    }
}

#[test]
fn a_pipe_is_refused_as_the_file_of_attitudes() {
    let system = System::new("");
    let pipe = system.path("pipe");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let run = Run::of(system.command(&["--out", pipe.to_str().unwrap()]).output().unwrap());
    assert_eq!(run.code, Some(1), "{}", run.people);
    assert!(run.people.contains("it is a pipe"), "{}", run.people);
    assert!(run.json["error"].as_str().unwrap().contains("it is a pipe"), "{}", run.json);
}

#[test]
fn a_duration_of_whole_ticks_gives_that_many() {
    let system = System::new("");
    for (time, ticks) in [("700ms", 700.0), ("1ms", 1.0), ("2.3s", 2300.0)] {
        let run = system.run(&["--for", time, "--speed", "max", "--in-process"]);
        assert_eq!(run.number("/ticks_out"), ticks);
    }
}
