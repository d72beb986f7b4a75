//! Campaigns against a running system: what becomes of its output when services are killed or swapped at random moments.
//!
//! Input: how often, and a seed. Output: what was lost, whether the bytes are those of an undisturbed run, and the distribution of the
//! times. Time: the clock, for the moments and the measures. Failure: a system that does not start, or does not come to its end.
#![forbid(unsafe_code)]

mod kills;
mod load;
mod swaps;
mod system_under_test;

use std::{io, path::PathBuf};

use bus::BusError;
use control::ControlError;
use hdrhistogram::Histogram;
use runtime::Pace;
use serde::Serialize;
use supervisor::{Request, UpError};

pub use kills::{Kills, KillsReport};
pub use swaps::{Swaps, SwapsReport};

/// Why a campaign could not be carried out.
#[derive(Debug, thiserror::Error)]
pub enum CampaignError {
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The system did not answer a request.
    #[error(transparent)]
    Door(#[from] ControlError),
    /// The undisturbed run failed.
    #[error("running the same without a disturbance: {0}")]
    Undisturbed(Box<UpError>),
    /// The undisturbed run is not whole.
    #[error("running the same without a disturbance: {0}")]
    NotWhole(String),
    /// A process or a file failed.
    #[error("{doing}: {cause}")]
    System {
        /// What was being done.
        doing: &'static str,
        /// What the system answered.
        cause: io::Error,
    },
    /// The system ended by itself.
    #[error("the system ended before the campaign did; what it said is in {log}")]
    Ended {
        /// Its log.
        log: PathBuf,
    },
    /// The system does not run.
    #[error("the system did not give an attitude within {limit_s} s; what it said is in {log}")]
    Silent {
        /// How long it was waited for.
        limit_s: u64,
        /// Its log.
        log: PathBuf,
    },
}

impl From<UpError> for CampaignError {
    fn from(error: UpError) -> Self {
        Self::Undisturbed(Box::new(error))
    }
}

/// The distribution of times, ms.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct DistributionMs {
    /// Smallest.
    pub min: f64,
    /// Median.
    pub p50: f64,
    /// 90 %.
    pub p90: f64,
    /// 99 %.
    pub p99: f64,
    /// Largest.
    pub max: f64,
}

impl DistributionMs {
    fn of(histogram: &Histogram<u64>) -> Self {
        let ms = |ns: u64| ns as f64 * 1e-6;
        let at = |quantile| ms(histogram.value_at_quantile(quantile));
        Self { min: ms(histogram.min()), p50: at(0.5), p90: at(0.9), p99: at(0.99), max: ms(histogram.max()) }
    }
}

impl std::fmt::Display for DistributionMs {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { min, p50, p90, p99, max } = self;
        write!(f, "min {min:.1} ms, p50 {p50:.1} ms, p90 {p90:.1} ms, p99 {p99:.1} ms, max {max:.1} ms")
    }
}

/// Times up to a minute to three digits.
fn times_ns() -> Histogram<u64> {
    Histogram::new_with_bounds(1, 60_000_000_000, 3).unwrap_or_else(|_| unreachable!("the bounds are in order"))
}

/// The attitudes of the same launch file in one process without a bus, as a file of `plumb up --out`.
fn undisturbed(name: &str, text: &str, duration_s: f64) -> Result<Vec<u8>, CampaignError> {
    let system = |doing| move |cause| CampaignError::System { doing, cause };
    let folder = tempfile::tempdir().map_err(system("making a folder"))?;
    let (launch, out) = (folder.path().join(format!("{name}.toml")), folder.path().join("attitude.csv"));
    std::fs::write(&launch, text).map_err(system("writing the launch file"))?;
    let request = Request {
        launch: Some(launch),
        pace: Some(Pace::Max),
        duration_s: Some(duration_s),
        in_process: true,
        out: Some(out.clone()),
        ..Request::default()
    };
    let report = supervisor::up(&request, None)?;
    report.error.map_or(Ok(()), |error| Err(CampaignError::NotWhole(error)))?;
    std::fs::read(out).map_err(system("reading the result"))
}
