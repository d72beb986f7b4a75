//! Configuration of a run, validated before anything starts.

use std::{
    fs,
    io::{self, IsTerminal},
    path::{self, Path, PathBuf},
};

use launch::{Date, Launch, Service, Slot, Source};
use pipeline::{AttitudeFile, Column, is_same_file};
use runtime::{Pace, ServiceConfig};
use time::OffsetDateTime;

use crate::{Flight, error::UpError, warm::state_file_path};

/// Name of the default launch file.
const LAUNCH_FILE: &str = "launch.toml";
/// Built-in launch file, used if there is no default launch file.
const BUILT_IN: &str = include_str!("../../../launch.toml");

/// Maximum excess over a whole number of ticks that counts as a rounding error.
const ROUNDING_TICKS: f64 = 1e-6;

/// Command-line options of a run.
#[derive(Debug, Clone, Default)]
pub struct Request {
    /// Path of the launch file; `None` for the default.
    pub launch: Option<PathBuf>,
    /// Source specification that overrides the launch file.
    pub source: Option<String>,
    /// Receiver specification that overrides the launch file.
    pub receiver: Option<String>,
    /// Recording to replay, which overrides the launch file's source.
    pub replay: Option<PathBuf>,
    /// Recording converted from `replay`, if `replay` is a log from another system.
    pub imported: Option<PathBuf>,
    /// Speed of the source; `None` for real time.
    pub pace: Option<Pace>,
    /// Duration of the run in the source's time, s; `None` for unlimited.
    pub duration_s: Option<f64>,
    /// `true` to run all slots in this process, without the bus.
    pub in_process: bool,
    /// Path of the output file for the attitude of each tick.
    pub out: Option<PathBuf>,
    /// Columns of the output file after time and quaternion.
    pub columns: Vec<Column>,
    /// Folder for the recording of the run; `None` for no recording.
    pub record: Option<PathBuf>,
    /// `true` to ignore the state kept from an earlier run.
    pub cold: bool,
    /// `true` to publish the raw readings of the source, so that the recorded flight can be
    /// replayed.
    pub publish_readings: bool,
    /// Services that this executable lacks, each with the feature that adds it. The built-in launch
    /// file runs without these services. Other launch files must not list them.
    pub absent_services: Vec<(Service, &'static str)>,
    /// `true` to show no progress, only events, warnings and errors.
    pub quiet: bool,
}

/// Validated configuration of a run.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Configuration common to all services.
    pub config: ServiceConfig,
    /// Number of ticks that the source will provide; `None` if unknown.
    pub ticks: Option<u64>,
    /// Run time after which an endless source is stopped, s.
    pub stop_after_s: Option<f64>,
    /// Set if the source has a reference attitude for at least some ticks.
    pub has_reference: bool,
    /// Path of the replayed recording, as given by the user.
    pub recording: Option<PathBuf>,
    /// Output file for the attitude of each tick.
    pub out: Option<AttitudeFile>,
    /// Path of the state file that is kept across runs; `None` if the run uses none.
    pub state_file: Option<PathBuf>,
    /// `true` for a cold start, which ignores an existing state file.
    pub cold: bool,
    /// `true` to show no progress.
    pub quiet: bool,
}

impl Plan {
    /// Creates the plan for a request.
    ///
    /// # Errors
    ///
    /// Returns an error if the launch file or the source is invalid, or if options conflict.
    pub fn new(request: &Request) -> Result<Self, UpError> {
        let (mut launch, launch_file) = read_launch(request)?;
        if let Some(line) = &request.source {
            launch.set_source(line).map_err(launch::LaunchError::from)?;
        }
        if let Some(line) = &request.receiver {
            launch.set_receiver(line).map_err(launch::LaunchError::from)?;
            if launch.ingest.source.is_repeatable() {
                return Err(UpError::Receiver);
            }
        }
        if let Some(file) = &request.replay {
            launch.ingest.source = Source::Replay;
            launch.ingest.replay.file.clone_from(request.imported.as_ref().unwrap_or(file));
        }
        if launch.gateway.is_split() {
            let reason = match launch.ingest.source {
                Source::Replay => Some("a replay waits for its slowest subscriber"),
                Source::Stdin => Some("standard input waits for its slowest subscriber"),
                _ if request.pace.is_some_and(|pace| pace != Pace::Speed(1.0)) => {
                    Some("a source at another speed waits for its slowest subscriber")
                }
                _ if request.in_process => Some("--in-process runs all slots in one process"),
                _ => None,
            };
            if let Some(reason) = reason {
                return Err(UpError::Split { reason });
            }
        }
        let (rate_hz, rows, has_reference) = match launch.ingest.source {
            Source::Replay => {
                let file = &launch.ingest.replay.file;
                let is_input = |out: &&PathBuf| {
                    [Some(file), request.replay.as_ref()].into_iter().flatten().any(|read| is_same_file(out, read))
                };
                if let Some(path) = request.out.as_ref().filter(is_input) {
                    return Err(UpError::OutIsReplay { path: path.clone() });
                }
                let survey = recording::survey(file)?;
                (survey.rate_hz, Some(survey.rows), survey.has_reference)
            }
            source => (launch.ingest.nominal_rate_hz(), None, source == Source::Sim),
        };
        if launch.ingest.source == Source::Stdin && io::stdin().is_terminal() {
            return Err(UpError::Terminal);
        }
        if launch.ingest.source == Source::Stdin
            && request.duration_s.is_some()
            && launch.ingest.declared_rate_hz().is_none()
        {
            return Err(UpError::DurationWithoutRate);
        }
        let is_live = !launch.ingest.source.is_repeatable() && !launch.ingest.source.is_blocking();
        if launch.north.is_true && launch.north.date.is_none() {
            launch.north.date = Some(if is_live { today()? } else { return Err(UpError::NoDate) });
        }
        let requested_ticks = request.duration_s.map(|duration_s| ticks_in(duration_s, rate_hz));
        let max_ticks = requested_ticks.filter(|_| !is_live);
        let config = ServiceConfig {
            launch_file,
            max_ticks,
            publishes_readings: request.publish_readings,
            supervisor_pid: std::process::id(),
            ..ServiceConfig::standalone(launch, rate_hz, request.pace.unwrap_or(Pace::Speed(1.0)))
        };
        Ok(Self {
            ticks: rows.into_iter().chain(max_ticks).min(),
            stop_after_s: request.duration_s.filter(|_| is_live),
            has_reference: has_reference && config.launch.gateway.import.is_none(),
            recording: request.replay.clone(),
            quiet: request.quiet,
            out: out_file(request, &config.launch),
            state_file: state_file_path(&config.launch, !config.is_lockstep() && !request.in_process),
            cold: request.cold,
            config,
        })
    }
}

