//! Levelling stages and the course stage `track` on a simulated aircraft in cruise: with satellite
//! velocity, in gaps and without a receiver.
//!
//! `cargo test --release -p plumbline-attitude levelling:: -- --include-ignored --nocapture` prints
//! every figure.
use crate::common::ResultCache;
use attitude::{
    Vector3,
    accel::Accelerometer,
    course::{Course, CourseInput, CourseReading, CourseReference},
    fuser::{Estimate, Fused, Fuser, FuserInput, FuserStage},
    gnss::Fix,
    gyro::{self, Gyro, RateKind, RateSample},
    rotation::Rotation,
    stage::Stage,
    state::{Attitude, wrapped_rad},
};
use proptest::prelude::*;
use scenario::{Motion, Scenario, SensorErrors};

#[derive(Clone)]
struct Chain {
    gyro: Gyro,
    accel: Accelerometer,
    fuser: Fuser,
    course: Course,
}

impl Chain {
    fn new(fuser: &str, course: &str) -> Self {
        Self {
            gyro: Gyro::from_name("mobius").unwrap(),
            accel: Accelerometer::default(),
            fuser: Fuser::from_name(fuser).unwrap(),
            course: Course::from_name(course).unwrap(),
        }
    }

    fn step(&mut self, sample: &RateSample, reading: &scenario::Reading) -> (Fused, CourseReading) {
        let fused = self.fuser.step(&FuserInput {
            motion: Some(self.gyro.step(sample)),
            inclination: Some(self.accel.step(&reading.force_m_s2)),
            field_ut: None,
            fix: reading.fix,
            rest_credible: true,
            rate_credible: true,
        });
        let course = self.course.step(&CourseInput {
            attitude: fused.attitude,
            reference: fused.reference,
            heading_sd_rad: fused.heading_sd_rad,
            fix: reading.fix,
            dt_s: sample.dt_s,
        });
        (fused, course)
    }
}

/// Root mean square and maximum of errors, degrees.
#[derive(Default, Clone, Copy)]
struct Rms {
    sum: f64,
    count: f64,
    max: f64,
}

impl Rms {
    fn add(&mut self, error_rad: f64) {
        let error_deg = error_rad.to_degrees();
        self.sum += error_deg * error_deg;
        self.count += 1.0;
        self.max = self.max.max(error_deg.abs());
    }

    fn value(&self) -> f64 {
        (self.sum / self.count.max(1.0)).sqrt()
    }
}

/// Errors of a flight. `aided` and `unaided` are the errors of roll and pitch with and without
/// fixes.
#[derive(Default, Clone, Copy)]
struct FlightErrors {
    aided: [Rms; 2],
    unaided: [Rms; 2],
    /// Error of the stage `track` while its course refers to true north.
    course: Rms,
    heading: Rms,
    /// Change of the roll or pitch error between samples.
    step: Rms,
}

impl FlightErrors {
    /// Runs several chains on one flight.
    fn fly<const N: usize>(all: &mut [Self; N], mut chains: [Chain; N], scenario: &Scenario) {
        let (mut since_fix_s, mut previous_s, mut previous) = (1e9, 0.0, [[0.0; 2]; N]);
        for (t_s, reading) in scenario.readings() {
            let dt_s = t_s - previous_s;
            previous_s = t_s;
            since_fix_s = if reading.fix.is_some() { 0.0 } else { since_fix_s + dt_s };
            let sample = RateSample { rate_rad_s: reading.rate_rad_s, dt_s, kind: scenario.rate_kind };
            let truth = reading.truth.attitude.angles();
            for ((flight, chain), previous) in all.iter_mut().zip(&mut chains).zip(&mut previous) {
                let (fused, course) = chain.step(&sample, &reading);
                let got = fused.attitude.angles();
                let errors = [wrapped_rad(got.roll_rad - truth.roll_rad), got.pitch_rad - truth.pitch_rad];
                if t_s >= scenario.scored_from_s {
                    let level = if since_fix_s > 1.5 { &mut flight.unaided } else { &mut flight.aided };
                    for (i, error_rad) in errors.into_iter().enumerate() {
                        level[i].add(error_rad);
                        flight.step.add(error_rad - previous[i]);
                    }
                    if course.reference == CourseReference::True {
                        flight.course.add(wrapped_rad(course.course_rad + truth.yaw_rad));
                    }
                    flight.heading.add(wrapped_rad(got.yaw_rad - truth.yaw_rad));
                }
                *previous = errors;
            }
        }
    }
}

