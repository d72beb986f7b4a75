//! Errors of the default fuser, `wz`, `vqf` and `madgwick` on every set of recordings.
//!
//! `cargo test --release -p plumbline-attitude sets:: -- --nocapture` prints the table: per set the
//! mean RMSE of inclination and heading, the normalised errors, and the trials that are worse than
//! with VQF.
//!
//! Input: the folders `broad`, `tumvi` and `phones` of `$PLUMBLINE_DATA` or `../shared/data`.
//!
//! Failure: without the recordings the test is skipped with a message.
mod recorded;
mod scores;

use recorded::{Recording, SETS, recordings};
use scores::{Scores, SetScores, mean, run};

/// Stages in the table. The first is the default, the last two are published filters for
/// comparison.
const STAGES: [&str; 4] = ["multiple-model", "wz", "vqf", "madgwick"];
const VQF: usize = 2;

/// Runs every stage on every recording, on two threads.
fn scores_of(recordings: &[Recording]) -> Vec<[Scores; STAGES.len()]> {
    let halves: Vec<Vec<_>> = std::thread::scope(|scope| {
        let half = |odd: usize| {
            let own = recordings.iter().skip(odd).step_by(2);
            scope.spawn(move || own.map(|recording| STAGES.map(|stage| run(stage, recording))).collect())
        };
        let threads = [half(0), half(1)];
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    let [mut even, mut odd] = <[Vec<_>; 2]>::try_from(halves).unwrap().map(Vec::into_iter);
    (0..recordings.len()).map(|i| if i % 2 == 0 { even.next() } else { odd.next() }.unwrap()).collect()
}

/// Asserts that the normalised errors of a set, or of all sets, are within limits.
fn assert_honest(name: &str, scores: &SetScores, limits: core::ops::RangeInclusive<f64>) {
    let ratios = scores.inclination_ratios.into_iter().chain(scores.heading_ratios);
    // Without a magnetometer there is no heading error, so its ratio is NaN.
    let dishonest = ratios.filter(|ratio| !ratio.is_nan()).find(|ratio| !limits.contains(ratio));
    assert_eq!(dishonest, None, "{name}: {scores}");
}

#[::recorded::test]
fn default_fuser_on_open_sets() {
    let Some(recordings) = recordings() else { return };
    let scores = scores_of(recordings);
    let mut worse = Vec::new();
    println!("mean RMSE, degrees: inclination, heading; normalised errors: 68 %, 95 % of each");
    for (set, spec) in SETS.iter().enumerate() {
        let of_set = || recordings.iter().zip(&scores).filter(|(recording, _)| recording.set == set);
        for (i, stage) in STAGES.iter().enumerate() {
            let all: Vec<_> = of_set().map(|(_, scores)| &scores[i]).collect();
            let means = mean(&all);
            println!("{:16} {stage:15} {means}", spec.name);
            if i == 0 {
                let [total, heading, inclination] = spec.limits_deg;
                assert!(means.inclination < inclination, "{}: inclination {}°", spec.name, means.inclination);
                assert!(!(means.heading > heading || means.total > total), "{}: {means}", spec.name);
                assert_honest(spec.name, &means, 0.5..=2.0);
            }
        }
        for (recording, scores) in of_set() {
            let (own, vqf) = (&scores[0], &scores[VQF]);
            for (what, own, vqf) in
                [("inclination", own.inclination, vqf.inclination), ("heading", own.heading, vqf.heading)]
            {
                if own > vqf + f64::max(0.3, 0.15 * vqf) {
                    worse.push(format!("{}: {what} {own:.2}°, VQF {vqf:.2}°", recording.name));
                }
            }
        }
    }
    let all = mean(&scores.iter().map(|scores| &scores[0]).collect::<Vec<_>>());
    println!("{:16} {:15} {all}", "all", STAGES[0]);
    assert_honest("all", &all, 0.7..=1.6);
    assert_eq!(worse, Vec::<String>::new(), "worse than VQF by more than 0.3° and 15 %");
}

/// Adds a gyro bias in °/s to each recording of a set.
fn with_bias(set: &str, bias_deg_s: [f64; 3]) -> Option<Vec<Recording>> {
    let biased = recordings()?.iter().filter(|recording| SETS[recording.set].name == set).map(|recording| {
        let mut rows = recording.rows.clone();
        for row in &mut rows {
            row.rate_rad_s.iter_mut().zip(bias_deg_s).for_each(|(rate, bias)| *rate += bias.to_radians());
        }
        Recording { set: recording.set, name: recording.name.clone(), rows }
    });
    Some(biased.collect())
}

/// The trials of BROAD begin at rest, those of TUM VI in motion. With a bias of 3 to 4 °/s, turns
/// are detected with the bias from `aided`, and a few seconds of BROAD are mistaken for a turn.
#[test]
fn large_gyro_bias_is_found() {
    for (set, bias_deg_s, (max_inclination_deg, max_heading_deg)) in [
        ("BROAD", [10.0, 10.0, -10.0], (0.56, Some(1.75))),
        ("BROAD", [3.0, -4.0, 2.5], (0.65, Some(1.75))),
        ("TUM VI", [3.0, -3.0, 3.0], (1.7, None)),
        ("TUM VI", [10.0, 10.0, -10.0], (7.5, None)),
        ("Nexus 5 calm", [10.0, 10.0, -10.0], (5.2, Some(9.5))),
    ] {
        let Some(recordings) = with_bias(set, bias_deg_s) else { return };
        let scores = scores_of(&recordings);
        let mean_of = |stage: usize| mean(&scores.iter().map(|scores| &scores[stage]).collect::<Vec<_>>());
        let means = mean_of(0);
        println!("{set} with {bias_deg_s:?} °/s: {means}; VQF {}", mean_of(VQF));
        assert!(means.inclination < max_inclination_deg, "{set} with {bias_deg_s:?} °/s: {means}");
        assert!(
            max_heading_deg.is_none_or(|max_deg| means.heading < max_deg),
            "{set} with {bias_deg_s:?} °/s: {means}"
        );
    }
}

/// Time by which a bias must be found in motion, s.
const FOUND_S: f64 = 60.0;

/// Biases of 10 °/s about each axis of the sensor, and on all axes with every combination of signs.
fn biases_of_10_deg_s() -> Vec<[f64; 3]> {
    let signs = (0..8).map(|signs| [0, 1, 2].map(|axis| if signs >> axis & 1 == 0 { 10.0 } else { -10.0 }));
    let axes = (0..3).flat_map(|axis| [10.0, -10.0].map(|rate| [0, 1, 2].map(|i| if i == axis { rate } else { 0.0 })));
    signs.chain(axes).collect()
}

/// With a magnetometer, a large bias about the vertical axis is also found. The local magnetic
/// fields of the building limit the accuracy. The person starts to walk with the first sample.
#[::recorded::test]
fn large_bias_in_motion_is_found_within_60_s() {
    let Some(unbiased) = with_bias("Nexus 5 calm", [0.0; 3]) else { return };
    let own_rad_s: Vec<_> = unbiased.iter().map(|own| scores::bias_at(STAGES[0], own, f64::INFINITY)).collect();
    for bias_deg_s in biases_of_10_deg_s() {
        let recordings = with_bias("Nexus 5 calm", bias_deg_s).unwrap();
        let error_deg_s = |(biased, own_rad_s): (&Recording, &attitude::Vector3<f64>)| {
            let found_rad_s = scores::bias_at(STAGES[0], biased, FOUND_S) - own_rad_s;
            (found_rad_s.map(f64::to_degrees) - attitude::Vector3::from(bias_deg_s)).amax()
        };
        let errors: Vec<_> = recordings.iter().zip(&own_rad_s).map(error_deg_s).collect();
        println!("{bias_deg_s:?} °/s: bias error after {FOUND_S} s {errors:.2?} °/s");
        assert!(errors.iter().all(|error| *error < 1.5), "{bias_deg_s:?} °/s: {errors:.2?}");
    }
}
