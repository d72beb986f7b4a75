//! What is to run, checked before anything starts.

use std::{
    fs,
    io::{self, IsTerminal},
    path::{Path, PathBuf},
};

use launch::{Date, Launch, Service, Source};
use pipeline::{Column, OutFile, is_same_file};
use runtime::{Pace, ServiceConfig};
use time::OffsetDateTime;

use crate::{Flight, UpError, warm};

/// The launch file that is looked for where none is named.
const LAUNCH_FILE: &str = "launch.toml";
/// What runs where there is no launch file.
const BUILT_IN: &str = include_str!("../../../launch.toml");

/// A duration of a whole number of ticks may come out larger by its rounding, ticks.
const ROUNDING: f64 = 1e-6;

/// What the command line asks for.
#[derive(Debug, Clone, Default)]
pub struct Request {
    /// The launch file.
    pub launch: Option<PathBuf>,
    /// A source in one line that takes the place of the launch file's.
    pub source: Option<String>,
    /// A receiver in one line that takes the place of the launch file's.
    pub receiver: Option<String>,
    /// A recording that takes the place of the launch file's source.
    pub replay: Option<PathBuf>,
    /// What was imported of it, where it is the log of another system.
    pub imported: Option<PathBuf>,
    /// How fast the source goes.
    pub pace: Option<Pace>,
    /// How much of the source's time to run, s.
    pub duration_s: Option<f64>,
    /// All slots in this process, without the bus.
    pub in_process: bool,
    /// Where to write the attitude of each tick.
    pub out: Option<PathBuf>,
    /// What its lines have after time and quaternion.
    pub columns: Vec<Column>,
    /// Nothing is taken over from an earlier run.
    pub cold: bool,
    /// What the source gives is published as it came, so that the flight can be replayed.
    pub readings: bool,
}

/// What is to run.
#[derive(Debug, Clone)]
pub struct Plan {
    /// What every service is told.
    pub config: ServiceConfig,
    /// Ticks that the source will give, as far as it is known.
    pub ticks: Option<u64>,
    /// After how much of the clock's time a source without an end is stopped, s.
    pub stop_after_s: Option<f64>,
    /// The source knows the true attitude, at least now and then.
    pub has_reference: bool,
    /// The recording that is replayed, as it was named.
    pub recording: Option<PathBuf>,
    /// Where to write the attitude of each tick, and how.
    pub out: Option<OutFile>,
    /// Where what outlives this run is kept, and what an earlier one has left.
    pub state_file: Option<PathBuf>,
    /// What is there is not used.
    pub cold: bool,
}

impl Plan {
    /// The plan for a request.
    pub fn new(request: &Request) -> Result<Self, UpError> {
        let mut launch = launch(request.launch.as_deref())?;
        if let Some(line) = &request.source {
            launch.set_source(line).map_err(launch::LaunchError::from)?;
        }
        if let Some(line) = &request.receiver {
            launch.set_receiver(line).map_err(launch::LaunchError::from)?;
            if launch.ingest.source.can_be_read_again() {
                return Err(UpError::Receiver);
            }
        }
        if let Some(file) = &request.replay {
            launch.ingest.source = Source::Replay;
            launch.ingest.replay.file.clone_from(request.imported.as_ref().unwrap_or(file));
        }
        if launch.gateway.is_split() {
            let obstacle = match launch.ingest.source {
                Source::Replay => Some("a replay waits for its slowest reader"),
                Source::Stdin => Some("standard input waits for its slowest reader"),
                _ if request.pace.is_some_and(|pace| pace != Pace::Speed(1.0)) => {
                    Some("at another speed the source waits for its slowest reader")
                }
                _ if request.in_process => Some("one process has all slots"),
                _ => None,
            };
            if let Some(why) = obstacle {
                return Err(UpError::Split { why });
            }
        }
        let (rate_hz, rows, has_reference) = match launch.ingest.source {
            Source::Replay => {
                let file = &launch.ingest.replay.file;
                let is_read = |out: &&PathBuf| {
                    [Some(file), request.replay.as_ref()].into_iter().flatten().any(|read| is_same_file(out, read))
                };
                if let Some(path) = request.out.as_ref().filter(is_read) {
                    return Err(UpError::OutIsReplay { path: path.clone() });
                }
                let survey = recording::survey(file)?;
                (survey.rate_hz, Some(survey.rows), survey.has_reference)
            }
            // All others declare their rate.
            source => {
                let rate_hz = launch.ingest.declared_rate_hz().unwrap_or(launch.ingest.sim.rate_hz);
                (rate_hz, None, source == Source::Sim)
            }
        };
        if launch.ingest.source == Source::Stdin && io::stdin().is_terminal() {
            return Err(UpError::Terminal);
        }
        let live = !launch.ingest.source.can_be_read_again() && !launch.ingest.source.waits();
        if launch.north.is_true && launch.north.date.is_none() {
            launch.north.date = Some(if live { today()? } else { return Err(UpError::NoDate) });
        }
        let wanted = request.duration_s.map(|duration_s| ticks_in(duration_s, rate_hz));
        let ticks_max = wanted.filter(|_| !live);
        let config = ServiceConfig {
            ticks_max,
            readings: request.readings,
            supervisor_pid: std::process::id(),
            ..alone(launch, rate_hz, request.pace.unwrap_or(Pace::Speed(1.0)))
        };
        Ok(Self {
            ticks: rows.into_iter().chain(ticks_max).min(),
            stop_after_s: request.duration_s.filter(|_| live),
            has_reference: has_reference && config.launch.gateway.import.is_none(),
            recording: request.replay.clone(),
            out: out_file(request, &config.launch),
            state_file: warm::place(&config.launch, !config.lockstep() && !request.in_process),
            cold: request.cold,
            config,
        })
    }
}

