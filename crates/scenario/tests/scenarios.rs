//! The scenarios agree with themselves: rates with attitudes, forces with velocities, readings with their seeds.
#![allow(clippy::unwrap_used, reason = "tests")]

use attitude::{GRAVITY_M_S2, Vector3, gnss::Fix, state::Attitude, rotation::Rotation};
use scenario::{Coverage, Errors, Motion, Scenario, Sensors};

fn every(name: &str) -> impl Iterator<Item = f64> + use<> {
    let duration_s = Scenario::named(name).unwrap().duration_s;
    (0..200).map(move |k| duration_s * (f64::from(k) + 0.37) / 200.0)
}

#[test]
fn the_attitude_turns_at_the_rate() {
    for name in Scenario::NAMES {
        let motion = Motion::named(name).unwrap();
        for t_s in every(name) {
            let turn = motion.turn(t_s - 1e-5, t_s + 1e-5).quaternion();
            let rate_rad_s = turn.imag() * (2.0 / 2e-5) * turn.w.signum();
            let off_rad_s = (rate_rad_s - motion.at(t_s).rate_rad_s).norm();
            assert!(off_rad_s < 1e-5, "{name} at {t_s} s: {off_rad_s} rad/s");
        }
    }
}

#[test]
fn mean_rates_are_those_of_the_instants_between() {
    for name in Scenario::NAMES {
        let motion = Motion::named(name).unwrap();
        for t_s in every(name) {
            let parts = (0..1000).map(|k| motion.at(t_s + 1e-5 * (f64::from(k) + 0.5)).rate_rad_s);
            let mean_rad_s = parts.sum::<Vector3<f64>>() / 1000.0;
            let off_rad_s = (mean_rad_s - motion.mean_rate_rad_s(t_s, t_s + 0.01)).norm();
            assert!(off_rad_s < 2e-3 * (mean_rad_s.norm() / 1000.0 + 1e-2), "{name} at {t_s} s: {off_rad_s} rad/s");
        }
    }
}

#[test]
fn coning_drifts_by_the_published_rate_for_who_takes_mean_rates_for_rotations() {
    let motion = Motion::named("coning").unwrap();
    let (mut attitude, mut two_sample) = (motion.at(0.0).attitude, motion.at(0.0).attitude);
    for k in 0..1000 {
        let t_s = f64::from(k) * 0.01;
        attitude = attitude.rotated(Rotation::from_rotation_vector(motion.mean_rate_rad_s(t_s, t_s + 0.01) * 0.01)).attitude;
        let [first, second] = [0.0, 0.005].map(|of| motion.mean_rate_rad_s(t_s + of, t_s + of + 0.005) * 0.005);
        let rotation_rad = first + second + first.cross(&second) * (2.0 / 3.0);
        two_sample = two_sample.rotated(Rotation::from_rotation_vector(rotation_rad)).attitude;
    }
    let off_deg = |attitude: Attitude| {
        let q = Rotation::between(attitude, motion.at(10.0).attitude).quaternion();
        (2.0 * q.imag().norm()).to_degrees()
    };
    let (one, two) = (off_deg(attitude), off_deg(two_sample));
    println!("drift over 10 s: one sample {one:.4}°, two samples {two:.6}°");
    assert!((1.0..1.25).contains(&one) && two < 0.01);
}

#[test]
fn the_force_of_a_flight_is_what_its_velocity_needs() {
    for name in ["cruise", "cruise-hard"] {
        let mut scenario = Scenario::named(name).unwrap();
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
            let force = now.truth.attitude.matrix().transpose() * now.truth.force_m_s2 - Vector3::z() * GRAVITY_M_S2;
            assert!((acceleration_m_s2 - force).norm() < 1e-3, "{name}: {acceleration_m_s2} of {force}");
        }
    }
}

