//! `plumb top`: shows the live state, rate and latency of each service.

mod observed_system;
mod view;

use std::{ops::ControlFlow, process::ExitCode, time::Instant};

use bus::Observer;
use control::{ControlRequest, ServiceStatus, send_request};
use dashboard::Screen;
use observe::top::{SystemMonitor, SystemSnapshot};

use observed_system::ObservedSystem;
pub(crate) use observed_system::TopCommand;

use crate::{
    failure::{Failure, Outcome},
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
) -> Result<Option<SystemSnapshot>, Failure> {
    match send_request::<Vec<ServiceStatus>>(name, &ControlRequest::Status) {
        Ok(statuses) => Ok(Some(monitor.snapshot(name, &statuses))),
        Err(_) if !observer.is_running() => Ok(None),
        Err(error) => Err(error.into()),
    }
}

pub(crate) fn run(command: TopCommand) -> Outcome {
    let observed = ObservedSystem::attach(&command.system.name()?)?;
    if !command.system.json && !command.lines && command.count.is_none() && Screen::is_available() {
        return view::run(&command, observed);
    }
    print_lines(&command, observed)
}

fn print_lines(command: &TopCommand, observed: ObservedSystem) -> Outcome {
    let ObservedSystem { observer, mut monitor, name } = observed;
    let mut stop = StopCondition::new(|| observer.is_running(), command.duration);
    let mut left = command.count.unwrap_or(u64::MAX);
    let mut last = Instant::now();
    while left > 0 && !stop.is_met() {
        std::thread::sleep(POLL_INTERVAL.min(command.interval));
        monitor.poll()?;
        if last.elapsed() < command.interval {
            continue;
        }
        last = Instant::now();
        left -= 1;
        if let Some(snapshot) = take_snapshot(&name, &observer, &mut monitor)?
            && let ControlFlow::Break(code) = print_snapshot(&snapshot, command.system.json)
        {
            return Ok(code);
        }
    }
    if stop.system_ended() {
        notice(format_args!("system {name:?} has ended"));
    }
    Ok(ExitCode::SUCCESS)
}

fn print_snapshot(snapshot: &SystemSnapshot, json: bool) -> ControlFlow<ExitCode> {
    if json {
        // Serialising numbers, strings and lists cannot fail.
        return stdout::print_item(&serde_json::to_string(snapshot).unwrap_or_default());
    }
    stdout::print_truncated(&snapshot.table(stdout::terminal_columns()))
}
