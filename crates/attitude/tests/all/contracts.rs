//! Contract of the fusers and gyro stages: exact snapshots, finite output, rejection of invalid
//! records, and continuation of an adopted estimate.
use attitude::{
    GRAVITY_M_S2, Vector3,
    accel::Accelerometer,
    angles::Angles,
    course::CourseReference,
    fuser::{Estimate, Fused, Fuser, FuserInput, FuserStage, GyroScale, HardIron, LeakyVelocity},
    gyro::{Gyro, GyroStage, Motion, RateKind, RateSample},
    rotation::Rotation,
    stage::{RestoreError, Stage},
    state::{Attitude, wrapped_rad},
};
use proptest::prelude::*;
use scenario::Scenario;

/// Fusers under test.
const FUSERS: [&str; 5] = ["wz-closed", "wz-open", "madgwick", "madgwick-improved", "vqf"];

/// Magnetic field of the site (east, north, up), 20 µT to the north and 44 µT down.
const FIELD_UT: Vector3<f64> = Vector3::new(0.0, 20.0, -44.0);

/// Returns the input from ideal sensors at one tick.
fn ideal_input(attitude: Attitude, rate_rad_s: Vector3<f64>, dt_s: f64) -> FuserInput {
    let rotation = Rotation::from_rotation_vector(rate_rad_s * dt_s);
    FuserInput {
        motion: Some(Motion { attitude, rotation, rate_rad_s, dt_s }),
        inclination: Some(Accelerometer::default().step(&(attitude.up.direction() * GRAVITY_M_S2))),
        field_ut: Some(attitude.matrix() * FIELD_UT),
        rest_credible: true,
        rate_credible: true,
        ..FuserInput::default()
    }
}

fn angle_deg(one: Attitude, other: Attitude) -> f64 {
    let e = one.quaternion() * other.quaternion().conjugate();
    (2.0 * e.imag().norm().atan2(e.w.abs())).to_degrees()
}

/// Returns the fuser inputs of scenario S3, with the magnetic field at every third tick.
fn s3() -> Vec<FuserInput> {
    let (mut gyro, mut accel, mut before_s) =
        (Gyro::from_name("mobius-coning").unwrap(), Accelerometer::default(), 0.0);
    let scenario = Scenario::parse("s3").unwrap();
    let input = |(index, (t_s, reading)): (usize, (f64, scenario::Reading))| {
        let sample = RateSample { rate_rad_s: reading.rate_rad_s, dt_s: t_s - before_s, kind: scenario.rate_kind };
        before_s = t_s;
        FuserInput {
            motion: Some(gyro.step(&sample)),
            inclination: Some(accel.step(&reading.force_m_s2)),
            field_ut: reading.field_ut.filter(|_| index % 3 == 2),
            rest_credible: true,
            rate_credible: true,
            ..FuserInput::default()
        }
    };
    scenario.readings().enumerate().map(input).collect()
}

#[test]
fn restored_fuser_continues_bit_for_bit_from_any_tick() {
    let inputs = s3();
    for name in FUSERS {
        for tick in [0, 1, 2, 3, 10, 40, 200, 1000, 1500] {
            let mut fuser = Fuser::from_name(name).unwrap();
            for input in &inputs[..tick] {
                fuser.step(input);
            }
            let mut restored = Fuser::from_name(name).unwrap();
            restored.restore(&fuser.snapshot()).unwrap();
            assert_eq!(restored, fuser);
            for input in &inputs[tick..] {
                assert_eq!(fuser.step(input), restored.step(input), "{name} from tick {tick}");
            }
        }
    }
}

#[test]
fn restored_gyro_continues_bit_for_bit_from_any_tick() {
    let scenario = Scenario::parse("coning").unwrap();
    let readings: Vec<_> = scenario.readings().take(100).collect();
    for name in Gyro::NAMES {
        for kind in [RateKind::Mean, RateKind::Instant] {
            for tick in 0..10 {
                let mut gyro = Gyro::from_name(name).unwrap();
                let step = |gyro: &mut Gyro, index: usize| {
                    let dt_s = if index == 0 { 0.0 } else { 0.01 };
                    gyro.step(&RateSample { rate_rad_s: readings[index].1.rate_rad_s, dt_s, kind })
                };
                for index in 0..tick {
                    step(&mut gyro, index);
                }
                let mut restored = Gyro::from_name(name).unwrap();
                restored.restore(&gyro.snapshot()).unwrap();
                for index in tick..100 {
                    assert_eq!(step(&mut gyro, index), step(&mut restored, index), "{name} {kind:?} from tick {tick}");
                }
            }
        }
    }
}

