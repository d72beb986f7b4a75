//! Simulator of the whole system: the supervisor's core and the real slots, with a simulated bus
//! and simulated processes.
//!
//! Input: seeds.
//!
//! Output: a summary of all seeds, and the cause of each failure.
//!
//! Time: simulated. A seed always produces the same run.
//!
//! Failure: a seed fails if a tick is missing, repeated, out of order or different from the
//! reference run, if a request does not receive exactly one reply, if the system does not stop, or
//! if a sender without measurements is chosen or stays chosen.
#![forbid(unsafe_code)]

mod bus;
mod collector;
mod flight;
mod process;
mod random;
mod record;
mod reference;
mod senders;
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
    /// Number of seeds, 1 to 2^62; a single seed also prints its events
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

/// Summary of all seeds.
#[derive(Debug, Default, Serialize)]
struct Report {
    seeds: u64,
    failed: u64,
    seeds_per_s: f64,
    /// Number of ticks received by the collector.
    ticks: u64,
    /// Number of processes started after the initial ones, either as restarts or as candidates.
    restarts: u64,
    /// Number of committed swaps.
    swaps: u64,
    /// Number of runs in which the output was compared byte by byte with a reference run.
    compared: u64,
    /// Failed seeds, at most `MAX_FAILURES`.
    failures: Vec<u64>,
}

const MAX_FAILURES: usize = 50;
/// Upper limit for both the number of seeds and the first seed. It is small enough that their sum
/// fits into a `u64`.
const MAX_SEEDS: u64 = 1 << 62;

fn main() -> ExitCode {
    let Arguments { seeds, from, threads, json } = Arguments::parse();
    let (next, total, started) = (AtomicU64::new(from), Mutex::new(Report::default()), Instant::now());
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
    report.seeds_per_s = report.seeds as f64 / started.elapsed().as_secs_f64();
    if json {
        println!("{}", serde_json::to_string(&report).unwrap_or_default());
    } else {
        println!("{report:?}");
    }
    ExitCode::from(u8::from(report.failed > 0))
}

/// Simulates one seed. Returns the cause if the run fails.
fn simulate(seed: u64, verbose: bool) -> Result<World, String> {
    let run = || {
        senders::simulate(seed)?;
        World::new(seed, verbose)?.run()
    };
    catch_unwind(AssertUnwindSafe(run)).unwrap_or_else(|_| Err("the simulation panicked".into()))
}

impl Report {
    fn add(&mut self, seed: u64, outcome: Result<World, String>) {
        self.seeds += 1;
        match outcome {
            Ok(world) => {
                self.ticks += world.collector.attitudes.len() as u64;
                self.restarts += world.restarts;
                self.swaps += world.swaps.count;
                self.compared += u64::from(world.setup.strict && !world.is_ambiguous());
            }
            Err(error) => {
                self.failed += 1;
                if self.failures.len() < MAX_FAILURES {
                    self.failures.push(seed);
                    eprintln!("seed {seed}: {error}");
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_cost_no_tick_and_every_request_is_answered() {
        let (mut report, seeds) = (Report::default(), 500);
        (0..seeds).for_each(|seed| report.add(seed, simulate(seed, false)));
        assert_eq!((report.seeds, report.failures), (seeds, Vec::new()));
        assert!(report.restarts > seeds && report.swaps > seeds / 10 && report.compared > seeds / 4);
    }

    #[test]
    fn same_seed_gives_same_run() {
        for seed in 0..20 {
            let [once, again] = [(); 2].map(|()| simulate(seed, false).unwrap());
            assert_eq!((once.now_ms, once.restarts), (again.now_ms, again.restarts), "seed {seed}");
            assert!(once.collector.attitudes == again.collector.attitudes, "seed {seed}");
        }
    }
}
