//! `plumb demo`.

use std::{
    io::{BufRead as _, BufReader},
    process::Stdio,
};

use crate::common::{System, plumb, signal};
use rustix::process::Signal;

#[test]
fn demo_loses_nothing_and_runs_until_it_is_interrupted() {
    let system = System::new("");
    let mut demo = plumb(&["demo", "--system", &system.name]).stdout(Stdio::piped()).spawn().unwrap();
    let lines = BufReader::new(demo.stdout.take().unwrap()).lines().map(Result::unwrap);
    let mut text = String::new();
    for line in lines {
        text += &format!("{line}\n");
        if line.starts_with("Try in another terminal") {
            system.wait_until_running();
            signal(demo.id(), Signal::INT);
        }
    }
    assert!(demo.wait().unwrap().success(), "{text}");
    let name = &system.name;
    for part in [
        "changes of the chart",
        "kill -9 fuser\n",
        "plumb swap fuser vqf\n",
        "   0 lost, 0 different in any bit",
        "Cockpit: http",
        &format!("plumb top --system {name}\n"),
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    assert_eq!(system.leftovers(), Vec::<String>::new());
}

#[test]
fn demo_of_a_name_in_use_reports_the_reason() {
    let system = System::new("[ingest.sim]\nrate_hz = 200\n");
    let running = system.start(&[]);
    system.wait_until_running();
    let mut demo = plumb(&["demo", "--stop", "--system", &system.name]);
    // The demonstration keeps its log, so its temporary folder is set to the folder of the test.
    let demo = demo.env("TMPDIR", system.path("")).output().unwrap();
    let stderr = String::from_utf8_lossy(&demo.stderr);
    assert_eq!(demo.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains("is already running"), "{stderr}");
    running.interrupt();
    running.wait().assert_complete();
}
