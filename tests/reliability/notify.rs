//! What a service manager hears of a system: real datagrams of real processes.
use std::{
    os::{
        linux::net::SocketAddrExt,
        unix::net::{SocketAddr, UnixDatagram},
    },
    process::Command,
    time::Duration,
};

use crate::common::{Running, System, until};
use bus::{Bus, SystemName};
use messages::SensorReading;
use runtime::clock::{monotonic_ns, sleep_until_ns};
use scenario::{SensorErrors, Motion, Sensors};

const RATE_HZ: f64 = 500.0;
/// Two seconds, as a launch file has it unless told otherwise.
const BUFFER: usize = 1000;
const BUS: &str = "[ingest]\nsource = \"bus\"\n[ingest.bus]\nrate_hz = 500.0\ngyro_samples = \"instants\"\n";
/// The watchdog's limit; it is fed four times as often.
const WATCHDOG: (&str, &str) = ("WATCHDOG_USEC", "400000");
/// Five times the watchdog's limit.
const SILENCE: Duration = Duration::from_secs(2);
/// Only there to end a failed test.
const LIMIT: Duration = Duration::from_secs(60);

/// What a manager's socket hears within `limit`.
fn receive(manager: &UnixDatagram, limit: Duration) -> Option<String> {
    let mut message = [0; 4096];
    manager.set_read_timeout(Some(limit)).unwrap();
    let length = manager.recv(&mut message).ok()?;
    Some(String::from_utf8(message[..length].to_vec()).unwrap())
}

#[test]
fn the_watchdog_is_fed_while_ticks_arrive_and_starves_when_the_source_stands_still() {
    let system = System::new(BUS);
    let path = system.path("notify");
    let manager = UnixDatagram::bind(&path).unwrap();
    let mut command = system.command(&[]);
    command.env("NOTIFY_SOCKET", &path).envs([WATCHDOG]);
    let running = Running::of(command);
    assert_eq!(receive(&manager, LIMIT).as_deref(), Some("READY=1"));
    assert_eq!(running.services().len(), 5);
    assert_eq!(receive(&manager, SILENCE), None, "no tick has come");

    let bus = Bus::join(&SystemName::new(&system.name).unwrap(), "test").unwrap();
    let sensor = bus.publisher::<SensorReading>(BUFFER).unwrap();
    let mut sensors = Sensors::new(Motion::S1, SensorErrors::S1, 3);
    let mut count = 0.0;
    for _ in 0..2 {
        // Fed while the sensor speaks, at whatever speed this machine has.
        let mut feeds = 0;
        until("three feeds", || {
            let start_ns = monotonic_ns();
            for step in 0..10 {
                sleep_until_ns(start_ns + step * 2_000_000, Duration::from_secs(1));
                let reading = sensors.read(count / RATE_HZ);
                let t_sensor_ns = (count * 1e9 / RATE_HZ).round() as i64;
                let (rate_rad_s, force_m_s2) = (reading.rate_rad_s.into(), reading.force_m_s2.into());
                sensor.send(&SensorReading { t_sensor_ns, rate_rad_s, force_m_s2, field_ut: [f64::NAN; 3] }).unwrap();
                sensor.wake();
                count += 1.0;
            }
            feeds += std::iter::from_fn(|| receive(&manager, Duration::from_millis(1)))
                .filter(|it| it == "WATCHDOG=1")
                .count();
            feeds >= 3
        });
        // What was on its way may still feed it once.
        let late = receive(&manager, SILENCE);
        assert!(late.is_none() || receive(&manager, SILENCE).is_none(), "fed without ticks");
        assert_eq!(running.services().len(), 5, "everything still runs");
    }
    drop((sensor, bus));
    running.interrupt();
    assert_eq!(running.wait().code, Some(0));
    assert_eq!(receive(&manager, LIMIT).as_deref(), Some("STOPPING=1"));
    assert_eq!(receive(&manager, Duration::from_millis(1)), None);
}

/// Runs a second of a simulation that tells an abstract socket; what that heard up to the end.
fn run_with(environment: &[(&str, &str)]) -> Vec<String> {
    let system = System::new("");
    let manager = UnixDatagram::bind_addr(&SocketAddr::from_abstract_name(&system.name).unwrap()).unwrap();
    let mut command: Command = system.command(&["--for", "1s"]);
    command.env("NOTIFY_SOCKET", format!("@{}", system.name)).envs(environment.iter().copied());
    let running = Running::of(command);
    let mut heard = Vec::new();
    while heard.last().is_none_or(|last| last != "STOPPING=1") {
        heard.push(receive(&manager, LIMIT).unwrap());
    }
    running.wait().assert_whole();
    assert_eq!(receive(&manager, Duration::from_millis(1)), None);
    heard
}

#[test]
fn an_abstract_socket_hears_the_same() {
    let heard = run_with(&[WATCHDOG]);
    assert_eq!((heard.first().unwrap().as_str(), heard.last().unwrap().as_str()), ("READY=1", "STOPPING=1"));
    let between = &heard[1..heard.len() - 1];
    assert!(!between.is_empty() && between.iter().all(|it| it == "WATCHDOG=1"), "{heard:?}");
}

#[test]
fn a_watchdog_that_is_not_ours_is_not_fed() {
    assert_eq!(run_with(&[]), ["READY=1", "STOPPING=1"]);
    assert_eq!(run_with(&[WATCHDOG, ("WATCHDOG_PID", "1")]), ["READY=1", "STOPPING=1"]);
}

#[test]
fn a_manager_that_cannot_be_reached_is_told_of_at_once() {
    let system = System::new("");
    let mut command = system.command(&[]);
    command.env("NOTIFY_SOCKET", system.path("nowhere"));
    let run = Running::of(command).wait();
    assert_eq!(run.code, Some(1));
    assert!(run.people.contains("NOTIFY_SOCKET"), "{}", run.people);
}
