//! Latency and CPU time of the pipeline, compared with a minimal chain of processes.
//!
//! Command: `cargo bench --bench pipeline`.
//!
//! Input: duration and number of rounds.
//!
//! Output: a table, and with `--json` one object on the last line of standard output.
//!
//! Time: every wait has a timeout, and no process outlives the run.
//!
//! Failure: a variant that fails ends the run with its error.
//!
//! | variant | description | latency up to | CPU time |
//! | --- | --- | --- | --- |
//! | `raw` | 5 processes over shared-memory rings, without a bus | receipt | 5 processes |
//! | `bus` | the same processes over `crates/bus` | receipt | 5 processes |
//! | `real` | `plumb up` with the fuser `wz` | publication | 5 services, supervisor |
//! | `other` | another `plumb` executable, with `--other` | publication | 5 services, supervisor |
//!
//! The 5 processes have one fan-out and one join. In `raw`, each topic is a ring in shared memory
//! with a futex. In `bus`, the processes forward the message headers.
//!
//! Latency is measured from the timestamp taken before a sample is first sent, up to receipt by the
//! last process or publication by the last service. `raw` and `bus` omit the first [`WARM_UP_S`];
//! `real` omits only the time before its first sample. Ratios to `raw` (or to `other`) are computed
//! within each round, and the table shows their medians over the rounds. On a shared machine, only
//! values from the same run are comparable.
//!
//! For `real` and `other` the table also shows the CPU time of the first [`START_S`], and the CPU
//! time per tick in the rest of the run. The CPU time per second covers the whole run.

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
#[path = "../common/round_args.rs"]
mod round_args;
mod table;

use std::{ffi::OsString, process::ExitCode};

use clap::Parser;
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
use serde::{Deserialize, Serialize};

use chain::ProcessSettings;
use round_args::RoundArgs;
use table::Table;

/// Warm-up omitted by `raw` and `bus`, s.
const WARM_UP_S: f64 = 0.5;
/// Shortest run, s. It leaves time for a steady state after the start-up phase.
const MIN_S: f64 = 1.5;
/// Duration of the start-up phase of `real` and `other`, s. The rest of a run counts as steady
/// state.
const START_S: f64 = 1.0;
const RATES_HZ: [u32; 2] = [1000, 8000];

type Failure = Box<dyn std::error::Error>;

/// Measure latency and CPU time of the pipeline and of minimal chains
#[derive(Parser)]
struct Cli {
    #[command(flatten)]
    args: RoundArgs,
    /// Also measure another plumb executable, such as an earlier build
    #[arg(long, value_name = "PLUMB")]
    other: Option<OsString>,
}

/// Transport of the samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Variant {
    Raw,
    Bus,
    Real,
    Other,
}

/// Processor cores on which the processes may run: all, or one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Mode {
    Free,
    One,
}

/// Result of a run. For `real` and `other`, all values except `phases` are read from the report of
/// `plumb up`.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct Cost {
    latency_us: LatencyUs,
    cpu_s_per_s: f64,
    lost: u64,
    /// CPU time by phase of the run; `None` if it was not measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    phases: Option<Phases>,
}

/// CPU time of all processes, in two phases of a run.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct Phases {
    /// CPU time of the first [`START_S`] of a run, s.
    start_s: f64,
    /// CPU time per tick in the rest of the run, µs.
    tick_us: f64,
}

/// Latency quantiles, µs.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct LatencyUs {
    p50: f64,
    p99: f64,
    p999: f64,
    max: f64,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    program::run(cli.args.process.as_deref(), run_process, || measure(&cli))
}

fn run_process(settings: &ProcessSettings) -> Result<(), Failure> {
    match settings.variant {
        Variant::Raw => raw::run_process(settings),
        Variant::Bus => bus::run_process(settings),
        Variant::Real | Variant::Other => Err("`real` and `other` have no processes of this benchmark".into()),
    }
}

fn measure(cli: &Cli) -> Result<(), Failure> {
    cli.args.validate(MIN_S)?;
    let RoundArgs { seconds, rounds, json, .. } = cli.args;
    let mut table = Table::new(rounds, seconds);
    for round in 0..rounds {
        for mode in [Mode::Free, Mode::One] {
            let _pinning = (mode == Mode::One).then(CorePinning::to_last_core).transpose()?;
            for rate_hz in RATES_HZ {
                let mut add = |variant, cost| table.add(round, mode, rate_hz, variant, cost);
                add(Variant::Raw, raw::run(rate_hz, seconds)?);
                add(Variant::Bus, bus::run(rate_hz, seconds)?);
                add(Variant::Real, real::run(real::PLUMB.as_ref(), rate_hz, seconds)?);
                if let Some(other) = &cli.other {
                    add(Variant::Other, real::run(other, rate_hz, seconds)?);
                }
            }
        }
        eprintln!("round {} of {rounds}", round + 1);
    }
    eprint!("{table}");
    if json {
        println!("{}", table.json()?);
    }
    Ok(())
}

/// Pins this process and its children to one core until dropped.
struct CorePinning {
    before: CpuSet,
}

impl CorePinning {
    fn to_last_core() -> Result<Self, Failure> {
        let before = sched_getaffinity(None)?;
        let last_core = (0..CpuSet::MAX_CPU).rfind(|core| before.is_set(*core)).ok_or("no core is available")?;
        let mut one = CpuSet::new();
        one.set(last_core);
        sched_setaffinity(None, &one)?;
        Ok(Self { before })
    }
}

impl Drop for CorePinning {
    fn drop(&mut self) {
        // All these cores were allowed before pinning, so the call cannot fail.
        let _ = sched_setaffinity(None, &self.before);
    }
}
