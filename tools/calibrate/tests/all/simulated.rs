//! What simulated units have is found, within what is said about it.
use attitude::{Quaternion, Vector3, gyro::RateKind};
use calibrate::{Calibrator, Kind, Known, Report, Sample};

use crate::{
    truth::Normalised,
    unit::{Errors, Noise, Unit, exp, rotated, six_sides, with_up},
};

const SEEDS: u64 = 60;

pub(crate) fn calibrated(kind: Kind, known: &Known, samples: &[Sample]) -> Result<Report, calibrate::Refusal> {
    let mut calibrator = Calibrator::new(kind, known);
    samples.iter().for_each(|sample| calibrator.take(sample));
    calibrator.finish()
}

fn found(kind: Kind, samples: &[Sample]) -> Report {
    calibrated(kind, &Known::default(), samples).unwrap()
}

/// Turned by hand about axes that wander, for so long, at some 60 °/s; every direction comes.
pub(crate) fn tumbled(seed: u64) -> impl Fn(f64) -> Quaternion<f64> {
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

/// To and fro about axes of its own, as by hand.
pub(crate) fn shaken(seed: u64) -> impl Fn(f64) -> Quaternion<f64> {
    let mut noise = Noise::new(seed + 2_000_000);
    let phases = noise.vector_within(3.0);
    move |t_s| {
        let swing = |axis: usize, hz: f64| (std::f64::consts::TAU * hz * t_s + phases[axis]).sin();
        exp(Vector3::new(0.6 * swing(0, 0.9), 0.5 * swing(1, 1.3), 0.7 * swing(2, 0.7)))
    }
}

#[test]
fn a_gyros_bias_is_found_at_rest() {
    let mut errors = Normalised::default();
    for seed in 0..SEEDS {
        let bias = Noise::new(seed).vector_within(0.05);
        let unit = Unit::of(Errors { gyro_bias_rad_s: bias, ..Errors::NONE }, seed);
        let poses = [with_up(Vector3::z()), with_up(Vector3::new(0.3, 0.2, 1.0)), with_up(Vector3::x())];
        let report = found(Kind::Gyro, &unit.through(&poses, 6.0, 1.5));
        let bias_found = &report.values[0];
        errors.take(&bias_found.value, &bias_found.sd, bias.as_slice());
        assert!(bias_found.sd.iter().all(|sd| *sd < 4e-4), "{report}");
        assert!(report.residual.after < report.residual.before);
    }
    errors.assert_honest("gyro bias");
}

#[test]
fn six_positions_give_the_accelerometers_bias_and_scale() {
    let (mut of_bias, mut of_scale) = (Normalised::default(), Normalised::default());
    for seed in 0..SEEDS {
        let mut noise = Noise::new(seed);
        let truth =
            Errors { accel_bias_m_s2: noise.vector_within(0.5), accel: noise.symmetric(0.05, 0.0), ..Errors::NONE };
        // Nobody lays a unit exactly on its sides.
        let poses: Vec<_> = six_sides().into_iter().map(|pose| pose * exp(noise.vector_within(0.15))).collect();
        let report = found(Kind::Accel, &Unit::of(truth, seed).through(&poses, 3.0, 1.0));
        assert!(report.block.contains("scale = ") && !report.block.contains("matrix"), "{report}");
        of_bias.take(&report.values[0].value, &report.values[0].sd, truth.accel_bias_m_s2.as_slice());
        of_scale.take(&report.values[1].value, &report.values[1].sd, truth.accel.diagonal().as_slice());
        assert!(report.residual.after < 0.1 * report.residual.before, "{report}");
    }
    of_bias.assert_honest("accelerometer's bias, six positions");
    of_scale.assert_honest("accelerometer's scale, six positions");
}

#[test]
fn many_positions_of_any_kind_give_the_misalignment_too() {
    let (mut of_bias, mut of_matrix) = (Normalised::default(), Normalised::default());
    for seed in 0..SEEDS {
        let mut noise = Noise::new(seed);
        let truth =
            Errors { accel_bias_m_s2: noise.vector_within(0.5), accel: noise.symmetric(0.05, 0.02), ..Errors::NONE };
        let poses: Vec<_> = six_sides().into_iter().chain((0..20).map(|_| with_up(noise.direction()))).collect();
        let report = found(Kind::Accel, &Unit::of(truth, seed).through(&poses, 2.5, 1.0));
        assert!(report.block.contains("matrix = "), "{report}");
        of_bias.take(&report.values[0].value, &report.values[0].sd, truth.accel_bias_m_s2.as_slice());
        of_matrix.take(&report.values[1].value, &report.values[1].sd, truth.accel.diagonal().as_slice());
        let cross = [truth.accel.m12, truth.accel.m13, truth.accel.m23];
        of_matrix.take(&report.values[2].value, &report.values[2].sd, &cross);
    }
    of_bias.assert_honest("accelerometer's bias, any positions");
    of_matrix.assert_honest("accelerometer's matrix, any positions");
}

/// What a hand does to a unit that it turns about: accelerations to and fro that lead nowhere.
pub(crate) fn shaken_by_a_hand(
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
            let of = |(sizes, phases, hz): &(Vector3<f64>, Vector3<f64>, Vector3<f64>)| {
                sizes[i] * (std::f64::consts::TAU * hz[i] * t_s + phases[i]).sin()
            };
            swings.iter().map(of).sum()
        };
        let earth = Vector3::from_fn(|i, _| swing(i));
        sample.force_m_s2 += errors.accel.try_inverse().unwrap() * rotated(pose(t_s).conjugate(), earth);
    }
}

