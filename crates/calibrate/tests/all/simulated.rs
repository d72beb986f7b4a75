//! Estimates from simulated units match the truth within their standard deviations.
use attitude::{Quaternion, Vector3, gyro::RateKind};
use calibrate::{Calibrator, Kind, Prior, Report, Sample};

use crate::{
    truth::NormalisedErrors,
    unit::{Errors, Noise, Unit, exp, rotated, six_sides, with_up},
};

const SEEDS: u64 = 60;

pub(crate) fn run_calibration(kind: Kind, prior: &Prior, samples: &[Sample]) -> Result<Report, calibrate::Rejection> {
    let mut calibrator = Calibrator::new(kind, prior);
    samples.iter().for_each(|sample| calibrator.push(sample));
    calibrator.finish()
}

fn calibrate_raw(kind: Kind, samples: &[Sample]) -> Report {
    run_calibration(kind, &Prior::default(), samples).unwrap()
}

/// Returns the orientation of a unit that is turned by hand at about 60 °/s. The axis of rotation
/// wanders, so that all directions are covered.
pub(crate) fn tumbling(seed: u64) -> impl Fn(f64) -> Quaternion<f64> {
    let mut noise = Noise::new(seed + 1_000_000);
    let phases: [f64; 4] = [0; 4].map(|_| noise.within(std::f64::consts::PI));
    let rates: [f64; 2] = [0; 2].map(|_| 0.9 + noise.within(0.1));
    move |t_s| {
        let about_z = exp(Vector3::z() * (rates[0] * t_s + phases[0]));
        let about_x = exp(Vector3::x() * (0.37 * rates[1] * t_s + phases[1]));
        let about_y = exp(Vector3::y() * (0.61 * t_s + phases[2]));
        let wobble = exp(Vector3::x() * (0.5 * (1.1 * t_s + phases[3]).sin()));
        about_z * about_x * about_y * wobble
    }
}

/// Returns the orientation of a unit that is shaken by hand about three axes.
pub(crate) fn shaking(seed: u64) -> impl Fn(f64) -> Quaternion<f64> {
    let mut noise = Noise::new(seed + 2_000_000);
    let phases = noise.vector_within(3.0);
    move |t_s| {
        let swing = |axis: usize, hz: f64| (std::f64::consts::TAU * hz * t_s + phases[axis]).sin();
        exp(Vector3::new(0.6 * swing(0, 0.9), 0.5 * swing(1, 1.3), 0.7 * swing(2, 0.7)))
    }
}

#[test]
fn gyro_bias_at_rest_matches_truth() {
    let mut errors = NormalisedErrors::default();
    for seed in 0..SEEDS {
        let bias = Noise::new(seed).vector_within(0.05);
        let unit = Unit::new(Errors { gyro_bias_rad_s: bias, ..Errors::NONE }, seed);
        let poses = [with_up(Vector3::z()), with_up(Vector3::new(0.3, 0.2, 1.0)), with_up(Vector3::x())];
        let report = calibrate_raw(Kind::Gyro, &unit.readings_in_poses(&poses, 6.0, 1.5));
        let estimate = &report.values[0];
        errors.push(&estimate.value, &estimate.sd, bias.as_slice());
        assert!(estimate.sd.iter().all(|sd| *sd < 4e-4), "{report}");
        assert!(report.residual.after < report.residual.before);
    }
    errors.assert_consistent("gyro bias");
}

#[test]
fn accel_six_positions_match_bias_and_scale() {
    let (mut bias_errors, mut scale_errors) = (NormalisedErrors::default(), NormalisedErrors::default());
    for seed in 0..SEEDS {
        let mut noise = Noise::new(seed);
        let truth =
            Errors { accel_bias_m_s2: noise.vector_within(0.5), accel: noise.symmetric(0.05, 0.0), ..Errors::NONE };
        // Hand-placed positions deviate from the exact sides.
        let poses: Vec<_> = six_sides().into_iter().map(|pose| pose * exp(noise.vector_within(0.15))).collect();
        let report = calibrate_raw(Kind::Accel, &Unit::new(truth, seed).readings_in_poses(&poses, 3.0, 1.0));
        assert!(report.block.contains("scale = ") && !report.block.contains("matrix"), "{report}");
        bias_errors.push(&report.values[0].value, &report.values[0].sd, truth.accel_bias_m_s2.as_slice());
        scale_errors.push(&report.values[1].value, &report.values[1].sd, truth.accel.diagonal().as_slice());
        assert!(report.residual.after < 0.1 * report.residual.before, "{report}");
    }
    bias_errors.assert_consistent("accelerometer's bias, six positions");
    scale_errors.assert_consistent("accelerometer's scale, six positions");
}

