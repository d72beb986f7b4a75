//! The standard deviations that are told: errors over them, 68 % and 95 % quantiles over those of a normal error.
//!
//! `cargo test --release -p attitude deviations:: -- --nocapture` prints every figure. Input: the trials of BROAD, the crossed ones, the
//! cruise scenarios. Failure: without the recordings those are not tested, and the test says so.
use attitude::{
    Quaternion,
    accel::Projector,
    course::CourseReference,
    fuser::{Fused, Fuser, FuserInput},
    gyro::{Gyro, RateSample},
    stage::Stage,
};
use scenario::Scenario;

use crate::heading::{
    CLEAN,
    crossed::crossed,
    trial::{Chain, trials, truth},
};

/// Quantiles of 68 % and 95 % of an error of one axis, and of the length of two, in deviations of one.
const ONE_AXIS: [f64; 2] = [1.0, 2.0];
const TWO_AXES: [f64; 2] = [1.51, 2.45];
/// Where they are true.
const TRUE: core::ops::RangeInclusive<f64> = 0.7..=1.4;

/// Errors over their deviations.
#[derive(Default)]
struct Normalised {
    inclination: Vec<f64>,
    heading: Vec<f64>,
}

impl Normalised {
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

    /// Over the ideal: inclination at 68 % and 95 %, heading.
    fn told(mut self, name: &str) -> [[f64; 2]; 2] {
        let told = [quantiles(&mut self.inclination, TWO_AXES), quantiles(&mut self.heading, ONE_AXIS)];
        println!("{name}: inclination {:.2?}, heading {:.2?}", told[0], told[1]);
        told
    }
}

/// None are told of no error.
fn quantiles(errors: &mut [f64], ideal: [f64; 2]) -> [f64; 2] {
    if errors.is_empty() {
        return [f64::NAN; 2];
    }
    errors.sort_by(f64::total_cmp);
    let at = |share: f64| errors[(share * (errors.len() - 1) as f64) as usize];
    [at(0.68) / ideal[0], at(0.95) / ideal[1]]
}

fn assert_true(told: [f64; 2], of: &str) {
    assert!(told.iter().all(|quantile| TRUE.contains(quantile)), "{of}: {told:.2?}");
}

#[test]
fn those_of_wz_are_true_on_broad_and_on_crossed_trials() {
    let Some(trials) = trials() else { return };
    let of = |rows: &[recording::Row]| {
        let (mut chain, mut errors) = (Chain::new(), Normalised::default());
        for row in rows {
            let out = chain.step(row);
            if let Some(q) = truth(row).filter(|_| row.reference.is_some_and(|reference| reference.scored)) {
                errors.add(&out, q);
            }
        }
        errors
    };
    // Of 27 the field points elsewhere by 6° while the body moves than while it rests, which nothing on board tells.
    let solvable = trials.iter().filter(|trial| trial.number() != "27");
    let open =
        solvable.map(|trial| of(&trial.rows)).fold(Normalised::default(), Normalised::with).told("wz, nine of BROAD");
    let all = trials
        .iter()
        .map(|trial| of(&trial.rows))
        .fold(Normalised::default(), Normalised::with)
        .told("wz, all of BROAD");
    let places: Vec<_> = trials.iter().filter(|trial| CLEAN.contains(&trial.number())).collect();
    let pairs = trials.iter().flat_map(|movement| places.iter().map(move |place| (movement, place)));
    let crossed = pairs.map(|(movement, place)| of(&crossed(movement, place, 1)));
    let crossed = crossed.fold(Normalised::default(), Normalised::with).told("wz, crossed");
    assert_true(all[0], "inclination on BROAD");
    assert_true(open[1], "heading on nine of BROAD");
    assert_true(crossed[0], "inclination, crossed");
    assert_true(crossed[1], "heading, crossed");
}

