//! `plumb top`: shows the live state, rate and latency of each service.

mod observed_system;
mod view;

use std::{ops::ControlFlow, process::ExitCode, time::Instant};

use bus::Observer;
use control::{ControlRequest, ServiceStatus, send_request};
use dashboard::Screen;
use observe::top::{SystemMonitor, SystemSnapshot};

pub(crate) use observed_system::TopCommand;
use observed_system::{ObservedSystem, TopError};

use crate::{
    failure::fail,
    notice::notice,
    stdout,
    topics::{POLL_INTERVAL, StopCondition},
};

/// Returns a snapshot that covers the time since the previous one, or `None` if the system has
/// ended.
fn take_snapshot(
    name: &str,
    observer: &Observer,
    monitor: &mut SystemMonitor,
) -> Result<Option<SystemSnapshot>, TopError> {
    match send_request::<Vec<ServiceStatus>>(name, &ControlRequest::Status) {
        Ok(statuses) => Ok(Some(monitor.snapshot(name, &statuses))),
        Err(_) if !observer.is_running() => Ok(None),
        Err(error) => Err(error.into()),
    }
}

pub(crate) fn run(command: TopCommand) -> ExitCode {
    let observed = match command.system.name().map_err(TopError::from).and_then(|name| ObservedSystem::attach(&name)) {
        Ok(observed) => observed,
        Err(error) => return fail(&error, error.exit_code()),
    };
    if !command.system.json && !command.lines && command.count.is_none() && Screen::is_available() {
        return view::run(&command, observed);
    }
    print_lines(&command, observed)
}

fn print_lines(command: &TopCommand, observed: ObservedSystem) -> ExitCode {
    let ObservedSystem { observer, mut monitor, name } = observed;
    let mut stop = StopCondition::new(|| observer.is_running(), command.duration);
    let mut left = command.count.unwrap_or(u64::MAX);
    let mut last = Instant::now();
    while left > 0 && !stop.is_met() {
        std::thread::sleep(POLL_INTERVAL.min(command.interval));
        if let Err(error) = monitor.poll() {
            return fail(&error, 1);
        }
        if last.elapsed() < command.interval {
            continue;
        }
        last = Instant::now();
        left -= 1;
        let printed = match take_snapshot(&name, &observer, &mut monitor) {
            Ok(Some(snapshot)) => print_snapshot(&snapshot, command.system.json),
            Ok(None) => ControlFlow::Continue(()),
            Err(error) => return fail(&error, 1),
        };
        if let ControlFlow::Break(code) = printed {
            return code;
        }
    }
    if stop.system_ended() {
        notice(format_args!("system {name:?} has ended"));
    }
    ExitCode::SUCCESS
}

fn print_snapshot(snapshot: &SystemSnapshot, json: bool) -> ControlFlow<ExitCode> {
    if json {
        // Serialising numbers, strings and lists cannot fail.
        return stdout::print_item(&serde_json::to_string(snapshot).unwrap_or_default());
    }
    stdout::print_truncated(&snapshot.table(stdout::terminal_columns()))
}
