//! Insufficient readings are rejected with a list of unmet conditions.
use attitude::{Quaternion, Vector3};
use calibrate::{Calibrator, Kind, Prior, Sample};

use crate::{
    simulated::{run_calibration, shaking, tumbling},
    unit::{Errors, Unit, exp, six_sides, with_up},
};

/// Checks that the readings are rejected, and that the message contains `expected` and no launch
/// file section.
fn assert_rejected(kind: Kind, samples: &[Sample], expected: &[&str]) {
    let rejection = run_calibration(kind, &Prior::default(), samples).unwrap_err();
    let text = rejection.to_string();
    expected.iter().for_each(|part| assert!(text.contains(part), "no {part:?} in:\n{text}"));
    assert!(!rejection.missing.is_empty() && !text.contains("[ingest"), "{text}");
}

fn exact(duration_s: f64, pose: impl Fn(f64) -> Quaternion<f64>) -> Vec<Sample> {
    Unit::new(Errors::NONE, 1).readings_along(duration_s, pose)
}

#[test]
fn gyro_without_rest_is_rejected() {
    assert_rejected(
        Kind::Gyro,
        &exact(30.0, tumbling(1)),
        &["0 %", "0 rests, 0.0 s", "missing: 5.0 s of rest", "do not touch it"],
    );
}

#[test]
fn gyro_with_steady_turn_in_a_rest_is_rejected() {
    let mut samples = exact(60.0, |_| exp(Vector3::zeros()));
    for sample in samples.iter_mut().filter(|sample| sample.t_ns > 40_000_000_000) {
        sample.rate_rad_s.z += 0.1;
    }
    assert_rejected(Kind::Gyro, &samples, &["the rests differ", "keep it still"]);
}

#[test]
fn accel_without_all_six_positions_is_rejected() {
    let mut poses = six_sides();
    poses.remove(2);
    let samples = Unit::new(Errors::NONE, 2).readings_in_poses(&poses, 3.0, 1.0);
    assert_rejected(Kind::Accel, &samples, &["83 %", "2 s of rest in each position: y up;"]);
    let flat = Unit::new(Errors::NONE, 2).readings_in_poses(&[with_up(Vector3::z())], 20.0, 1.0);
    assert_rejected(Kind::Accel, &flat, &["16 %", "x up", "x down", "y up", "y down", "z down"]);
}

#[test]
fn accel_without_force_is_rejected() {
    let mut samples = Unit::new(Errors::NONE, 2).readings_in_poses(&six_sides(), 3.0, 1.0);
    samples.iter_mut().for_each(|sample| sample.force_m_s2 = Vector3::zeros());
    assert_rejected(Kind::Accel, &samples, &["0 rests in 0 positions", "2 s of rest in each position: x up"]);
    assert_rejected(Kind::Mounting, &samples, &["0 rests", "a level pose"]);
}

#[test]
fn mag_turned_about_vertical_only_is_rejected() {
    let samples = exact(60.0, |t_s| exp(Vector3::z() * t_s));
    assert_rejected(Kind::Mag, &samples, &["+z", "−z", "upside down"]);
}

#[test]
fn mag_at_rest_is_rejected() {
    assert_rejected(Kind::Mag, &exact(60.0, |_| exp(Vector3::zeros())), &["0 %", "0 of 24", "+x, −x, +y, −y, +z, −z"]);
}

#[test]
fn recording_without_magnetometer_is_rejected() {
    let mut samples = exact(60.0, shaking(1));
    samples.iter_mut().for_each(|sample| sample.field_ut = None);
    for kind in [Kind::Mag, Kind::Clock] {
        assert_rejected(kind, &samples, &["0 %", "a magnetometer sample"]);
    }
}

#[test]
fn mounting_with_one_pose_is_rejected() {
    let level = exp(Vector3::zeros());
    let one = Unit::new(Errors::NONE, 3).readings_in_poses(&[level], 10.0, 1.0);
    assert_rejected(Kind::Mounting, &one, &["50 %", "nose down by 20°"]);
    let near = Unit::new(Errors::NONE, 3).readings_in_poses(&[level, exp(Vector3::x() * -0.2)], 5.0, 1.0);
    assert_rejected(Kind::Mounting, &near, &["50 %", "2 rests, no two distinct poses"]);
    assert_rejected(Kind::Mounting, &exact(20.0, tumbling(3)), &["0 %", "a level pose", "a second pose"]);
}

#[test]
fn clock_without_turns_to_and_fro_is_rejected() {
    assert_rejected(Kind::Clock, &exact(40.0, |_| exp(Vector3::zeros())), &["0 %", "to and fro"]);
    assert_rejected(Kind::Clock, &exact(40.0, |t_s| exp(Vector3::x() * t_s)), &["0 %", "to and fro"]);
}

#[test]
fn clock_delay_beyond_fuser_range_is_rejected() {
    let samples = Unit::new(Errors { delay_s: 0.09, ..Errors::NONE }, 4).readings_along(40.0, shaking(4));
    assert_rejected(Kind::Clock, &samples, &["measured 90.", "correct the driver's"]);
}

#[test]
fn clock_with_swapped_mag_axes_is_rejected() {
    let mut samples = exact(40.0, shaking(5));
    for field_ut in samples.iter_mut().filter_map(|sample| sample.field_ut.as_mut()) {
        *field_ut = Vector3::new(field_ut.y, field_ut.x, field_ut.z);
    }
    assert_rejected(Kind::Clock, &samples, &["both sensors use the same axes"]);
}

#[test]
fn invalid_readings_are_skipped() {
    let mut samples = Unit::new(Errors::NONE, 6).readings_in_poses(&six_sides(), 3.0, 1.0);
    let clean = run_calibration(Kind::Accel, &Prior::default(), &samples).unwrap();
    let invalid_values = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
    for (i, value) in invalid_values.into_iter().enumerate() {
        let at = 200 + 100 * i;
        let invalid = Sample { force_m_s2: Vector3::repeat(value), ..samples[at] };
        let field = Sample { t_ns: invalid.t_ns, field_ut: Some(Vector3::repeat(value)), ..samples[at] };
        // The timestamps of the last two readings are invalid: one is a repetition, the other is
        // earlier than the previous one.
        samples.splice(at..at, [invalid, field, samples[at], Sample { t_ns: i64::MIN, ..samples[at] }]);
    }
    let report = run_calibration(Kind::Accel, &Prior::default(), &samples).unwrap();
    assert_eq!((&report.values, &report.block), (&clean.values, &clean.block));
    assert!(report.notes.iter().any(|note| note.contains("readings skipped")), "{report}");
    for kind in [Kind::Gyro, Kind::Accel, Kind::Mag, Kind::Mounting, Kind::Clock] {
        let mut calibrator = Calibrator::new(kind, &Prior::default());
        assert!(calibrator.finish().is_err() && calibrator.coverage().share == 0.0);
        for (i, value) in [f64::MAX, -f64::MAX, f64::MIN_POSITIVE, 0.0].into_iter().cycle().take(4000).enumerate() {
            let vector = Vector3::repeat(value);
            let t_ns = i64::MIN + (i as i64) * (i64::MAX / 2000);
            calibrator.push(&Sample { t_ns, rate_rad_s: vector, force_m_s2: vector, field_ut: Some(vector) });
        }
        assert!(calibrator.finish().is_err());
    }
}
