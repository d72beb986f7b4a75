//! Course stages: wrap-around, declination, tracks, gaps, references, snapshots.
use std::f64::consts::{PI, TAU};

use attitude::{
    Vector3,
    angles::Angles,
    course::{Course, CourseInput, CourseReading, CourseReference},
    gnss::Fix,
    stage::Stage,
    state::{Attitude, wrapped_rad},
};
use proptest::prelude::*;

const REFERENCES: [CourseReference; 3] = [CourseReference::Arbitrary, CourseReference::Magnetic, CourseReference::True];

/// Returns the input for a level body with this yaw.
fn input(yaw_rad: f64, reference: CourseReference) -> CourseInput {
    let attitude = Attitude::from_angles(Angles { yaw_rad, ..Angles::default() });
    let heading_sd_rad = if reference == CourseReference::Arbitrary { PI } else { 0.02 };
    CourseInput { attitude, reference, heading_sd_rad, fix: None, dt_s: 0.01 }
}

/// Returns a fix with this track, clockwise from north, and this speed.
fn fix(track_rad: f64, speed_m_s: f64) -> Option<Fix> {
    let velocity_m_s = Vector3::new(track_rad.sin(), track_rad.cos(), 0.0) * speed_m_s;
    Some(Fix { velocity_m_s, sd_m_s: None, age_s: Some(0.0), latitude_rad: None })
}

fn course(name: &str, settings: &[(&str, f64)]) -> Course {
    let mut course = Course::from_name(name).unwrap();
    settings.iter().for_each(|(name, value)| course.set(name, *value).unwrap());
    course
}

/// Runs a stage for `seconds` at 100 Hz and returns its readings.
///
/// `yaw` and `track` receive the time (s). `track` is called at every tenth tick and returns a fix,
/// if any.
fn run(
    course: &mut Course,
    seconds: f64,
    reference: CourseReference,
    yaw: impl Fn(f64) -> f64,
    track: impl Fn(f64) -> Option<Fix>,
) -> Vec<CourseReading> {
    (0..(seconds * 100.0) as u32)
        .map(|tick| {
            let t_s = f64::from(tick) / 100.0;
            let fix = if tick % 10 == 0 { track(t_s) } else { None };
            course.step(&CourseInput { fix, ..input(yaw(t_s), reference) })
        })
        .collect()
}

fn error_deg(reading: &CourseReading, course_rad: f64) -> f64 {
    wrapped_rad(reading.course_rad - course_rad).to_degrees()
}

proptest! {
    #[test]
    fn course_is_in_range_and_minus_yaw(yaw_rad in -10.0..10.0f64, declination_deg in -180.0..180.0f64) {
        for name in Course::NAMES {
            for reference in REFERENCES {
                let reading = course(name, &[("declination_deg", declination_deg)]).step(&input(yaw_rad, reference));
                prop_assert!((0.0..TAU).contains(&reading.course_rad));
                let declination_rad = if reference == CourseReference::Magnetic { declination_deg.to_radians() } else { 0.0 };
                prop_assert!(error_deg(&reading, declination_rad - yaw_rad).abs() < 1e-9);
                prop_assert!(wrapped_rad(reading.angles.yaw_rad - yaw_rad).abs() < 1e-9, "the yaw must stay magnetic");
                let is_corrected = reference == CourseReference::Magnetic && declination_deg != 0.0;
                prop_assert_eq!(reading.reference, if is_corrected { CourseReference::True } else { reference });
            }
        }
    }

    #[test]
    fn course_follows_gyro_and_track_around_circle(
        from_rad in -PI..PI, rate_rad_s in -0.5..0.5f64, azimuth_rad in -PI..PI,
    ) {
        let mut stage = course("track", &[]);
        let truth = |t_s: f64| from_rad + rate_rad_s * t_s;
        let readings = run(&mut stage, 30.0, CourseReference::Arbitrary, |t| azimuth_rad - truth(t), |t| fix(truth(t), 20.0));
        for (tick, reading) in readings.iter().enumerate() {
            prop_assert!(error_deg(reading, truth(tick as f64 / 100.0)).abs() < 1e-6);
            prop_assert_eq!((reading.reference, reading.aligned), (CourseReference::True, tick == 0));
        }
    }

    #[test]
    fn course_stays_in_range_for_any_input(
        ticks in prop::collection::vec(
            (any::<[f64; 3]>(), 0..3usize, [-4.0..4.0f64, -4.0..4.0, -4.0..4.0], 0.0..1.0f64, any::<Option<f64>>(), any::<f64>()),
            1..40,
        ),
    ) {
        for name in Course::NAMES {
            let mut stage = course(name, &[]);
            for (velocity, reference, angles, dt_s, age_s, sd) in &ticks {
                let finite = |x: f64| if x.is_finite() { x } else { 0.0 };
                let [yaw_rad, pitch_rad, roll_rad] = *angles;
                let fix = Fix {
                    velocity_m_s: Vector3::from(velocity.map(finite)),
                    sd_m_s: Some(finite(*sd)),
                    age_s: age_s.map(finite),
                    latitude_rad: None,
                };
                let reading = stage.step(&CourseInput {
                    attitude: Attitude::from_angles(Angles { yaw_rad, pitch_rad, roll_rad }),
                    reference: REFERENCES[*reference],
                    heading_sd_rad: finite(*sd),
                    fix: Some(fix),
                    dt_s: *dt_s,
                });
                prop_assert!((0.0..TAU).contains(&reading.course_rad));
                prop_assert!((0.0..=PI).contains(&reading.course_sd_rad));
                prop_assert_eq!(stage.validation_error(), None);
            }
        }
    }
}

