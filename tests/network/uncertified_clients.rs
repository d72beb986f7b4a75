//! Clients that have no certificate: they may read, but must not impersonate or command the
//! vehicle, exhaust its memory or block other clients.
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
    Run, Running, System, plumb,
    remote::{endpoint, free_port, gateway, last_json, number, ps, station, topic, with_gateway},
    site::Site,
    wait_for,
};
use link::MAX_SESSIONS;
use wire::{command::ControlMessage, v1::SwapRequest};
use zenoh::{
    Config, Session, Wait,
    qos::{CongestionControl, Priority},
};

/// Number of idle connections in the simulated attack, the same as in an observed attack.
const IDLE_CONNECTIONS: usize = 1200;
/// Maximum resident memory of a gateway under attack, KiB.
const MAX_MEMORY_KIB: u64 = 64 * 1024;

/// Opens a plain Zenoh session, without any of Plumbline's own code.
fn uncertified_session(endpoint: &str, mode: &str) -> Session {
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

fn stop(running: Running) -> Run {
    running.interrupt();
    let run = running.wait();
    run.assert_complete();
    run
}

fn fuser(system: &System) -> String {
    ps(system)
        .into_iter()
        .find(|entry| entry["service"] == "fuser")
        .map(|entry| format!("{} {}", entry["stage"], entry["epoch"]))
        .unwrap()
}

#[test]
fn uncertified_client_reads_but_cannot_impersonate_or_command() {
    let system = with_gateway(free_port(), "");
    let running = system.start(&[]);
    let endpoint = endpoint(&system);
    wait_for("every service to run", || ps(&system).iter().filter(|entry| entry["state"] == "running").count() == 6);
    let key = |rest: &str| format!("plumbline/v1/{}/{rest}", system.name);
    let before = fuser(&system);

    // The reader is a client, because the gateway does not forward messages from one peer to
    // another.
    let (reader, received) = (uncertified_session(&endpoint, "client"), Arc::new(Mutex::new(Vec::new())));
    let _subscriber = reader.declare_subscriber("plumbline/v1/**").callback({
        let received = received.clone();
        move |sample| {
            received.lock().unwrap().push((sample.key_expr().to_string(), sample.payload().to_bytes().into_owned()))
        }
    });
    let _subscriber = _subscriber.wait().unwrap();
    let forgers = ["client", "peer"].map(|mode| uncertified_session(&endpoint, mode));
    let forged = || b"forged".to_vec();
    let query = |session: &Session, key: &str, payload: Vec<u8>| -> Vec<Vec<u8>> {
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
            assert_eq!(query(forger, &command, request.to_bytes()), Vec::<Vec<u8>>::new(), "{command}");
        }
        let token = forger.liveliness().declare_token(key("@live/ghost")).wait().unwrap();
        let queryable = forger.declare_queryable(key("services")).callback({
            let key = key("services");
            move |query| drop(query.reply(key.clone(), b"forged".to_vec()).wait())
        });
        declared.push((token, queryable.wait().unwrap()));
    }
    let attitudes = || received.lock().unwrap().iter().filter(|(received, _)| *received == key("attitude")).count();
    let before_count = attitudes();
    wait_for("attitudes of the vehicle", || attitudes() > before_count + 50);
    for (key, bytes) in received.lock().unwrap().iter() {
        assert!(!bytes.is_empty() && *bytes != forged(), "{key} was forged");
    }
    let services = query(&reader, &key("services"), Vec::new());
    assert!(services.len() == 1 && services[0] != forged(), "{services:?}");
    let tokens = reader.liveliness().get("plumbline/v1/*/@live/**").wait().unwrap();
    let tokens: Vec<_> = tokens.iter().map(|reply| reply.result().unwrap().key_expr().to_string()).collect();
    assert!(tokens.contains(&key("@live/fuser")) && !tokens.contains(&key("@live/ghost")), "{tokens:?}");

    let output = plumb(&["swap", "fuser", "vqf", "--remote", &system.name, "--connect", &endpoint]).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    for word in [&endpoint, "which is read-only", "operator", "`plumb swap fuser vqf`", "--keys keys/operator.NAME"] {
        assert!(stderr.contains(word), "{stderr}");
    }
    assert_eq!(fuser(&system), before);
    drop((declared, forgers));
    stop(running);
}

