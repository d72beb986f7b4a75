//! `plumb up`: runs a system.

use std::{path::PathBuf, process::ExitCode};

use clap::Args;
use pipeline::Column;
use runtime::Pace;
use supervisor::{Recorder, Report, Request};

use crate::{
    fail_after_result,
    import::{Readable, Reading},
    out::print,
    record::FlightRecorder,
    replay,
};

/// The command line of `plumb up`.
#[derive(Args, Default)]
pub(crate) struct Up {
    /// What runs [default: ./launch.toml, else the one built in].
    launch: Option<PathBuf>,
    /// A source in place of the launch file's, as `sim:s1?seed=2`, `serial:/dev/ttyUSB0?format=witmotion`, `mavlink:udpin:127.0.0.1:14540` or
    /// `stdin`, `udp`, `tcp`, `iio`; what follows `?` are keys of its section in the launch file (docs/sensors.md).
    #[arg(long, value_name = "SOURCE", conflicts_with = "replay")]
    source: Option<String>,
    /// A satellite receiver beside a live source, as `tcp:HOST:PORT`, `serial:/dev/ttyACM0?format=nmea&baud=9600`; keys of `[ingest.receiver]`.
    #[arg(long, value_name = "RECEIVER", conflicts_with = "replay")]
    receiver: Option<String>,
    /// A recording (CSV, CSV.gz, a ULog of PX4, a log of ArduPilot, MCAP or a ROS 2 bag) in place of the launch file's source; or a flight of
    /// `--record`, which is flown again in one process, with its own launch file where none is named.
    #[arg(long, value_name = "FILE")]
    replay: Option<PathBuf>,
    /// Seconds of the source per second, or `max`: as fast as the slowest service.
    #[arg(long, value_name = "X|max", value_parser = pace)]
    speed: Option<Pace>,
    /// How much of the source to run, as `10s`, `500ms`, `2m`, `1h`.
    #[arg(long = "for", value_name = "TIME", value_parser = duration_s)]
    duration_s: Option<f64>,
    /// Run every slot in this process, without the bus.
    #[arg(long)]
    in_process: bool,
    /// Write `t_s,qw,qx,qy,qz` of each tick, in the frame of `[output]`.
    #[arg(long, value_name = "FILE.csv")]
    out: Option<PathBuf>,
    /// What a line of --out has after them, with commas between: uvz, angles, course, bias, sd, flags, or all (docs/recordings.md).
    #[arg(long, value_name = "COLUMNS", value_delimiter = ',', value_parser = columns, requires = "out")]
    columns: Vec<Columns>,
    /// Record the flight from its first tick to its last: each start makes one MCAP file in this folder.
    #[arg(long, value_name = "DIR")]
    record: Option<PathBuf>,
    /// Take nothing over from an earlier run: gyro bias, gyro scale and hard iron are found anew.
    #[arg(long)]
    cold: bool,
    /// Publish on the topic `reading` what the source gives, before anything is done to it: from a recording of that a flight is replayed.
    #[arg(long)]
    readings: bool,
    /// Print one JSON object at the end, on the last line of standard output; what did not run is told there, too, as "error".
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    reading: Reading,
}

pub(crate) fn run(up: Up) -> ExitCode {
    let Up {
        launch,
        source,
        receiver,
        replay,
        speed,
        duration_s,
        in_process,
        out,
        columns,
        record,
        cold,
        readings,
        json,
        reading,
    } = up;
    let source = source.map(|line| if launch::replay_path(&line).is_some() { line } else { reading.source(&line) });
    let mut recorder =
        record.map(|folder| FlightRecorder::new(&folder, launch.as_deref(), source.as_deref(), receiver.as_deref()));
    // A flight that is recorded can be flown again.
    let readings = readings || recorder.is_some();
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
        launch,
        source,
        receiver,
        replay,
        imported,
        pace: speed,
        duration_s,
        in_process,
        out,
        columns,
        cold,
        publish_readings: readings,
    };
    let report = report(request, &reading, recorder.as_mut());
    let printed = if json { print(&report.to_json()) } else { ExitCode::SUCCESS };
    match &report.error {
        Some(error) => fail_after_result(error, report.exit_code),
        None => printed,
    }
}

/// Runs what is asked for, of a recording whatever its format.
fn report(mut request: Request, reading: &Reading, recorder: Option<&mut FlightRecorder>) -> Report {
    if reading.is_said() && request.source.is_none() && request.replay.is_none() {
        return Report::from_error(&"--map and --topic say how --replay or --source is read: name one of them", 2);
    }
    let ran = match request.replay.clone() {
        Some(path) if flight::is_flight(&path) => {
            replay::fly_again(&request, &path, recorder.is_some()).map_err(|error| *error)
        }
        replay => {
            // What is imported is there until the end.
            let readable = match replay.as_deref().map(|path| Readable::of(path, reading)).transpose() {
                Ok(readable) => readable,
                Err(error) => return Report::from_error(&error, error.exit_code()),
            };
            request.imported = readable.as_ref().map(|readable| readable.path.clone());
            supervisor::up(&request, recorder.map(|recorder| recorder as &mut dyn Recorder))
        }
    };
    match ran {
        Ok(report) => {
            supervisor::announce(&report);
            report
        }
        Err(error) => Report::from_error(&error, error.exit_code()),
    }
}

/// Columns of one name.
#[derive(Debug, Clone)]
struct Columns(Vec<Column>);

fn columns(text: &str) -> Result<Columns, String> {
    let names: Vec<_> = Column::NAMES.iter().map(|(name, _)| *name).chain(["all"]).collect();
    let all = || Columns(Column::NAMES.iter().map(|(_, column)| *column).collect());
    let one = Column::NAMES.iter().find(|(name, _)| *name == text).map(|(_, column)| Columns(vec![*column]));
    one.or_else(|| (text == "all").then(all)).ok_or_else(|| {
        let meant = launch::nearest(text, &names).map_or_else(String::new, |name| format!("did you mean {name:?}? "));
        format!("{meant}there are {}", names.join(", "))
    })
}

fn pace(text: &str) -> Result<Pace, String> {
    match text.parse() {
        _ if text == "max" => Ok(Pace::Max),
        Ok(speed) if (1e-3..=1e6).contains(&speed) => Ok(Pace::Speed(speed)),
        _ => Err("expected `max` or a number from 0.001 to 1000000".into()),
    }
}

pub(crate) fn duration_s(text: &str) -> Result<f64, String> {
    let split = text.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(text.len());
    let scale = match &text[split..] {
        "ms" => 1e-3,
        "s" | "" => 1.0,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        _ => return Err("expected a number with ms, s, m or h".into()),
    };
    let number: f64 = text[..split].trim().parse().map_err(|_| "expected a number with ms, s, m or h")?;
    Some(number * scale).filter(|s| (1e-3..=1e8).contains(s)).ok_or_else(|| "expected 1 ms to 27000 h".into())
}
