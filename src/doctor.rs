//! `plumb doctor`: checks the machine and the system and suggests remedies.

use std::{process::ExitCode, time::Duration};

use bus::{BusError, SystemName};
use clap::Args;
use control::{ControlError, ControlRequest, RecordStatus, ServiceStatus, send_request};
use observe::{
    doctor::{Check, DoctorReport, Severity, leftovers, machine, remedy::Remedy, running, running::Observation},
    process::is_stopped,
};
use runtime::ServiceConfig;
use supervisor::LastRun;

use crate::{
    duration::duration,
    failure::{OrFail as _, Outcome},
    notice::colored_results,
    stdout::print,
    system::LocalSystemArgs,
    topics::{StopCondition, observer},
};

/// Column at which the details of a check begin.
const DETAIL_COLUMN: usize = 25;

/// Arguments of `plumb doctor`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  plumb doctor
  plumb doctor --for 30s
  plumb doctor --fix

Exit codes: 0 no problem (warnings are possible), 1 a problem remains.")]
pub(crate) struct DoctorCommand {
    #[command(flatten)]
    system: LocalSystemArgs,
    /// Remove leftover files of dead systems, or only of the selected one
    #[arg(long)]
    fix: bool,
    /// Observation time of a running system, such as 500ms or 1m
    #[arg(long = "for", value_name = "TIME", default_value = "5s", value_parser = duration)]
    duration: Duration,
}

pub(crate) fn run(DoctorCommand { system, fix, duration }: DoctorCommand) -> Outcome {
    let name = system.name()?;
    let system_name = SystemName::new(&name).or_fail(2)?;
    let mut checks = machine::checks();
    checks.extend(leftovers::checks(system.selection.is_named().then_some(&system_name), fix));
    checks.extend(match system_name.owner_pid() {
        Ok(Some(pid)) => check_running_system(&name, pid, duration).unwrap_or_else(|check| vec![*check]),
        Ok(None) => vec![match observer(&name, "doctor") {
            Err(error @ BusError::FilesRemoved { .. }) => {
                Check::problem("system", error.to_string(), Remedy::for_bus_error(&error))
            }
            _ => match LastRun::read(&name) {
                Some(run) => Check::warning("system", format!("{name:?} is not running; {run}"), Remedy::StartSystem),
                None => Check::ok("system", format!("{name:?} is not running")),
            },
        }],
        Err(error) => {
            vec![Check::problem("system", error.to_string(), Remedy::for_bus_error(&error))]
        }
    });
    let diagnosis = DoctorReport { system: name, checks };
    // Serialising strings and lists cannot fail.
    let printed = if system.json {
        print(&serde_json::to_string(&diagnosis).unwrap_or_default())
    } else {
        print(&colored_results(&diagnosis, DETAIL_COLUMN))
    };
    Ok(if diagnosis.count(Severity::Problem) > 0 { ExitCode::FAILURE } else { printed })
}

/// Checks the running system of the given supervisor. Returns a failed check if it cannot be
/// observed.
fn check_running_system(name: &str, supervisor: u32, duration: Duration) -> Result<Vec<Check>, Box<Check>> {
    let observe_failed =
        |error: BusError| Box::new(Check::warning("system", error.to_string(), Remedy::for_bus_error(&error)));
    let request_failed = |error: ControlError| {
        if is_stopped(supervisor) {
            let found = format!(
                "the supervisor of {name:?}, process {supervisor}, has been stopped: no service is restarted, and its report and file lack attitudes older than buffer_s"
            );
            return Box::new(Check::problem("system", found, Remedy::ResumeSupervisor(supervisor)));
        }
        Box::new(Check::problem("system", error.to_string(), Remedy::RunAgain))
    };
    let observer = observer(name, "doctor").map_err(observe_failed)?;
    let mut stop = StopCondition::new(|| observer.is_running(), Some(duration));
    let snapshot = Observation::collect(&observer, &mut || stop.is_met()).map_err(observe_failed)?;
    let statuses = send_request::<Vec<ServiceStatus>>(name, &ControlRequest::Status).map_err(request_failed)?;
    let config = send_request::<ServiceConfig>(name, &ControlRequest::ServiceConfig).map_err(request_failed)?;
    let record = send_request::<RecordStatus>(name, &ControlRequest::RecordStatus).map_err(request_failed)?;
    Ok([snapshot.checks(&statuses, &config), vec![running::record_check(&record, &config)]].concat())
}
