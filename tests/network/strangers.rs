//! Who shows no certificate looks, and can neither speak as the vehicle nor command it, nor take its memory or everybody's place.
use std::{
    fs,
    net::TcpStream,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use crate::common::{
    Run, Running, System,
    beyond::{endpoint, free_port, gateway, number, ps, seen, station, topic, with_gateway},
    plumb,
    site::Site,
    until,
};
use link::MAX_SESSIONS;
use wire::{command::ControlMessage, v1::SwapRequest};
use zenoh::{
    Config, Session, Wait,
    qos::{CongestionControl, Priority},
};

/// The idle connections of an attack that was seen.
const IDLE: usize = 1200;
/// What a gateway under attack may have in memory, KiB.
const MAX_MEMORY_KIB: u64 = 64 * 1024;

/// Somebody with nothing of ours.
fn stranger(endpoint: &str, mode: &str) -> Session {
    let mut config = Config::default();
    for (key, value) in [
        ("mode", format!("{mode:?}")),
        ("connect/endpoints", format!("[{endpoint:?}]")),
        ("listen/endpoints", "[]".into()),
        ("scouting/multicast/enabled", "false".into()),
        ("connect/timeout_ms", "60000".into()),
        ("connect/exit_on_failure", "true".into()),
    ] {
        config.insert_json5(key, &value).unwrap();
    }
    zenoh::open(config).wait().unwrap()
}

fn end(running: Running) -> Run {
    running.interrupt();
    let run = running.wait();
    run.assert_whole();
    run
}

fn fuser(system: &System) -> String {
    ps(system)
        .into_iter()
        .find(|one| one["service"] == "fuser")
        .map(|one| format!("{} {}", one["stage"], one["epoch"]))
        .unwrap()
}

#[test]
fn a_stranger_looks_and_neither_speaks_as_the_vehicle_nor_commands_it() {
    let system = with_gateway(free_port(), "");
    let running = system.start(&[]);
    let endpoint = endpoint(&system);
    until("every service to run", || ps(&system).iter().filter(|one| one["state"] == "running").count() == 6);
    let key = |rest: &str| format!("plumbline/v1/{}/{rest}", system.name);
    let before = fuser(&system);

    // A client, as a peer that the gateway is connected to would hand on what it puts to nobody but the gateway.
    let (reader, heard) = (stranger(&endpoint, "client"), Arc::new(Mutex::new(Vec::new())));
    let _subscriber = reader.declare_subscriber("plumbline/v1/**").callback({
        let heard = heard.clone();
        move |sample| {
            heard.lock().unwrap().push((sample.key_expr().to_string(), sample.payload().to_bytes().into_owned()))
        }
    });
    let _subscriber = _subscriber.wait().unwrap();
    let forgers = ["client", "peer"].map(|mode| stranger(&endpoint, mode));
    let forged = || b"forged".to_vec();
    let ask = |session: &Session, key: &str, payload: Vec<u8>| -> Vec<Vec<u8>> {
        let replies = session.get(key).payload(payload).timeout(Duration::from_secs(20)).wait().unwrap();
        replies.iter().filter_map(|reply| Some(reply.result().ok()?.payload().to_bytes().into_owned())).collect()
    };
    let request = SwapRequest {
        request_id: "forged".into(),
        slot: "fuser".into(),
        stage: "vqf".into(),
        expected_epoch: 1,
        t_deadline_ns: runtime::clock::monotonic_ns() + 30_000_000_000,
        ..SwapRequest::default()
    };
    let mut declared = Vec::new();
    for forger in &forgers {
        for rest in ["attitude", "health", "gateway", "command/swap"] {
            forger.put(key(rest), forged()).wait().unwrap();
            forger.delete(key(rest)).wait().unwrap();
        }
        for command in [key("command/swap"), key("**"), "plumbline/v1/*/command/*".into()] {
            assert_eq!(ask(forger, &command, request.to_bytes()), Vec::<Vec<u8>>::new(), "{command}");
        }
        let token = forger.liveliness().declare_token(key("@live/ghost")).wait().unwrap();
        let answering = forger.declare_queryable(key("services")).callback({
            let key = key("services");
            move |query| drop(query.reply(key.clone(), b"forged".to_vec()).wait())
        });
        declared.push((token, answering.wait().unwrap()));
    }
    let attitudes = || heard.lock().unwrap().iter().filter(|(heard, _)| *heard == key("attitude")).count();
    let came = attitudes();
    until("attitudes of the vehicle", || attitudes() > came + 50);
    for (key, bytes) in heard.lock().unwrap().iter() {
        assert!(!bytes.is_empty() && *bytes != forged(), "{key} was forged");
    }
    let services = ask(&reader, &key("services"), Vec::new());
    assert!(services.len() == 1 && services[0] != forged(), "{services:?}");
    let living = reader.liveliness().get("plumbline/v1/*/@live/**").wait().unwrap();
    let living: Vec<_> = living.iter().map(|reply| reply.result().unwrap().key_expr().to_string()).collect();
    assert!(living.contains(&key("@live/fuser")) && !living.contains(&key("@live/ghost")), "{living:?}");

    let output = plumb(&["swap", "fuser", "vqf", "--remote", &system.name, "--connect", &endpoint]).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    for word in [&endpoint, "which is read-only", "operator", "`plumb swap fuser vqf`", "--keys keys/operator.NAME"] {
        assert!(said.contains(word), "{said}");
    }
    assert_eq!(fuser(&system), before);
    drop((declared, forgers));
    end(running);
}

/// What the process has in memory, KiB.
fn resident_kib(pid: u64) -> u64 {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap_or("0");
    line.split_whitespace().next().unwrap().parse().unwrap()
}

/// Runs a system for some seconds while `attack` goes on until it is told to stop; the most memory that the gateway had, KiB.
fn attacked(system: &System, attack: impl Fn(&str, &AtomicBool) + Sync) -> (Run, u64) {
    let running = system.start(&[]);
    let endpoint = endpoint(system);
    let pid = number(&gateway(system).unwrap(), "pid");
    let ends = AtomicBool::new(false);
    let most_kib = thread::scope(|scope| {
        scope.spawn(|| attack(&endpoint, &ends));
        let (began, mut most_kib) = (Instant::now(), 0);
        let mut report = None;
        while began.elapsed() < Duration::from_secs(5) {
            most_kib = most_kib.max(resident_kib(pid));
            thread::sleep(Duration::from_millis(2));
            if report.is_none() && began.elapsed() > Duration::from_secs(2) {
                report = Some(scope.spawn(|| seen(station(&[&endpoint], &["--seconds", "2"]))));
            }
        }
        let report = report.unwrap().join().unwrap();
        assert!(number(topic(&report["vehicles"][0], "attitude"), "samples") > 0, "{report}");
        ends.store(true, Ordering::SeqCst);
        most_kib
    });
    assert_eq!(number(&gateway(system).unwrap(), "restarts"), 0);
    (end(running), most_kib)
}

#[test]
fn messages_that_are_too_large_take_neither_memory_nor_the_board() {
    let (quiet, _) = attacked(&with_gateway(free_port(), ""), |_, _| {});
    let flood = |endpoint: &str, ends: &AtomicBool| {
        let session = stranger(endpoint, "client");
        let message = zenoh::bytes::ZBytes::from(vec![7; 24 << 20]);
        while !ends.load(Ordering::SeqCst) {
            for priority in [Priority::RealTime, Priority::InteractiveHigh, Priority::Data, Priority::Background] {
                let put = session.put("plumbline/v1/forged", message.clone()).priority(priority);
                put.congestion_control(CongestionControl::Block).wait().unwrap();
            }
        }
    };
    let (run, most_kib) = attacked(&with_gateway(free_port(), ""), flood);
    let latencies = [&quiet, &run].map(|run| run.number("/latency_us/p999"));
    println!(
        "the gateway had {} MiB at most; p99.9 on board {latencies:.0?} µs, quiet and attacked: {:.2} times",
        most_kib / 1024,
        latencies[1] / latencies[0]
    );
    assert!(most_kib < MAX_MEMORY_KIB, "{most_kib} KiB");
}

#[test]
fn a_client_that_declares_without_end_ends_a_gateway_that_says_so_and_the_board_does_not_notice() {
    let system = with_gateway(free_port(), "");
    let running = system.start(&[]);
    let endpoint = endpoint(&system);
    // Several, as each takes the longer for a declaration the more it has made.
    let sessions: Vec<_> = (0..32).map(|_| stranger(&endpoint, "client")).collect();
    // As long as a key may be, nearly: each is compared with all that were declared before.
    let long = "x".repeat(60_000);
    let mut declared = Vec::new();
    for (number, session) in sessions.iter().cycle().enumerate() {
        declared.push(session.declare_subscriber(format!("plumbline/v1/{number}/{long}")).wait().unwrap());
        if number % 100 == 0 && gateway(&system).is_some_and(|one| one["restarts"] != 0) {
            break;
        }
        assert!(number < 10_000, "it has taken all of it");
    }
    drop((declared, sessions));
    until("the next gateway", || {
        gateway(&system).is_some_and(|one| one["state"] == "running" && one["address"].is_string())
    });
    let run = end(running);
    assert!(run.people.contains("memory limit exceeded"), "{}", run.people);
}

#[test]
fn idle_connections_keep_nobody_out() {
    let system = with_gateway(free_port(), "");
    let running = system.start(&[]);
    let endpoint = endpoint(&system);
    let address = endpoint.strip_prefix("tcp/").unwrap();
    let idle: Vec<_> = (0..IDLE).map(|_| TcpStream::connect(address).unwrap()).collect();
    // They are worked off at so many a second; on a slow machine whoever asks is told so and asks again.
    until("an honest client to get in", || {
        let output = plumb(&["ps", "--remote", &system.name, "--connect", &endpoint]).output().unwrap();
        println!("{}", String::from_utf8_lossy(&output.stderr));
        output.status.success()
    });
    drop(idle);
    end(running);
}

#[test]
fn who_comes_when_every_place_is_taken_is_told_so_and_gets_in_when_one_is_free() {
    let system = with_gateway(free_port(), "");
    let running = system.start(&[]);
    let endpoint = endpoint(&system);
    let sessions: Vec<_> = (0..MAX_SESSIONS).map(|_| stranger(&endpoint, "client")).collect();
    let ps = || plumb(&["ps", "--remote", &system.name, "--connect", &endpoint]).output().unwrap();
    let said = String::from_utf8(ps().stderr).unwrap();
    assert!(said.contains(&format!("it accepts at most {MAX_SESSIONS} sessions and all are in use")), "{said}");
    sessions.into_iter().take(8).for_each(|session| session.close().wait().unwrap());
    until("a place", || ps().status.success());
    end(running);
}

/// Of an operator, and ended on 2025-02-01.
const ENDED: &str = "-----BEGIN CERTIFICATE-----
MIIBFjCBvAIBATAKBggqhkjOPQQDAjAXMRUwEwYDVQQDDAxvcGVyYXRvci5hbm4w
HhcNMjUwMTAxMDAwMDAwWhcNMjUwMjAxMDAwMDAwWjAXMRUwEwYDVQQDDAxvcGVy
YXRvci5hbm4wWTATBgcqhkjOPQIBBggqhkjOPQMBBwNCAAQjySwFQzPBtLqwmDB5
7Zx343EvRdg0tTkJ4OvszBlbyxcAXJvw6KUyUxaPmr+3+F48lY08aTRAFeMdQNix
Ve4oMAoGCCqGSM49BAMCA0kAMEYCIQDB88oVGk11RsUN9J5cjf6aR8jGdx9gwK+Z
EW7lafohywIhALpQljKcpvlEIPlOPIZThppnDH9MmDYzlO7YiM4eTgOS
-----END CERTIFICATE-----
";

#[test]
fn a_certificate_that_has_ended_is_named_with_the_remedy_before_anybody_is_called() {
    let site = Site::new(&[&["operator", "ann"]]);
    fs::write(site.of("operator.ann").join("cert.pem"), ENDED).unwrap();
    let keys = site.of("operator.ann");
    for verb in
        [&["station"][..], &["topic", "hz", "attitude", "--remote", "a"], &["swap", "fuser", "vqf", "--remote", "a"]]
    {
        let output = plumb(verb).args(["--connect", "quic/127.0.0.1:9", "--keys"]).arg(&keys).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{said}");
        for word in ["operator.ann", "expired on 2025-02-01", "`plumb keys operator ann --force`"] {
            assert!(said.contains(word), "{verb:?}: {said}");
        }
    }
    // A gateway says it, and goes on with what it can.
    let tls = site.tls("operator.ann");
    let system = with_gateway(free_port(), &format!("connect = [\"quic/127.0.0.1:9\"]\n{tls}"));
    let running = system.start(&[]);
    endpoint(&system);
    thread::sleep(Duration::from_secs(1));
    let run = end(running);
    assert!(run.people.contains("expired on 2025-02-01"), "{}", run.people);
}
