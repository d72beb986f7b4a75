//! Tests of the fuser `multiple-model`: choice between its two stages, and its heading reference.
use attitude::{
    Complex, GRAVITY_M_S2, Vector3,
    accel::Accelerometer,
    course::CourseReference,
    fuser::{Fused, Fuser, FuserInput},
    gnss::Fix,
    gyro::{Gyro, Motion, RateKind, RateSample},
    parameters::ParameterError,
    rotation::Rotation,
    stage::Stage,
    state::Attitude,
};
use nalgebra::UnitQuaternion;
use scenario::{Magnetometer, Scenario};

use crate::common::{DT_S, Row, broad};

const FIELD_UT: Vector3<f64> = Vector3::new(0.0, 20.0, -44.0);

fn from_name(name: &str) -> Fuser {
    Fuser::from_name(name).unwrap()
}

/// Returns the inputs of a trial without the ticks for which `is_missing` is true. The rotation
/// during a gap is computed from the rate after the gap.
fn inputs(trial: &[Row], magnetic: bool, is_missing: impl Fn(usize) -> bool) -> Vec<FuserInput> {
    let (mut gyro, mut accel) = (Gyro::from_name("mobius").unwrap(), Accelerometer::default());
    let mut previous = 0;
    let input = |(index, row): (usize, &Row)| {
        let dt_s = (index - std::mem::replace(&mut previous, index)) as f64 * DT_S;
        FuserInput {
            motion: Some(gyro.step(&RateSample { rate_rad_s: row.rate_rad_s, dt_s, kind: RateKind::Mean })),
            inclination: Some(accel.step(&row.force_m_s2)),
            field_ut: magnetic.then_some(row.field_ut),
            rest_credible: true,
            rate_credible: true,
            ..FuserInput::default()
        }
    };
    trial.iter().enumerate().filter(|(index, _)| !is_missing(*index)).map(input).collect()
}

#[recorded::test]
fn multiple_model_on_broad_equals_wz_bit_for_bit() {
    let Some(trials) = broad() else { return };
    for (index, trial) in trials.iter().enumerate() {
        for magnetic in [false, true] {
            let (mut multiple_model, mut wz) = (from_name("multiple-model"), from_name("wz"));
            for (tick, input) in inputs(trial, magnetic, |_| false).iter().enumerate() {
                assert_eq!(multiple_model.step(input), wz.step(input), "trial {index}, field {magnetic}, tick {tick}");
            }
        }
    }
}

#[recorded::test]
fn gaps_in_motion_are_not_taken_for_turns() {
    let Some(trials) = broad() else { return };
    for (index, trial) in trials.iter().enumerate() {
        for gap_s in [0.3, 0.5, 0.7] {
            let is_missing = |tick: usize| tick as f64 * DT_S > 20.0 && tick as f64 * DT_S % 20.0 < gap_s;
            let (mut multiple_model, mut wz) = (from_name("multiple-model"), from_name("wz"));
            for (tick, input) in inputs(trial, true, is_missing).iter().enumerate() {
                let [up, expected] = [&mut multiple_model, &mut wz].map(|stage| stage.step(input).attitude.up);
                assert_eq!(up, expected, "trial {index}, gaps of {gap_s} s, tick {tick}");
            }
        }
    }
}