#[test]
fn turns_of_a_flight_are_coordinated_and_frequent() {
    let motion = Motion::named("cruise").unwrap();
    let banked = (0..1800).filter(|t_s| motion.at(f64::from(*t_s)).attitude.angles().roll_rad.abs() > 0.1).count();
    assert!((200..900).contains(&banked), "{banked} s of turns in 1800 s");
    for t_s in every("cruise") {
        let force_m_s2 = motion.at(t_s).force_m_s2;
        assert!(libm::atan2(force_m_s2.x, force_m_s2.z).abs() < 0.02, "no force to the side at {t_s} s");
    }
}

#[test]
fn the_same_seed_gives_the_same_bits_and_another_seed_another_flight() {
    let bits = |seed: u64| {
        let scenario = Scenario::named("cruise-hard?duration_s=300").unwrap().with_seed(seed);
        let numbers = scenario.readings().flat_map(|(_, reading)| {
            let fix = reading.fix.map_or(Vector3::zeros(), |fix| fix.velocity_m_s);
            [reading.rate_rad_s, reading.force_m_s2, fix].map(|v| v.map(f64::to_bits))
        });
        numbers.flat_map(|v| [v.x, v.y, v.z]).fold(0u64, |sum, bits| (sum ^ bits).wrapping_mul(0x100_0000_01b3))
    };
    assert_eq!(bits(3), bits(3));
    assert_ne!(bits(3), bits(4));
    assert_eq!(bits(1), 11_033_558_824_228_236_432, "as on every other machine");
}

#[test]
fn the_fixes_keep_their_schedule_and_come_late() {
    for (query, fixes) in [("always", 17_999), ("gaps", 17_999 - 7 * 600), ("start", 5_998), ("never", 0)] {
        let scenario = Scenario::named(&format!("cruise?gnss={query}")).unwrap();
        let count = scenario.readings().filter(|(_, reading)| reading.fix.is_some()).count();
        assert_eq!(count, fixes, "{query}");
    }
    assert!(!Coverage::Gaps.covers(300.0) && Coverage::Gaps.covers(360.0) && !Coverage::Gaps.covers(540.0));
    let first_s = Scenario::named("cruise").unwrap().readings().find(|(_, reading)| reading.fix.is_some()).unwrap().0;
    assert_eq!(first_s, 0.2);
}

#[test]
fn errors_have_the_size_they_say() {
    let scenario = Scenario::named("s3").unwrap();
    let reference_ut = Vector3::from(scenario::s3::FIELD_UT);
    let (mut rate2, mut force2, mut field2, mut count) = (0.0, 0.0, 0.0, 0.0);
    for (_, reading) in scenario.readings().skip(1) {
        let matrix = reading.truth.attitude.matrix();
        force2 += (reading.force_m_s2 - reading.truth.force_m_s2).norm_squared() / 3.0;
        field2 += (reading.field_ut.unwrap() - matrix * reference_ut).norm_squared() / 3.0;
        // Not at the two samples in which the axis of the turn changes.
        rate2 += (reading.rate_rad_s - reading.truth.rate_rad_s).norm_squared().min(0.01) / 3.0;
        count += 1.0;
    }
    let rms = |sum: f64| libm::sqrt(sum / count);
    assert!((rms(rate2).to_degrees() - 1.0).abs() < 0.05);
    assert!((rms(force2) / GRAVITY_M_S2 - 0.03).abs() < 0.0015);
    assert!((rms(field2) / reference_ut.norm() - 0.03).abs() < 0.0015);
}

#[test]
fn readings_of_the_reference_scenario_are_those_of_its_own_sensors() {
    let scenario = Scenario::named("s1?seed=5&rate_hz=200&duration_s=2").unwrap();
    let mut sensors = Sensors::new(Motion::S1, Errors::S1, 5);
    let readings: Vec<_> = scenario.readings().collect();
    assert_eq!(readings.len(), 401);
    for (t_s, reading) in readings {
        assert_eq!(reading, sensors.read(t_s));
    }
}

