//! The simulator of the whole system: what the supervisor decides, and the real slots, over a simulated bus and simulated processes.
//!
//! Input: seeds. Output: one JSON object, and for each seed that fails what was wrong. Time: simulated; the same seed lives through the same.
//! Failure: a seed of which a tick is missing, comes twice, out of order or with other bytes, in which a request stays without an
//! answer, or which does not end.
#![forbid(unsafe_code)]

mod bus;
mod collector;
mod flight;
mod process;
mod random;
mod record;
mod reference;
mod setup;
mod shell;
mod slots;
mod source;
mod world;

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    process::ExitCode,
    sync::{
        Mutex,
        atomic::{AtomicU64, Ordering},
    },
    time::Instant,
};

use clap::Parser;
use serde::Serialize;

use world::World;

/// Simulate a system for each seed and check its output
#[derive(Parser)]
#[command(after_help = "\
Examples:
  simulator --seeds 1000 --threads 2 --json
  simulator --from 42 --seeds 1               # prints each event of the seed")]
struct Arguments {
    /// Number of seeds, 1 to 2^62; a single seed is traced
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u64).range(1..=MAX_SEEDS))]
    seeds: u64,
    /// First seed, 0 to 2^62
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u64).range(..=MAX_SEEDS))]
    from: u64,
    /// Number of threads, 1 to 64
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=64))]
    threads: u64,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// How it went.
#[derive(Debug, Default, Serialize)]
struct Report {
    seeds: u64,
    failed: u64,
    seeds_per_s: f64,
    /// Ticks that came out.
    ticks: u64,
    /// Processes that were started again or beside another.
    restarts: u64,
    /// Swaps that were committed.
    swaps: u64,
    /// Worlds whose bytes could be compared.
    compared: u64,
    /// Seeds that failed, the first of them.
    failures: Vec<u64>,
}

const MAX_FAILURES: usize = 50;
/// So many may be asked for, from any of as many: their sum is a number.
const MAX_SEEDS: u64 = 1 << 62;

fn main() -> ExitCode {
    let Arguments { seeds, from, threads, json } = Arguments::parse();
    let (next, total, begun) = (AtomicU64::new(from), Mutex::new(Report::default()), Instant::now());
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= from + seeds {
                        return;
                    }
                    let outcome = simulate(seed, seeds == 1);
                    let mut report = total.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
                    report.add(seed, outcome);
                }
            });
        }
    });
    let mut report = total.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner());
    report.failures.sort_unstable();
    report.seeds_per_s = report.seeds as f64 / begun.elapsed().as_secs_f64();
    if json {
        println!("{}", serde_json::to_string(&report).unwrap_or_default());
    } else {
        println!("{report:?}");
    }
    ExitCode::from(u8::from(report.failed > 0))
}

/// One world; what was wrong with it, if anything.
fn simulate(seed: u64, verbose: bool) -> Result<World, String> {
    let run = || World::new(seed, verbose)?.run();
    catch_unwind(AssertUnwindSafe(run)).unwrap_or_else(|_| Err("it panicked".into()))
}

impl Report {
    fn add(&mut self, seed: u64, outcome: Result<World, String>) {
        self.seeds += 1;
        match outcome {
            Ok(world) => {
                self.ticks += world.collector.taken.len() as u64;
                self.restarts += world.restarts;
                self.swaps += world.swaps.count;
                self.compared += u64::from(world.setup.strict && !world.is_undecided());
            }
            Err(wrong) => {
                self.failed += 1;
                if self.failures.len() < MAX_FAILURES {
                    self.failures.push(seed);
                    eprintln!("seed {seed}: {wrong}");
                }
            }
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;

    #[test]
    fn nothing_that_befalls_a_system_costs_a_tick_or_leaves_a_request_without_an_answer() {
        let (mut report, seeds) = (Report::default(), 500);
        (0..seeds).for_each(|seed| report.add(seed, simulate(seed, false)));
        assert_eq!((report.seeds, report.failures), (seeds, Vec::new()));
        assert!(report.restarts > seeds && report.swaps > seeds / 10 && report.compared > seeds / 4);
    }

    #[test]
    fn a_seed_lives_through_the_same_again() {
        for seed in 0..20 {
            let [once, again] = [(); 2].map(|()| simulate(seed, false).unwrap());
            assert_eq!((once.now_ms, once.restarts), (again.now_ms, again.restarts), "seed {seed}");
            assert!(once.collector.taken == again.collector.taken, "seed {seed}");
        }
    }
}
