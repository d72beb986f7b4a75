//! Checks that rates match attitudes, that forces match velocities and that the seed determines the
//! readings.
#![allow(clippy::unwrap_used, reason = "tests")]

use attitude::{GRAVITY_M_S2, Vector3, gnss::Fix, rotation::Rotation, state::Attitude};
use scenario::{Coverage, Motion, Scenario, SensorErrors, Sensors};

fn sample_times(name: &str) -> impl Iterator<Item = f64> + use<> {
    let duration_s = Scenario::parse(name).unwrap().duration_s;
    (0..200).map(move |k| duration_s * (f64::from(k) + 0.37) / 200.0)
}

#[test]
fn attitude_rotates_at_body_rate() {
    for name in Scenario::NAMES {
        let motion = Motion::from_name(name).unwrap();
        for t_s in sample_times(name) {
            let rotation = motion.rotation_between(t_s - 1e-5, t_s + 1e-5).quaternion();
            let rate_rad_s = rotation.imag() * (2.0 / 2e-5) * rotation.w.signum();
            let error_rad_s = (rate_rad_s - motion.at(t_s).rate_rad_s).norm();
            assert!(error_rad_s < 1e-5, "{name} at {t_s} s: {error_rad_s} rad/s");
        }
    }
}

#[test]
fn mean_rate_is_average_of_instantaneous_rates() {
    for name in Scenario::NAMES {
        let motion = Motion::from_name(name).unwrap();
        for t_s in sample_times(name) {
            let parts = (0..1000).map(|k| motion.at(t_s + 1e-5 * (f64::from(k) + 0.5)).rate_rad_s);
            let mean_rad_s = parts.sum::<Vector3<f64>>() / 1000.0;
            let error_rad_s = (mean_rad_s - motion.mean_rate_rad_s(t_s, t_s + 0.01)).norm();
            assert!(error_rad_s < 2e-3 * (mean_rad_s.norm() / 1000.0 + 1e-2), "{name} at {t_s} s: {error_rad_s} rad/s");
        }
    }
}

#[test]
fn single_sample_integration_of_coning_drifts_as_published() {
    let motion = Motion::from_name("coning").unwrap();
    let (mut attitude, mut two_sample) = (motion.at(0.0).attitude, motion.at(0.0).attitude);
    for k in 0..1000 {
        let t_s = f64::from(k) * 0.01;
        attitude =
            attitude.rotated(Rotation::from_rotation_vector(motion.mean_rate_rad_s(t_s, t_s + 0.01) * 0.01)).attitude;
        let [first, second] =
            [0.0, 0.005].map(|offset_s| motion.mean_rate_rad_s(t_s + offset_s, t_s + offset_s + 0.005) * 0.005);
        let rotation_rad = first + second + first.cross(&second) * (2.0 / 3.0);
        two_sample = two_sample.rotated(Rotation::from_rotation_vector(rotation_rad)).attitude;
    }
    let error_deg = |attitude: Attitude| {
        let q = Rotation::between(attitude, motion.at(10.0).attitude).quaternion();
        (2.0 * q.imag().norm()).to_degrees()
    };
    let (one, two) = (error_deg(attitude), error_deg(two_sample));
    println!("drift over 10 s: one sample {one:.4}°, two samples {two:.6}°");
    assert!((1.0..1.25).contains(&one) && two < 0.01);
}

#[test]
fn flight_force_matches_derivative_of_velocity() {
    for name in ["cruise", "cruise-hard"] {
        let mut scenario = Scenario::parse(name).unwrap();
        scenario.errors.receiver = scenario.errors.receiver.map(|r| scenario::Receiver {
            interval_s: 0.01,
            latency_s: 0.0,
            noise_m_s: 0.0,
            ..r
        });
        scenario.duration_s = 200.0;
        let readings: Vec<_> = scenario.readings().map(|(_, reading)| reading).collect();
        let velocity = |reading: &scenario::Reading| reading.fix.unwrap().velocity_m_s;
        for three in readings.windows(3) {
            let [before, now, after] = three else { unreachable!() };
            let acceleration_m_s2 = (velocity(after) - velocity(before)) / 0.02;
            let expected_m_s2 =
                now.truth.attitude.matrix().transpose() * now.truth.force_m_s2 - Vector3::z() * GRAVITY_M_S2;
            let error_m_s2 = (acceleration_m_s2 - expected_m_s2).norm();
            assert!(error_m_s2 < 1e-3, "{name}: {acceleration_m_s2}, expected {expected_m_s2}");
        }
    }
}

