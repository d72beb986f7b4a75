//! `plumb top`: how a running system does, from moment to moment.

mod view;

use std::{
    ops::ControlFlow,
    process::ExitCode,
    time::{Duration, Instant},
};

use bus::{BusError, Observer};
use clap::Args;
use control::{ControlError, ControlRequest, ServiceStatus, send_request};
use dashboard::Screen;
use observe::top::{Moment, Top};

use crate::{
    fail, out,
    seeing::{LOOK, Until, duration, observer},
    system::OnBoard,
};

/// The command line of `plumb top`.
#[derive(Args)]
pub(crate) struct TopCommand {
    #[command(flatten)]
    system: OnBoard,
    /// Seconds between two looks.
    #[arg(long, value_name = "SECONDS", default_value = "1", value_parser = duration)]
    interval: Duration,
    /// End after so many looks, and print each below the one before.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    count: Option<u64>,
    /// End after so long [default: q or Ctrl-C ends it].
    #[arg(long, value_parser = duration)]
    seconds: Option<Duration>,
    /// Print each look below the one before, also on a terminal.
    #[arg(long)]
    lines: bool,
}

/// Why a system is not looked at.
#[derive(Debug, thiserror::Error)]
enum TopError {
    /// It does not answer.
    #[error(transparent)]
    Control(#[from] ControlError),
    /// Its bus cannot be read.
    #[error(transparent)]
    Bus(#[from] BusError),
}

/// A system that is looked at.
struct Observed {
    observer: Observer,
    top: Top,
    name: String,
}

impl Observed {
    fn begin(name: &str) -> Result<Self, TopError> {
        let statuses = send_request::<Vec<ServiceStatus>>(name, &ControlRequest::Status)?;
        let observer = observer(name, "top")?;
        Ok(Self { top: Top::new(&observer, &statuses)?, observer, name: name.into() })
    }
}

/// What was seen since the last moment; `None` where the system ended meanwhile.
fn moment(name: &str, observer: &Observer, top: &mut Top) -> Result<Option<Moment>, TopError> {
    match send_request::<Vec<ServiceStatus>>(name, &ControlRequest::Status) {
        Ok(statuses) => Ok(Some(top.moment(name, &statuses))),
        Err(_) if !observer.is_running() => Ok(None),
        Err(error) => Err(error.into()),
    }
}

pub(crate) fn run(command: TopCommand) -> ExitCode {
    let observed = match Observed::begin(&command.system.name()) {
        Ok(observed) => observed,
        Err(error) => return fail(&error, 1),
    };
    if !command.system.json && !command.lines && command.count.is_none() && Screen::is_there() {
        return view::run(&command, observed);
    }
    lines(&command, observed)
}

fn lines(command: &TopCommand, observed: Observed) -> ExitCode {
    let Observed { observer, mut top, name } = observed;
    let mut until = Until::new(|| observer.is_running(), command.seconds);
    let mut left = command.count.unwrap_or(u64::MAX);
    let mut last = Instant::now();
    while left > 0 && !until.is_over() {
        std::thread::sleep(LOOK.min(command.interval));
        if let Err(error) = top.look() {
            return fail(&error, 1);
        }
        if last.elapsed() < command.interval {
            continue;
        }
        last = Instant::now();
        left -= 1;
        let shown = match moment(&name, &observer, &mut top) {
            Ok(Some(moment)) => show(&moment, command.system.json),
            Ok(None) => ControlFlow::Continue(()),
            Err(error) => return fail(&error, 1),
        };
        if let ControlFlow::Break(code) = shown {
            return code;
        }
    }
    if until.system_ended() {
        supervisor::announce(format_args!("the system {name:?} has ended"));
    }
    ExitCode::SUCCESS
}

fn show(moment: &Moment, json: bool) -> ControlFlow<ExitCode> {
    if json {
        // Numbers, strings and lists always serialise.
        return out::show(&serde_json::to_string(moment).unwrap_or_default());
    }
    out::show_lines(&moment.table(out::columns()))
}