#[test]
fn what_does_not_exist_is_refused_with_what_does() {
    for (text, said) in [
        ("cruse", "there is no scenario `cruse`; there are s1, tumble, s3, coning, cruise, cruise-hard"),
        (
            "cruise?sed=3",
            "a scenario has no `sed`; seed, rate_hz, duration_s, gnss, gyro_bias_deg_s, gyro_noise_deg_s, gyro_scale, accel_bias_g, accel_noise_g, \
             field_noise_ut, gnss_noise_m_s, gnss_latency_s, antenna_right_m, antenna_forward_m, antenna_up_m, amplitude_deg can be set, as in `cruise?seed=3&gnss=gaps`",
        ),
        ("cruise?seed=-1", "a scenario's seed: expected a natural number, found `-1`"),
        ("cruise?rate_hz=NaN", "a scenario's rate_hz: expected a number from 1 to 10000, found `NaN`"),
        ("cruise?gnss=often", "a scenario's gnss: expected one of always, gaps, start, never, found `often`"),
        ("s1?gnss=gaps", "the scenario `s1` has no satellite receiver; leave out `gnss`"),
        ("s1?field_noise_ut=1", "the scenario `s1` has no magnetometer; leave out `field_noise_ut`"),
        ("cruise?amplitude_deg=9", "the scenario `cruise` has no amplitude; leave out `amplitude_deg`"),
        ("s1?amplitude_deg=90", "a scenario's amplitude_deg: expected a number from 0 to 89, found `90`"),
    ] {
        assert_eq!(Scenario::named(text).unwrap_err().to_string(), said);
    }
}

#[test]
fn numbers_of_a_scenario_change_what_they_say_and_nothing_else() {
    let usual = |name: &str| Scenario::named(name).unwrap();
    for (text, changed) in [
        (
            "s1?gyro_bias_deg_s=2&rate_hz=200",
            Scenario {
                rate_hz: 200.0,
                errors: Errors { gyro_bias_rad_s: 2f64.to_radians(), ..Errors::S1 },
                ..usual("s1")
            },
        ),
        (
            "tumble?accel_noise_g=0.5",
            Scenario { errors: Errors { accel_noise_m_s2: 0.5 * GRAVITY_M_S2, ..Errors::S1 }, ..usual("tumble") },
        ),
        // The noise that is set is that at the scenario's rate, whatever stands first.
        ("cruise?gyro_noise_deg_s=1&rate_hz=400&accel_noise_g=0.1", {
            let cruise = usual("cruise?rate_hz=400");
            let errors =
                Errors { gyro_noise_rad_s: 1f64.to_radians(), accel_noise_m_s2: 0.1 * GRAVITY_M_S2, ..cruise.errors };
            Scenario { errors, ..cruise }
        }),
    ] {
        assert_eq!(usual(text), changed, "{text}");
    }
    let swing = |text: &str| {
        let angles = usual(text).motion.at(5.0).attitude.angles();
        let pitch_rad = usual(text).motion.at(0.0).attitude.angles().pitch_rad;
        [angles.roll_rad, pitch_rad].map(f64::to_degrees)
    };
    for (text, [roll_deg, pitch_deg]) in [("s1", [30.0, 25.0]), ("s1?amplitude_deg=60", [60.0, 50.0])] {
        let [roll, pitch] = swing(text);
        assert!((roll - roll_deg).abs() < 1e-9 && (pitch - pitch_deg).abs() < 1e-9, "{text}: {roll} {pitch}");
    }
    let latency_s = |text: &str| usual(text).readings().find(|(_, reading)| reading.fix.is_some()).unwrap().0;
    assert_eq!((latency_s("cruise"), latency_s("cruise?gnss_latency_s=0.5")), (0.2, 0.5));
    let velocities = |text: &str| usual(text).readings().filter_map(|(_, reading)| reading.fix);
    let apart = |text: &str| {
        let pairs = velocities("cruise?duration_s=20").zip(velocities(text));
        let most = |most: f64, (one, other): (Fix, Fix)| most.max((one.velocity_m_s - other.velocity_m_s).norm());
        pairs.fold(0.0, most)
    };
    // 10 m above the sensors a roll of 1° at 1/7.3 Hz is 0.15 m/s, the pitch 0.21 m/s at most.
    assert!((0.15..0.26).contains(&apart("cruise?antenna_up_m=10&duration_s=20")));
    assert_eq!(apart("cruise?antenna_up_m=0&duration_s=20"), 0.0);
}
