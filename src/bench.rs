//! `plumb bench`: stress tests with kills and swaps.

use std::{fmt::Display, process::ExitCode};

use campaign::{KillCampaign, SwapCampaign};
use clap::{Args, Subcommand};
use serde::Serialize;

use crate::{
    failure::{Outcome, fail_after_result},
    stdout::print_result,
};

#[derive(Subcommand)]
pub(crate) enum Bench {
    /// Kill services at random and verify that nothing is lost
    #[command(after_help = "\
Examples:
  plumb bench kills --count 10
  plumb bench kills --count 200 --rate-hz 500 --load 2 --json

Exit codes: 0 nothing lost and the output equals an undisturbed run, 1
otherwise.")]
    Kills {
        #[command(flatten)]
        campaign: Campaign,
    },
    /// Swap stages of all slots at random and verify that nothing is lost
    #[command(after_help = "\
Examples:
  plumb bench swaps --count 10
  plumb bench swaps --count 1000 --same --json

Exit codes: 0 all swaps committed and nothing lost, 1 otherwise.")]
    Swaps {
        #[command(flatten)]
        campaign: Campaign,
        /// Swap each stage for itself, which must not change the output
        #[arg(long)]
        same: bool,
    },
}

/// Arguments of both stress tests.
#[derive(Args)]
pub(crate) struct Campaign {
    /// Number of kills or swaps
    #[arg(long, default_value_t = 50)]
    count: u32,
    /// Seed for the random targets and times
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Sample rate of the simulated source, Hz
    #[arg(long, default_value_t = 1000)]
    rate_hz: u32,
    /// Number of additional threads that load the processors
    #[arg(long, default_value_t = 0)]
    load: u32,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(bench: &Bench) -> Outcome {
    match *bench {
        Bench::Kills { campaign: Campaign { count, seed, rate_hz, load, json } } => {
            let report = KillCampaign { count, seed, rate_hz, load_threads: load }.run()?;
            Ok(print_report(&report, json, report.passed()))
        }
        Bench::Swaps { campaign: Campaign { count, seed, rate_hz, load, json }, same } => {
            let report = SwapCampaign { count, seed, rate_hz, load_threads: load, same_stage: same }.run()?;
            Ok(print_report(&report, json, report.passed()))
        }
    }
}

fn print_report(report: &(impl Display + Serialize), json: bool, passed: bool) -> ExitCode {
    let printed = print_result(report, json);
    if passed { printed } else { fail_after_result(&"a required property does not hold, see above", 1) }
}
