//! The gateway with the folders that `plumb keys` makes: who looks, who commands and who is refused, at a vehicle that listens itself and
//! behind a router.
use std::{fs, path::Path, process::Output};

use crate::common::{
    Running, System,
    beyond::{endpoint, free_port, number, ps, topic},
    plumb,
    site::{Site, listening, system},
    until,
};
use serde_json::Value;
use zenoh::{Config, Session, Wait};

/// A router as its folder has it, but for paths and port.
fn router(site: &Site, port: u16) -> Session {
    let folder = site.of("router");
    let text = fs::read_to_string(folder.join("router.json5")).unwrap();
    let text = text.replace("/etc/plumbline/keys", folder.to_str().unwrap());
    let text = text.replace("0.0.0.0:7447", &format!("127.0.0.1:{port}"));
    zenoh::open(Config::from_json5(&text).unwrap()).wait().unwrap()
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A gateway under the name of `vehicle` that shows a router the certificate of `party`.
fn behind_router(site: &Site, port: u16, vehicle: &str, party: &str) -> System {
    let own = free_port();
    let tls = site.tls(party);
    system(&format!(
        "vehicle = \"{vehicle}\"\nlisten = [\"tcp/127.0.0.1:{own}\"]\nconnect = [\"quic/127.0.0.1:{port}\"]\n{tls}"
    ))
}

fn started(system: &System) -> Running {
    let running = system.start(&[]);
    endpoint(system);
    until("every service to run", || ps(system).iter().filter(|one| one["state"] == "running").count() == 6);
    running
}

fn end(running: Running) {
    running.interrupt();
    let run = running.wait();
    assert_eq!(run.code, Some(0), "{}", run.people);
}

/// A verb with the keys of a party.
fn with(port: u16, keys: &Path, arguments: &[&str]) -> Output {
    plumb(arguments).args(["--connect", &format!("quic/127.0.0.1:{port}"), "--keys"]).arg(keys).output().unwrap()
}

/// What a verb that succeeds says to scripts.
fn answer(port: u16, keys: &Path, arguments: &[&str]) -> Value {
    let output = with(port, keys, &[arguments, &["--json"]].concat());
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", said(&output));
    serde_json::from_str(String::from_utf8(output.stdout).unwrap().lines().last().unwrap()).unwrap()
}

/// The vehicles that a station sees.
fn vehicles(port: u16, keys: &Path, seconds: &str) -> Vec<Value> {
    answer(port, keys, &["station", "--seconds", seconds])["vehicles"].as_array().unwrap().clone()
}

fn names(vehicles: &[Value]) -> Vec<&str> {
    vehicles.iter().map(|vehicle| vehicle["vehicle"].as_str().unwrap()).collect()
}

fn fuser(standings: &[Value]) -> [Value; 2] {
    let fuser = standings.iter().find(|one| one["service"] == "fuser").unwrap();
    [fuser["stage"].clone(), fuser["epoch"].clone()]
}

#[test]
fn at_a_vehicle_that_listens_itself_an_operator_commands_a_viewer_looks_and_nobody_else_gets_in() {
    let parties = [&["vehicle", "alpha", "--host", "127.0.0.1"][..], &["operator", "ann"], &["viewer", "wall"]];
    let (site, other) = (Site::new(&parties), Site::new(&parties));
    let port = free_port();
    let system = listening(&site, port);
    let running = started(&system);
    let (operator, viewer) = (site.of("operator.ann"), site.of("viewer.wall"));

    for keys in [&operator, &viewer] {
        let vehicles = vehicles(port, keys, "2");
        assert_eq!(names(&vehicles), ["alpha"]);
        let attitude = topic(&vehicles[0], "attitude");
        assert!(number(attitude, "samples") > 20 && vehicles[0]["alive"] == true, "{}", vehicles[0]);
        assert_eq!((number(attitude, "lost_samples"), number(attitude, "dropped")), (0, 0), "{attitude}");
        let hz = answer(port, keys, &["topic", "hz", "attitude", "--count", "20", "--remote", "alpha"]);
        assert_eq!((hz["messages"].as_u64(), hz["missed"].as_u64()), (Some(20), Some(0)), "{hz}");
    }

    let swap = ["swap", "fuser", "vqf", "--remote", "alpha"];
    let before = fuser(&ps(&system));
    let refused = with(port, &viewer, &swap);
    assert_eq!((refused.status.code(), refused.stdout.len()), (Some(1), 0), "{refused:?}");
    assert!(said(&refused).contains("takes no command from this client") && said(&refused).contains("--keys keys/operator"));
    assert_eq!(fuser(&ps(&system)), before);
    let report = answer(port, &operator, &swap);
    assert_eq!(report["outcome"], "committed", "{report}");
    let remote = answer(port, &viewer, &["ps", "--remote", "alpha"]);
    assert_eq!(fuser(remote.as_array().unwrap())[0], "vqf");

    let ipv6 = ["ps", "--remote", "alpha", "--connect", "quic/[::1]:7447", "--keys", viewer.to_str().unwrap()];
    let refused = plumb(&ipv6).output().unwrap();
    assert!(refused.status.code() == Some(2) && said(&refused).contains("or by an IPv4 address"), "{}", said(&refused));

    // Another authority, no certificate, no folder of keys, no TLS.
    let nowhere = site.of("nobody");
    for (foreign, code, word) in
        [(&other.of("operator.ann"), 1, "another authority"), (&nowhere, 2, "there is no ca.pem")]
    {
        for verb in [&["station", "--seconds", "2"][..], &["ps", "--remote", "alpha"], &swap] {
            let refused = with(port, foreign, verb);
            assert_eq!((refused.status.code(), refused.stdout.len()), (Some(code), 0), "{verb:?}: {refused:?}");
            assert!(said(&refused).contains(word), "{}", said(&refused));
        }
    }
    for (endpoint, code, word) in
        [(format!("quic/127.0.0.1:{port}"), 2, "--keys"), (format!("tcp/127.0.0.1:{port}"), 1, "nobody")]
    {
        let bare = plumb(&["ps", "--remote", "alpha", "--connect", &endpoint]).output().unwrap();
        assert_eq!((bare.status.code(), bare.stdout.len()), (Some(code), 0), "{}", said(&bare));
        assert!(said(&bare).contains(word), "{}", said(&bare));
    }
    end(running);
}

#[test]
fn behind_a_router_a_station_sees_every_vehicle_and_none_speaks_for_another() {
    let site = Site::new(&[&["vehicle", "alpha"], &["vehicle", "beta"], &["operator", "ann"], &["viewer", "wall"]]);
    let port = free_port();
    let _router = router(&site, port);
    let (operator, viewer) = (site.of("operator.ann"), site.of("viewer.wall"));
    let alpha = behind_router(&site, port, "alpha", "vehicle.alpha");
    let forger = behind_router(&site, port, "beta", "vehicle.alpha");
    let (alpha_runs, forger_runs) = (started(&alpha), started(&forger));
    until("alpha", || names(&vehicles(port, &viewer, "1")).contains(&"alpha"));
    // The forger's own clients on its machine hear it as beta, and so does nobody behind the router.
    let own = plumb(&["topic", "hz", "attitude", "--count", "10", "--remote", "beta", "--connect", &endpoint(&forger)]);
    assert!({ own }.output().unwrap().status.success());
    assert_eq!(names(&vehicles(port, &viewer, "3")), ["alpha"]);
    let unheard = with(port, &operator, &["swap", "fuser", "vqf", "--remote", "beta"]);
    assert_eq!(unheard.status.code(), Some(1));
    assert!(said(&unheard).contains("no response within"), "{}", said(&unheard));

    let beta = behind_router(&site, port, "beta", "vehicle.beta");
    let beta_runs = started(&beta);
    until("both", || names(&vehicles(port, &viewer, "1")) == ["alpha", "beta"]);
    let before = fuser(&ps(&forger));
    for (vehicle, system) in [("alpha", &alpha), ("beta", &beta)] {
        let report = answer(port, &operator, &["swap", "fuser", "vqf", "--remote", vehicle]);
        assert_eq!(report["outcome"], "committed", "{report}");
        assert_eq!(fuser(&ps(system))[0], "vqf");
        let refused = with(port, &viewer, &["swap", "fuser", "wz", "--remote", vehicle]);
        assert!(refused.status.code() == Some(1) && said(&refused).contains("takes no command"), "{}", said(&refused));
    }
    assert_eq!(fuser(&ps(&forger)), before);
    let seen = vehicles(port, &viewer, "3");
    for vehicle in &seen {
        let attitude = topic(vehicle, "attitude");
        assert!(number(attitude, "samples") > 50 && vehicle["alive"] == true, "{vehicle}");
        // Two that spoke under one name would show as lives and repetitions.
        let counts = ["lost_samples", "repeated", "restarts"].map(|count| number(attitude, count));
        assert_eq!(counts, [0; 3], "{vehicle}");
    }
    [alpha_runs, beta_runs, forger_runs].into_iter().for_each(end);
}

#[test]
fn ticks_of_a_split_system_go_to_the_host_that_may_import_them_and_to_no_other() {
    let site = Site::new(&[
        &["vehicle", "board", "--host", "127.0.0.1"],
        &["vehicle", "base", "--imports", "board"],
        &["vehicle", "other"],
    ]);
    let topics = "[\"gyro\", \"accel\", \"mag\", \"gnss\"]";
    let (port, sim) = (free_port(), "[ingest.sim]\nrate_hz = 100\n[gateway]\n");
    let (tls, access) = (site.tls("vehicle.board"), site.of("vehicle.board").join("access.json5"));
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
    let other_runs = other.start(&[]);
    let base_runs = base.start(&["--for", "5s"]);
    let board_runs = board.start(&[]);
    let run = base_runs.wait();
    run.assert_whole();
    assert_eq!(run.number("/ticks_out"), 500.0, "{}", run.people);
    // It connects to the same gateway and has asked all the while.
    let of_other = ps(&other).into_iter().find(|one| one["service"] == "gateway").unwrap();
    assert_eq!((of_other["state"].as_str(), of_other["ticks"].as_u64()), (Some("running"), Some(0)), "{of_other}");
    drop(other_runs);
    end(board_runs);
}
