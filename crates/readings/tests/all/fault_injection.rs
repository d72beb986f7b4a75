//! Tests the effect of injected faults on the samples of the conditioner.
use attitude::{
    Vector3,
    gnss::{Fix, ReceiverFix},
};
use launch::{Fault, FaultKind, GyroSamples, Launch, Sensor};
use messages::Flags;
use readings::{
    conditioner::{Conditioner, Sample},
    source::Reading,
};

const RATE_HZ: f64 = 100.0;
const FROM: usize = 100;
const UNTIL: usize = 200;

/// Returns a valid reading that differs for each count. Every second one has a magnetic field, and
/// every tenth one a fix.
fn reading(count: usize) -> Reading {
    let x = count as f64 * 1e-3;
    let velocity_m_s = Vector3::new(x, 1.0, 0.0);
    let fix = Fix { velocity_m_s, sd_m_s: Some(0.1), age_s: Some(0.2), latitude_rad: Some(0.9) };
    let received = ReceiverFix { fix, longitude_rad: Some(-0.2), altitude_m: Some(80.0) };
    Reading {
        t_ns: count as i64 * 10_000_000,
        rate_rad_s: [x, -x, 0.1],
        force_m_s2: [0.1, x, 9.8],
        field_ut: (count.is_multiple_of(2)).then_some([20.0 + x, 0.0, -40.0]),
        fix: (count.is_multiple_of(10)).then_some(received),
        reference: None,
    }
}

/// Conditions three seconds of readings. The faults are active from 1 s to 2 s.
fn conditioned(faults: &[(Sensor, FaultKind)]) -> Vec<Option<Sample>> {
    let mut ingest = Launch::default().ingest;
    let fault = |&(sensor, kind): &(Sensor, FaultKind)| Fault { sensor, kind, from_s: 1.0, until_s: 2.0 };
    ingest.faults = faults.iter().map(fault).collect();
    let mut conditioner = Conditioner::new(&ingest, RATE_HZ, GyroSamples::Means).unwrap();
    let samples = (0..300).map(|count| conditioner.condition(&reading(count))).collect();
    assert_eq!(conditioner.rejected(), 0, "a dropped reading does not count as rejected");
    samples
}

fn conditioned_with(sensor: Sensor, kind: FaultKind) -> Vec<Option<Sample>> {
    conditioned(&[(sensor, kind)])
}

fn rate(sample: &Option<Sample>) -> [f64; 3] {
    // The default calibration and mounting leave every bit of the rate unchanged.
    sample.unwrap().imu.rate_rad_s
}

#[test]
fn fault_acts_and_is_flagged_within_its_period_only() {
    let unchanged = conditioned(&[]);
    for kind in [FaultKind::Off, FaultKind::Stuck, FaultKind::Garbage { seed: 1 }, FaultKind::Slow { every: 3 }] {
        for sensor in [Sensor::Gyro, Sensor::Accel, Sensor::Mag, Sensor::Gnss] {
            let faulty = conditioned_with(sensor, kind);
            assert!(faulty[..FROM] == unchanged[..FROM], "{sensor:?} {kind:?}");
            for (count, sample) in faulty.iter().enumerate() {
                let flagged = sample.unwrap().imu.header.flags.any(Flags::FAULT_INJECTED);
                assert_eq!(flagged, (FROM..UNTIL).contains(&count), "{sensor:?} {kind:?}, reading {count}");
            }
            assert_eq!(rate(&faulty[UNTIL]), reading(UNTIL).rate_rad_s, "{sensor:?} {kind:?}");
        }
    }
}

#[test]
fn dropped_reading_is_flagged_at_next_one() {
    let faulty = conditioned_with(Sensor::All, FaultKind::Off);
    assert!(faulty[FROM..UNTIL].iter().all(Option::is_none));
    let next = faulty[UNTIL].unwrap().imu.header;
    assert_eq!((next.tick, next.flags.any(Flags::FAULT_INJECTED)), (FROM as u64, true));
    assert!(next.flags.any(Flags::GAP), "{}", next.flags);
    assert!(!faulty[UNTIL + 1].unwrap().imu.header.flags.any(Flags::FAULT_INJECTED));
}

#[test]
fn stuck_sensor_repeats_last_value() {
    let faulty = conditioned_with(Sensor::All, FaultKind::Stuck);
    let last = reading(FROM - 1);
    for sample in &faulty[FROM..UNTIL] {
        assert_eq!(rate(sample), last.rate_rad_s);
        assert_eq!(sample.unwrap().imu.force_m_s2, last.force_m_s2);
        assert_eq!(sample.unwrap().mag, None, "a repeated field is not a new sample");
    }
    let fix = faulty[FROM + 10].unwrap().gnss.unwrap();
    assert_eq!(fix.velocity_m_s, [0.09, 1.0, 0.0], "velocity of the last fix before the fault");
}

