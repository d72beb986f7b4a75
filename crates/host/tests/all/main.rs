//! Integration tests of `host` in one executable, with real processes that respond incorrectly.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::time::{Duration, Instant};

use attitude::{
    Vector3,
    accel::Accelerometer,
    stage::{RestoreError, Stage, Validate},
};
use host::{HostError, HostedStage};
use launch::{ExternalStage, Slot};

/// Timeout of programs that respond. Only a heavily loaded machine needs most of it.
const TIMEOUT: Duration = Duration::from_secs(30);
/// Timeout of a program that does not respond.
const HANG_TIMEOUT: Duration = Duration::from_secs(2);

/// Accelerometer stage that stores the number of its steps as its state. The third step causes
/// `fault`.
const PROGRAM: &str = r#"
import os, socket, struct, sys, time
requests, steps, fault = socket.socket(fileno=0), 0.0, sys.argv[1]
while request := requests.recv(16384):
    version, kind, _, number = struct.unpack_from("<HHIQ", request)
    numbers, refused = [], 0
    if kind == 1:
        text = "slot\taccel\nparameter\tgain\t\t1\t0\t2\tFor the test.\n"
        requests.send(struct.pack("<HHIQ", version, 1, 0, number) + text.encode())
        continue
    if kind == 3:
        steps += 1.0
        numbers = [0.0, 0.0, 0.0, *struct.unpack("<3d", request[16:]), steps, 0.5]
        if steps == 3.0:
            # The socket stays open until the process has ended, so that its status is known in time.
            if fault == "dies": os._exit(7)
            if fault == "leaves" and os.fork(): os._exit(7)
            if fault in ("hangs", "leaves"): time.sleep(3600)
            if fault == "forks" and os.fork() == 0: sys.stdin.close(); requests.close(); time.sleep(3600)
            if fault == "shortens": numbers.pop()
            if fault == "lengthens": numbers *= 90
            if fault == "repeats": number -= 1
            if fault == "confuses": kind = 4
            if fault == "ages": version = 9
            if fault == "nan": numbers[6] = float("nan")
            if fault == "refuses": numbers, refused = [], 1
            if fault == "breaks": requests.send(b"?"); continue
    if kind == 4: numbers = [steps]
    if kind == 5:
        state, = struct.unpack("<d", request[16:])
        refused, steps = (1, steps) if state < 0.0 else (0, state)
    if kind == 6: numbers = [0.0, 0.0, 0.0]
    requests.send(struct.pack("<HHIQ", version, kind, refused, number) + struct.pack(f"<{len(numbers)}d", *numbers))
"#;

fn start(fault: &str) -> Result<HostedStage<Accelerometer>, HostError> {
    let command = ["python3", "-c", PROGRAM, fault].map(String::from).into();
    let timeout = if fault == "hangs" { HANG_TIMEOUT } else { TIMEOUT };
    HostedStage::start("own", &ExternalStage { slot: Slot::Accel, command, folder: ".".into() }, timeout)
}

fn steps(stage: &mut HostedStage<Accelerometer>) -> f64 {
    stage.step(&Vector3::zeros()).norm_m_s2
}

#[test]
fn external_stage_implements_the_stage_contract() {
    let mut stage = start("none").unwrap();
    assert_eq!([1, 2, 3].map(|_| steps(&mut stage)), [1.0, 2.0, 3.0]);
    let mut copy = stage.clone();
    assert_eq!((steps(&mut copy), steps(&mut copy), steps(&mut stage)), (4.0, 5.0, 4.0));
    let mut record = copy.snapshot();
    stage.restore(&record).unwrap();
    assert_eq!(steps(&mut stage), 6.0);
    record.values[0] = -1.0;
    record.checksum = record.compute_checksum();
    assert!(matches!(stage.restore(&record), Err(RestoreError::Invalid { .. })));
    assert_eq!((steps(&mut stage), stage.failure().is_none()), (7.0, true));
    assert!(stage.set("gain", 1.5).is_ok() && stage.set("gain", 3.0).is_err() && stage.set("again", 1.0).is_err());
    // Values that are not finite do not reach the program.
    assert_eq!(stage.step(&Vector3::new(f64::NAN, 1.0, 2.0)).force_m_s2, Vector3::zeros());
}