#[test]
fn flight_turns_are_coordinated_and_frequent() {
    let motion = Motion::from_name("cruise").unwrap();
    let banked = (0..1800).filter(|t_s| motion.at(f64::from(*t_s)).attitude.angles().roll_rad.abs() > 0.1).count();
    assert!((200..900).contains(&banked), "{banked} s of turns in 1800 s");
    for t_s in sample_times("cruise") {
        let force_m_s2 = motion.at(t_s).force_m_s2;
        assert!(libm::atan2(force_m_s2.x, force_m_s2.z).abs() < 0.02, "lateral force at {t_s} s");
    }
}

#[test]
fn seed_determines_readings_bit_exact() {
    let bits = |seed: u64| {
        let scenario = Scenario::parse("cruise-hard?duration_s=300").unwrap().with_seed(seed);
        let numbers = scenario.readings().flat_map(|(_, reading)| {
            let fix = reading.fix.map_or(Vector3::zeros(), |fix| fix.velocity_m_s);
            [reading.rate_rad_s, reading.force_m_s2, fix].map(|v| v.map(f64::to_bits))
        });
        numbers.flat_map(|v| [v.x, v.y, v.z]).fold(0u64, |sum, bits| (sum ^ bits).wrapping_mul(0x100_0000_01b3))
    };
    assert_eq!(bits(3), bits(3));
    assert_ne!(bits(3), bits(4));
    assert_eq!(bits(1), 11_033_558_824_228_236_432, "the readings must have the same bits on every machine");
}

#[test]
fn fixes_follow_coverage_and_latency() {
    for (query, fixes) in [("always", 17_999), ("gaps", 17_999 - 7 * 600), ("start", 5_998), ("never", 0)] {
        let scenario = Scenario::parse(&format!("cruise?gnss={query}")).unwrap();
        let count = scenario.readings().filter(|(_, reading)| reading.fix.is_some()).count();
        assert_eq!(count, fixes, "{query}");
    }
    assert!(!Coverage::Gaps.covers(300.0) && Coverage::Gaps.covers(360.0) && !Coverage::Gaps.covers(540.0));
    let first_s = Scenario::parse("cruise").unwrap().readings().find(|(_, reading)| reading.fix.is_some()).unwrap().0;
    assert_eq!(first_s, 0.2);
}

#[test]
fn noise_has_specified_standard_deviation() {
    let scenario = Scenario::parse("s3").unwrap();
    let reference_ut = Vector3::from(scenario::s3::FIELD_UT);
    let (mut rate2, mut force2, mut field2, mut count) = (0.0, 0.0, 0.0, 0.0);
    for (_, reading) in scenario.readings().skip(1) {
        let matrix = reading.truth.attitude.matrix();
        force2 += (reading.force_m_s2 - reading.truth.force_m_s2).norm_squared() / 3.0;
        field2 += (reading.field_ut.unwrap() - matrix * reference_ut).norm_squared() / 3.0;
        // The axis of rotation changes at two samples, where the reading differs greatly from the
        // true rate. Each squared difference is therefore capped.
        rate2 += (reading.rate_rad_s - reading.truth.rate_rad_s).norm_squared().min(0.01) / 3.0;
        count += 1.0;
    }
    let rms = |sum: f64| libm::sqrt(sum / count);
    assert!((rms(rate2).to_degrees() - 1.0).abs() < 0.05);
    assert!((rms(force2) / GRAVITY_M_S2 - 0.03).abs() < 0.0015);
    assert!((rms(field2) / reference_ut.norm() - 0.03).abs() < 0.0015);
}

#[test]
fn reference_scenario_readings_match_its_sensors() {
    let scenario = Scenario::parse("s1?seed=5&rate_hz=200&duration_s=2").unwrap();
    let mut sensors = Sensors::new(Motion::S1, SensorErrors::S1, 5);
    let readings: Vec<_> = scenario.readings().collect();
    assert_eq!(readings.len(), 401);
    for (t_s, reading) in readings {
        assert_eq!(reading, sensors.read(t_s));
    }
}

