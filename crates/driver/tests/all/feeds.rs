//! A program's feeds on the bus of a system that only the test has.
use std::{
    sync::atomic::{AtomicU32, Ordering},
    time::{Duration, Instant},
};

use bus::{Bus, Claim, Subscriber, SystemName};
use driver::{BusError, DriverError, Known, Receiver, Sensor};
use messages::{ReceiverReading, SensorReading};

const BUFFER: usize = 300;

/// A system's owner and its ingest.
struct System {
    readings: Subscriber<SensorReading>,
    bus: Bus,
    _claim: Claim,
}

impl System {
    fn begin(name: &SystemName) -> Self {
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
fn a_reading_and_a_fix_arrive_as_they_were_sent_and_the_topic_says_how_much_it_holds() {
    let claim = claim();
    let bus = Bus::join(claim.system_name(), "ingest").unwrap();
    let readings = bus.subscriber::<SensorReading>(BUFFER).unwrap();
    let fixes = bus.subscriber::<ReceiverReading>(7).unwrap();
    let mut sensor = Sensor::open(claim.system_name().name()).unwrap();
    let mut receiver = Receiver::open(claim.system_name().name()).unwrap();
    assert_eq!((sensor.holds(), receiver.holds()), (BUFFER, 7));
    sensor.send(5, [1.0, 2.0, 3.0], [4.0, 5.0, 6.0], None).unwrap();
    sensor.send(6, [0.0; 3], [0.0; 3], Some([7.0, 8.0, 9.0])).unwrap();
    receiver.send([1.0, -2.0, 0.5], Known { latitude_rad: Some(0.8), ..Known::default() }).unwrap();
    let first = readings.receive().unwrap().unwrap();
    assert_eq!((first.t_sensor_ns, first.rate_rad_s, first.force_m_s2), (5, [1.0, 2.0, 3.0], [4.0, 5.0, 6.0]));
    assert!(first.field_ut.iter().all(|x| x.is_nan()));
    assert_eq!(readings.receive().unwrap().unwrap().field_ut, [7.0, 8.0, 9.0]);
    let fix = fixes.receive().unwrap().unwrap();
    assert_eq!((fix.velocity_m_s, fix.latitude_rad), ([1.0, -2.0, 0.5], 0.8));
    assert!(fix.velocity_sd_m_s.is_nan() && fix.age_s.is_nan());
}

#[test]
fn a_system_that_does_not_run_or_takes_no_readings_is_named_with_the_remedy() {
    assert!(matches!(Sensor::open("test-nobody"), Err(DriverError::Bus(BusError::NotRunning { .. }))));
    let claim = claim();
    let refused = Sensor::open(claim.system_name().name()).unwrap_err().to_string();
    assert!(refused.contains("source = \"bus\""), "{refused}");
}

#[test]
fn a_program_that_feeds_a_system_that_ends_feeds_the_next_one_and_takes_nothing_from_it() {
    let name = claim().system_name().clone();
    let first = System::begin(&name);
    let mut sensor = Sensor::open(name.name()).unwrap();
    drop(first);
    // The next system begins before the program has looked.
    let second = System::begin(&name);
    let deadline = Instant::now() + Duration::from_secs(10);
    while second.readings.receive().unwrap().is_none() {
        assert!(Instant::now() < deadline, "no reading has come");
        sensor.send(1, [0.0; 3], [0.0; 3], None).unwrap();
        std::thread::sleep(Duration::from_millis(5));
    }
    // Its topic is still there for whoever comes later.
    let later = second.bus.subscriber::<SensorReading>(BUFFER).unwrap();
    let mut other = Sensor::open(name.name()).unwrap();
    other.send(2, [0.0; 3], [0.0; 3], None).unwrap();
    assert_eq!(later.receive().unwrap().map(|reading| reading.t_sensor_ns), Some(2));
}

#[test]
fn what_is_sent_where_no_system_runs_is_gone_and_the_program_is_told() {
    let name = claim().system_name().clone();
    let system = System::begin(&name);
    let mut sensor = Sensor::open(name.name()).unwrap();
    drop(system);
    let deadline = Instant::now() + Duration::from_secs(10);
    let refused = loop {
        assert!(Instant::now() < deadline, "nothing was said");
        if let Err(error) = sensor.send(1, [0.0; 3], [0.0; 3], None) {
            break error;
        }
        std::thread::sleep(Duration::from_millis(5));
    };
    assert!(matches!(refused, DriverError::Bus(BusError::NotRunning { .. })), "{refused}");
}
