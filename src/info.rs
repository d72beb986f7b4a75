//! `plumb info`: what a file holds, whatever its format.

use std::{
    fmt,
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::Args;
use flight::{FlightError, FlightInfo};
use import::{Format, ImportError, Options};
use recording::{RecordingError, survey};
use serde::Serialize;

use crate::{
    fail, fail_after_result,
    import::{Readable, told},
    out::print,
};

/// The command line of `plumb info`.
#[derive(Args)]
#[command(after_help = "Exit codes: 0 the file is whole, 1 it was cut, 3 it cannot be read.")]
pub(crate) struct Info {
    /// A flight (MCAP), a recording (CSV, CSV.gz), or a log of another system.
    file: PathBuf,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, thiserror::Error)]
enum InfoError {
    #[error(transparent)]
    Flight(#[from] FlightError),
    #[error(transparent)]
    Import(#[from] ImportError),
    #[error(transparent)]
    Recording(#[from] RecordingError),
}

/// What there is to say of a recording that is no flight.
#[derive(Serialize)]
struct RecordingInfo {
    file: PathBuf,
    format: String,
    rows: u64,
    rate_hz: f64,
    seconds: f64,
    has_reference: bool,
    #[serde(skip)]
    people: String,
}

pub(crate) fn run(Info { file, json }: &Info) -> ExitCode {
    let read = || -> Result<ExitCode, InfoError> {
        Ok(match Format::of(file)? {
            Format::Mcap => {
                let info = FlightInfo::read(file)?;
                let printed = show(&info, *json);
                match &info.cut {
                    Some(why) => fail_after_result(&format_args!("{}: the file was cut: {why}", file.display()), 1),
                    None => printed,
                }
            }
            Format::Recording => show(&of_recording(file)?, *json),
            _ => show(&of_another(file)?, *json),
        })
    };
    read().unwrap_or_else(|error| fail(&error, 3))
}

fn show<T: Serialize + fmt::Display>(info: &T, json: bool) -> ExitCode {
    // Numbers, strings and maps with names always serialise.
    if json { print(&serde_json::to_string(info).unwrap_or_default()) } else { print(info) }
}

fn of_recording(file: &Path) -> Result<RecordingInfo, RecordingError> {
    let survey = survey(file)?;
    let (rows, rate_hz, has_reference) = (survey.rows, survey.rate_hz, survey.has_reference);
    let seconds = rows.saturating_sub(1) as f64 / rate_hz;
    let reference = if has_reference { "with" } else { "without" };
    let samples = launch::pluralize(rows, "sample");
    let people = format!(
        "{}: {}, {samples} at {rate_hz:.1} Hz, about {seconds:.1} s, {reference} a reference attitude",
        file.display(),
        Format::Recording
    );
    let format = Format::Recording.to_string();
    Ok(RecordingInfo { file: file.to_owned(), format, rows, rate_hz, seconds, has_reference, people })
}

/// A log of another system, as it would be imported.
fn of_another(file: &Path) -> Result<RecordingInfo, ImportError> {
    let (_, summary) = Readable::imported(&[file.to_owned()], &Options::default())?;
    Ok(RecordingInfo {
        file: file.to_owned(),
        format: summary.format.to_string(),
        rows: summary.rows,
        rate_hz: summary.rate_hz,
        seconds: summary.duration_s,
        has_reference: summary.reference_rows > 0,
        people: told(&summary, file),
    })
}

impl fmt::Display for RecordingInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.people)
    }
}