fn flight_errors(fuser: &str, text: &str, seeds: core::ops::RangeInclusive<u64>) -> FlightErrors {
    static ERRORS: ResultCache<FlightErrors> = ResultCache::new();
    ERRORS.get_or_compute(&format!("{fuser} {text} {seeds:?}"), || fly_seeds(fuser, text, seeds))
}

fn fly_seeds(fuser: &str, text: &str, seeds: core::ops::RangeInclusive<u64>) -> FlightErrors {
    let mut all = FlightErrors::default();
    for seed in seeds {
        let scenario = Scenario::parse(text).unwrap().with_seed(seed);
        FlightErrors::fly(std::array::from_mut(&mut all), [Chain::new(fuser, "track")], &scenario);
    }
    let show = |errors: [Rms; 2]| {
        format!("{:.3} / {:.3} (max {:.2})", errors[0].value(), errors[1].value(), errors[0].max.max(errors[1].max))
    };
    println!(
        "{fuser:12} {text:24} roll / pitch: aided {}, unaided {}; course {:.2}, fuser's heading {:.2}; step {:.4}",
        show(all.aided),
        show(all.unaided),
        all.course.value(),
        all.heading.value(),
        all.step.max
    );
    all
}

fn worse_axis(errors: [Rms; 2]) -> f64 {
    errors[0].value().max(errors[1].value())
}

#[test]
fn levelling_is_within_0_5_degrees_aided_2_5_in_gaps() {
    let aided = flight_errors("levelling", "cruise?gnss=always", 1..=8);
    assert!(worse_axis(aided.aided) < 0.5);
    // The error is time constant × gyro bias = 50 s × 0.05 °/s, with the time constant of `track`.
    assert!((2.0..3.0).contains(&aided.course.value()), "{}", aided.course.value());
    let gaps = flight_errors("levelling", "cruise?gnss=gaps", 1..=8);
    assert!(worse_axis(gaps.unaided) < 2.5);
    assert!(gaps.step.max < 0.2, "a jump of {}°", gaps.step.max);
}

#[test]
fn levelling_without_receiver_keeps_bias_error() {
    let never = flight_errors("levelling", "cruise?gnss=never", 1..=4);
    assert!((1.5..6.0).contains(&worse_axis(never.unaided)));
    assert_eq!(never.course.count, 0.0, "the course must not refer to true north");
}

#[test]
fn unified_levelling_matches_levelling_unless_in_gaps() {
    let aided = flight_errors("levelling-unified", "cruise?gnss=always", 1..=8);
    assert!(worse_axis(aided.aided) < 0.5);
    // The error is time constant × gyro bias = 50 s × 0.05 °/s, with the time constant of the
    // course.
    assert!((2.0..3.0).contains(&aided.heading.value()), "{}", aided.heading.value());
    let gaps = flight_errors("levelling-unified", "cruise?gnss=gaps", 1..=8);
    let printed = flight_errors("levelling", "cruise?gnss=gaps", 1..=8);
    assert!(worse_axis(gaps.unaided) > worse_axis(printed.unaided) && worse_axis(gaps.unaided) < 5.0);
    let never = flight_errors("levelling-unified", "cruise?gnss=never", 1..=4);
    let unaided = flight_errors("levelling", "cruise?gnss=never", 1..=4);
    assert_eq!(worse_axis(never.unaided), worse_axis(unaided.unaided), "unaided, P2 must equal the printed law");
}

#[test]
fn unified_levelling_announces_jump_between_platforms() {
    let scenario = Scenario::parse("cruise?gnss=gaps&duration_s=700").unwrap();
    let mut chain = Chain::new("levelling-unified", "angles");
    let (mut announced, mut previous) = (Vec::new(), None::<[f64; 3]>);
    for (t_s, reading) in scenario.readings() {
        let dt_s = if t_s > 0.0 { 0.01 } else { 0.0 };
        let sample = RateSample { rate_rad_s: reading.rate_rad_s, dt_s, kind: scenario.rate_kind };
        let fused = chain.step(&sample, &reading).0;
        let (got, truth) = (fused.attitude.angles(), reading.truth.attitude.angles());
        let errors = [got.roll_rad - truth.roll_rad, got.pitch_rad - truth.pitch_rad, got.yaw_rad - truth.yaw_rad];
        let errors = errors.map(|error_rad| wrapped_rad(error_rad).to_degrees());
        let step = previous.map_or([0.0; 3], |previous| [0, 1, 2].map(|i| (errors[i] - previous[i]).abs()));
        if fused.corrections.aligned {
            announced.push((t_s, step));
        } else {
            assert!(step[0].max(step[1]) < 0.2, "{t_s} s: unannounced step of {step:?}°");
        }
        previous = Some(errors);
    }
    println!("{announced:.2?}");
    // The first jump sets the level at the first sample. The second jump sets the course at the
    // first fix. The other jumps are at the start and the end of the gaps at 300 s and 540 s.
    let [_, _, edges @ ..] = &announced[..] else { panic!("{announced:?}") };
    let near = |t_s: f64| edges.iter().any(|edge| (edge.0 - t_s).abs() < 2.0);
    assert!(edges.len() == 4 && [301.5, 360.0, 541.5, 600.0].into_iter().all(near), "{announced:?}");
    // Only roll and pitch jump. The course does not.
    assert!(edges.iter().all(|(_, [roll, pitch, yaw])| roll.max(*pitch) > 0.03 && *yaw < 0.2), "{announced:?}");
}

