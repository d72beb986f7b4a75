//! Command-line arguments of a benchmark that measures variants in rounds.

use clap::Args;

use crate::Failure;

// Without a doc comment, which clap would print instead of the description of the benchmark.
#[derive(Args)]
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

impl RoundArgs {
    /// Returns an error unless each variant runs for `min_s` to 60 s per round, and there are 1 to
    /// 1000 rounds.
    pub(crate) fn validate(&self, min_s: f64) -> Result<(), Failure> {
        match (min_s..=60.0).contains(&self.seconds) && (1..=1000).contains(&self.rounds) {
            true => Ok(()),
            false => Err(format!("expected {min_s} to 60 seconds and 1 to 1000 rounds").into()),
        }
    }
}
