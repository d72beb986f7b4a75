//! Starts in motion with sensor errors that are known from an earlier run.
use attitude::{
    GRAVITY_M_S2, Vector3,
    accel::Accelerometer,
    angles::Angles,
    course::CourseReference,
    fuser::{Estimate, Fused, Fuser, FuserInput, FuserStage, GyroScale, HardIron, LeakyVelocity},
    gyro::{Gyro, Motion, RateSample},
    rotation::Rotation,
    stage::Stage,
    state::Attitude,
};
use scenario::Scenario;

/// Fusers that subtract the bias from the rate, with the largest accepted bias error in °/s.
///
/// `vqf` has a higher limit, because it assumes the same bias uncertainty as on a cold start, even
/// if the bias comes from an earlier run.
const BIAS_ESTIMATORS: [(&str, f64); 5] =
    [("wz", 0.02), ("multiple-model", 0.02), ("levelling-pi", 0.02), ("aided", 0.02), ("vqf", 0.08)];
/// Gyro bias on each axis, rad/s (0.1 °/s).
const BIAS_RAD_S: f64 = 0.001_745_329_251_994_329_5;
const BIAS_SD_RAD_S: f64 = 2e-4;
/// Hard iron, µT. Its horizontal part is three quarters of the horizontal part of the ambient
/// field.
const HARD_IRON_UT: Vector3<f64> = Vector3::new(15.0, 0.0, -4.0);
const HARD_IRON_SD_UT: f64 = 0.5;
/// Scale error of the gyro, per axis.
const GYRO_SCALE: GyroScale =
    GyroScale { error: Vector3::new(0.002, -0.004, 0.001), sd: Vector3::new(2e-4, 3e-4, 1e-4) };