#[test]
fn delayed_values_lag_and_each_fix_arrives_once() {
    let faulty = conditioned_with(Sensor::All, FaultKind::Delayed { delay_s: 0.205 });
    let mut fixes = Vec::new();
    for (count, sample) in faulty.iter().enumerate().take(UNTIL).skip(FROM) {
        assert_eq!(rate(sample), reading(count - 21).rate_rad_s);
        fixes.extend(sample.unwrap().gnss.map(|fix| (count, fix.velocity_m_s[0])));
    }
    let expected = (80..=170).step_by(10).map(|count| (count + 21, count as f64 * 1e-3));
    assert_eq!(fixes, expected.collect::<Vec<_>>());
}

#[test]
fn slow_sensor_repeats_or_omits_values() {
    let faulty = conditioned_with(Sensor::Gyro, FaultKind::Slow { every: 4 });
    for (count, sample) in faulty.iter().enumerate().take(UNTIL).skip(FROM) {
        assert_eq!(rate(sample), reading(count - (count - FROM) % 4).rate_rad_s);
    }
    let fixes = |samples: &[Option<Sample>]| samples.iter().flatten().filter(|sample| sample.gnss.is_some()).count();
    assert_eq!(fixes(&conditioned_with(Sensor::Gnss, FaultKind::Slow { every: 5 })[FROM..UNTIL]), 2);
    let readings = conditioned_with(Sensor::All, FaultKind::Slow { every: 4 });
    assert_eq!(readings[FROM..UNTIL].iter().flatten().count(), 25);
}

#[test]
fn intermittent_sensor_follows_share_and_seed() {
    let delivered = |seed| -> Vec<bool> {
        let faulty = conditioned_with(Sensor::Gyro, FaultKind::Intermittent { share: 0.3, seed });
        faulty[FROM..UNTIL].iter().map(|it| !it.unwrap().imu.header.flags.any(Flags::RATE_INVALID)).collect()
    };
    let count = delivered(5).iter().filter(|spoken| **spoken).count();
    assert!((20..=40).contains(&count), "{count} of 100");
    assert_eq!(delivered(5), delivered(5));
    assert_ne!(delivered(5), delivered(6));
}

#[test]
fn faults_are_applied_in_sequence() {
    let twice = FaultKind::Miscalibrated { factor: 2.0, offset: [1.0, 0.0, 0.0] };
    let faulty = conditioned(&[(Sensor::Gyro, FaultKind::Stuck), (Sensor::Gyro, twice)]);
    let [x, y, z] = reading(FROM - 1).rate_rad_s;
    assert_eq!(rate(&faulty[UNTIL - 1]), [2.0 * x + 1.0, 2.0 * y, 2.0 * z]);
}

#[test]
fn garbage_gives_finite_samples() {
    let faulty = conditioned_with(Sensor::All, FaultKind::Garbage { seed: 3 });
    let mut flags = Flags::NONE;
    for sample in faulty.iter().flatten() {
        assert!(sample.imu.rate_rad_s.iter().chain(&sample.imu.force_m_s2).all(|x| x.is_finite()));
        flags |= sample.imu.header.flags;
    }
    for flag in [Flags::RATE_INVALID, Flags::FORCE_INVALID, Flags::FIELD_INVALID, Flags::FIX_INVALID] {
        assert!(flags.any(flag), "{flag}");
    }
}

#[test]
fn clock_leaps_do_not_shift_fault_period() {
    let mut ingest = Launch::default().ingest;
    let kind = FaultKind::Delayed { delay_s: 2.0 };
    ingest.faults = vec![Fault { sensor: Sensor::All, kind, from_s: 0.0, until_s: 1e6 }; 4];
    let mut conditioner = Conditioner::new(&ingest, RATE_HZ, GyroSamples::Means).unwrap();
    let mut bits = 1i64;
    for count in 0..30_000 {
        bits = bits.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        conditioner.condition(&Reading { t_ns: bits >> (count % 64), ..reading(count) });
    }
    assert!(conditioner.ticks() > 0);
    ingest.faults = vec![Fault { sensor: Sensor::Gyro, kind: FaultKind::Off, from_s: 1.0, until_s: 2.0 }];
    let mut conditioner = Conditioner::new(&ingest, RATE_HZ, GyroSamples::Means).unwrap();
    for count in 0..300 {
        let leap_ns = if count < 50 { 0 } else { 3_600_000_000_000 };
        let shifted = Reading { t_ns: reading(count).t_ns + leap_ns, ..reading(count) };
        let flags = conditioner.condition(&shifted).unwrap().imu.header.flags;
        // The step in which the clock leaps does not count as elapsed time.
        assert_eq!(flags.any(Flags::RATE_INVALID), (FROM + 1..UNTIL + 1).contains(&count), "reading {count}");
    }
}