/// Returns the outputs of a cruise until `until_s`, followed by `rest_s` seconds at rest.
///
/// The cruise has fixes from 10 s onwards. The rest begins immediately, without a landing, and has
/// no fixes.
fn fly_and_rest(until_s: f64, rest_s: f64, magnetic: bool) -> Vec<(f64, Fused)> {
    let mut scenario = Scenario::parse("cruise?duration_s=600").unwrap();
    scenario.errors.magnetometer = magnetic.then_some(Magnetometer { reference_ut: FIELD_UT, noise_ut: 0.5 });
    let (mut gyro, mut accel) = (Gyro::from_name("mobius").unwrap(), Accelerometer::default());
    let mut fuser = from_name("multiple-model");
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

/// Returns each heading reference with the time from which it applies, s.
fn references(outputs: &[(f64, Fused)]) -> Vec<(f64, CourseReference)> {
    let mut all: Vec<(f64, CourseReference)> = Vec::new();
    for (t_s, out) in outputs {
        if all.last().is_none_or(|(_, reference)| *reference != out.reference) {
            assert!(out.corrections.aligned, "unannounced change of reference at {t_s} s");
            all.push((*t_s, out.reference));
        }
    }
    all
}

#[test]
fn change_of_heading_reference_is_announced() {
    use CourseReference::{Arbitrary, Magnetic, True};
    let in_order = |references: Vec<(f64, CourseReference)>| {
        references.into_iter().map(|(_, reference)| reference).collect::<Vec<_>>()
    };
    assert_eq!(in_order(references(&fly_and_rest(60.0, 400.0, false))), [Arbitrary, True]);
    let outputs = fly_and_rest(60.0, 400.0, true);
    let changes = references(&outputs);
    println!("{changes:?}");
    assert_eq!(in_order(changes.clone()), [Arbitrary, Magnetic, True, Magnetic]);
    // The reference changes 300 s after the last fix.
    assert!((359.0..361.0).contains(&changes[3].0));
}

#[test]
fn change_of_stage_at_rest_has_no_unannounced_step() {
    for magnetic in [false, true] {
        let outputs = fly_and_rest(300.0, 400.0, magnetic);
        let mut worst_deg = 0f64;
        // The body is at rest, so every rotation is a correction by the fuser.
        for pair in outputs.windows(2).filter(|pair| pair[0].0 > 300.0) {
            let [(t_s, previous), (_, next)] = pair else { continue };
            let difference = next.attitude.quaternion() * previous.attitude.quaternion().conjugate();
            let step_deg = 2.0 * difference.imag().norm().to_degrees();
            if !next.corrections.aligned {
                worst_deg = worst_deg.max(step_deg);
                assert!(step_deg < 0.05, "{step_deg}° at {t_s} s");
            }
        }
        println!("field {magnetic}: {worst_deg:.4}° at most in a tick");
    }
}

#[test]
fn parameters_are_those_of_wz_and_aided_without_magnetic() {
    const MAGNETOMETER_OF_AIDED: [&str; 4] = ["magnetic", "declination_deg", "magnetic_sd_deg", "magnetic_memory_s"];
    let mut fuser = from_name("multiple-model");
    let parameters = fuser.parameters();
    let [of_wz, of_aided] = ["wz", "aided"].map(|name| from_name(name).parameters());
    let of_wz_only = of_wz.iter().filter(|own| of_aided.iter().all(|other| other.name != own.name));
    let expected: Vec<_> = of_wz_only
        .chain(of_aided)
        .filter(|parameter| !MAGNETOMETER_OF_AIDED.contains(&parameter.name))
        .copied()
        .collect();
    assert_eq!(parameters, expected);
    let shared =
        of_wz.iter().filter_map(|own| of_aided.iter().find(|other| other.name == own.name).map(|other| (own, other)));
    let shared: Vec<_> = shared.inspect(|(own, other)| assert_eq!(own, other)).map(|(own, _)| own.name).collect();
    assert_eq!(shared, ["gyro_bias_walk_deg_s_sqrt_s"]);
    for name in ["hard_iron_sd_ut", "antenna_up_m", "gyro_bias_walk_deg_s_sqrt_s"] {
        assert_eq!(fuser.set(name, 1.0), Ok(()));
        assert!(matches!(fuser.set(name, 1e6), Err(ParameterError::OutOfRange { .. })));
    }
    for name in MAGNETOMETER_OF_AIDED.into_iter().chain(["colour"]) {
        assert_eq!(fuser.set(name, 1.0), Err(ParameterError::Unknown { known: parameters }));
    }
    assert_eq!(fuser.parts(), ["wz", "aided"]);
}

/// Tests the leaky velocity of a car that drives, stands still and is then pushed. ¶ The car stands
/// still until the fuser no longer assumes ground motion.
///
/// At the time of the push, the level comes from `wz` and the heading from `aided`.
#[test]
fn leaky_velocity_is_handed_over_in_heading_frame() {
    for roll_deg in [0.0, 93.0, 180.0] {
        let velocity_m_s = leaky_velocity_after_push(0.7, f64::to_radians(roll_deg));
        println!("rolled by {roll_deg}°: {velocity_m_s} m/s");
        assert!((0.7..1.0).contains(&velocity_m_s.re.hypot(velocity_m_s.im)), "{velocity_m_s}");
        assert!((velocity_m_s.im.atan2(velocity_m_s.re) - 0.7).abs() < 0.05, "{velocity_m_s}");
    }
}

/// Returns the leaky velocity after a push of 1 m/s² for 1 s in `direction_rad`.
///
/// Before the push, the vehicle rolls to `roll_rad`, drives in the direction of its right axis with
/// fixes, and then stands still without fixes.
fn leaky_velocity_after_push(direction_rad: f64, roll_rad: f64) -> Complex<f64> {
    let (sin, cos) = direction_rad.sin_cos();
    let (mut fuser, mut gyro, mut accel) =
        (from_name("multiple-model"), Gyro::from_name("mobius").unwrap(), Accelerometer::default());
    let (mut current_roll_rad, mut speed_m_s) = (roll_rad - 0.3, 0.0);
    let mut drive = |duration_s: f64, roll_rad_s: f64, acceleration_m_s2: f64, has_fixes: bool| {
        let mut reference = CourseReference::Arbitrary;
        for tick in 0..(duration_s * 100.0) as u32 {
            current_roll_rad += roll_rad_s * 0.01;
            speed_m_s += acceleration_m_s2 * 0.01;
            let rotation = UnitQuaternion::from_euler_angles(0.0, current_roll_rad, 0.0);
            let force_m_s2 = rotation.inverse_transform_vector(&Vector3::new(acceleration_m_s2, 0.0, GRAVITY_M_S2));
            let rate_rad_s = Vector3::new(0.0, roll_rad_s, 0.0);
            let velocity_m_s = Vector3::new(cos * speed_m_s, sin * speed_m_s, 0.0);
            let fix = Fix { velocity_m_s, sd_m_s: None, age_s: None, latitude_rad: None };
            let out = fuser.step(&FuserInput {
                motion: Some(gyro.step(&RateSample { rate_rad_s, dt_s: 0.01, kind: RateKind::Mean })),
                inclination: Some(accel.step(&force_m_s2)),
                fix: (has_fixes && tick % 20 == 0).then_some(fix),
                rest_credible: true,
                rate_credible: true,
                ..FuserInput::default()
            });
            reference = out.reference;
        }
        (reference, fuser.common().leaky_velocity.velocity_m_s)
    };
    drive(1.0, 0.3, 0.0, true);
    for acceleration_m_s2 in [0.0, 1.0, 0.0, -1.0] {
        drive(15.0, 0.0, acceleration_m_s2, true);
    }
    drive(310.0, 0.0, 0.0, false);
    let (reference, velocity_m_s) = drive(1.0, 0.0, 1.0, false);
    assert_eq!(reference, CourseReference::True);
    velocity_m_s
}