impl Plan {
    /// The plan for a flight that is flown again, in this process.
    pub fn of_flight(request: &Request, flight: &Flight) -> Self {
        let ends = request.duration_s.map(|duration_s| ticks_in(duration_s, flight.rate_hz));
        let ticks_max = flight.schedule.end_tick().into_iter().chain(ends).min();
        let pace = request.pace.unwrap_or(Pace::Speed(1.0));
        let prior = flight.prior.filter(|_| !request.cold);
        let config = ServiceConfig { ticks_max, prior, ..alone(flight.launch.clone(), flight.rate_hz, pace) };
        Self {
            ticks: ticks_max,
            stop_after_s: None,
            has_reference: config.launch.ingest.source.can_be_read_again(),
            recording: request.replay.clone(),
            out: out_file(request, &config.launch),
            state_file: None,
            cold: request.cold,
            config,
        }
    }
}

/// The date of the magnetic model while sensors are read.
fn today() -> Result<Date, UpError> {
    let today = OffsetDateTime::now_utc().date();
    let date = u16::try_from(today.year()).ok().and_then(|year| Date::new(year, today.month().into(), today.day()));
    date.ok_or_else(|| UpError::NoModel { today: today.to_string() })
}

/// The file of attitudes, in the frame of the launch file.
fn out_file(request: &Request, launch: &Launch) -> Option<OutFile> {
    let (path, columns) = (request.out.clone()?, request.columns.clone());
    Some(OutFile { path, output: launch.output, columns })
}

/// A duration in ticks, one at least.
fn ticks_in(duration_s: f64, rate_hz: f64) -> u64 {
    ((duration_s * rate_hz - ROUNDING).ceil() as u64).max(1)
}

/// What the slots are told that run without a supervisor.
fn alone(launch: Launch, rate_hz: f64, pace: Pace) -> ServiceConfig {
    ServiceConfig {
        launch,
        rate_hz,
        pace,
        ticks_max: None,
        readings: false,
        incarnation: 0,
        epoch: runtime::service_config::FIRST_EPOCH,
        role: runtime::Role::Owner { from_tick: 0 },
        prior: None,
        resume: None,
        supervisor_pid: 0,
    }
}

/// What is wrong with the stage that fills a slot, for people.
pub(crate) fn validate(launch: &Launch, slot: Service) -> Result<(), String> {
    // A program of the user's says itself what is wrong with its settings.
    if launch.program(slot).is_some() {
        return Ok(());
    }
    let config = alone(launch.clone(), 1000.0, Pace::Speed(1.0));
    let filled = match slot {
        Service::Ingest | Service::Gateway | Service::Drivers | Service::Cockpit => return Ok(()),
        Service::Gyro => gyro::slot(&config).map(|_| ()),
        Service::Accel => accel::slot(&config).map(|_| ()),
        Service::Fuser => fuser::slot(&config).map(|_| ()),
        Service::Course => course::slot(&config).map(|_| ()),
    };
    filled.map_err(|error| error.to_string())
}

/// The launch file as it is written: the one named, else that of the folder, else the one built in.
pub fn launch_text(named: Option<&Path>) -> io::Result<String> {
    match named {
        Some(path) => fs::read_to_string(path),
        None if Path::new(LAUNCH_FILE).exists() => fs::read_to_string(LAUNCH_FILE),
        None => Ok(BUILT_IN.into()),
    }
}

fn launch(named: Option<&Path>) -> Result<Launch, UpError> {
    match named {
        Some(path) => Ok(Launch::read(path)?),
        None if Path::new(LAUNCH_FILE).exists() => Ok(Launch::read(Path::new(LAUNCH_FILE))?),
        None => Ok(Launch::parse(LAUNCH_FILE, BUILT_IN).map_err(launch::LaunchError::from)?),
    }
}
