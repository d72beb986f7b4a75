//! Gateway with the certificates and access lists that `plumb keys` creates.
//!
//! One vehicle listens for clients itself; others connect to a router. The tests cover the
//! permissions of viewers and operators, and the clients that are rejected.
use std::{fs, path::Path, process::Output};

use crate::common::{
    Running, System, plumb,
    remote::{endpoint, free_port, number, ps, topic},
    site::{Site, listening_vehicle, system_with_gateway},
    wait_for,
};
use serde_json::Value;
use zenoh::{Config, Session, Wait};

/// Opens a router with the configuration in its key folder, except for paths and port.
fn router(site: &Site, port: u16) -> Session {
    let folder = site.holder_folder("router");
    let text = fs::read_to_string(folder.join("router.json5")).unwrap();
    let text = text.replace("/etc/plumbline/keys", folder.to_str().unwrap());
    let text = text.replace("0.0.0.0:7447", &format!("127.0.0.1:{port}"));
    zenoh::open(Config::from_json5(&text).unwrap()).wait().unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Returns a gateway named `vehicle` that presents the certificate of `party` to a router.
fn behind_router(site: &Site, port: u16, vehicle: &str, party: &str) -> System {
    let own = free_port();
    let tls = site.tls(party);
    system_with_gateway(&format!(
        "vehicle = \"{vehicle}\"\nlisten = [\"tcp/127.0.0.1:{own}\"]\nconnect = [\"quic/127.0.0.1:{port}\"]\n{tls}"
    ))
}

fn start(system: &System) -> Running {
    let running = system.start(&[]);
    endpoint(system);
    wait_for("every service to run", || ps(system).iter().filter(|entry| entry["state"] == "running").count() == 6);
    running
}

fn stop(running: Running) {
    running.interrupt();
    let run = running.wait();
    assert_eq!(run.code, Some(0), "{}", run.stderr);
}

/// Runs `plumb` with the keys of a party.
fn run_with_keys(port: u16, keys: &Path, arguments: &[&str]) -> Output {
    plumb(arguments).args(["--connect", &format!("quic/127.0.0.1:{port}"), "--keys"]).arg(keys).output().unwrap()
}

/// Returns the JSON output of a command that must succeed.
fn run_json(port: u16, keys: &Path, arguments: &[&str]) -> Value {
    let output = run_with_keys(port, keys, &[arguments, &["--json"]].concat());
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", stderr(&output));
    serde_json::from_str(String::from_utf8(output.stdout).unwrap().lines().last().unwrap()).unwrap()
}

/// Returns the vehicles in the report of `plumb station`.
fn vehicles(port: u16, keys: &Path, seconds: &str) -> Vec<Value> {
    run_json(port, keys, &["station", "--for", seconds])["vehicles"].as_array().unwrap().clone()
}

fn names(vehicles: &[Value]) -> Vec<&str> {
    vehicles.iter().map(|vehicle| vehicle["vehicle"].as_str().unwrap()).collect()
}

fn fuser(services: &[Value]) -> [Value; 2] {
    let fuser = services.iter().find(|entry| entry["service"] == "fuser").unwrap();
    [fuser["stage"].clone(), fuser["epoch"].clone()]
}

#[test]
fn listening_vehicle_enforces_roles_of_clients() {
    let parties = [&["vehicle", "alpha", "--host", "127.0.0.1"][..], &["operator", "ann"], &["viewer", "wall"]];
    let (site, other) = (Site::new(&parties), Site::new(&parties));
    let port = free_port();
    let system = listening_vehicle(&site, port);
    let running = start(&system);
    let (operator, viewer) = (site.holder_folder("operator.ann"), site.holder_folder("viewer.wall"));

    for keys in [&operator, &viewer] {
        let vehicles = vehicles(port, keys, "2");
        assert_eq!(names(&vehicles), ["alpha"]);
        let attitude = topic(&vehicles[0], "attitude");
        assert!(number(attitude, "samples") > 20 && vehicles[0]["alive"] == true, "{}", vehicles[0]);
        assert_eq!((number(attitude, "lost_samples"), number(attitude, "dropped")), (0, 0), "{attitude}");
        let hz = run_json(port, keys, &["topic", "hz", "attitude", "--count", "20", "--remote", "alpha"]);
        assert_eq!((hz["messages"].as_u64(), hz["missed"].as_u64()), (Some(20), Some(0)), "{hz}");
    }

    let swap = ["swap", "fuser", "vqf", "--remote", "alpha"];
    let before = fuser(&ps(&system));
    let rejected = run_with_keys(port, &viewer, &swap);
    assert_eq!((rejected.status.code(), rejected.stdout.len()), (Some(1), 0), "{rejected:?}");
    assert!(
        stderr(&rejected).contains("accepts no commands from this client")
            && stderr(&rejected).contains("--keys keys/operator")
    );
    assert_eq!(fuser(&ps(&system)), before);
    let report = run_json(port, &operator, &swap);
    assert_eq!(report["outcome"], "committed", "{report}");
    let remote = run_json(port, &viewer, &["ps", "--remote", "alpha"]);
    assert_eq!(fuser(remote["services"].as_array().unwrap())[0], "vqf");

    let ipv6 = ["ps", "--remote", "alpha", "--connect", "quic/[::1]:7447", "--keys", viewer.to_str().unwrap()];
    let rejected = plumb(&ipv6).output().unwrap();
    assert!(
        rejected.status.code() == Some(2) && stderr(&rejected).contains("use a DNS name or an IPv4 address"),
        "{}",
        stderr(&rejected)
    );

    // Keys from another authority, and a key folder without certificates, are rejected.
    let missing = site.holder_folder("missing");
    for (foreign, code, word) in
        [(&other.holder_folder("operator.ann"), 1, "another authority"), (&missing, 2, "no ca.pem")]
    {
        for verb in [&["station", "--for", "2"][..], &["ps", "--remote", "alpha"], &swap] {
            let rejected = run_with_keys(port, foreign, verb);
            assert_eq!((rejected.status.code(), rejected.stdout.len()), (Some(code), 0), "{verb:?}: {rejected:?}");
            assert!(stderr(&rejected).contains(word), "{}", stderr(&rejected));
        }
    }
    for (endpoint, code, word) in [
        (format!("quic/127.0.0.1:{port}"), 2, "--keys"),
        (format!("tcp/127.0.0.1:{port}"), 1, "no process listens there"),
    ] {
        let uncertified = plumb(&["ps", "--remote", "alpha", "--connect", &endpoint]).output().unwrap();
        assert_eq!((uncertified.status.code(), uncertified.stdout.len()), (Some(code), 0), "{}", stderr(&uncertified));
        assert!(stderr(&uncertified).contains(word), "{}", stderr(&uncertified));
    }
    stop(running);
}

#[test]
fn router_keeps_vehicles_from_impersonating_each_other() {
    let site = Site::new(&[&["vehicle", "alpha"], &["vehicle", "beta"], &["operator", "ann"], &["viewer", "wall"]]);
    let port = free_port();
    let _router = router(&site, port);
    let (operator, viewer) = (site.holder_folder("operator.ann"), site.holder_folder("viewer.wall"));
    let alpha = behind_router(&site, port, "alpha", "vehicle.alpha");
    let forger = behind_router(&site, port, "beta", "vehicle.alpha");
    let (alpha_running, forger_running) = (start(&alpha), start(&forger));
    wait_for("telemetry of alpha", || names(&vehicles(port, &viewer, "1")).contains(&"alpha"));
    // Clients of the forger's own gateway see the forger as beta. Clients of the router do not see
    // the forger.
    let own = plumb(&["topic", "hz", "attitude", "--count", "10", "--remote", "beta", "--connect", &endpoint(&forger)]);
    assert!({ own }.output().unwrap().status.success());
    assert_eq!(names(&vehicles(port, &viewer, "3")), ["alpha"]);
    let unanswered = run_with_keys(port, &operator, &["swap", "fuser", "vqf", "--remote", "beta"]);
    assert_eq!(unanswered.status.code(), Some(1));
    assert!(stderr(&unanswered).contains("no response within"), "{}", stderr(&unanswered));

    let beta = behind_router(&site, port, "beta", "vehicle.beta");
    let beta_running = start(&beta);
    wait_for("telemetry of both vehicles", || names(&vehicles(port, &viewer, "1")) == ["alpha", "beta"]);
    let before = fuser(&ps(&forger));
    for (vehicle, system) in [("alpha", &alpha), ("beta", &beta)] {
        let report = run_json(port, &operator, &["swap", "fuser", "vqf", "--remote", vehicle]);
        assert_eq!(report["outcome"], "committed", "{report}");
        assert_eq!(fuser(&ps(system))[0], "vqf");
        let rejected = run_with_keys(port, &viewer, &["swap", "fuser", "wz", "--remote", vehicle]);
        assert!(
            rejected.status.code() == Some(1) && stderr(&rejected).contains("accepts no commands"),
            "{}",
            stderr(&rejected)
        );
    }
    assert_eq!(fuser(&ps(&forger)), before);
    let reported = vehicles(port, &viewer, "3");
    for vehicle in &reported {
        let attitude = topic(vehicle, "attitude");
        assert!(number(attitude, "samples") > 50 && vehicle["alive"] == true, "{vehicle}");
        // If two vehicles used one name, this would be counted as restarts and repetitions.
        let counts = ["lost_samples", "repeated", "restarts"].map(|count| number(attitude, count));
        assert_eq!(counts, [0; 3], "{vehicle}");
    }
    [alpha_running, beta_running, forger_running].into_iter().for_each(stop);
}

#[test]
fn only_authorised_host_imports_ticks_of_split_system() {
    let site = Site::new(&[
        &["vehicle", "board", "--host", "127.0.0.1"],
        &["vehicle", "base", "--imports", "board"],
        &["vehicle", "other"],
    ]);
    let topics = "[\"gyro\", \"accel\", \"mag\", \"gnss\"]";
    let (port, sim) = (free_port(), "[ingest.sim]\nrate_hz = 100\n[gateway]\n");
    let (tls, access) = (site.tls("vehicle.board"), site.holder_folder("vehicle.board").join("access.json5"));
    let board = System::new(&format!(
        "services = [\"ingest\", \"gyro\", \"accel\", \"gateway\"]\n{sim}vehicle = \"board\"\nlisten = [\"quic/127.0.0.1:{port}\"]\naccess = {access:?}\n{tls}\nexport = {topics}\n"
    ));
    let host = |party: &str| {
        let (own, tls) = (free_port(), site.tls(party));
        System::new(&format!(
            "services = [\"fuser\", \"course\", \"gateway\"]\n{sim}listen = [\"tcp/127.0.0.1:{own}\"]\nconnect = [\"quic/127.0.0.1:{port}\"]\n{tls}\nimport = {{ vehicle = \"board\", topics = {topics} }}\n"
        ))
    };
    let (base, other) = (host("vehicle.base"), host("vehicle.other"));
    let other_running = other.start(&[]);
    let base_running = base.start(&["--for", "5s"]);
    let board_running = board.start(&[]);
    let run = base_running.wait();
    run.assert_complete();
    assert_eq!(run.number("/ticks_out"), 500.0, "{}", run.stderr);
    // The other host is connected to the same gateway and has requested the ticks throughout.
    let other_gateway = ps(&other).into_iter().find(|entry| entry["service"] == "gateway").unwrap();
    assert_eq!(
        (other_gateway["state"].as_str(), other_gateway["ticks"].as_u64()),
        (Some("running"), Some(0)),
        "{other_gateway}"
    );
    drop(other_running);
    stop(board_running);
}
