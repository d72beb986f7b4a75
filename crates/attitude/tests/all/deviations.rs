//! Tests of the reported standard deviations. Each error is divided by its reported standard
//! deviation, and the quantiles of these normalised errors are compared with those of a normal
//! distribution.
//!
//! `cargo test --release -p plumbline-attitude deviations:: -- --nocapture` prints every figure.
//!
//! Input: trials of BROAD, crossed trials (the movement of one trial in the magnetic field of
//! another) and cruise scenarios.
//!
//! Failure: without the recordings, the tests that need them are skipped with a message.
use attitude::{
    Quaternion,
    accel::Accelerometer,
    course::CourseReference,
    fuser::{Fused, Fuser, FuserInput},
    gyro::{Gyro, RateSample},
    stage::Stage,
};
use scenario::Scenario;

use crate::heading::{
    CLEAN,
    crossed::crossed_rows,
    trial::{Chain, trials, truth},
};

/// Ideal 68 % and 95 % quantiles of an error in one axis, in standard deviations.
///
/// The ideal error is normally distributed.
const ONE_AXIS: [f64; 2] = [1.0, 2.0];
/// Ideal 68 % and 95 % quantiles of an error in two axes, in standard deviations of one axis.
///
/// The ideal error is normally distributed.
const TWO_AXES: [f64; 2] = [1.51, 2.45];
/// Accepted ratio of a measured quantile to the ideal one.
const CONSISTENT: core::ops::RangeInclusive<f64> = 0.7..=1.4;

/// Errors divided by their reported standard deviations.
#[derive(Default)]
struct NormalisedErrors {
    inclination: Vec<f64>,
    heading: Vec<f64>,
}

impl NormalisedErrors {
    fn add(&mut self, out: &Fused, truth: Quaternion<f64>) {
        let e = out.attitude.quaternion() * truth.conjugate();
        let inclination_rad = 2.0 * e.i.hypot(e.j).atan2(e.w.hypot(e.k));
        self.inclination.push(inclination_rad / out.inclination_sd_rad);
        if out.reference != CourseReference::Arbitrary {
            self.heading.push(2.0 * e.k.abs().atan2(e.w.abs()) / out.heading_sd_rad);
        }
    }

    fn with(mut self, other: Self) -> Self {
        self.inclination.extend(other.inclination);
        self.heading.extend(other.heading);
        self
    }

    /// Prints and returns the 68 % and 95 % quantiles for inclination and heading.
    ///
    /// Each quantile is given as a ratio to its ideal value.
    fn ratios(mut self, name: &str) -> [[f64; 2]; 2] {
        let ratios = [quantiles(&mut self.inclination, TWO_AXES), quantiles(&mut self.heading, ONE_AXIS)];
        println!("{name}: inclination {:.2?}, heading {:.2?}", ratios[0], ratios[1]);
        ratios
    }
}

/// Returns the 68 % and 95 % quantiles, each as a ratio to its ideal value.
///
/// Returns NaN if there are no errors.
fn quantiles(errors: &mut [f64], ideal: [f64; 2]) -> [f64; 2] {
    if errors.is_empty() {
        return [f64::NAN; 2];
    }
    errors.sort_by(f64::total_cmp);
    let at = |share: f64| errors[(share * (errors.len() - 1) as f64) as usize];
    [at(0.68) / ideal[0], at(0.95) / ideal[1]]
}

fn assert_consistent(ratios: [f64; 2], name: &str) {
    assert!(ratios.iter().all(|ratio| CONSISTENT.contains(ratio)), "{name}: {ratios:.2?}");
}

#[recorded::test]
fn wz_sd_is_consistent_on_broad_and_crossed_trials() {
    let Some(trials) = trials() else { return };
    let normalised = |rows: &[recording::Row]| {
        let (mut chain, mut errors) = (Chain::new(), NormalisedErrors::default());
        for row in rows {
            let out = chain.step(row);
            if let Some(q) = truth(row).filter(|_| row.reference.is_some_and(|reference| reference.scored)) {
                errors.add(&out, q);
            }
        }
        errors
    };
    // Trial 27 is left out, because its magnetic field directions in motion and at rest differ by
    // 6°, which no sensor on the body can detect.
    let solvable = trials.iter().filter(|trial| trial.number() != "27");
    let without_27 = solvable
        .map(|trial| normalised(&trial.rows))
        .fold(NormalisedErrors::default(), NormalisedErrors::with)
        .ratios("wz, BROAD without trial 27");
    let all = trials
        .iter()
        .map(|trial| normalised(&trial.rows))
        .fold(NormalisedErrors::default(), NormalisedErrors::with)
        .ratios("wz, all of BROAD");
    let places: Vec<_> = trials.iter().filter(|trial| CLEAN.contains(&trial.number())).collect();
    let pairs = trials.iter().flat_map(|movement| places.iter().map(move |place| (movement, place)));
    let crossed = pairs.map(|(movement, place)| normalised(&crossed_rows(movement, place, 1)));
    let crossed = crossed.fold(NormalisedErrors::default(), NormalisedErrors::with).ratios("wz, crossed");
    assert_consistent(all[0], "inclination on BROAD");
    assert_consistent(without_27[1], "heading on BROAD without trial 27");
    assert_consistent(crossed[0], "inclination, crossed");
    assert_consistent(crossed[1], "heading, crossed");
}

