//! Third-party client in another language, without any of Plumbline's own code. It reads telemetry
//! and sends queries and commands.
use std::{
    fs,
    io::{BufRead, BufReader, Write},
    path::Path,
    process::{Command, Stdio},
};

use crate::common::{
    Running, System, plumb,
    python::python,
    remote::{endpoint, free_port},
};
use serde_json::Value;

fn boat(gateway: &str) -> System {
    System::new(&format!(
        "services = [\"ingest\", \"gyro\", \"accel\", \"fuser\", \"course\", \"gateway\"]\n[gateway]\nvehicle = \"boat\"\n{gateway}\n"
    ))
}

fn client(python: &Path, endpoint: &str, folder: Option<&Path>) -> Command {
    let mut command = Command::new(python);
    command.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foreign/client.py")).args([endpoint, "boat"]);
    command.args(folder).stdin(Stdio::piped()).stdout(Stdio::piped());
    command
}

/// Checks each step that the client reports, and stops the vehicle before the last step.
fn assert_client_steps(mut client: Command, running: Running, commands: bool) {
    let mut child = client.spawn().unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let mut step = |name: &str| -> Value {
        let line = lines.next().unwrap_or_else(|| panic!("the client exited before `{name}`")).unwrap();
        println!("{line}");
        let step: Value = serde_json::from_str(&line).unwrap();
        assert_eq!(step["step"], name);
        step
    };
    assert_eq!(step("appeared")["all"], true);
    assert_eq!(step("schema")["encoding"], "application/protobuf;google.protobuf.FileDescriptorSet");
    let attitude = step("attitude");
    assert_eq!(attitude["type"], "plumbline.v1.AttitudeOutputBatch");
    assert_eq!((&attitude["complete"], &attitude["unit"]), (&Value::Bool(true), &Value::Bool(true)));
    assert!((attitude["period_ms"].as_f64().unwrap() - 20.0).abs() < 0.01, "50 Hz: {attitude}");
    assert_eq!(step("cached")["newest"], true);
    if commands {
        let swap = step("swap");
        let [committed, rejected] = [1, 2];
        let result = (&swap["outcome"], &swap["lost"], &swap["same"]);
        assert_eq!(result, (&committed.into(), &0.into(), &Value::Bool(true)));
        assert_eq!((&swap["outdated"], &swap["stage"]), (&rejected.into(), &"vqf".into()), "{swap}");
    } else {
        assert_eq!(step("ignored")["all"], true);
    }

    running.interrupt();
    running.wait().assert_complete();
    child.stdin.take().unwrap().write_all(b"\n").unwrap();
    assert_eq!(step("disappeared")["all"], true);
    assert!(child.wait().unwrap().success());
}

#[test]
fn third_party_client_reads_but_cannot_command_over_tcp() {
    let Some(python) = python() else { return };
    let system = boat(&format!("listen = [\"tcp/127.0.0.1:{}\"]", free_port()));
    let running = system.start(&[]);
    assert_client_steps(client(python, &endpoint(&system), None), running, false);
}

#[test]
fn third_party_client_commands_over_quic_with_certificate() {
    let Some(python) = python() else { return };
    let keys = tempfile::tempdir().unwrap();
    let folder_of = |party: &str| keys.path().join(party);
    for arguments in [&["init"][..], &["vehicle", "boat", "--host", "127.0.0.1"], &["operator", "ann"]] {
        let output = plumb(&["keys"]).args(arguments).arg("--dir").arg(keys.path()).output().unwrap();
        assert!(output.status.success(), "{output:?}");
    }
    let [ca, cert, key, access] =
        ["ca.pem", "cert.pem", "key.pem", "access.json5"].map(|file| folder_of("vehicle.boat").join(file));
    let port = free_port();
    let system = boat(&format!(
        "listen = [\"quic/127.0.0.1:{port}\"]\naccess = {access:?}\ntls = {{ ca = {ca:?}, cert = {cert:?}, key = {key:?} }}"
    ));
    let running = system.start(&[]);
    let endpoint = endpoint(&system);

    let (operator, uncertified) = (folder_of("operator.ann"), tempfile::tempdir().unwrap());
    let text = fs::read_to_string(operator.join("ground.json5")).unwrap();
    let is_kept = |line: &&str| !line.contains("connect_certificate") && !line.contains("connect_private_key");
    let text = text.replace("enable_mtls: true", "enable_mtls: false").replace("client: 40000", "client: 5000");
    fs::write(uncertified.path().join("ground.json5"), text.lines().filter(is_kept).collect::<Vec<_>>().join("\n"))
        .unwrap();
    fs::copy(operator.join("ca.pem"), uncertified.path().join("ca.pem")).unwrap();
    let rejected = client(python, &endpoint, Some(uncertified.path())).stderr(Stdio::piped()).output().unwrap();
    let stderr = String::from_utf8_lossy(&rejected.stderr).into_owned();
    assert!(rejected.stdout.is_empty() && stderr.contains("Unable to connect"), "{rejected:?}");

    assert_client_steps(client(python, &endpoint, Some(&operator)), running, true);
}