#[test]
fn slow_turns_by_hand_give_the_accelerometers_errors_without_a_rest() {
    let (mut of_bias, mut of_matrix) = (Normalised::default(), Normalised::default());
    for seed in 0..SEEDS {
        let mut noise = Noise::new(seed);
        let truth =
            Errors { accel_bias_m_s2: noise.vector_within(0.5), accel: noise.symmetric(0.05, 0.02), ..Errors::NONE };
        let mut samples = Unit::of(truth, seed).along(120.0, tumbled(seed));
        shaken_by_a_hand(&mut samples, tumbled(seed), &truth, seed);
        let report = found(Kind::Accel, &samples);
        assert!(report.notes.iter().any(|note| note.contains("found in motion")), "{report}");
        assert!(report.block.contains("matrix = "), "{report}");
        of_bias.take(&report.values[0].value, &report.values[0].sd, truth.accel_bias_m_s2.as_slice());
        of_matrix.take(&report.values[1].value, &report.values[1].sd, truth.accel.diagonal().as_slice());
        let cross = [truth.accel.m12, truth.accel.m13, truth.accel.m23];
        of_matrix.take(&report.values[2].value, &report.values[2].sd, &cross);
        assert!(report.residual.after < report.residual.before, "{report}");
    }
    // What a hand gives to one window it takes from the next, so that means are better than their residuals say.
    of_bias.assert_within("accelerometer's bias, in motion", 0.5);
    of_matrix.assert_within("accelerometer's matrix, in motion", 0.5);
}

#[test]
fn hard_and_soft_iron_are_found_by_turning_about() {
    let (mut of_hard, mut of_soft) = (Normalised::default(), Normalised::default());
    for seed in 0..SEEDS {
        let mut noise = Noise::new(seed);
        let soft_iron = noise.symmetric(0.15, 0.06);
        let soft_iron = soft_iron / soft_iron.determinant().cbrt();
        let truth = Errors { hard_iron_ut: noise.vector_within(60.0), soft_iron, ..Errors::NONE };
        let samples = Unit::of(truth, seed).along(90.0, tumbled(seed));
        let report = found(Kind::Mag, &samples);
        of_hard.take(&report.values[0].value, &report.values[0].sd, truth.hard_iron_ut.as_slice());
        of_soft.take(&report.values[1].value, &report.values[1].sd, soft_iron.diagonal().as_slice());
        let cross = [soft_iron.m12, soft_iron.m13, soft_iron.m23];
        of_soft.take(&report.values[2].value, &report.values[2].sd, &cross);
        assert!(report.values[0].sd.iter().all(|sd| *sd < 0.3), "{report}");
        assert!(report.residual.after < 1.0, "{report}");
    }
    of_hard.assert_honest("hard iron");
    of_soft.assert_honest("soft iron");
}

#[test]
fn a_known_strength_gives_the_field_its_scale() {
    let strength_ut = Vector3::from(crate::unit::FIELD_UT).norm();
    let truth = Errors { soft_iron: attitude::Matrix3::identity() * 1.25, ..Errors::NONE };
    let samples = Unit::of(truth, 1).along(90.0, tumbled(1));
    let known = Known { field_ut: Some(strength_ut), ..Known::default() };
    let report = calibrated(Kind::Mag, &known, &samples).unwrap();
    report.values[1].value.iter().for_each(|scale| assert!((scale - 1.25).abs() < 0.01, "{report}"));
}

