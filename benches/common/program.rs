//! Entry point of a benchmark that starts copies of itself and measures them.

use std::process::ExitCode;

use clap::Args;
use serde::de::DeserializeOwned;

use crate::Failure;

// Arguments of a benchmark that measures variants in rounds. A doc comment would replace the
// description of the benchmark in its help.
#[derive(Args)]
#[allow(dead_code, reason = "the benchmark `fleet` has no rounds")]
pub(crate) struct RoundArgs {
    /// Measure each variant for this many seconds per round
    #[arg(long, default_value_t = 3.0)]
    pub(crate) seconds: f64,
    /// Measure all variants in this many rounds
    #[arg(long, default_value_t = 5)]
    pub(crate) rounds: usize,
    /// Print one JSON object on the last line of standard output
    #[arg(long)]
    pub(crate) json: bool,
    /// Accept the flag that cargo passes to every benchmark
    #[arg(long, hide = true)]
    bench: bool,
    /// Run as one measured process, with these settings (JSON)
    #[arg(long, hide = true)]
    pub(crate) process: Option<String>,
}

/// Runs one measured process if `settings` (JSON) is given, otherwise runs the whole benchmark.
///
/// An error is printed to standard error.
pub(crate) fn run<P: DeserializeOwned>(
    settings: Option<&str>,
    run_process: impl FnOnce(&P) -> Result<(), Failure>,
    measure: impl FnOnce() -> Result<(), Failure>,
) -> ExitCode {
    let result = match settings {
        Some(settings) => {
            serde_json::from_str(settings).map_err(Failure::from).and_then(|settings| run_process(&settings))
        }
        None => measure(),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}
