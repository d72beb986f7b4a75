//! `wz` with nine axes on the trials of BROAD, beside VQF: `cargo test --release -p attitude --test heading -- --nocapture`.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod stress;
mod trial;

use stress::Kind;
use trial::{Errors, of_vqf, of_wz, trials};

/// Trials without a magnetic disturbance of their own.
const CLEAN: [&str; 6] = ["02", "04", "07", "11", "15", "24"];

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

#[test]
fn heading_is_better_than_that_of_vqf() {
    let Some(trials) = trials() else { return };
    let (mut ours, mut theirs) = (Vec::new(), Vec::new());
    println!("RMSE, degrees: total, heading, inclination of wz; of VQF 9D");
    for trial in &trials {
        ours.push(of_wz(&trial.rows, 0.0));
        theirs.push(of_vqf(&trial.rows, 0.0));
        println!("{} | {} | {}", ours[ours.len() - 1], theirs[theirs.len() - 1], trial.name);
    }
    for (i, trial) in trials.iter().enumerate() {
        let rest = |all: &[Errors]| Errors::mean(&[&all[..i], &all[i + 1..]].concat());
        println!("{} | {} | mean without {}", rest(&ours), rest(&theirs), trial.number());
        assert!(rest(&ours).total < rest(&theirs).total, "without {}", trial.name);
    }
    let (ours, theirs) = (Errors::mean(&ours), Errors::mean(&theirs));
    println!("{ours} | {theirs} | mean");
    assert!(ours.total < 2.06 && ours.heading < 1.90, "{ours}");
}

#[test]
fn magnets_are_told_from_the_field_of_the_place() {
    let Some(trials) = trials() else { return };
    for (kind, limit_deg) in Kind::ALL.into_iter().zip([2.1, 2.3, 7.5, 2.6, 2.4]) {
        let (mut ours, mut theirs) = (Vec::new(), Vec::new());
        for trial in trials.iter().filter(|trial| CLEAN.contains(&trial.number())) {
            for seed in 1..=4 {
                let rows = stress::disturbed(trial, kind, seed);
                ours.push(of_wz(&rows, 0.0).heading);
                theirs.push(of_vqf(&rows, 0.0).heading);
            }
        }
        let most = |all: &[f64]| all.iter().copied().fold(0.0, f64::max);
        println!(
            "{kind:?}: heading of wz {:.2}° (most {:.1}°), of VQF {:.2}° (most {:.1}°)",
            mean(&ours),
            most(&ours),
            mean(&theirs),
            most(&theirs)
        );
        assert!(mean(&ours) < limit_deg, "{kind:?}: {}°", mean(&ours));
    }
}

#[test]
fn a_start_in_the_middle_of_the_movement_is_survived() {
    let Some(trials) = trials() else { return };
    for unscored_s in [0.0, 20.0] {
        let (mut ours, mut theirs) = (Vec::new(), Vec::new());
        for trial in &trials {
            let (from, to) = trial.movement();
            let rows = &trial.rows[(from + to) / 2..];
            ours.push(of_wz(rows, unscored_s));
            theirs.push(of_vqf(rows, unscored_s));
            println!("{} | {} | {}", ours[ours.len() - 1], theirs[theirs.len() - 1], trial.name);
        }
        let (ours, theirs) = (Errors::mean(&ours), Errors::mean(&theirs));
        println!("{ours} | {theirs} | mean from {unscored_s} s after the start");
        assert!(unscored_s == 0.0 || ours.total < theirs.total, "{ours}");
    }
}