/// Runs the first 2 s of scenario S1, which has no rest. Returns the outputs and the fuser at the
/// end.
fn run_in_motion(mut fuser: Fuser) -> (Vec<Fused>, Fuser) {
    let (mut gyro, mut accel, mut before_s) = (Gyro::from_name("mobius").unwrap(), Accelerometer::default(), 0.0);
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

/// Returns the estimate of an earlier run, with the attitude at its end.
fn prior() -> Estimate {
    Estimate {
        attitude: Attitude::from_angles(Angles { yaw_rad: 1.0, pitch_rad: 0.5, roll_rad: 2.0 }),
        reference: CourseReference::Magnetic,
        bias_rad_s: Vector3::repeat(BIAS_RAD_S),
        inclination_sd_rad: 0.001,
        heading_sd_rad: 0.001,
        bias_sd_rad_s: BIAS_SD_RAD_S,
        gyro_scale: GYRO_SCALE,
        hard_iron: HardIron { field_ut: HARD_IRON_UT, sd_ut: HARD_IRON_SD_UT },
        leaky_velocity: LeakyVelocity::UNKNOWN,
    }
}

fn warm_started(name: &str) -> Fuser {
    let mut fuser = Fuser::from_name(name).unwrap();
    fuser.seed_sensor_errors(&prior()).unwrap();
    fuser
}

fn error_deg_s(bias_rad_s: Vector3<f64>) -> f64 {
    (bias_rad_s - Vector3::repeat(BIAS_RAD_S)).amax().to_degrees()
}

#[test]
fn known_bias_applies_from_first_tick_in_motion() {
    for (name, max_deg_s) in BIAS_ESTIMATORS {
        let worst_deg_s = |(outputs, _): (Vec<Fused>, Fuser)| {
            outputs.iter().map(|out| error_deg_s(out.bias_rad_s)).fold(0.0, f64::max)
        };
        let (cold_deg_s, warm_deg_s) = (
            worst_deg_s(run_in_motion(Fuser::from_name(name).unwrap())),
            worst_deg_s(run_in_motion(warm_started(name))),
        );
        println!("{name}: largest bias error {cold_deg_s:.4} °/s cold, {warm_deg_s:.4} °/s warm");
        assert!(warm_deg_s < max_deg_s && cold_deg_s > 0.09, "{name}: {warm_deg_s}, {cold_deg_s}");
    }
}

#[test]
fn every_fuser_hands_on_known_bias() {
    for name in Fuser::NAMES {
        let (_, fuser) = run_in_motion(warm_started(name));
        let common = fuser.common();
        println!(
            "{name}: {:.4} °/s error, reported sd {:.4} °/s",
            error_deg_s(common.bias_rad_s),
            common.bias_sd_rad_s.to_degrees()
        );
        let max_deg_s = if name == "vqf" { 0.08 } else { 0.02 };
        assert!(error_deg_s(common.bias_rad_s) < max_deg_s, "{name}: {common:?}");
    }
}

#[test]
fn known_sensor_errors_leave_attitude_unknown() {
    for name in Fuser::NAMES {
        let (cold, warm) = (run_in_motion(Fuser::from_name(name).unwrap()).0, run_in_motion(warm_started(name)).0);
        let (cold, warm) = (&cold[0], &warm[0]);
        assert_eq!(warm.attitude, cold.attitude, "{name}");
        assert!(warm.corrections.aligned, "{name}");
        assert_eq!((warm.reference, warm.heading_sd_rad), (CourseReference::Arbitrary, cold.heading_sd_rad), "{name}");
        let share = warm.inclination_sd_rad / cold.inclination_sd_rad;
        assert!((share - 1.0).abs() < 1e-2, "{name}: {} and {} rad", warm.inclination_sd_rad, cold.inclination_sd_rad);
    }
}

#[test]
fn every_fuser_hands_on_known_hard_iron() {
    for name in Fuser::NAMES {
        let (_, fuser) = run_in_motion(warm_started(name));
        assert_eq!(fuser.common().hard_iron, prior().hard_iron, "{name}");
        let mut restored = Fuser::from_name(name).unwrap();
        restored.restore(&fuser.snapshot()).unwrap();
        assert_eq!(restored.common().hard_iron, prior().hard_iron, "{name}");
        assert_eq!(Fuser::from_name(name).unwrap().common().hard_iron, HardIron::UNKNOWN, "{name}");
    }
}

#[test]
fn every_fuser_hands_on_known_gyro_scale() {
    for name in Fuser::NAMES {
        let mut fuser = Fuser::from_name(name).unwrap();
        fuser.adopt(&prior()).unwrap();
        assert_eq!(fuser.common().gyro_scale, GYRO_SCALE, "{name}");
        let mut restored = Fuser::from_name(name).unwrap();
        restored.restore(&fuser.snapshot()).unwrap();
        assert_eq!(restored.common().gyro_scale, GYRO_SCALE, "{name}");
        assert_eq!(warm_started(name).common().gyro_scale, GYRO_SCALE, "{name}");
    }
}

#[test]
fn wz_with_known_hard_iron_finds_north_immediately() {
    let (rate_rad_s, dt_s) = (Vector3::new(0.3, -0.2, 1.0), 0.01);
    let ambient_ut = Vector3::new(0.0, 20.0, -44.0);
    let largest_deg = |mut fuser: Fuser| {
        let mut attitude = Attitude::from_angles(Angles { yaw_rad: 2.0, pitch_rad: 0.3, roll_rad: -0.4 });
        let mut largest_deg: f64 = 0.0;
        for tick in 0..200 {
            let rotation = Rotation::from_rotation_vector(rate_rad_s * dt_s);
            attitude = attitude.rotated(rotation).attitude;
            let out = fuser.step(&FuserInput {
                motion: Some(Motion { attitude, rotation, rate_rad_s, dt_s }),
                inclination: Some(Accelerometer::default().step(&(attitude.up.direction() * GRAVITY_M_S2))),
                field_ut: Some(attitude.matrix() * ambient_ut + HARD_IRON_UT),
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
    warm.seed_sensor_errors(&Estimate { bias_rad_s: Vector3::zeros(), ..prior() }).unwrap();
    let (cold_deg, warm_deg) = (largest_deg(Fuser::from_name("wz").unwrap()), largest_deg(warm));
    println!("largest heading error within 2 s {cold_deg:.1}° cold, {warm_deg:.1}° warm");
    assert!(warm_deg < 2.0 && cold_deg > 10.0, "{warm_deg}°, {cold_deg}°");
}

#[test]
fn invalid_sensor_errors_leave_fuser_unchanged() {
    let hard_iron = |field_ut: f64, sd_ut: f64| HardIron { field_ut: Vector3::repeat(field_ut), sd_ut };
    let scale = |error: f64, sd: f64| Estimate {
        gyro_scale: GyroScale { error: Vector3::repeat(error), sd: Vector3::repeat(sd) },
        ..prior()
    };
    let bias = |bias_rad_s: f64| Estimate { bias_rad_s: Vector3::repeat(bias_rad_s), ..prior() };
    for name in Fuser::NAMES {
        for invalid in [
            bias(f64::NAN),
            bias(11.0),
            Estimate { bias_sd_rad_s: f64::NAN, ..prior() },
            Estimate { bias_sd_rad_s: -1.0, ..prior() },
            Estimate { hard_iron: hard_iron(f64::NAN, 1.0), ..prior() },
            Estimate { hard_iron: hard_iron(1e5, 1.0), ..prior() },
            Estimate { hard_iron: hard_iron(1.0, -1.0), ..prior() },
            scale(f64::NAN, 1e-3),
            scale(0.2, 1e-3),
            scale(1e-3, -1.0),
        ] {
            let mut fuser = Fuser::from_name(name).unwrap();
            assert!(fuser.seed_sensor_errors(&invalid).is_err(), "{name}: {invalid:?}");
            assert_eq!(fuser, Fuser::from_name(name).unwrap(), "{name}");
        }
    }
}