/// Returns the resident memory of a process, KiB.
fn resident_kib(pid: u64) -> u64 {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap_or("0");
    line.split_whitespace().next().unwrap().parse().unwrap()
}

/// Runs a system for 5 s under `attack`, which must return once the flag passed to it is set.
///
/// Returns the run and the peak memory of the gateway in KiB.
fn run_under_attack(system: &System, attack: impl Fn(&str, &AtomicBool) + Sync) -> (Run, u64) {
    let running = system.start(&[]);
    let endpoint = endpoint(system);
    let pid = number(&gateway(system).unwrap(), "pid");
    let is_stopped = AtomicBool::new(false);
    let peak_kib = thread::scope(|scope| {
        scope.spawn(|| attack(&endpoint, &is_stopped));
        let (started_at, mut peak_kib) = (Instant::now(), 0);
        let mut report = None;
        while started_at.elapsed() < Duration::from_secs(5) {
            peak_kib = peak_kib.max(resident_kib(pid));
            thread::sleep(Duration::from_millis(2));
            if report.is_none() && started_at.elapsed() > Duration::from_secs(2) {
                report = Some(scope.spawn(|| last_json(station(&[&endpoint], &["--for", "2"]))));
            }
        }
        let report = report.unwrap().join().unwrap();
        assert!(number(topic(&report["vehicles"][0], "attitude"), "samples") > 0, "{report}");
        is_stopped.store(true, Ordering::SeqCst);
        peak_kib
    });
    assert_eq!(number(&gateway(system).unwrap(), "restarts"), 0);
    (stop(running), peak_kib)
}

#[test]
fn oversized_messages_do_not_exhaust_gateway_memory() {
    let (baseline, _) = run_under_attack(&with_gateway(free_port(), ""), |_, _| {});
    let flood = |endpoint: &str, is_stopped: &AtomicBool| {
        let session = uncertified_session(endpoint, "client");
        let message = zenoh::bytes::ZBytes::from(vec![7; 24 << 20]);
        while !is_stopped.load(Ordering::SeqCst) {
            for priority in [Priority::RealTime, Priority::InteractiveHigh, Priority::Data, Priority::Background] {
                let put = session.put("plumbline/v1/forged", message.clone()).priority(priority);
                put.congestion_control(CongestionControl::Block).wait().unwrap();
            }
        }
    };
    let (run, peak_kib) = run_under_attack(&with_gateway(free_port(), ""), flood);
    let latencies = [&baseline, &run].map(|run| run.number("/latency_us/p999"));
    println!(
        "the gateway used {} MiB at most; p99.9 latency on board {latencies:.0?} µs without and with the attack, ratio {:.2}",
        peak_kib / 1024,
        latencies[1] / latencies[0]
    );
    assert!(peak_kib < MAX_MEMORY_KIB, "{peak_kib} KiB");
}

#[test]
fn excessive_declarations_restart_gateway_with_message() {
    let system = with_gateway(free_port(), "");
    let running = system.start(&[]);
    let endpoint = endpoint(&system);
    // Several sessions are used, because a declaration takes longer the more declarations its
    // session has already made.
    let sessions: Vec<_> = (0..32).map(|_| uncertified_session(&endpoint, "client")).collect();
    // The keys are close to the maximum length. Each one is compared with all keys declared before
    // it.
    let long = "x".repeat(60_000);
    let mut declared = Vec::new();
    for (number, session) in sessions.iter().cycle().enumerate() {
        declared.push(session.declare_subscriber(format!("plumbline/v1/{number}/{long}")).wait().unwrap());
        if number % 100 == 0 && gateway(&system).is_some_and(|entry| entry["restarts"] != 0) {
            break;
        }
        assert!(number < 10_000, "the gateway accepted all declarations");
    }
    drop((declared, sessions));
    wait_for("the next gateway", || {
        gateway(&system).is_some_and(|entry| entry["state"] == "running" && entry["address"].is_string())
    });
    let run = stop(running);
    assert!(run.stderr.contains("memory limit exceeded"), "{}", run.stderr);
}

