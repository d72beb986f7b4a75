//! What dead systems and killed processes have left behind.

use bus::{BusError, Domain, Remains, Standing};

use super::Check;

const FIX: &str = "plumb doctor --fix";

/// Looks at one system, or at every one of which there is anything on this machine; with `fix` removes what nobody needs.
pub fn checks(only: Option<&Domain>, fix: bool) -> Vec<Check> {
    let remains = only.map_or_else(Remains::all, |domain| vec![Remains::of(domain)]);
    // Of a system that nobody has named it may be right.
    let check = if only.is_some() { Check::problem } else { Check::warning };
    let foreign = |error: &BusError| check("leftovers", error.to_string(), "left alone; its owner can look");
    let look = |remains: &Result<_, _>| remains.as_ref().map_or_else(|error| Some(foreign(error)), |it| look(it, fix));
    let checks: Vec<_> = remains.iter().filter_map(look).collect();
    if checks.is_empty() { vec![Check::ok("leftovers", "none")] } else { checks }
}

fn look(remains: &Remains, fix: bool) -> Option<Check> {
    let (check, name) = ("leftovers", remains.domain.name());
    let dead = remains.dead.len();
    let found = match &remains.standing {
        Standing::Lingers { pids } => {
            let pids = pids.iter().map(u32::to_string).collect::<Vec<_>>().join(" ");
            let found = format!("the supervisor of {name:?} has ended, processes of it have not: {pids}");
            return Some(Check::problem(check, found, format!("end them (kill -KILL {pids}), then {FIX}")));
        }
        Standing::Runs { pid } if remains.half_made.is_some() => {
            let path = remains.half_made.iter().map(|path| path.display().to_string()).collect::<String>();
            let found =
                format!("a process of {name:?} was killed while it made {path}; whoever opens it waits for ever");
            return Some(Check::problem(check, found, format!("start the system anew: kill {pid}, then plumb up")));
        }
        Standing::Runs { .. } if dead == 0 => return None,
        Standing::Runs { pid } => format!("{dead} killed processes on the bus of {name:?}, which runs (process {pid})"),
        Standing::Dead if remains.files.is_empty() => return None,
        Standing::Dead => {
            let files = remains.files.len();
            format!("{files} files of {name:?}, which does not run any more; {dead} killed processes on its bus")
        }
    };
    if fix {
        return Some(match remains.clear() {
            Ok(()) => Check::ok(check, format!("{found}; removed")),
            Err(error) => {
                Check::problem(check, format!("{found}; {error}"), "try again when nothing of it starts or ends")
            }
        });
    }
    Some(match remains.standing {
        // Whoever joins next cleans up; until then the killed keep their places.
        Standing::Runs { .. } => Check::warning(check, found, FIX),
        _ => Check::problem(check, found, FIX),
    })
}
