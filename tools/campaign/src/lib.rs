//! Stress tests that kill services or swap stages of a running system at random, and a
//! demonstration of both.
//!
//! - Input: the number of disturbances and a seed.
//! - Output: lost ticks, a comparison with an undisturbed run, and distributions of times.
//! - Time: disturbances are scheduled and measured with the monotonic clock.
//! - Failure: an error if the system does not start, exits too early or does not exit in time.
#![forbid(unsafe_code)]

mod demo;
mod kills;
mod load;
mod swaps;
mod system_under_test;

use std::{io, path::PathBuf};

use bus::BusError;
use control::ControlError;
use foreign::ForeignText;
use hdrhistogram::Histogram;
use runtime::Pace;
use serde::Serialize;
use supervisor::{Request, UpError};

pub use demo::{Demo, DemoReport};
pub use kills::{KillCampaign, KillCampaignReport};
pub use swaps::{SwapCampaign, SwapCampaignReport};

/// Error that prevents a campaign from being completed.
#[derive(Debug, thiserror::Error)]
pub enum CampaignError {
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The control socket of the system failed.
    #[error(transparent)]
    Control(#[from] ControlError),
    /// The undisturbed run failed.
    #[error("running the undisturbed reference: {0}")]
    UndisturbedRun(Box<UpError>),
    /// The undisturbed run ended too early.
    #[error("running the undisturbed reference: {0}")]
    IncompleteUndisturbedRun(String),
    /// A process or file operation failed.
    #[error("{action}: {cause}")]
    Io {
        /// Failed operation.
        action: &'static str,
        /// Error of the operating system.
        cause: io::Error,
    },
    /// A signal ended the campaign.
    #[error("interrupted before the end")]
    Interrupted,
    /// The system exited during the campaign.
    #[error("the system ended too early: {message}; its log is {log}", log = foreign::path(log))]
    EarlyExit {
        /// Last line of the system's log.
        message: ForeignText,
        /// Path of the system's log.
        log: PathBuf,
    },
    /// The system did not start or did not exit in time.
    #[error("the system did not start or end within {timeout_s} s; see its log {log}", log = foreign::path(log))]
    Timeout {
        /// Time waited, s.
        timeout_s: u64,
        /// Path of the system's log.
        log: PathBuf,
    },
}

impl From<UpError> for CampaignError {
    fn from(error: UpError) -> Self {
        Self::UndisturbedRun(Box::new(error))
    }
}

/// Distribution of times, ms.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct DistributionMs {
    /// Minimum.
    pub min: f64,
    /// Median.
    pub p50: f64,
    /// 90th percentile.
    pub p90: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Maximum.
    pub max: f64,
}

impl DistributionMs {
    fn from_histogram(histogram: &Histogram<u64>) -> Self {
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

/// Creates a histogram of times in ns, up to one minute, with three significant digits.
fn new_histogram_ns() -> Histogram<u64> {
    Histogram::new_with_bounds(1, 60_000_000_000, 3).unwrap_or_else(|_| unreachable!("the bounds are in order"))
}

/// Runs the launch file in one process without a bus. Returns the attitudes in the format of the
/// file that `plumb up --out` writes.
fn run_undisturbed(name: &str, text: &str, duration_s: f64) -> Result<Vec<u8>, CampaignError> {
    let io_error = |action| move |cause| CampaignError::Io { action, cause };
    let folder = tempfile::tempdir().map_err(io_error("creating a folder"))?;
    let (launch, out) = (folder.path().join(format!("{name}.toml")), folder.path().join("attitude.csv"));
    std::fs::write(&launch, text).map_err(io_error("writing the launch file"))?;
    let request = Request {
        launch: Some(launch),
        pace: Some(Pace::Max),
        duration_s: Some(duration_s),
        in_process: true,
        out: Some(out.clone()),
        ..Request::default()
    };
    let report = supervisor::up(&request)?;
    report.error.map_or(Ok(()), |error| Err(CampaignError::IncompleteUndisturbedRun(error)))?;
    std::fs::read(out).map_err(io_error("reading the result"))
}
