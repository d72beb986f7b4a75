//! Split system on two hosts: through outages and crashes, its output equals that of a single host,
//! and unrecoverable ticks are listed exactly.
use std::{
    collections::HashSet,
    fs,
    io::{Read, Write},
    net::{Shutdown, TcpListener, TcpStream},
    path::Path,
    process::Command,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use crate::common::{Run, Running, System, plumb, signal, wait_for};
use rustix::process::Signal;
use serde_json::Value;

const TOPICS: &str = "[\"gyro\", \"accel\", \"mag\", \"gnss\"]";

fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

fn board(endpoint: &str, more: &str) -> System {
    System::new(&format!(
        "services = [\"ingest\", \"gyro\", \"accel\", \"gateway\"]\n[gateway]\nlisten = [\"{endpoint}\"]\nexport = {TOPICS}\n{more}\n"
    ))
}

fn base(board: &System, endpoint: &str, more: &str) -> System {
    let vehicle = &board.name;
    System::new(&format!(
        "services = [\"fuser\", \"course\", \"gateway\"]\n[gateway]\nlisten = [\"tcp/127.0.0.1:{}\"]\nconnect = [\"{endpoint}\"]\n{more}\nimport = {{ vehicle = \"{vehicle}\", topics = {TOPICS} }}\n",
        free_port()
    ))
}

/// Returns the output of an undisturbed run in one process.
fn undisturbed(launch: &str, arguments: &[&str]) -> Vec<u8> {
    let system = System::new(launch);
    let out = system.path("out.csv");
    let more = ["--in-process", "--speed", "max", "--out", out.to_str().unwrap()];
    system.run(&[arguments, &more].concat()).assert_complete();
    fs::read(out).unwrap()
}

/// The two hosts of a split system. The board runs until the base has received all ticks of the
/// board.
struct Hosts {
    board: System,
    base: System,
    board_running: Running,
    base_running: Running,
}

impl Hosts {
    fn start(board: System, base: System, duration: &str) -> Self {
        let out = base.path("out.csv");
        let base_running = base.start(&["--for", duration, "--out", out.to_str().unwrap()]);
        wait_for("the gateway of the base to run", || {
            service_status(&base, "gateway").is_some_and(|entry| entry["state"] == "running")
        });
        let board_running = board.start(&[]);
        wait_for("ticks at the base", || ticks(&base) > 0);
        Self { board, base, board_running, base_running }
    }

    /// Waits for the base to exit and returns its run and its output file.
    fn stop(self) -> (Run, Vec<u8>) {
        let Self { board, base, board_running, base_running } = self;
        let run = base_running.wait();
        board_running.interrupt();
        let board_run = board_running.wait();
        board_run.assert_complete();
        assert_eq!((board.leftovers(), base.leftovers()), (Vec::new(), Vec::new()));
        println!("{}\n{}", board_run.stderr, run.stderr);
        (run, fs::read(base.path("out.csv")).unwrap())
    }

    fn assert_undisturbed(self, duration: &str) -> Run {
        let (run, bytes) = self.stop();
        run.assert_complete();
        assert!(bytes == undisturbed("", &["--for", duration]), "the bytes differ: {}", run.stderr);
        run
    }
}

fn service_status(system: &System, service: &str) -> Option<Value> {
    system.ps().into_iter().find(|entry| entry["service"] == service)
}

/// Returns the number of ticks that the base has received.
fn ticks(base: &System) -> u64 {
    service_status(base, "gateway").and_then(|entry| entry["ticks"].as_u64()).unwrap_or(0)
}

fn restarts(run: &Run, service: &str) -> u64 {
    let services = run.json["services"].as_array().unwrap();
    services.iter().find(|entry| entry["name"] == service).unwrap()["restarts"].as_u64().unwrap()
}

/// TCP proxy between two hosts. While it is cut, connections are closed and new ones are not
/// forwarded.
struct CuttableProxy {
    port: u16,
    is_cut: Arc<AtomicBool>,
    is_stopped: Arc<AtomicBool>,
}

impl CuttableProxy {
    fn start(port: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        listener.set_nonblocking(true).unwrap();
        let proxy =
            Self { port: listener.local_addr().unwrap().port(), is_cut: Arc::default(), is_stopped: Arc::default() };
        let (is_cut, is_stopped) = (proxy.is_cut.clone(), proxy.is_stopped.clone());
        thread::spawn(move || {
            while !is_stopped.load(Ordering::SeqCst) {
                let Ok((client, _)) = listener.accept() else {
                    thread::sleep(Duration::from_millis(5));
                    continue;
                };
                if let (false, Ok(server)) = (is_cut.load(Ordering::SeqCst), TcpStream::connect(("127.0.0.1", port))) {
                    forward(&client, &server, &is_cut);
                    forward(&server, &client, &is_cut);
                }
            }
        });
        proxy
    }

    fn cut_for(&self, duration: Duration) {
        self.is_cut.store(true, Ordering::SeqCst);
        thread::sleep(duration);
        self.is_cut.store(false, Ordering::SeqCst);
    }
}

impl Drop for CuttableProxy {
    fn drop(&mut self) {
        self.is_stopped.store(true, Ordering::SeqCst);
        self.is_cut.store(true, Ordering::SeqCst);
    }
}

fn forward(from: &TcpStream, to: &TcpStream, is_cut: &Arc<AtomicBool>) {
    let (mut from, mut to, is_cut) = (from.try_clone().unwrap(), to.try_clone().unwrap(), is_cut.clone());
    from.set_nonblocking(false).unwrap();
    from.set_read_timeout(Some(Duration::from_millis(10))).unwrap();
    thread::spawn(move || {
        let mut bytes = [0; 65_536];
        while !is_cut.load(Ordering::SeqCst) {
            match from.read(&mut bytes) {
                Ok(0) => break,
                Ok(count) if to.write_all(&bytes[..count]).is_err() => break,
                Ok(_) => {}
                Err(error) if matches!(error.kind(), std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut) => {
                }
                Err(_) => break,
            }
        }
        // The thread for the opposite direction may have closed the sockets already.
        let _ = from.shutdown(Shutdown::Both);
        let _ = to.shutdown(Shutdown::Both);
    });
}

fn endpoint_of(proxy: &CuttableProxy) -> String {
    format!("tcp/127.0.0.1:{}", proxy.port)
}

#[test]
fn split_system_output_equals_single_host() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let board = board(&endpoint, "");
    let base = base(&board, &endpoint, "");
    Hosts::start(board, base, "5s").assert_undisturbed("5s");
}