/// What `aided` is told of the sensors of `cruise`: 0.005 °/√s and ±0.05 °/s that stay, 0.002 m/s/√s and ±0.02 m/s² that stay, no scale error.
const CRUISE: [(&str, f64); 7] = [
    ("gyro_noise_deg_sqrt_s", 0.005),
    ("gyro_bias_sd_deg_s", 0.05),
    ("gyro_bias_walk_deg_s_sqrt_s", 0.0),
    ("accel_noise_m_s_sqrt_s", 0.002),
    ("accel_bias_sd_m_s2", 0.02),
    ("accel_bias_walk_m_s2_sqrt_s", 0.0),
    ("scale_noise", 0.0),
];
/// Of `cruise-hard`: the same with a scale error of 1 % and a bias that drifts.
const CRUISE_HARD: [(&str, f64); 5] = [CRUISE[0], CRUISE[1], CRUISE[3], CRUISE[4], ("scale_noise", 0.003)];
/// What `wz` is told of the sensors of `s1`, which have a constant bias of the gyro and white noise of the accelerometer alone.
const S1: [(&str, f64); 3] =
    [("level_noise_deg_sqrt_s", 0.0001), ("gyro_bias_walk_deg_s_sqrt_s", 0.0), ("residual_accel_bias_sd_m_s2", 0.0)];

#[test]
fn those_of_aided_are_true_on_cruise_flights() {
    for name in ["cruise", "cruise?gnss=gaps", "cruise-hard", "cruise-hard?gnss_noise_m_s=0.2"] {
        assert_true_of("aided", name, &[], 6);
    }
}

#[test]
fn those_of_aided_are_true_where_it_is_told_of_its_sensors() {
    let told = |name: &str, of: &[(&str, f64)], receiver_m_s: f64| {
        assert_true_of("aided", name, &[of, &[("velocity_sd_m_s", receiver_m_s)]].concat(), 6);
    };
    told("cruise", &CRUISE, 0.05);
    told("cruise?gnss=gaps", &CRUISE, 0.05);
    told("cruise?gnss_noise_m_s=0.2", &CRUISE, 0.2);
    told("cruise?gnss=never", &CRUISE, 0.2);
    told("cruise-hard", &CRUISE_HARD, 0.15);
    told("cruise-hard?gnss=gaps", &CRUISE_HARD, 0.15);
    told("cruise-hard?gnss=never", &CRUISE_HARD, 0.2);
}

/// Innovations of a receiver that is better than `aided` is told say nothing of a gyro that it was told of.
#[test]
fn those_of_aided_are_not_too_small_where_it_is_told_of_its_gyro_alone() {
    let [inclination, heading] = simulated("aided", "cruise", &CRUISE, 3);
    assert!(
        inclination.into_iter().chain(heading).all(|quantile| quantile < *TRUE.end()),
        "{inclination:.2?} {heading:.2?}"
    );
}

/// 1 mg is what a good calibration of an accelerometer leaves.
#[test]
fn those_of_wz_are_true_behind_a_calibrated_accelerometer() {
    assert_true_of("wz", "s1?accel_bias_g=0.001", &[], 16);
}

#[test]
fn those_of_wz_are_true_where_it_is_told_of_its_sensors() {
    assert_true_of("wz", "s1", &S1, 16);
    assert_true_of("wz", "s1?accel_bias_g=0.001", &[S1[0], S1[1], ("residual_accel_bias_sd_m_s2", 0.01)], 16);
}

fn assert_true_of(fuser: &str, name: &str, settings: &[(&str, f64)], seeds: u64) {
    let [inclination, heading] = simulated(fuser, name, settings, seeds);
    assert_true(inclination, name);
    // A heading that is counted from nowhere has no error.
    if !heading[0].is_nan() {
        assert_true(heading, name);
    }
}

/// Of so many seeds of a scenario.
fn simulated(fuser: &str, name: &str, settings: &[(&str, f64)], seeds: u64) -> [[f64; 2]; 2] {
    let run = |seed: u64| {
        let scenario = Scenario::parse(name).unwrap().with_seed(seed);
        let (mut gyro, mut accel) = (Gyro::from_name("mobius").unwrap(), Projector::default());
        let (mut fuser, mut errors, mut before_s) = (Fuser::from_name(fuser).unwrap(), Normalised::default(), None);
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
    (1..=seeds).map(run).fold(Normalised::default(), Normalised::with).told(&format!("{fuser}, {name}, {settings:?}"))
}