#[test]
fn accel_many_positions_match_misalignment() {
    let (mut bias_errors, mut matrix_errors) = (NormalisedErrors::default(), NormalisedErrors::default());
    for seed in 0..SEEDS {
        let mut noise = Noise::new(seed);
        let truth =
            Errors { accel_bias_m_s2: noise.vector_within(0.5), accel: noise.symmetric(0.05, 0.02), ..Errors::NONE };
        let poses: Vec<_> = six_sides().into_iter().chain((0..20).map(|_| with_up(noise.direction()))).collect();
        let report = calibrate_raw(Kind::Accel, &Unit::new(truth, seed).readings_in_poses(&poses, 2.5, 1.0));
        assert!(report.block.contains("matrix = "), "{report}");
        bias_errors.push(&report.values[0].value, &report.values[0].sd, truth.accel_bias_m_s2.as_slice());
        matrix_errors.push(&report.values[1].value, &report.values[1].sd, truth.accel.diagonal().as_slice());
        let cross = [truth.accel.m12, truth.accel.m13, truth.accel.m23];
        matrix_errors.push(&report.values[2].value, &report.values[2].sd, &cross);
    }
    bias_errors.assert_consistent("accelerometer's bias, any positions");
    matrix_errors.assert_consistent("accelerometer's matrix, any positions");
}

/// Adds the accelerations of a hand that turns the unit: oscillations without net displacement.
pub(crate) fn add_hand_accelerations(
    samples: &mut [Sample],
    pose: impl Fn(f64) -> Quaternion<f64>,
    errors: &Errors,
    seed: u64,
) {
    let mut noise = Noise::new(seed + 3_000_000);
    let swings: Vec<_> = (0..40)
        .map(|_| (noise.vector_within(0.15), noise.vector_within(3.0), Vector3::repeat(1.3) + noise.vector_within(0.6)))
        .collect();
    for sample in samples {
        let t_s = sample.t_ns as f64 * 1e-9;
        let swing = |i: usize| {
            let term = |(sizes, phases, hz): &(Vector3<f64>, Vector3<f64>, Vector3<f64>)| {
                sizes[i] * (std::f64::consts::TAU * hz[i] * t_s + phases[i]).sin()
            };
            swings.iter().map(term).sum()
        };
        let earth = Vector3::from_fn(|i, _| swing(i));
        sample.force_m_s2 += errors.accel.try_inverse().unwrap() * rotated(pose(t_s).conjugate(), earth);
    }
}

#[test]
fn accel_slow_motion_without_rest_matches_truth() {
    let (mut bias_errors, mut matrix_errors) = (NormalisedErrors::default(), NormalisedErrors::default());
    for seed in 0..SEEDS {
        let mut noise = Noise::new(seed);
        let truth =
            Errors { accel_bias_m_s2: noise.vector_within(0.5), accel: noise.symmetric(0.05, 0.02), ..Errors::NONE };
        let mut samples = Unit::new(truth, seed).readings_along(120.0, tumbling(seed));
        add_hand_accelerations(&mut samples, tumbling(seed), &truth, seed);
        let report = calibrate_raw(Kind::Accel, &samples);
        assert!(report.notes.iter().any(|note| note.contains("estimated in motion")), "{report}");
        assert!(report.block.contains("matrix = "), "{report}");
        bias_errors.push(&report.values[0].value, &report.values[0].sd, truth.accel_bias_m_s2.as_slice());
        matrix_errors.push(&report.values[1].value, &report.values[1].sd, truth.accel.diagonal().as_slice());
        let cross = [truth.accel.m12, truth.accel.m13, truth.accel.m23];
        matrix_errors.push(&report.values[2].value, &report.values[2].sd, &cross);
        assert!(report.residual.after < report.residual.before, "{report}");
    }
    // Successive windows are anticorrelated, so the means are more accurate than their residuals
    // suggest.
    bias_errors.assert_rms_above("accelerometer's bias, in motion", 0.5);
    matrix_errors.assert_rms_above("accelerometer's matrix, in motion", 0.5);
}