#[test]
fn base_imports_only_from_hosts_it_connects_to() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let honest = board(&endpoint, "");
    let base = base(&honest, &endpoint, "");
    let base_running = base.start(&[]);
    let address = || Some(service_status(&base, "gateway")?["address"].as_str()?.to_owned());
    wait_for("the base to listen", || address().is_some());
    // The forger is a second system that uses the board's name.
    let more = format!("vehicle = \"{}\"\nconnect = [{:?}]", honest.name, address().unwrap());
    let forger = board(&format!("tcp/127.0.0.1:{}", free_port()), &more);
    let forger_running = forger.start(&[]);
    wait_for("forged ticks", || ticks(&forger) > 3000);
    assert_eq!(ticks(&base), 0);
    // The base still receives ticks from the honest board, to which it connects itself.
    let honest_running = honest.start(&[]);
    wait_for("ticks at the base", || ticks(&base) > 0);
    drop((forger_running, honest_running, base_running));
}

#[test]
fn split_system_keeps_field_and_fixes_with_their_ticks() {
    for (scenario, flag) in [("cruise", "fix"), ("s3", "field")] {
        let endpoint = format!("tcp/127.0.0.1:{}", free_port());
        let launch = format!("[ingest.sim]\nscenario = \"{scenario}\"");
        let board = board(&endpoint, &launch);
        let base = base(&board, &endpoint, "");
        let (run, bytes) = Hosts::start(board, base, "4s").stop();
        run.assert_complete();
        assert!(bytes == undisturbed(&launch, &["--for", "4s"]), "the bytes differ: {}", run.stderr);
        let flags = run.line("flags");
        assert!(flags.contains(flag) && !flags.contains("aiding-missing"), "{flags}");
    }
}

