//! What a fleet costs its router: `cargo bench --bench fleet`.
//!
//! Input: how many vehicles, how long. Output: a table, CPU time, memory and bytes at the router, and what arrived at a station. Time:
//! every wait has a limit; no process outlives the run. Failure: a fleet that does not come together ends the run with its reason.
//!
//! A process is the router, one the station, and 250 vehicles at most share one: each a session of its own that publishes `attitude` at
//! 50 Hz in messages as the gateway makes them, with the settings of `link`, over tcp/127.0.0.1. The station decodes them all.

mod part;
#[path = "../common/process.rs"]
mod process;
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

use part::{Heard, Part};
use process::Process;
use usage::cpu_s;

type Failure = Box<dyn std::error::Error>;

/// Vehicles in one process.
const VEHICLES_EACH: usize = 250;
/// From the start until all have come together.
const LIMIT: Duration = Duration::from_secs(120);
/// Before anything is measured.
const SETTLING: Duration = Duration::from_secs(3);

/// What a fleet costs its router.
#[derive(Parser)]
struct Cli {
    /// Fleets to measure, one after the other.
    #[arg(long, value_delimiter = ',', default_values_t = [1, 10, 100, 1000])]
    vehicles: Vec<usize>,
    /// Seconds that each is measured.
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    /// What cargo passes to every benchmark.
    #[arg(long, hide = true)]
    bench: bool,
    /// Be one process of the fleet: the part as JSON.
    #[arg(long, hide = true)]
    part: Option<String>,
}

/// What a fleet costs.
struct Cost {
    router_cpu: f64,
    router_mib: f64,
    station_cpu: f64,
    vehicles_cpu: f64,
    /// Over the loopback, to the router and from there, bytes a second.
    bytes_s: f64,
    heard: Heard,
    seconds: f64,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    program::run(cli.part.as_deref(), Part::be, || measure(&cli))
}

fn measure(cli: &Cli) -> Result<(), Failure> {
    if !(1.0..=600.0).contains(&cli.seconds) || !cli.vehicles.iter().all(|count| (1..=2000).contains(count)) {
        return Err("expected 1 to 600 seconds and 1 to 2000 vehicles".into());
    }
    // Each session has files of its own.
    let files = getrlimit(Resource::Nofile);
    setrlimit(Resource::Nofile, Rlimit { current: files.maximum, ..files })?;
    println!(
        "| vehicles | router CPU s/s | µs a message | router MiB | bytes a message, in and out | sent a vehicle, Hz | arrived | lost | station CPU s/s | vehicles CPU s/s |\n| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |"
    );
    for vehicles in &cli.vehicles {
        let Cost { router_cpu, router_mib, station_cpu, vehicles_cpu, bytes_s, heard, seconds } =
            fleet(*vehicles, cli.seconds)?;
        let Heard { arrived, lost, .. } = heard;
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
    let at = format!("tcp/127.0.0.1:{port}");
    let router = start(&Part::Router { at: at.clone() })?;
    let mut station = start(&Part::Station { at: at.clone(), vehicles })?;
    let firsts = (0..vehicles).step_by(VEHICLES_EACH);
    let groups = firsts.map(|first| {
        let count = VEHICLES_EACH.min(vehicles - first);
        start(&Part::Vehicles { at: at.clone(), first, count })
    });
    let mut groups = groups.collect::<Result<Vec<_>, _>>()?;
    groups.iter_mut().try_for_each(|group| group.write_line(""))?;
    station.line(Instant::now() + LIMIT)?;
    thread::sleep(SETTLING);
    let station_pid = station.id();
    let usage = || -> Result<[f64; 4], Failure> {
        let vehicles = groups.iter().map(|group| cpu_s(group.id())).sum::<Result<f64, _>>()?;
        Ok([cpu_s(router.id())?, cpu_s(station_pid)?, vehicles, loopback_bytes()?])
    };
    let (before, begun) = (usage()?, Instant::now());
    station.write_line(&seconds.to_string())?;
    let heard: Heard = serde_json::from_str(&station.line(begun + Duration::from_secs_f64(seconds) + LIMIT)?)?;
    let (after, seconds) = (usage()?, begun.elapsed().as_secs_f64());
    let of = |which: usize| (after[which] - before[which]) / seconds;
    Ok(Cost {
        router_cpu: of(0),
        router_mib: resident_mib(router.id())?,
        station_cpu: of(1),
        vehicles_cpu: of(2),
        bytes_s: of(3),
        heard,
        seconds,
    })
}

/// A process of the fleet, once it is ready.
fn start(part: &Part) -> Result<Process, Failure> {
    let mut process = Process::start(std::env::current_exe()?.as_os_str(), ["--part", &serde_json::to_string(part)?])?;
    process.line(Instant::now() + LIMIT)?;
    Ok(process)
}

/// What a process has in memory, MiB.
fn resident_mib(pid: u32) -> Result<f64, Failure> {
    let text = fs::read_to_string(format!("/proc/{pid}/status"))?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmRSS:")).ok_or("a process has ended early")?;
    Ok(line.split_whitespace().next().ok_or("VmRSS is empty")?.parse::<f64>()? / 1024.0)
}

/// What has gone over the loopback so far, everybody's.
fn loopback_bytes() -> Result<f64, Failure> {
    let text = fs::read_to_string("/proc/net/dev")?;
    let line = text.lines().find_map(|line| line.trim().strip_prefix("lo:")).ok_or("there is no loopback")?;
    Ok(line.split_whitespace().next().ok_or("the loopback has no count")?.parse()?)
}