#[test]
fn record_with_implausible_value_is_rejected() {
    for name in FUSERS {
        let mut fuser = Fuser::from_name(name).unwrap();
        for input in &s3() {
            fuser.step(input);
        }
        let good = fuser.snapshot();
        let mut rejected = 0;
        for index in 0..good.len {
            let mut bad = good;
            bad.values[index] = -1e6;
            bad.checksum = bad.compute_checksum();
            let before = fuser.clone();
            rejected += usize::from(matches!(fuser.restore(&bad), Err(RestoreError::Invalid { .. })));
            assert!(fuser == before || fuser.restore(&good) == Ok(()));
        }
        println!("{name}: {rejected} of {} values rejected", good.len);
        let min_rejected = if name == "vqf" { 20 } else { 6 };
        assert!(rejected >= min_rejected, "{name}: only {rejected} of {} values rejected", good.len);
    }
}

#[test]
fn accepted_record_with_extreme_value_causes_no_panic() {
    let inputs = s3();
    for name in Fuser::NAMES {
        let mut fuser = Fuser::from_name(name).unwrap();
        for input in &inputs {
            fuser.step(input);
        }
        let good = fuser.snapshot();
        let mut accepted = 0;
        for (index, value) in
            (0..good.len).flat_map(|index| [1e300, -1e300, 1e15, 1e-300, 0.0].map(|value| (index, value)))
        {
            let mut bad = good;
            bad.values[index] = value;
            bad.checksum = bad.compute_checksum();
            let mut restored = Fuser::from_name(name).unwrap();
            if restored.restore(&bad).is_err() {
                continue;
            }
            accepted += 1;
            let steps = || {
                for input in &inputs[..200] {
                    restored.step(input);
                }
            };
            let is_ok = std::panic::catch_unwind(std::panic::AssertUnwindSafe(steps)).is_ok();
            assert!(is_ok, "{name}: value {index} of {} is {value:e}", good.len);
        }
        assert!(accepted > 0, "{name}");
    }
}

#[test]
fn first_field_sets_heading_and_later_ones_hold_it() {
    let attitude = Attitude::from_angles(Angles { yaw_rad: 2.0, pitch_rad: 0.4, roll_rad: -2.5 });
    // The attitude of the gyro slot has an arbitrary heading that drifts by 0.2 °/s.
    let gyro = |t_s: f64| Attitude { z_rad: wrapped_rad(attitude.z_rad - 2.0 + 0.0035 * t_s), ..attitude };
    for name in FUSERS {
        let mut fuser = Fuser::from_name(name).unwrap();
        let mut last = None;
        for tick in 0..40_000u32 {
            let mut input = ideal_input(attitude, attitude.up.direction() * 0.0035, 0.005);
            input.motion.as_mut().unwrap().attitude = gyro(f64::from(tick) * 0.005);
            input.field_ut = input.field_ut.filter(|_| tick % 4 == 3);
            let out: Fused = fuser.step(&input);
            let expected = if tick < 3 { CourseReference::Arbitrary } else { CourseReference::Magnetic };
            assert_eq!(out.reference, expected, "{name}, tick {tick}");
            assert_eq!(out.corrections.aligned, tick == 0 || tick == 3, "{name}, tick {tick}");
            if tick == 3 {
                assert!(angle_deg(out.attitude, attitude) < 0.1, "{name}: {}°", angle_deg(out.attitude, attitude));
            }
            last = Some(out);
        }
        let out = last.unwrap();
        let error_deg = angle_deg(out.attitude, attitude);
        println!("{name}: {error_deg:.2}°, reported sd {:.2}°", out.heading_sd_rad.to_degrees());
        assert!(error_deg < 5.0, "{name}: {error_deg}°");
        assert!((1e-5..0.2).contains(&out.heading_sd_rad), "{name}: {} rad", out.heading_sd_rad);
        assert!((1e-6..0.2).contains(&out.inclination_sd_rad), "{name}: {} rad", out.inclination_sd_rad);
    }
}

