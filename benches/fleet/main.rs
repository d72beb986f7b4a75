//! Load that a fleet of vehicles puts on its router.
//!
//! Command: `cargo bench --bench fleet`.
//!
//! Input: fleet sizes and duration.
//!
//! Output: a table of the CPU time, memory and traffic of the router, and of the messages received
//! by a station.
//!
//! Time: every wait has a timeout, and no process outlives the run.
//!
//! Failure: if a fleet does not connect, the run ends with an error.
//!
//! The router and the station are one process each, and up to 250 vehicles share a process. Each
//! vehicle has its own session with the settings of `link` over tcp/127.0.0.1 and publishes
//! `attitude` at 50 Hz, in messages like those of the gateway. The station decodes all messages.

#[path = "../common/process.rs"]
mod process;
mod processes;
#[path = "../common/program.rs"]
mod program;
#[path = "../common/sample.rs"]
mod sample;
#[path = "../common/usage.rs"]
mod usage;

use std::{
    fs,
    net::TcpListener,
    process::ExitCode,
    thread,
    time::{Duration, Instant},
};

use clap::Parser;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

use process::Process;
use processes::{ProcessSettings, StationReport};
use usage::cpu_s;

type Failure = Box<dyn std::error::Error>;

/// Maximum number of vehicles in one process.
const MAX_VEHICLES_PER_PROCESS: usize = 250;
/// Time allowed for all processes to connect.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(120);
/// Pause before the measurement starts.
const SETTLING_TIME: Duration = Duration::from_secs(3);

/// Measure the load of a router that serves a fleet
#[derive(Parser)]
struct Cli {
    /// Measure fleets of these sizes, one after the other
    #[arg(long, value_delimiter = ',', default_values_t = [1, 10, 100, 1000])]
    vehicles: Vec<usize>,
    /// Measure each fleet for this many seconds
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    /// Accept the flag that cargo passes to every benchmark
    #[arg(long, hide = true)]
    bench: bool,
    /// Run as one process of the fleet, with these settings (JSON)
    #[arg(long, hide = true)]
    process: Option<String>,
}

/// Measured cost of a fleet.
struct Cost {
    router_cpu: f64,
    router_mib: f64,
    station_cpu: f64,
    vehicles_cpu: f64,
    /// Loopback traffic to and from the router, in bytes per second.
    bytes_s: f64,
    report: StationReport,
    seconds: f64,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    program::run(cli.process.as_deref(), ProcessSettings::run, || measure(&cli))
}

fn measure(cli: &Cli) -> Result<(), Failure> {
    if !(1.0..=600.0).contains(&cli.seconds) || !cli.vehicles.iter().all(|count| (1..=2000).contains(count)) {
        return Err("expected 1 to 600 seconds and 1 to 2000 vehicles".into());
    }
    // Each session opens several files, so the open-file limit is raised.
    let files = getrlimit(Resource::Nofile);
    setrlimit(Resource::Nofile, Rlimit { current: files.maximum, ..files })?;
    println!(
        "| vehicles | router CPU s/s | µs a message | router MiB | bytes a message, in and out | sent a vehicle, Hz | arrived | lost | station CPU s/s | vehicles CPU s/s |\n| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |"
    );
    for vehicles in &cli.vehicles {
        let Cost { router_cpu, router_mib, station_cpu, vehicles_cpu, bytes_s, report, seconds } =
            fleet(*vehicles, cli.seconds)?;
        let StationReport { arrived, lost, .. } = report;
        let (arrived_hz, sent) = (arrived as f64 / seconds, (arrived + lost) as f64);
        println!(
            "| {vehicles} | {router_cpu:.3} | {:.1} | {router_mib:.1} | {:.0} | {:.1} | {arrived} | {lost} | {station_cpu:.3} | {vehicles_cpu:.3} |",
            router_cpu * 1e6 / arrived_hz,
            bytes_s / arrived_hz,
            sent / seconds / *vehicles as f64,
        );
    }
    Ok(())
}

fn fleet(vehicles: usize, seconds: f64) -> Result<Cost, Failure> {
    let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let router = start(&ProcessSettings::Router { endpoint: endpoint.clone() })?;
    let mut station = start(&ProcessSettings::Station { endpoint: endpoint.clone(), vehicles })?;
    let firsts = (0..vehicles).step_by(MAX_VEHICLES_PER_PROCESS);
    let groups = firsts.map(|first| {
        let count = MAX_VEHICLES_PER_PROCESS.min(vehicles - first);
        start(&ProcessSettings::Vehicles { endpoint: endpoint.clone(), first, count })
    });
    let mut groups = groups.collect::<Result<Vec<_>, _>>()?;
    groups.iter_mut().try_for_each(|group| group.write_input(""))?;
    station.line(Instant::now() + CONNECT_TIMEOUT)?;
    thread::sleep(SETTLING_TIME);
    let station_pid = station.id();
    let usage = || -> Result<[f64; 4], Failure> {
        let vehicles = groups.iter().map(|group| cpu_s(group.id())).sum::<Result<f64, _>>()?;
        Ok([cpu_s(router.id())?, cpu_s(station_pid)?, vehicles, loopback_bytes()?])
    };
    let (before, started) = (usage()?, Instant::now());
    station.write_input(&seconds.to_string())?;
    let report: StationReport =
        serde_json::from_str(&station.line(started + Duration::from_secs_f64(seconds) + CONNECT_TIMEOUT)?)?;
    let (after, seconds) = (usage()?, started.elapsed().as_secs_f64());
    let per_second = |which: usize| (after[which] - before[which]) / seconds;
    Ok(Cost {
        router_cpu: per_second(0),
        router_mib: resident_mib(router.id())?,
        station_cpu: per_second(1),
        vehicles_cpu: per_second(2),
        bytes_s: per_second(3),
        report,
        seconds,
    })
}

/// Starts a process of the fleet and waits until it is ready.
fn start(settings: &ProcessSettings) -> Result<Process, Failure> {
    let mut process =
        Process::start(std::env::current_exe()?.as_os_str(), ["--process", &serde_json::to_string(settings)?])?;
    process.line(Instant::now() + CONNECT_TIMEOUT)?;
    Ok(process)
}

/// Returns the resident memory of a process, MiB.
fn resident_mib(pid: u32) -> Result<f64, Failure> {
    let text = fs::read_to_string(format!("/proc/{pid}/status"))?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmRSS:")).ok_or("a process has ended early")?;
    Ok(line.split_whitespace().next().ok_or("VmRSS is empty")?.parse::<f64>()? / 1024.0)
}

/// Returns the number of bytes received so far over the loopback interface, by all processes.
fn loopback_bytes() -> Result<f64, Failure> {
    let text = fs::read_to_string("/proc/net/dev")?;
    let line = text.lines().find_map(|line| line.trim().strip_prefix("lo:")).ok_or("there is no loopback interface")?;
    Ok(line.split_whitespace().next().ok_or("the loopback interface has no byte count")?.parse()?)
}
