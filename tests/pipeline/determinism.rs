//! Identical input gives identical output bytes: in one process or five, at any speed, and
//! regardless of scheduling and start order.
use std::{fs, time::Duration};

use crate::common::{System, signal};
use rustix::process::Signal;

/// Pseudo-random choices in a test, derived from a seed.
struct Choices(u64);

impl Choices {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % limit
    }

    fn shuffled<T, const N: usize>(&mut self, mut items: [T; N]) -> [T; N] {
        for i in (1..N).rev() {
            items.swap(i, self.below(i as u64 + 1) as usize);
        }
        items
    }
}

/// Returns a launch file with buffers large enough for any stall of a loaded machine.
fn launch(order: [&str; 5], source: &str) -> String {
    format!("services = {order:?}\nbuffer_s = 20.0\nlateness_s = 10.0\n{source}")
}

const ORDER: [&str; 5] = ["ingest", "gyro", "accel", "fuser", "course"];

/// Returns the output and the digest line of a run in one process.
fn in_one_process(source: &str, arguments: &[&str]) -> (Vec<u8>, String) {
    let system = System::new(&launch(ORDER, source));
    let out = system.path("out.csv");
    let out_text = out.to_str().unwrap();
    let run = system.run(&[&["--in-process", "--speed", "max", "--out", out_text], arguments].concat());
    run.assert_complete();
    (fs::read(out).unwrap(), run.line("digest").to_owned())
}

fn assert_same_in_five(seed: u64, source: &str, arguments: &[&str], expected: &(Vec<u8>, String)) {
    let mut choices = Choices(seed);
    let system = System::new(&launch(choices.shuffled(ORDER), source));
    let out = system.path("out.csv");
    let running = system.start(&[&["--out", out.to_str().unwrap()], arguments].concat());
    for _ in 0..12 {
        let services = running.services();
        if !services.is_empty() {
            let pid = services[choices.below(services.len() as u64) as usize].1;
            signal(pid, Signal::STOP);
            std::thread::sleep(Duration::from_millis(choices.below(120)));
            signal(pid, Signal::CONT);
        }
        std::thread::sleep(Duration::from_millis(choices.below(120)));
    }
    let run = running.wait();
    run.assert_complete();
    assert_eq!(run.line("digest"), expected.1, "seed {seed}: {}", run.stderr);
    assert!(fs::read(out).unwrap() == expected.0, "seed {seed}: the files differ");
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn simulation_at_speed_1_is_deterministic() {
    let arguments = ["--for", "3s"];
    let expected = in_one_process("", &arguments);
    assert_eq!(expected.0.iter().filter(|byte| **byte == b'\n').count(), 3001);
    for seed in 0..6 {
        assert_same_in_five(seed, "", &arguments, &expected);
    }
}

#[test]
fn lockstep_is_deterministic() {
    let source = "[ingest.sim]\nscenario = \"tumble\"\nseed = 5";
    let arguments = ["--for", "300s"];
    let expected = in_one_process(source, &arguments);
    for seed in 100..106 {
        assert_same_in_five(seed, source, &[&arguments[..], &["--speed", "max"]].concat(), &expected);
    }
}

#[test]
fn bad_recording_is_deterministic_at_any_speed() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("bad.csv");
    let mut text = String::from("t_s,gx,gy,gz,ax,ay,az\n");
    let mut choices = Choices(42);
    let mut t_ms = 0;
    for row in 0..4000 {
        t_ms += match choices.below(200) {
            0 => 0,
            1 => 300,
            2 => 2_500,
            _ => 5,
        };
        let value = |choices: &mut Choices| match choices.below(300) {
            0 => "nan".into(),
            1 => "-inf".into(),
            n => format!("{:.4}", (n as f64 - 150.0) / 100.0 + (f64::from(row) * 0.01).sin()),
        };
        let values: Vec<String> = (0..6).map(|_| value(&mut choices)).collect();
        text += &format!("{}.{:03},{}\n", t_ms / 1000, t_ms % 1000, values.join(","));
    }
    fs::write(&file, text).unwrap();
    let replay = ["--replay", file.to_str().unwrap()];
    let expected = in_one_process("", &replay);
    for (seed, speed) in (200..).zip(["max", "1000", "40", "max"]) {
        assert_same_in_five(seed, "", &[&replay[..], &["--speed", speed]].concat(), &expected);
    }
}

