//! S3's simulation through the stages: one full turn about each axis in rotation.

use attitude::{
    Vector3,
    accel::Projector,
    course::CourseReference,
    fuser::{Fuser, FuserInput},
    gyro::{Gyro, RateSample},
    metrics::{Accuracy, AttitudeError},
    stage::Stage,
    state::{Attitude, wrapped_rad},
    rotation::Rotation,
};
use scenario::{Scenario, s3};

/// The gains of the paper: of the original, rad/s, and of the improved form, 1/s.
pub(crate) const ORIGINAL: Filter = Filter { name: "madgwick", gain: Some(("beta_rad_s", 0.021)) };
pub(crate) const IMPROVED: Filter = Filter { name: "madgwick-improved", gain: Some(("beta_1_s", 0.029)) };
/// Runs of which the table takes the mean.
pub(crate) const SEEDS: u64 = 40;
/// The magnet of figure 2 c: east, as strong as the field is towards north, in the middle of each rotation.
const DISTURBANCE_UT: f64 = 20.0;
const DISTURBANCE_INTERVAL_S: std::ops::Range<f64> = 2.0..4.0;

/// A fuser with its gain.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Filter {
    pub(crate) name: &'static str,
    pub(crate) gain: Option<(&'static str, f64)>,
}

/// What is wrong with the sensors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SensorCase {
    /// Figure 2 a: the gyro's noise alone, 1 °/s.
    Ideal,
    /// Figure 2 b: and the accelerometer's, 0.03.
    AccelNoise,
    /// Figure 2 c: in place of it a magnet beside the way.
    MagneticDisturbance,
    /// Of the table: all noise; the gyro's as printed, 1 rad/s, in place of 1 °/s; the first rate_sample noisy, too.
    Table { printed_gyro_noise: bool, noisy_start: bool },
}

/// A sample of a run.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sample {
    pub(crate) t_s: f64,
    pub(crate) estimate: Attitude,
    pub(crate) truth: Attitude,
    pub(crate) reference: CourseReference,
}

fn scenario(sensors: SensorCase, seed: u64) -> Option<Scenario> {
    let mut scenario = Scenario::parse("s3").ok()?.with_seed(seed);
    let errors = &mut scenario.errors;
    match sensors {
        SensorCase::Table { printed_gyro_noise, noisy_start } => {
            errors.gyro_noise_rad_s = if printed_gyro_noise { 1.0 } else { 1f64.to_radians() };
            errors.exact_start = !noisy_start;
        }
        SensorCase::Ideal | SensorCase::AccelNoise | SensorCase::MagneticDisturbance => {
            errors.magnetometer.as_mut()?.noise_ut = 0.0;
            if sensors != SensorCase::AccelNoise {
                errors.accel_noise_m_s2 = 0.0;
            }
        }
    }
    Some(scenario)
}

/// The run of a filter; nothing where there is no such stage.
pub(crate) fn run(filter: Filter, sensors: SensorCase, seed: u64) -> Option<Vec<Sample>> {
    let scenario = scenario(sensors, seed)?;
    let (mut gyro, mut accel) = (Gyro::from_name("mobius")?, Projector::default());
    let mut fuser = Fuser::from_name(filter.name)?;
    if let Some((parameter, value)) = filter.gain {
        fuser.set(parameter, value).ok()?;
    }
    let mut previous_s = 0.0;
    let sample = |(t_s, reading): (f64, scenario::Reading)| {
        let truth = reading.truth.attitude;
        let time_in_turn_s = t_s % (s3::DURATION_S / 3.0);
        let disturbance = (sensors == SensorCase::MagneticDisturbance && DISTURBANCE_INTERVAL_S.contains(&time_in_turn_s))
            .then(|| truth.matrix() * Vector3::new(DISTURBANCE_UT, 0.0, 0.0));
        let rate_sample = RateSample { rate_rad_s: reading.rate_rad_s, dt_s: t_s - previous_s, kind: scenario.rate_kind };
        previous_s = t_s;
        let out = fuser.step(&FuserInput {
            motion: Some(gyro.step(&rate_sample)),
            inclination: Some(accel.step(&reading.force_m_s2)),
            field_ut: reading.field_ut.map(|field_ut| field_ut + disturbance.unwrap_or_default()),
            rest_credible: true,
            rate_credible: true,
            ..FuserInput::default()
        });
        Sample { t_s, estimate: out.attitude, truth, reference: out.reference }
    };
    Some(scenario.readings().map(sample).collect())
}

/// RMS errors, degrees.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Rms {
    /// Differences of pitch, roll and yaw, which go wild where pitch is ±90°.
    pub angles_deg: [f64; 3],
    /// The rotation vector between estimate and truth, about the body's axes of pitch, roll and yaw.
    pub vector_deg: [f64; 3],
    /// Its length.
    pub total_deg: f64,
    /// Its part about the vertical; none where no north is known.
    pub heading_deg: Option<f64>,
    /// Its tilt.
    pub inclination_deg: f64,
}