#[test]
fn course_without_field_and_fix_is_arbitrary() {
    for name in Course::NAMES {
        let reading = course(name, &[("declination_deg", 10.0)]).step(&input(1.0, CourseReference::Arbitrary));
        assert_eq!((reading.reference, reading.course_sd_rad), (CourseReference::Arbitrary, PI));
    }
}

#[test]
fn east_declination_increases_true_course() {
    for name in Course::NAMES {
        let reading = course(name, &[("declination_deg", 12.0)]).step(&input(-1.0, CourseReference::Magnetic));
        assert!((reading.course_rad - 1.0 - 12f64.to_radians()).abs() < 1e-12);
        assert_eq!(reading.reference, CourseReference::True);
    }
}

#[test]
fn angles_stage_ignores_track() {
    let mut stage = course("angles", &[]);
    let readings = run(&mut stage, 5.0, CourseReference::Arbitrary, |_| 0.0, |_| fix(1.0, 20.0));
    assert!(
        readings.iter().all(|reading| reading.reference == CourseReference::Arbitrary && reading.course_rad == 0.0)
    );
}

#[test]
fn stationary_vehicle_has_no_track() {
    let mut stage = course("track", &[]);
    let noise = |t: f64| fix(t * 100.0, 0.3);
    let readings = run(&mut stage, 20.0, CourseReference::Arbitrary, |_| 0.0, noise);
    assert!(readings.iter().all(|reading| reading.reference == CourseReference::Arbitrary && !reading.aligned));
    let moving = run(&mut stage, 1.0, CourseReference::Arbitrary, |_| 0.0, |_| fix(1.0, 10.0));
    assert_eq!(moving.iter().filter(|reading| reading.aligned).count(), 1);
    let stopped = run(&mut stage, 60.0, CourseReference::Arbitrary, |_| 0.0, noise);
    assert!(
        stopped.iter().all(|reading| error_deg(reading, 1.0).abs() < 1e-9),
        "a parked vehicle must keep its course"
    );
}

#[test]
fn gyro_bias_causes_predicted_course_error() {
    let bias_rad_s = 0.05f64.to_radians();
    let mut stage = course("track", &[]);
    let is_covered = |t: f64| !(400.0..460.0).contains(&t);
    let readings = run(
        &mut stage,
        800.0,
        CourseReference::Arbitrary,
        |t| bias_rad_s * t,
        |t| fix(0.7, 20.0).filter(|_| is_covered(t)),
    );
    let at = |t_s: f64| error_deg(&readings[(t_s * 100.0) as usize - 1], 0.7);
    // The steady error has the magnitude T b = 50 s · 0.05 °/s = 2.5°, with the time constant T of
    // the stage and the bias b. The gap of 60 s adds 60 s · 0.05 °/s = 3°.
    assert!((at(400.0) + 2.5).abs() < 0.01, "{}", at(400.0));
    assert!((at(460.0) + 5.5).abs() < 0.01, "{}", at(460.0));
    assert!((at(510.0) + 2.5 + 3.0 * (-1f64).exp()).abs() < 0.15, "{}", at(510.0));
    assert!(
        readings.iter().skip(1).all(|reading| !reading.aligned),
        "the end of a gap must not be announced as a jump"
    );
    let sd = |t_s: f64| readings[(t_s * 100.0) as usize - 1].course_sd_rad.to_degrees();
    assert!(sd(400.0) > 2.5 && sd(460.0) > sd(400.0) + 1.5 && sd(700.0) < sd(400.0) + 0.1);
}