#[test]
fn killed_gateways_lose_no_tick() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let board = board(&endpoint, "");
    let base = base(&board, &endpoint, "");
    let hosts = Hosts::start(board, base, "15s");
    for (system, runs) in [(&hosts.board, &hosts.board_running), (&hosts.base, &hosts.base_running)] {
        let before = ticks(&hosts.base);
        wait_for("more ticks", || ticks(&hosts.base) > before + 1000);
        signal(runs.service("gateway"), Signal::KILL);
        wait_for("the next gateway", || service_status(system, "gateway").is_some_and(|entry| entry["restarts"] == 1));
    }
    let run = hosts.assert_undisturbed("15s");
    assert_eq!(restarts(&run, "gateway"), 1);
}

#[test]
fn split_system_swaps_slot_on_its_host_without_loss() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let board = board(&endpoint, "");
    let base = base(&board, &endpoint, "");
    let hosts = Hosts::start(board, base, "8s");
    for (system, slot, stage) in [(&hosts.base, "fuser", "vqf"), (&hosts.board, "gyro", "rk4")] {
        let report = system.swap(&[slot, stage]);
        println!("{report}");
        assert_eq!(report["outcome"], "committed", "{report}");
    }
    let rejected = hosts.base.swap_once(&["gyro", "rk4"]);
    assert!(rejected["reason"].as_str().unwrap().contains("expected one of fuser, course"), "{rejected}");
    let (run, _) = hosts.stop();
    run.assert_complete();
}

#[test]
fn split_system_runs_user_defined_stage() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let board = board(&endpoint, "");
    let base = base(&board, &endpoint, "");
    // The folder must outlive the system, because a later run uses the stage again.
    let home = tempfile::tempdir().unwrap();
    let folder = home.path().join("mine");
    let output = plumb(&["stage", "new", "mine", "--lang", "python", "--dir"]).arg(&folder).output().unwrap();
    assert!(output.status.success(), "{output:?}");
    let command = format!("[\"python3\", {:?}]", folder.join("mine.py"));
    let launch = format!("[fuser]\nstage = \"mine\"\n[stages.mine]\nslot = \"fuser\"\ncommand = {command}\n");
    base.append_launch(&launch);
    let hosts = Hosts::start(board, base, "5s");
    signal(hosts.base_running.service("fuser"), Signal::KILL);
    let (run, bytes) = hosts.stop();
    run.assert_complete();
    assert_eq!(restarts(&run, "fuser"), 1);
    assert!(bytes == undisturbed(&launch, &["--for", "5s"]), "the bytes differ: {}", run.stderr);
}

#[test]
fn killed_services_on_both_hosts_lose_no_tick() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let board = board(&endpoint, "");
    let base = base(&board, &endpoint, "");
    let hosts = Hosts::start(board, base, "8s");
    for (runs, service) in [
        (&hosts.base_running, "fuser"),
        (&hosts.board_running, "gyro"),
        (&hosts.base_running, "course"),
        (&hosts.board_running, "ingest"),
    ] {
        thread::sleep(Duration::from_millis(900));
        signal(runs.service(service), Signal::KILL);
    }
    hosts.assert_undisturbed("8s");
}

#[test]
fn outage_of_5_s_loses_no_tick() {
    let port = free_port();
    let proxy = CuttableProxy::start(port);
    let board = board(&format!("tcp/127.0.0.1:{port}"), "");
    let base = base(&board, &endpoint_of(&proxy), "");
    let hosts = Hosts::start(board, base, "16s");
    wait_for("two seconds of ticks", || ticks(&hosts.base) > 2000);
    proxy.cut_for(Duration::from_secs(5));
    let before = ticks(&hosts.base);
    let restored_at = Instant::now();
    wait_for("the ticks of the outage", || ticks(&hosts.base) > before + 5000);
    println!("5000 more ticks {:.1} s after an outage of 5 s", restored_at.elapsed().as_secs_f64());
    hosts.assert_undisturbed("16s");
}

