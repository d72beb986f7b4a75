//! Simulation of stage swaps. Each seed generates one world with delays, exits, hangs, late
//! decisions and bad candidates.
//!
//! `SWAP_SEED=n cargo test --release -p swap --test simulate -- --nocapture` prints the trace of
//! one seed. `SWAP_SEEDS=n` runs n seeds.
#![allow(clippy::unwrap_used)]

mod check;
mod faults;
mod process;
mod rng;
mod scenario;
mod subscriber;
mod supervisor;
mod world;

use std::{panic, thread};

use check::Statistics;
use world::World;

const SEEDS: u64 = 100_000;

#[test]
fn every_subscriber_gets_every_tick_once_in_order() {
    if let Some(seed) = number("SWAP_SEED") {
        World::new(seed, true).run().unwrap_or_else(|failure| panic!("seed {seed}: {failure}"));
        return;
    }
    let seeds = number("SWAP_SEEDS").unwrap_or(SEEDS);
    let threads = thread::available_parallelism().unwrap().get() as u64;
    let results = thread::scope(|scope| {
        let all: Vec<_> = (0..threads)
            .map(|first| scope.spawn(move || run_worlds((first..seeds).step_by(threads as usize))))
            .collect();
        all.into_iter().map(|each| each.join().unwrap()).collect::<Vec<_>>()
    });
    let (statistics, mut failures) =
        results.into_iter().fold((Statistics::default(), Vec::new()), |(statistics, failures), (more, failed)| {
            (statistics.merged(more), [failures, failed].concat())
        });
    println!("{seeds} worlds\n{statistics}");
    failures.sort();
    let first: Vec<_> = failures.iter().take(20).map(|(seed, failure)| format!("seed {seed}: {failure}")).collect();
    assert!(failures.is_empty(), "{} of {seeds} worlds:\n{}", failures.len(), first.join("\n"));
    if seeds >= SEEDS {
        statistics.assert_all_cases_covered();
    }
}

/// Runs the worlds of `seeds`. Returns their statistics and failures.
fn run_worlds(seeds: impl Iterator<Item = u64>) -> (Statistics, Vec<(u64, String)>) {
    let mut statistics = Statistics::default();
    let mut failures = Vec::new();
    for seed in seeds {
        match panic::catch_unwind(|| World::new(seed, false).run()) {
            Ok(Ok(world)) => statistics.add(&world),
            Ok(Err(failure)) => failures.push((seed, failure)),
            Err(_) => failures.push((seed, "panic".into())),
        }
    }
    (statistics, failures)
}

/// Returns the number in an environment variable.
fn number(name: &str) -> Option<u64> {
    std::env::var(name).ok()?.parse().ok()
}
