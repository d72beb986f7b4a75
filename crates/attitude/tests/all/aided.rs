//! Tests of the fuser `aided`, except those of its accuracy: invalid input, snapshots, a day of
//! flight, operation without a receiver, parameters.
use attitude::{
    GRAVITY_M_S2, Vector3,
    accel::Accelerometer,
    course::CourseReference,
    fuser::{Fused, Fuser, FuserInput, FuserStage},
    gnss::Fix,
    gyro::{Gyro, Motion, RateKind, RateSample},
    parameters::ParameterError,
    rotation::Rotation,
    stage::{RestoreError, Stage},
    state::{Attitude, wrapped_rad},
};
use proptest::prelude::*;
use scenario::{Magnetometer, Reading, Scenario};

fn aided(settings: &[(&str, f64)]) -> Fuser {
    let mut fuser = Fuser::from_name("aided").unwrap();
    settings.iter().for_each(|(name, value)| fuser.set(name, *value).unwrap());
    fuser
}

/// Gyro and accelerometer stages that precede the fuser.
#[derive(Clone)]
struct FrontEnd {
    gyro: Gyro,
    accel: Accelerometer,
    kind: RateKind,
    previous_s: Option<f64>,
}

impl FrontEnd {
    fn new(kind: RateKind) -> Self {
        let (gyro, accel) = (Gyro::from_name("mobius").unwrap(), Accelerometer::default());
        Self { gyro, accel, kind, previous_s: None }
    }

    fn input(&mut self, t_s: f64, reading: &Reading) -> FuserInput {
        let dt_s = self.previous_s.map_or(0.0, |previous_s| t_s - previous_s);
        self.previous_s = Some(t_s);
        FuserInput {
            motion: Some(self.gyro.step(&RateSample { rate_rad_s: reading.rate_rad_s, dt_s, kind: self.kind })),
            inclination: Some(self.accel.step(&reading.force_m_s2)),
            field_ut: reading.field_ut,
            fix: reading.fix,
            rest_credible: true,
            rate_credible: true,
        }
    }
}

/// Runs `fuser` over a scenario and passes time, output and true attitude to `observe`.
fn fly(scenario: &Scenario, fuser: &mut Fuser, mut observe: impl FnMut(f64, &Fused, Attitude)) {
    let mut front = FrontEnd::new(scenario.rate_kind);
    for (t_s, reading) in scenario.readings() {
        let out = fuser.step(&front.input(t_s, &reading));
        observe(t_s, &out, reading.truth.attitude);
    }
}

fn inclination_deg(a: Attitude, b: Attitude) -> f64 {
    libm::asin(a.up.direction().cross(&b.up.direction()).norm().min(1.0)).to_degrees()
}

/// Returns the RMS of the inclination error from `from_s` onwards, in degrees.
fn inclination_rms_deg(scenario: &Scenario, fuser: &mut Fuser, from_s: f64) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    fly(scenario, fuser, |t_s, out, truth| {
        if t_s >= from_s {
            sum += inclination_deg(out.attitude, truth).powi(2);
            count += 1.0;
        }
    });
    libm::sqrt(sum / count)
}

#[test]
fn aided_without_receiver_levels_by_gravity() {
    let scenario = Scenario::parse("s1?duration_s=300").unwrap();
    let mut fuser = aided(&[]);
    let error_deg = inclination_rms_deg(&scenario, &mut fuser, 60.0);
    println!("s1 without a receiver: {error_deg:.3}°");
    // The limit is wide, because `aided` cannot detect that the body stays in place and allows for
    // a velocity of 50 m/s along and 4 m/s across the course.
    assert!(error_deg < 4.0);
    assert_eq!(fuser.common().reference, CourseReference::Arbitrary);
    assert!(fuser.validation_error().is_none());
}

#[test]
fn aided_at_rest_without_receiver_finds_gyro_bias() {
    let mut fuser = aided(&[]);
    let mut front = FrontEnd::new(RateKind::Mean);
    let bias_rad_s = Vector3::new(0.3, -0.2, 0.1).map(f64::to_radians);
    let truth = Scenario::parse("s1").unwrap().motion.at(0.0);
    let reading = Reading { rate_rad_s: bias_rad_s, force_m_s2: truth.force_m_s2, field_ut: None, fix: None, truth };
    let mut rested = false;
    for tick in 0..60_000u32 {
        let out = fuser.step(&front.input(f64::from(tick) / 100.0, &reading));
        rested |= out.corrections.rest;
        assert!(tick < 3_000 || inclination_deg(out.attitude, truth.attitude) < 0.05);
    }
    assert!(rested && (fuser.common().bias_rad_s - bias_rad_s).norm().to_degrees() < 0.01);
}

