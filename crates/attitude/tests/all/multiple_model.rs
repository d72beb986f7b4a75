//! The fuser `multiple-model`: which of its two stages speaks, what its heading counts from, and that it says so.
use attitude::{
    Complex, GRAVITY_M_S2, Vector3,
    accel::Projector,
    course::CourseReference,
    fuser::{Fused, Fuser, FuserInput},
    gnss::Fix,
    gyro::{Gyro, Motion, RateKind, RateSample},
    parameters::ParameterError,
    stage::Stage,
    state::Attitude,
    rotation::Rotation,
};
use nalgebra::UnitQuaternion;
use scenario::{Magnetometer, Scenario};

use crate::common::{DT_S, Row, broad};

const FIELD_UT: Vector3<f64> = Vector3::new(0.0, 20.0, -44.0);

fn named(name: &str) -> Fuser {
    Fuser::from_name(name).unwrap()
}

fn inputs(trial: &[Row], magnetic: bool) -> Vec<FuserInput> {
    let (mut gyro, mut accel) = (Gyro::from_name("mobius").unwrap(), Projector::default());
    let input = |(index, row): (usize, &Row)| {
        let dt_s = if index == 0 { 0.0 } else { DT_S };
        FuserInput {
            motion: Some(gyro.step(&RateSample { rate_rad_s: row.rate_rad_s, dt_s, kind: RateKind::Mean })),
            inclination: Some(accel.step(&row.force_m_s2)),
            field_ut: magnetic.then_some(row.field_ut),
            rest_credible: true,
            rate_credible: true,
            ..FuserInput::default()
        }
    };
    trial.iter().enumerate().map(input).collect()
}

#[test]
fn what_a_hand_moves_has_the_attitude_of_wz_to_the_last_bit() {
    let Some(trials) = broad() else { return };
    for (index, trial) in trials.iter().enumerate() {
        for magnetic in [false, true] {
            let (mut both, mut wz) = (named("multiple-model"), named("wz"));
            for (tick, input) in inputs(trial, magnetic).iter().enumerate() {
                assert_eq!(both.step(input), wz.step(input), "trial {index}, field {magnetic}, tick {tick}");
            }
        }
    }
}

/// What was published of a cruise with a field and fixes until `until_s`, and of a landing without a word: rest from then on.
fn flown_and_landed(until_s: f64, rest_s: f64, magnetic: bool) -> Vec<(f64, Fused)> {
    let mut scenario = Scenario::parse("cruise?duration_s=600").unwrap();
    scenario.errors.magnetometer = magnetic.then_some(Magnetometer { reference_ut: FIELD_UT, noise_ut: 0.5 });
    let (mut gyro, mut accel) = (Gyro::from_name("mobius").unwrap(), Projector::default());
    let mut fuser = named("multiple-model");
    let (mut outputs, mut last) = (Vec::new(), Attitude::default());
    let flight = scenario.readings().take_while(|(t_s, _)| *t_s < until_s);
    for (tick, (t_s, reading)) in flight.enumerate() {
        let dt_s = if tick == 0 { 0.0 } else { 0.01 };
        let sample = RateSample { rate_rad_s: reading.rate_rad_s, dt_s, kind: scenario.rate_kind };
        let input = FuserInput {
            motion: Some(gyro.step(&sample)),
            inclination: Some(accel.step(&reading.force_m_s2)),
            field_ut: reading.field_ut,
            fix: reading.fix.filter(|_| t_s > 10.0),
            rest_credible: true,
            rate_credible: true,
        };
        outputs.push((t_s, fuser.step(&input)));
        last = reading.truth.attitude;
    }
    for tick in 0..(rest_s * 100.0) as u32 {
        let motion = Motion { attitude: last, rotation: Rotation::IDENTITY, rate_rad_s: Vector3::zeros(), dt_s: 0.01 };
        let input = FuserInput {
            motion: Some(motion),
            inclination: Some(accel.step(&(last.up.direction() * GRAVITY_M_S2))),
            field_ut: magnetic.then(|| last.matrix() * FIELD_UT),
            rest_credible: true,
            rate_credible: true,
            ..FuserInput::default()
        };
        outputs.push((until_s + f64::from(tick) * 0.01, fuser.step(&input)));
    }
    assert_eq!(fuser.validation_error(), None);
    outputs
}

/// What the heading counts from, each with the time from which on.
fn references(outputs: &[(f64, Fused)]) -> Vec<(f64, CourseReference)> {
    let mut all: Vec<(f64, CourseReference)> = Vec::new();
    for (t_s, out) in outputs {
        if all.last().is_none_or(|(_, before)| *before != out.reference) {
            assert!(out.corrections.aligned, "another reference without a word at {t_s} s");
            all.push((*t_s, out.reference));
        }
    }
    all
}

#[test]
fn the_heading_says_what_it_counts_from_whenever_that_changes() {
    use CourseReference::{Arbitrary, Magnetic, True};
    let of = |outputs: &[(f64, Fused)]| references(outputs).into_iter().map(|(_, of)| of).collect::<Vec<_>>();
    assert_eq!(of(&flown_and_landed(60.0, 400.0, false)), [Arbitrary, True]);
    let outputs = flown_and_landed(60.0, 400.0, true);
    let of_flight = references(&outputs);
    println!("{of_flight:?}");
    assert_eq!(of_flight.iter().map(|(_, of)| *of).collect::<Vec<_>>(), [Arbitrary, Magnetic, True, Magnetic]);
    // Five minutes after the last fix.
    assert!((359.0..361.0).contains(&of_flight[3].0));
}

