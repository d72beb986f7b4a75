//! What another process has used of the machine.

use std::fs;

use crate::Failure;

/// CPU time of all threads of a process, s.
pub(crate) fn cpu_s(pid: u32) -> Result<f64, Failure> {
    let mut ns = 0.0;
    for task in fs::read_dir(format!("/proc/{pid}/task"))? {
        // A thread may end between the two.
        let text = fs::read_to_string(task?.path().join("schedstat")).unwrap_or_default();
        ns += text.split_whitespace().next().map_or(Ok(0.0), str::parse::<f64>)?;
    }
    Ok(ns * 1e-9)
}