#[test]
fn fields_and_fixes_are_deterministic() {
    let flight =
        "[ingest.sim]\nscenario = \"cruise\"\nrate_hz = 200\n[fuser]\nstage = \"aided\"\n[course]\nstage = \"track\"";
    let field = "[ingest.sim]\nscenario = \"s3\"\n[fuser]\nstage = \"wz\"\nset.magnetometer_delay_s = 0.01";
    let default_stages = "[ingest.sim]\nscenario = \"cruise\"\nrate_hz = 200";
    for (seeds, source, length) in
        [(300..303, flight, "120s"), (310..313, field, "15s"), (315..317, default_stages, "120s")]
    {
        let arguments = ["--for", length, "--speed", "max"];
        let expected = in_one_process(source, &arguments[..2]);
        for seed in seeds {
            assert_same_in_five(seed, source, &arguments, &expected);
        }
    }
}

#[recorded::test]
fn recorded_flight_is_deterministic_and_depends_on_fixes() {
    let Some(data) = crate::common::data() else { return };
    let file = data.join("flights/apm_plane_log2_imu.csv.gz");
    let replay = ["--replay", file.to_str().unwrap()];
    let stage = "[fuser]\nstage = \"aided\"\n";
    let expected = in_one_process(stage, &replay);
    assert_same_in_five(320, stage, &[&replay[..], &["--speed", "max"]].concat(), &expected);
    let without = in_one_process(&format!("[ingest.replay]\ngnss = \"off\"\n{stage}"), &replay);
    assert!(without.0 != expected.0, "the fixes have no effect");
}

#[test]
fn injected_faults_are_deterministic() {
    let kinds = [
        "\"off\"",
        "\"stuck\"",
        "\"garbage\"\nseed = 7",
        "\"miscalibrated\"\nfactor = -0.7",
        "\"slow\"\nevery = 7",
        "\"delayed\"\ndelay_s = 0.123",
        "\"intermittent\"\nshare = 0.61\nseed = 9",
    ];
    let sensors = ["gyro", "accel", "mag", "gnss", "all"];
    let mut fault_entries = String::new();
    for (i, (sensor, kind)) in sensors.iter().flat_map(|sensor| kinds.map(|kind| (sensor, kind))).enumerate() {
        let from_s = 1.0 + 0.37 * i as f64;
        let until_s = from_s + 0.61;
        fault_entries +=
            &format!("[[ingest.fault]]\nsensor = {sensor:?}\nkind = {kind}\nfrom_s = {from_s}\nuntil_s = {until_s}\n");
    }
    let flight =
        "[ingest.sim]\nscenario = \"cruise\"\nrate_hz = 200\n[fuser]\nstage = \"aided\"\n[course]\nstage = \"track\"";
    let field = "[ingest.sim]\nscenario = \"s3\"\n[fuser]\nstage = \"wz\"";
    for (seeds, source, length) in [(330..333, flight, "60s"), (340..342, field, "18s")] {
        let source = format!("faults = true\n{source}\n{fault_entries}");
        let arguments = ["--for", length, "--speed", "max"];
        let expected = in_one_process(&source, &arguments[..2]);
        for seed in seeds {
            assert_same_in_five(seed, &source, &arguments, &expected);
        }
    }
    let clean = in_one_process(flight, &["--for", "60s"]);
    let faulty = in_one_process(&format!("faults = true\n{flight}\n{fault_entries}"), &["--for", "60s"]);
    assert!(clean.0 != faulty.0, "the faults have no effect");
}
