//! One system on two hosts: the bytes are those of the run on one, through cuts and deaths; what cannot be had again is named exactly.
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

use crate::common::{Run, Running, System, plumb, signal, until};
use rustix::process::Signal;
use serde_json::Value;

const TOPICS: &str = "[\"gyro\", \"accel\", \"mag\", \"gnss\"]";

/// A port that nobody has.
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

/// The bytes of the run in one process.
fn undisturbed(launch: &str, arguments: &[&str]) -> Vec<u8> {
    let system = System::new(launch);
    let out = system.path("out.csv");
    let more = ["--in-process", "--speed", "max", "--out", out.to_str().unwrap()];
    system.run(&[arguments, &more].concat()).assert_whole();
    fs::read(out).unwrap()
}

/// Both halves, the base first; the board runs until the base has all its ticks.
struct Halves {
    board: System,
    base: System,
    board_runs: Running,
    base_runs: Running,
}

impl Halves {
    fn start(board: System, base: System, duration: &str) -> Self {
        let out = base.path("out.csv");
        let base_runs = base.start(&["--for", duration, "--out", out.to_str().unwrap()]);
        until("the base to wait", || standing(&base, "gateway").is_some_and(|one| one["state"] == "running"));
        let board_runs = board.start(&[]);
        until("ticks at the base", || ticks(&base) > 0);
        Self { board, base, board_runs, base_runs }
    }

    /// The run of the base, and what it wrote.
    fn end(self) -> (Run, Vec<u8>) {
        let Self { board, base, board_runs, base_runs } = self;
        let run = base_runs.wait();
        board_runs.interrupt();
        let of_board = board_runs.wait();
        of_board.assert_whole();
        assert_eq!((board.remains(), base.remains()), (Vec::new(), Vec::new()));
        println!("{}\n{}", of_board.people, run.people);
        (run, fs::read(base.path("out.csv")).unwrap())
    }

    fn assert_undisturbed(self, duration: &str) -> Run {
        let (run, bytes) = self.end();
        run.assert_whole();
        assert!(bytes == undisturbed("", &["--for", duration]), "the bytes differ: {}", run.people);
        run
    }
}

fn standing(system: &System, service: &str) -> Option<Value> {
    let output = plumb(&["ps", "--json", "--system", &system.name]).output().unwrap();
    let all: Vec<Value> = serde_json::from_slice(&output.stdout).unwrap_or_default();
    all.into_iter().find(|one| one["service"] == service)
}

/// Ticks that have come to the base.
fn ticks(base: &System) -> u64 {
    standing(base, "gateway").and_then(|one| one["ticks"].as_u64()).unwrap_or(0)
}

fn restarts(run: &Run, service: &str) -> u64 {
    let services = run.json["services"].as_array().unwrap();
    services.iter().find(|one| one["name"] == service).unwrap()["restarts"].as_u64().unwrap()
}

/// A way between two hosts that can be cut: nothing is forwarded, connections break, and nobody gets through.
struct Way {
    port: u16,
    cut: Arc<AtomicBool>,
    ends: Arc<AtomicBool>,
}

impl Way {
    fn to(port: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        listener.set_nonblocking(true).unwrap();
        let way = Self { port: listener.local_addr().unwrap().port(), cut: Arc::default(), ends: Arc::default() };
        let (cut, ends) = (way.cut.clone(), way.ends.clone());
        thread::spawn(move || {
            while !ends.load(Ordering::SeqCst) {
                let Ok((here, _)) = listener.accept() else {
                    thread::sleep(Duration::from_millis(5));
                    continue;
                };
                if let (false, Ok(there)) = (cut.load(Ordering::SeqCst), TcpStream::connect(("127.0.0.1", port))) {
                    forward(&here, &there, &cut);
                    forward(&there, &here, &cut);
                }
            }
        });
        way
    }

    fn cut_for(&self, duration: Duration) {
        self.cut.store(true, Ordering::SeqCst);
        thread::sleep(duration);
        self.cut.store(false, Ordering::SeqCst);
    }
}

impl Drop for Way {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::SeqCst);
        self.cut.store(true, Ordering::SeqCst);
    }
}

