//! Latency and CPU time of each source, compared with a simulation at the same rate.
//!
//! Command: `cargo bench --bench sources`.
//!
//! Input: duration, number of rounds, rate.
//!
//! Output: a table, and with `--json` one object on the last line of standard output.
//!
//! Time: every wait has a timeout, and no process outlives the run.
//!
//! Failure: a source that fails ends the run with its error.
//!
//! Each source other than the simulation is a device in this process. It sends readings at a fixed
//! interval, timestamped with CLOCK_MONOTONIC. Two latencies are measured up to the publication of
//! the attitude: **from ingest**, as reported by `plumb up`, and **from the device**, which starts
//! with the timestamp taken before the bytes are written. CPU time is that of all services and the
//! supervisor, without the device. Ratios to the simulation are computed within each round, and the
//! table shows their medians over the rounds.

mod device;
#[path = "../common/median.rs"]
mod median;

use std::{
    fs::{self, File},
    process::{Command, ExitCode, Stdio},
    thread,
    time::{Duration, Instant},
};

use bus::{Observer, SystemName};
use clap::Parser;
use graph::Topic;
use messages::AttitudeOutput;
use rustix::process::{Pid, Signal, kill_process};
use serde::{Deserialize, Serialize};

use device::{Device, SourceKind};
use median::median;

/// Time allowed for a system in addition to the duration of the run.
const MAX_OVERHEAD: Duration = Duration::from_secs(20);
/// Interval at which the attitudes are polled.
const POLL_INTERVAL: Duration = Duration::from_millis(20);
const PLUMB: &str = env!("CARGO_BIN_EXE_plumb");

type Failure = Box<dyn std::error::Error>;

/// Measure CPU time and latency of each source against a simulation
#[derive(Parser)]
struct Cli {
    /// Measure each source for this many seconds per round
    #[arg(long, default_value_t = 5.0)]
    seconds: f64,
    /// Measure all sources in this many rounds
    #[arg(long, default_value_t = 3)]
    rounds: usize,
    /// Send this many readings per second
    #[arg(long, default_value_t = 200)]
    rate_hz: u32,
    /// Print one JSON object on the last line of standard output
    #[arg(long)]
    json: bool,
    /// Accept the flag that cargo passes to every benchmark
    #[arg(long, hide = true)]
    bench: bool,
}

/// Values of the `plumb up` report that this benchmark uses.
#[derive(Deserialize)]
struct Report {
    latency_us: LatencyUs,
    cpu_s_per_s: f64,
    lost: u64,
}

#[derive(Deserialize)]
struct LatencyUs {
    p50: f64,
    p99: f64,
}

/// Result for one source, either of one round or combined over all rounds.
///
/// Each combined value is a median, except that `lost` is the sum.
#[derive(Clone, Copy, Serialize)]
struct Cost {
    source: &'static str,
    from_ingest_p50_us: f64,
    from_ingest_p99_us: f64,
    /// Median latency from the device, µs; NaN for a simulation.
    from_device_p50_us: f64,
    /// 99th percentile of the latency from the device, µs; NaN for a simulation.
    from_device_p99_us: f64,
    cpu_s_per_s: f64,
    cpu_to_sim: f64,
    lost: u64,
}

