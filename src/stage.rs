//! `plumb stage`: the stages there are, and whether they do what every stage must.

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
};

use ::score::catalogue::Catalogue;
use clap::{Subcommand, ValueEnum};
use conformance::Report;
use launch::{Launch, LaunchError};
use sdk::template::{Language, Slot, Template, TemplateError};

use crate::{fail, out::print};

#[derive(Subcommand)]
pub(crate) enum Stage {
    /// Print every slot's stages with their parameters.
    List {
        /// The launch file whose `[stages.NAME]` are told, too [default: ./launch.toml].
        #[arg(long, value_name = "FILE")]
        launch: Option<PathBuf>,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Hold stages against the conformance kit: soundness under every fault, snapshots, hand-over, recovery. Exit code 1 when one does not
    /// pass.
    Test {
        /// Only stages of this slot.
        #[arg(long)]
        slot: Option<String>,
        /// Only these stages.
        names: Vec<String>,
        /// The launch file whose `[stages.NAME]` may be named, too [default: ./launch.toml].
        #[arg(long, value_name = "FILE")]
        launch: Option<PathBuf>,
        /// Print the reports as one JSON array on the last line of standard output.
        #[arg(long)]
        json: bool,
    },
    /// Write a working stage of one's own, with a test, into a new folder.
    New {
        /// Its name: a-z, 0-9 and -, beginning with a letter.
        name: String,
        /// In which language.
        #[arg(long)]
        lang: Lang,
        /// The slot that it fills.
        #[arg(long, default_value = "fuser", value_parser = slot)]
        slot: Slot,
        /// Where [default: ./NAME].
        #[arg(long)]
        dir: Option<PathBuf>,
        /// Where Plumbline's crates are, for Rust: a folder or the URL of a git repository.
        #[arg(long, value_name = "FOLDER|URL", required_if_eq("lang", "rust"))]
        source: Option<String>,
    },
}

#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum Lang {
    Rust,
    Python,
    /// C, and C++.
    C,
}

pub(crate) fn run(command: Stage) -> ExitCode {
    match command {
        Stage::New { name, lang, slot, dir, source } => new(name, lang, slot, dir, source),
        Stage::List { launch, json } => list(launch.as_deref(), json),
        Stage::Test { slot, names, launch, json } => test(slot.as_deref(), &names, launch.as_deref(), json),
    }
}

fn list(launch: Option<&Path>, json: bool) -> ExitCode {
    let programs = match programs(launch) {
        Ok(programs) => programs,
        Err(error) => return fail(&error, 3),
    };
    match Catalogue::new(&programs) {
        Ok(catalogue) if json => print(&catalogue.json()),
        Ok(catalogue) => print(&catalogue),
        Err(error) => fail(&error, 1),
    }
}

/// The launch file with programs that may be named.
pub(crate) fn programs(named: Option<&Path>) -> Result<Launch, LaunchError> {
    let usual = Path::new("launch.toml");
    match named.or_else(|| usual.exists().then_some(usual)) {
        Some(path) => Launch::read(path),
        None => Ok(Launch::default()),
    }
}

fn slot(name: &str) -> Result<Slot, String> {
    Slot::named(name).ok_or_else(|| "these are gyro, accel, fuser and course".into())
}

fn new(name: String, lang: Lang, slot: Slot, dir: Option<PathBuf>, source: Option<String>) -> ExitCode {
    let folder = dir.unwrap_or_else(|| name.clone().into());
    let source = match source.map_or(Ok(String::new()), |source| crates(&source)) {
        Ok(source) => source,
        Err(wrong) => return fail(&format_args!("looking for Plumbline's crates: {wrong}"), 2),
    };
    let language = match lang {
        Lang::Rust => Language::Rust { source },
        Lang::Python => Language::Python,
        Lang::C => Language::C,
    };
    match (Template { language, slot, name }).write(&folder) {
        Ok(()) => {
            supervisor::announce(format_args!("{} is written; its README.md tells what comes next", folder.display()));
            ExitCode::SUCCESS
        }
        Err(error @ TemplateError::Unwritable { .. }) => fail(&error, 1),
        Err(error) => fail(&error, 2),
    }
}

/// Where Plumbline's crates are, as a crate in another folder names it.
fn crates(source: &str) -> Result<String, String> {
    if source.contains("://") {
        return Ok(source.into());
    }
    let absolute = std::path::absolute(source).map_err(|cause| cause.to_string())?;
    if !absolute.join("crates/sdk").is_dir() {
        return Err(format!("{} has no folder crates/sdk; name the folder of Plumbline's source", absolute.display()));
    }
    Ok(absolute.display().to_string())
}

fn test(slot: Option<&str>, names: &[String], launch: Option<&Path>, json: bool) -> ExitCode {
    let ours = |asked: &String| conformance::stages().any(|(_, name)| name == asked);
    // Who asks only for what this executable has needs no launch file.
    let programs = if launch.is_none() && names.iter().all(ours) { Ok(Launch::default()) } else { programs(launch) };
    let programs = match programs {
        Ok(programs) => programs,
        Err(error) => return fail(&error, 3),
    };
    let meant = |(of, name): &(&str, &str)| {
        slot.is_none_or(|slot| slot == *of) && (names.is_empty() || names.iter().any(|asked| asked == name))
    };
    let mut chosen: Vec<(&str, &str)> = conformance::stages().collect();
    // Without names, all that this executable has.
    let of_ones_own = programs.stages.iter().filter(|_| !names.is_empty());
    chosen.extend(of_ones_own.map(|(name, program)| (program.slot.name(), name.as_str())));
    chosen.retain(meant);
    let unknown = names.iter().find(|asked| !chosen.iter().any(|(_, name)| name == asked));
    if chosen.is_empty() || unknown.is_some() {
        let asked = unknown.map_or_else(|| slot.unwrap_or_default(), String::as_str);
        return fail(
            &format!(
                "testing `{asked}`: there is no such stage; `plumb stage list` tells them all, [stages.NAME] of a launch file more (--launch)"
            ),
            2,
        );
    }
    let mut reports: Vec<Report> = Vec::new();
    for (slot, name) in chosen {
        let report = match conformance::run(slot, name) {
            Some(report) => report,
            None => {
                let Some(program) = programs.stages.get(name) else { continue };
                // In a slow language it takes minutes.
                let on_begin = &mut |kind: &str| supervisor::announce(format_args!("{slot} {name}: {kind}"));
                match conformance::program(name, program, on_begin) {
                    Ok(report) => report,
                    Err(error) => return fail(&error, 1),
                }
            }
        };
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