fn forward(from: &TcpStream, to: &TcpStream, cut: &Arc<AtomicBool>) {
    let (mut from, mut to, cut) = (from.try_clone().unwrap(), to.try_clone().unwrap(), cut.clone());
    from.set_nonblocking(false).unwrap();
    from.set_read_timeout(Some(Duration::from_millis(10))).unwrap();
    thread::spawn(move || {
        let mut bytes = [0; 65_536];
        while !cut.load(Ordering::SeqCst) {
            match from.read(&mut bytes) {
                Ok(0) => break,
                Ok(count) if to.write_all(&bytes[..count]).is_err() => break,
                Ok(_) => {}
                Err(error) if matches!(error.kind(), std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut) => {
                }
                Err(_) => break,
            }
        }
        // The other side may have done so already.
        let _ = from.shutdown(Shutdown::Both);
        let _ = to.shutdown(Shutdown::Both);
    });
}

fn over(way: &Way) -> String {
    format!("tcp/127.0.0.1:{}", way.port)
}

#[test]
fn two_halves_give_the_bytes_of_the_whole() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let board = board(&endpoint, "");
    let base = base(&board, &endpoint, "");
    Halves::start(board, base, "5s").assert_undisturbed("5s");
}

#[test]
fn ticks_come_from_whom_the_base_calls_and_from_nobody_who_calls_it() {
    let called = format!("tcp/127.0.0.1:{}", free_port());
    let honest = board(&called, "");
    let base = base(&honest, &called, "");
    let base_runs = base.start(&[]);
    let at = || Some(standing(&base, "gateway")?["address"].as_str()?.to_owned());
    until("the base to listen", || at().is_some());
    // Another system under the name of the board.
    let more = format!("vehicle = \"{}\"\nconnect = [{:?}]", honest.name, at().unwrap());
    let forger = board(&format!("tcp/127.0.0.1:{}", free_port()), &more);
    let forger_runs = forger.start(&[]);
    until("forged ticks", || ticks(&forger) > 3000);
    assert_eq!(ticks(&base), 0);
    // It is not deaf: the one that it calls it hears.
    let honest_runs = honest.start(&[]);
    until("ticks at the base", || ticks(&base) > 0);
    drop((forger_runs, honest_runs, base_runs));
}

#[test]
fn field_and_fixes_go_with_their_ticks() {
    for (scenario, flag) in [("cruise", "fix"), ("s3", "field")] {
        let endpoint = format!("tcp/127.0.0.1:{}", free_port());
        let launch = format!("[ingest.sim]\nscenario = \"{scenario}\"");
        let board = board(&endpoint, &launch);
        let base = base(&board, &endpoint, "");
        let (run, bytes) = Halves::start(board, base, "4s").end();
        run.assert_whole();
        assert!(bytes == undisturbed(&launch, &["--for", "4s"]), "the bytes differ: {}", run.people);
        let flags = run.line("flags");
        assert!(flags.contains(flag) && !flags.contains("aiding-missing"), "{flags}");
    }
}

#[test]
fn gateways_that_are_killed_lose_nothing_and_change_no_byte() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let board = board(&endpoint, "");
    let base = base(&board, &endpoint, "");
    let halves = Halves::start(board, base, "15s");
    for (system, runs) in [(&halves.board, &halves.board_runs), (&halves.base, &halves.base_runs)] {
        let before = ticks(&halves.base);
        until("more ticks", || ticks(&halves.base) > before + 1000);
        signal(runs.service("gateway"), Signal::KILL);
        until("the next gateway", || standing(system, "gateway").is_some_and(|one| one["restarts"] == 1));
    }
    let run = halves.assert_undisturbed("15s");
    assert_eq!(restarts(&run, "gateway"), 1);
}

#[test]
fn a_slot_is_swapped_on_the_host_that_has_it_and_no_tick_is_lost() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let board = board(&endpoint, "");
    let base = base(&board, &endpoint, "");
    let halves = Halves::start(board, base, "8s");
    for (system, slot, stage) in [(&halves.base, "fuser", "vqf"), (&halves.board, "gyro", "rk4")] {
        let report = system.swap(&[slot, stage]);
        println!("{report}");
        assert_eq!(report["outcome"], "committed", "{report}");
    }
    let elsewhere = halves.base.ask_swap(&["gyro", "rk4"]);
    assert!(elsewhere["reason"].as_str().unwrap().contains("slots: fuser, course"), "{elsewhere}");
    let (run, _) = halves.end();
    run.assert_whole();
}

