//! A system whose stages are swapped, many times over: one seed is one world of delays, deaths, hangs, late decisions and bad candidates.
//!
//! `SWAP_SEED=n cargo test --release -p swap --test simulate -- --nocapture` tells the history of one; `SWAP_SEEDS=n` lives through n.
#![allow(clippy::unwrap_used)]

mod chance;
mod check;
mod faults;
mod nature;
mod process;
mod reader;
mod supervisor;
mod world;

use std::{panic, thread};

use check::Tally;
use world::World;

const SEEDS: u64 = 100_000;

#[test]
fn every_reader_gets_every_tick_once_and_in_order_whatever_happens_to_the_swap() {
    if let Some(seed) = number("SWAP_SEED") {
        World::new(seed, true).run().unwrap_or_else(|failure| panic!("seed {seed}: {failure}"));
        return;
    }
    let seeds = number("SWAP_SEEDS").unwrap_or(SEEDS);
    let threads = thread::available_parallelism().unwrap().get() as u64;
    let lived = thread::scope(|scope| {
        let all: Vec<_> =
            (0..threads).map(|first| scope.spawn(move || live((first..seeds).step_by(threads as usize)))).collect();
        all.into_iter().map(|each| each.join().unwrap()).collect::<Vec<_>>()
    });
    let (tally, mut failures) =
        lived.into_iter().fold((Tally::default(), Vec::new()), |(tally, failures), (more, failed)| {
            (tally.with(more), [failures, failed].concat())
        });
    println!("{seeds} worlds\n{tally}");
    failures.sort();
    let first: Vec<_> = failures.iter().take(20).map(|(seed, failure)| format!("seed {seed}: {failure}")).collect();
    assert!(failures.is_empty(), "{} of {seeds} worlds:\n{}", failures.len(), first.join("\n"));
    if seeds >= SEEDS {
        tally.everything_was_seen();
    }
}

/// Lives through worlds: what was met, and what failed.
fn live(seeds: impl Iterator<Item = u64>) -> (Tally, Vec<(u64, String)>) {
    let mut tally = Tally::default();
    let mut failures = Vec::new();
    for seed in seeds {
        match panic::catch_unwind(|| World::new(seed, false).run()) {
            Ok(Ok(world)) => tally.add(&world),
            Ok(Err(failure)) => failures.push((seed, failure)),
            Err(_) => failures.push((seed, "panic".into())),
        }
    }
    (tally, failures)
}

/// A number from the environment.
fn number(name: &str) -> Option<u64> {
    std::env::var(name).ok()?.parse().ok()
}