fn main() -> ExitCode {
    match measure(&Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

fn measure(cli: &Cli) -> Result<(), Failure> {
    if !(2.0..=60.0).contains(&cli.seconds) || !(1..=1000).contains(&cli.rounds) || !(10..=2000).contains(&cli.rate_hz)
    {
        return Err("expected 2 to 60 seconds, 1 to 1000 rounds, 10 to 2000 readings a second".into());
    }
    let mut costs: Vec<Vec<Cost>> = vec![Vec::new(); SourceKind::ALL.len()];
    for round in 0..cli.rounds {
        let mut sim_cpu = f64::NAN;
        for (costs_of_kind, kind) in costs.iter_mut().zip(SourceKind::ALL) {
            let mut cost = run(kind, cli)?;
            if kind == SourceKind::Sim {
                sim_cpu = cost.cpu_s_per_s;
            }
            cost.cpu_to_sim = cost.cpu_s_per_s / sim_cpu;
            costs_of_kind.push(cost);
        }
        eprintln!("round {} of {}", round + 1, cli.rounds);
    }
    let rows: Vec<_> = costs.iter().map(|costs_of_kind| medians(costs_of_kind)).collect();
    print_table(&rows, cli);
    if cli.json {
        println!("{}", serde_json::to_string(&rows)?);
    }
    Ok(())
}

/// Runs a system with a source of the given kind.
fn run(kind: SourceKind, cli: &Cli) -> Result<Cost, Failure> {
    let folder = tempfile::tempdir()?;
    let name = format!("bench-{}-{}", kind.name(), std::process::id());
    let device = Device::new(kind, &name, folder.path(), cli.rate_hz)?;
    let launch = folder.path().join("launch.toml");
    let services = r#"services = ["ingest", "gyro", "accel", "fuser", "course"]"#;
    fs::write(&launch, format!("name = \"{name}\"\n{services}\n{}", device.launch_sections))?;
    let mut command = Command::new(PLUMB);
    command.args(["up", "--launch"]).arg(&launch).args([
        "--source",
        &device.source,
        "--for",
        &format!("{}s", cli.seconds),
        "--json",
    ]);
    if let Some(pipe) = &device.stdin {
        // Both ends of the FIFO are opened, because opening only one would block.
        command.stdin(File::options().read(true).write(true).open(pipe)?);
    }
    let plumb = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn()?;
    let pid = Pid::from_raw(plumb.id() as i32);
    let deadline = Instant::now() + Duration::from_secs_f64(cli.seconds) + MAX_OVERHEAD;
    let running_device = device.start();
    let (output, latencies) = thread::scope(|scope| {
        let output = scope.spawn(|| plumb.wait_with_output());
        let latencies = from_device(&name, kind, || output.is_finished() || Instant::now() > deadline);
        if let (false, Some(pid)) = (output.is_finished(), pid) {
            // If the process has just ended, the signal is not needed.
            let _ = kill_process(pid, Signal::KILL);
        }
        (output.join(), latencies)
    });
    drop(running_device);
    let output = output.map_err(|_| "the thread that reads the report panicked")??;
    let mut latencies = latencies?;
    if !output.status.success() {
        return Err(format!("{}: {}", kind.name(), String::from_utf8_lossy(&output.stderr).trim_end()).into());
    }
    let stdout = String::from_utf8(output.stdout)?;
    let report = stdout.lines().last().unwrap_or_default();
    if kind != SourceKind::Sim && latencies.is_empty() {
        return Err(format!("{}: no attitude was received", kind.name()).into());
    }
    // The first second is omitted, because the system is still settling.
    latencies.drain(..latencies.len().min(cli.rate_hz as usize));
    latencies.sort_by(f64::total_cmp);
    let quantile = |share: f64| latencies.get((latencies.len() as f64 * share) as usize).copied().unwrap_or(f64::NAN);
    let Report { latency_us, cpu_s_per_s, lost } = serde_json::from_str(report)?;
    Ok(Cost {
        source: kind.name(),
        from_ingest_p50_us: latency_us.p50,
        from_ingest_p99_us: latency_us.p99,
        from_device_p50_us: quantile(0.5),
        from_device_p99_us: quantile(0.99),
        cpu_s_per_s,
        cpu_to_sim: f64::NAN,
        lost,
    })
}

/// Measures the latencies (µs) from the device's timestamp to the publication of the attitude,
/// until `has_ended` returns `true`.
fn from_device(name: &str, kind: SourceKind, has_ended: impl Fn() -> bool) -> Result<Vec<f64>, Failure> {
    let mut latencies = Vec::new();
    let mut tap = None;
    while !has_ended() {
        thread::sleep(POLL_INTERVAL);
        // Timestamps of a simulation are not from CLOCK_MONOTONIC, so the latency is unknown.
        if kind == SourceKind::Sim {
            continue;
        }
        if tap.is_none() {
            // The system can be observed only after it has started.
            let observer = Observer::attach(&SystemName::new(name)?, "bench").ok();
            tap = observer.and_then(|observer| Some((observer.tap(Topic::Attitude).ok()?, observer)));
        }
        let Some((tap, _)) = &tap else { continue };
        tap.drain(&mut |bytes| {
            if let Ok(AttitudeOutput { header, .. }) = bytemuck::try_pod_read_unaligned(bytes) {
                latencies.push(header.t_sent_ns.saturating_sub(header.t_end_ns as u64) as f64 / 1000.0);
            }
        })?;
    }
    Ok(latencies)
}

fn medians(costs: &[Cost]) -> Cost {
    let over = |pick: fn(&Cost) -> f64| median(costs.iter().map(pick));
    Cost {
        source: costs.first().map_or("", |cost| cost.source),
        from_ingest_p50_us: over(|cost| cost.from_ingest_p50_us),
        from_ingest_p99_us: over(|cost| cost.from_ingest_p99_us),
        from_device_p50_us: over(|cost| cost.from_device_p50_us),
        from_device_p99_us: over(|cost| cost.from_device_p99_us),
        cpu_s_per_s: over(|cost| cost.cpu_s_per_s),
        cpu_to_sim: over(|cost| cost.cpu_to_sim),
        lost: costs.iter().map(|cost| cost.lost).sum(),
    }
}

fn print_table(rows: &[Cost], Cli { rounds, seconds, rate_hz, .. }: &Cli) {
    eprintln!("{rate_hz} readings a second; medians over {rounds} rounds of {seconds} s; lost: sum");
    eprintln!(
        "{:10} {:>14} {:>14} {:>14} {:>14} {:>8} {:>8} {:>6}",
        "source", "ingest p50 µs", "ingest p99 µs", "device p50 µs", "device p99 µs", "CPU s/s", "CPU/sim", "lost"
    );
    for row in rows {
        eprintln!(
            "{:10} {:>14.0} {:>14.0} {:>14.0} {:>14.0} {:>8.3} {:>8.2} {:>6}",
            row.source,
            row.from_ingest_p50_us,
            row.from_ingest_p99_us,
            row.from_device_p50_us,
            row.from_device_p99_us,
            row.cpu_s_per_s,
            row.cpu_to_sim,
            row.lost
        );
    }
}
