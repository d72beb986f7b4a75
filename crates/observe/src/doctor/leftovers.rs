//! Leftovers of dead systems and killed processes.

use bus::{BusError, StaleResources, SystemLiveness, SystemName};
use launch::pluralize;

use super::{Check, remedy::Remedy};

/// Checks one system, or every system that has files on this machine. If `fix` is set, removes the
/// leftovers.
pub fn checks(only: Option<&SystemName>, fix: bool) -> Vec<Check> {
    let stale = only.map_or_else(StaleResources::all, |system_name| vec![StaleResources::for_system(system_name)]);
    // Files that belong to another user are reported as a problem only if their system was
    // requested by name. Otherwise, they may be legitimate.
    let severity_check = if only.is_some() { Check::problem } else { Check::warning };
    let inaccessible = |error: &BusError| severity_check("leftovers", error.to_string(), Remedy::for_bus_error(error));
    let check = |stale: &Result<_, _>| {
        stale.as_ref().map_or_else(|error| Some(inaccessible(error)), |stale| system_check(stale, fix))
    };
    let checks: Vec<_> = stale.iter().filter_map(check).collect();
    if checks.is_empty() { vec![Check::ok("leftovers", "none")] } else { checks }
}

fn system_check(stale: &StaleResources, fix: bool) -> Option<Check> {
    let (check, name) = ("leftovers", stale.system_name.name());
    let killed_count = stale.dead.len();
    let found = match &stale.liveness {
        SystemLiveness::Lingering { pids } => {
            let found = format!("the supervisor of {name:?} has ended, but these processes have not: {pids:?}");
            return Some(Check::problem(check, found, Remedy::KillProcesses(name.into(), pids.clone())));
        }
        SystemLiveness::Unreachable { pids } => {
            let found =
                format!("files of {name:?} were removed while it runs (processes {pids:?}), so no process can join");
            return Some(Check::problem(check, found, Remedy::renew_bus(pids)));
        }
        SystemLiveness::Running { pid } if stale.incomplete_segment.is_some() => {
            let path = stale.incomplete_segment.iter().map(|path| foreign::path(path).to_string()).collect::<String>();
            let found = format!(
                "a process of {name:?} was killed or has stalled while creating {path}; a process that opens it hangs"
            );
            return Some(Check::problem(check, found, Remedy::RestartSystem(*pid)));
        }
        SystemLiveness::Running { .. } if killed_count == 0 => return None,
        SystemLiveness::Running { pid } => {
            let killed = pluralize(killed_count as u64, "killed process");
            format!("{killed} on the bus of {name:?}, which is running (process {pid})")
        }
        SystemLiveness::Dead if stale.files.is_empty() => return None,
        SystemLiveness::Dead => {
            let files = pluralize(stale.files.len() as u64, "file");
            let killed = pluralize(killed_count as u64, "killed process");
            format!("{files} of {name:?}, which is not running; {killed} on its bus")
        }
    };
    if fix {
        return Some(match stale.remove() {
            Ok(()) => Check::ok(check, format!("{found}; removed")),
            Err(error) => Check::problem(check, format!("{found}; {error}"), Remedy::RetryRemoval(name.into())),
        });
    }
    Some(match stale.liveness {
        // The next process that joins the system removes the leftovers. Until then, the ports of
        // the killed processes stay occupied.
        SystemLiveness::Running { .. } => Check::warning(check, found, Remedy::RemoveLeftovers(name.into())),
        _ => Check::problem(check, found, Remedy::RemoveLeftovers(name.into())),
    })
}
