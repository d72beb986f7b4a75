//! `plumb up`: exit codes, messages, signals, and no files left behind.
use std::{
    fs,
    io::Write,
    os::fd::OwnedFd,
    path::Path,
    process::{Command, Output},
    time::{Duration, Instant},
};

use crate::common::{Run, Running, System, is_alive, plumb, signal, wait_for};
use flate2::{Compression, write::GzEncoder};
use rustix::{
    fs::{Mode, OFlags, fcntl_setfl},
    pipe::pipe,
    process::{Pid, Signal, kill_process_group},
};

/// Keys of the JSON report. Every report has the same keys, whatever the result of the run.
const REPORT: [&str; 12] = [
    "cpu_s_per_s",
    "duplicated",
    "error",
    "error_deg",
    "latency_us",
    "lost",
    "lost_readings",
    "not_recorded",
    "services",
    "ticks_in",
    "ticks_out",
    "warnings",
];
const RECORDING: &str = "t_s,gx,gy,gz,ax,ay,az\n0.00,0,0,0,0,0,9.8\n0.01,0,0,0,0,0,9.8\n0.02,0,0,0,0,0,9.8\n";
/// Maximum time for a shutdown. It elapses only if a test fails.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(10);

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// Runs a command. Checks its exit code and output, and checks that standard error contains
/// `texts`.
///
/// With `--json`, standard output must contain the same message in its report; otherwise, standard
/// output must be empty. Returns standard error.
fn assert_exits_with(mut command: Command, code: i32, texts: &[&str]) -> String {
    let output = command.output().unwrap();
    let stderr = text(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{stderr}");
    if command.get_args().any(|argument| argument == "--json") {
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(sorted(keys(&report)), REPORT);
        assert_eq!((report["error"].as_str(), report["ticks_in"].as_u64()), (Some(stderr.trim_end()), Some(0)));
    } else {
        assert_eq!(text(&output.stdout), "", "standard output without --json");
    }
    for words in texts {
        assert!(stderr.contains(words), "no {words:?} in:\n{stderr}");
    }
    stderr
}

fn gzip(text: &str) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(text.as_bytes()).unwrap();
    encoder.finish().unwrap()
}

/// Checks that a recording with these contents is rejected, with and without `--in-process`. The
/// message must contain the name of the recording and `texts`.
fn assert_recording_rejected(name: &str, contents: &[u8], texts: &[&str]) {
    let system = System::new("");
    let file = system.path(name);
    fs::write(&file, contents).unwrap();
    for mode in [&[][..], &["--in-process"]] {
        let command = system.command(&[&["--replay", file.to_str().unwrap(), "--speed", "max"], mode].concat());
        assert_exits_with(command, 3, &[&[&*format!(" {}: ", file.display())], texts].concat());
        assert_eq!(system.leftovers(), Vec::<String>::new());
    }
}

/// Checks that `rows` rows of a recording with these contents are read, and that standard error
/// contains `text`.
fn assert_recording_read(name: &str, contents: &[u8], rows: u64, text: &str) {
    let system = System::new("");
    let file = system.path(name);
    fs::write(&file, contents).unwrap();
    let run = system.run(&["--replay", file.to_str().unwrap(), "--speed", "max", "--in-process"]);
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    assert_eq!(run.number("/ticks_out"), rows as f64, "{}", run.stderr);
    assert!(run.stderr.contains(text), "{}", run.stderr);
}

#[test]
fn malformed_rows_cost_only_themselves() {
    let bad = RECORDING.replace("0.02,0,0", "0.02,0,0.1.2");
    let note = "skipped 1 malformed row, the first in line 4: found \"0.1.2\", expected a number";
    let rows = RECORDING.lines().count() as u64 - 2;
    assert_recording_read("bad.csv", bad.as_bytes(), rows, note);
    assert_recording_read("bad.csv.gz", &gzip(&bad), rows, note);
    let short = format!("{RECORDING}0.03,0,0\n");
    let note = "skipped 1 malformed row, the first in line 5: found 3 fields, expected 7 as in the header";
    assert_recording_read("bad.csv", short.as_bytes(), rows + 1, note);
    let zeros = [RECORDING.as_bytes(), &[0; 5000]].concat();
    assert_recording_read("bad.csv", &zeros, rows + 1, "skipped 1 malformed row, the first in line 5");
}

