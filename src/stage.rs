//! `plumb stage`: lists, tests and creates stages.

use std::{path::PathBuf, process::ExitCode, time::Duration};

use ::score::catalogue::Catalogue;
use clap::{Subcommand, ValueEnum};
use conformance::Report;
use launch::{Launch, Slot};
use mapping::names::UnknownName;
use rayon::prelude::*;
use sdk::template::{Language, Template, TemplateError};
use serde::Serialize;

use crate::{
    duration::duration,
    failure::{Failure, OrFail as _, Outcome},
    notice::{colored_results, notice, progress_bar},
    stdout::print,
    system::LaunchArgs,
};

/// Interval between two updates of the progress.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(200);

#[derive(Subcommand)]
pub(crate) enum Stage {
    /// List the stages of every slot with their parameters
    #[command(after_help = "\
Examples:
  plumb stage list
  plumb stage list --launch my-fuser/launch.toml
  plumb stage list --json")]
    List {
        #[command(flatten)]
        launch: LaunchArgs,
        /// Print one JSON object
        #[arg(long)]
        json: bool,
    },
    /// Run the conformance suite on stages
    #[command(after_help = "\
Examples:
  plumb stage test                            # all built-in stages
  plumb stage test vqf madgwick
  plumb stage test my-fuser --launch my-fuser/launch.toml

Checks soundness under every fault, snapshots, hand-over and recovery. The
report counts the cases left out because a user-defined stage is slow.
Exit codes: 0 all stages pass, 1 otherwise, 2 unknown stage.")]
    Test {
        /// Slot to test: gyro, accel, fuser or course [default: all]
        #[arg(long, value_parser = parse_slot)]
        slot: Option<Slot>,
        /// Stages to test [default: all built-in stages]
        names: Vec<String>,
        #[command(flatten)]
        launch: LaunchArgs,
        /// Time limit for the checks of user-defined stages
        #[arg(long = "for", value_name = "TIME", default_value = "1m", value_parser = duration)]
        duration: Duration,
        /// Run all checks, which takes minutes for a stage in a slow language
        #[arg(long, conflicts_with = "duration")]
        complete: bool,
        /// Print one JSON object with the reports on the last line
        #[arg(long)]
        json: bool,
    },
    /// Create a working user-defined stage with a test in a new folder
    #[command(after_help = "\
Examples:
  plumb stage new my-fuser --lang python
  plumb stage new my-accel --lang c --slot accel
  plumb stage new my-rust-fuser --lang rust --source /path/to/plumbline")]
    New {
        /// Stage name: a letter, then a-z, 0-9 and -
        name: String,
        /// Programming language
        #[arg(long)]
        lang: Lang,
        /// Slot of the stage: gyro, accel, fuser or course
        #[arg(long, default_value = "fuser", value_parser = parse_slot)]
        slot: Slot,
        /// Folder to create [default: ./NAME]
        #[arg(long)]
        dir: Option<PathBuf>,
        /// Folder or git URL of Plumbline's crates, required for Rust
        #[arg(long, value_name = "FOLDER|URL", required_if_eq("lang", "rust"))]
        source: Option<String>,
    },
}

#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum Lang {
    Rust,
    Python,
    /// C and C++
    C,
}

pub(crate) fn run(command: Stage) -> Outcome {
    match command {
        Stage::New { name, lang, slot, dir, source } => new(name, lang, slot, dir, source),
        Stage::List { launch, json } => list(&launch, json),
        Stage::Test { slot, names, launch, duration, complete, json } => {
            test(slot, &names, &launch, (!complete).then_some(duration), json)
        }
    }
}

fn list(launch: &LaunchArgs, json: bool) -> Outcome {
    let catalogue = Catalogue::new(&launch.read()?).or_fail(1)?;
    Ok(if json { print(&catalogue.json()) } else { print(&catalogue) })
}

fn parse_slot(name: &str) -> Result<Slot, String> {
    Slot::from_name(name).ok_or_else(|| UnknownName::new("slot", name, Slot::ALL.map(Slot::name)).to_string())
}

fn new(name: String, lang: Lang, slot: Slot, dir: Option<PathBuf>, source: Option<String>) -> Outcome {
    let folder = dir.unwrap_or_else(|| name.clone().into());
    let source = source.map_or(Ok(String::new()), |source| crates_source(&source));
    let source = source.map_err(|reason| Failure::new(format_args!("cannot use --source: {reason}"), 2))?;
    let language = match lang {
        Lang::Rust => Language::Rust { source },
        Lang::Python => Language::Python,
        Lang::C => Language::C,
    };
    let written = Template { language, slot, name }.write(&folder);
    written.map_err(|error| Failure::new(&error, if matches!(error, TemplateError::Write { .. }) { 1 } else { 2 }))?;
    notice(format_args!("{} created; see its README.md for the next steps", foreign::path(&folder)));
    Ok(ExitCode::SUCCESS)
}

