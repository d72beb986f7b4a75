//! Variants `real` and `other`: `plumb up` with scenario S1. The results are taken from the report
//! of `plumb up`.

use std::{
    ffi::OsStr,
    fs,
    thread::sleep,
    time::{Duration, Instant},
};

use runtime::clock::cpu_time_ns;

use crate::{Cost, Failure, Phases, START_S, process::Process};

/// Time allowed for `plumb` in addition to the duration of the run.
const MAX_OVERHEAD: Duration = Duration::from_secs(20);

/// Path of this build's executable.
pub(crate) const PLUMB: &str = env!("CARGO_BIN_EXE_plumb");

/// Services of the data path, the same as in the other variants.
const SERVICES: &str = "services = [\"ingest\", \"gyro\", \"accel\", \"fuser\", \"course\"]\n";

/// Measures a variant, `real` or `other`, by running the executable `plumb`.
pub(crate) fn run(plumb: &OsStr, rate_hz: u32, seconds: f64) -> Result<Cost, Failure> {
    let folder = tempfile::tempdir()?;
    let launch = folder.path().join("launch.toml");
    let name = format!("bench-real-{}", std::process::id());
    fs::write(
        &launch,
        format!(
            "name = \"{name}\"\n{SERVICES}[ingest.sim]\nscenario = \"s1\"\nrate_hz = {rate_hz}\n[fuser]\nstage = \"wz\"\n"
        ),
    )?;
    let launch = launch.to_str().ok_or("the path of the temporary folder is not valid UTF-8")?;
    let started = Instant::now();
    let deadline = started + Duration::from_secs_f64(seconds) + MAX_OVERHEAD;
    let mut plumb = Process::start(plumb, ["up", "--launch", launch, "--for", &format!("{seconds}s"), "--json"])?;
    let phases = measure_phases(plumb.id(), started, rate_hz, seconds);
    let cost: Cost = serde_json::from_str(&plumb.line(deadline)?)?;
    Ok(Cost { phases: Some(phases), ..cost })
}

/// Measures the CPU time of the start-up phase and of the ticks until `seconds` after `started`.
///
/// The services are still running then, because the run lasts for `seconds` from its first tick.
fn measure_phases(pid: u32, started: Instant, rate_hz: u32, seconds: f64) -> Phases {
    let cpu_s_at = |at_s: f64| {
        sleep(Duration::from_secs_f64(at_s).saturating_sub(started.elapsed()));
        (started.elapsed().as_secs_f64(), cpu_s(pid))
    };
    let (start_end_s, start_s) = cpu_s_at(START_S);
    let (end_s, total_s) = cpu_s_at(seconds);
    let ticks = (end_s - start_end_s) * f64::from(rate_hz);
    Phases { start_s, tick_us: (total_s - start_s) * 1e6 / ticks }
}

/// Returns the CPU time of a process and its children, s.
fn cpu_s(pid: u32) -> f64 {
    let threads = fs::read_dir(format!("/proc/{pid}/task")).into_iter().flatten().flatten();
    let children = threads.filter_map(|thread| fs::read_to_string(thread.path().join("children")).ok());
    let children: Vec<u32> = children.flat_map(|text| numbers(&text)).collect();
    [pid].into_iter().chain(children).filter_map(cpu_time_ns).sum::<u64>() as f64 * 1e-9
}

fn numbers(text: &str) -> Vec<u32> {
    text.split_whitespace().filter_map(|word| word.parse().ok()).collect()
}
