//! Latency and CPU time of one network hop, compared with bare Zenoh.
//!
//! Command: `cargo bench --bench remote`.
//!
//! Input: duration and number of rounds.
//!
//! Output: a table, and with `--json` one object on the last line of standard output.
//!
//! Time: every wait has a timeout, and no process outlives the run.
//!
//! Failure: a variant that fails ends the run with its error.
//!
//! | variant | near end | path | far end |
//! | --- | --- | --- | --- |
//! | `zenoh` | puts bytes | Zenoh | receives the bytes |
//! | `each` | publishes `attitude` on the bus | gateway, one message per sample | decodes it |
//! | `batches` | publishes `attitude` on the bus | gateway, 200 messages per second | decodes it |
//! | `carried` | publishes `imu` on the bus | gateways of a split system | reads another bus |
//! | `tunnel` | publishes samples over iceoryx2 | iceoryx2 tunnels over Zenoh | reads the samples |
//!
//! Each end is a process. In `zenoh`, the near end puts as many bytes as a message with one
//! attitude contains. In `tunnel`, a sample has the size of an IMU sample.
//!
//! Latency is measured from the timestamp taken before a sample is sent until the far end has
//! decoded the sample. All sessions have the settings of `link` and use tcp/127.0.0.1. CPU time is
//! that of all threads in all processes of the hop, including the source, in µs per sample. The
//! first [`WARM_UP_S`] is omitted. Ratios are computed within each round, and the table shows their
//! medians over the rounds. On a shared machine, only values from the same run are comparable.

mod bare;
mod carried;
mod gateway;
mod hop;
mod hop_end;
#[path = "../common/median.rs"]
mod median;
#[path = "../common/process.rs"]
mod process;
#[path = "../common/program.rs"]
mod program;
#[path = "../common/round_args.rs"]
mod round_args;
#[path = "../common/sample.rs"]
mod sample;
mod system;
mod table;
mod tunnel;
#[path = "../common/usage.rs"]
mod usage;

use std::{path::PathBuf, process::ExitCode};

use clap::Parser;
use serde::{Deserialize, Serialize};

use hop_end::ProcessSettings;
use round_args::RoundArgs;
use table::Table;

/// Warm-up omitted at the start of each variant, s.
const WARM_UP_S: f64 = 1.0;
const RATES_HZ: [u32; 3] = [100, 1000, 8000];

type Failure = Box<dyn std::error::Error>;

/// Measure latency and CPU time of one network hop against bare Zenoh
#[derive(Parser)]
struct Cli {
    #[command(flatten)]
    args: RoundArgs,
    /// Measure `tunnel` as well, with this iceoryx2-tunnel program
    #[arg(long)]
    tunnel: Option<PathBuf>,
}

/// Transport of the samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Variant {
    Zenoh,
    Each,
    Batches,
    Carried,
    Tunnel,
}

/// Measured cost of a hop.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct Cost {
    p50_us: f64,
    p99_us: f64,
    /// CPU time of all processes per sample, µs.
    cpu_us: f64,
    lost: u64,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    program::run(cli.args.process.as_deref(), run_process, || measure(&cli))
}

fn run_process(settings: &ProcessSettings) -> Result<(), Failure> {
    hop_end::die_with_parent()?;
    match settings.variant {
        Variant::Zenoh => bare::run_process(settings),
        Variant::Each | Variant::Batches => gateway::run_process(settings),
        Variant::Carried => carried::run_process(settings),
        Variant::Tunnel => tunnel::run_process(settings),
    }
}

fn measure(cli: &Cli) -> Result<(), Failure> {
    cli.args.validate(0.1)?;
    let RoundArgs { seconds, rounds, json, .. } = cli.args;
    let mut variants = vec![Variant::Zenoh, Variant::Each, Variant::Batches, Variant::Carried];
    variants.extend(cli.tunnel.is_some().then_some(Variant::Tunnel));
    let mut table = Table::new(rounds, seconds);
    for round in 0..rounds {
        for rate_hz in RATES_HZ {
            for variant in &variants {
                let cost = match variant {
                    Variant::Zenoh => bare::run(rate_hz, seconds),
                    Variant::Each | Variant::Batches => gateway::run(*variant, rate_hz, seconds),
                    Variant::Carried => carried::run(rate_hz, seconds),
                    Variant::Tunnel => tunnel::run(cli.tunnel.as_deref(), rate_hz, seconds),
                };
                table.add(round, rate_hz, *variant, cost.map_err(|error| format!("{variant:?}: {error}"))?);
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