/// Returns the location of Plumbline's crates as a URL or absolute path. A crate in any folder can
/// then depend on them.
fn crates_source(source: &str) -> Result<String, String> {
    if source.contains("://") {
        return Ok(source.into());
    }
    let absolute = std::path::absolute(source).map_err(|cause| cause.to_string())?;
    if !absolute.join("crates/sdk").is_dir() {
        return Err(format!(
            "{} has no folder crates/sdk; expected the folder of Plumbline's source",
            foreign::path(&absolute)
        ));
    }
    Ok(absolute.to_string_lossy().into_owned())
}

fn test(slot: Option<Slot>, names: &[String], launch: &LaunchArgs, time: Option<Duration>, json: bool) -> Outcome {
    let is_built_in = |wanted: &String| conformance::stages().any(|(_, name)| name == wanted);
    // A launch file is needed only for stages that are not built in.
    let needs_no_file = launch.launch.is_none() && names.iter().all(is_built_in);
    let launch = if needs_no_file { Launch::default() } else { launch.read()? };
    let selected = |(of, name): &(Slot, &str)| {
        slot.is_none_or(|slot| slot == *of) && (names.is_empty() || names.iter().any(|wanted| wanted == name))
    };
    let mut selected_stages: Vec<(Slot, &str)> = conformance::stages().collect();
    // If no names are given, only the built-in stages are tested.
    let external = launch.stages.iter().filter(|_| !names.is_empty());
    selected_stages.extend(external.map(|(name, program)| (program.slot, name.as_str())));
    selected_stages.retain(selected);
    if let Some(name) = names.iter().find(|wanted| !selected_stages.iter().any(|(_, name)| name == wanted)) {
        let all = Slot::ALL.into_iter().flat_map(|slot| launch.stage_names(slot));
        let unknown = match slot.map(|slot| launch.validate_stage(slot, name)) {
            Some(Err(error)) => error.to_string(),
            _ => UnknownName::new("stage", name, all).to_string(),
        };
        return Err(Failure::new(format_args!("{unknown}; --launch names the launch file of your own stages"), 2));
    }
    let (built_in, external): (Vec<_>, Vec<_>) =
        selected_stages.into_iter().partition(|(_, name)| !launch.stages.contains_key(*name));
    let mut reports = run_built_in(&built_in);
    let time = time.map(|time| time / external.len().max(1) as u32);
    for (_, name) in external {
        let Some(program) = launch.stages.get(name) else { continue };
        let bar = progress_bar(0, "{spinner} {elapsed} {wide_msg}");
        bar.enable_steady_tick(PROGRESS_INTERVAL);
        let slot = program.slot;
        let on_check = &|check: &str| bar.set_message(format!("{slot} {name}: {check}"));
        let result = conformance::run_external(name, program, time, on_check);
        bar.finish_and_clear();
        reports.push(result.or_fail(1)?);
    }
    for report in reports.iter().filter(|_| !json) {
        if print(&colored_results(report, 4)) != ExitCode::SUCCESS {
            return Ok(ExitCode::FAILURE);
        }
    }
    if json {
        let printed = print(&serde_json::to_string(&Reports { reports: &reports }).unwrap_or_default());
        if printed != ExitCode::SUCCESS {
            return Ok(printed);
        }
    }
    // The notice follows the results, so that it is the last line.
    if reports.iter().any(|report| !report.left_out.is_empty()) {
        notice("checks were left out for lack of time; to run all: --complete");
    }
    Ok(if reports.iter().all(Report::passed) { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Reports of all tested stages, for `--json`.
#[derive(Serialize)]
struct Reports<'r> {
    reports: &'r [Report],
}

/// Tests built-in stages on all cores, with a progress bar on a terminal.
fn run_built_in(stages: &[(Slot, &str)]) -> Vec<Report> {
    let bar = progress_bar(stages.len() as u64, "{bar:40} {pos} of {len} stages, {elapsed}");
    bar.tick();
    let reports = stages.par_iter().filter_map(|(slot, name)| {
        let report = conformance::run(*slot, name);
        bar.inc(1);
        report
    });
    let reports = reports.collect();
    bar.finish_and_clear();
    reports
}
