//! Telemetry and commands through the gateway. Off-board faults must not affect the system on
//! board.
use std::{
    fs,
    path::Path,
    process::{Child, Stdio},
    thread,
    time::Duration,
};

use crate::common::site::{Site, listening_vehicle};
use crate::common::{
    Running, System, plumb,
    remote::{endpoint, free_port, gateway, last_json, number, ps, station, ticks, topic, with_gateway},
    signal, wait_for,
};
use link::{Endpoints, Link, LinkError, endpoints::Tls};
use rustix::process::Signal;
use serde_json::Value;
use wire::{
    command::ControlMessage,
    keys,
    v1::{Services, SwapAnswer, SwapRequest, swap_answer::Outcome},
};

const QUERY_TIMEOUT: Duration = Duration::from_secs(40);

/// Asserts that no message was lost, dropped, repeated or rejected.
fn assert_lossless(vehicle: &Value) {
    for topic in vehicle["topics"].as_array().unwrap() {
        for count in ["lost_messages", "lost_samples", "dropped", "repeated"] {
            assert_eq!(number(topic, count), 0, "{topic}");
        }
    }
    assert_eq!(number(vehicle, "rejected"), 0, "{vehicle}");
}

fn stop(running: Running) {
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn station_receives_all_telemetry_of_vehicle() {
    let system = with_gateway(free_port(), "");
    let running = system.start(&[]);
    system.wait_until_running();
    let tables = system.path("tables");
    let endpoint = endpoint(&system);
    let report = last_json(station(&[&endpoint], &["--for", "4", "--csv", tables.to_str().unwrap()]));
    println!("{report}");
    let vehicle = &report["vehicles"][0];
    assert_eq!((vehicle["vehicle"].as_str(), vehicle["alive"].as_bool()), (Some(system.name.as_str()), Some(true)));
    assert_eq!(vehicle["services"].as_array().unwrap().len(), 6, "{vehicle}");
    assert_lossless(vehicle);
    let attitude = topic(vehicle, "attitude");
    let ticks = ticks(&tables.join(&system.name).join("attitude.csv"));
    assert_eq!(ticks.len() as u64, number(attitude, "samples"));
    assert!(ticks.len() > 50 && ticks.windows(2).all(|pair| pair[1] - pair[0] == 20), "50 of 1000 Hz: {ticks:?}");
    assert!(number(topic(vehicle, "health"), "samples") > 10 && number(topic(vehicle, "gateway"), "messages") > 1);
    stop(running);
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn rate_all_batches_every_sample_of_fast_topic() {
    let system = with_gateway(
        free_port(),
        "messages_hz = 100\nrates = { attitude = \"all\", imu = \"all\", health = \"off\" }\n",
    );
    let running = system.start(&[]);
    system.wait_until_running();
    let tables = system.path("tables");
    let report = last_json(station(&[&endpoint(&system)], &["--for", "4", "--csv", tables.to_str().unwrap()]));
    let vehicle = &report["vehicles"][0];
    println!("{vehicle}");
    assert_lossless(vehicle);
    for name in ["imu", "attitude"] {
        let topic = topic(vehicle, name);
        assert!(number(topic, "samples") > 5 * number(topic, "messages"), "{topic}");
        let ticks = ticks(&tables.join(&system.name).join(format!("{name}.csv")));
        assert!(ticks.len() > 1000 && ticks.windows(2).all(|pair| pair[1] == pair[0] + 1), "{name}: a tick is missing");
    }
    assert!(vehicle["topics"].as_array().unwrap().iter().all(|topic| topic["topic"] != "health"));
    stop(running);
}

#[test]
fn vehicles_on_one_machine_use_separate_ports() {
    let port = free_port();
    let systems = [with_gateway(port, "vehicle = \"boat\""), with_gateway(port, "vehicle = \"buoy\"")];
    let running = systems.each_ref().map(|system| {
        let running = system.start(&[]);
        system.wait_until_running();
        running
    });
    let [first, second] = systems.each_ref().map(endpoint);
    assert_ne!(first, second);
    let report = last_json(station(&[&first, &second], &["--for", "3"]));
    let names: Vec<_> =
        report["vehicles"].as_array().unwrap().iter().map(|entry| entry["vehicle"].as_str().unwrap()).collect();
    assert_eq!(names, ["boat", "buoy"], "{report}");
    report["vehicles"].as_array().unwrap().iter().for_each(assert_lossless);
    running.into_iter().for_each(stop);
}

fn services(link: &Link, vehicle: &str) -> Services {
    link.query_one(&keys::key(vehicle, keys::SERVICES), Vec::new(), QUERY_TIMEOUT).unwrap()
}

fn epoch(services: &Services) -> u32 {
    services.services.iter().find(|entry| entry.service == "fuser").unwrap().epoch
}

#[test]
fn repeated_remote_swap_takes_effect_once() {
    let site = Site::new(&[&["vehicle", "alpha", "--host", "127.0.0.1"], &["operator", "ann"]]);
    let system = listening_vehicle(&site, free_port());
    let running = system.start(&[]);
    let endpoint = endpoint(&system);
    wait_for("every service to run", || ps(&system).iter().filter(|entry| entry["state"] == "running").count() == 6);

    let operator = site.holder_folder("operator.ann");
    let remote = ["--remote", "alpha", "--connect", &endpoint, "--json", "--keys", operator.to_str().unwrap()];
    let output = plumb(&["swap", "fuser", "vqf"]).args(remote).output().unwrap();
    let report: Value = serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{output:?}"));
    assert_eq!((report["outcome"].as_str(), report["lost"].as_u64()), (Some("committed"), Some(0)), "{report}");
    let output = plumb(&["ps"]).args(remote).output().unwrap();
    let services_report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(services_report["services"][3]["stage"], "vqf", "{services_report}");

    let [ca, cert, key] = ["ca.pem", "cert.pem", "key.pem"].map(|file| operator.join(file));
    let endpoints = Endpoints { tls: Some(Tls { ca, cert, key }), ..Endpoints::with_connect(&[endpoint]) };
    let link = Link::connect(&endpoints, QUERY_TIMEOUT).unwrap();
    let before = services(&link, "alpha");
    let request = |id: &str, stage: &str| SwapRequest {
        request_id: id.into(),
        slot: "fuser".into(),
        stage: stage.into(),
        expected_epoch: epoch(&before),
        t_deadline_ns: before.t_now_ns + 30_000_000_000,
        ..SwapRequest::default()
    };
    let swap = |request: &SwapRequest| -> SwapAnswer {
        link.query_one(&keys::key("alpha", keys::SWAP), request.to_bytes(), QUERY_TIMEOUT).unwrap()
    };
    // Simulates a network that duplicates requests.
    let answers: Vec<SwapAnswer> = thread::scope(|scope| {
        let threads: Vec<_> = (0..4).map(|_| scope.spawn(|| swap(&request("one", "wz")))).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    assert_eq!(answers[0].outcome(), Outcome::Committed, "{answers:?}");
    assert!(answers.iter().all(|answer| *answer == answers[0]), "{answers:?}");
    let after = services(&link, "alpha");
    assert_eq!(epoch(&after), epoch(&before) + 1, "expected one decision");
    // Request `two` is refused, because the decision on request `one` has changed the epoch that
    // `two` expects. Request `three` is refused, because its deadline has passed.
    let overtaken = swap(&request("two", "vqf"));
    assert_eq!(overtaken.outcome(), Outcome::Refused);
    assert!(overtaken.reason.contains("the epoch of `fuser` is"), "{overtaken:?}");
    let late = SwapRequest { t_deadline_ns: after.t_now_ns, expected_epoch: epoch(&after), ..request("three", "vqf") };
    assert!(swap(&late).reason.contains("after its deadline"));
    let wrong = SwapRequest { expected_epoch: epoch(&after), ..request("four", "kalman") };
    assert!(swap(&wrong).reason.contains("no stage named `kalman`"));
    // Invalid requests are rejected with a reason and counted.
    let assert_rejected = |payload: Vec<u8>, reason_part: &str| {
        let key = keys::key("alpha", keys::SWAP);
        let error = link.query_one::<SwapAnswer>(&key, payload, QUERY_TIMEOUT).unwrap_err();
        assert!(matches!(&error, LinkError::Rejected { reason, .. } if reason.raw().contains(reason_part)), "{error}");
    };
    assert_rejected(vec![0xff; 100], "cannot decode SwapRequest");
    assert_rejected(
        SwapRequest { set: [("beta".into(), f64::NAN)].into(), ..request("five", "madgwick") }.to_bytes(),
        "`set` is not finite",
    );
    wait_for("the rejections in the gateway's report", || {
        let report =
            link.query_one::<wire::v1::GatewayReport>(&keys::key("alpha", keys::GATEWAY), Vec::new(), QUERY_TIMEOUT);
        report
            .is_ok_and(|report| report.refused.is_some_and(|refused| (refused.malformed, refused.not_finite) == (1, 1)))
    });
    assert_eq!(epoch(&services(&link, "alpha")), epoch(&after));
    stop(running);
}

#[test]
fn frozen_supervisor_is_reported_to_clients() {
    let system = with_gateway(free_port(), "");
    let running = system.start(&[]);
    let endpoint = endpoint(&system);
    system.wait_until_running();
    signal(running.pid(), Signal::STOP);
    let (local, remote) = (["--system", &system.name], ["--remote", &system.name, "--connect", &endpoint]);
    for (arguments, target) in [
        (&["ps"][..], &local[..]),
        (&["ps"], &remote),
        (&["swap", "fuser", "vqf"], &local),
        (&["swap", "fuser", "vqf"], &remote),
        (&["shadow", "fuser", "vqf"], &local),
    ] {
        let output = plumb(&[arguments, target].concat()).output().unwrap();
        let text = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {text}");
        assert!(text.contains("has not responded for 2 s"), "{arguments:?}: {text}");
    }
    let output = plumb(&["doctor", "--for", "0.1", "--json"]).args(local).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("has been stopped") && text.contains("kill -CONT"), "{text}");
    signal(running.pid(), Signal::CONT);
    wait_for("the supervisor to respond", || ps(&system).len() == 6);
    running.interrupt();
    // The supervisor was frozen for longer than the attitude topic can buffer, so some attitudes
    // were not recorded.
    let run = running.wait();
    assert_eq!((run.code, run.number("/lost")), (Some(1), 0.0), "{}", run.stderr);
    assert!(run.number("/not_recorded") > 0.0, "{}", run.stderr);
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn repeatedly_killed_gateway_does_not_affect_output() {
    let system = with_gateway(free_port(), "");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    endpoint(&system);
    for kill in 1..=3 {
        signal(gateway(&system).unwrap()["pid"].as_u64().unwrap() as u32, Signal::KILL);
        wait_for("the next gateway", || {
            gateway(&system).is_some_and(|entry| entry["restarts"] == kill && entry["address"].is_string())
        });
    }
    system.stop_and_assert_undisturbed(running, &out, "");
}

#[test]
fn frozen_gateway_does_not_affect_output() {
    let slow = "[ingest.sim]\nrate_hz = 100\n";
    let system = with_gateway(free_port(), slow);
    let out = system.path("out.csv");
    let running = system.start(&["--for", "16s", "--out", out.to_str().unwrap()]);
    let endpoint = endpoint(&system);
    let report = last_json(station(&[&endpoint], &["--for", "2"]));
    assert!(number(topic(&report["vehicles"][0], "attitude"), "samples") > 0, "{report}");
    let pid = gateway(&system).unwrap()["pid"].as_u64().unwrap() as u32;
    signal(pid, Signal::STOP);
    let run = running.wait();
    run.assert_complete();
    assert!(fs::read(out).unwrap() == undisturbed_with(slow, "16s"), "the bytes differ: {}", run.stderr);
}

fn undisturbed_with(launch: &str, duration: &str) -> Vec<u8> {
    let system = System::new(launch);
    let out = system.path("out.csv");
    system
        .run(&["--in-process", "--speed", "max", "--for", duration, "--out", out.to_str().unwrap()])
        .assert_complete();
    fs::read(out).unwrap()
}

/// Returns the tick of the last complete line of a table, or `None` before the first one.
fn last_tick(table: &Path) -> Option<u64> {
    let text = fs::read_to_string(table).ok()?;
    let (lines, _) = text.rsplit_once('\n')?;
    lines.lines().last()?.split(',').next()?.parse().ok()
}

/// Station process that is killed on drop.
struct StationProcess(Option<Child>);

impl StationProcess {
    fn signal(&self, kind: Signal) {
        signal(self.0.as_ref().unwrap().id(), kind);
    }

    /// Interrupts the station and returns its report.
    fn stop(mut self) -> Value {
        self.signal(Signal::INT);
        let output = self.0.take().unwrap().wait_with_output().unwrap();
        serde_json::from_slice(&output.stdout).unwrap()
    }
}

impl Drop for StationProcess {
    fn drop(&mut self) {
        if let Some(child) = &mut self.0 {
            child.kill().unwrap();
            child.wait().unwrap();
        }
    }
}

#[test]
fn stalled_station_and_dead_endpoint_do_not_affect_output() {
    let rates = "rates = { imu = \"all\", gyro = \"all\", accel = \"all\", fused = \"all\", attitude = \"all\", checkpoint = \"all\" }";
    let unused_port = free_port();
    let system = with_gateway(free_port(), &format!("connect = [\"tcp/127.0.0.1:{unused_port}\"]\n{rates}\n"));
    let (out, tables) = (system.path("out.csv"), system.path("tables"));
    let running = system.start(&["--out", out.to_str().unwrap()]);
    let endpoint = endpoint(&system);
    let mut command = station(&[&endpoint], &["--csv", tables.to_str().unwrap()]);
    let stalled = StationProcess(Some(command.stdout(Stdio::piped()).spawn().unwrap()));
    let attitudes = tables.join(&system.name).join("attitude.csv");
    wait_for("attitudes of the station", || last_tick(&attitudes).is_some());
    stalled.signal(Signal::STOP);
    // A second station receives telemetry in the meantime.
    let report = last_json(station(&[&endpoint], &["--for", "7"]));
    let tick = number(&report["vehicles"][0]["attitude"], "tick");
    stalled.signal(Signal::CONT);
    wait_for("attitudes after the stall", || last_tick(&attitudes) > Some(tick));
    system.stop_and_assert_undisturbed(running, &out, "");
    // The counts reported by the stalled station match the ticks missing from its tables.
    let report = stalled.stop();
    println!("{report}");
    for name in ["imu", "attitude"] {
        let topic = topic(&report["vehicles"][0], name);
        let ticks = ticks(&tables.join(&system.name).join(format!("{name}.csv")));
        let (first, last) = (*ticks.first().unwrap(), *ticks.last().unwrap());
        let missing = last + 1 - first - ticks.len() as u64;
        // Samples dropped while the gateway was connecting precede the first tick in the table, so
        // they do not count as missing.
        let lost = number(topic, "lost_samples");
        assert!((lost..=lost + number(topic, "dropped")).contains(&missing), "{missing}: {topic}");
    }
}

#[test]
fn unreachable_vehicle_error_contains_endpoint() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let output = plumb(&["ps", "--remote", "boat", "--connect", &endpoint]).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(text.contains(&endpoint) && text.contains("no process listens there"), "{text}");
}