#[test]
fn adopted_estimate_is_continued() {
    let moving_rad_s = Vector3::new(0.5, -0.3, 0.8);
    let start = Attitude::from_angles(Angles { yaw_rad: -1.0, pitch_rad: 0.7, roll_rad: 2.2 });
    for name in FUSERS {
        for (reference, rate_rad_s) in [
            (CourseReference::Arbitrary, moving_rad_s),
            (CourseReference::Magnetic, moving_rad_s),
            (CourseReference::True, moving_rad_s),
            (CourseReference::Magnetic, Vector3::zeros()),
        ] {
            let mut fuser = Fuser::from_name(name).unwrap();
            let estimate = Estimate {
                attitude: start,
                reference,
                bias_rad_s: Vector3::zeros(),
                inclination_sd_rad: 0.01,
                heading_sd_rad: 0.02,
                bias_sd_rad_s: 0.001,
                gyro_scale: GyroScale::UNKNOWN,
                hard_iron: HardIron::UNKNOWN,
                leaky_velocity: LeakyVelocity::UNKNOWN,
            };
            fuser.adopt(&estimate).unwrap();
            assert!(angle_deg(fuser.common().attitude, start) < 1e-9, "{name}");
            // The gyro slot's attitude starts with a heading unrelated to that of the adopted
            // attitude.
            let mut gyro = Gyro::from_name("mobius").unwrap();
            gyro.align(Attitude::from_angles(Angles { yaw_rad: 2.0, pitch_rad: 0.2, roll_rad: -0.4 }));
            let mut attitude = start;
            for tick in 0..1000 {
                attitude = attitude.rotated(Rotation::from_rotation_vector(rate_rad_s * 0.01)).attitude;
                let mut input = ideal_input(attitude, rate_rad_s, 0.01);
                let sample = RateSample { rate_rad_s, dt_s: 0.01, kind: RateKind::Mean };
                input.motion = Some(gyro.step(&sample));
                input.field_ut = None;
                let out = fuser.step(&input);
                // `madgwick` corrects the attitude by its gain times the interval, however large
                // the error is, and compares the force with the attitude of the previous interval.
                // `wz-open` low-pass filters the difference between two points w: that of the
                // accelerometer and that of the gyro slot's attitude. If the points differ, their
                // difference varies as the body rotates.
                let limit_deg = match name {
                    "madgwick" => 1.0,
                    "wz-open" if tick > 0 && rate_rad_s == moving_rad_s => 180.1,
                    _ => 0.01,
                };
                let error_deg = angle_deg(out.attitude, attitude);
                assert!(error_deg < limit_deg, "{name} {reference:?}, tick {tick}: {error_deg}°");
            }
        }
    }
}

#[test]
fn tilt_error_decays_with_configured_time_constant() {
    for (name, time_constant_s) in [("wz-closed", 0.5), ("wz-closed", 4.0), ("wz-open", 0.5), ("wz-open", 4.0)] {
        let mut fuser = Fuser::from_name(name).unwrap();
        fuser.set("time_constant_s", time_constant_s).unwrap();
        let tilted = Attitude::from_angles(Angles { pitch_rad: 0.01, ..Angles::default() });
        fuser.step(&ideal_input(tilted, Vector3::zeros(), 0.0));
        let mut remaining_deg = 0.0;
        for _ in 0..(time_constant_s * 100.0) as u32 {
            let mut input = ideal_input(Attitude::default(), Vector3::zeros(), 0.01);
            input.motion.as_mut().unwrap().attitude = tilted;
            remaining_deg = angle_deg(fuser.step(&input).attitude, Attitude::default());
        }
        let share = remaining_deg / 0.01f64.to_degrees();
        assert!(
            (share - (-1.0f64).exp()).abs() < 0.01,
            "{name}, T = {time_constant_s} s: a share of {share} remains after T"
        );
    }
}

#[test]
fn error_does_not_grow_over_a_day() {
    let rate_rad_s = Vector3::new(0.02, -0.01, 0.05);
    let bias_rad_s = Vector3::new(3e-4, -3e-4, 3e-4);
    let (dt_s, hour) = (0.04, 90_000);
    for name in ["wz-closed", "madgwick", "madgwick-improved", "vqf"] {
        let mut fuser = Fuser::from_name(name).unwrap();
        let mut attitude = Attitude::default();
        let mut worst_deg = [0.0f64; 24];
        for tick in 0..24 * hour {
            attitude = attitude.rotated(Rotation::from_rotation_vector(rate_rad_s * dt_s)).attitude;
            let mut input = ideal_input(attitude, rate_rad_s, dt_s);
            let motion = input.motion.as_mut().unwrap();
            motion.rate_rad_s += bias_rad_s;
            motion.rotation = Rotation::from_rotation_vector(motion.rate_rad_s * dt_s);
            let error_deg = angle_deg(fuser.step(&input).attitude, attitude);
            worst_deg[tick / hour] = worst_deg[tick / hour].max(error_deg);
        }
        println!("{name}: {:.4}° in the second hour, {:.4}° in the last", worst_deg[1], worst_deg[23]);
        assert!(worst_deg[23] < 1.05 * worst_deg[1] + 1e-3, "{name}: {worst_deg:?}");
    }
}