#[test]
fn invalid_scenario_is_rejected_with_alternatives() {
    for (text, expected) in [
        (
            "cruse",
            "unknown scenario `cruse`; did you mean `cruise`? expected one of s1, tumble, s3, coning, cruise, cruise-hard",
        ),
        (
            "cruise?sed=3",
            "unknown scenario parameter `sed`; did you mean `seed`? expected one of seed, rate_hz, duration_s, gnss, gyro_bias_deg_s, gyro_noise_deg_s, gyro_scale, \
             accel_bias_g, accel_noise_g, field_noise_ut, gnss_noise_m_s, gnss_latency_s, antenna_right_m, antenna_forward_m, antenna_up_m, \
             amplitude_deg, as in `cruise?seed=3&gnss=gaps`",
        ),
        ("cruise?seed=-1", "invalid scenario parameter seed: found `-1`, expected a natural number"),
        ("cruise?rate_hz=NaN", "invalid scenario parameter rate_hz: found `NaN`, expected a number from 1 to 10000"),
        (
            "cruise?gnss=often",
            "invalid scenario parameter gnss: found `often`, expected one of always, gaps, start, never",
        ),
        ("s1?gnss=gaps", "scenario `s1` has no satellite receiver; remove `gnss`"),
        ("s1?field_noise_ut=1", "scenario `s1` has no magnetometer; remove `field_noise_ut`"),
        ("cruise?amplitude_deg=9", "scenario `cruise` has no amplitude; remove `amplitude_deg`"),
        ("s1?amplitude_deg=90", "invalid scenario parameter amplitude_deg: found `90`, expected a number from 0 to 89"),
    ] {
        assert_eq!(Scenario::parse(text).unwrap_err().to_string(), expected);
    }
}

#[test]
fn parameters_change_only_what_they_name() {
    let parse = |name: &str| Scenario::parse(name).unwrap();
    for (text, expected) in [
        (
            "s1?gyro_bias_deg_s=2&rate_hz=200",
            Scenario {
                rate_hz: 200.0,
                errors: SensorErrors { gyro_bias_rad_s: 2f64.to_radians(), ..SensorErrors::S1 },
                ..parse("s1")
            },
        ),
        (
            "tumble?accel_noise_g=0.5",
            Scenario {
                errors: SensorErrors { accel_noise_m_s2: 0.5 * GRAVITY_M_S2, ..SensorErrors::S1 },
                ..parse("tumble")
            },
        ),
        // Noise parameters apply at the final sampling rate, whatever the order of the keys.
        ("cruise?gyro_noise_deg_s=1&rate_hz=400&accel_noise_g=0.1", {
            let cruise = parse("cruise?rate_hz=400");
            let errors = SensorErrors {
                gyro_noise_rad_s: 1f64.to_radians(),
                accel_noise_m_s2: 0.1 * GRAVITY_M_S2,
                ..cruise.errors
            };
            Scenario { errors, ..cruise }
        }),
    ] {
        assert_eq!(parse(text), expected, "{text}");
    }
    let swing = |text: &str| {
        let angles = parse(text).motion.at(5.0).attitude.angles();
        let pitch_rad = parse(text).motion.at(0.0).attitude.angles().pitch_rad;
        [angles.roll_rad, pitch_rad].map(f64::to_degrees)
    };
    for (text, [roll_deg, pitch_deg]) in [("s1", [30.0, 25.0]), ("s1?amplitude_deg=60", [60.0, 50.0])] {
        let [roll, pitch] = swing(text);
        assert!((roll - roll_deg).abs() < 1e-9 && (pitch - pitch_deg).abs() < 1e-9, "{text}: {roll} {pitch}");
    }
    let latency_s = |text: &str| parse(text).readings().find(|(_, reading)| reading.fix.is_some()).unwrap().0;
    assert_eq!((latency_s("cruise"), latency_s("cruise?gnss_latency_s=0.5")), (0.2, 0.5));
    let velocities = |text: &str| parse(text).readings().filter_map(|(_, reading)| reading.fix);
    let max_difference = |text: &str| {
        let pairs = velocities("cruise?duration_s=20").zip(velocities(text));
        let max = |max: f64, (one, other): (Fix, Fix)| max.max((one.velocity_m_s - other.velocity_m_s).norm());
        pairs.fold(0.0, max)
    };
    // With the antenna 10 m above the sensors, a roll of 1° at 1/7.3 Hz contributes 0.15 m/s and
    // the pitch at most 0.21 m/s.
    assert!((0.15..0.26).contains(&max_difference("cruise?antenna_up_m=10&duration_s=20")));
    assert_eq!(max_difference("cruise?antenna_up_m=0&duration_s=20"), 0.0);
}
