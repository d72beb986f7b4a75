//! The input of a course stage.

use super::reference::Reference;
use crate::{gnss::Fix, numbers::Numbers, state::Attitude};

/// What the course slot is offered at a tick.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CourseInput {
    /// The fused attitude.
    pub attitude: Attitude,
    /// What its heading is counted from.
    pub reference: Reference,
    /// Standard deviation of its heading, rad.
    pub heading_sd_rad: f64,
    /// Of the satellite receiver, at the tick at which it arrived.
    pub fix: Option<Fix>,
    /// Length of the tick's interval, s.
    pub dt_s: f64,
}

impl Numbers for CourseInput {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let Self { attitude, reference, heading_sd_rad, fix, dt_s } = self;
        attitude.visit(visit);
        reference.visit(visit);
        heading_sd_rad.visit(visit);
        fix.visit(visit);
        dt_s.visit(visit);
    }
}