/// Generates finite numbers of any magnitude, including zero.
fn extreme() -> impl Strategy<Value = f64> {
    prop_oneof![4 => -20.0..20.0f64, 1 => Just(0.0), 1 => (-300.0..300.0f64, any::<bool>()).prop_map(|(e, sign)| {
        if sign { 10f64.powf(e) } else { -10f64.powf(e) }
    })]
}

fn vector() -> impl Strategy<Value = Vector3<f64>> {
    [extreme(), extreme(), extreme()].prop_map(Vector3::from)
}

type Tick = (Option<Vector3<f64>>, Option<Vector3<f64>>, Option<Vector3<f64>>, f64, bool);

fn tick() -> impl Strategy<Value = Tick> {
    let dt_s = prop_oneof![3 => Just(0.01), 1 => Just(0.0), 1 => 0.0..1.0f64, 1 => 1e-12..1e-6f64];
    (
        prop::option::weighted(0.8, vector()),
        prop::option::weighted(0.8, vector()),
        prop::option::weighted(0.5, vector()),
        dt_s,
        any::<bool>(),
    )
}

proptest! {
    #[test]
    fn fuser_output_is_finite_for_any_input(ticks in prop::collection::vec(tick(), 1..200)) {
        for name in FUSERS {
            let mut fuser = Fuser::from_name(name).unwrap();
            let mut open = Attitude::default();
            for (index, (rate, force, field_ut, dt_s, rest_credible)) in ticks.iter().enumerate() {
                let motion = rate.map(|rate_rad_s| {
                    let rotation = Rotation::from_rotation_vector(rate_rad_s.map(|x| x.clamp(-1e3, 1e3)) * *dt_s);
                    open = open.rotated(rotation).attitude;
                    Motion { attitude: open, rotation, rate_rad_s, dt_s: *dt_s }
                });
                let inclination = force.map(|force| Accelerometer::default().step(&force)).filter(|inclination| inclination.trust > 0.0);
                let input = FuserInput {
                    motion,
                    inclination,
                    field_ut: *field_ut,
                    rest_credible: *rest_credible, rate_credible: true,
                    ..FuserInput::default()
                };
                if index == 50 {
                    fuser.realign();
                }
                let out = fuser.step(&input);
                let mut numbers = vec![out.innovation_rad, out.inclination_sd_rad, out.heading_sd_rad, out.attitude.z_rad];
                numbers.extend([out.attitude.up.w.re, out.attitude.up.w.im]);
                numbers.extend(out.bias_rad_s.iter().chain(&out.rate_rad_s));
                prop_assert!(numbers.iter().all(|x| x.is_finite()), "{name}, tick {index}: {out:?}");
                prop_assert!(out.heading_sd_rad >= 0.0 && out.inclination_sd_rad >= 0.0);
            }
            let mut restored = Fuser::from_name(name).unwrap();
            prop_assert_eq!(restored.restore(&fuser.snapshot()), Ok(()), "{}", name);
        }
    }

    #[test]
    fn coning_output_is_finite_for_any_interval(ticks in prop::collection::vec(([-1e3..1e3, -1e3..1e3, -1e3..1e3], 0.0..1.0f64, any::<bool>()), 1..100)) {
        let mut gyro = Gyro::from_name("mobius-coning").unwrap();
        for (rate, dt_s, mean) in ticks {
            let kind = if mean { RateKind::Mean } else { RateKind::Instant };
            let out = gyro.step(&RateSample { rate_rad_s: Vector3::from(rate), dt_s, kind });
            prop_assert!(out.rate_rad_s.iter().all(|x| x.is_finite()) && out.attitude.z_rad.is_finite());
            prop_assert!((out.rotation.quaternion().norm() - 1.0).abs() < 1e-9);
        }
    }
}
