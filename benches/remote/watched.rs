//! The processes of a hop, and their CPU time while samples are measured.

use std::time::{Duration, Instant};

use crate::{
    Cost, Failure,
    part::{Heard, Part},
    process::Process,
    usage::cpu_s,
};

/// From the start until a process must be ready, and from the end until it must have said what it heard.
const LIMIT: Duration = Duration::from_secs(15);

/// Starts a process of this benchmark.
pub(crate) fn start(part: &Part) -> Result<Process, Failure> {
    let mut process = Process::start(std::env::current_exe()?.as_os_str(), ["--part", &serde_json::to_string(part)?])?;
    process.line(Instant::now() + LIMIT)?;
    Ok(process)
}

/// Lets the near end begin; what the far end heard, and what both and those `between` cost.
pub(crate) fn watch(part: &Part, near: &mut Process, between: &[Process], far: &mut Process) -> Result<Cost, Failure> {
    near.write_line("")?;
    let deadline = Instant::now() + Duration::from_secs(part.ticks / u64::from(part.rate_hz)) + LIMIT;
    let pids: Vec<u32> = between.iter().chain([&*near, &*far]).map(Process::id).collect();
    let cpu_s = || pids.iter().map(|pid| cpu_s(*pid)).sum::<Result<f64, Failure>>();
    far.line(deadline)?;
    let before_s = cpu_s()?;
    let heard: Heard = serde_json::from_str(&far.line(deadline)?)?;
    let (expected, Heard { p50_us, p99_us, samples }) = (part.ticks - part.warm_ticks, heard);
    let cpu_us = (cpu_s()? - before_s) * 1e6 / expected as f64;
    Ok(Cost { p50_us, p99_us, cpu_us, lost: expected.saturating_sub(samples) })
}
