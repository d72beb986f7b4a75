//! Beyond the board: what goes out arrives, what comes in has one effect, and nothing out there is felt on board.
use std::{
    fs,
    process::{Child, Stdio},
    thread,
    time::Duration,
};

use crate::common::site::{Site, listening};
use crate::common::{
    Running, System,
    beyond::{endpoint, free_port, gateway, number, ps, seen, station, ticks, topic, with_gateway},
    plumb, signal, until,
};
use link::{Endpoints, Link, LinkError, endpoints::Tls};
use rustix::process::Signal;
use serde_json::Value;
use wire::{
    command::ControlMessage,
    keys,
    v1::{Services, SwapAnswer, SwapRequest, swap_answer::Outcome},
};

const LIMIT: Duration = Duration::from_secs(40);

/// Nothing was lost on the way or on board, and nothing was refused.
fn assert_all_arrived(vehicle: &Value) {
    for topic in vehicle["topics"].as_array().unwrap() {
        for count in ["lost_messages", "lost_samples", "dropped", "repeated"] {
            assert_eq!(number(topic, count), 0, "{topic}");
        }
    }
    assert_eq!(number(vehicle, "rejected"), 0, "{vehicle}");
}

fn end(running: Running) {
    running.interrupt();
    running.wait().assert_whole();
}

#[test]
fn a_station_sees_a_vehicle_and_misses_nothing() {
    let system = with_gateway(free_port(), "");
    let running = system.start(&[]);
    let tables = system.path("tables");
    let endpoint = endpoint(&system);
    let report = seen(station(&[&endpoint], &["--seconds", "4", "--csv", tables.to_str().unwrap()]));
    println!("{report}");
    let vehicle = &report["vehicles"][0];
    assert_eq!((vehicle["vehicle"].as_str(), vehicle["alive"].as_bool()), (Some(system.name.as_str()), Some(true)));
    assert_eq!(vehicle["services"].as_array().unwrap().len(), 6, "{vehicle}");
    assert_all_arrived(vehicle);
    let attitude = topic(vehicle, "attitude");
    let ticks = ticks(&tables.join(&system.name).join("attitude.csv"));
    assert_eq!(ticks.len() as u64, number(attitude, "samples"));
    assert!(ticks.len() > 50 && ticks.windows(2).all(|pair| pair[1] - pair[0] == 20), "50 of 1000 Hz: {ticks:?}");
    assert!(number(topic(vehicle, "health"), "samples") > 10 && number(topic(vehicle, "gateway"), "messages") > 1);
    end(running);
    assert_eq!(system.remains(), Vec::<String>::new());
}

#[test]
fn every_sample_of_a_fast_topic_comes_down_several_to_a_message() {
    let system = with_gateway(
        free_port(),
        "messages_hz = 100\nrates = { attitude = \"all\", imu = \"all\", health = \"off\" }\n",
    );
    let running = system.start(&[]);
    let tables = system.path("tables");
    let report = seen(station(&[&endpoint(&system)], &["--seconds", "4", "--csv", tables.to_str().unwrap()]));
    let vehicle = &report["vehicles"][0];
    println!("{vehicle}");
    assert_all_arrived(vehicle);
    for name in ["imu", "attitude"] {
        let topic = topic(vehicle, name);
        assert!(number(topic, "samples") > 5 * number(topic, "messages"), "{topic}");
        let ticks = ticks(&tables.join(&system.name).join(format!("{name}.csv")));
        assert!(ticks.len() > 1000 && ticks.windows(2).all(|pair| pair[1] == pair[0] + 1), "{name}: a tick is missing");
    }
    assert!(vehicle["topics"].as_array().unwrap().iter().all(|topic| topic["topic"] != "health"));
    end(running);
}

