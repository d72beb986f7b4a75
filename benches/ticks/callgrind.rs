//! Counts the instructions of functions of this executable with callgrind.

use std::{
    collections::HashMap,
    fs,
    process::{Command, Stdio},
};

use crate::{Counts, Failure};

/// Function in which callgrind counts instructions, including the functions that it calls.
const COUNTED: &str = "ticks::services::count";

/// Runs the services under callgrind. Returns the number of instructions of each function per tick,
/// including the functions that it calls.
pub(crate) fn count(functions: &[&str], ticks: u64) -> Result<Counts, Failure> {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("callgrind.out");
    let output = Command::new("valgrind")
        .args(["--tool=callgrind", "--quiet", &format!("--toggle-collect={COUNTED}*")])
        .arg(format!("--callgrind-out-file={}", path.display()))
        .arg(std::env::current_exe()?)
        .arg("--services")
        .stdin(Stdio::null())
        .output()
        .map_err(|cause| format!("starting valgrind: {cause}; install valgrind"))?;
    if !output.status.success() {
        return Err(format!("valgrind failed: {}", String::from_utf8_lossy(&output.stderr).trim_end()).into());
    }
    let text = fs::read_to_string(&path)?;
    let costs = inclusive_costs(&text)?;
    functions
        .iter()
        .map(|function| {
            let name = format!("ticks::services::{function}");
            let calls = costs.iter().filter(|(called, _)| is_instance(called, &name));
            let cost: u64 = calls.map(|(_, cost)| cost).sum();
            if cost == 0 { Err(format!("callgrind did not count {name}").into()) } else { Ok((function, cost)) }
        })
        .map(|counted| counted.map(|(function, cost)| ((*function).to_owned(), cost / ticks)))
        .collect()
}

/// Returns `true` if `called` is the function `name` or an instance of it.
fn is_instance(called: &str, name: &str) -> bool {
    called.strip_prefix(name).is_some_and(|rest| rest.is_empty() || rest.starts_with("::"))
}

/// Sums the inclusive costs of the calls of each function in callgrind's output.
///
/// A call is described by three lines, such as `cfn=(1) name`, `calls=2 3` and `4 5`. The last
/// number, here 5, is the cost. The name is given only once for each number in parentheses.
fn inclusive_costs(text: &str) -> Result<HashMap<&str, u64>, Failure> {
    let (mut names, mut costs) = (HashMap::new(), HashMap::new());
    let mut called = None;
    let mut is_cost = false;
    for line in text.lines() {
        if is_cost {
            let cost: u64 = line.split_whitespace().last().ok_or("a call without a cost")?.parse()?;
            if let Some(name) = called.and_then(|id| names.get(id)) {
                *costs.entry(*name).or_insert(0) += cost;
            }
            is_cost = false;
        } else if let Some(function) = line.strip_prefix("cfn=").or_else(|| line.strip_prefix("fn=")) {
            let (id, name) = function.split_once(' ').unwrap_or((function, ""));
            if !name.is_empty() {
                names.insert(id, name);
            }
            called = line.starts_with("cfn=").then_some(id);
        } else {
            is_cost = line.starts_with("calls=");
        }
    }
    Ok(costs)
}
