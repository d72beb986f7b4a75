//! What every kind of log gives.
//!
//! A source is read more than once, so that nothing is kept that grows with it: once for what is there, once for the rows, and once
//! for each series that is laid at their times.

use crate::{
    Format, ImportError, Note,
    force_aligner::{ForceAligner, Sample},
    row_writer::{Attitude, RowWriter, Samples},
};

/// Takes fixes, each after the one before it.
pub(crate) type TakeFix<'a> = dyn FnMut(&Fixed) -> Result<(), ImportError> + 'a;

/// A receiver's fix, in our axes; nan where the log does not say.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Fixed {
    /// When it arrived.
    pub(crate) t_ns: i64,
    pub(crate) velocity_m_s: [f64; 3],
    pub(crate) latitude_deg: f64,
    pub(crate) longitude_deg: f64,
    /// Above mean sea level.
    pub(crate) altitude_m: f64,
}

/// What the first reading finds.
#[derive(Debug, Clone, Default)]
pub(crate) struct Survey {
    pub(crate) has_field: bool,
    pub(crate) has_reference: bool,
    pub(crate) notes: Vec<Note>,
    /// Why there may be no row.
    pub(crate) reason: Option<String>,
    /// Where rate and force would be.
    pub(crate) expected: String,
}

/// A recording of another system.
pub(crate) trait Source {
    fn format(&self) -> Format;

    /// To be read in all, bytes, as far as is known.
    fn total_bytes(&self) -> u64;

    /// The first reading. `tell` is told the bytes read of all that are to be read.
    fn survey(&mut self, take: &mut TakeFix<'_>, tell: &mut dyn FnMut(u64)) -> Result<Survey, ImportError>;

    /// The samples of the field.
    fn fields(&self) -> Result<Samples<'_, Sample>, ImportError>;

    /// The attitudes of the reference.
    fn attitudes(&self) -> Result<Samples<'_, Attitude>, ImportError>;

    /// Makes the rows. `tell` is told the bytes read of all that are to be read.
    fn rows(&self, rows: &mut RowWriter, tell: &mut dyn FnMut(u64)) -> Result<ForceAligner, ImportError>;
}
