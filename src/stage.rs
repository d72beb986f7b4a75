//! `plumb stage`: the stages there are, and whether they do what every stage must.

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
};

use ::score::catalogue::Catalogue;
use clap::{Subcommand, ValueEnum};
use conformance::Report;
use launch::{Launch, LaunchError, Service};
use own_stage::template::{Language, Template, TemplateError};

use crate::{fail, out::print};

#[derive(Subcommand)]
pub(crate) enum Stage {
    /// Print every slot's stages with their parameters.
    List {
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Hold stages against the conformance kit: soundness under every fault, snapshots, hand-over, recovery. A program that the
    /// launch file names is held against what of it messages tell. Exit code 1 when one does not pass.
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
        #[arg(long, default_value = "fuser", value_parser = crate::service)]
        slot: Service,
        /// Where [default: ./NAME].
        #[arg(long)]
        dir: Option<PathBuf>,
        /// Where Plumbline's crates are, for Rust: a folder or the URL of a git repository.
        #[arg(long, value_name = "FOLDER|URL", required_if_eq("lang", "rust"))]
        source: Option<String>,
    },
    /// Print the messages as a C header or a Python module.
    Header {
        /// For which language.
        #[arg(long, default_value = "c")]
        lang: HeaderLang,
    },
}

#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum Lang {
    Rust,
    Python,
}

#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum HeaderLang {
    C,
    Python,
}

pub(crate) fn run(command: Stage) -> ExitCode {
    match command {
        Stage::New { name, lang, slot, dir, source } => new(name, lang, slot, dir, source),
        Stage::Header { lang: HeaderLang::C } => print(&own_stage::c::header().trim_end()),
        Stage::Header { lang: HeaderLang::Python } => print(&own_stage::python::messages().trim_end()),
        Stage::List { json: true } => print(&Catalogue::new().json()),
        Stage::List { json: false } => print(&Catalogue::new()),
        Stage::Test { slot, names, launch, json } => test(slot.as_deref(), &names, launch.as_deref(), json),
    }
}

/// The launch file with programs that may be named.
fn programs(named: Option<&Path>) -> Result<Launch, LaunchError> {
    let usual = Path::new("launch.toml");
    match named.or_else(|| usual.exists().then_some(usual)) {
        Some(path) => Launch::read(path),
        None => Ok(Launch::default()),
    }
}

fn new(name: String, lang: Lang, slot: Service, dir: Option<PathBuf>, source: Option<String>) -> ExitCode {
    let language = match lang {
        Lang::Rust => Language::Rust,
        Lang::Python => Language::Python,
    };
    let folder = dir.unwrap_or_else(|| name.clone().into());
    // The crate's own folder is not this one.
    let source = source.map_or(Ok(String::new()), |source| match source.contains("://") {
        true => Ok(source),
        false => std::path::absolute(&source).map(|path| path.display().to_string()),
    });
    let source = match source {
        Ok(source) => source,
        Err(cause) => return fail(&format_args!("looking for Plumbline's crates: {cause}"), 2),
    };
    match (Template { language, slot, name, source }).write(&folder) {
        Ok(()) => {
            supervisor::tell(format_args!("{} is written; its README.md tells what comes next", folder.display()));
            ExitCode::SUCCESS
        }
        Err(error @ TemplateError::Unwritable { .. }) => fail(&error, 1),
        Err(error) => fail(&error, 2),
    }
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
        let Some(report) = conformance::run(slot, name).or_else(|| own_stage::trial::run(&programs, name)) else {
            continue;
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
