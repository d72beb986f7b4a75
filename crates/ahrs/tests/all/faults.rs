//! Sensor faults have the same effect as in the system.

use launch::Launch;
use plumbline_ahrs::{Ahrs, Flags, stages::Fuser};
use readings::source::{Reading, Truth};

use crate::path::{System, bits, system_bits, update};

const RATE_HZ: f64 = 100.0;
const INTERVAL_NS: i64 = 10_000_000;

/// Returns a reading of a body that turns and tilts. Every second reading has a magnetic field,
/// every 20th a fix.
fn reading(count: i64) -> Reading {
    let t_s = count as f64 / RATE_HZ;
    let (sin, cos) = (0.3 * t_s.sin()).sin_cos();
    let fix = attitude_fix(t_s, (count % 20 == 0).then_some(()));
    Reading {
        t_ns: count * INTERVAL_NS,
        rate_rad_s: [0.3 * t_s.cos(), 0.02, 0.4],
        force_m_s2: [0.01 * t_s.cos(), 9.81 * sin, 9.81 * cos],
        field_ut: (count % 2 == 0).then_some([20.0 * (0.4 * t_s).sin(), 20.0 * (0.4 * t_s).cos(), -40.0 + 1e-3 * t_s]),
        fix,
        reference: None::<Truth>,
    }
}

fn attitude_fix(t_s: f64, present: Option<()>) -> Option<plumbline_ahrs::attitude::gnss::ReceiverFix> {
    present.map(|()| {
        let velocity_m_s = [5.0 * t_s.sin(), 5.0 * t_s.cos(), 0.1].into();
        plumbline_ahrs::attitude::gnss::Fix {
            velocity_m_s,
            sd_m_s: Some(0.2),
            age_s: Some(0.1),
            latitude_rad: Some(0.9),
        }
        .into()
    })
}

/// Asserts that the system and the filter have equal outputs, bit for bit, over 2,000 readings.
///
/// `edit` may alter each reading before both receive it. Returns the union of all flags.
fn run(stage: &str, edit: impl Fn(i64, &mut Reading)) -> Flags {
    let mut launch = Launch::default();
    launch.fuser.stage = stage.into();
    let mut system = System::new(launch, RATE_HZ);
    let mut ahrs = Ahrs::<Fuser>::with_stage(stage).unwrap();
    let mut all = Flags::NONE;
    for count in 0..2000 {
        let mut reading = reading(count);
        edit(count, &mut reading);
        let before = bits(&ahrs.attitude());
        let rejected = ahrs.rejected();
        let attitude = update(&mut ahrs, &reading);
        match system.step(&reading) {
            Some(output) => assert_eq!(bits(&attitude), system_bits(&output), "{stage}, reading {count}"),
            None => assert_eq!((bits(&attitude), ahrs.rejected()), (before, rejected + 1), "{stage}, reading {count}"),
        }
        all |= attitude.flags();
    }
    assert!(ahrs.failure().is_none());
    all
}

#[test]
fn every_stage_yields_the_bits_of_the_system() {
    for stage in Fuser::NAMES {
        assert!(run(stage, |_, _| {}).any(Flags::FIX));
    }
}

#[test]
fn faulty_sensors_yield_the_bits_of_the_system() {
    type Edit = fn(i64, &mut Reading);
    let faults: [(Edit, Flags); 12] = [
        (
            |count, reading| {
                if count % 50 < 5 {
                    reading.rate_rad_s[1] = f64::NAN
                }
            },
            Flags::RATE_INVALID,
        ),
        (
            |count, reading| {
                if count > 500 {
                    reading.rate_rad_s = [f64::NAN; 3]
                }
            },
            Flags::RATE_INVALID,
        ),
        (
            |count, reading| {
                if count % 50 < 9 {
                    reading.force_m_s2 = [f64::INFINITY; 3]
                }
            },
            Flags::FORCE_INVALID,
        ),
        (
            |count, reading| {
                if count % 90 < 2 {
                    reading.rate_rad_s[0] = 40.0
                }
            },
            Flags::RATE_CLIPPED,
        ),
        (
            |count, reading| {
                if count % 90 < 2 {
                    reading.force_m_s2[0] = 200.0
                }
            },
            Flags::FORCE_CLIPPED,
        ),
        (
            |count, reading| {
                if count > 300 {
                    reading.rate_rad_s = [0.1; 3]
                }
            },
            Flags::RATE_STUCK,
        ),
        (
            |count, reading| {
                if count > 300 {
                    reading.force_m_s2 = [0.0, 1.0, 9.7]
                }
            },
            Flags::FORCE_STUCK,
        ),
        (
            |count, reading| {
                if count > 300 {
                    reading.force_m_s2 = [0.0, 0.01 * count as f64 % 0.3, 0.0]
                }
            },
            Flags::FORCE_SMALL,
        ),
        (
            |count, reading| {
                if count > 300 {
                    reading.field_ut = Some([f64::NAN; 3])
                }
            },
            Flags::FIELD_INVALID,
        ),
        (|count, reading| reading.t_ns += count / 400 * 700_000_000, Flags::GAP),
        (
            |count, reading| {
                if count % 70 == 3 {
                    reading.t_ns -= 15_000_000
                }
            },
            Flags::REFUSED_BEFORE,
        ),
        (
            |count, reading| {
                if count > 900 {
                    reading.t_ns -= 60_000_000_000
                }
            },
            Flags::CLOCK_LEAP,
        ),
    ];
    for (index, (edit, flag)) in faults.into_iter().enumerate() {
        assert!(run("multiple-model", edit).any(flag), "fault {index}: no tick has {flag}");
    }
}

#[test]
fn repeated_sample_is_rejected() {
    let mut ahrs = Ahrs::new();
    let first = update(&mut ahrs, &reading(0));
    assert_eq!(update(&mut ahrs, &reading(0)), first);
    assert_eq!(ahrs.rejected(), 1);
}

#[test]
fn arbitrary_input_never_yields_a_number_that_is_not_finite() {
    let mut ahrs = Ahrs::new();
    let values = [f64::NAN, f64::INFINITY, -1e300, 1e300, -0.0, 1e-320, 9.8, -30.0];
    let mut state = 1_u64;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        values[(state >> 33) as usize % values.len()]
    };
    for _ in 0..20_000 {
        let mut vector = || [next(), next(), next()];
        let (rate, force, field, velocity_m_s) = (vector(), vector(), vector(), vector());
        ahrs.update_gnss(&plumbline_ahrs::GnssFix { velocity_m_s, age_s: Some(next()), ..Default::default() });
        let attitude = ahrs.update(rate, force, Some(field), next());
        let norm: f64 = attitude.quaternion().iter().map(|x| x * x).sum();
        assert!((norm - 1.0).abs() < 1e-6 && attitude.heading_rad().is_finite());
        assert!(attitude.heading_sd_rad() >= 0.0 && attitude.gyro_bias_rad_s().iter().all(|x| x.is_finite()));
    }
    assert!(ahrs.failure().is_none());
}