#[test]
#[ignore = "long: two days of flight"]
fn error_does_not_grow_over_a_day_of_flight() {
    for (query, limit_deg) in [("gnss=gaps", 0.1), ("gnss=never", 0.8)] {
        let scenario = Scenario::parse(&format!("cruise?rate_hz=20&duration_s=86400&{query}")).unwrap();
        let mut fuser = aided(&[]);
        let mut hours = [(0.0, 0.0); 25];
        let mut validation_error = None;
        let mut front = FrontEnd::new(scenario.rate_kind);
        for (t_s, reading) in scenario.readings() {
            let out = fuser.step(&front.input(t_s, &reading));
            if t_s % 3600.0 > 600.0 {
                let hour = &mut hours[(t_s / 3600.0) as usize];
                hour.0 += inclination_deg(out.attitude, reading.truth.attitude).powi(2);
                hour.1 += 1.0;
            }
            if t_s % 60.0 == 0.0 {
                validation_error = validation_error.or(fuser.validation_error());
            }
        }
        let [first, .., last, _] = hours.map(|(sum, count): (f64, f64)| libm::sqrt(sum / count));
        println!("{query}: {first:.3}° in the first hour, {last:.3}° in the last");
        assert!(first < limit_deg && last < limit_deg && last < 2.0 * first, "{query}");
        assert_eq!(validation_error, None);
    }
}

#[test]
fn restored_aided_continues_bit_for_bit_through_gap() {
    let scenario = Scenario::parse("cruise?duration_s=380&gnss=gaps").unwrap();
    let (mut fuser, mut front) = (aided(&[]), FrontEnd::new(scenario.rate_kind));
    let mut restored = None;
    for (t_s, reading) in scenario.readings() {
        let input = front.input(t_s, &reading);
        if t_s == 310.0 {
            let mut other = aided(&[]);
            other.restore(&fuser.snapshot()).unwrap();
            restored = Some(other);
        }
        let out = fuser.step(&input);
        if let Some(restored) = &mut restored {
            assert_eq!(restored.step(&input), out, "at {t_s} s");
        }
    }
    assert_eq!(restored.unwrap(), fuser);
}

#[test]
fn invalid_covariance_is_rejected() {
    let scenario = Scenario::parse("cruise?duration_s=60").unwrap();
    let mut fuser = aided(&[]);
    fly(&scenario, &mut fuser, |_, _, _| ());
    // Finds the covariance in the snapshot by its symmetry: the second value of its first row
    // equals the first value of its second row.
    let record = fuser.snapshot();
    let offset = (0..record.len - 13).find(|i| {
        let (across, down) = (record.values[*i + 1], record.values[*i + 13]);
        across == down && across != 0.0 && record.values[*i] > 0.0 && record.values[*i + 14] > 0.0
    });
    let offset = offset.unwrap();
    let damaged = |change: fn(&mut [f64])| {
        let mut damaged = record;
        change(&mut damaged.values[offset..]);
        damaged.checksum = damaged.compute_checksum();
        fuser.clone().restore(&damaged)
    };
    let invalid = |reason: &'static str| Err(RestoreError::Invalid { reason });
    assert_eq!(damaged(|_| ()), Ok(()));
    assert_eq!(damaged(|p| p[0] = -1.0), invalid("a variance below zero"));
    assert_eq!(damaged(|p| p[1] *= 2.0), invalid("a covariance that is not symmetric"));
    let large = |p: &mut [f64]| {
        p[1] = 2.0 * (p[0] + p[14]);
        p[13] = p[1];
    };
    assert_eq!(damaged(large), invalid("a covariance that is not positive"));
}

#[test]
fn moving_body_has_true_course_within_three_sd() {
    let scenario = Scenario::parse("cruise?duration_s=400").unwrap();
    let mut outside = 0;
    fly(&scenario, &mut aided(&[]), |t_s, out, truth| {
        assert!(t_s < 1.0 || out.reference == CourseReference::True);
        let error_rad = wrapped_rad(out.attitude.angles().yaw_rad - truth.angles().yaw_rad).abs();
        outside += u32::from(t_s > 1.0 && error_rad > 3.0 * out.heading_sd_rad);
    });
    assert!(outside < 4_000, "{outside} of 40,000 headings outside three standard deviations");
}