#[test]
fn recording_without_valid_row_is_rejected() {
    let header = RECORDING.lines().next().unwrap();
    let bad = format!("{header}\n0,0,0\n1,0,0\n");
    assert_recording_rejected("bad.csv", bad.as_bytes(), &["line 2, column 4 (gz): found 3 fields, expected 7"]);
}

#[test]
fn missing_columns_are_named() {
    let bad = RECORDING.replace("ax,ay,az", "ax,my,mz");
    assert_recording_rejected("bad.csv", bad.as_bytes(), &["line 1: found no column ay, az, expected all of t_s, gx"]);
}

#[test]
fn unknown_column_is_reported_with_suggestion() {
    let bad = RECORDING.replace("t_s", "ts");
    assert_recording_rejected("bad.csv", bad.as_bytes(), &["line 1, column 1: found \"ts\"", "did you mean \"t_s\"?"]);
}

#[test]
fn empty_recording_is_rejected() {
    assert_recording_rejected("empty.csv", b"", &["line 1: found the end of the file, expected the header line"]);
    assert_recording_rejected("empty.csv.gz", &gzip(""), &["line 1: found the end of the file"]);
    let header = RECORDING.lines().next().unwrap().to_owned() + "\n";
    assert_recording_rejected("header.csv", header.as_bytes(), &["line 2: found the end of the file, expected a row"]);
}

#[test]
fn binary_noise_is_rejected() {
    assert_recording_rejected(
        "noise.csv.gz",
        &[0x1f, 0x8b, 0xff, 0, 1, 2, 3, 4, 5, 6, 7, 8],
        &["line 1: cannot read the line: ", "gzip"],
    );
    assert_recording_rejected("noise.csv", &[0, 0xff, 0xfe, 0x80, 9], &["unknown format, expected ULog, MCAP"]);
}

#[test]
fn truncated_gzip_stream_is_rejected() {
    let stream = gzip(RECORDING);
    let texts = ["found the end of the file inside the compressed data, expected the rest of it; copy the file again"];
    assert_recording_rejected("cut.csv.gz", &stream[..stream.len() / 2], &texts);
}

#[test]
fn missing_recording_is_reported_with_remedy() {
    let system = System::new("");
    let file = system.path("absent.csv");
    let texts = [&*format!("opening the recording {}: No such file", file.display()), "check the path"];
    assert_exits_with(system.command(&["--replay", file.to_str().unwrap()]), 3, &texts);
}