#[test]
fn levelling_pi_is_within_0_25_degrees_aided_0_3_in_gaps() {
    let aided = flight_errors("levelling-pi", "cruise?gnss=always", 1..=8);
    assert!(worse_axis(aided.aided) < 0.25);
    assert!(aided.course.value() < 1.0 && aided.heading.value() < 2.0);
    let gaps = flight_errors("levelling-pi", "cruise?gnss=gaps", 1..=8);
    assert!(worse_axis(gaps.aided) < 0.25 && worse_axis(gaps.unaided) < 0.3);
    assert!(gaps.step.max < 0.05, "a jump of {}°", gaps.step.max);
}

#[test]
fn levelling_pi_20_min_unaided_is_within_0_6_degrees() {
    let start = flight_errors("levelling-pi", "cruise?gnss=start", 1..=4);
    assert!(worse_axis(start.unaided) < 0.6);
}

#[test]
fn levelling_pi_in_wind_and_side_slip_is_within_limits() {
    let hard = flight_errors("levelling-pi", "cruise-hard?gnss=gaps", 1..=8);
    assert!(worse_axis(hard.aided) < 0.5 && worse_axis(hard.unaided) < 0.8);
    assert!(hard.heading.value() < 6.0);
}

#[test]
fn levelling_pi_cold_without_receiver_matches_levelling() {
    let (pi, printed) = (
        flight_errors("levelling-pi", "cruise?gnss=never", 1..=4),
        flight_errors("levelling", "cruise?gnss=never", 1..=4),
    );
    assert!(worse_axis(pi.unaided) <= worse_axis(printed.unaided) * 1.05);
}

/// Flies for a day at 10 Hz and scores the last two hours.
#[test]
#[ignore = "long: three days of flight"]
fn levelling_error_does_not_grow_over_a_day() {
    let fusers = ["levelling", "levelling-unified", "levelling-pi"];
    for (gnss, max_deg) in [("always", [0.6, 0.6, 0.25]), ("never", [7.0; 3]), ("start", [7.0, 7.0, 1.0])] {
        let text = format!("cruise?gnss={gnss}&duration_s=86400&rate_hz=10");
        let scenario = Scenario { scored_from_s: 79_200.0, ..Scenario::parse(&text).unwrap() };
        let mut days = [FlightErrors::default(); 3];
        FlightErrors::fly(&mut days, fusers.map(|fuser| Chain::new(fuser, "track")), &scenario);
        for ((fuser, day), max_deg) in fusers.into_iter().zip(days).zip(max_deg) {
            let [aided, unaided] = [day.aided, day.unaided].map(worse_axis);
            println!(
                "{fuser}, {gnss}: after 22 hours {aided:.3}° aided, {unaided:.3}° unaided, worse of roll and pitch"
            );
            assert!(aided.max(unaided) < max_deg, "{fuser}, {gnss}: {aided}° aided, {unaided}° unaided");
        }
    }
}