/// Sensor errors of `cruise` as parameters of `aided`: noise and constant biases, no scale error.
const CRUISE: [(&str, f64); 7] = [
    ("gyro_noise_deg_sqrt_s", 0.005),
    ("gyro_bias_sd_deg_s", 0.05),
    ("gyro_bias_walk_deg_s_sqrt_s", 0.0),
    ("accel_noise_m_s_sqrt_s", 0.002),
    ("accel_bias_sd_m_s2", 0.02),
    ("accel_bias_walk_m_s2_sqrt_s", 0.0),
    ("scale_noise", 0.0),
];
/// Sensor errors of `cruise-hard` as parameters of `aided`.
///
/// The list contains the errors of `cruise` plus a scale error of 1 % and a drifting bias.
const CRUISE_HARD: [(&str, f64); 5] = [CRUISE[0], CRUISE[1], CRUISE[3], CRUISE[4], ("scale_noise", 0.003)];
/// Sensor errors of `s1` as parameters of `wz`: constant gyro bias and white accelerometer noise.
const S1: [(&str, f64); 3] =
    [("level_noise_deg_sqrt_s", 0.0001), ("gyro_bias_walk_deg_s_sqrt_s", 0.0), ("residual_accel_bias_sd_m_s2", 0.0)];

#[test]
fn aided_sd_is_consistent_on_cruise_flights() {
    for name in ["cruise", "cruise?gnss=gaps", "cruise-hard", "cruise-hard?gnss_noise_m_s=0.2"] {
        assert_consistent_in("aided", name, &[], 6);
    }
}

#[test]
fn aided_sd_with_sensor_parameters_is_consistent() {
    let check = |name: &str, sensors: &[(&str, f64)], receiver_m_s: f64| {
        assert_consistent_in("aided", name, &[sensors, &[("velocity_sd_m_s", receiver_m_s)]].concat(), 6);
    };
    check("cruise", &CRUISE, 0.05);
    check("cruise?gnss=gaps", &CRUISE, 0.05);
    check("cruise?gnss_noise_m_s=0.2", &CRUISE, 0.2);
    check("cruise?gnss=never", &CRUISE, 0.2);
    check("cruise-hard", &CRUISE_HARD, 0.15);
    check("cruise-hard?gnss=gaps", &CRUISE_HARD, 0.15);
    check("cruise-hard?gnss=never", &CRUISE_HARD, 0.2);
}

/// The gyro parameters are exact, and the simulated receiver is better than its parameters.
///
/// The reported standard deviations may then be too large, but not too small.
#[test]
fn aided_sd_with_gyro_parameters_is_not_too_small() {
    let [inclination, heading] = simulated("aided", "cruise", &CRUISE, 3);
    assert!(
        inclination.into_iter().chain(heading).all(|ratio| ratio < *CONSISTENT.end()),
        "{inclination:.2?} {heading:.2?}"
    );
}

/// A good accelerometer calibration leaves a bias of 1 mg.
#[test]
fn wz_sd_with_calibrated_accelerometer_is_consistent() {
    assert_consistent_in("wz", "s1?accel_bias_g=0.001", &[], 16);
}

#[test]
fn wz_sd_with_sensor_parameters_is_consistent() {
    assert_consistent_in("wz", "s1", &S1, 16);
    assert_consistent_in("wz", "s1?accel_bias_g=0.001", &[S1[0], S1[1], ("residual_accel_bias_sd_m_s2", 0.01)], 16);
}

fn assert_consistent_in(fuser: &str, name: &str, settings: &[(&str, f64)], seeds: u64) {
    let [inclination, heading] = simulated(fuser, name, settings, seeds);
    assert_consistent(inclination, name);
    // The error of a heading with an arbitrary reference is undefined, so its ratio may be NaN.
    if !heading[0].is_nan() {
        assert_consistent(heading, name);
    }
}

/// Returns the quantile ratios of inclination and heading over several seeds of a scenario.
fn simulated(fuser: &str, name: &str, settings: &[(&str, f64)], seeds: u64) -> [[f64; 2]; 2] {
    let run = |seed: u64| {
        let scenario = Scenario::parse(name).unwrap().with_seed(seed);
        let (mut gyro, mut accel) = (Gyro::from_name("mobius").unwrap(), Accelerometer::default());
        let (mut fuser, mut errors, mut before_s) =
            (Fuser::from_name(fuser).unwrap(), NormalisedErrors::default(), None);
        settings.iter().for_each(|(name, value)| fuser.set(name, *value).unwrap());
        for (t_s, reading) in scenario.readings() {
            let dt_s = t_s - before_s.replace(t_s).unwrap_or(t_s);
            let sample = RateSample { rate_rad_s: reading.rate_rad_s, dt_s, kind: scenario.rate_kind };
            let out = fuser.step(&FuserInput {
                motion: Some(gyro.step(&sample)),
                inclination: Some(accel.step(&reading.force_m_s2)),
                fix: reading.fix,
                rest_credible: true,
                rate_credible: true,
                ..FuserInput::default()
            });
            if t_s > scenario.scored_from_s {
                errors.add(&out, reading.truth.attitude.quaternion());
            }
        }
        errors
    };
    (1..=seeds)
        .map(run)
        .fold(NormalisedErrors::default(), NormalisedErrors::with)
        .ratios(&format!("{fuser}, {name}, {settings:?}"))
}
