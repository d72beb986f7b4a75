//! Seeing a running system from outside: every verb shows what is there, and none of them can disturb it.
use std::{
    fs,
    io::{BufRead, BufReader, Read},
    path::PathBuf,
    process::{Child, Command, Output, Stdio},
    time::{Duration, Instant},
};

use crate::common::{Running, System, lives, plumb, signal, until};
use graph::{Service, Topic};
use messages::{Layout, Message};
use rustix::process::Signal;
use serde_json::Value;

/// How long a test waits for what a machine with much to do shows later; the limit is only there to end a failed test.
const PATIENCE: Duration = Duration::from_secs(30);

/// `plumb` about a system, for scripts.
fn about(system: &System, arguments: &[&str]) -> Command {
    let mut command = plumb(arguments);
    command.args(["--json", "--system", &system.name]);
    command
}

fn ask(system: &System, arguments: &[&str]) -> Output {
    about(system, arguments).output().unwrap()
}

/// The JSON on each line of standard output.
fn lines(output: &Output) -> Vec<Value> {
    let text = String::from_utf8(output.stdout.clone()).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|_| panic!("no JSON: {line}"))).collect()
}

/// What a verb that succeeds says, on its one line.
fn answer(system: &System, arguments: &[&str]) -> Value {
    let output = ask(system, arguments);
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", said(&output));
    let [answer] = lines(&output).try_into().unwrap();
    answer
}

/// The same, once `holds` is true of it: rates and states of one moment are those of the machine too, which may have much to do.
fn answer_that(system: &System, arguments: &[&str], holds: impl Fn(&Value) -> bool) -> Value {
    lines_that(system, arguments, |lines| holds(&lines[0])).remove(0)
}