#[test]
fn a_stage_of_ones_own_fills_a_slot_there_as_anywhere_else() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let board = board(&endpoint, "");
    let base = base(&board, &endpoint, "");
    // Not the system's: it is asked for once more when that has ended.
    let home = tempfile::tempdir().unwrap();
    let folder = home.path().join("mine");
    let output = plumb(&["stage", "new", "mine", "--lang", "python", "--dir"]).arg(&folder).output().unwrap();
    assert!(output.status.success(), "{output:?}");
    let command = format!("[\"python3\", {:?}]", folder.join("mine.py"));
    let own = format!("[fuser]\nstage = \"mine\"\n[stages.mine]\nslot = \"fuser\"\ncommand = {command}\n");
    base.add(&own);
    let halves = Halves::start(board, base, "5s");
    signal(halves.base_runs.service("fuser"), Signal::KILL);
    let (run, bytes) = halves.end();
    run.assert_whole();
    assert_eq!(restarts(&run, "fuser"), 1);
    assert!(bytes == undisturbed(&own, &["--for", "5s"]), "the bytes differ: {}", run.people);
}

#[test]
fn slots_on_both_hosts_that_are_killed_lose_nothing_and_change_no_byte() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let board = board(&endpoint, "");
    let base = base(&board, &endpoint, "");
    let halves = Halves::start(board, base, "8s");
    for (runs, service) in [
        (&halves.base_runs, "fuser"),
        (&halves.board_runs, "gyro"),
        (&halves.base_runs, "course"),
        (&halves.board_runs, "ingest"),
    ] {
        thread::sleep(Duration::from_millis(900));
        signal(runs.service(service), Signal::KILL);
    }
    halves.assert_undisturbed("8s");
}

#[test]
fn after_a_cut_of_five_seconds_nothing_is_missing() {
    let port = free_port();
    let way = Way::to(port);
    let board = board(&format!("tcp/127.0.0.1:{port}"), "");
    let base = base(&board, &over(&way), "");
    let halves = Halves::start(board, base, "16s");
    until("two seconds of ticks", || ticks(&halves.base) > 2000);
    way.cut_for(Duration::from_secs(5));
    let before = ticks(&halves.base);
    let began = Instant::now();
    until("the ticks of the cut", || ticks(&halves.base) > before + 5000);
    println!("5000 ticks more {:.1} s after a cut of 5 s", began.elapsed().as_secs_f64());
    halves.assert_undisturbed("16s");
}

#[test]
fn a_cut_longer_than_the_cache_is_named_exactly() {
    let port = free_port();
    let way = Way::to(port);
    let board = board(&format!("tcp/127.0.0.1:{port}"), "cache_s = 1");
    let base = base(&board, &over(&way), "");
    let halves = Halves::start(board, base, "16s");
    until("two seconds of ticks", || ticks(&halves.base) > 2000);
    way.cut_for(Duration::from_secs(4));
    let (run, bytes) = halves.end();
    assert_eq!((run.code, run.number("/not_recorded")), (Some(1), 0.0), "{}", run.people);
    let lost = run.number("/lost") as usize;
    assert!(lost > 1000 && run.number("/ticks_in") == 16_000.0, "{}", run.people);
    let named = named_losses(&run.people);
    assert_eq!(named.len(), lost, "{}", run.people);
    // The attitudes that are not there are those of the ticks named, and no others.
    let lines = |bytes: &[u8]| -> Vec<String> {
        let text = String::from_utf8(bytes.to_vec()).unwrap();
        text.lines().skip(1).map(|line| line.split(',').next().unwrap().to_owned()).collect()
    };
    let there: HashSet<_> = lines(&bytes).into_iter().collect();
    let whole = lines(&undisturbed("", &["--for", "16s"]));
    let missing: HashSet<_> = (0..whole.len() as u64).filter(|tick| !there.contains(&whole[*tick as usize])).collect();
    assert_eq!(missing, named, "{}", run.people);
}

/// Parses the ticks in `ticks lost, no longer cached by the other host: A to B (N), …; M in total`.
fn named_losses(people: &str) -> HashSet<u64> {
    let lines = people.lines().filter_map(|line| line.split_once("no longer cached by the other host: "));
    let spans = lines.flat_map(|(_, spans)| spans.split(';').next().unwrap().split(", "));
    spans
        .flat_map(|span| {
            let words: Vec<_> = span.split_whitespace().collect();
            words[0].parse().unwrap()..=words[2].parse::<u64>().unwrap()
        })
        .collect()
}