#[test]
fn known_latitude_compensates_earth_rate() {
    let mut scenario = Scenario::parse("cruise?duration_s=1800&gnss=gaps").unwrap();
    scenario.errors.earth_latitude_rad = Some(1.4);
    let mut error_deg = |latitude_rad: Option<f64>| {
        scenario.errors.receiver.as_mut().unwrap().latitude_rad = latitude_rad;
        inclination_rms_deg(&scenario, &mut aided(&[]), 300.0)
    };
    let (with_latitude, without) = (error_deg(Some(1.4)), error_deg(None));
    println!("earth rate: {with_latitude:.3}° with the latitude, {without:.3}° without");
    assert!(with_latitude < without);
}

#[test]
fn reported_latency_and_accuracy_reduce_error() {
    let mut scenario = Scenario::parse("cruise?duration_s=300").unwrap();
    let receiver = scenario.errors.receiver.as_mut().unwrap();
    (receiver.latency_s, receiver.noise_m_s) = (0.5, 1.0);
    let error_deg = |is_reported: bool| {
        let (mut front, mut fuser) = (FrontEnd::new(scenario.rate_kind), aided(&[]));
        let (mut sum, mut count) = (0.0, 0.0);
        for (t_s, reading) in scenario.readings() {
            let mut input = front.input(t_s, &reading);
            if let (true, Some(fix)) = (is_reported, &mut input.fix) {
                (fix.age_s, fix.sd_m_s) = (Some(0.5), Some(1.0));
            }
            let out = fuser.step(&input);
            if t_s > 120.0 {
                sum += inclination_deg(out.attitude, reading.truth.attitude).powi(2);
                count += 1.0;
            }
        }
        libm::sqrt(sum / count)
    };
    let (reported, unreported) = (error_deg(true), error_deg(false));
    println!("0.5 s late, 1 m/s: {reported:.3}° if reported, {unreported:.3}° if not");
    assert!(reported < 0.8 * unreported);
}

#[test]
fn field_gives_heading_only_if_magnetic_is_set() {
    let mut scenario = Scenario::parse("cruise?duration_s=300&gnss=never").unwrap();
    scenario.errors.magnetometer = Some(Magnetometer { reference_ut: Vector3::new(0.0, 20.0, -44.0), noise_ut: 0.5 });
    let heading_deg = |settings: &[(&str, f64)]| {
        let (mut worst_deg, mut reference) = (0.0f64, CourseReference::Arbitrary);
        fly(&scenario, &mut aided(settings), |t_s, out, truth| {
            let error_rad = wrapped_rad(out.attitude.angles().yaw_rad - truth.angles().yaw_rad).abs();
            worst_deg = if t_s > 120.0 { worst_deg.max(error_rad.to_degrees()) } else { 0.0 };
            reference = out.reference;
        });
        (worst_deg, reference)
    };
    let (off, on) = (heading_deg(&[]), heading_deg(&[("magnetic", 1.0)]));
    println!("largest heading error: {:.2}° with the field, {:.1}° without", on.0, off.0);
    assert!(off.1 == CourseReference::Arbitrary && on.1 == CourseReference::Magnetic && on.0 < 10.0);
    let declined = heading_deg(&[("magnetic", 1.0), ("declination_deg", 11.0)]);
    assert!(declined.1 == CourseReference::True && (declined.0 - 11.0).abs() < on.0 + 3.0);
}

#[test]
fn disturbed_field_does_not_affect_heading_in_flight() {
    let mut scenario = Scenario::parse("cruise?duration_s=600").unwrap();
    // A magnet on board. Its field is half as strong as the earth's and rotates with the body.
    let mut worst_deg = 0.0f64;
    scenario.errors.magnetometer = Some(Magnetometer { reference_ut: Vector3::new(0.0, 20.0, -44.0), noise_ut: 0.5 });
    let (mut front, mut fuser) = (FrontEnd::new(scenario.rate_kind), aided(&[]));
    for (t_s, mut reading) in scenario.readings() {
        reading.field_ut = reading.field_ut.map(|field_ut| field_ut + Vector3::new(25.0, 0.0, 0.0));
        let out = fuser.step(&front.input(t_s, &reading));
        let error_rad = wrapped_rad(out.attitude.angles().yaw_rad - reading.truth.attitude.angles().yaw_rad).abs();
        worst_deg = if t_s > 300.0 { worst_deg.max(error_rad.to_degrees()) } else { 0.0 };
    }
    assert!(worst_deg < 1.0, "{worst_deg}°");
}

