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
