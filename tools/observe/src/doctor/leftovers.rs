//! What dead systems and killed processes have left behind.

use bus::{BusError, StaleResources, SystemLiveness, SystemName};
use launch::pluralize;

use super::Check;

const FIX: &str = "plumb doctor --fix";

/// Looks at one system, or at every one of which there is anything on this machine; with `fix` removes what nobody needs.
pub fn checks(only: Option<&SystemName>, fix: bool) -> Vec<Check> {
    let remains = only.map_or_else(StaleResources::all, |system_name| vec![StaleResources::for_system(system_name)]);
    // Of a system that nobody has named it may be right.
    let check = if only.is_some() { Check::problem } else { Check::warning };
    let foreign = |error: &BusError| check("leftovers", error.to_string(), "left alone; its owner can look");
    let look = |remains: &Result<_, _>| remains.as_ref().map_or_else(|error| Some(foreign(error)), |it| look(it, fix));
    let checks: Vec<_> = remains.iter().filter_map(look).collect();
    if checks.is_empty() { vec![Check::ok("leftovers", "none")] } else { checks }
}

fn look(remains: &StaleResources, fix: bool) -> Option<Check> {
    let (check, name) = ("leftovers", remains.system_name.name());
    let dead = remains.dead.len();
    let found = match &remains.liveness {
        SystemLiveness::Lingering { pids } => {
            let pids = pids.iter().map(u32::to_string).collect::<Vec<_>>().join(" ");
            let found = format!("the supervisor of {name:?} has ended, processes of it have not: {pids}");
            return Some(Check::problem(check, found, format!("end them (kill -KILL {pids}), then {FIX}")));
        }
        SystemLiveness::Unreachable { pids } => {
            let found =
                format!("somebody removed files of {name:?} while it runs (processes {pids:?}): nobody can join it");
            let remedy = "it starts anew by itself once a service ends or is swapped; was it logind, set RemoveIPC=no in /etc/systemd/logind.conf";
            return Some(Check::problem(check, found, remedy));
        }
        SystemLiveness::Running { pid } if remains.incomplete_segment.is_some() => {
            let path = remains.incomplete_segment.iter().map(|path| path.display().to_string()).collect::<String>();
            let found =
                format!("a process of {name:?} was killed while it made {path}; whoever opens it waits for ever");
            return Some(Check::problem(check, found, format!("start the system anew: kill {pid}, then plumb up")));
        }
        SystemLiveness::Running { .. } if dead == 0 => return None,
        SystemLiveness::Running { pid } => {
            format!(
                "{} of the killed on the bus of {name:?}, which runs (process {pid})",
                pluralize(dead as u64, "process")
            )
        }
        SystemLiveness::Dead if remains.files.is_empty() => return None,
        SystemLiveness::Dead => {
            let files = pluralize(remains.files.len() as u64, "file");
            let dead = pluralize(dead as u64, "process");
            format!("{files} of {name:?}, which does not run any more; {dead} of the killed on its bus")
        }
    };
    if fix {
        return Some(match remains.remove() {
            Ok(()) => Check::ok(check, format!("{found}; removed")),
            Err(error) => {
                Check::problem(check, format!("{found}; {error}"), "try again when nothing of it starts or ends")
            }
        });
    }
    Some(match remains.liveness {
        // Whoever joins next cleans up; until then the killed keep their places.
        SystemLiveness::Running { .. } => Check::warning(check, found, FIX),
        _ => Check::problem(check, found, FIX),
    })
}
