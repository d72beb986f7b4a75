//! `plumb top`: how the services of a running system do, from moment to moment.

use std::{
    ops::ControlFlow,
    process::ExitCode,
    time::{Duration, Instant},
};

use clap::Args;
use control::{ControlRequest, ServiceStatus, ask};
use observe::top::{Moment, Top};

use crate::{
    fail,
    out::{self, Screen},
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
    /// End after so long [default: Ctrl-C ends it].
    #[arg(long, value_parser = duration)]
    seconds: Option<Duration>,
}

pub(crate) fn run(command: TopCommand) -> ExitCode {
    let TopCommand { system, interval, count, seconds } = command;
    let name = system.name();
    let standings = match ask::<Vec<ServiceStatus>>(&name, &ControlRequest::Ps) {
        Ok(standings) => standings,
        Err(error) => return fail(&error, 1),
    };
    let observed = observer(&name, "top").and_then(|observer| Ok((Top::new(&observer, &standings)?, observer)));
    let (mut top, observer) = match observed {
        Ok(observed) => observed,
        Err(error) => return fail(&error, 1),
    };
    let mut until = Until::new(|| observer.is_running(), seconds);
    let screen = Screen::new(!system.json && count.is_none());
    let mut left = count.unwrap_or(u64::MAX);
    let mut last = Instant::now();
    while left > 0 && !until.is_over() {
        std::thread::sleep(LOOK.min(interval));
        if let Err(error) = top.look() {
            return fail(&error, 1);
        }
        if last.elapsed() < interval {
            continue;
        }
        last = Instant::now();
        left -= 1;
        let moment = match ask::<Vec<ServiceStatus>>(&name, &ControlRequest::Ps) {
            Ok(standings) => top.moment(&name, &standings),
            // It ended between two looks.
            Err(_) if !observer.is_running() => continue,
            Err(error) => return fail(&error, 1),
        };
        if let ControlFlow::Break(code) = show(&moment, system.json, &screen) {
            return code;
        }
    }
    drop(screen);
    if until.system_ended() {
        supervisor::announce(format_args!("the system {name:?} has ended"));
    }
    ExitCode::SUCCESS
}

fn show(moment: &Moment, json: bool, screen: &Screen) -> ControlFlow<ExitCode> {
    if json {
        // Numbers, strings and lists always serialise.
        return out::show(&serde_json::to_string(moment).unwrap_or_default());
    }
    screen.show(&|columns| moment.table(columns))
}
