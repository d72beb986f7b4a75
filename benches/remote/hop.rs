//! Starts the processes of a hop and measures their CPU time while samples are sent.

use std::time::{Duration, Instant};

use crate::{
    Cost, Failure,
    hop_end::{FarEndReport, ProcessSettings},
    process::Process,
    usage::cpu_s,
};

/// Time limit for a process to become ready, and for the report after the last sample.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(15);

/// Starts a process of this benchmark and waits until it is ready.
pub(crate) fn start(settings: &ProcessSettings) -> Result<Process, Failure> {
    let mut process =
        Process::start(std::env::current_exe()?.as_os_str(), ["--process", &serde_json::to_string(settings)?])?;
    process.line(Instant::now() + RESPONSE_TIMEOUT)?;
    Ok(process)
}

/// Starts the near end. Returns the latency and the loss at the far end, and the CPU time of all
/// processes.
pub(crate) fn measure(
    settings: &ProcessSettings,
    near: &mut Process,
    between: &[Process],
    far: &mut Process,
) -> Result<Cost, Failure> {
    near.write_input("")?;
    let deadline =
        Instant::now() + Duration::from_secs(settings.ticks / u64::from(settings.rate_hz)) + RESPONSE_TIMEOUT;
    let pids: Vec<u32> = between.iter().chain([&*near, &*far]).map(Process::id).collect();
    let cpu_s = || pids.iter().map(|pid| cpu_s(*pid)).sum::<Result<f64, Failure>>();
    far.line(deadline)?;
    let before_s = cpu_s()?;
    let report: FarEndReport = serde_json::from_str(&far.line(deadline)?)?;
    let (expected, FarEndReport { p50_us, p99_us, samples }) = (settings.ticks - settings.warm_up_ticks, report);
    let cpu_us = (cpu_s()? - before_s) * 1e6 / expected as f64;
    Ok(Cost { p50_us, p99_us, cpu_us, lost: expected.saturating_sub(samples) })
}
