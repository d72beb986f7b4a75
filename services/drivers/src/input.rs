//! What measurements come from.

use std::time::Duration;

use decoders::{Counts, Measurement};

use crate::{DriversError, line::Absence};

/// A device, whichever way it is read.
pub(crate) trait Input {
    /// Takes what is there, or comes within the limit, and adds what was measured to `found`.
    fn take(&mut self, limit: Duration, found: &mut Vec<Measurement>) -> Result<Step, DriversError>;

    /// How it does.
    fn report(&self) -> Report;
}

/// What came of a look at a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Step {
    /// It gave something.
    Given {
        /// It was away before: something may be missing.
        after_absence: bool,
    },
    /// Nothing within the limit.
    Nothing,
    /// Nothing comes any more.
    End,
}

/// How a device does, since the start.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Report {
    /// Its port, for people.
    pub(crate) place: String,
    /// The name of its format.
    pub(crate) format: &'static str,
    /// Why it is not there, if it is not.
    pub(crate) absence: Option<Absence>,
    /// Bytes that came.
    pub(crate) bytes: u64,
    /// What became of them.
    pub(crate) counts: Counts,
    /// Measurements made of them.
    pub(crate) measurements: u64,
    /// Datagrams of others than the one that is heard.
    pub(crate) strangers: u64,
}