#[test]
fn late_track_is_compared_with_earlier_course() {
    let mut stage = course("track", &[("time_constant_s", 5.0)]);
    let rate_rad_s = 0.1;
    let late = |t: f64| fix(rate_rad_s * (t - 0.5), 20.0).map(|fix| Fix { age_s: Some(0.5), ..fix });
    let readings = run(&mut stage, 60.0, CourseReference::Arbitrary, |t| -rate_rad_s * t, late);
    assert!(error_deg(readings.last().unwrap(), rate_rad_s * 59.99).abs() < 0.05);
}

#[test]
fn track_keeps_course_through_a_loop() {
    let mut stage = course("track", &[]);
    let pitched = |pitch_rad: f64| CourseInput {
        attitude: Attitude::from_angles(Angles { yaw_rad: 0.3, pitch_rad, roll_rad: 0.0 }),
        ..input(0.0, CourseReference::Arbitrary)
    };
    stage.step(&CourseInput { fix: fix(1.0, 50.0), ..pitched(0.0) });
    for tick in 0..=628 {
        let fix = fix(1.0, 50.0).filter(|_| tick % 10 == 0 && !(130..500).contains(&tick));
        stage.step(&CourseInput { fix, ..pitched(f64::from(tick) / 100.0) });
    }
    assert!(error_deg(&stage.step(&pitched(0.0)), 1.0).abs() < 1.0);
}

#[test]
fn true_heading_of_fuser_sets_course_and_is_announced() {
    for name in Course::NAMES {
        let mut stage = course(name, &[]);
        run(&mut stage, 1.0, CourseReference::Arbitrary, |_| 0.0, |_| fix(1.0, 20.0));
        let reading = stage.step(&input(-1.1, CourseReference::True));
        assert_eq!((reading.reference, reading.aligned), (CourseReference::True, true), "{name}");
        assert!(error_deg(&reading, 1.1).abs() < 1e-9);
        assert!(!stage.step(&input(-1.1, CourseReference::True)).aligned);
    }
}

#[test]
fn lost_reference_of_fuser_keeps_course_by_track() {
    let mut stage = course("track", &[]);
    run(&mut stage, 1.0, CourseReference::True, |_| -1.0, |_| fix(1.0, 20.0));
    let reading = stage.step(&input(2.0, CourseReference::Arbitrary));
    assert_eq!((reading.reference, reading.aligned), (CourseReference::True, false));
    assert!(error_deg(&reading, 1.0).abs() < 1e-9);
}

#[test]
fn restored_and_adopted_courses_continue() {
    for name in Course::NAMES {
        let mut stage = course(name, &[]);
        let yaw = |t: f64| 0.01 * t;
        run(&mut stage, 20.0, CourseReference::Arbitrary, yaw, |t| fix(0.7 + 0.1 * t.sin(), 20.0));
        let mut restored = course(name, &[]);
        restored.restore(&stage.snapshot()).unwrap();
        let continued = |stage: &mut Course| {
            run(stage, 5.0, CourseReference::Arbitrary, |t| yaw(20.0 + t), |t| fix(0.7 + 0.1 * t.cos(), 20.0))
        };
        let mut adopted = course("track", &[]);
        adopted.adopt(&stage.common()).unwrap();
        let last = stage.common().course.unwrap();
        let next = adopted.step(&input(yaw(20.0), CourseReference::Arbitrary));
        if last.reference == CourseReference::True {
            assert!(error_deg(&next, last.course_rad).abs() < 1e-9);
        }
        assert!(!next.aligned);
        assert_eq!(continued(&mut stage), continued(&mut restored));
    }
}

#[test]
fn record_with_invalid_value_is_rejected() {
    let mut stage = course("track", &[]);
    run(&mut stage, 2.0, CourseReference::Arbitrary, |_| 0.0, |_| fix(0.7, 20.0));
    let record = stage.snapshot();
    for (index, value) in [(0, 2.0), (4, 7.0), (6, -1.0), (8, 7.0), (11, 100.0), (13, 100.0), (14, -1.0), (15, -1.0)] {
        let mut damaged = record;
        damaged.values[index] = value;
        damaged.checksum = damaged.compute_checksum();
        let untouched = stage.clone();
        assert!(stage.restore(&damaged).is_err(), "value {index} = {value}");
        assert_eq!(stage, untouched);
    }
}
