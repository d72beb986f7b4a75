//! `plumb detect`: a sensor on a pseudo-terminal is recognised, and the printed source runs.
use std::{
    io::Write as _,
    sync::atomic::{AtomicBool, Ordering},
    thread::{self, sleep},
    time::Duration,
};

use serde_json::Value;

use crate::{
    common::{System, plumb, wait_for},
    pipeline::drivers::open_serial_device,
};

/// Sets a flag on drop, even if the test fails.
struct SetOnDrop<'a>(&'a AtomicBool);

impl Drop for SetOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::SeqCst);
    }
}

/// Runs `steps` while a device sends lines at about 100 Hz, with the time in ms, rates in °/s and
/// forces in g.
fn with_sensor(system: &System, steps: impl FnOnce(&str)) {
    let port = system.path("imu");
    let mut device = open_serial_device(&port);
    let is_done = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| {
            for n in 0u64.. {
                if is_done.load(Ordering::SeqCst) {
                    break;
                }
                writeln!(device, "{},0.1,0.2,-0.1,0.01,0.02,{}", 5000 + 10 * n, 0.99 + 0.001 * (n % 7) as f64).unwrap();
                sleep(Duration::from_millis(10));
            }
        });
        let _done = SetOnDrop(&is_done);
        steps(port.to_str().unwrap());
    });
}

fn detect(port: &str) -> (Option<i32>, Value) {
    let output = plumb(&["detect", "--json", port]).output().unwrap();
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    (output.status.code(), found["ports"][0].clone())
}

#[test]
fn detected_source_delivers_readings() {
    let system = System::new("restart.silence_s = 3.0");
    with_sensor(&system, |port| {
        let (code, found) = detect(port);
        assert_eq!((code, &found["format"], &found["up_axis"]), (Some(0), &"csv".into(), &"+z".into()), "{found}");
        let line = found["source"].as_str().unwrap();
        assert!(line.contains("units=ms,deg/s,g"), "{line}");
        // A bare path is a serial port.
        let bare = line.strip_prefix("serial:").unwrap();
        let running = system.start(&["--source", bare]);
        wait_for("readings", || {
            let services = system.ps();
            services
                .iter()
                .find(|one| one["service"] == "ingest")
                .is_some_and(|ingest| ingest["ticks"].as_u64() >= Some(50))
        });
        running.interrupt();
        assert_eq!(running.wait().code, Some(0));
    });
}

#[test]
fn silent_missing_and_other_files_are_reported() {
    let system = System::new("");
    let port = system.path("silent");
    let _device = open_serial_device(&port);
    let (code, found) = detect(port.to_str().unwrap());
    assert_eq!((code, &found["found"]), (Some(1), &"silent".into()), "{found}");
    let (code, found) = detect(system.path("missing").to_str().unwrap());
    assert_eq!((code, &found["found"]), (Some(1), &"failed".into()), "{found}");
    assert!(found["remedy"].as_str().unwrap().contains("plug the device in"), "{found}");
    let (code, found) = detect("/dev/null");
    assert_eq!((code, &found["found"]), (Some(1), &"failed".into()), "{found}");
    assert!(found["remedy"].as_str().unwrap().contains("is not a serial port"), "{found}");
}