impl Plan {
    /// Creates the plan for the replay of a flight in this process.
    pub fn from_flight(request: &Request, flight: &Flight) -> Self {
        let requested_ticks = request.duration_s.map(|duration_s| ticks_in(duration_s, flight.rate_hz));
        let max_ticks = flight.schedule.end_tick().into_iter().chain(requested_ticks).min();
        let pace = request.pace.unwrap_or(Pace::Speed(1.0));
        let prior = flight.prior.filter(|_| !request.cold);
        let config = ServiceConfig {
            max_ticks,
            prior,
            ..ServiceConfig::standalone(flight.launch.clone(), flight.rate_hz, pace)
        };
        Self {
            ticks: max_ticks,
            stop_after_s: None,
            has_reference: config.launch.ingest.source.is_repeatable(),
            recording: request.replay.clone(),
            quiet: request.quiet,
            out: out_file(request, &config.launch),
            state_file: None,
            cold: request.cold,
            config,
        }
    }
}

/// Returns the current date, for the magnetic model of a live source.
fn today() -> Result<Date, UpError> {
    let today = OffsetDateTime::now_utc().date();
    let date = u16::try_from(today.year()).ok().and_then(|year| Date::new(year, today.month().into(), today.day()));
    date.ok_or_else(|| UpError::NoModel { today: today.to_string() })
}

/// Returns the output file. Its attitudes are in the frame that the launch file specifies.
fn out_file(request: &Request, launch: &Launch) -> Option<AttitudeFile> {
    let (path, columns) = (request.out.clone()?, request.columns.clone());
    Some(AttitudeFile { path, output: launch.output, columns })
}

/// Converts a duration to ticks, at least 1.
fn ticks_in(duration_s: f64, rate_hz: f64) -> u64 {
    ((duration_s * rate_hz - ROUNDING_TICKS).ceil() as u64).max(1)
}

/// Validates the stage that fills a slot. The error is shown to the user.
pub(crate) fn validate(launch: &Launch, slot: Slot) -> Result<(), String> {
    // An external stage validates its settings itself.
    if launch.external_stage(slot).is_some() {
        return Ok(());
    }
    let config = ServiceConfig::standalone(launch.clone(), 1000.0, Pace::Speed(1.0));
    let result = match slot {
        Slot::Gyro => slots::gyro::slot(&config).map(|_| ()),
        Slot::Accel => slots::accel::slot(&config).map(|_| ()),
        Slot::Fuser => slots::fuser::slot(&config).map(|_| ()),
        Slot::Course => slots::course::slot(&config).map(|_| ()),
    };
    result.map_err(|error| error.to_string())
}

/// Returns the text of the given launch file, else of `launch.toml` in the current folder, else of
/// the built-in launch file.
pub(crate) fn launch_text(path: Option<&Path>) -> io::Result<String> {
    match path {
        Some(path) => fs::read_to_string(path),
        None if Path::new(LAUNCH_FILE).exists() => fs::read_to_string(LAUNCH_FILE),
        None => Ok(BUILT_IN.into()),
    }
}

/// Returns the launch file and its absolute path, `None` for the built-in one.
fn read_launch(request: &Request) -> Result<(Launch, Option<PathBuf>), UpError> {
    let default = Path::new(LAUNCH_FILE);
    let file = request.launch.as_deref().or_else(|| default.exists().then_some(default));
    let mut launch = match file {
        Some(path) => Launch::read(path)?,
        None => Launch::parse(LAUNCH_FILE, BUILT_IN).map_err(launch::LaunchError::from)?,
    };
    for (service, feature) in &request.absent_services {
        match file {
            Some(file) if launch.services.contains(service) => {
                return Err(UpError::AbsentService { file: file.into(), service: service.name(), feature });
            }
            _ => launch.services.retain(|listed| listed != service),
        }
    }
    // Making a relative path absolute fails only if the current folder was removed.
    Ok((launch, file.and_then(|file| path::absolute(file).ok())))
}
