//! Readings that do not suffice are refused, and it is said what is missing.
use attitude::{Quaternion, Vector3};
use calibrate::{Calibrator, Kind, Known, Sample};

use crate::{
    simulated::{calibrated, shaken, tumbled},
    unit::{Errors, Unit, exp, six_sides, with_up},
};

/// It is refused, says each of these, and prints no piece of a launch file.
fn assert_refused(kind: Kind, samples: &[Sample], said: &[&str]) {
    let refusal = calibrated(kind, &Known::default(), samples).unwrap_err();
    let text = refusal.to_string();
    said.iter().for_each(|words| assert!(text.contains(words), "no {words:?} in:\n{text}"));
    assert!(!refusal.missing.is_empty() && !text.contains("[ingest"), "{text}");
}

fn exact(whole_s: f64, pose: impl Fn(f64) -> Quaternion<f64>) -> Vec<Sample> {
    Unit::of(Errors::NONE, 1).along(whole_s, pose)
}

#[test]
fn a_gyro_that_never_rests() {
    assert_refused(
        Kind::Gyro,
        &exact(30.0, tumbled(1)),
        &["0 %", "at rest for 0.0 s", "missing: 5.0 s of rest", "do not touch it"],
    );
}

#[test]
fn a_gyro_that_turns_steadily_in_one_of_its_rests() {
    let mut samples = exact(60.0, |_| exp(Vector3::zeros()));
    for sample in samples.iter_mut().filter(|sample| sample.t_ns > 40_000_000_000) {
        sample.rate_rad_s.z += 0.1;
    }
    assert_refused(Kind::Gyro, &samples, &["the rests disagree", "turned steadily"]);
}

#[test]
fn an_accelerometer_without_one_of_six_positions() {
    let mut poses = six_sides();
    poses.remove(2);
    let samples = Unit::of(Errors::NONE, 2).through(&poses, 3.0, 1.0);
    assert_refused(Kind::Accel, &samples, &["83 %", "no rest with y up; turn the unit"]);
    let flat = Unit::of(Errors::NONE, 2).through(&[with_up(Vector3::z())], 20.0, 1.0);
    assert_refused(Kind::Accel, &flat, &["16 %", "x up", "x down", "y up", "y down", "z down"]);
}

#[test]
fn an_accelerometer_that_feels_nothing() {
    let mut samples = Unit::of(Errors::NONE, 2).through(&six_sides(), 3.0, 1.0);
    samples.iter_mut().for_each(|sample| sample.force_m_s2 = Vector3::zeros());
    assert_refused(Kind::Accel, &samples, &["0 rests in 0 positions", "no rest with x up"]);
    assert_refused(Kind::Mounting, &samples, &["0 rests", "a level pose"]);
}

#[test]
fn a_magnetometer_that_is_turned_about_the_vertical_alone() {
    let samples = exact(60.0, |t_s| exp(Vector3::z() * t_s));
    assert_refused(Kind::Mag, &samples, &["+z", "−z", "upside down"]);
}

#[test]
fn a_magnetometer_that_lies_there() {
    assert_refused(Kind::Mag, &exact(60.0, |_| exp(Vector3::zeros())), &["0 %", "0 of 24", "+x, −x, +y, −y, +z, −z"]);
}

#[test]
fn a_recording_without_a_magnetometer() {
    let mut samples = exact(60.0, shaken(1));
    samples.iter_mut().for_each(|sample| sample.field_ut = None);
    for kind in [Kind::Mag, Kind::Clock] {
        assert_refused(kind, &samples, &["0 %", "there is no sample of one"]);
    }
}

#[test]
fn a_mounting_by_one_pose() {
    let level = exp(Vector3::zeros());
    let one = Unit::of(Errors::NONE, 3).through(&[level], 10.0, 1.0);
    assert_refused(Kind::Mounting, &one, &["50 %", "nose down by 20°"]);
    let near = Unit::of(Errors::NONE, 3).through(&[level, exp(Vector3::x() * -0.2)], 5.0, 1.0);
    assert_refused(Kind::Mounting, &near, &["50 %", "2 rests, no two of them in poses that differ"]);
    assert_refused(Kind::Mounting, &exact(20.0, tumbled(3)), &["0 %", "a level pose", "a second pose"]);
}

#[test]
fn a_clock_without_turns_to_and_fro() {
    assert_refused(Kind::Clock, &exact(40.0, |_| exp(Vector3::zeros())), &["0 %", "to and fro"]);
    assert_refused(Kind::Clock, &exact(40.0, |t_s| exp(Vector3::x() * t_s)), &["0 %", "to and fro"]);
}

#[test]
fn a_magnetometer_that_is_later_than_the_fuser_makes_up_for() {
    let samples = Unit::of(Errors { delay_s: 0.09, ..Errors::NONE }, 4).along(40.0, shaken(4));
    assert_refused(Kind::Clock, &samples, &["90.", "ms late", "correct the stamps"]);
}

#[test]
fn a_magnetometer_with_axes_of_its_own_has_no_delay_to_be_found() {
    let mut samples = exact(40.0, shaken(5));
    for field_ut in samples.iter_mut().filter_map(|sample| sample.field_ut.as_mut()) {
        *field_ut = Vector3::new(field_ut.y, field_ut.x, field_ut.z);
    }
    assert_refused(Kind::Clock, &samples, &["check that both have the same axes"]);
}

#[test]
fn garbage_is_left_out_and_never_hurts() {
    let mut samples = Unit::of(Errors::NONE, 6).through(&six_sides(), 3.0, 1.0);
    let whole = calibrated(Kind::Accel, &Known::default(), &samples).unwrap();
    let garbage = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
    for (i, value) in garbage.into_iter().enumerate() {
        let at = 200 + 100 * i;
        let spoilt = Sample { force_m_s2: Vector3::repeat(value), ..samples[at] };
        let field = Sample { t_ns: spoilt.t_ns, field_ut: Some(Vector3::repeat(value)), ..samples[at] };
        // The same moment again, and one that is past.
        samples.splice(at..at, [spoilt, field, samples[at], Sample { t_ns: i64::MIN, ..samples[at] }]);
    }
    let report = calibrated(Kind::Accel, &Known::default(), &samples).unwrap();
    assert_eq!((&report.values, &report.block), (&whole.values, &whole.block));
    assert!(report.notes.iter().any(|note| note.contains("were left out")), "{report}");
    for kind in [Kind::Gyro, Kind::Accel, Kind::Mag, Kind::Mounting, Kind::Clock] {
        let mut calibrator = Calibrator::new(kind, &Known::default());
        assert!(calibrator.finish().is_err() && calibrator.coverage().share == 0.0);
        for (i, value) in [f64::MAX, -f64::MAX, f64::MIN_POSITIVE, 0.0].into_iter().cycle().take(4000).enumerate() {
            let vector = Vector3::repeat(value);
            let t_ns = i64::MIN + (i as i64) * (i64::MAX / 2000);
            calibrator.take(&Sample { t_ns, rate_rad_s: vector, force_m_s2: vector, field_ut: Some(vector) });
        }
        assert!(calibrator.finish().is_err());
    }
}