fn lines_that(system: &System, arguments: &[&str], hold: impl Fn(&[Value]) -> bool) -> Vec<Value> {
    let deadline = Instant::now() + PATIENCE;
    loop {
        let lines = lines(&ask(system, arguments));
        if !lines.is_empty() && hold(&lines) {
            return lines;
        }
        assert!(Instant::now() < deadline, "{arguments:?}: {lines:?}");
    }
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Every service of the system works.
fn all_run(system: &System) -> bool {
    let ps = ask(system, &["ps"]);
    lines(&ps).first().is_some_and(|all| all.as_array().unwrap().iter().all(|one| one["state"] == "running"))
}

/// A system that publishes attitudes.
fn started(system: &System, arguments: &[&str]) -> Running {
    let running = system.start(arguments);
    let flows = |hz: &Output| lines(hz).iter().any(|hz| hz["messages"] == 2);
    until("attitudes", || {
        flows(&ask(system, &["topic", "hz", "attitude", "--count", "2", "--seconds", "0.2"])) && all_run(system)
    });
    running
}

fn number(value: &Value, key: &str) -> f64 {
    value[key].as_f64().unwrap_or_else(|| panic!("no {key} in {value}"))
}

fn layout(topic: &str) -> Layout {
    messages::layout(Topic::from_name(topic).unwrap())
}

/// Observers of a test; whatever becomes of the test, none lives on.
struct Observer(Child);

impl Observer {
    fn start(system: &System, arguments: &[&str]) -> Self {
        let mut command = about(system, arguments);
        Self(command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap())
    }

    fn pid(&self) -> u32 {
        self.0.id()
    }

    /// It reads the topic.
    fn await_reading(&self, system: &System, topic: &str) {
        until("the observer to read", || {
            let info = answer(system, &["topic", "info", topic, "--seconds", "0.01"]);
            info["subscribers"].as_array().unwrap().iter().any(|port| port["pid"] == self.pid())
        });
    }

    fn first_line(&mut self) -> String {
        let mut line = String::new();
        BufReader::new(self.0.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
        line
    }

    fn output(mut self) -> Output {
        let (mut stdout, mut stderr) = (Vec::new(), Vec::new());
        self.0.stdout.take().unwrap().read_to_end(&mut stdout).unwrap();
        self.0.stderr.take().unwrap().read_to_end(&mut stderr).unwrap();
        Output { status: self.0.wait().unwrap(), stdout, stderr }
    }
}

impl Drop for Observer {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn every_verb_shows_a_running_system_as_it_is() {
    let system = System::new("buffer_s = 2.0\nlateness_s = 1.0\n");
    let running = started(&system, &[]);

    let is_at_rate = |one: &Value| one["rate_hz"].as_f64().is_some_and(|rate_hz| (500.0..1500.0).contains(&rate_hz));
    let published: Vec<_> = Service::PATH.iter().map(|service| service.output().unwrap().name()).collect();
    let list = answer_that(&system, &["topic", "list"], |list| {
        let mut topics =
            list.as_array().unwrap().iter().filter(|one| published.contains(&one["topic"].as_str().unwrap()));
        topics.all(is_at_rate)
    });
    let topics = list.as_array().unwrap();
    for topic in published.iter().copied() {
        let one = topics.iter().find(|one| one["topic"] == topic).unwrap_or_else(|| panic!("no {topic}"));
        assert_eq!(one["type"], layout(topic).name);
        assert_eq!((one["buffer"].as_u64(), one["publishers"].as_array().unwrap().len()), (Some(2000), 1), "{one}");
        assert!(one["subscribers"].as_array().unwrap().iter().all(|port| port["alive"] == true), "{one}");
    }

    let info = answer(&system, &["topic", "info", "fused"]);
    let fused = messages::FusedState::layout();
    assert_eq!(info["fingerprint"], format!("{:016x}", fused.fingerprint()));
    assert_eq!(
        (info["publishers"][0]["name"].as_str(), info["subscribers"][0]["name"].as_str()),
        (Some("fuser"), Some("course"))
    );
    let fields = info["fields"].as_array().unwrap();
    let bias = fields.iter().find(|field| field["name"] == "bias_rad_s").unwrap();
    assert_eq!(
        (bias["unit"].as_str(), bias["offset"].as_u64(), bias["type"].as_str()),
        (Some("rad/s"), Some(120), Some("[f64; 3]"))
    );
    assert!(bias["meaning"].as_str().unwrap().starts_with("Gyro bias, rad/s"), "{bias}");

    let echo = ask(&system, &["topic", "echo", "imu", "--count", "3", "--every", "3"]);
    let messages = lines(&echo);
    let ticks: Vec<_> = messages.iter().map(|message| message["tick"].as_u64().unwrap()).collect();
    assert!(ticks.windows(2).all(|pair| pair[1] == pair[0] + 3) && ticks.len() == 3, "{ticks:?}");
    let names: Vec<_> = messages[0].as_object().unwrap().keys().cloned().collect();
    let mut expected: Vec<_> = layout("imu").fields.iter().map(|field| field.name.to_owned()).collect();
    expected.sort();
    assert_eq!(names, expected);
    assert_eq!(messages[0]["flags"], serde_json::json!(["rate-instant"]));

    let hz = answer_that(&system, &["topic", "hz", "attitude", "--seconds", "1"], is_at_rate);
    assert_eq!((hz["lost"].as_u64(), hz["measured_by"].as_str()), (Some(0), Some("sent")));
    let interval = |name| number(&hz["interval_ms"], name);
    assert!(0.0 <= interval("min") && interval("min") <= interval("mean") && interval("mean") <= interval("max"));

    let bw = answer(&system, &["topic", "bw", "attitude", "--count", "500"]);
    assert_eq!(bw["messages"], 500);
    assert!((number(&bw, "bytes_per_s") / number(&bw, "rate_hz") - 224.0).abs() < 1e-6, "{bw}");

    let moments = lines_that(&system, &["top", "--count", "2", "--interval", "0.5"], |moments| {
        let rows = |moment: &Value| moment["services"].as_array().unwrap()[..5].to_vec();
        moments.iter().flat_map(rows).all(|one| one["state"] == "running" && is_at_rate(&one))
    });
    assert_eq!(moments.len(), 2);
    for moment in &moments {
        let services = moment["services"].as_array().unwrap();
        let names: Vec<_> = services.iter().map(|one| one["service"].as_str().unwrap()).collect();
        assert_eq!(names, ["ingest", "gyro", "accel", "fuser", "course", "supervisor"]);
        for one in &services[..5] {
            assert_eq!(one["lost"], 0, "{one}");
            assert!(number(one, "resident_mib") > 1.0 && number(one, "cpu_percent") > 0.0, "{one}");
            let latency = &one["latency_us"];
            assert!(
                number(latency, "p50") <= number(latency, "p99") && number(latency, "p99") <= number(latency, "max")
            );
        }
        assert!(number(&moment["latency_us"], "p50") > 0.0, "{moment}");
    }

    let doctor = answer_that(&system, &["doctor", "--seconds", "1"], |doctor| {
        doctor["checks"].as_array().unwrap().iter().all(|check| check["result"] != "problem")
    });
    let checks = doctor["checks"].as_array().unwrap();
    let found = |check: &str, words: &str| {
        checks.iter().any(|one| one["check"] == check && one["found"].as_str().unwrap().contains(words))
    };
    assert!(found("rates", "declared 1000.0 Hz") && found("services", "fuser running"), "{doctor}");
    assert!(found("flags", "rate-instant on ") && found("gravity", "the body moves"), "{doctor}");

    running.interrupt();
    running.wait().assert_whole();
    assert_eq!(system.remains(), Vec::<String>::new());
}

#[test]
fn a_rate_is_shown_once_a_second_and_once_at_the_end() {
    let system = System::new("");
    let running = started(&system, &[]);
    for verb in ["hz", "bw"] {
        let output = plumb(&["topic", verb, "attitude", "--seconds", "2", "--system", &system.name]).output().unwrap();
        let shown = String::from_utf8(output.stdout).unwrap();
        let lines: Vec<_> = shown.lines().collect();
        assert!((1..=2).contains(&lines.len()) && lines.iter().all(|line| line.starts_with("attitude: ")), "{shown}");
    }
    running.interrupt();
    running.wait().assert_whole();
}

#[test]
fn observers_that_are_killed_or_frozen_cost_the_system_no_tick() {
    let system = System::new("buffer_s = 4.0\nlateness_s = 2.0\n");
    let running = started(&system, &[]);
    for (round, topic) in ["imu", "fused", "attitude", "gyro", "imu", "health"].iter().enumerate() {
        let observers: Vec<_> =
            [&["topic", "hz", topic][..], &["topic", "echo", topic], &["top", "--interval", "0.05"]]
                .iter()
                .map(|verb| Observer::start(&system, verb))
                .collect();
        std::thread::sleep(Duration::from_millis(40 + 60 * round as u64));
        observers.iter().for_each(|observer| signal(observer.pid(), Signal::KILL));
    }
    let frozen: Vec<_> = (0..bus::MAX_OBSERVERS - 1).map(|_| Observer::start(&system, &["topic", "hz", "imu"])).collect();
    frozen.iter().for_each(|observer| observer.await_reading(&system, "imu"));
    frozen.iter().for_each(|observer| signal(observer.pid(), Signal::STOP));
    // Longer than buffer_s.
    std::thread::sleep(Duration::from_millis(6000));
    let restarted = running.service("fuser");
    signal(restarted, Signal::KILL);
    let goes_on = |(service, pid): &(String, u32)| service == "fuser" && *pid != restarted;
    until("the fuser to go on", || running.services().iter().any(goes_on) && all_run(&system));
    std::thread::sleep(Duration::from_millis(500));
    for observer in frozen {
        signal(observer.pid(), Signal::CONT);
        std::thread::sleep(Duration::from_millis(300));
        signal(observer.pid(), Signal::INT);
        let output = observer.output();
        let hz = &lines(&output)[0];
        assert!(hz["missed"].as_u64() > Some(1000), "what it slept through is its own loss: {hz}");
        assert_eq!(hz["lost"], 0, "{hz}");
    }
    running.interrupt();
    let run = running.wait();
    run.assert_whole();
    assert_eq!(system.remains(), Vec::<String>::new());
}

#[test]
fn one_observer_too_many_is_told_so() {
    let system = System::new("");
    let running = started(&system, &[]);
    let top = Observer::start(&system, &["top"]);
    top.await_reading(&system, "attitude");
    let observers: Vec<_> = (1..bus::MAX_OBSERVERS)
        .map(|_| {
            let mut observer = Observer::start(&system, &["topic", "echo", "imu"]);
            observer.first_line();
            observer
        })
        .collect();
    let refused = ask(&system, &["topic", "hz", "imu", "--count", "1"]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(said(&refused).contains("4 observers are attached already"), "{}", said(&refused));
    let pid = observers[0].pid().to_string();
    assert!(said(&refused).contains(&pid), "{}", said(&refused));
    let doctor = ask(&system, &["doctor"]);
    let check = lines(&doctor)[0]["checks"].as_array().unwrap().last().unwrap().clone();
    assert!(check["remedy"].as_str().unwrap().contains(&pid), "{check}");
    drop((observers, top));
    running.interrupt();
    running.wait().assert_whole();
}

#[test]
fn ctrl_c_ends_an_observation_with_its_summary() {
    let system = System::new("");
    let running = started(&system, &[]);
    for verb in [&["topic", "hz", "imu"][..], &["topic", "bw", "imu"]] {
        let observer = Observer::start(&system, verb);
        observer.await_reading(&system, "imu");
        std::thread::sleep(Duration::from_millis(300));
        signal(observer.pid(), Signal::INT);
        let output = observer.output();
        assert_eq!(output.status.code(), Some(0), "{}", said(&output));
        assert!(number(&lines(&output)[0], "messages") > 0.0);
    }
    let mut echo = Observer::start(&system, &["topic", "echo", "imu"]);
    echo.first_line();
    signal(echo.pid(), Signal::INT);
    let output = echo.output();
    assert_eq!(output.status.code(), Some(0));
    assert!(said(&output).contains("lost on the bus 0"), "{}", said(&output));
    running.interrupt();
    running.wait().assert_whole();
}

#[test]
fn an_observation_ends_with_its_system() {
    let system = System::new("");
    let running = started(&system, &[]);
    let observer = Observer::start(&system, &["topic", "hz", "imu"]);
    observer.await_reading(&system, "imu");
    running.interrupt();
    running.wait().assert_whole();
    let output = observer.output();
    assert_eq!(output.status.code(), Some(0), "{}", said(&output));
    assert!(said(&output).contains("has ended"), "{}", said(&output));
    assert_eq!(system.remains(), Vec::<String>::new());
}

#[test]
fn a_frozen_observer_of_a_killed_system_is_in_nobodys_way() {
    let system = System::new("");
    let killed = started(&system, &[]);
    let observer = Observer::start(&system, &["topic", "hz", "imu"]);
    observer.await_reading(&system, "imu");
    signal(observer.pid(), Signal::STOP);
    signal(killed.pid(), Signal::KILL);
    drop(killed);
    let running = started(&system, &[]);
    signal(observer.pid(), Signal::CONT);
    let output = observer.output();
    assert_eq!(output.status.code(), Some(0), "{}", said(&output));
    assert!(said(&output).contains("has ended"), "{}", said(&output));
    let hz = answer(&system, &["topic", "hz", "imu", "--count", "100"]);
    assert_eq!((hz["messages"].as_u64(), hz["lost"].as_u64()), (Some(100), Some(0)), "{hz}");
    running.interrupt();
    running.wait().assert_whole();
    assert_eq!(system.remains(), Vec::<String>::new());
}

#[test]
fn where_nothing_runs_that_is_said_and_the_machine_is_looked_at_all_the_same() {
    let system = System::new("");
    for verb in [&["topic", "list"][..], &["topic", "hz", "imu"], &["top", "--count", "1"]] {
        let output = ask(&system, verb);
        assert_eq!(output.status.code(), Some(1), "{verb:?}");
        let [object] = lines(&output).try_into().unwrap();
        assert!(object["error"].as_str().unwrap().contains("is not running"), "{object}");
        assert!(said(&output).contains("is not running"), "{}", said(&output));
    }
    let unknown = ask(&system, &["topic", "hz"]);
    assert_eq!(unknown.status.code(), Some(2));
    let doctor = answer(&system, &["doctor"]);
    let checks: Vec<_> =
        doctor["checks"].as_array().unwrap().iter().map(|one| one["check"].as_str().unwrap()).collect();
    assert!(
        ["shared-memory", "open-files", "clock-monotonic", "leftovers", "system"].iter().all(|it| checks.contains(it))
    );
    assert_eq!(system.remains(), Vec::<String>::new());
}

/// The check that the doctor made of what was left behind.
fn leftovers(output: &Output) -> Value {
    let [doctor] = lines(output).try_into().unwrap();
    let checks = doctor["checks"].as_array().unwrap();
    checks.iter().find(|check| check["check"] == "leftovers").unwrap().clone()
}

#[test]
fn the_doctor_finds_what_a_killed_system_left_and_removes_it() {
    let (dead, living) = (System::new(""), System::new(""));
    let (killed, running) = (started(&dead, &[]), started(&living, &[]));
    // As every process of the system does.
    let member = fs::File::open(format!("/dev/shm/plumbline.{}.members", dead.name)).unwrap();
    rustix::fs::flock(&member, rustix::fs::FlockOperation::LockShared).unwrap();
    // It must not start again what is killed.
    signal(killed.pid(), Signal::STOP);
    let services = killed.all_services();
    services.iter().for_each(|(_, pid)| signal(*pid, Signal::KILL));
    signal(killed.pid(), Signal::KILL);
    drop(killed);
    until("the killed services to end", || !services.iter().any(|(_, pid)| lives(*pid)));

    let lingering = ask(&dead, &["doctor", "--fix"]);
    let check = leftovers(&lingering);
    assert_eq!((lingering.status.code(), check["result"].as_str()), (Some(1), Some("problem")), "{check}");
    assert!(check["remedy"].as_str().unwrap().contains(&format!("kill -KILL {}", std::process::id())), "{check}");
    let left = dead.remains();
    assert!(left.len() > 10, "nothing is taken from a process that lives: {left:?}");
    drop(member);

    let found = ask(&dead, &["doctor"]);
    let check = leftovers(&found);
    assert_eq!((found.status.code(), check["result"].as_str()), (Some(1), Some("problem")), "{check}");
    assert_eq!(check["remedy"], "plumb doctor --fix");
    assert_eq!(dead.remains(), left, "the doctor only looks");
    let fixed = ask(&dead, &["doctor", "--fix"]);
    let check = leftovers(&fixed);
    assert_eq!((fixed.status.code(), check["result"].as_str()), (Some(0), Some("ok")), "{check}");
    assert_eq!(dead.remains(), Vec::<String>::new());
    assert_eq!(leftovers(&ask(&dead, &["doctor"]))["found"], "none");

    // The supervisor clears such remains away by itself now and then, perhaps before the doctor looks.
    let after_an_observer = |arguments: &[&str]| {
        let observer = Observer::start(&living, &["topic", "hz", "imu"]);
        observer.await_reading(&living, "imu");
        signal(observer.pid(), Signal::KILL);
        drop(observer);
        ask(&living, arguments)
    };
    until("the doctor to see what an observer left", || {
        leftovers(&after_an_observer(&["doctor", "--seconds", "0.1"]))["result"] == "warning"
    });
    until("the doctor to remove what an observer left", || {
        let fixed = after_an_observer(&["doctor", "--fix", "--seconds", "1"]);
        fixed.status.success() && leftovers(&fixed)["found"].as_str().unwrap().ends_with("removed")
    });
    running.interrupt();
    running.wait().assert_whole();
}

/// A recording of sensors that lie still, 100 Hz, with forces about `force`.
fn still(system: &System, force: f64) -> PathBuf {
    let path = system.path("still.csv");
    let row = |i: u32| {
        let noise = f64::from(i * 7919 % 101) * 1e-5;
        format!("{:.2},{noise},{},0.001,{noise},{},{}\n", f64::from(i) * 0.01, -noise, 2.0 * noise, force + noise)
    };
    fs::write(&path, "t_s,gx,gy,gz,ax,ay,az\n".to_owned() + &(0..6000).map(row).collect::<String>()).unwrap();
    path
}

#[test]
fn the_doctor_holds_sensors_at_rest_against_gravity() {
    for (force, code, result) in [(9.81, 0, "ok"), (1.0, 1, "problem")] {
        let system = System::new("");
        let recording = still(&system, force);
        let running = started(&system, &["--replay", recording.to_str().unwrap(), "--speed", "1"]);
        let output = ask(&system, &["doctor", "--seconds", "1.5"]);
        let [doctor] = lines(&output).try_into().unwrap();
        let checks = doctor["checks"].as_array().unwrap();
        let of = |name: &str| checks.iter().find(|check| check["check"] == name).unwrap();
        assert_eq!((of("gravity")["result"].as_str(), output.status.code()), (Some(result), Some(code)), "{doctor}");
        assert!(of("gravity")["found"].as_str().unwrap().ends_with("at rest"), "{doctor}");
        assert_eq!(of("gyro-at-rest")["result"], "ok", "{doctor}");
        assert!(of("rates")["found"].as_str().unwrap().contains("declared 100.0 Hz"), "{doctor}");
        running.interrupt();
        running.wait();
    }
}