#[test]
fn mag_tumbling_matches_hard_and_soft_iron() {
    let (mut hard_iron_errors, mut soft_iron_errors) = (NormalisedErrors::default(), NormalisedErrors::default());
    for seed in 0..SEEDS {
        let mut noise = Noise::new(seed);
        let soft_iron = noise.symmetric(0.15, 0.06);
        let soft_iron = soft_iron / soft_iron.determinant().cbrt();
        let truth = Errors { hard_iron_ut: noise.vector_within(60.0), soft_iron, ..Errors::NONE };
        let samples = Unit::new(truth, seed).readings_along(90.0, tumbling(seed));
        let report = calibrate_raw(Kind::Mag, &samples);
        hard_iron_errors.push(&report.values[0].value, &report.values[0].sd, truth.hard_iron_ut.as_slice());
        soft_iron_errors.push(&report.values[1].value, &report.values[1].sd, soft_iron.diagonal().as_slice());
        let cross = [soft_iron.m12, soft_iron.m13, soft_iron.m23];
        soft_iron_errors.push(&report.values[2].value, &report.values[2].sd, &cross);
        assert!(report.values[0].sd.iter().all(|sd| *sd < 0.3), "{report}");
        assert!(report.residual.after < 1.0, "{report}");
    }
    hard_iron_errors.assert_consistent("hard iron");
    soft_iron_errors.assert_consistent("soft iron");
}

#[test]
fn mag_known_strength_sets_scale() {
    let strength_ut = Vector3::from(crate::unit::FIELD_UT).norm();
    let truth = Errors { soft_iron: attitude::Matrix3::identity() * 1.25, ..Errors::NONE };
    let samples = Unit::new(truth, 1).readings_along(90.0, tumbling(1));
    let prior = Prior { field_ut: Some(strength_ut), ..Prior::default() };
    let report = run_calibration(Kind::Mag, &prior, &samples).unwrap();
    report.values[1].value.iter().for_each(|scale| assert!((scale - 1.25).abs() < 0.01, "{report}"));
}

#[test]
fn mag_passing_iron_has_little_effect() {
    let truth = Errors { hard_iron_ut: Vector3::new(30.0, -20.0, 10.0), ..Errors::NONE };
    let mut samples = Unit::new(truth, 3).readings_along(90.0, tumbling(3));
    for sample in samples.iter_mut().filter(|sample| (40_000_000_000..45_000_000_000).contains(&sample.t_ns)) {
        sample.field_ut = sample.field_ut.map(|field_ut| field_ut + Vector3::new(25.0, 10.0, 0.0));
    }
    let report = calibrate_raw(Kind::Mag, &samples);
    let deviation = Vector3::from_column_slice(&report.values[0].value) - truth.hard_iron_ut;
    assert!(deviation.amax() < 1.0, "{report}");
}

#[test]
fn mounting_level_and_nose_down_pose_match_truth() {
    let mut errors = NormalisedErrors::default();
    for seed in 0..SEEDS {
        let mut noise = Noise::new(seed);
        // Rotation from sensor to body.
        let mounting = exp(noise.direction() * (3.1 * noise.unit()));
        let level = exp(Vector3::z() * noise.within(3.0));
        let angle_rad = 0.5 + 0.8 * noise.unit();
        // The calibration refuses a nose-down pose if one of the unit's axes is near the vertical
        // in this pose, but none is in the level pose. The test avoids such poses.
        let nose_down = [angle_rad, angle_rad + 0.4]
            .map(|angle_rad| level * exp(Vector3::x() * -angle_rad))
            .into_iter()
            .find(|pose| rotated((pose * mounting).conjugate(), Vector3::z()).amax() < 10f64.to_radians().cos())
            .unwrap();
        let poses = [level * mounting, nose_down * mounting];
        let report = calibrate_raw(Kind::Mounting, &Unit::new(Errors::NONE, seed).readings_in_poses(&poses, 4.0, 1.5));
        let [w, x, y, z] = report.values[0].value.clone().try_into().unwrap();
        // Small rotation from the true mounting to the estimate, as angles about the body axes.
        let deviation = Quaternion::new(w, x, y, z) * mounting.conjugate();
        let deviation = Vector3::new(deviation.i, deviation.j, deviation.k) * (2.0 * deviation.w.signum()).to_degrees();
        errors.push(deviation.as_slice(), &report.values[1].sd, &[0.0; 3]);
        assert!(deviation.amax() < 0.5, "{deviation} {report}");
    }
    errors.assert_consistent("mounting");
}