#[test]
fn outage_beyond_cache_lists_lost_ticks() {
    let port = free_port();
    let proxy = CuttableProxy::start(port);
    let board = board(&format!("tcp/127.0.0.1:{port}"), "cache_s = 1");
    let base = base(&board, &endpoint_of(&proxy), "");
    let hosts = Hosts::start(board, base, "16s");
    wait_for("two seconds of ticks", || ticks(&hosts.base) > 2000);
    proxy.cut_for(Duration::from_secs(4));
    let (run, bytes) = hosts.stop();
    assert_eq!((run.code, run.number("/not_recorded")), (Some(1), 0.0), "{}", run.stderr);
    let lost = run.number("/lost") as usize;
    assert!(lost > 1000 && run.number("/ticks_in") == 16_000.0, "{}", run.stderr);
    let listed = parse_lost_ticks(&run.stderr);
    assert_eq!(listed.len(), lost, "{}", run.stderr);
    // The missing attitudes are exactly those of the listed ticks.
    let lines = |bytes: &[u8]| -> Vec<String> {
        let text = String::from_utf8(bytes.to_vec()).unwrap();
        text.lines().skip(1).map(|line| line.split(',').next().unwrap().to_owned()).collect()
    };
    let written: HashSet<_> = lines(&bytes).into_iter().collect();
    let complete = lines(&undisturbed("", &["--for", "16s"]));
    let missing: HashSet<_> =
        (0..complete.len() as u64).filter(|tick| !written.contains(&complete[*tick as usize])).collect();
    assert_eq!(missing, listed, "{}", run.stderr);
}

/// Parses the ticks in `ticks lost, no longer cached by the other host: A to B (N), …; M in total`.
/// The ticks A and B themselves are also lost.
fn parse_lost_ticks(stderr: &str) -> HashSet<u64> {
    let lines = stderr.lines().filter_map(|line| line.split_once("no longer cached by the other host: "));
    let spans = lines.flat_map(|(_, spans)| spans.split(';').next().unwrap().split(", "));
    spans
        .flat_map(|span| {
            let words: Vec<_> = span.split_whitespace().collect();
            words[0].parse().unwrap()..=words[2].parse::<u64>().unwrap()
        })
        .collect()
}

#[test]
fn replay_and_other_speed_are_rejected_for_split_system() {
    let board = board("tcp/127.0.0.1:7451", "");
    for (arguments, reason) in [
        (&["--speed", "2"][..], "at another speed"),
        (&["--in-process"], "runs all slots in one process"),
        (&["--replay", "flight.csv"], "a replay waits for its slowest subscriber"),
    ] {
        let run = board.run(arguments);
        assert_eq!(run.code, Some(2), "{}", run.stderr);
        assert!(
            run.stderr.contains("cannot split the system over hosts") && run.stderr.contains(reason),
            "{}",
            run.stderr
        );
    }
}

#[test]
fn launch_files_of_deploy_split_are_valid() {
    for file in ["board", "base"] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("deploy/split/{file}.toml"));
        let output = plumb(&["config", "check", "--launch", path.to_str().unwrap()]).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
}

/// Two network namespaces joined by a veth pair; removed on drop.
struct Wire {
    names: [String; 2],
}

impl Wire {
    fn create() -> Result<Self, String> {
        let names = ["a", "b"].map(|end| format!("plumb-{}-{end}", std::process::id()));
        let wire = Self { names };
        let [a, b] = &wire.names;
        run("ip", &["netns", "add", a])?;
        run("ip", &["netns", "add", b])?;
        run("ip", &["-n", a, "link", "add", "wire", "type", "veth", "peer", "name", "wire", "netns", b])?;
        for (name, address) in [(a, "10.77.0.1/24"), (b, "10.77.0.2/24")] {
            run("ip", &["-n", name, "address", "add", address, "dev", "wire"])?;
            run("ip", &["-n", name, "link", "set", "lo", "up"])?;
            run("ip", &["-n", name, "link", "set", "wire", "up"])?;
        }
        Ok(wire)
    }

    fn set_state(&self, state: &str) {
        run("ip", &["-n", &self.names[0], "link", "set", "wire", state]).unwrap();
    }

    fn start(&self, end: usize, system: &System, arguments: &[&str]) -> Running {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.names[end]]);
        let inner = system.command(arguments);
        command.arg(inner.get_program()).args(inner.get_args());
        Running::spawn(command)
    }
}

