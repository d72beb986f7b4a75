//! Somebody else's client, in another language and with nothing of ours: reads, asks, commands.
use std::{
    io::{BufRead, BufReader, Write},
    net::TcpListener,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use crate::common::{System, plumb, until};
use serde_json::Value;

/// A Python with what the client needs; says why where there is none.
fn python() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("foreign-venv");
    let python = folder.join("bin/python");
    let is_ready = || {
        let check = Command::new(&python).args(["-c", "import zenoh, google.protobuf"]).stderr(Stdio::null()).status();
        check.is_ok_and(|status| status.success())
    };
    if is_ready() {
        return Some(python);
    }
    let run = |command: &mut Command| {
        let output = command.output().map_err(|cause| cause.to_string())?;
        if output.status.success() { Ok(()) } else { Err(String::from_utf8_lossy(&output.stderr).into_owned()) }
    };
    let made = run(Command::new("python3").args(["-m", "venv"]).arg(&folder)).and_then(|()| {
        let packages = ["eclipse-zenoh==1.10.2", "protobuf==7.36.2"];
        run(Command::new(&python).args(["-m", "pip", "install", "--quiet"]).args(packages))
    });
    match made {
        Ok(()) => Some(python),
        Err(cause) => {
            eprintln!("skipped: no Python with eclipse-zenoh and protobuf: {cause}");
            None
        }
    }
}

#[test]
fn a_client_that_knows_nothing_of_us_reads_asks_and_commands() {
    let Some(python) = python() else { return };
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let system = System::new(&format!(
        "services = [\"ingest\", \"gyro\", \"accel\", \"fuser\", \"course\", \"gateway\"]\n[gateway]\nlisten = [\"tcp/127.0.0.1:{port}\"]\n"
    ));
    let running = system.start(&[]);
    let ps = || -> Vec<Value> {
        let output = plumb(&["ps", "--json", "--system", &system.name]).output().unwrap();
        serde_json::from_slice(&output.stdout).unwrap_or_default()
    };
    until("the gateway to listen", || ps().last().is_some_and(|gateway| gateway["at"].is_string()));
    let at = ps().last().unwrap()["at"].as_str().unwrap().to_owned();

    let client = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foreign/client.py");
    let mut child = Command::new(python)
        .arg(client)
        .args([&at, &system.name])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let mut step = |name: &str| -> Value {
        let line = lines.next().unwrap_or_else(|| panic!("the client ended before `{name}`")).unwrap();
        println!("{line}");
        let step: Value = serde_json::from_str(&line).unwrap();
        assert_eq!(step["step"], name);
        step
    };
    assert_eq!(step("came")["all"], true);
    assert_eq!(step("schema")["encoding"], "application/protobuf;google.protobuf.FileDescriptorSet");
    let attitude = step("attitude");
    assert_eq!(attitude["type"], "plumbline.v1.AttitudeOutputBatch");
    assert_eq!((&attitude["whole"], &attitude["unit"]), (&Value::Bool(true), &Value::Bool(true)));
    assert!((attitude["period_ms"].as_f64().unwrap() - 20.0).abs() < 0.01, "50 Hz: {attitude}");
    assert_eq!(step("last")["newest"], true);
    let swap = step("swap");
    let [committed, refused] = [1, 2];
    assert_eq!((&swap["outcome"], &swap["lost"], &swap["same"]), (&committed.into(), &0.into(), &Value::Bool(true)));
    assert_eq!((&swap["reordered"], &swap["stage"]), (&refused.into(), &"vqf".into()), "{swap}");

    running.interrupt();
    running.wait().assert_whole();
    child.stdin.take().unwrap().write_all(b"\n").unwrap();
    assert_eq!(step("went")["all"], true);
    assert!(child.wait().unwrap().success());
}
