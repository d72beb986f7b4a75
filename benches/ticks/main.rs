//! Instructions that each service of the data path needs for one tick, compared with a budget.
//!
//! Command: `cargo bench --profile release --bench ticks`.
//!
//! Input: scenario S1 at 1 kHz, the default stages, and the budget in `budget.json`.
//!
//! Output: a table. With `--lower`, budgets above the measured values are lowered to them.
//!
//! Time: the counts do not depend on the load of the machine.
//!
//! Failure: a service that exceeds its budget by more than [`TOLERANCE`] ends the run with an
//! error. valgrind is required.
//!
//! All services run in one process, over the bus, and each tick passes through them in turn. For
//! each tick, a service waits (the wait returns immediately), receives and joins its inputs, steps
//! its stage, publishes the output and wakes the subscribers. Callgrind counts all instructions,
//! including those of health reports and checkpoints. The warm-up is not counted.

mod callgrind;
mod services;

use std::{collections::BTreeMap, fs, process::ExitCode};

use clap::Parser;

type Failure = Box<dyn std::error::Error>;

/// Instructions per tick, by service.
type Counts = BTreeMap<String, u64>;

const BUDGET: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/budget.json");
/// Fraction by which a count may exceed its budget. Counts vary because health reports are timed by
/// the clock, not by ticks, and because the C library copies memory differently on each processor.
const TOLERANCE: f64 = 0.02;

/// Count the instructions of one tick and compare them with the budget
#[derive(Parser)]
struct Cli {
    /// Lower the budgets that are above the measured values
    #[arg(long)]
    lower: bool,
    /// Accept the flag that cargo passes to every benchmark
    #[arg(long, hide = true)]
    bench: bool,
    /// Run the services, as the process that callgrind measures
    #[arg(long, hide = true)]
    services: bool,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    let result = if cli.services { services::run() } else { compare(cli.lower) };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

fn compare(lower: bool) -> Result<(), Failure> {
    let counts = callgrind::count(&services::MEASURED, services::TICKS)?;
    let mut budget: Counts = serde_json::from_str(&fs::read_to_string(BUDGET)?)?;
    println!("{:<8} {:>12} {:>8}", "service", "instructions", "budget");
    for (service, count) in &counts {
        let allowed = budget.get(service).map_or_else(|| "none".into(), u64::to_string);
        println!("{service:<8} {count:>12} {allowed:>8}");
    }
    if lower {
        for (service, allowed) in &mut budget {
            *allowed = counts.get(service).map_or(*allowed, |count| (*count).min(*allowed));
        }
        fs::write(BUDGET, serde_json::to_string_pretty(&budget)? + "\n")?;
    }
    let exceeded: Vec<String> = counts.iter().filter_map(|(service, count)| excess(service, *count, &budget)).collect();
    if !exceeded.is_empty() {
        return Err(exceeded.join("\n").into());
    }
    if counts.iter().any(|(service, count)| (*count as f64) < budget[service] as f64 * (1.0 - TOLERANCE)) {
        println!("to keep the improvement, run `cargo bench --profile release --bench ticks -- --lower`");
    }
    Ok(())
}

/// Describes by how much a service exceeds its budget. Returns `None` if it does not.
fn excess(service: &str, count: u64, budget: &Counts) -> Option<String> {
    let Some(allowed) = budget.get(service) else {
        return Some(format!("{service} needs {count} instructions per tick and has no budget: add one to {BUDGET}"));
    };
    (count as f64 > *allowed as f64 * (1.0 + TOLERANCE)).then(|| {
        format!(
            "{service} needs {count} instructions per tick, {:.1} % more than its budget of {allowed}: reduce the \
             work on the data path, or raise the budget in {BUDGET} and give the reason in the commit message",
            (count as f64 / *allowed as f64 - 1.0) * 100.0
        )
    })
}