#[test]
fn idle_connections_do_not_block_clients() {
    let system = with_gateway(free_port(), "");
    let running = system.start(&[]);
    let endpoint = endpoint(&system);
    let address = endpoint.strip_prefix("tcp/").unwrap();
    let idle: Vec<_> = (0..IDLE_CONNECTIONS).map(|_| TcpStream::connect(address).unwrap()).collect();
    // Idle connections are closed at a limited rate, so the first attempts may be rejected on a
    // slow machine.
    wait_for("a client to connect", || {
        let output = plumb(&["ps", "--remote", &system.name, "--connect", &endpoint]).output().unwrap();
        println!("{}", String::from_utf8_lossy(&output.stderr));
        output.status.success()
    });
    drop(idle);
    stop(running);
}

#[test]
fn client_beyond_session_limit_is_rejected_until_one_closes() {
    let system = with_gateway(free_port(), "");
    let running = system.start(&[]);
    let endpoint = endpoint(&system);
    let sessions: Vec<_> = (0..MAX_SESSIONS).map(|_| uncertified_session(&endpoint, "client")).collect();
    let ps = || plumb(&["ps", "--remote", &system.name, "--connect", &endpoint]).output().unwrap();
    let stderr = String::from_utf8(ps().stderr).unwrap();
    assert!(stderr.contains(&format!("it accepts at most {MAX_SESSIONS} sessions and all are in use")), "{stderr}");
    sessions.into_iter().take(8).for_each(|session| session.close().wait().unwrap());
    wait_for("a free session", || ps().status.success());
    stop(running);
}

/// Certificate of an operator that expired on 2025-02-01.
const EXPIRED: &str = "-----BEGIN CERTIFICATE-----
MIIBFjCBvAIBATAKBggqhkjOPQQDAjAXMRUwEwYDVQQDDAxvcGVyYXRvci5hbm4w
HhcNMjUwMTAxMDAwMDAwWhcNMjUwMjAxMDAwMDAwWjAXMRUwEwYDVQQDDAxvcGVy
YXRvci5hbm4wWTATBgcqhkjOPQIBBggqhkjOPQMBBwNCAAQjySwFQzPBtLqwmDB5
7Zx343EvRdg0tTkJ4OvszBlbyxcAXJvw6KUyUxaPmr+3+F48lY08aTRAFeMdQNix
Ve4oMAoGCCqGSM49BAMCA0kAMEYCIQDB88oVGk11RsUN9J5cjf6aR8jGdx9gwK+Z
EW7lafohywIhALpQljKcpvlEIPlOPIZThppnDH9MmDYzlO7YiM4eTgOS
-----END CERTIFICATE-----
";

#[test]
fn expired_certificate_is_reported_before_connecting() {
    let site = Site::new(&[&["operator", "ann"]]);
    fs::write(site.holder_folder("operator.ann").join("cert.pem"), EXPIRED).unwrap();
    let keys = site.holder_folder("operator.ann");
    for verb in
        [&["station"][..], &["topic", "hz", "attitude", "--remote", "a"], &["swap", "fuser", "vqf", "--remote", "a"]]
    {
        let output = plumb(verb).args(["--connect", "quic/127.0.0.1:9", "--keys"]).arg(&keys).output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{stderr}");
        for word in ["operator.ann", "expired on 2025-02-01", "`plumb keys operator ann --force`"] {
            assert!(stderr.contains(word), "{verb:?}: {stderr}");
        }
    }
    // A gateway reports the expired certificate and keeps its other endpoints running.
    let tls = site.tls("operator.ann");
    let system = with_gateway(free_port(), &format!("connect = [\"quic/127.0.0.1:9\"]\n{tls}"));
    let log = system.path("log");
    let running = Running::spawn_with_stderr(system.command(&[]), fs::File::create(&log).unwrap());
    endpoint(&system);
    wait_for("the report", || fs::read_to_string(&log).is_ok_and(|text| text.contains("expired on 2025-02-01")));
    stop(running);
}
