//! Arguments of `plumb top`, and the system that it observes.

use std::time::Duration;

use bus::Observer;
use clap::Args;
use control::{ControlRequest, ServiceStatus, send_request};
use observe::top::SystemMonitor;

use crate::{duration::duration, failure::Failure, system::LocalSystemArgs, topics::observer};

/// Arguments of `plumb top`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  plumb top
  plumb top --interval 500ms --lines
  plumb top --count 10 --json")]
pub(crate) struct TopCommand {
    #[command(flatten)]
    pub(super) system: LocalSystemArgs,
    /// Interval between two updates, such as 500ms
    #[arg(long, value_name = "TIME", default_value = "1s", value_parser = duration)]
    pub(super) interval: Duration,
    /// Number of updates before stopping; prints them as lines
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub(super) count: Option<u64>,
    /// Time before stopping, such as 10s [default: until q or Ctrl-C]
    #[arg(long = "for", value_name = "TIME", value_parser = duration)]
    pub(super) duration: Option<Duration>,
    /// Print updates as lines, even on a terminal
    #[arg(long)]
    pub(super) lines: bool,
}

/// Running system with its observer.
pub(super) struct ObservedSystem {
    pub(super) observer: Observer,
    pub(super) monitor: SystemMonitor,
    pub(super) name: String,
}

impl ObservedSystem {
    pub(super) fn attach(name: &str) -> Result<Self, Failure> {
        let statuses = send_request::<Vec<ServiceStatus>>(name, &ControlRequest::Status)?;
        let observer = observer(name, "top")?;
        Ok(Self { monitor: SystemMonitor::new(&observer, &statuses)?, observer, name: name.into() })
    }
}
