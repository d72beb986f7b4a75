//! Every integration test of `host`, in one executable: real processes that answer as none may.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::time::{Duration, Instant};

use attitude::{
    Vector3,
    accel::Accelerometer,
    stage::{RestoreError, Sound, Stage},
};
use host::{HostError, Hosted};
use launch::{Program, Service};

const LIMIT: Duration = Duration::from_millis(300);

/// An accelerometer stage whose state is one number, the steps so far; at its third step it does `fault`.
const PROGRAM: &str = r#"
import socket, struct, sys, time
requests, steps, fault = socket.socket(fileno=0), 0.0, sys.argv[1]
while request := requests.recv(16384):
    version, kind, _, number = struct.unpack_from("<HHIQ", request)
    numbers, refused = [], 0
    if kind == 1:
        text = "slot\taccel\nparameter\tgain\t\t1\t0\t2\tIt is for the test.\n"
        requests.send(struct.pack("<HHIQ", version, 1, 0, number) + text.encode())
        continue
    if kind == 3:
        steps += 1.0
        numbers = [0.0, 0.0, 0.0, *struct.unpack("<3d", request[16:]), steps, 0.5]
        if steps == 3.0:
            if fault == "dies": sys.exit(7)
            if fault == "hangs": time.sleep(3600)
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

fn start(fault: &str) -> Result<Hosted<Accelerometer>, HostError> {
    let command = ["python3", "-c", PROGRAM, fault].map(String::from).into();
    Hosted::start("own", &Program { slot: Service::Accel, command, folder: ".".into() }, LIMIT)
}

fn steps(stage: &mut Hosted<Accelerometer>) -> f64 {
    stage.step(&Vector3::zeros()).norm_m_s2
}

#[test]
fn a_program_is_a_stage_like_any_other() {
    let mut stage = start("none").unwrap();
    assert_eq!([1, 2, 3].map(|_| steps(&mut stage)), [1.0, 2.0, 3.0]);
    let mut like = stage.clone();
    assert_eq!((steps(&mut like), steps(&mut like), steps(&mut stage)), (4.0, 5.0, 4.0));
    let mut record = like.snapshot();
    stage.restore(&record).unwrap();
    assert_eq!(steps(&mut stage), 6.0);
    record.values[0] = -1.0;
    record.checksum = record.sum();
    assert!(matches!(stage.restore(&record), Err(RestoreError::Flaw { .. })));
    assert_eq!((steps(&mut stage), stage.failure().is_none()), (7.0, true));
    assert!(stage.set("gain", 1.5).is_ok() && stage.set("gain", 3.0).is_err() && stage.set("again", 1.0).is_err());
    // What is not a number is not handed on.
    assert_eq!(stage.step(&Vector3::new(f64::NAN, 1.0, 2.0)).force_m_s2, Vector3::zeros());
}

#[test]
fn what_is_no_answer_is_the_last_and_its_reason_is_told() {
    for (fault, said) in [
        ("dies", "ended with exit status: 7 when it was asked to step"),
        ("hangs", "was asked to step and has said nothing for"),
        ("shortens", "a payload of 56 bytes, expected 64"),
        ("lengthens", "a payload of 5760 bytes, expected 64"),
        ("repeats", "an answer to the request 4 of the kind Step, expected 5"),
        ("confuses", "of the kind Snapshot"),
        ("ages", "frames of version 9"),
        ("breaks", "1 bytes, and a frame has at least 16"),
    ] {
        let mut stage = start(fault).unwrap();
        assert_eq!([1, 2].map(|_| steps(&mut stage)), [1.0, 2.0], "{fault}");
        let begun = Instant::now();
        assert!(stage.step(&Vector3::zeros()).flaw().is_some(), "{fault}");
        let why = stage.failure().map(ToString::to_string).unwrap_or_default();
        assert!(why.contains(said), "{fault}: {why}");
        // From then on nothing is asked and nothing waited for.
        let waited = begun.elapsed();
        assert!(stage.step(&Vector3::zeros()).flaw().is_some() && stage.restore(&stage.snapshot()).is_err());
        assert!(stage.clone().failure().is_some_and(|like| like.to_string() == why), "{fault}");
        println!("{fault}: {waited:?}");
    }
}

#[test]
fn an_output_that_is_none_is_for_the_slot_to_judge() {
    for fault in ["nan", "refuses"] {
        let mut stage = start(fault).unwrap();
        steps(&mut stage);
        steps(&mut stage);
        assert!(stage.step(&Vector3::zeros()).flaw().is_some() && stage.failure().is_none(), "{fault}");
        assert_eq!(steps(&mut stage), 4.0);
    }
}

#[test]
fn what_does_not_describe_a_stage_of_the_slot_is_not_started() {
    let mut program = Program { slot: Service::Fuser, command: vec!["python3".into()], folder: ".".into() };
    program.command.extend(["-c", PROGRAM, "none"].map(String::from));
    let said = Hosted::<attitude::fuser::Fuser>::start("own", &program, LIMIT).unwrap_err().to_string();
    assert!(said.ends_with("answered with `slot accel`, and it is to fill the slot fuser"), "{said}");
    program.command = vec!["false".into()];
    let said = Hosted::<attitude::fuser::Fuser>::start("own", &program, LIMIT).unwrap_err().to_string();
    assert!(said.contains("false ended with exit status: 1 when it was asked to describe itself"), "{said}");
}
