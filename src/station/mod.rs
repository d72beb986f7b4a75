//! `plumb station`: monitors remote vehicles and verifies that all their messages arrive.

mod lines;
mod view;

use std::{
    error::Error,
    ops::ControlFlow,
    path::PathBuf,
    process::ExitCode,
    time::{Duration, Instant},
};

use clap::Args;
use dashboard::Screen;
use link::Link;
use observe::tables::{CsvTables, TableError};
use remote::fleet::{self, FleetMonitor, Vehicles};

use crate::{
    duration::duration,
    failure::{OrFail as _, Outcome},
    stdout,
    system::EndpointArgs,
    topics::StopCondition,
};

/// Interval between two printed tables.
const SHOW_INTERVAL: Duration = Duration::from_secs(1);

/// Arguments of `plumb station`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  plumb station
  plumb station --connect quic/192.168.1.5:7447 --keys keys/viewer.wall
  plumb station --csv tables --for 1m")]
pub(crate) struct Station {
    #[command(flatten)]
    endpoint: EndpointArgs,
    /// Vehicle to show in detail [default: the first]
    #[arg(long)]
    vehicle: Option<String>,
    /// Time before stopping, such as 10s [default: until q or Ctrl-C]
    #[arg(long = "for", value_name = "TIME", value_parser = duration)]
    duration: Option<Duration>,
    /// Folder for a table VEHICLE/TOPIC.csv of each topic
    #[arg(long, value_name = "DIR")]
    csv: Option<PathBuf>,
    /// Print one JSON object on the last line of standard output
    #[arg(long)]
    json: bool,
    /// Print a table each second, even on a terminal
    #[arg(long)]
    lines: bool,
}

/// Monitors vehicles until the time limit is reached, the user quits or a signal arrives.
pub(crate) fn run(station: &Station) -> Outcome {
    let link = station.endpoint.endpoint().open()?;
    let (vehicles, printed) = monitor_vehicles(station, &link).or_fail(1)?;
    Ok(match station.json {
        true => stdout::print(&fleet::to_json(&vehicles)),
        false => printed.break_value().unwrap_or(ExitCode::SUCCESS),
    })
}

fn monitor_vehicles(station: &Station, link: &Link) -> Result<(Vehicles, ControlFlow<ExitCode>), Box<dyn Error>> {
    let mut monitor = FleetMonitor::open(link, &["*"], station.csv.as_deref().map(CsvTables::new))?;
    let mut stop = StopCondition::new(|| true, station.duration);
    let printed = if !station.json && !station.lines && Screen::is_available() {
        view::show(&mut monitor, &mut stop, station.vehicle.as_deref())?;
        ControlFlow::Continue(())
    } else {
        print_tables(&mut monitor, &mut stop, station)?
    };
    let vehicles = monitor.finish()?;
    link.close();
    Ok((vehicles, printed))
}

fn print_tables(
    monitor: &mut FleetMonitor,
    stop: &mut StopCondition<'_>,
    station: &Station,
) -> Result<ControlFlow<ExitCode>, TableError> {
    let (mut printed, mut shown_at) = (ControlFlow::Continue(()), Instant::now());
    while printed.is_continue() && !stop.is_met() {
        monitor.poll()?;
        if shown_at.elapsed() > SHOW_INTERVAL && !station.json {
            shown_at = Instant::now();
            printed = stdout::print_truncated(&lines::table(&monitor.vehicles, station.vehicle.as_deref()));
        }
    }
    Ok(printed)
}