#[test]
fn invalid_response_fails_permanently_with_reason() {
    for (fault, message) in [
        ("dies", "ended with exit status: 7 on the request to step"),
        ("leaves", "ended with exit status: 7 on the request to step"),
        ("hangs", "if it is slow, raise silence_s in [restart]"),
        ("shortens", "the payload has 56 bytes, expected 64"),
        ("lengthens", "the payload has 5760 bytes, expected 64"),
        ("repeats", "the response is to request 4 (Step), expected 5"),
        ("confuses", "(Snapshot), expected"),
        ("ages", "the frame has version 9"),
        ("breaks", "the frame has 1 bytes, expected at least 16"),
    ] {
        let mut stage = start(fault).unwrap();
        assert_eq!([1, 2].map(|_| steps(&mut stage)), [1.0, 2.0], "{fault}");
        let started = Instant::now();
        assert!(stage.step(&Vector3::zeros()).validation_error().is_some(), "{fault}");
        let reason = stage.failure().map(ToString::to_string).unwrap_or_default();
        assert!(reason.contains(message), "{fault}: {reason}");
        // After the failure no request is sent, so nothing blocks.
        let waited = started.elapsed();
        assert!(
            stage.step(&Vector3::zeros()).validation_error().is_some() && stage.restore(&stage.snapshot()).is_err()
        );
        assert!(stage.clone().failure().is_some_and(|copy| copy.to_string() == reason), "{fault}");
        println!("{fault}: {waited:?}");
    }
}

/// Returns the state of a process as in proc(5), or `None` if the process does not exist.
fn process_state(pid: u32) -> Option<String> {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    stat.rsplit_once(") ")?.1.split(' ').next().map(str::to_owned)
}

#[test]
fn processes_started_by_the_program_end_with_it() {
    let mut stage = start("forks").unwrap();
    let program = stage.pid().unwrap();
    assert_eq!([1, 2, 3].map(|_| steps(&mut stage)), [1.0, 2.0, 3.0]);
    let children = std::fs::read_to_string(format!("/proc/{program}/task/{program}/children")).unwrap();
    let forked: u32 = children.trim().parse().unwrap();
    assert!(process_state(forked).is_some());
    drop(stage);
    assert_eq!(process_state(program), None);
    let started = Instant::now();
    // The init process reaps the child. Until then it is a zombie (Z).
    let has_ended = || process_state(forked).is_none_or(|state| state == "Z" || state == "X");
    while !has_ended() && started.elapsed() < Duration::from_secs(10) {
        std::thread::sleep(Duration::from_millis(5));
    }
    assert!(has_ended(), "{forked} still runs");
}

#[test]
fn invalid_output_is_left_to_the_slot() {
    for fault in ["nan", "refuses"] {
        let mut stage = start(fault).unwrap();
        steps(&mut stage);
        steps(&mut stage);
        assert!(stage.step(&Vector3::zeros()).validation_error().is_some() && stage.failure().is_none(), "{fault}");
        assert_eq!(steps(&mut stage), 4.0);
    }
}

#[test]
fn stage_of_another_slot_is_not_started() {
    let mut program = ExternalStage { slot: Slot::Fuser, command: vec!["python3".into()], folder: ".".into() };
    program.command.extend(["-c", PROGRAM, "none"].map(String::from));
    let message = HostedStage::<attitude::fuser::Fuser>::start("own", &program, TIMEOUT).unwrap_err().to_string();
    assert!(message.ends_with("it is a stage of the slot accel, not of fuser"), "{message}");
    program.command = vec!["false".into()];
    let message = HostedStage::<attitude::fuser::Fuser>::start("own", &program, TIMEOUT).unwrap_err().to_string();
    assert!(message.contains("false ended with exit status: 1 on the request to describe itself"), "{message}");
}
