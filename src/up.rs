//! `plumb up`: runs a system.

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
    time::Duration,
};

use ::import::readable::ReadableFile;
use clap::Args;
use launch::{Ingest, Source};
use mapping::names::UnknownName;
use pipeline::{Column, STANDARD_OUTPUT};
use runtime::Pace;
use supervisor::{Report, Request};

use crate::{
    absent::absent_services,
    detached,
    duration::duration,
    failure::{Failure, Outcome, fail_after_result},
    import::{ReadOptions, SensorNumbers, announce_deferred_warning, announcer},
    notice::{is_quiet, notice},
    replay,
    stdout::print,
    system::LaunchArgs,
};

/// Arguments of `plumb up`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  plumb up --launch launch.toml --detach      # until `plumb down`
  plumb up --source 'serial:/dev/ttyUSB0?format=witmotion&rate_hz=200'
  plumb up --replay flight.ulg --speed max --out attitude.csv

SOURCE is KIND:TARGET?key=value&key=value. KIND is sim, stdin, udp, tcp, serial,
mavlink or iio, and the keys are those of its section in the launch file
(docs/how-to/sensors.md). A path such as /dev/ttyUSB0 is a serial port. `plumb
detect` prints the source of a connected sensor.

RECEIVER has the same form, such as serial:/dev/ttyACM0?format=nmea&baud=9600.
Its keys are those of [ingest.receiver].

--replay reads CSV, CSV.gz, PX4 ULog, ArduPilot log, tlog, MCAP or a ROS 2 bag.
A flight recorded with --record is replayed bit for bit in one process, with its
own launch file unless --launch is given.")]
pub(crate) struct Up {
    #[command(flatten)]
    launch: LaunchArgs,
    /// Source instead of the launch file's, such as sim:s1?seed=2
    #[arg(long, value_name = "SOURCE", conflicts_with = "replay")]
    source: Option<String>,
    /// GNSS receiver in addition to a live source, such as tcp:HOST:PORT
    #[arg(long, value_name = "RECEIVER", conflicts_with = "replay")]
    receiver: Option<String>,
    /// Recording, log or flight to use instead of the launch file's source
    #[arg(long, value_name = "FILE")]
    replay: Option<PathBuf>,
    /// Speed relative to real time, 0.001 to 1000000 or max [default: 1]
    #[arg(long, value_name = "X|max", value_parser = pace)]
    speed: Option<Pace>,
    /// Source time to run, such as 500ms, 10s, 2m or 1h [default: all]
    #[arg(long = "for", value_name = "TIME", value_parser = duration)]
    duration: Option<Duration>,
    /// Run all slots in this process, without the bus
    #[arg(long)]
    in_process: bool,
    /// CSV of t_s,qw,qx,qy,qz per tick, in the [output] frame; - is stdout
    #[arg(long, short, value_name = "FILE.csv")]
    out: Option<PathBuf>,
    /// Extra columns for --out: uvz, angles, course, bias, sd, flags or all
    #[arg(long, value_name = "COLUMNS", value_delimiter = ',', value_parser = parse_columns, requires = "out")]
    columns: Vec<Columns>,
    /// Folder for flight recordings, one MCAP file per start
    #[arg(long, value_name = "DIR")]
    record: Option<PathBuf>,
    /// Ignore the gyro bias, gyro scale and hard iron of earlier runs
    #[arg(long)]
    cold: bool,
    /// Publish raw readings, from which a recorded flight can be replayed
    #[arg(long)]
    readings: bool,
    /// Run the programs that a replayed flight's launch file names as stages
    #[arg(long, requires = "replay")]
    trust_programs: bool,
    /// Run in the background, see `plumb logs` and `plumb down`
    #[arg(long, conflicts_with_all = ["in_process", "replay", "json"])]
    detach: bool,
    /// Print one JSON object, or an error object, as the last line
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    reading: ReadOptions,
    #[command(flatten)]
    sensors: SensorNumbers,
}