/// Returns the last output of a vehicle parked for `seconds`.
///
/// If `has_receiver`, every tenth tick has a fix with a velocity of nearly zero.
fn parked(chain: &mut Chain, errors: &SensorErrors, seconds: f64, has_receiver: bool) -> Fused {
    let mut sensors = scenario::Sensors::new(Motion::Tumble(Vector3::zeros()), *errors, 1);
    let mut last = None;
    for tick in 0..(seconds * 100.0) as u32 {
        let mut reading = sensors.read(f64::from(tick) / 100.0);
        let noise_m_s = 0.05 * f64::from(tick).sin();
        let fix = Fix { velocity_m_s: Vector3::repeat(noise_m_s), sd_m_s: None, age_s: None, latitude_rad: None };
        reading.fix = (has_receiver && tick % 10 == 0).then_some(fix);
        let sample = RateSample { rate_rad_s: reading.rate_rad_s, dt_s: 0.01, kind: RateKind::Instant };
        last = Some(chain.step(&sample, &reading).0);
    }
    last.unwrap()
}

#[test]
fn levelling_pi_at_rest_finds_gyro_bias_within_30_s() {
    let errors = SensorErrors { receiver: None, random_signs: false, ..SensorErrors::CRUISE };
    for has_receiver in [false, true] {
        let mut chain = Chain::new("levelling-pi", "track");
        let fused = parked(&mut chain, &errors, 30.0, has_receiver);
        let error_deg_s = fused.bias_rad_s.add_scalar(-errors.gyro_bias_rad_s).amax().to_degrees();
        println!("receiver {has_receiver}: bias error {error_deg_s:.4} °/s");
        assert!(fused.corrections.rest && error_deg_s < 0.01);
        assert_eq!(fused.reference, CourseReference::Arbitrary);
        // Because the bias is now known, a flight without a receiver is no longer a cold start.
        let Estimate { bias_sd_rad_s, .. } = chain.fuser.common();
        assert!(bias_sd_rad_s.to_degrees() < 0.02);
    }
}

#[test]
fn cruise_is_not_detected_as_rest() {
    for text in ["cruise?gnss=never", "cruise?gnss=always", "cruise-hard?gnss=never"] {
        let scenario = Scenario::parse(text).unwrap();
        let mut chain = Chain::new("levelling-pi", "track");
        for (t_s, reading) in scenario.readings() {
            let dt_s = if t_s > 0.0 { 0.01 } else { 0.0 };
            let sample = RateSample { rate_rad_s: reading.rate_rad_s, dt_s, kind: scenario.rate_kind };
            assert!(!chain.step(&sample, &reading).0.corrections.rest, "{text}, {t_s} s");
        }
    }
}

#[test]
fn first_track_sets_heading_and_is_announced() {
    let scenario = Scenario::parse("cruise?duration_s=20").unwrap();
    let mut chain = Chain::new("levelling-pi", "angles");
    let mut aligned = Vec::new();
    for (t_s, reading) in scenario.readings() {
        let sample = RateSample { rate_rad_s: reading.rate_rad_s, dt_s: 0.01, kind: scenario.rate_kind };
        let (fused, course) = chain.step(&sample, &reading);
        let is_true = fused.reference == CourseReference::True;
        assert_eq!(fused.heading_sd_rad < 0.5, is_true);
        if fused.corrections.aligned {
            aligned.push((t_s, is_true, course.aligned));
        }
        let error_rad = wrapped_rad(fused.attitude.angles().yaw_rad - reading.truth.attitude.angles().yaw_rad);
        assert!(!is_true || error_rad.abs() < 0.05);
    }
    // The first sample sets the level, and the second fix sets the course.
    assert!(matches!(aligned[..], [(0.0, false, false), (t_s, true, true)] if (t_s - 0.3).abs() < 1e-9), "{aligned:?}");
}

#[test]
fn restored_levelling_continues_bit_for_bit_in_gap() {
    for fuser in ["levelling", "levelling-unified", "levelling-pi"] {
        let scenario = Scenario::parse("cruise?gnss=gaps&duration_s=400").unwrap();
        let (mut chain, mut other) = (Chain::new(fuser, "track"), Chain::new(fuser, "track"));
        for (t_s, reading) in scenario.readings() {
            let sample = RateSample { rate_rad_s: reading.rate_rad_s, dt_s: 0.01, kind: scenario.rate_kind };
            if [200.0, 320.0, 360.05].contains(&t_s) {
                other = chain.clone();
                other.fuser = Fuser::from_name(fuser).unwrap();
                other.fuser.restore(&chain.fuser.snapshot()).unwrap();
                other.course = Course::from_name("track").unwrap();
                other.course.restore(&chain.course.snapshot()).unwrap();
            }
            let output = chain.step(&sample, &reading);
            if t_s >= 200.0 {
                assert_eq!(output, other.step(&sample, &reading), "{fuser}, {t_s} s");
            }
        }
    }
}

