//! Attitude of `wz` with nine axes on the trials of BROAD, compared with VQF.
//!
//! `cargo test --release -p plumbline-attitude heading:: -- --nocapture` prints every figure.
pub(crate) mod crossed;
mod rng;
mod stress;
pub(crate) mod trial;

use attitude::{Vector3, fuser::GyroScale};
use recording::Row;
use stress::Disturbance;
use trial::{Errors, Trial, trials, vqf_errors, wz_errors, wz_errors_with_scale};

/// Numbers of the trials without magnetic disturbance.
pub(crate) const CLEAN: [&str; 6] = ["02", "04", "07", "11", "15", "24"];

/// Kinds of trials. Each kind is given by words that occur in the names of its trials.
///
/// A rotation with breaks belongs only to the kind `with_breaks`.
const KINDS: [&[&str]; 7] = [
    &["undisturbed", "rotation"],
    &["undisturbed", "translation"],
    &["with_breaks"],
    &["tapping"],
    &["vibration"],
    &["stationary_magnet"],
    &["attached_magnet"],
];

fn is_of_kind(trial: &Trial, kind: &[&str]) -> bool {
    let breaks = trial.name.contains("with_breaks");
    kind.iter().all(|word| trial.name.contains(word)) && (!breaks || kind.contains(&"with_breaks"))
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

#[recorded::test]
fn wz_heading_on_broad_beats_vqf() {
    let Some(trials) = trials() else { return };
    let (mut wz, mut vqf) = (Vec::new(), Vec::new());
    println!("RMSE, degrees: total, heading, inclination of wz; of VQF 9D");
    for trial in trials {
        wz.push(wz_errors(&trial.rows, 0.0));
        vqf.push(vqf_errors(&trial.rows, 0.0));
        println!("{} | {} | {}", wz[wz.len() - 1], vqf[vqf.len() - 1], trial.name);
    }
    for (trial, (wz, vqf)) in trials.iter().zip(wz.iter().zip(&vqf)) {
        assert!(wz.total <= vqf.total + 0.15, "{}: {wz}, VQF {vqf}", trial.name);
    }
    for (i, trial) in trials.iter().enumerate() {
        let mean_without = |all: &[Errors]| Errors::mean(&[&all[..i], &all[i + 1..]].concat());
        println!("{} | {} | mean without {}", mean_without(&wz), mean_without(&vqf), trial.number());
        assert!(mean_without(&wz).total < mean_without(&vqf).total, "without {}", trial.name);
    }
    for kind in KINDS {
        let mean_without = |all: &[Errors]| {
            let others = trials.iter().zip(all).filter(|(trial, _)| !is_of_kind(trial, kind));
            Errors::mean(&others.map(|(_, errors)| *errors).collect::<Vec<_>>())
        };
        println!("{} | {} | mean without {}", mean_without(&wz), mean_without(&vqf), kind.join(" and "));
        assert!(mean_without(&wz).total < mean_without(&vqf).total, "without {kind:?}");
    }
    let (wz, vqf) = (Errors::mean(&wz), Errors::mean(&vqf));
    println!("{wz} | {vqf} | mean");
    assert!(wz.total <= 1.80 && wz.heading <= 1.65, "{wz}");
}

#[recorded::test]
fn wz_heading_with_magnets_stays_within_limits() {
    let Some(trials) = trials() else { return };
    for (kind, limit_deg) in Disturbance::ALL.into_iter().zip([2.0, 1.91, 7.5, 1.37, 1.4]) {
        let (mut wz, mut vqf) = (Vec::new(), Vec::new());
        for trial in trials.iter().filter(|trial| CLEAN.contains(&trial.number())) {
            for seed in 1..=4 {
                let rows = stress::disturbed(trial, kind, seed);
                wz.push(wz_errors(&rows, 0.0).heading);
                vqf.push(vqf_errors(&rows, 0.0).heading);
            }
        }
        let max = |all: &[f64]| all.iter().copied().fold(0.0, f64::max);
        println!(
            "{kind:?}: heading of wz {:.2}° (max {:.1}°), of VQF {:.2}° (max {:.1}°)",
            mean(&wz),
            max(&wz),
            mean(&vqf),
            max(&vqf)
        );
        assert!(mean(&wz) < limit_deg, "{kind:?}: {}°", mean(&wz));
    }
}

#[recorded::test]
fn wz_started_in_motion_beats_vqf() {
    let Some(trials) = trials() else { return };
    for unscored_s in [0.0, 20.0] {
        let (mut wz, mut vqf) = (Vec::new(), Vec::new());
        for trial in trials {
            let (from, to) = trial.movement();
            let rows = &trial.rows[(from + to) / 2..];
            wz.push(wz_errors(rows, unscored_s));
            vqf.push(vqf_errors(rows, unscored_s));
            println!("{} | {} | {}", wz[wz.len() - 1], vqf[vqf.len() - 1], trial.name);
        }
        let (wz, vqf) = (Errors::mean(&wz), Errors::mean(&vqf));
        println!("{wz} | {vqf} | mean from {unscored_s} s after the start");
        assert!(wz.total < vqf.total && wz.heading < vqf.heading, "{wz}");
        assert!(wz.inclination < vqf.inclination + 0.005, "{wz}");
    }
}

#[recorded::test]
fn wz_on_crossed_trials_beats_vqf() {
    let Some(trials) = trials() else { return };
    let (mut wz, mut vqf) = (Vec::new(), Vec::new());
    for movement in trials {
        for place in trials.iter().filter(|trial| CLEAN.contains(&trial.number())) {
            let rows = crossed::crossed_rows(movement, place, 1);
            wz.push(wz_errors(&rows, 0.0));
            vqf.push(vqf_errors(&rows, 0.0));
        }
        let mean_of_movement = |all: &[Errors]| Errors::mean(&all[all.len() - CLEAN.len()..]);
        println!("{} | {} | {}", mean_of_movement(&wz), mean_of_movement(&vqf), movement.name);
    }
    let (wz, vqf) = (Errors::mean(&wz), Errors::mean(&vqf));
    println!("{wz} | {vqf} | mean of 60 crossed trials");
    assert!(wz.total <= 1.50 && wz.total < vqf.total, "{wz}");
}

/// Emulates warm starts. Each trial starts with the gyro scale found in an earlier trial.
///
/// The earlier scale is assumed to be accurate to 0.2 %.
///
/// Crossed trials all have different gyro errors, so an earlier scale cannot help. There, the scale
/// must only not increase the error.
#[recorded::test]
fn kept_gyro_scale_reduces_wz_error() {
    let Some(trials) = trials() else { return };
    let places: Vec<_> = trials.iter().filter(|trial| CLEAN.contains(&trial.number())).collect();
    let recorded: Vec<_> = trials.iter().map(|trial| trial.rows.clone()).collect();
    let pairs = trials.iter().flat_map(|movement| places.iter().map(move |place| (movement, place)));
    let crossed: Vec<_> = pairs.map(|(movement, place)| crossed::crossed_rows(movement, place, 1)).collect();
    for (name, rows, max_ratio) in [("recorded", &recorded, 0.99), ("crossed", &crossed, 1.0)] {
        let (cold, warm) = (mean_errors(rows, false), mean_errors(rows, true));
        println!("{cold} cold | {warm} with the scale of the trial before | {name}");
        assert!(warm.total < max_ratio * cold.total, "{name}: {warm}, cold {cold}");
    }
}

/// Returns the mean errors of `wz`. If `keeps_scale`, each trial starts with the scale found in
/// earlier trials.
fn mean_errors(trials: &[Vec<Row>], keeps_scale: bool) -> Errors {
    let mut scale = GyroScale::UNKNOWN;
    let errors = trials.iter().map(|rows| {
        let (errors, found) = wz_errors_with_scale(rows, scale);
        if keeps_scale && found.sd.min() < 0.0015 {
            scale = GyroScale { sd: Vector3::repeat(0.002), ..found };
        }
        errors
    });
    Errors::mean(&errors.collect::<Vec<_>>())
}