#[test]
fn adopted_estimate_keeps_level() {
    let scenario = Scenario::parse("cruise?duration_s=200").unwrap();
    let (mut front, mut previous, mut next) = (FrontEnd::new(scenario.rate_kind), aided(&[]), aided(&[]));
    for (t_s, reading) in scenario.readings() {
        let input = front.input(t_s, &reading);
        let out = previous.step(&input);
        if t_s == 100.0 {
            next.adopt(&previous.common()).unwrap();
            assert_eq!(next.common().attitude, out.attitude);
        } else if t_s > 100.0 {
            let error_deg = inclination_deg(next.step(&input).attitude, reading.truth.attitude);
            assert!(error_deg < 0.6, "{error_deg}° at {t_s} s");
        }
    }
}

#[test]
fn realign_keeps_heading_and_bias() {
    let scenario = Scenario::parse("cruise?duration_s=100").unwrap();
    let mut fuser = aided(&[]);
    fly(&scenario, &mut fuser, |_, _, _| ());
    let before = fuser.common();
    fuser.realign();
    let inclination = Accelerometer::default().step(&Vector3::new(0.0, 0.0, GRAVITY_M_S2));
    let out = fuser.step(&FuserInput { inclination: Some(inclination), ..FuserInput::default() });
    assert!(out.corrections.aligned && out.attitude.up.w.norm_sqr() < 1e-20);
    assert_eq!(fuser.common().bias_rad_s, before.bias_rad_s);
    let yaw_rad = |attitude: Attitude| attitude.angles().yaw_rad;
    assert!(wrapped_rad(yaw_rad(out.attitude) - yaw_rad(before.attitude)).abs() < 0.02);
}

#[test]
fn parameters_outside_their_ranges_are_rejected() {
    let mut fuser = aided(&[("smoothing_s", 1.0)]);
    assert!(matches!(fuser.set("latency_s", 0.7), Err(ParameterError::OutOfRange { .. })));
    assert!(matches!(fuser.set("latency", 0.1), Err(ParameterError::Unknown { .. })));
}

fn extreme() -> impl Strategy<Value = f64> {
    prop_oneof![
        -20.0..20.0f64,
        Just(0.0),
        Just(1e300),
        Just(-1e300),
        Just(1e-300),
        Just(f64::MAX),
        -1e6..1e6f64,
        any::<f64>().prop_filter("finite", |x| x.is_finite()),
    ]
}

fn vector() -> impl Strategy<Value = Vector3<f64>> {
    (extreme(), extreme(), extreme()).prop_map(|(x, y, z)| Vector3::new(x, y, z))
}

prop_compose! {
    fn tick()(
        rate in prop::option::weighted(0.9, vector()),
        dt_s in prop_oneof![Just(0.0), Just(0.01), 0.0..1.0f64],
        force in prop::option::weighted(0.9, vector()),
        field_ut in prop::option::of(vector()),
        fix in prop::option::of((vector(), prop::option::of(extreme()), prop::option::of(extreme()), prop::option::of(extreme()))),
        rest_credible: bool,
    ) -> FuserInput {
        let motion = rate.map(|rate_rad_s| {
            let rotation_vector = (rate_rad_s * dt_s).map(|x| x.clamp(-1e3, 1e3));
            Motion { attitude: Attitude::default(), rotation: Rotation::from_rotation_vector(rotation_vector), rate_rad_s, dt_s }
        });
        let inclination = force.map(|force| Accelerometer::default().step(&force));
        let fix = fix.map(|(velocity_m_s, sd_m_s, age_s, latitude_rad)| Fix { velocity_m_s, sd_m_s, age_s, latitude_rad });
        FuserInput { motion, inclination, field_ut, fix, rest_credible, rate_credible: true }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn state_stays_valid_for_any_input(ticks in prop::collection::vec(tick(), 1..400), magnetic: bool) {
        let mut fuser = aided(&[("magnetic", f64::from(u8::from(magnetic)))]);
        for input in &ticks {
            let out = fuser.step(input);
            let q = out.attitude.quaternion();
            prop_assert!((q.norm() - 1.0).abs() < 1e-9, "{q:?}");
            let numbers = [out.inclination_sd_rad, out.heading_sd_rad, out.innovation_rad, out.bias_rad_s.amax()];
            prop_assert!(numbers.iter().all(|x| x.is_finite()), "{out:?}");
            prop_assert_eq!(fuser.validation_error(), None);
        }
        let record = fuser.snapshot();
        prop_assert!(record.values.iter().all(|x| x.is_finite()));
        prop_assert_eq!(aided(&[]).restore(&record), Ok(()));
    }
}
