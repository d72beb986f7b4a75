//! `plumb bench`: campaigns against a running system.

use std::{fmt::Display, process::ExitCode};

use campaign::{CampaignError, Kills};
use clap::Subcommand;
use serde::Serialize;

use crate::{fail, print};

/// The campaigns.
#[derive(Subcommand)]
pub(crate) enum Bench {
    /// Kill services at random moments; exit code 1 when anything was lost or is not what an undisturbed run gives.
    Kills {
        /// How many.
        #[arg(long, default_value_t = 50)]
        count: u32,
        /// Of the moments and the services.
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
    },
}

pub(crate) fn run(bench: &Bench) -> ExitCode {
    let Bench::Kills { count, seed, rate_hz, load, json } = *bench;
    let report = Kills { count, seed, rate_hz, load }.run();
    show(report, json, |report| report.holds())
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
            if holds(&report) { printed } else { fail(&"the output is not that of an undisturbed run", 1) }
        }
        Err(error) => fail(&error, 1),
    }
}