#[test]
fn levelling_pi_continues_adopted_estimate() {
    let scenario = Scenario::parse("cruise?duration_s=600").unwrap();
    let mut chain = Chain::new("levelling-pi", "track");
    let mut late = [Rms::default(); 2];
    for (t_s, reading) in scenario.readings() {
        let sample = RateSample { rate_rad_s: reading.rate_rad_s, dt_s: 0.01, kind: scenario.rate_kind };
        if t_s == 400.0 {
            for name in Fuser::NAMES {
                Fuser::from_name(name).unwrap().adopt(&chain.fuser.common()).unwrap();
            }
            let mut next = Fuser::from_name("levelling-pi").unwrap();
            next.adopt(&chain.fuser.common()).unwrap();
            assert_eq!(next.common().bias_rad_s, chain.fuser.common().bias_rad_s);
            chain.fuser = next;
        }
        let fused = chain.step(&sample, &reading).0;
        if t_s > 400.0 {
            assert!(fused.reference == CourseReference::True && !fused.corrections.aligned);
            let (got, truth) = (fused.attitude.angles(), reading.truth.attitude.angles());
            late[0].add(got.roll_rad - truth.roll_rad);
            late[1].add(got.pitch_rad - truth.pitch_rad);
        }
    }
    assert!(worse_axis(late) < 0.3, "{}", worse_axis(late));
}

#[test]
fn record_with_negative_variance_or_time_is_rejected() {
    for fuser in ["levelling", "levelling-unified", "levelling-pi"] {
        let mut stage = Fuser::from_name(fuser).unwrap();
        let record = stage.snapshot();
        let rejected = (0..record.len)
            .filter(|index| {
                let mut damaged = record;
                damaged.values[*index] = -1e3;
                damaged.checksum = damaged.compute_checksum();
                stage.restore(&damaged).is_err()
            })
            .count();
        // A value of −1000 is rejected only if the number must not be negative or has a bound. Such
        // numbers are the attitude, times, variances and the intervals in the ring buffer.
        let min_rejected = match fuser {
            "levelling" => 7,
            "levelling-unified" => 14,
            _ => 45,
        };
        assert!(rejected >= min_rejected, "{fuser}: {rejected} of {}", record.len);
    }
}

proptest! {
    #[test]
    fn levelling_output_is_finite_for_any_input(
        ticks in prop::collection::vec(
            (any::<[f64; 3]>(), any::<[f64; 3]>(), any::<[f64; 3]>(), 0.0..1.0f64, any::<[bool; 5]>(), any::<Option<f64>>()),
            1..60,
        ),
        tame in any::<bool>(),
    ) {
        let finite = |v: [f64; 3], scale: f64| {
            Vector3::from(v.map(|x| if tame { x.sin() * scale } else { x })).map(|x| if x.is_finite() { x } else { 0.0 })
        };
        for name in ["levelling", "levelling-unified", "levelling-pi"] {
            let mut chain = Chain::new(name, "track");
            for (rate, force, velocity, dt_s, [has_motion, has_force, has_fix, rest_credible, realigns], age_s) in &ticks {
                let age_s = age_s.filter(|age| age.is_finite());
                let velocity_m_s = finite(*velocity, 50.0);
                let fix = Fix { velocity_m_s, sd_m_s: None, age_s, latitude_rad: None };
                let rate_rad_s = finite(*rate, 3.0);
                if *realigns {
                    chain.fuser.realign();
                }
                let rotation = Rotation::from_rotation_vector(rate_rad_s.map(|x| x.clamp(-100.0, 100.0)) * *dt_s);
                let motion = gyro::Motion { attitude: Attitude::default(), rotation, rate_rad_s, dt_s: *dt_s };
                let fused = chain.fuser.step(&FuserInput {
                    motion: has_motion.then_some(motion),
                    inclination: has_force.then(|| chain.accel.step(&finite(*force, 15.0))),
                    field_ut: None,
                    fix: has_fix.then_some(fix),
                    rest_credible: *rest_credible, rate_credible: true,
                });
                prop_assert_eq!(chain.fuser.validation_error(), None);
                chain.fuser.common().attitude.angles();
                let numbers = [fused.inclination_sd_rad, fused.heading_sd_rad, fused.innovation_rad];
                prop_assert!(numbers.iter().chain(&fused.bias_rad_s).all(|x| x.is_finite()));
                let mut restored = chain.fuser.clone();
                prop_assert!(restored.restore(&chain.fuser.snapshot()).is_ok(), "the snapshot must be valid");
            }
        }
    }
}
