//! `plumb bench`: campaigns against a running system.

use std::{fmt::Display, process::ExitCode};

use campaign::{CampaignError, Kills, Swaps};
use clap::{Args, Subcommand};
use serde::Serialize;

use crate::{fail, fail_after_result, out::print};

/// The campaigns.
#[derive(Subcommand)]
pub(crate) enum Bench {
    /// Kill services at random moments; exit code 1 when anything was lost or is not what an undisturbed run gives.
    Kills {
        #[command(flatten)]
        campaign: Campaign,
    },
    /// Swap stages of all slots at random; exit code 1 when one was not committed or anything was lost.
    Swaps {
        #[command(flatten)]
        campaign: Campaign,
        /// Swap each stage for itself, which must not change a byte.
        #[arg(long)]
        same: bool,
    },
}

/// What both have in common.
#[derive(Args)]
pub(crate) struct Campaign {
    /// How many.
    #[arg(long, default_value_t = 50)]
    count: u32,
    /// Of what is done and when.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Samples per second.
    #[arg(long, default_value_t = 1000)]
    rate_hz: u32,
    /// Threads that take the machine from the system.
    #[arg(long, default_value_t = 0)]
    load: u32,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(bench: &Bench) -> ExitCode {
    match *bench {
        Bench::Kills { campaign: Campaign { count, seed, rate_hz, load, json } } => {
            show(Kills { count, seed, rate_hz, load }.run(), json, |report| report.holds())
        }
        Bench::Swaps { campaign: Campaign { count, seed, rate_hz, load, json }, same } => {
            show(Swaps { count, seed, rate_hz, load, same }.run(), json, |report| report.holds())
        }
    }
}

fn show<R: Display + Serialize>(
    report: Result<R, CampaignError>,
    json: bool,
    holds: impl FnOnce(&R) -> bool,
) -> ExitCode {
    match report {
        // Numbers, strings and lists always serialise.
        Ok(report) => {
            let printed =
                if json { print(&serde_json::to_string(&report).unwrap_or_default()) } else { print(&report) };
            if holds(&report) { printed } else { fail_after_result(&"not everything that must hold did", 1) }
        }
        Err(error) => fail(&error, 1),
    }
}
