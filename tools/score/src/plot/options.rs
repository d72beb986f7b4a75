//! Options of the figures.

use std::path::PathBuf;

/// Options for the figures.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PlotOptions {
    /// Output folder.
    pub folder: PathBuf,
    /// Start of the time window, seconds from the first sample.
    pub from_s: f64,
    /// End of the time window, seconds from the first sample; `None` for the end of the trial.
    pub to_s: Option<f64>,
    /// Width and height, pixels; `None` for the defaults.
    pub size: Option<(u32, u32)>,
}

impl PlotOptions {
    /// Returns `true` if the time is in the window.
    pub(crate) fn includes(&self, t_s: f64) -> bool {
        t_s >= self.from_s && self.to_s.is_none_or(|to_s| t_s <= to_s)
    }
}
