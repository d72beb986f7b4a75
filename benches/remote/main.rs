//! One hop beyond the board beside what it could cost: `cargo bench --bench remote`.
//!
//! Input: how long, how many rounds. Output: a table for people, with `--json` one object on the last line of standard output.
//! Time: every wait has a limit; no process outlives the run. Failure: a variant that does not run ends the run with its reason.
//!
//! | variant | from | over | to |
//! | --- | --- | --- | --- |
//! | `zenoh` | a process that puts as many bytes as a message of one attitude has | Zenoh | a process that receives them |
//! | `each` | a process that publishes `attitude` on the bus | the gateway, a message for each sample | a process that decodes it |
//! | `batches` | the same | the gateway, 200 messages a second | the same |
//! | `carried` | a process that publishes `imu` on the bus of one system | the gateways of a split system | one that reads the bus of another |
//! | `tunnel` | a process that publishes as many bytes by iceoryx2 | iceoryx2's tunnels over Zenoh | one that reads there |
//!
//! Latency is from the stamp before a sample is sent to the far end's, after decoding. All sessions have the settings of `link` and speak
//! over tcp/127.0.0.1. CPU is that of all threads of all processes that belong to the hop, the first included; µs for each sample. What
//! comes in the first [`WARM_S`] is left out. Ratios are within a round, and then the median over rounds: figures of one run on a
//! shared machine compare, figures of two do not.

mod bare;
mod carried;
mod gateway;
#[path = "../common/median.rs"]
mod median;
mod part;
#[path = "../common/process.rs"]
mod process;
#[path = "../common/program.rs"]
mod program;
#[path = "../common/sample.rs"]
mod sample;
mod system;
mod table;
mod tunnel;
#[path = "../common/usage.rs"]
mod usage;
mod watched;

use std::{path::PathBuf, process::ExitCode};

use clap::Parser;
use serde::{Deserialize, Serialize};

use part::Part;
use table::Table;

/// What is left out at the start of each variant, s.
const WARM_S: f64 = 1.0;
const RATES_HZ: [u32; 3] = [100, 1000, 8000];

type Failure = Box<dyn std::error::Error>;

/// Latency and CPU time of one hop beyond the board, beside bare Zenoh.
#[derive(Parser)]
struct Cli {
    /// Seconds that each variant is measured in a round.
    #[arg(long, default_value_t = 3.0)]
    seconds: f64,
    /// Rounds of all variants.
    #[arg(long, default_value_t = 5)]
    rounds: usize,
    /// The executable of iceoryx2-integrations-zenoh-link-tunnel-cli; without it there is no `tunnel`.
    #[arg(long)]
    tunnel: Option<PathBuf>,
    /// Print one JSON object at the end, on the last line of standard output.
    #[arg(long)]
    json: bool,
    /// What cargo passes to every benchmark.
    #[arg(long, hide = true)]
    bench: bool,
    /// Be one process of a hop: the part as JSON.
    #[arg(long, hide = true)]
    part: Option<String>,
}

/// What carries the samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Variant {
    Zenoh,
    Each,
    Batches,
    Carried,
    Tunnel,
}

/// What a hop costs.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct Cost {
    p50_us: f64,
    p99_us: f64,
    /// Of all processes, for each sample.
    cpu_us: f64,
    lost: u64,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    program::run(cli.part.as_deref(), be, || measure(&cli))
}

fn be(part: &Part) -> Result<(), Failure> {
    part::end_with_parent()?;
    match part.variant {
        Variant::Zenoh => bare::be(part),
        Variant::Each | Variant::Batches => gateway::be(part),
        Variant::Carried => carried::be(part),
        Variant::Tunnel => tunnel::be(part),
    }
}

fn measure(cli: &Cli) -> Result<(), Failure> {
    if !(0.1..=60.0).contains(&cli.seconds) || !(1..=1000).contains(&cli.rounds) {
        return Err("expected 0.1 to 60 seconds and 1 to 1000 rounds".into());
    }
    let mut variants = vec![Variant::Zenoh, Variant::Each, Variant::Batches, Variant::Carried];
    variants.extend(cli.tunnel.is_some().then_some(Variant::Tunnel));
    let mut table = Table::new(cli.rounds, cli.seconds);
    for round in 0..cli.rounds {
        for rate_hz in RATES_HZ {
            for variant in &variants {
                let cost = match variant {
                    Variant::Zenoh => bare::run(rate_hz, cli.seconds),
                    Variant::Each | Variant::Batches => gateway::run(*variant, rate_hz, cli.seconds),
                    Variant::Carried => carried::run(rate_hz, cli.seconds),
                    Variant::Tunnel => tunnel::run(cli.tunnel.as_deref(), rate_hz, cli.seconds),
                };
                table.add(round, rate_hz, *variant, cost.map_err(|error| format!("{variant:?}: {error}"))?);
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
