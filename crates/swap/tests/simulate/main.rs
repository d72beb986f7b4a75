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
    let mut tally = Tally::default();
    let mut failures = Vec::new();
    for seed in 0..seeds {
        match std::panic::catch_unwind(|| World::new(seed, false).run()) {
            Ok(Ok(world)) => tally.add(&world),
            Ok(Err(failure)) => failures.push(format!("seed {seed}: {failure}")),
            Err(_) => failures.push(format!("seed {seed}: panic")),
        }
    }
    println!("{seeds} worlds\n{tally}");
    let first: Vec<_> = failures.iter().take(20).map(String::as_str).collect();
    assert!(failures.is_empty(), "{} of {seeds} worlds:\n{}", failures.len(), first.join("\n"));
    if seeds >= SEEDS {
        tally.everything_was_seen();
    }
}

/// A number from the environment.
fn number(name: &str) -> Option<u64> {
    std::env::var(name).ok()?.parse().ok()
}