pub(crate) fn run(up: Up) -> Outcome {
    let Up { launch, source, receiver, replay, speed, duration, in_process, out, columns, record, .. } = up;
    let Up { cold, readings, trust_programs, detach, json, reading, sensors, .. } = up;
    if json && out.as_deref() == Some(Path::new(STANDARD_OUTPUT)) {
        let message = "--json and `--out -` both write to standard output; write the attitudes to a file";
        return Err(Failure::new(message, 2));
    }
    if detach {
        return detached::start(&launch);
    }
    let source =
        source.map(|line| if launch::replay_path(&line).is_some() { line } else { reading.apply_to_source(&line) });
    // A recorded flight can be replayed only from its readings, so recording always includes them.
    let readings = readings || record.is_some();
    let columns = columns.iter().flat_map(|Columns(some)| some.iter().copied());
    let columns = columns.fold(Vec::new(), |mut all, column| {
        if !all.contains(&column) {
            all.push(column);
        }
        all
    });
    let replay = replay.or_else(|| source.as_deref().and_then(launch::replay_path).map(PathBuf::from));
    let imported = None;
    let request = Request {
        launch: launch.launch,
        source,
        receiver,
        replay,
        imported,
        pace: speed,
        duration_s: duration.map(|duration| duration.as_secs_f64()),
        in_process,
        out,
        columns,
        record,
        cold,
        publish_readings: readings,
        absent_services: absent_services(),
        quiet: is_quiet(),
    };
    let report = report(request, &reading, sensors, trust_programs);
    let printed = if json { print(&report.to_json()) } else { ExitCode::SUCCESS };
    Ok(report.error.map_or(printed, |error| fail_after_result(&error, report.exit_code)))
}

/// Replays a flight, or runs the system. If the source is a foreign recording, it is imported
/// first.
fn report(mut request: Request, reading: &ReadOptions, sensors: SensorNumbers, trust_programs: bool) -> Report {
    if request.source.is_none() && request.replay.is_none() {
        request.replay = foreign_recording(&LaunchArgs { launch: request.launch.clone() });
    }
    if reading.is_set() && request.source.is_none() && request.replay.is_none() {
        return Report::from_error(&"--map and --topic need a source: add --replay or --source", 2);
    }
    let result = match request.replay.clone() {
        Some(path) if flight::is_flight(&path) => {
            replay::replay_flight(&request, &path, trust_programs).map_err(|error| *error)
        }
        replay => {
            // An imported recording is a temporary file that is removed on drop, so it is kept
            // until the end of the run.
            let open = |path| ReadableFile::open(path, &reading.options(sensors)?, &mut announcer());
            let readable = match replay.as_deref().map(open).transpose() {
                Ok(readable) => readable,
                Err(error) => return Report::from_error(&error, error.exit_code()),
            };
            request.imported = readable.as_ref().map(|readable| readable.path.clone());
            let result = supervisor::up(&request);
            readable.iter().for_each(announce_deferred_warning);
            let with_user_path = |text: String| match &readable {
                Some(readable) => readable.with_user_path(&text),
                None => text,
            };
            match result {
                Ok(report) => Ok(Report { error: report.error.map(with_user_path), ..report }),
                Err(error) => return Report::from_error(&with_user_path(error.to_string()), error.exit_code()),
            }
        }
    };
    match result {
        Ok(report) => {
            notice(&report);
            report
        }
        Err(error) => Report::from_error(&error, error.exit_code()),
    }
}

/// Returns the recording that a launch file names as its source, unless it is a flight.
///
/// Mistakes in the launch file are reported when the system starts.
fn foreign_recording(launch: &LaunchArgs) -> Option<PathBuf> {
    // A pipe can be read only once, so it is left for the start of the system.
    if launch.path().is_some_and(|path| !path.is_file()) {
        return None;
    }
    let Ingest { source, replay, .. } = launch.read().ok()?.ingest;
    (source == Source::Replay && !flight::is_flight(&replay.file)).then_some(replay.file)
}

/// Columns selected by one name.
#[derive(Debug, Clone)]
struct Columns(Vec<Column>);

fn parse_columns(text: &str) -> Result<Columns, String> {
    let names: Vec<_> = Column::NAMES.iter().map(|(name, _)| *name).chain(["all"]).collect();
    let all = || Columns(Column::NAMES.iter().map(|(_, column)| *column).collect());
    let one = Column::NAMES.iter().find(|(name, _)| *name == text).map(|(_, column)| Columns(vec![*column]));
    one.or_else(|| (text == "all").then(all))
        .ok_or_else(|| UnknownName::new("column group", text, names.iter().copied()).to_string())
}

fn pace(text: &str) -> Result<Pace, String> {
    match text.parse() {
        _ if text == "max" => Ok(Pace::Max),
        Ok(speed) if (1e-3..=1e6).contains(&speed) => Ok(Pace::Speed(speed)),
        _ => Err("expected `max` or a number from 0.001 to 1000000".into()),
    }
}
