//! Input of a course stage.

use super::reference::CourseReference;
use crate::{gnss::Fix, scalars::scalars, state::Attitude};

/// Input of the course slot at a tick.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CourseInput {
    /// Fused attitude.
    pub attitude: Attitude,
    /// Reference direction of the heading.
    pub reference: CourseReference,
    /// Standard deviation of the heading, rad.
    pub heading_sd_rad: f64,
    /// Fix from the satellite receiver, present only at the tick at which it arrived.
    pub fix: Option<Fix>,
    /// Length of the tick's interval, s.
    pub dt_s: f64,
}

scalars!(CourseInput: attitude, reference, heading_sd_rad, fix, dt_s);
