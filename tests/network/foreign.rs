//! Somebody else's client, in another language and with nothing of ours: reads, asks, commands.
use std::{
    fs,
    io::{BufRead, BufReader, Write},
    path::Path,
    process::{Command, Stdio},
};

use crate::common::{
    Running, System,
    beyond::{endpoint, free_port},
    plumb,
    python::python,
};
use serde_json::Value;

/// The vehicle boat.
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

/// What the client says at each step is as it must be; it goes on from the last one when the vehicle has gone.
fn assert_reads_and_asks(mut client: Command, running: Running, commands: bool) {
    let mut child = client.spawn().unwrap();
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
    if commands {
        let swap = step("swap");
        let [committed, refused] = [1, 2];
        let done = (&swap["outcome"], &swap["lost"], &swap["same"]);
        assert_eq!(done, (&committed.into(), &0.into(), &Value::Bool(true)));
        assert_eq!((&swap["reordered"], &swap["stage"]), (&refused.into(), &"vqf".into()), "{swap}");
    } else {
        assert_eq!(step("unheard")["all"], true);
    }

    running.interrupt();
    running.wait().assert_whole();
    child.stdin.take().unwrap().write_all(b"\n").unwrap();
    assert_eq!(step("went")["all"], true);
    assert!(child.wait().unwrap().success());
}

#[test]
fn a_client_that_knows_nothing_of_us_reads_and_asks_and_commands_nobody_over_plain_tcp() {
    let Some(python) = python() else { return };
    let system = boat(&format!("listen = [\"tcp/127.0.0.1:{}\"]", free_port()));
    let running = system.start(&[]);
    assert_reads_and_asks(client(python, &endpoint(&system), None), running, false);
}

#[test]
fn over_quic_it_commands_as_well_with_a_certificate_and_gets_nothing_without() {
    let Some(python) = python() else { return };
    let keys = tempfile::tempdir().unwrap();
    let of = |party: &str| keys.path().join(party);
    for arguments in [&["init"][..], &["vehicle", "boat", "--host", "127.0.0.1"], &["operator", "ann"]] {
        let made = plumb(&["keys"]).args(arguments).arg("--dir").arg(keys.path()).output().unwrap();
        assert!(made.status.success(), "{made:?}");
    }
    let [ca, cert, key, access] =
        ["ca.pem", "cert.pem", "key.pem", "access.json5"].map(|it| of("vehicle.boat").join(it));
    let port = free_port();
    let system = boat(&format!(
        "listen = [\"quic/127.0.0.1:{port}\"]\naccess = {access:?}\ntls = {{ ca = {ca:?}, cert = {cert:?}, key = {key:?} }}"
    ));
    let running = system.start(&[]);
    let at = endpoint(&system);

    let (operator, bare) = (of("operator.ann"), tempfile::tempdir().unwrap());
    let text = fs::read_to_string(operator.join("ground.json5")).unwrap();
    let kept = |line: &&str| !line.contains("connect_certificate") && !line.contains("connect_private_key");
    let text = text.replace("enable_mtls: true", "enable_mtls: false").replace("client: 40000", "client: 5000");
    fs::write(bare.path().join("ground.json5"), text.lines().filter(kept).collect::<Vec<_>>().join("\n")).unwrap();
    fs::copy(operator.join("ca.pem"), bare.path().join("ca.pem")).unwrap();
    let refused = client(python, &at, Some(bare.path())).stderr(Stdio::piped()).output().unwrap();
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(refused.stdout.is_empty() && said.contains("Unable to connect"), "{refused:?}");

    assert_reads_and_asks(client(python, &at, Some(&operator)), running, true);
}
