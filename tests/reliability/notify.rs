//! Notifications to a service manager: datagrams sent by real processes.
use std::{
    os::{
        linux::net::SocketAddrExt,
        unix::net::{SocketAddr, UnixDatagram},
    },
    process::Command,
    time::Duration,
};

use crate::common::{Running, System, wait_for};
use bus::{Bus, SystemName};
use messages::SensorReading;
use runtime::clock::{monotonic_ns, sleep_until_ns};
use scenario::{Motion, SensorErrors, Sensors};

const RATE_HZ: f64 = 500.0;
/// Capacity of the topic `sensor` in messages: two seconds of readings, which is the default.
const BUFFER: usize = 1000;
const BUS: &str = "[ingest]\nsource = \"bus\"\n[ingest.bus]\nrate_hz = 500.0\ngyro_samples = \"instants\"\n";
/// Watchdog timeout, µs. The watchdog is fed four times per timeout.
const WATCHDOG: (&str, &str) = ("WATCHDOG_USEC", "400000");
/// Time to wait for a message that must not arrive: five times the watchdog timeout.
const SILENCE: Duration = Duration::from_secs(2);
/// Maximum time to wait for a message. It elapses only if a test fails.
const TIMEOUT: Duration = Duration::from_secs(60);

/// Returns the next datagram received by the manager's socket, or `None` after `limit`.
fn receive(manager: &UnixDatagram, limit: Duration) -> Option<String> {
    let mut message = [0; 4096];
    manager.set_read_timeout(Some(limit)).unwrap();
    let length = manager.recv(&mut message).ok()?;
    Some(String::from_utf8(message[..length].to_vec()).unwrap())
}

#[test]
fn watchdog_is_fed_only_while_ticks_arrive() {
    let system = System::new(BUS);
    let path = system.path("notify");
    let manager = UnixDatagram::bind(&path).unwrap();
    let mut command = system.command(&[]);
    command.env("NOTIFY_SOCKET", &path).envs([WATCHDOG]);
    let running = Running::spawn(command);
    assert_eq!(receive(&manager, TIMEOUT).as_deref(), Some("READY=1"));
    assert_eq!(running.services().len(), 5);
    assert_eq!(receive(&manager, SILENCE), None, "notified before the first tick");

    let bus = Bus::join(&SystemName::new(&system.name).unwrap(), "test").unwrap();
    let sensor = bus.publisher::<SensorReading>(BUFFER).unwrap();
    let mut sensors = Sensors::new(Motion::S1, SensorErrors::S1, 3);
    let mut count = 0.0;
    for _ in 0..2 {
        // The watchdog must be fed while the sensor publishes, regardless of the speed of the
        // machine.
        let mut feeds = 0;
        wait_for("three feeds", || {
            let start_ns = monotonic_ns();
            for step in 0..10 {
                sleep_until_ns(start_ns + step * 2_000_000);
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
        // Ticks that are still in transit may feed the watchdog once more.
        let late = receive(&manager, SILENCE);
        assert!(late.is_none() || receive(&manager, SILENCE).is_none(), "fed without ticks");
        assert_eq!(running.services().len(), 5, "all services are running");
    }
    drop((sensor, bus));
    running.interrupt();
    assert_eq!(running.wait().code, Some(0));
    assert_eq!(receive(&manager, TIMEOUT).as_deref(), Some("STOPPING=1"));
    assert_eq!(receive(&manager, Duration::from_millis(1)), None);
}

/// Runs a one-second simulation with a notification socket in the abstract namespace. Returns all
/// its notifications.
fn run_with(environment: &[(&str, &str)]) -> Vec<String> {
    let system = System::new("");
    let manager = UnixDatagram::bind_addr(&SocketAddr::from_abstract_name(&system.name).unwrap()).unwrap();
    let mut command: Command = system.command(&["--for", "1s"]);
    command.env("NOTIFY_SOCKET", format!("@{}", system.name)).envs(environment.iter().copied());
    let running = Running::spawn(command);
    let mut notifications = Vec::new();
    while notifications.last().is_none_or(|last| last != "STOPPING=1") {
        notifications.push(receive(&manager, TIMEOUT).unwrap());
    }
    running.wait().assert_complete();
    assert_eq!(receive(&manager, Duration::from_millis(1)), None);
    notifications
}

#[test]
fn abstract_socket_receives_all_notifications() {
    let notifications = run_with(&[WATCHDOG]);
    assert_eq!(
        (notifications.first().unwrap().as_str(), notifications.last().unwrap().as_str()),
        ("READY=1", "STOPPING=1")
    );
    let between = &notifications[1..notifications.len() - 1];
    assert!(!between.is_empty() && between.iter().all(|it| it == "WATCHDOG=1"), "{notifications:?}");
}

#[test]
fn watchdog_of_other_process_is_not_fed() {
    assert_eq!(run_with(&[]), ["READY=1", "STOPPING=1"]);
    assert_eq!(run_with(&[WATCHDOG, ("WATCHDOG_PID", "1")]), ["READY=1", "STOPPING=1"]);
}

#[test]
fn unreachable_notify_socket_is_an_error() {
    let system = System::new("");
    let mut command = system.command(&[]);
    command.env("NOTIFY_SOCKET", system.path("nowhere"));
    let run = Running::spawn(command).wait();
    assert_eq!(run.code, Some(1));
    assert!(run.stderr.contains("NOTIFY_SOCKET"), "{}", run.stderr);
}