/// Checks that `plumb up` and `plumb config check` reject a launch file with the same message.
fn assert_launch_rejected(launch: &str, texts: &[&str]) {
    let system = System::from_launch(launch);
    let file = system.path("launch.toml");
    let mut check = plumb(&["config", "check", "--launch"]);
    check.arg(&file);
    let path = file.display().to_string();
    let texts: Vec<_> = texts.iter().map(|words| words.replace("launch.toml", &path)).collect();
    let texts: Vec<_> = texts.iter().map(String::as_str).collect();
    let stderr = assert_exits_with(check, 3, &texts);
    assert_eq!(assert_exits_with(system.command(&["--in-process"]), 3, &texts), stderr);
    assert_eq!(assert_exits_with(system.command(&[]), 3, &texts), stderr);
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn unknown_launch_key_is_underlined_with_suggestion() {
    let texts = [
        "unknown key \"bufer_s\"",
        "launch.toml:2:1",
        "2 | bufer_s = 2.0\n  | ^^^^^^^",
        "did you mean \"buffer_s\"?",
        "allowed: \"name\", \"services\", \"buffer_s\"",
        "1 problem",
    ];
    assert_launch_rejected("bufer_s = 2.0\n", &texts);
}

#[test]
fn unknown_stage_is_underlined_with_suggestion() {
    let texts = [
        "fuser.stage: unknown value \"wz-close\"",
        "launch.toml:3:9",
        "3 | stage = \"wz-close\"\n  |         ^^^^^^^^^^",
        "did you mean \"wz-closed\"?",
        "allowed: \"multiple-model\", \"wz\", \"wz-closed\", \"wz-open\"",
    ];
    assert_launch_rejected("[fuser]\nstage = \"wz-close\"\n", &texts);
}

#[test]
fn value_of_wrong_type_is_underlined_with_expected_type() {
    let texts = [
        "ingest.sim.rate_hz: expected a number, found a string",
        "launch.toml:3:11",
        "3 | rate_hz = \"fast\"\n  |           ^^^^^^",
    ];
    assert_launch_rejected("[ingest.sim]\nrate_hz = \"fast\"\n", &texts);
}

#[test]
fn value_out_of_range_is_underlined_with_range() {
    let texts =
        ["ingest.limits.gap_s: expected 0.001 to 10, found -1", "launch.toml:3:9", "3 | gap_s = -1\n  |         ^^"];
    assert_launch_rejected("[ingest.limits]\ngap_s = -1\n", &texts);
}

#[test]
fn all_launch_file_problems_are_shown_together() {
    let launch = "buffer_s = 0\n[gyro]\nstage = \"moebius\"\n[ingest]\nsource = \"simulation\"\n";
    let texts = ["launch.toml:2:12", "launch.toml:4:9", "did you mean \"mobius\"?", "launch.toml:6:10", "3 problems"];
    assert_launch_rejected(launch, &texts);
}

#[test]
fn invalid_toml_is_reported_with_position() {
    assert_launch_rejected("[gyro\n", &["not valid TOML", "launch.toml:2:6"]);
}

#[test]
fn config_check_reports_validity() {
    let system = System::new("[fuser]\nstage = \"wz\"\n");
    let file = system.path("launch.toml");
    assert_exits_with(plumb(&["config", "check", "--launch", file.to_str().unwrap()]), 0, &["launch.toml is valid"]);
    let absent = system.path("absent.toml");
    let texts = [&*format!("reading the launch file {}: No such file", absent.display()), "check that it exists"];
    assert_exits_with(plumb(&["config", "check", "--launch", absent.to_str().unwrap()]), 3, &texts);
    assert_exits_with(plumb(&["up", "--launch", absent.to_str().unwrap()]), 3, &texts);
}

#[test]
fn launch_file_of_repository_is_valid() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("launch.toml");
    assert_exits_with(plumb(&["config", "check", "--launch", file.to_str().unwrap()]), 0, &["is valid"]);
}

#[test]
fn invalid_usage_exits_with_2() {
    assert_exits_with(plumb(&["up", "--sped", "max"]), 2, &["unexpected argument '--sped'", "--speed"]);
    assert_exits_with(plumb(&["up", "mine.toml"]), 2, &["'mine.toml'", "use '--launch mine.toml'"]);
    assert_exits_with(plumb(&["fly"]), 2, &["fly"]);
    assert_exits_with(plumb(&["service", "gryo"]), 2, &["unknown service"]);
    for speed in ["fast", "0", "-1", "nan", "inf"] {
        let texts = ["--speed", "expected `max` or a number from 0.001 to 1000000"];
        assert_exits_with(plumb(&["up", &format!("--speed={speed}")]), 2, &texts);
    }
    for duration in ["soon", "10x", "s", "-1s", "nan", "0s"] {
        assert_exits_with(plumb(&["up", &format!("--for={duration}")]), 2, &["--for", "expected "]);
    }
}

#[test]
fn failing_commands_print_a_json_error() {
    for (arguments, code, texts) in [
        (&["up", "--sped", "max", "--json"][..], 2, "unexpected argument '--sped'"),
        (&["ps", "--system", "no-such-system", "--json"], 1, "no-such-system"),
        (&["shadow", "fusr", "vqf", "--json"], 2, "did you mean `fuser`?"),
        (&["score", "no-such-recording.csv", "--json"], 3, "no-such-recording.csv"),
    ] {
        let output = plumb(arguments).output().unwrap();
        let object: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {object}");
        assert!(object["error"].as_str().is_some_and(|error| error.contains(texts)), "{arguments:?}: {object}");
    }
    assert!(plumb(&["up", "--help", "--json"]).output().unwrap().status.success());
}

#[test]
fn non_finite_parameter_exits_with_2() {
    for value in ["nan", "-inf", "infinity", "1e999", "three", ""] {
        let mut command = plumb(&["swap", "fuser", "madgwick", "--set"]);
        command.arg(format!("beta={value}"));
        assert_exits_with(command, 2, &[&format!("beta={value}"), "expected KEY=VALUE with a finite number"]);
    }
}

