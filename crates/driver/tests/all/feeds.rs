//! Sensors and receivers on the bus of a test system.
use std::{
    sync::atomic::{AtomicU32, Ordering},
    time::{Duration, Instant},
};

use bus::{Bus, Claim, Subscriber, SystemName};
use driver::{BusError, DriverError, FixMetadata, Receiver, Sensor};
use messages::{ReceiverReading, SensorReading};

const BUFFER: usize = 300;

/// Running test system with its ingest.
struct System {
    readings: Subscriber<SensorReading>,
    bus: Bus,
    _claim: Claim,
}

impl System {
    fn start(name: &SystemName) -> Self {
        let claim = name.claim().unwrap();
        let bus = Bus::join(name, "ingest").unwrap();
        Self { readings: bus.subscriber(BUFFER).unwrap(), bus, _claim: claim }
    }
}

fn claim() -> Claim {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    let name = format!("test-driver-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::SeqCst));
    SystemName::new(&name).unwrap().claim().unwrap()
}

#[test]
fn reading_and_fix_arrive_unchanged() {
    let claim = claim();
    let bus = Bus::join(claim.system_name(), "ingest").unwrap();
    let readings = bus.subscriber::<SensorReading>(BUFFER).unwrap();
    let fixes = bus.subscriber::<ReceiverReading>(7).unwrap();
    let mut sensor = Sensor::open(claim.system_name().name()).unwrap();
    let mut receiver = Receiver::open(claim.system_name().name()).unwrap();
    assert_eq!((sensor.capacity(), receiver.capacity()), (BUFFER, 7));
    sensor.send(5, [1.0, 2.0, 3.0], [4.0, 5.0, 6.0], None).unwrap();
    sensor.send(6, [0.0; 3], [0.0; 3], Some([7.0, 8.0, 9.0])).unwrap();
    receiver.send([1.0, -2.0, 0.5], FixMetadata { latitude_rad: Some(0.8), ..FixMetadata::default() }).unwrap();
    let first = readings.receive().unwrap().unwrap();
    assert_eq!((first.t_sensor_ns, first.rate_rad_s, first.force_m_s2), (5, [1.0, 2.0, 3.0], [4.0, 5.0, 6.0]));
    assert!(first.field_ut.iter().all(|x| x.is_nan()));
    assert_eq!(readings.receive().unwrap().unwrap().field_ut, [7.0, 8.0, 9.0]);
    let fix = fixes.receive().unwrap().unwrap();
    assert_eq!((fix.velocity_m_s, fix.latitude_rad), ([1.0, -2.0, 0.5], 0.8));
    assert!(fix.velocity_sd_m_s.is_nan() && fix.age_s.is_nan());
}

#[test]
fn open_fails_without_system_or_topic() {
    assert!(matches!(Sensor::open("test-missing"), Err(DriverError::Bus(BusError::NotRunning { .. }))));
    let claim = claim();
    let message = Sensor::open(claim.system_name().name()).unwrap_err().to_string();
    assert!(message.contains("source = \"bus\""), "{message}");
}

#[test]
fn sensor_rejoins_restarted_system() {
    let name = claim().system_name().clone();
    let first = System::start(&name);
    let mut sensor = Sensor::open(name.name()).unwrap();
    drop(first);
    // The next system starts before the sensor checks whether the first one is running.
    let second = System::start(&name);
    let deadline = Instant::now() + Duration::from_secs(10);
    while second.readings.receive().unwrap().is_none() {
        assert!(Instant::now() < deadline, "no reading received");
        sensor.send(1, [0.0; 3], [0.0; 3], None).unwrap();
        std::thread::sleep(Duration::from_millis(5));
    }
    // The topic remains open for programs that join later.
    let later = second.bus.subscriber::<SensorReading>(BUFFER).unwrap();
    let mut other = Sensor::open(name.name()).unwrap();
    other.send(2, [0.0; 3], [0.0; 3], None).unwrap();
    assert_eq!(later.receive().unwrap().map(|reading| reading.t_sensor_ns), Some(2));
}

#[test]
fn send_fails_after_system_ends() {
    let name = claim().system_name().clone();
    let system = System::start(&name);
    let mut sensor = Sensor::open(name.name()).unwrap();
    drop(system);
    let deadline = Instant::now() + Duration::from_secs(10);
    let error = loop {
        assert!(Instant::now() < deadline, "no error reported");
        if let Err(error) = sensor.send(1, [0.0; 3], [0.0; 3], None) {
            break error;
        }
        std::thread::sleep(Duration::from_millis(5));
    };
    assert!(matches!(error, DriverError::Bus(BusError::NotRunning { .. })), "{error}");
}
