//! `wz` with nine axes on the trials of BROAD, beside VQF: `cargo test --release -p attitude --test broad -- --nocapture`.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod stress;
mod trial;

use stress::Kind;
use trial::{Errors, of_vqf, of_wz, trials};

/// Trials without a magnetic disturbance of their own.
const CLEAN: [&str; 6] = ["02", "04", "07", "11", "15", "24"];

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
    println!("{} | {} | mean", Errors::mean(&ours), Errors::mean(&theirs));
}

#[test]
fn magnets_are_told_from_the_field_of_the_place() {
    let Some(trials) = trials() else { return };
    for kind in Kind::ALL {
        let (mut ours, mut theirs) = (Vec::new(), Vec::new());
        for trial in trials.iter().filter(|trial| CLEAN.contains(&trial.number())) {
            for seed in 1..=4 {
                let rows = stress::disturbed(trial, kind, seed);
                ours.push(of_wz(&rows, 0.0).heading);
                theirs.push(of_vqf(&rows, 0.0).heading);
            }
        }
        let mean = |all: &[f64]| all.iter().sum::<f64>() / all.len() as f64;
        let most = |all: &[f64]| all.iter().copied().fold(0.0, f64::max);
        println!(
            "{kind:?}: wz {:.2} (most {:.1}), VQF {:.2} (most {:.1})",
            mean(&ours),
            most(&ours),
            mean(&theirs),
            most(&theirs)
        );
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
            print!("{:.1} ", ours[ours.len() - 1].total);
        }
        println!("\nafter {unscored_s} s: {} | {}", Errors::mean(&ours), Errors::mean(&theirs));
    }
}

#[test]
fn cost() {
    let Some(trials) = trials() else { return };
    let rows = &trials[2].rows[..];
    if std::env::var("CG").is_ok() {
        return trial::collected(&rows[20000..30000]);
    }
    let time = |run: &mut dyn FnMut()| {
        (0..7)
            .map(|_| {
                let start = std::time::Instant::now();
                run();
                start.elapsed().as_nanos() as f64 / rows.len() as f64
            })
            .fold(f64::INFINITY, f64::min)
    };
    let blind: Vec<_> = rows.iter().map(|row| recording::Row { field_ut: None, ..*row }).collect();
    let mut sink = 0.0;
    let nine = time(&mut || {
        let mut chain = trial::Chain::new();
        rows.iter().for_each(|row| sink += chain.step(row).attitude.z_rad);
    });
    let six = time(&mut || {
        let mut chain = trial::Chain::new();
        blind.iter().for_each(|row| sink += chain.step(row).attitude.z_rad);
    });
    let vqf = time(&mut || {
        let mut vqf = vqf_rs::VQF::new(trial::DT_S, None, None, None);
        rows.iter().for_each(|row| {
            vqf.update(row.rate_rad_s, row.force_m_s2, row.field_ut);
            sink += vqf.quat_9d().0
        });
    });
    println!("ns: 9D {nine:.1}, 6D {six:.1}, heading {:.1}, VQF {vqf:.1}; ratio {:.2} {sink}", nine - six, nine / vqf);
}
