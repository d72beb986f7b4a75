//! `plumb stage`: the stages there are, and whether they do what every stage must.

use std::process::ExitCode;

use ::score::catalogue::Catalogue;
use clap::Subcommand;
use conformance::Report;

use crate::{fail, print};

#[derive(Subcommand)]
pub(crate) enum Stage {
    /// Print every slot's stages with their parameters.
    List {
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Hold stages against the conformance kit: soundness under every fault, snapshots, hand-over, recovery. Exit code 1 when one
    /// does not pass.
    Test {
        /// Only stages of this slot.
        #[arg(long)]
        slot: Option<String>,
        /// Only these stages.
        names: Vec<String>,
        /// Print the reports as one JSON array on the last line of standard output.
        #[arg(long)]
        json: bool,
    },
}

pub(crate) fn run(command: Stage) -> ExitCode {
    match command {
        Stage::List { json: true } => print(&Catalogue::new().json()),
        Stage::List { json: false } => print(&Catalogue::new()),
        Stage::Test { slot, names, json } => test(slot.as_deref(), &names, json),
    }
}

fn test(slot: Option<&str>, names: &[String], json: bool) -> ExitCode {
    let meant = |(of, name): &(&str, &str)| {
        slot.is_none_or(|slot| slot == *of) && (names.is_empty() || names.iter().any(|asked| asked == name))
    };
    let unknown = names.iter().find(|asked| !conformance::stages().any(|stage| meant(&stage) && stage.1 == *asked));
    let chosen: Vec<_> = conformance::stages().filter(meant).collect();
    if chosen.is_empty() || unknown.is_some() {
        let asked = unknown.map_or_else(|| slot.unwrap_or_default(), String::as_str);
        return fail(&format!("testing `{asked}`: there is no such stage; `plumb stage list` tells them all"), 2);
    }
    let mut reports: Vec<Report> = Vec::new();
    for (slot, name) in chosen {
        let Some(report) = conformance::run(slot, name) else { continue };
        if !json && print(&report) != ExitCode::SUCCESS {
            return ExitCode::FAILURE;
        }
        reports.push(report);
    }
    if json {
        match serde_json::to_string(&reports) {
            Ok(text) if print(&text) == ExitCode::SUCCESS => {}
            _ => return ExitCode::FAILURE,
        }
    }
    if reports.iter().all(Report::passed) { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