impl Rms {
    /// Over a run.
    pub(crate) fn from_samples(samples: &[Sample]) -> Self {
        let mut accuracy = Accuracy::default();
        let (mut angles, mut vector) = ([0.0; 3], [0.0; 3]);
        for Sample { estimate, truth, .. } in samples {
            accuracy.add(AttitudeError::between(estimate.quaternion(), truth.quaternion()));
            let (got, want) = (estimate.angles(), truth.angles());
            let differences = [got.pitch_rad - want.pitch_rad, got.roll_rad - want.roll_rad, got.yaw_rad - want.yaw_rad]
                .map(wrapped_rad);
            let rotation = Rotation::between(*truth, *estimate).quaternion();
            let imag_norm = rotation.imag().norm();
            let angle_rad = 2.0 * imag_norm.atan2(rotation.w.abs()) * rotation.w.signum();
            let vector_rad = rotation.imag() * if imag_norm > 0.0 { angle_rad / imag_norm } else { 0.0 };
            for axis in 0..3 {
                angles[axis] += differences[axis].to_degrees().powi(2);
                vector[axis] += vector_rad[axis].to_degrees().powi(2);
            }
        }
        let count = samples.len() as f64;
        let AttitudeError { total_deg, heading_deg, inclination_deg } = accuracy.rmse().unwrap_or_default();
        let has_north = samples.last().is_some_and(|sample| sample.reference != CourseReference::Arbitrary);
        Self {
            angles_deg: angles.map(|sum| f64::sqrt(sum / count)),
            vector_deg: vector.map(|sum| f64::sqrt(sum / count)),
            total_deg,
            heading_deg: has_north.then_some(heading_deg),
            inclination_deg,
        }
    }

    /// The mean of each over so many seeds.
    pub(crate) fn mean_over_seeds(filter: Filter, sensors: SensorCase) -> Self {
        let mut mean = Self::default();
        for seed in 1..=SEEDS {
            let rms = Self::of(&run(filter, sensors, seed).unwrap_or_default());
            let share = 1.0 / SEEDS as f64;
            for axis in 0..3 {
                mean.angles_deg[axis] += rms.angles_deg[axis] * share;
                mean.vector_deg[axis] += rms.vector_deg[axis] * share;
            }
            mean.total_deg += rms.total_deg * share;
            mean.inclination_deg += rms.inclination_deg * share;
            mean.heading_deg = rms.heading_deg.map(|deg| mean.heading_deg.unwrap_or(0.0) + deg * share);
        }
        mean
    }
}

/// The table's columns: original and improved under one kind of noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Comparison {
    /// The gyro's noise is as printed, 1 rad/s.
    pub printed_gyro_noise: bool,
    /// The first rate_sample is noisy, too, and the filter begins with it.
    pub noisy_start: bool,
    /// At β = 0.021 rad/s.
    pub original: Rms,
    /// At β = 0.029 1/s.
    pub improved: Rms,
}

/// 1 °/s and 1 rad/s, each with an exact and with a noisy first rate_sample.
pub(crate) const TABLE_CASES: [(bool, bool); 4] = [(false, false), (false, true), (true, false), (true, true)];

impl Comparison {
    pub(crate) fn run((printed_gyro_noise, noisy_start): (bool, bool)) -> Self {
        let sensors = SensorCase::Table { printed_gyro_noise, noisy_start };
        let [original, improved] = [ORIGINAL, IMPROVED].map(|filter| Rms::mean_over_seeds(filter, sensors));
        Self { printed_gyro_noise, noisy_start, original, improved }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gain(original: f64, improved: f64) -> f64 {
        1.0 - improved / original
    }

    #[test]
    fn exact_start_improved_gains_third_total_half_pitch() {
        let Comparison { original, improved, .. } = Comparison::run((false, false));
        let total = gain(original.total_deg, improved.total_deg);
        let pitch = gain(original.angles_deg[0], improved.angles_deg[0]);
        println!("{original:.3?} → {improved:.3?}");
        assert!((0.28..0.36).contains(&total) && (0.43..0.53).contains(&pitch), "{total}, {pitch}");
        assert!((0.49..0.60).contains(&original.total_deg), "{original:?}");
        // Of the rotation vector yaw gains nothing.
        assert!(gain(original.vector_deg[2], improved.vector_deg[2]) < 0.05);
    }

    #[test]
    fn noisy_start_makes_improved_form_worse() {
        let Comparison { original, improved, .. } = Comparison::run((false, true));
        println!("{original:.3?} → {improved:.3?}");
        assert!(gain(original.total_deg, improved.total_deg) < -0.4, "{original:?}, {improved:?}");
        assert!((1.7..2.6).contains(&original.total_deg) && (2.9..4.3).contains(&improved.total_deg));
    }

    #[test]
    fn printed_gyro_noise_makes_both_forms_equal() {
        for noisy_start in [false, true] {
            let Comparison { original, improved, .. } = Comparison::run((true, noisy_start));
            println!("{original:.3?} → {improved:.3?}");
            assert!((0.0..0.06).contains(&gain(original.total_deg, improved.total_deg)), "{original:?}, {improved:?}");
            assert!((15.0..27.0).contains(&original.total_deg), "{original:?}");
        }
    }

    #[test]
    fn disturbance_moves_heading_more_than_inclination() {
        let [ideal, disturbance] =
            [SensorCase::Ideal, SensorCase::MagneticDisturbance].map(|sensors| Rms::from_samples(&run(IMPROVED, sensors, 1).unwrap()));
        println!("{ideal:.3?}, {disturbance:.3?}");
        assert!(disturbance.heading_deg.unwrap() > 2.0 && disturbance.heading_deg > Some(disturbance.inclination_deg), "{disturbance:?}");
        assert!(disturbance.inclination_deg > 4.0 * ideal.inclination_deg, "{disturbance:?}");
    }
}
