//! A beginning in motion with a gyro's bias that was known before.
use attitude::{
    GRAVITY_M_S2, Vector3,
    accel::Projector,
    angles::Angles,
    course::CourseReference,
    fuser::{Estimate, Fused, Fuser, FuserInput, FuserStage, GyroScale, HardIron, LeakyVelocity},
    gyro::{Gyro, Motion, RateSample},
    stage::Stage,
    state::Attitude,
    rotation::Rotation,
};
use scenario::Scenario;

/// They take the bias off the rate; how wrong it may be, °/s. `vqf` finds out by itself how well a bias is known, whoever found it.
const ESTIMATE_IT: [(&str, f64); 5] =
    [("wz", 0.02), ("multiple-model", 0.02), ("levelling-pi", 0.02), ("aided", 0.02), ("vqf", 0.08)];
/// Of the gyro, rad/s, on each axis: 0.1 °/s.
const BIAS_RAD_S: f64 = 0.001_745_329_251_994_329_5;
const SD_RAD_S: f64 = 2e-4;
/// Three quarters of the horizontal field.
const IRON_UT: Vector3<f64> = Vector3::new(15.0, 0.0, -4.0);
const IRON_SD_UT: f64 = 0.5;
/// Of the gyro.
const SCALE: GyroScale = GyroScale { error: Vector3::new(0.002, -0.004, 0.001), sd: Vector3::new(2e-4, 3e-4, 1e-4) };

/// The outputs over 2 s of a movement that does not rest, and the fuser after them.
fn moved(mut fuser: Fuser) -> (Vec<Fused>, Fuser) {
    let (mut gyro, mut accel, mut before_s) = (Gyro::from_name("mobius").unwrap(), Projector::default(), 0.0);
    let scenario = Scenario::parse("s1").unwrap();
    let step = |(t_s, reading): (f64, scenario::Reading)| {
        let (rate_rad_s, dt_s, kind) = (reading.rate_rad_s, t_s - before_s, scenario.rate_kind);
        before_s = t_s;
        fuser.step(&FuserInput {
            motion: Some(gyro.step(&RateSample { rate_rad_s, dt_s, kind })),
            inclination: Some(accel.step(&reading.force_m_s2)),
            rest_credible: true,
            rate_credible: true,
            ..FuserInput::default()
        })
    };
    let outputs = scenario.readings().take(200).map(step).collect();
    (outputs, fuser)
}

/// What an earlier run has found, and the attitude at its end.
fn known() -> Estimate {
    Estimate {
        attitude: Attitude::from_angles(Angles { yaw_rad: 1.0, pitch_rad: 0.5, roll_rad: 2.0 }),
        reference: CourseReference::Magnetic,
        bias_rad_s: Vector3::repeat(BIAS_RAD_S),
        inclination_sd_rad: 0.001,
        heading_sd_rad: 0.001,
        bias_sd_rad_s: SD_RAD_S,
        gyro_scale: SCALE,
        hard_iron: HardIron { field_ut: IRON_UT, sd_ut: IRON_SD_UT },
        leaky_velocity: LeakyVelocity::UNKNOWN,
    }
}

fn warm(name: &str) -> Fuser {
    let mut fuser = Fuser::from_name(name).unwrap();
    fuser.seed_sensor_errors(&known()).unwrap();
    fuser
}

fn error_deg_s(bias_rad_s: Vector3<f64>) -> f64 {
    (bias_rad_s - Vector3::repeat(BIAS_RAD_S)).amax().to_degrees()
}

#[test]
fn the_bias_is_there_from_the_first_tick_on_although_the_body_moves() {
    for (name, most_deg_s) in ESTIMATE_IT {
        let worst_deg_s = |(outputs, _): (Vec<Fused>, Fuser)| {
            outputs.iter().map(|out| error_deg_s(out.bias_rad_s)).fold(0.0, f64::max)
        };
        let (cold_deg_s, warm_deg_s) =
            (worst_deg_s(moved(Fuser::from_name(name).unwrap())), worst_deg_s(moved(warm(name))));
        println!("{name}: bias wrong by at most {cold_deg_s:.4} °/s cold, {warm_deg_s:.4} °/s warm");
        assert!(warm_deg_s < most_deg_s && cold_deg_s > 0.09, "{name}: {warm_deg_s}, {cold_deg_s}");
    }
}

#[test]
fn every_fuser_hands_it_on() {
    for name in Fuser::NAMES {
        let (_, fuser) = moved(warm(name));
        let common = fuser.common();
        println!(
            "{name}: {:.4} °/s off, told {:.4} °/s",
            error_deg_s(common.bias_rad_s),
            common.bias_sd_rad_s.to_degrees()
        );
        let most_deg_s = if name == "vqf" { 0.08 } else { 0.02 };
        assert!(error_deg_s(common.bias_rad_s) < most_deg_s, "{name}: {common:?}");
    }
}

