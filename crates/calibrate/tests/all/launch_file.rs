//! The printed blocks form a valid launch file that corrects the errors.
use attitude::{GRAVITY_M_S2, Quaternion, Vector3, calibration::Mounting};
use calibrate::{Kind, Prior, Report};
use launch::Launch;

use crate::{
    simulated::{run_calibration, shaking, tumbling},
    unit::{Errors, Noise, Unit, exp, six_sides, with_up},
};

/// Returns a report of every kind of calibration for one simulated unit.
fn reports(truth: Errors, mounting: Quaternion<f64>) -> Vec<Report> {
    let unit = Unit::new(truth, 11);
    let mut noise = Noise::new(11);
    let many: Vec<_> = six_sides().into_iter().chain((0..20).map(|_| with_up(noise.direction()))).collect();
    let level = exp(Vector3::z() * 0.4);
    let poses = [level * mounting, level * exp(Vector3::x() * -0.8) * mounting];
    let prior = Prior { accel: truth.accel(), ..Prior::default() };
    [
        (Kind::Gyro, Prior::default(), unit.readings_in_poses(&six_sides(), 3.0, 1.0)),
        (Kind::Accel, Prior::default(), unit.readings_in_poses(&many, 2.5, 1.0)),
        (Kind::Mag, Prior::default(), unit.readings_along(90.0, tumbling(11))),
        (Kind::Mounting, prior, unit.readings_in_poses(&poses, 4.0, 1.0)),
        (Kind::Clock, Prior::default(), unit.readings_along(40.0, shaking(11))),
    ]
    .iter()
    .map(|(kind, prior, samples)| run_calibration(*kind, prior, samples).unwrap())
    .collect()
}

#[test]
fn combined_blocks_form_launch_file_that_corrects_errors() {
    let mut noise = Noise::new(12);
    let soft_iron = noise.symmetric(0.1, 0.05);
    let truth = Errors {
        gyro_bias_rad_s: noise.vector_within(0.03),
        accel_bias_m_s2: noise.vector_within(0.4),
        accel: noise.symmetric(0.03, 0.01),
        hard_iron_ut: noise.vector_within(30.0),
        soft_iron: soft_iron / soft_iron.determinant().cbrt(),
        delay_s: 0.02,
    };
    let mounting = exp(Vector3::new(0.4, -1.0, 2.0));
    let reports = reports(truth, mounting);
    let text = reports.iter().map(|report| report.block.as_str()).collect::<Vec<_>>().join("\n");
    let launch = Launch::parse("launch.toml", &text).unwrap_or_else(|error| panic!("{text}\n{error}"));

    let calibration = launch.ingest.calibration;
    let [gyro, accel, mag] =
        [calibration.gyro, calibration.accel, calibration.mag].map(|section| section.to_calibration().unwrap());
    // The calibration must undo the distortion of exact readings.
    for _ in 0..100 {
        let exact = calibrate::Sample {
            t_ns: 0,
            rate_rad_s: noise.vector_within(3.0),
            force_m_s2: noise.direction() * GRAVITY_M_S2,
            field_ut: Some(noise.direction() * 48.0),
        };
        let raw = truth.distort(&exact);
        assert!((gyro.apply(raw.rate_rad_s) - exact.rate_rad_s).amax() < 1e-3);
        assert!((accel.apply(raw.force_m_s2) - exact.force_m_s2).amax() < 0.02);
        assert!((mag.apply(raw.field_ut.unwrap()) - exact.field_ut.unwrap()).amax() < 1.0);
    }
    let matrix = attitude::Matrix3::from_fn(|row, column| launch.ingest.mounting[row][column]);
    let deviation = matrix - Mounting::from_quaternion(mounting).unwrap().matrix();
    assert!(deviation.amax() < 0.01, "{deviation}");
    assert!((launch.fuser.set["magnetometer_delay_s"] - 0.02).abs() < 2e-3);
    assert!(launch.fuser.set["magnetometer_delay_sd_s"] < 1e-3 && launch.fuser.stage == "multiple-model");
}

#[test]
fn report_shows_values_deviations_and_block() {
    for report in reports(Errors { delay_s: 0.01, ..Errors::NONE }, exp(Vector3::z() * 0.02)) {
        let text = report.to_string();
        let heading = "Add to launch.toml, replacing any existing [";
        for expected in [" ± ", "before", "after", "coverage 100 %", heading, &report.block] {
            assert!(text.contains(expected), "no {expected:?} in:\n{text}");
        }
    }
}
