//! Readings as sensors send them, through ingest's conditioner and the slots: stamps and values that no stage sees as they are.
use attitude::Quaternion;
use ingest::{conditioner::Conditioner, source::Reading};
use launch::{GyroSamples, Launch};
use messages::AttitudeOutput;
use runtime::{Pace, ServiceConfig};
use scenario::{Errors, Motion, Sensors};

const RATE_HZ: f64 = 100.0;
const USUAL_NS: i64 = 10_000_000;
const BEGIN: usize = 2000;

/// A fault of raw readings, and the readings that it lasts for.
type Fault = (&'static str, usize, fn(&mut Reading, &Reading, i64));

const FAULTS: [Fault; 12] = [
    ("rate not a number", 200, |it, _, _| it.rate_rad_s[1] = f64::NAN),
    ("force not a number", 300, |it, _, _| it.force_m_s2 = [f64::NAN; 3]),
    ("everything not a number", 100, |it, _, _| (it.rate_rad_s, it.force_m_s2) = ([f64::NAN; 3], [f64::NAN; 3])),
    ("rates and forces infinite", 100, |it, _, _| {
        (it.rate_rad_s, it.force_m_s2) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    }),
    ("rates and forces of 1e300", 100, |it, _, _| (it.rate_rad_s[0], it.force_m_s2[1]) = (1e300, -1e300)),
    ("stamps of zero", 100, |it, _, _| it.t_ns = 0),
    ("stamps that stand", 100, |it, last, _| it.t_ns = last.t_ns),
    ("stamps that run backward", 100, |it, last, i| it.t_ns = last.t_ns - i * USUAL_NS),
    ("stamps that leap", 100, |it, _, i| it.t_ns += (i % 7 - 3) * 3_000_000_000),
    ("stamps at the ends of 64 bits", 100, |it, _, i| it.t_ns = if i % 2 == 0 { i64::MAX } else { i64::MIN }),
    ("the same reading again", 100, |it, last, _| *it = *last),
    ("sensors all zero", 200, |it, _, _| (it.rate_rad_s, it.force_m_s2) = ([0.0; 3], [0.0; 3])),
];

/// S1 with its errors and one fault, and the truth at each reading.
fn readings(motion: Motion, fault: &Fault) -> Vec<(Reading, Quaternion<f64>)> {
    let mut sensors = Sensors::new(motion, Errors::S1, 11);
    let mut readings: Vec<_> = (0..8000)
        .map(|count| {
            let reading = sensors.read(count as f64 / RATE_HZ);
            let raw = Reading {
                t_ns: count * USUAL_NS,
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
    let last = readings[BEGIN - 1].0;
    for (i, (reading, _)) in (0..).zip(&mut readings[BEGIN..BEGIN + length]) {
        change(reading, &last, i);
    }
    readings
}

/// Runs the chain; the last attitude and the truth there.
fn last_attitude(fuser: &str, motion: Motion, fault: &Fault) -> (AttitudeOutput, Quaternion<f64>) {
    let (what, ..) = fault;
    let mut launch = Launch::default();
    launch.fuser.stage = fuser.into();
    let mut conditioner = Conditioner::new(&launch.ingest, RATE_HZ, GyroSamples::Instants).unwrap();
    let config = ServiceConfig {
        launch,
        rate_hz: RATE_HZ,
        pace: Pace::Max,
        max_ticks: None,
        incarnation: 0,
        epoch: 1,
        role: runtime::Role::Owner { from_tick: 0 },
        prior: None,
        resume: None,
        publishes_readings: false,
        supervisor_pid: 0,
    };
    let mut path = pipeline::Path::new(&config).unwrap();
    let (mut next_tick, mut last) = (0, None);
    for (reading, truth) in readings(motion, fault) {
        let Some(sample) = conditioner.condition(&reading) else { continue };
        let offered = path.offer(sample, &mut |output| {
            let norm2: f64 = output.quaternion.iter().map(|x| x * x).sum();
            assert_eq!(output.header.tick, next_tick, "{fuser}, {what}");
            assert!((norm2 - 1.0).abs() < 1e-9, "{fuser}, {what}, tick {next_tick}: {:?}", output.quaternion);
            let numbers = [output.yaw_rad, output.pitch_rad, output.roll_rad, output.course_rad];
            let numbers = numbers.iter().chain(&output.rate_rad_s).chain(&output.jump);
            assert!(numbers.chain([&output.inclination_sd_rad]).all(|x| x.is_finite()), "{fuser}, {what}: {output:?}");
            next_tick += 1;
            last = Some((output, truth));
        });
        offered.unwrap();
    }
    assert_eq!(next_tick, conditioner.ticks(), "{fuser}, {what}: every tick comes out");
    last.unwrap()
}

#[test]
fn whatever_is_read_every_tick_comes_out_finite_and_of_unit_length() {
    for (_, fuser) in conformance::stages().filter(|(slot, _)| *slot == "fuser") {
        for fault in &FAULTS {
            last_attitude(fuser, Motion::named("tumble").unwrap(), fault);
            last_attitude(fuser, Motion::S1, fault);
        }
    }
}

#[test]
fn the_default_and_wz_are_level_again_at_the_end_of_every_fault() {
    for (fuser, fault) in
        ["multiple-model", "wz"].into_iter().flat_map(|fuser| FAULTS.iter().map(move |of| (fuser, of)))
    {
        let (output, truth) = last_attitude(fuser, Motion::S1, fault);
        let [w, x, y, z] = output.quaternion;
        let e = Quaternion::new(w, x, y, z) * truth.conjugate();
        let error_deg = (2.0 * e.i.hypot(e.j).atan2(e.w.hypot(e.k))).to_degrees();
        println!("{fuser}, {}: {error_deg:.3}°", fault.0);
        assert!(error_deg < 0.35, "{fuser}, {}: {error_deg}°", fault.0);
    }
}