#[test]
fn iron_that_passes_by_spoils_little() {
    let truth = Errors { hard_iron_ut: Vector3::new(30.0, -20.0, 10.0), ..Errors::NONE };
    let mut samples = Unit::of(truth, 3).along(90.0, tumbled(3));
    for sample in samples.iter_mut().filter(|sample| (40_000_000_000..45_000_000_000).contains(&sample.t_ns)) {
        sample.field_ut = sample.field_ut.map(|field_ut| field_ut + Vector3::new(25.0, 10.0, 0.0));
    }
    let report = found(Kind::Mag, &samples);
    let off = Vector3::from_column_slice(&report.values[0].value) - truth.hard_iron_ut;
    assert!(off.amax() < 1.0, "{report}");
}

#[test]
fn the_mounting_is_found_by_a_level_and_a_nose_down_pose() {
    let mut errors = Normalised::default();
    for seed in 0..SEEDS {
        let mut noise = Noise::new(seed);
        // Sensor → body.
        let mounting = exp(noise.direction() * (3.1 * noise.unit()));
        let level = exp(Vector3::z() * noise.within(3.0));
        let nose_down = level * exp(Vector3::x() * -(0.5 + 0.8 * noise.unit()));
        let poses = [level * mounting, nose_down * mounting];
        let report = found(Kind::Mounting, &Unit::of(Errors::NONE, seed).through(&poses, 4.0, 1.5));
        let [w, x, y, z] = report.values[0].value.clone().try_into().unwrap();
        // Small turns about the body's axes between what was found and the truth.
        let off = Quaternion::new(w, x, y, z) * mounting.conjugate();
        let off = Vector3::new(off.i, off.j, off.k) * (2.0 * off.w.signum()).to_degrees();
        errors.take(off.as_slice(), &report.values[1].sd, &[0.0; 3]);
        assert!(off.amax() < 0.5, "{off} {report}");
    }
    errors.assert_honest("mounting");
}

#[test]
fn a_mounting_builds_on_the_accelerometers_calibration() {
    let truth = Errors { accel_bias_m_s2: Vector3::new(0.8, -0.6, 0.4), ..Errors::NONE };
    let level = exp(Vector3::zeros());
    let samples = Unit::of(truth, 5).through(&[level, exp(Vector3::x() * -0.9)], 4.0, 1.0);
    let turned_deg = |known: &Known| {
        let report = calibrated(Kind::Mounting, known, &samples).unwrap();
        2.0 * report.values[0].value[0].clamp(-1.0, 1.0).acos().to_degrees()
    };
    let raw = turned_deg(&Known::default());
    let built_on = turned_deg(&Known { accel: truth.accel(), ..Known::default() });
    assert!(raw > 3.0 && built_on < 0.5, "{raw} {built_on}");
}

#[test]
fn the_magnetometers_delay_is_found_by_turns_to_and_fro() {
    let mut errors = Normalised::default();
    for seed in 0..SEEDS {
        let mut noise = Noise::new(seed);
        let delay_s = -0.008 + 0.045 * noise.unit();
        let truth = Errors {
            delay_s,
            hard_iron_ut: noise.vector_within(5.0),
            gyro_bias_rad_s: noise.vector_within(0.02),
            ..Errors::NONE
        };
        let samples = Unit::of(truth, seed).along(40.0, shaken(seed));
        let report = found(Kind::Clock, &samples);
        errors.take(&report.values[0].value, &report.values[0].sd, &[1e3 * delay_s]);
        assert!(report.values[0].sd[0] < 0.5, "{report}");
        assert!(report.residual.after <= report.residual.before, "{report}");
    }
    errors.assert_honest("delay");
}

#[test]
fn a_rate_at_the_end_of_its_interval_is_half_an_interval_away_from_the_mean_of_it() {
    let samples = Unit::of(Errors { delay_s: 0.012, ..Errors::NONE }, 7).along(40.0, shaken(7));
    let instants = Known { rate_kind: RateKind::Instant, ..Known::default() };
    let delay_ms = |known: &Known| calibrated(Kind::Clock, known, &samples).unwrap().values[0].value[0];
    let (as_means, as_instants) = (delay_ms(&Known::default()), delay_ms(&instants));
    // 10 ms of interval: taken for instants, means are 5 ms late, and the magnetometer less.
    assert!((as_means - 12.0).abs() < 1.0 && (as_means - as_instants - 5.0).abs() < 0.5, "{as_means} {as_instants}");
}

#[test]
fn forces_are_turned_as_poses_say() {
    let up = rotated(with_up(Vector3::new(1.0, 2.0, -3.0)), Vector3::new(1.0, 2.0, -3.0).normalize());
    assert!((up - Vector3::z()).amax() < 1e-12);
}