#[test]
fn service_started_by_hand_points_to_plumb_up() {
    for service in ["ingest", "gyro", "accel", "fuser", "course"] {
        let texts =
            [&*format!("configuration of service {service} on standard input: "), "start services with `plumb up`"];
        assert_exits_with(plumb(&["service", service]), 1, &texts);
    }
}

#[test]
fn unwritable_output_file_is_named() {
    let system = System::new("");
    let out = system.path("no/such/folder/out.csv");
    for mode in [&[][..], &["--in-process"]] {
        let command = system.command(&[&["--out", out.to_str().unwrap(), "--for", "1s"], mode].concat());
        assert_exits_with(command, 1, &[&format!("writing {}: No such file", out.display())]);
        assert_eq!(system.leftovers(), Vec::<String>::new());
    }
}

fn keys(object: &serde_json::Value) -> Vec<&str> {
    object.as_object().unwrap().keys().map(String::as_str).collect()
}

fn assert_report(output: &Output, has_error: bool) {
    let stdout = text(&output.stdout);
    assert_eq!(stdout.lines().count(), 1, "{stdout}");
    let json: serde_json::Value = serde_json::from_str(&stdout).unwrap();
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
fn json_report_has_documented_keys() {
    let system = System::new("");
    let file = system.path("short.csv");
    fs::write(&file, RECORDING).unwrap();
    let simulation = ["--for", "1s", "--speed", "max"];
    let replay = ["--replay", file.to_str().unwrap(), "--speed", "max"];
    for mode in [&[][..], &["--in-process"]] {
        assert_report(&system.command(&[&simulation, mode].concat()).output().unwrap(), true);
        assert_report(&system.command(&[&replay, mode].concat()).output().unwrap(), false);
    }
}

#[test]
fn stdout_is_empty_without_json() {
    let system = System::new("");
    for mode in [&[][..], &["--in-process"]] {
        let mut command = plumb(&["up", "--launch"]);
        command.arg(system.path("launch.toml")).args(["--for", "1s", "--speed", "max"]).args(mode);
        assert_exits_with(command, 0, &["ticks    1000 in, 1000 out, 0 lost", "digest   "]);
    }
}

/// The system has the default name. With `--in-process` it does not use the bus, so it cannot
/// collide with another system of that name.
#[test]
fn default_launch_file_is_built_in() {
    let empty = tempfile::tempdir().unwrap();
    let mut command = plumb(&["up", "--in-process", "--for", "2s", "--speed", "max"]);
    command.current_dir(empty.path());
    assert_exits_with(command, 0, &["plumbline: simulation s1 at 1000 Hz", "ticks    2000 in, 2000 out, 0 lost"]);
}

#[test]
fn up_without_arguments_runs_local_launch_file() {
    let system = System::new("");
    let mut command = plumb(&["up"]);
    command.current_dir(system.folder.path());
    let running = Running::spawn(command);
    running.all_services();
    wait_for("the bus", || !system.leftovers().is_empty());
    running.interrupt();
    let output = running.output();
    let stderr = text(&output.stderr);
    assert_eq!((output.status.code(), text(&output.stdout)), (Some(0), String::new()), "{stderr}");
    assert!(stderr.contains(&format!("{}: simulation s1", system.name)), "{stderr}");
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

/// Stops a running system. Checks its report, and that no process or file is left behind.
fn assert_stops_cleanly(label: &str, stop: impl Fn(&Running)) {
    let system = System::new("");
    let running = system.start_in_process_group(&[]);
    system.wait_until_running();
    let services = running.all_services();
    stop(&running);
    let stopped = Instant::now();
    let run = running.wait();
    let elapsed = stopped.elapsed();
    println!("{label}: stopped after {} ms", elapsed.as_millis());
    assert!(elapsed < SHUTDOWN_TIMEOUT, "{elapsed:?}");
    run.assert_complete();
    assert!(run.number("/ticks_out") > 0.0, "{}", run.stderr);
    assert!(services.iter().all(|(_, pid)| !is_alive(*pid)), "{services:?}");
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn ctrl_c_stops_system_cleanly() {
    assert_stops_cleanly("Ctrl-C", |running| {
        kill_process_group(Pid::from_raw(running.pid() as i32).unwrap(), Signal::INT).unwrap();
    });
}

#[test]
fn sigterm_stops_system_cleanly() {
    assert_stops_cleanly("SIGTERM", |running| signal(running.pid(), Signal::TERM));
}

#[test]
fn ctrl_c_during_start_leaves_nothing() {
    for delay_ms in (0..40).step_by(2) {
        let system = System::new("");
        let running = system.start_in_process_group(&[]);
        wait_for("the system's name", || !system.leftovers().is_empty());
        std::thread::sleep(Duration::from_millis(delay_ms));
        running.interrupt();
        let stopped = Instant::now();
        let run = running.wait();
        println!("Ctrl-C {delay_ms} ms after the start: stopped after {} ms", stopped.elapsed().as_millis());
        assert_eq!(run.code, Some(0), "{}", run.stderr);
        assert_eq!(system.leftovers(), Vec::<String>::new());
    }
}

#[test]
fn ctrl_c_stops_run_at_max_speed() {
    let system = System::new("");
    let running = system.start_in_process_group(&["--speed", "max"]);
    let services = running.all_services();
    std::thread::sleep(Duration::from_millis(300));
    running.interrupt();
    let run = running.wait();
    run.assert_complete();
    assert!(services.iter().all(|(_, pid)| !is_alive(*pid)), "{services:?}");
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn sigterm_ends_run_whose_output_is_not_read() {
    for blocked_first in [false, true] {
        let system = System::new("");
        let (reader, writer) = std::io::pipe().unwrap();
        let mut filler = writer.try_clone().unwrap();
        rustix::io::ioctl_fionbio(&filler, true).unwrap();
        while std::io::Write::write(&mut filler, b"x").is_ok() {}
        rustix::io::ioctl_fionbio(&filler, false).unwrap();
        let end = if blocked_first { "100ms" } else { "1h" };
        let mut command = system.command(&["--for", end]);
        let mut process = command.stdout(writer).stderr(std::process::Stdio::null()).spawn().unwrap();
        drop(command);
        if blocked_first {
            wait_for("the system to start", || !system.leftovers().is_empty());
            wait_for("the system to end", || system.leftovers().is_empty());
        } else {
            system.wait_until_running();
        }
        signal(process.id(), Signal::TERM);
        wait_for("the process to end", || process.try_wait().unwrap().is_some());
        assert_eq!(system.leftovers(), Vec::<String>::new());
        drop(reader);
    }
}

#[test]
fn pipe_without_writer_does_not_block_the_end() {
    let system = System::new("");
    let pipe = system.path("pipe.csv");
    rustix::fs::mknodat(rustix::fs::CWD, &pipe, rustix::fs::FileType::Fifo, Mode::from(0o600), 0).unwrap();
    let pipe = pipe.to_str().unwrap();
    for arguments in [&["--replay", pipe][..], &["--replay", pipe, "--in-process"]] {
        let run = system.run(arguments);
        assert_eq!(run.code, Some(3), "{}", run.stderr);
        assert!(run.stderr.contains("not a regular file"), "{}", run.stderr);
    }
    // A launch file may be a pipe. The command therefore waits until text arrives in the pipe or a
    // signal ends the command.
    let mut process = crate::common::plumb(&["up", "--launch", pipe]).spawn().unwrap();
    let mut writer = None;
    wait_for("the process to open the pipe", || {
        writer = rustix::fs::open(pipe, OFlags::WRONLY | OFlags::NONBLOCK, Mode::empty()).ok();
        writer.is_some()
    });
    signal(process.id(), Signal::TERM);
    wait_for("the process to end", || process.try_wait().unwrap().is_some());
}

#[test]
fn second_system_of_same_name_is_rejected() {
    let system = System::new("");
    let first = system.start(&[]);
    let services = first.all_services();
    let (pid, name) = (first.pid(), &system.name);
    let texts = [
        &*format!("starting the system {name:?}: a system of this name is already running (process {pid})"),
        &format!("stop it (kill {pid})"),
        "set another `name` in launch.toml",
    ];
    assert_exits_with(system.command(&["--for", "1s"]), 1, &texts);
    assert!(services.iter().all(|(_, pid)| is_alive(*pid)), "{services:?}");
    assert_eq!(first.services(), services);
    system.wait_until_running();
    first.interrupt();
    let run = first.wait();
    run.assert_complete();
    assert!(run.number("/ticks_out") > 0.0);
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn killed_supervisor_leaves_no_process_or_file() {
    let system = System::new("");
    let running = system.start(&[]);
    let services = running.all_services();
    system.wait_until_running();
    signal(running.pid(), Signal::KILL);
    assert_eq!(running.output().status.code(), None);
    wait_for("the services to exit", || services.iter().all(|(_, pid)| !is_alive(*pid)));
    wait_for("the remaining files to be removed", || system.leftovers().is_empty());
    let run = system.run(&["--for", "1s", "--speed", "max"]);
    run.assert_complete();
    assert_eq!(run.number("/ticks_out"), 1000.0);
}

#[test]
fn start_right_after_supervisor_kill_succeeds() {
    let system = System::new("");
    for _ in 0..5 {
        let first = system.start(&[]);
        first.service("course");
        signal(first.pid(), Signal::KILL);
        let run = Run::from_output(system.command(&["--for", "200ms"]).output().unwrap());
        run.assert_complete();
        assert_eq!(run.number("/ticks_out"), 200.0);
        drop(first);
    }
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn output_over_the_recording_is_rejected() {
    let system = System::new("");
    let file = system.path("rec.csv");
    let text = "t_s,gx,gy,gz,ax,ay,az\n0,0,0,0,0,0,9.8\n0.01,0,0,0,0,0,9.8\n";
    fs::write(&file, text).unwrap();
    let name = file.to_str().unwrap();
    let run = Run::from_output(system.command(&["--replay", name, "--out", name]).output().unwrap());
    assert_eq!(run.code, Some(2), "{}", run.stderr);
    assert_eq!(fs::read_to_string(&file).unwrap(), text);
}

#[test]
fn unwritable_stderr_does_not_stop_the_run() {
    let system = System::new("");
    let full = fs::File::options().write(true).open("/dev/full").unwrap();
    let output = system.command(&["--for", "1500ms"]).stderr(full).output().unwrap();
    Run::from_output(output).assert_complete();
}

/// Returns both ends of a pipe that has a full buffer.
fn full_pipe() -> (OwnedFd, OwnedFd) {
    let (reader, writer) = pipe().unwrap();
    fcntl_setfl(&writer, OFlags::NONBLOCK).unwrap();
    while rustix::io::write(&writer, &[b'x'; 4096]).is_ok() {}
    fcntl_setfl(&writer, OFlags::empty()).unwrap();
    (reader, writer)
}

#[test]
fn full_stderr_pipe_does_not_block_shutdown() {
    for mode in [&["--for", "1s"] as &[&str], &["--for", "1s", "--in-process"]] {
        let (_reader, writer) = full_pipe();
        let system = System::new("[ingest.sim]\nrate_hz = 200\n");
        let mut running = Running::spawn_with_stderr(system.command(mode), writer);
        wait_for("the end", || running.has_exited());
        let report: serde_json::Value = serde_json::from_slice(&running.output().stdout).unwrap();
        assert!(report["error"].is_null() && report["ticks_out"].as_u64() > Some(100), "{report}");
    }
}

#[test]
fn pipe_as_output_file_is_rejected() {
    let system = System::new("");
    let pipe = system.path("pipe");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let run = Run::from_output(system.command(&["--out", pipe.to_str().unwrap()]).output().unwrap());
    assert_eq!(run.code, Some(1), "{}", run.stderr);
    let error = run.json["error"].as_str().unwrap();
    assert!(error.contains("is a named pipe") && error.contains("choose a regular file"), "{error}");
    assert!(run.stderr.contains(error), "{}", run.stderr);
}

#[test]
fn duration_yields_exact_tick_count() {
    let system = System::new("");
    for (time, ticks) in [("700ms", 700.0), ("1ms", 1.0), ("2.3s", 2300.0)] {
        let run = system.run(&["--for", time, "--speed", "max", "--in-process"]);
        assert_eq!(run.number("/ticks_out"), ticks);
    }
}
