//! Errors of the default fuser, `wz`, `vqf` and `madgwick` on every set of recordings.
//!
//! `cargo test --release -p attitude sets:: -- --nocapture` prints the table: per set the mean RMSE
//! of inclination and heading, the normalised errors, and the trials that are worse than with VQF.
//!
//! Input: the folders `broad`, `tumvi` and `phones` of `$PLUMBLINE_DATA` or `../shared/data`.
//!
//! Failure: without the recordings the test is skipped with a message.
mod recorded;
mod scores;

use recorded::{Recording, SETS, recordings};
use scores::{Scores, mean, run};

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

#[test]
fn default_fuser_on_open_sets() {
    let Some(recordings) = recordings() else { return };
    let scores = scores_of(recordings);
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
            }
        }
        for (recording, scores) in of_set() {
            let (own, vqf) = (&scores[0], &scores[VQF]);
            for (what, own, vqf) in
                [("inclination", own.inclination, vqf.inclination), ("heading", own.heading, vqf.heading)]
            {
                if spec.name != "BROAD" && own > vqf + f64::max(0.3, 0.15 * vqf) {
                    println!("  {}: {what} {own:.2}°, VQF {vqf:.2}°", recording.name);
                }
            }
        }
    }
}
