//! Latency and CPU time of the pipeline beside those of the least it could cost: `cargo bench --bench pipeline`.
//!
//! Input: how long, how many rounds. Output: a table for people, with `--json` one object on the last line of standard output.
//! Time: every wait has a limit; no process outlives the run. Failure: a variant that does not run ends the run with its reason.
//!
//! | variant | what it is | latency | CPU time |
//! | --- | --- | --- | --- |
//! | `raw` | 5 processes, one fan-out, one join; each topic a ring in shared memory and a futex word: the limit | to the receipt by the last | 5 processes |
//! | `bus` | the same over `crates/bus`, headers passed on | to the receipt by the last | 5 processes |
//! | `real` | `plumb up` with the fuser `wz` | to the publication by the last | 5 services, supervisor |
//! | `other` | the same of another executable, with `--other` | the same | the same |
//!
//! Latency is from the stamp before a sample's first send. `raw` and `bus` leave out their first [`WARM_S`]; `real` leaves out
//! what comes before its first sample only. Ratios are to `raw` (or to `other`) within a round, and then the median over rounds: figures
//! of one run on a shared machine compare, figures of two do not.

mod bus;
mod chain;
#[path = "../common/median.rs"]
mod median;
#[path = "../common/process.rs"]
mod process;
#[path = "../common/program.rs"]
mod program;
mod raw;
mod real;
mod table;

use std::{ffi::OsString, process::ExitCode};

use clap::Parser;
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
use serde::{Deserialize, Serialize};

use chain::Part;
use table::Table;

/// What `raw` and `bus` leave out at the start, s.
const WARM_S: f64 = 0.5;
const RATES_HZ: [u32; 2] = [1000, 8000];

type Failure = Box<dyn std::error::Error>;

/// Latency and CPU time of the pipeline, of its bus, and of the least that both could cost.
#[derive(Parser)]
struct Cli {
    /// Seconds that each variant is measured in a round.
    #[arg(long, default_value_t = 3.0)]
    seconds: f64,
    /// Rounds of all variants.
    #[arg(long, default_value_t = 5)]
    rounds: usize,
    /// Measure another `plumb` in the same rounds: an earlier build, say.
    #[arg(long, value_name = "PLUMB")]
    other: Option<OsString>,
    /// Print one JSON object at the end, on the last line of standard output.
    #[arg(long)]
    json: bool,
    /// What cargo passes to every benchmark.
    #[arg(long, hide = true)]
    bench: bool,
    /// Be one process of a chain: the part as JSON.
    #[arg(long, hide = true)]
    part: Option<String>,
}

/// What carries the samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Variant {
    Raw,
    Bus,
    Real,
    Other,
}

/// Where the processes may run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Mode {
    Free,
    One,
}

/// What a run costs; as far as it goes, the report of `plumb up`.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct Cost {
    latency_us: LatencyUs,
    cpu_s_per_s: f64,
    lost: u64,
}

/// Latency, µs.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct LatencyUs {
    p50: f64,
    p99: f64,
    p999: f64,
    max: f64,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    program::run(cli.part.as_deref(), be, || measure(&cli))
}

fn be(part: &Part) -> Result<(), Failure> {
    match part.variant {
        Variant::Raw => raw::be(part),
        Variant::Bus => bus::be(part),
        Variant::Real | Variant::Other => Err("the real pipeline has no part here".into()),
    }
}

fn measure(cli: &Cli) -> Result<(), Failure> {
    if !(0.1..=60.0).contains(&cli.seconds) || !(1..=1000).contains(&cli.rounds) {
        return Err("expected 0.1 to 60 seconds and 1 to 1000 rounds".into());
    }
    let mut table = Table::new(cli.rounds, cli.seconds);
    for round in 0..cli.rounds {
        for mode in [Mode::Free, Mode::One] {
            let _pinned = (mode == Mode::One).then(Pinned::to_last_core).transpose()?;
            for rate_hz in RATES_HZ {
                let mut add = |variant, cost| table.add(round, mode, rate_hz, variant, cost);
                add(Variant::Raw, raw::run(rate_hz, cli.seconds)?);
                add(Variant::Bus, bus::run(rate_hz, cli.seconds)?);
                add(Variant::Real, real::run(real::PLUMB.as_ref(), rate_hz, cli.seconds)?);
                if let Some(other) = &cli.other {
                    add(Variant::Other, real::run(other, rate_hz, cli.seconds)?);
                }
            }
        }
        eprintln!("round {} of {}", round + 1, cli.rounds);
    }
    eprint!("{table}");
    if cli.json {
        println!("{}", table.json()?);
    }
    Ok(())
}

/// This process, and what it starts, on one core until it is dropped.
struct Pinned {
    before: CpuSet,
}

impl Pinned {
    fn to_last_core() -> Result<Self, Failure> {
        let before = sched_getaffinity(None)?;
        let last = (0..CpuSet::MAX_CPU).rfind(|core| before.is_set(*core)).ok_or("there is no core to run on")?;
        let mut one = CpuSet::new();
        one.set(last);
        sched_setaffinity(None, &one)?;
        Ok(Self { before })
    }
}

impl Drop for Pinned {
    fn drop(&mut self) {
        // The cores were allowed before.
        let _ = sched_setaffinity(None, &self.before);
    }
}