#[test]
fn from_one_stage_to_the_other_nothing_turns_unannounced() {
    for magnetic in [false, true] {
        let outputs = flown_and_landed(300.0, 400.0, magnetic);
        let mut worst_deg = 0f64;
        // At rest: all that turns is the stage's own doing.
        for pair in outputs.windows(2).filter(|pair| pair[0].0 > 300.0) {
            let [(t_s, one), (_, other)] = pair else { continue };
            let apart = other.attitude.quaternion() * one.attitude.quaternion().conjugate();
            let deg = 2.0 * apart.imag().norm().to_degrees();
            if !other.corrections.aligned {
                worst_deg = worst_deg.max(deg);
                assert!(deg < 0.05, "{deg}° at {t_s} s");
            }
        }
        println!("field {magnetic}: {worst_deg:.4}° at most in a tick");
    }
}

#[test]
fn it_takes_the_numbers_of_both_stages_but_for_the_magnetometer_of_aided() {
    const OF_THE_MAGNETOMETER: [&str; 4] = ["magnetic", "declination_deg", "magnetic_sd_deg", "magnetic_memory_s"];
    let mut fuser = named("multiple-model");
    let known = fuser.parameters();
    let [of_wz, of_aided] = ["wz", "aided"].map(|name| named(name).parameters());
    let own = of_wz.iter().filter(|of| of_aided.iter().all(|other| other.name != of.name));
    let expected: Vec<_> = own.chain(of_aided).filter(|of| !OF_THE_MAGNETOMETER.contains(&of.name)).copied().collect();
    assert_eq!(known, expected);
    let shared =
        of_wz.iter().filter_map(|of| of_aided.iter().find(|other| other.name == of.name).map(|other| (of, other)));
    let shared: Vec<_> = shared.inspect(|(of, other)| assert_eq!(of, other)).map(|(of, _)| of.name).collect();
    assert_eq!(shared, ["gyro_bias_walk_deg_s_sqrt_s"]);
    for name in ["hard_iron_sd_ut", "antenna_up_m", "gyro_bias_walk_deg_s_sqrt_s"] {
        assert_eq!(fuser.set(name, 1.0), Ok(()));
        assert!(matches!(fuser.set(name, 1e6), Err(ParameterError::OutOfRange { .. })));
    }
    for name in OF_THE_MAGNETOMETER.into_iter().chain(["colour"]) {
        assert_eq!(fuser.set(name, 1.0), Err(ParameterError::Unknown { known }));
    }
    assert_eq!(fuser.parts(), ["wz", "aided"]);
}

/// A car drives, stands until it is no longer taken to be carried, and is pushed: the level is that of `wz`, the heading that of `aided`.
#[test]
fn the_velocity_by_which_the_level_leans_is_handed_over_in_the_frame_of_the_heading() {
    for roll_deg in [0.0, 93.0, 180.0] {
        let velocity_m_s = velocity_of_a_push(0.7, f64::to_radians(roll_deg));
        println!("rolled by {roll_deg}°: {velocity_m_s} m/s");
        assert!((0.7..1.0).contains(&velocity_m_s.re.hypot(velocity_m_s.im)), "{velocity_m_s}");
        assert!((velocity_m_s.im.atan2(velocity_m_s.re) - 0.7).abs() < 0.05, "{velocity_m_s}");
    }
}

/// The leaky velocity after a push by 1 m/s² for 1 s in this direction, of a vehicle that goes to its right and rolled there at first.
fn velocity_of_a_push(direction_rad: f64, roll_rad: f64) -> Complex<f64> {
    let (sin, cos) = direction_rad.sin_cos();
    let (mut fuser, mut gyro, mut accel) =
        (named("multiple-model"), Gyro::from_name("mobius").unwrap(), Projector::default());
    let (mut rolled_rad, mut speed_m_s) = (roll_rad - 0.3, 0.0);
    let mut seconds = |duration_s: f64, roll_rad_s: f64, acceleration_m_s2: f64, told: bool| {
        let mut reference = CourseReference::Arbitrary;
        for tick in 0..(duration_s * 100.0) as u32 {
            rolled_rad += roll_rad_s * 0.01;
            speed_m_s += acceleration_m_s2 * 0.01;
            let rolled = UnitQuaternion::from_euler_angles(0.0, rolled_rad, 0.0);
            let force_m_s2 = rolled.inverse_transform_vector(&Vector3::new(acceleration_m_s2, 0.0, GRAVITY_M_S2));
            let rate_rad_s = Vector3::new(0.0, roll_rad_s, 0.0);
            let velocity_m_s = Vector3::new(cos * speed_m_s, sin * speed_m_s, 0.0);
            let fix = Fix { velocity_m_s, sd_m_s: None, age_s: None, latitude_rad: None };
            let out = fuser.step(&FuserInput {
                motion: Some(gyro.step(&RateSample { rate_rad_s, dt_s: 0.01, kind: RateKind::Mean })),
                inclination: Some(accel.step(&force_m_s2)),
                fix: (told && tick % 20 == 0).then_some(fix),
                rest_credible: true,
                rate_credible: true,
                ..FuserInput::default()
            });
            reference = out.reference;
        }
        (reference, fuser.common().leaky_velocity.velocity_m_s)
    };
    seconds(1.0, 0.3, 0.0, true);
    for acceleration_m_s2 in [0.0, 1.0, 0.0, -1.0] {
        seconds(15.0, 0.0, acceleration_m_s2, true);
    }
    seconds(310.0, 0.0, 0.0, false);
    let (reference, velocity_m_s) = seconds(1.0, 0.0, 1.0, false);
    assert_eq!(reference, CourseReference::True);
    velocity_m_s
}
