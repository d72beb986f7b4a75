//! What another process has used of the machine.

use crate::Failure;

/// CPU time of a process, s.
pub(crate) fn cpu_s(pid: u32) -> Result<f64, Failure> {
    let ns = runtime::clock::cpu_time_ns(pid).ok_or_else(|| format!("process {pid} is no more"))?;
    Ok(ns as f64 * 1e-9)
}
