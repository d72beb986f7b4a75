//! CPU time of another process.

use crate::Failure;

/// Returns the CPU time of a process, s.
pub(crate) fn cpu_s(pid: u32) -> Result<f64, Failure> {
    let ns = runtime::clock::cpu_time_ns(pid).ok_or_else(|| format!("process {pid} has ended"))?;
    Ok(ns as f64 * 1e-9)
}