#[test]
fn a_replay_and_another_speed_are_refused_with_the_reason() {
    let board = board("tcp/127.0.0.1:7451", "");
    for (arguments, why) in [
        (&["--speed", "2"][..], "at another speed"),
        (&["--in-process"], "runs all slots in one process"),
        (&["--replay", "flight.csv"], "a replay waits for its slowest subscriber"),
    ] {
        let run = board.run(arguments);
        assert_eq!(run.code, Some(2), "{}", run.people);
        assert!(run.people.contains("cannot split the system over hosts") && run.people.contains(why), "{}", run.people);
    }
}

#[test]
fn the_launch_files_of_deploy_split_are_right() {
    for file in ["board", "base"] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("deploy/split/{file}.toml"));
        let output = plumb(&["config", "check", path.to_str().unwrap()]).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
}

/// Two network namespaces with a wire between them; they go with the test.
struct Wire {
    names: [String; 2],
}

impl Wire {
    fn lay() -> Result<Self, String> {
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

    fn set(&self, state: &str) {
        run("ip", &["-n", &self.names[0], "link", "set", "wire", state]).unwrap();
    }

    fn start(&self, end: usize, system: &System, arguments: &[&str]) -> Running {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.names[end]]);
        let inner = system.command(arguments);
        command.arg(inner.get_program()).args(inner.get_args());
        Running::of(command)
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
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    if output.status.success() { Ok(()) } else { Err(format!("{program} {}: {said}", arguments.join(" "))) }
}

/// Certificates for both ends in a folder: `ca.pem`, and `a.pem` and `b.pem` with their keys.
fn certificates(folder: &Path) -> Result<(), String> {
    let at = |file: &str| folder.join(file).to_str().unwrap().to_owned();
    let curve = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2"];
    let authority = ["req", "-x509", "-subj", "/CN=ca", "-keyout", &at("ca.key"), "-out", &at("ca.pem")];
    run("openssl", &[&authority[..], &curve].concat())?;
    for (end, address) in [("a", "10.77.0.1"), ("b", "10.77.0.2")] {
        let (key, pem) = (at(&format!("{end}.key")), at(&format!("{end}.pem")));
        let name = format!("subjectAltName=IP:{address}");
        let (subject, ca, ca_key) = (format!("/CN={end}"), at("ca.pem"), at("ca.key"));
        let own = ["req", "-x509", "-subj", &subject, "-keyout", &key, "-out", &pem, "-addext", &name];
        let signed = ["-CA", &ca, "-CAkey", &ca_key, "-addext", "basicConstraints=critical,CA:FALSE"];
        run("openssl", &[&own[..], &signed, &curve].concat())?;
    }
    Ok(())
}

/// An access list that lets whoever shows a certificate do everything.
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
fn a_wire_that_is_pulled_for_five_seconds_costs_no_tick() {
    let keys = tempfile::tempdir().unwrap();
    let wire = match Wire::lay().and_then(|wire| certificates(keys.path()).map(|()| wire)) {
        Ok(wire) => wire,
        Err(why) => return eprintln!("skipped: no network of one's own here: {why}"),
    };
    let at = |file: &str| keys.path().join(file).to_str().unwrap().to_owned();
    let tls = |end: &str| {
        let (ca, cert, key) = (at("ca.pem"), at(&format!("{end}.pem")), at(&format!("{end}.key")));
        format!("access = {:?}\ntls = {{ ca = {ca:?}, cert = {cert:?}, key = {key:?} }}", at("open.json5"))
    };
    // Who may do what is tested with the keys.
    fs::write(at("open.json5"), EVERYTHING).unwrap();
    let endpoint = "quic/10.77.0.1:7451";
    let board = board(endpoint, &tls("a"));
    let base = base(&board, endpoint, &tls("b"));
    let out = base.path("out.csv");
    let base_runs = wire.start(1, &base, &["--for", "22s", "--out", out.to_str().unwrap()]);
    until("the base to wait", || standing(&base, "gateway").is_some_and(|one| one["state"] == "running"));
    let board_runs = wire.start(0, &board, &[]);
    until("two seconds of ticks", || ticks(&base) > 2000);
    wire.set("down");
    thread::sleep(Duration::from_secs(5));
    wire.set("up");
    let halves = Halves { board, base, board_runs, base_runs };
    halves.assert_undisturbed("22s");
}