#[test]
fn the_attitude_is_as_unknown_as_without_it() {
    for name in Fuser::NAMES {
        let (cold, warm) = (moved(Fuser::from_name(name).unwrap()).0, moved(warm(name)).0);
        let (cold, warm) = (&cold[0], &warm[0]);
        assert_eq!(warm.attitude, cold.attitude, "{name}");
        assert!(warm.corrections.aligned, "{name}");
        assert_eq!((warm.reference, warm.heading_sd_rad), (CourseReference::Arbitrary, cold.heading_sd_rad), "{name}");
        let share = warm.inclination_sd_rad / cold.inclination_sd_rad;
        assert!((share - 1.0).abs() < 1e-2, "{name}: {} and {} rad", warm.inclination_sd_rad, cold.inclination_sd_rad);
    }
}

#[test]
fn every_fuser_hands_the_hard_iron_on() {
    for name in Fuser::NAMES {
        let (_, fuser) = moved(warm(name));
        assert_eq!(fuser.common().hard_iron, known().hard_iron, "{name}");
        let mut restored = Fuser::from_name(name).unwrap();
        restored.restore(&fuser.snapshot()).unwrap();
        assert_eq!(restored.common().hard_iron, known().hard_iron, "{name}");
        assert_eq!(Fuser::from_name(name).unwrap().common().hard_iron, HardIron::UNKNOWN, "{name}");
    }
}

#[test]
fn every_fuser_hands_the_scale_of_the_gyro_on() {
    for name in Fuser::NAMES {
        let mut fuser = Fuser::from_name(name).unwrap();
        fuser.adopt(&known()).unwrap();
        assert_eq!(fuser.common().gyro_scale, SCALE, "{name}");
        let mut restored = Fuser::from_name(name).unwrap();
        restored.restore(&fuser.snapshot()).unwrap();
        assert_eq!(restored.common().gyro_scale, SCALE, "{name}");
        assert_eq!(warm(name).common().gyro_scale, SCALE, "{name}");
    }
}

#[test]
fn wz_finds_north_at_once_beside_a_hard_iron_that_was_known_before() {
    let (rate_rad_s, dt_s) = (Vector3::new(0.3, -0.2, 1.0), 0.01);
    let place_ut = Vector3::new(0.0, 20.0, -44.0);
    let largest_deg = |mut fuser: Fuser| {
        let mut attitude = Attitude::from_angles(Angles { yaw_rad: 2.0, pitch_rad: 0.3, roll_rad: -0.4 });
        let mut largest_deg: f64 = 0.0;
        for tick in 0..200 {
            let turn = Rotation::from_rotation_vector(rate_rad_s * dt_s);
            attitude = attitude.rotated(turn).attitude;
            let out = fuser.step(&FuserInput {
                motion: Some(Motion { attitude, rotation: turn, rate_rad_s, dt_s }),
                inclination: Some(Projector::default().step(&(attitude.up.direction() * GRAVITY_M_S2))),
                field_ut: Some(attitude.matrix() * place_ut + IRON_UT),
                rest_credible: true,
                rate_credible: true,
                ..FuserInput::default()
            });
            let error = out.attitude.quaternion() * attitude.quaternion().conjugate();
            let error_deg = (2.0 * error.imag().norm().atan2(error.w.abs())).to_degrees();
            largest_deg = if tick < 10 { 0.0 } else { largest_deg.max(error_deg) };
        }
        largest_deg
    };
    let mut warm = Fuser::from_name("wz").unwrap();
    warm.seed_sensor_errors(&Estimate { bias_rad_s: Vector3::zeros(), ..known() }).unwrap();
    let (cold_deg, warm_deg) = (largest_deg(Fuser::from_name("wz").unwrap()), largest_deg(warm));
    println!("heading within 2 s wrong by at most {cold_deg:.1}° cold, {warm_deg:.1}° warm");
    assert!(warm_deg < 2.0 && cold_deg > 10.0, "{warm_deg}°, {cold_deg}°");
}

#[test]
fn what_cannot_be_known_leaves_the_fuser_as_it_was() {
    let iron = |field_ut: f64, sd_ut: f64| HardIron { field_ut: Vector3::repeat(field_ut), sd_ut };
    let scale = |error: f64, sd: f64| Estimate {
        gyro_scale: GyroScale { error: Vector3::repeat(error), sd: Vector3::repeat(sd) },
        ..known()
    };
    let bias = |bias_rad_s: f64| Estimate { bias_rad_s: Vector3::repeat(bias_rad_s), ..known() };
    for name in Fuser::NAMES {
        for wrong in [
            bias(f64::NAN),
            bias(11.0),
            Estimate { bias_sd_rad_s: f64::NAN, ..known() },
            Estimate { bias_sd_rad_s: -1.0, ..known() },
            Estimate { hard_iron: iron(f64::NAN, 1.0), ..known() },
            Estimate { hard_iron: iron(1e5, 1.0), ..known() },
            Estimate { hard_iron: iron(1.0, -1.0), ..known() },
            scale(f64::NAN, 1e-3),
            scale(0.2, 1e-3),
            scale(1e-3, -1.0),
        ] {
            let mut fuser = Fuser::from_name(name).unwrap();
            assert!(fuser.seed_sensor_errors(&wrong).is_err(), "{name}: {wrong:?}");
            assert_eq!(fuser, Fuser::from_name(name).unwrap(), "{name}");
        }
    }
}