#[test]
fn two_vehicles_on_one_machine_take_two_ports_and_are_seen_together() {
    let port = free_port();
    let systems = [with_gateway(port, "vehicle = \"boat\""), with_gateway(port, "vehicle = \"buoy\"")];
    let running = systems.each_ref().map(|system| {
        let running = system.start(&[]);
        endpoint(system);
        running
    });
    let [one, other] = systems.each_ref().map(endpoint);
    assert_ne!(one, other);
    let report = seen(station(&[&one, &other], &["--seconds", "3"]));
    let names: Vec<_> =
        report["vehicles"].as_array().unwrap().iter().map(|one| one["vehicle"].as_str().unwrap()).collect();
    assert_eq!(names, ["boat", "buoy"], "{report}");
    report["vehicles"].as_array().unwrap().iter().for_each(assert_all_arrived);
    running.into_iter().for_each(end);
}

fn services(link: &Link, vehicle: &str) -> Services {
    link.query_one(&keys::key(vehicle, keys::SERVICES), Vec::new(), LIMIT).unwrap()
}

fn epoch(services: &Services) -> u32 {
    services.services.iter().find(|one| one.service == "fuser").unwrap().epoch
}

#[test]
fn a_swap_from_elsewhere_has_one_effect_however_often_late_or_out_of_order_it_comes() {
    let site = Site::new(&[&["vehicle", "alpha", "--host", "127.0.0.1"], &["operator", "ann"]]);
    let system = listening(&site, free_port());
    let running = system.start(&[]);
    let endpoint = endpoint(&system);
    until("the fuser to run", || ps(&system).iter().filter(|one| one["state"] == "running").count() == 6);

    let operator = site.of("operator.ann");
    let remote = ["--remote", "alpha", "--connect", &endpoint, "--json", "--keys", operator.to_str().unwrap()];
    let output = plumb(&["swap", "fuser", "vqf"]).args(remote).output().unwrap();
    let report: Value = serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{output:?}"));
    assert_eq!((report["outcome"].as_str(), report["lost"].as_u64()), (Some("committed"), Some(0)), "{report}");
    let output = plumb(&["ps"]).args(remote).output().unwrap();
    let standings: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(standings[3]["stage"], "vqf", "{standings}");

    let [ca, cert, key] = ["ca.pem", "cert.pem", "key.pem"].map(|file| operator.join(file));
    let ends = Endpoints { tls: Some(Tls { ca, cert, key }), ..Endpoints::with_connect(&[endpoint]) };
    let link = Link::connect(&ends, LIMIT).unwrap();
    let before = services(&link, "alpha");
    let request = |id: &str, stage: &str| SwapRequest {
        request_id: id.into(),
        slot: "fuser".into(),
        stage: stage.into(),
        expected_epoch: epoch(&before),
        t_deadline_ns: before.t_now_ns + 30_000_000_000,
        ..SwapRequest::default()
    };
    let ask = |request: &SwapRequest| -> SwapAnswer {
        link.query_one(&keys::key("alpha", keys::SWAP), request.to_bytes(), LIMIT).unwrap()
    };
    // The same one many times at once, as a network does that is not sure.
    let answers: Vec<SwapAnswer> = thread::scope(|scope| {
        let asking: Vec<_> = (0..4).map(|_| scope.spawn(|| ask(&request("one", "wz")))).collect();
        asking.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    assert_eq!(answers[0].outcome(), Outcome::Committed, "{answers:?}");
    assert!(answers.iter().all(|answer| *answer == answers[0]), "{answers:?}");
    let after = services(&link, "alpha");
    assert_eq!(epoch(&after), epoch(&before) + 1, "one decision");
    // One that was sent before that decision, and one that comes after its time.
    let overtaken = ask(&request("two", "vqf"));
    assert_eq!(overtaken.outcome(), Outcome::Refused);
    assert!(overtaken.reason.contains("the epoch of `fuser` is"), "{overtaken:?}");
    let late = SwapRequest { t_deadline_ns: after.t_now_ns, expected_epoch: epoch(&after), ..request("three", "vqf") };
    assert!(ask(&late).reason.contains("after its deadline"));
    let wrong = SwapRequest { expected_epoch: epoch(&after), ..request("four", "kalman") };
    assert!(ask(&wrong).reason.contains("no stage named `kalman`"));
    // What is no request is refused, counted, and whoever asked reads why.
    let refused = |payload: Vec<u8>, why: &str| {
        let key = keys::key("alpha", keys::SWAP);
        let error = link.query_one::<SwapAnswer>(&key, payload, LIMIT).unwrap_err();
        assert!(matches!(&error, LinkError::Rejected { reason, .. } if reason.contains(why)), "{error}");
    };
    refused(vec![0xff; 100], "cannot decode SwapRequest");
    refused(
        SwapRequest { set: [("beta".into(), f64::NAN)].into(), ..request("five", "madgwick") }.to_bytes(),
        "`set` is not finite",
    );
    until("the refusal in its health", || {
        let report = link.query_one::<wire::v1::GatewayReport>(&keys::key("alpha", keys::GATEWAY), Vec::new(), LIMIT);
        report
            .is_ok_and(|report| report.refused.is_some_and(|refused| (refused.malformed, refused.not_finite) == (1, 1)))
    });
    assert_eq!(epoch(&services(&link, "alpha")), epoch(&after));
    end(running);
}

#[test]
fn a_supervisor_that_is_frozen_is_not_waited_for_and_whoever_asks_is_told_so() {
    let system = with_gateway(free_port(), "");
    let running = system.start(&[]);
    let endpoint = endpoint(&system);
    system.all_run();
    signal(running.pid(), Signal::STOP);
    let (here, elsewhere) = (["--system", &system.name], ["--remote", &system.name, "--connect", &endpoint]);
    for (arguments, place) in [
        (&["ps"][..], &here[..]),
        (&["ps"], &elsewhere),
        (&["swap", "fuser", "vqf"], &here),
        (&["swap", "fuser", "vqf"], &elsewhere),
        (&["shadow", "fuser", "vqf"], &here),
    ] {
        let output = plumb(&[arguments, place].concat()).output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {said}");
        assert!(said.contains("has not responded for 2 s"), "{arguments:?}: {said}");
    }
    let output = plumb(&["doctor", "--seconds", "0.1", "--json"]).args(here).output().unwrap();
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(said.contains("has been stopped") && said.contains("kill -CONT"), "{said}");
    signal(running.pid(), Signal::CONT);
    until("the supervisor to answer", || ps(&system).len() == 6);
    running.interrupt();
    // It was frozen for longer than a topic holds.
    let run = running.wait();
    assert_eq!((run.code, run.number("/lost")), (Some(1), 0.0), "{}", run.people);
    assert!(run.number("/not_recorded") > 0.0, "{}", run.people);
    assert_eq!(system.remains(), Vec::<String>::new());
}

#[test]
fn a_gateway_that_is_killed_again_and_again_is_not_missed_on_board() {
    let system = with_gateway(free_port(), "");
    let out = system.path("out.csv");
    let running = system.start(&["--out", out.to_str().unwrap()]);
    endpoint(&system);
    for kill in 1..=3 {
        signal(gateway(&system).unwrap()["pid"].as_u64().unwrap() as u32, Signal::KILL);
        until("the next gateway", || {
            gateway(&system).is_some_and(|one| one["restarts"] == kill && one["address"].is_string())
        });
    }
    system.assert_ends_undisturbed(running, &out, "");
}

#[test]
fn a_gateway_that_was_to_be_woken_and_is_frozen_is_not_missed_on_board() {
    let slow = "[ingest.sim]\nrate_hz = 100\n";
    let system = with_gateway(free_port(), slow);
    let out = system.path("out.csv");
    let running = system.start(&["--for", "8s", "--out", out.to_str().unwrap()]);
    let endpoint = endpoint(&system);
    let report = seen(station(&[&endpoint], &["--seconds", "2"]));
    assert!(number(topic(&report["vehicles"][0], "attitude"), "samples") > 0, "{report}");
    let pid = gateway(&system).unwrap()["pid"].as_u64().unwrap() as u32;
    signal(pid, Signal::STOP);
    let run = running.wait();
    run.assert_whole();
    assert!(fs::read(out).unwrap() == undisturbed_with(slow, "8s"), "the bytes differ: {}", run.people);
}

fn undisturbed(duration: &str) -> Vec<u8> {
    undisturbed_with("", duration)
}

fn undisturbed_with(launch: &str, duration: &str) -> Vec<u8> {
    let system = System::new(launch);
    let out = system.path("out.csv");
    system.run(&["--in-process", "--speed", "max", "--for", duration, "--out", out.to_str().unwrap()]).assert_whole();
    fs::read(out).unwrap()
}

/// A station of the test, which goes when the test does.
struct Watching(Option<Child>);

impl Watching {
    fn signal(&self, how: Signal) {
        signal(self.0.as_ref().unwrap().id(), how);
    }

    /// Ends it as Ctrl-C does; what it has seen.
    fn end(mut self) -> Value {
        self.signal(Signal::INT);
        let output = self.0.take().unwrap().wait_with_output().unwrap();
        serde_json::from_slice(&output.stdout).unwrap()
    }
}

impl Drop for Watching {
    fn drop(&mut self) {
        if let Some(child) = &mut self.0 {
            child.kill().unwrap();
            child.wait().unwrap();
        }
    }
}

#[test]
fn readers_that_do_not_read_and_ends_that_do_not_answer_are_not_felt_on_board() {
    let rates = "rates = { imu = \"all\", gyro = \"all\", accel = \"all\", fused = \"all\", attitude = \"all\", checkpoint = \"all\" }";
    let nobody = free_port();
    let system = with_gateway(free_port(), &format!("connect = [\"tcp/127.0.0.1:{nobody}\"]\n{rates}\n"));
    let (out, tables) = (system.path("out.csv"), system.path("tables"));
    let running = system.start(&["--for", "14s", "--out", out.to_str().unwrap()]);
    let endpoint = endpoint(&system);
    let mut command = station(&[&endpoint], &["--csv", tables.to_str().unwrap()]);
    let blocked = Watching(Some(command.stdout(Stdio::piped()).spawn().unwrap()));
    thread::sleep(Duration::from_secs(2));
    blocked.signal(Signal::STOP);
    // Another one sees all the while what there is.
    let report = seen(station(&[&endpoint], &["--seconds", "7"]));
    assert!(number(topic(&report["vehicles"][0], "attitude"), "samples") > 0, "{report}");
    blocked.signal(Signal::CONT);
    let run = running.wait();
    run.assert_whole();
    assert!(fs::read(out).unwrap() == undisturbed("14s"), "the bytes differ: {}", run.people);
    // What the one that slept has missed is what the numbers say that it has missed.
    let report = blocked.end();
    println!("{report}");
    for name in ["imu", "attitude"] {
        let topic = topic(&report["vehicles"][0], name);
        let ticks = ticks(&tables.join(&system.name).join(format!("{name}.csv")));
        let (first, last) = (*ticks.first().unwrap(), *ticks.last().unwrap());
        let missing = last + 1 - first - ticks.len() as u64;
        // What was dropped before it came, while the gateway opened the network, it does not miss.
        let lost = number(topic, "lost_samples");
        assert!((lost..=lost + number(topic, "dropped")).contains(&missing), "{missing}: {topic}");
    }
}

#[test]
fn a_station_that_finds_nobody_says_where_it_looked() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let output = plumb(&["ps", "--remote", "boat", "--connect", &endpoint]).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains(&endpoint) && said.contains("no process listens there"), "{said}");
}
