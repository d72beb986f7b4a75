//! A program's feeds on the bus of a system that only the test has.
use std::sync::atomic::{AtomicU32, Ordering};

use bus::{Bus, Claim, SystemName};
use driver::{BusError, DriverError, Known, Receiver, Sensor};
use messages::{ReceiverReading, SensorReading};

const BUFFER: usize = 300;

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
