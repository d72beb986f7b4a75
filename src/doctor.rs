//! `plumb doctor`: whether the machine and the system are as they should be.

use std::{process::ExitCode, time::Duration};

use bus::{BusError, SystemName};
use clap::Args;
use control::{ControlError, ControlRequest, RecordStatus, ServiceStatus, send_request};
use observe::{
    doctor::{Check, Diagnosis, Outcome, leftovers, machine, running, running::Seen},
    process::is_stopped,
};
use runtime::ServiceConfig;

use crate::{
    fail,
    out::print,
    seeing::{Until, duration, observer},
    system::OnBoard,
};

/// The command line of `plumb doctor`.
#[derive(Args)]
#[command(after_help = "Exit codes: 0 no problem (there may be warnings), 1 a problem remains.")]
pub(crate) struct DoctorCommand {
    #[command(flatten)]
    system: OnBoard,
    /// Remove what dead systems and killed processes have left behind; nothing of a living system is touched. With --system only of
    /// that one.
    #[arg(long)]
    fix: bool,
    /// How long a running system is watched.
    #[arg(long, default_value = "5", value_parser = duration)]
    seconds: Duration,
}

pub(crate) fn run(DoctorCommand { system, fix, seconds }: DoctorCommand) -> ExitCode {
    let name = system.name();
    let system_name = match SystemName::new(&name) {
        Ok(system_name) => system_name,
        Err(error) => return fail(&error, 2),
    };
    let mut checks = machine::checks();
    checks.extend(leftovers::checks(system.is_named().then_some(&system_name), fix));
    checks.extend(match system_name.owner_pid() {
        Ok(Some(pid)) => examine(&name, pid, seconds).unwrap_or_else(|check| vec![check]),
        Ok(None) => vec![match observer(&name, "doctor") {
            Err(error @ BusError::FilesRemoved { .. }) => Check::problem(
                "system",
                error.to_string(),
                "swap a stage, or wait until a service ends; then look again",
            ),
            _ => Check::ok("system", format!("{name:?} does not run")),
        }],
        Err(error) => vec![Check::problem("system", error.to_string(), "free the name as it says, or be its owner")],
    });
    let diagnosis = Diagnosis { system: name, checks };
    // Strings and lists always serialise.
    let printed =
        if system.json { print(&serde_json::to_string(&diagnosis).unwrap_or_default()) } else { print(&diagnosis) };
    if diagnosis.count(Outcome::Problem) > 0 { ExitCode::FAILURE } else { printed }
}

/// How these processes are ended.
fn kill(pids: &[u32]) -> String {
    pids.iter().fold("kill".into(), |line, pid| format!("{line} {pid}"))
}

/// What is to be said about the running system of this supervisor; if it cannot be looked at, that.
fn examine(name: &str, supervisor: u32, seconds: Duration) -> Result<Vec<Check>, Check> {
    let unseen = |error: BusError| {
        let remedy = match &error {
            BusError::TooManyObservers { pids, .. } => format!("end one of them ({}), then look again", kill(pids)),
            _ => "look again".into(),
        };
        Check::warning("system", error.to_string(), remedy)
    };
    let unanswered = |error: ControlError| {
        if is_stopped(supervisor) {
            let found = format!(
                "the supervisor of {name:?}, process {supervisor}, has been stopped: nobody starts services again, and attitudes older than buffer_s are missing in its report and file"
            );
            return Check::problem("system", found, format!("let it go on: kill -CONT {supervisor}"));
        }
        Check::problem("system", error.to_string(), "look again; if it stays so, start the system anew")
    };
    let observer = observer(name, "doctor").map_err(unseen)?;
    let mut until = Until::new(|| observer.is_running(), Some(seconds));
    let seen = Seen::watch(&observer, &mut || until.is_over()).map_err(unseen)?;
    let standings = send_request::<Vec<ServiceStatus>>(name, &ControlRequest::Status).map_err(unanswered)?;
    let config = send_request::<ServiceConfig>(name, &ControlRequest::ServiceConfig).map_err(unanswered)?;
    let record = send_request::<RecordStatus>(name, &ControlRequest::RecordStatus).map_err(unanswered)?;
    Ok([seen.checks(&standings, &config), vec![running::record(&record)]].concat())
}
