//! Simulation of S3 with the stages: one full turn about each axis in sequence.

use attitude::{
    Vector3,
    accel::Accelerometer,
    course::CourseReference,
    fuser::{Fuser, FuserInput},
    gyro::{Gyro, RateSample},
    metrics::{Accuracy, AttitudeError},
    rotation::Rotation,
    stage::Stage,
    state::{Attitude, wrapped_rad},
};
use scenario::{Scenario, s3};

/// Original Madgwick filter with the paper's gain, rad/s.
pub(crate) const ORIGINAL: Filter = Filter { name: "madgwick", gain: Some(("beta_rad_s", 0.021)) };
/// Improved Madgwick filter with the paper's gain, 1/s.
pub(crate) const IMPROVED: Filter = Filter { name: "madgwick-improved", gain: Some(("beta_1_s", 0.029)) };
/// Number of runs that are averaged for the table.
pub(crate) const SEEDS: u64 = 40;
/// Eastward magnetic disturbance in figure 2 c, µT. It is as strong as the northward component of
/// the Earth's field.
const DISTURBANCE_UT: f64 = 20.0;
/// Interval of each turn in which the disturbance acts, in seconds.
const DISTURBANCE_INTERVAL_S: std::ops::Range<f64> = 2.0..4.0;

/// Fuser stage, with the name and the value of its gain; `None` keeps the default gain.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Filter {
    pub(crate) name: &'static str,
    pub(crate) gain: Option<(&'static str, f64)>,
}

/// Sensor errors of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SensorCase {
    /// Figure 2 a: only gyro noise of 1 °/s.
    Ideal,
    /// Figure 2 b: gyro noise of 1 °/s, and accelerometer noise of 0.03 g.
    AccelNoise,
    /// Figure 2 c: gyro noise of 1 °/s, and a magnetic disturbance.
    MagneticDisturbance,
    /// Table 1: noise of all sensors. The gyro noise is 1 rad/s, as printed, if
    /// `printed_gyro_noise` is set, otherwise 1 °/s. The first sample is noisy if `noisy_start` is
    /// set, otherwise exact.
    Table { printed_gyro_noise: bool, noisy_start: bool },
}

/// Sample of a run.
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

/// Runs a filter over the scenario. Returns `None` if the stage or its gain does not exist.
pub(crate) fn run(filter: Filter, sensors: SensorCase, seed: u64) -> Option<Vec<Sample>> {
    let scenario = scenario(sensors, seed)?;
    let (mut gyro, mut accel) = (Gyro::from_name("mobius")?, Accelerometer::default());
    let mut fuser = Fuser::from_name(filter.name)?;
    if let Some((parameter, value)) = filter.gain {
        fuser.set(parameter, value).ok()?;
    }
    let mut previous_s = 0.0;
    let sample = |(t_s, reading): (f64, scenario::Reading)| {
        let truth = reading.truth.attitude;
        let time_in_turn_s = t_s % (s3::DURATION_S / 3.0);
        let is_disturbed =
            sensors == SensorCase::MagneticDisturbance && DISTURBANCE_INTERVAL_S.contains(&time_in_turn_s);
        let disturbance = is_disturbed.then(|| truth.matrix() * Vector3::new(DISTURBANCE_UT, 0.0, 0.0));
        let rate_sample =
            RateSample { rate_rad_s: reading.rate_rad_s, dt_s: t_s - previous_s, kind: scenario.rate_kind };
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

/// RMS errors of a run, degrees.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Rms {
    /// Errors of pitch, roll and yaw. They become very large near a pitch of ±90°.
    pub angles_deg: [f64; 3],
    /// Components of the rotation vector from truth to estimate, about the body axes of pitch, roll
    /// and yaw.
    pub vector_deg: [f64; 3],
    /// Total error: the angle of the rotation from truth to estimate.
    pub total_deg: f64,
    /// Heading component of the error; `None` if the stage has no north reference.
    pub heading_deg: Option<f64>,
    /// Inclination component of the error.
    pub inclination_deg: f64,
}

impl Rms {
    /// Computes the errors of a run.
    pub(crate) fn from_samples(samples: &[Sample]) -> Self {
        let mut accuracy = Accuracy::default();
        let (mut angles, mut vector) = ([0.0; 3], [0.0; 3]);
        for Sample { estimate, truth, .. } in samples {
            accuracy.add(AttitudeError::between(estimate.quaternion(), truth.quaternion()));
            let (got, want) = (estimate.angles(), truth.angles());
            let differences =
                [got.pitch_rad - want.pitch_rad, got.roll_rad - want.roll_rad, got.yaw_rad - want.yaw_rad]
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

    /// Returns the mean errors over `SEEDS` runs.
    pub(crate) fn mean_over_seeds(filter: Filter, sensors: SensorCase) -> Self {
        let mut mean = Self::default();
        for seed in 1..=SEEDS {
            let rms = Self::from_samples(&run(filter, sensors, seed).unwrap_or_default());
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

/// Errors of the original and the improved filter in one case of table 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Comparison {
    /// `true` for a gyro noise of 1 rad/s, as printed, instead of 1 °/s.
    pub printed_gyro_noise: bool,
    /// `true` if the first sample, from which the filter starts, is noisy.
    pub noisy_start: bool,
    /// Errors of the original filter with β = 0.021 rad/s.
    pub original: Rms,
    /// Errors of the improved filter with β = 0.029 1/s.
    pub improved: Rms,
}

/// Cases of table 1: the flags `printed_gyro_noise` and `noisy_start`.
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
        // The yaw component of the rotation vector does not improve.
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
        let cases = [SensorCase::Ideal, SensorCase::MagneticDisturbance];
        let [ideal, disturbed] = cases.map(|sensors| Rms::from_samples(&run(IMPROVED, sensors, 1).unwrap()));
        println!("{ideal:.3?}, {disturbed:.3?}");
        let heading_deg = disturbed.heading_deg.unwrap();
        assert!(heading_deg > 2.0 && heading_deg > disturbed.inclination_deg, "{disturbed:?}");
        assert!(disturbed.inclination_deg > 4.0 * ideal.inclination_deg, "{disturbed:?}");
    }
}
