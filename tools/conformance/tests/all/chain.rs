//! Runs faulty sensor readings through the complete chain: the conditioner of ingest, which must
//! correct or reject them, and the stages of all slots.
use attitude::Quaternion;
use launch::{GyroSamples, Launch, Slot};
use messages::AttitudeOutput;
use readings::{conditioner::Conditioner, source::Reading};
use runtime::{Pace, ServiceConfig};
use scenario::{Motion, SensorErrors, Sensors};

const RATE_HZ: f64 = 100.0;
const INTERVAL_NS: i64 = 10_000_000;
const FAULT_START: usize = 2000;

/// Name, number of readings and effect of a fault. The effect receives the reading to change, the
/// last reading before the fault, and the index of the reading within the fault.
type Fault = (&'static str, usize, fn(&mut Reading, &Reading, i64));

const FAULTS: [Fault; 12] = [
    ("NaN rate", 200, |reading, _, _| reading.rate_rad_s[1] = f64::NAN),
    ("NaN force", 300, |reading, _, _| reading.force_m_s2 = [f64::NAN; 3]),
    ("NaN rate and force", 100, |reading, _, _| {
        (reading.rate_rad_s, reading.force_m_s2) = ([f64::NAN; 3], [f64::NAN; 3])
    }),
    ("infinite rate and force", 100, |reading, _, _| {
        (reading.rate_rad_s, reading.force_m_s2) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    }),
    ("rate and force of 1e300", 100, |reading, _, _| (reading.rate_rad_s[0], reading.force_m_s2[1]) = (1e300, -1e300)),
    ("timestamps of zero", 100, |reading, _, _| reading.t_ns = 0),
    ("constant timestamps", 100, |reading, last, _| reading.t_ns = last.t_ns),
    ("decreasing timestamps", 100, |reading, last, i| reading.t_ns = last.t_ns - i * INTERVAL_NS),
    ("jumping timestamps", 100, |reading, _, i| reading.t_ns += (i % 7 - 3) * 3_000_000_000),
    ("timestamps at the ends of the i64 range", 100, |reading, _, i| {
        reading.t_ns = if i % 2 == 0 { i64::MAX } else { i64::MIN }
    }),
    ("repeated reading", 100, |reading, last, _| *reading = *last),
    ("sensors all zero", 200, |reading, _, _| (reading.rate_rad_s, reading.force_m_s2) = ([0.0; 3], [0.0; 3])),
];

/// Returns readings from a motion with sensor errors and one fault, each with the true attitude.
fn readings(motion: Motion, fault: &Fault) -> Vec<(Reading, Quaternion<f64>)> {
    let mut sensors = Sensors::new(motion, SensorErrors::S1, 11);
    let mut readings: Vec<_> = (0..8000)
        .map(|count| {
            let reading = sensors.read(count as f64 / RATE_HZ);
            let raw = Reading {
                t_ns: count * INTERVAL_NS,
                rate_rad_s: reading.rate_rad_s.into(),
                force_m_s2: reading.force_m_s2.into(),
                field_ut: None,
                fix: None,
                reference: None,
            };
            (raw, reading.truth.attitude.quaternion())
        })
        .collect();
    let (_, length, change) = fault;
    let last = readings[FAULT_START - 1].0;
    for (i, (reading, _)) in (0..).zip(&mut readings[FAULT_START..FAULT_START + length]) {
        change(reading, &last, i);
    }
    readings
}

/// Runs the chain and returns the last attitude together with the true one.
fn last_attitude(fuser: &str, motion: Motion, fault: &Fault) -> (AttitudeOutput, Quaternion<f64>) {
    let (name, ..) = fault;
    let mut launch = Launch::default();
    launch.fuser.stage = fuser.into();
    let mut conditioner = Conditioner::new(&launch.ingest, RATE_HZ, GyroSamples::Instants).unwrap();
    let config = ServiceConfig::standalone(launch, RATE_HZ, Pace::Max);
    let mut path = pipeline::Path::new(&config).unwrap();
    let (mut next_tick, mut last) = (0, None);
    for (reading, truth) in readings(motion, fault) {
        let Some(sample) = conditioner.condition(&reading) else { continue };
        let offered = path.offer(sample, &mut |output| {
            let norm2: f64 = output.quaternion.iter().map(|x| x * x).sum();
            assert_eq!(output.header.tick, next_tick, "{fuser}, {name}");
            assert!((norm2 - 1.0).abs() < 1e-9, "{fuser}, {name}, tick {next_tick}: {:?}", output.quaternion);
            let numbers = [output.yaw_rad, output.pitch_rad, output.roll_rad, output.course_rad];
            let numbers = numbers.iter().chain(&output.rate_rad_s).chain(&output.jump);
            assert!(numbers.chain([&output.inclination_sd_rad]).all(|x| x.is_finite()), "{fuser}, {name}: {output:?}");
            next_tick += 1;
            last = Some((output, truth));
        });
        offered.unwrap();
    }
    assert_eq!(next_tick, conditioner.ticks(), "{fuser}, {name}: ticks are missing");
    last.unwrap()
}

#[test]
fn chain_output_is_valid_for_any_reading() {
    for (_, fuser) in conformance::stages().filter(|(slot, _)| *slot == Slot::Fuser) {
        for fault in &FAULTS {
            last_attitude(fuser, Motion::from_name("tumble").unwrap(), fault);
            last_attitude(fuser, Motion::S1, fault);
        }
    }
}

#[test]
fn default_and_wz_recover_from_every_reading_fault() {
    for (fuser, fault) in
        ["multiple-model", "wz"].into_iter().flat_map(|fuser| FAULTS.iter().map(move |fault| (fuser, fault)))
    {
        let (output, truth) = last_attitude(fuser, Motion::S1, fault);
        let [w, x, y, z] = output.quaternion;
        let e = Quaternion::new(w, x, y, z) * truth.conjugate();
        let error_deg = (2.0 * e.i.hypot(e.j).atan2(e.w.hypot(e.k))).to_degrees();
        println!("{fuser}, {}: {error_deg:.3}°", fault.0);
        assert!(error_deg < 0.35, "{fuser}, {}: {error_deg}°", fault.0);
    }
}