impl Drop for Wire {
    fn drop(&mut self) {
        for name in &self.names {
            let _ = run("ip", &["netns", "del", name]);
        }
    }
}

fn run(program: &str, arguments: &[&str]) -> Result<(), String> {
    let output = Command::new(program).args(arguments).output().map_err(|error| format!("{program}: {error}"))?;
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    if output.status.success() { Ok(()) } else { Err(format!("{program} {}: {stderr}", arguments.join(" "))) }
}

/// Creates certificates for both hosts: `ca.pem`, and `a.pem` and `b.pem` with their keys.
fn certificates(folder: &Path) -> Result<(), String> {
    let path = |file: &str| folder.join(file).to_str().unwrap().to_owned();
    let curve = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2"];
    let authority = ["req", "-x509", "-subj", "/CN=ca", "-keyout", &path("ca.key"), "-out", &path("ca.pem")];
    run("openssl", &[&authority[..], &curve].concat())?;
    for (end, address) in [("a", "10.77.0.1"), ("b", "10.77.0.2")] {
        let (key, pem) = (path(&format!("{end}.key")), path(&format!("{end}.pem")));
        let name = format!("subjectAltName=IP:{address}");
        let (subject, ca, ca_key) = (format!("/CN={end}"), path("ca.pem"), path("ca.key"));
        let request = ["req", "-x509", "-subj", &subject, "-keyout", &key, "-out", &pem, "-addext", &name];
        let signed = ["-CA", &ca, "-CAkey", &ca_key, "-addext", "basicConstraints=critical,CA:FALSE"];
        run("openssl", &[&request[..], &signed, &curve].concat())?;
    }
    Ok(())
}

/// Access list that grants every permission to clients with a certificate.
const EVERYTHING: &str = r#"{
    enabled: true, default_permission: "deny",
    rules: [{
        id: "everything", permission: "allow", flows: ["ingress", "egress"], key_exprs: ["plumbline/**", "plumbline/v1/*/@live/**", "plumbline/v1/*/@carry"],
        messages: [
            "put", "delete", "query", "reply", "declare_subscriber", "declare_queryable",
            "liveliness_token", "liveliness_query", "declare_liveliness_subscriber",
        ],
    }],
    subjects: [{ id: "certified", link_protocols: ["quic"] }],
    policies: [{ rules: ["everything"], subjects: ["certified"] }],
}"#;

#[test]
fn unplugged_link_for_5_s_loses_no_tick() {
    let keys = tempfile::tempdir().unwrap();
    let wire = match Wire::create().and_then(|wire| certificates(keys.path()).map(|()| wire)) {
        Ok(wire) => wire,
        Err(error) => return eprintln!("skipped: cannot create namespaces or certificates: {error}"),
    };
    let path = |file: &str| keys.path().join(file).to_str().unwrap().to_owned();
    let tls = |end: &str| {
        let (ca, cert, key) = (path("ca.pem"), path(&format!("{end}.pem")), path(&format!("{end}.key")));
        format!("access = {:?}\ntls = {{ ca = {ca:?}, cert = {cert:?}, key = {key:?} }}", path("open.json5"))
    };
    // Roles are covered by the tests in `sessions`.
    fs::write(path("open.json5"), EVERYTHING).unwrap();
    let endpoint = "quic/10.77.0.1:7451";
    let board = board(endpoint, &tls("a"));
    let base = base(&board, endpoint, &tls("b"));
    let out = base.path("out.csv");
    let base_running = wire.start(1, &base, &["--for", "22s", "--out", out.to_str().unwrap()]);
    wait_for("the gateway of the base to run", || {
        service_status(&base, "gateway").is_some_and(|entry| entry["state"] == "running")
    });
    let board_running = wire.start(0, &board, &[]);
    wait_for("two seconds of ticks", || ticks(&base) > 2000);
    wire.set_state("down");
    thread::sleep(Duration::from_secs(5));
    wire.set_state("up");
    let hosts = Hosts { board, base, board_running, base_running };
    hosts.assert_undisturbed("22s");
}