#[test]
fn mounting_accepts_poses_before_and_after_the_two() {
    let (level, tilted) = (exp(Vector3::zeros()), exp(Vector3::x() * 0.12));
    let nose_down = exp(Vector3::x() * -0.8);
    for (poses, order) in [
        (&[nose_down, level, nose_down][..], "nose down first"),
        (&[tilted, tilted, tilted, level, nose_down], "levelled after a long rest"),
        (&[level, nose_down, level, level, level], "back to level for longer"),
    ] {
        let report = calibrate_raw(Kind::Mounting, &Unit::new(Errors::NONE, 7).readings_in_poses(poses, 3.0, 1.0));
        let angle_deg = 2.0 * report.values[0].value[0].clamp(-1.0, 1.0).acos().to_degrees();
        assert!(angle_deg < 0.5, "{order}: {report}");
    }
}

#[test]
fn mounting_uses_prior_accel_calibration() {
    let truth = Errors { accel_bias_m_s2: Vector3::new(0.8, -0.6, 0.4), ..Errors::NONE };
    let level = exp(Vector3::zeros());
    let samples = Unit::new(truth, 5).readings_in_poses(&[level, exp(Vector3::x() * -0.9)], 4.0, 1.0);
    let mounting_angle_deg = |prior: &Prior| {
        let report = run_calibration(Kind::Mounting, prior, &samples).unwrap();
        2.0 * report.values[0].value[0].clamp(-1.0, 1.0).acos().to_degrees()
    };
    let raw = mounting_angle_deg(&Prior::default());
    let calibrated = mounting_angle_deg(&Prior { accel: truth.accel(), ..Prior::default() });
    assert!(raw > 3.0 && calibrated < 0.5, "{raw} {calibrated}");
}

#[test]
fn clock_delay_matches_truth() {
    let mut errors = NormalisedErrors::default();
    for seed in 0..SEEDS {
        let mut noise = Noise::new(seed);
        let delay_s = -0.008 + 0.045 * noise.unit();
        let truth = Errors {
            delay_s,
            hard_iron_ut: noise.vector_within(5.0),
            gyro_bias_rad_s: noise.vector_within(0.02),
            ..Errors::NONE
        };
        let samples = Unit::new(truth, seed).readings_along(40.0, shaking(seed));
        let report = calibrate_raw(Kind::Clock, &samples);
        errors.push(&report.values[0].value, &report.values[0].sd, &[1e3 * delay_s]);
        assert!(report.values[0].sd[0] < 0.5, "{report}");
        assert!(report.residual.after <= report.residual.before, "{report}");
    }
    errors.assert_consistent("delay");
}

#[test]
fn clock_rate_kind_shifts_delay_by_half_interval() {
    let samples = Unit::new(Errors { delay_s: 0.012, ..Errors::NONE }, 7).readings_along(40.0, shaking(7));
    let instants = Prior { rate_kind: RateKind::Instant, ..Prior::default() };
    let delay_ms = |prior: &Prior| run_calibration(Kind::Clock, prior, &samples).unwrap().values[0].value[0];
    let (as_means, as_instants) = (delay_ms(&Prior::default()), delay_ms(&instants));
    // The readings are means over 10 ms. A mean that is treated as an instantaneous rate is 5 ms
    // late, which reduces the estimated delay by 5 ms.
    assert!((as_means - 12.0).abs() < 1.0 && (as_means - as_instants - 5.0).abs() < 0.5, "{as_means} {as_instants}");
}

#[test]
fn with_up_rotates_vector_to_vertical() {
    let up = rotated(with_up(Vector3::new(1.0, 2.0, -3.0)), Vector3::new(1.0, 2.0, -3.0).normalize());
    assert!((up - Vector3::z()).amax() < 1e-12);
}
