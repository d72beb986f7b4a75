//! Interface of all source formats.
//!
//! A source is read in several passes: a survey, one pass for the rows, and one pass for each
//! series that is merged into the rows. The memory required therefore does not grow with the length
//! of the source.

use foreign::ForeignText;

use crate::{
    Format, ImportError, Note,
    force_aligner::ForceAligner,
    row_writer::Sample,
    row_writer::{Attitude, RowWriter, Samples},
};

/// Callback that receives fixes in time order.
pub(crate) type FixSink<'a> = dyn FnMut(&ReceiverFix) -> Result<(), ImportError> + 'a;

/// GNSS fix in native axes. Unknown values are NaN.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ReceiverFix {
    /// Time of arrival, ns.
    pub(crate) t_ns: i64,
    pub(crate) velocity_m_s: [f64; 3],
    pub(crate) latitude_deg: f64,
    pub(crate) longitude_deg: f64,
    /// Height above mean sea level, m.
    pub(crate) altitude_m: f64,
}

/// Result of the first pass.
#[derive(Debug, Clone, Default)]
pub(crate) struct Survey {
    pub(crate) has_field: bool,
    pub(crate) has_reference: bool,
    pub(crate) notes: Vec<Note>,
    /// Reason to report if no row was written.
    pub(crate) reason: Option<ForeignText>,
    /// Description of the data that provides rate and force, used in the error reported when there
    /// are no rows.
    pub(crate) expected: ForeignText,
}

/// Recording of another system.
pub(crate) trait Source {
    fn format(&self) -> Format;

    /// Returns the total number of bytes read by all passes.
    ///
    /// Before the survey, the value is an estimate.
    fn total_bytes(&self) -> u64;

    /// Makes the first pass. `progress` receives the bytes read so far, in the unit of
    /// `total_bytes`.
    fn survey(&mut self, on_fix: &mut FixSink<'_>, progress: &mut dyn FnMut(u64)) -> Result<Survey, ImportError>;

    /// Returns the magnetic field samples.
    fn field_samples(&self) -> Result<Samples<'_, Sample>, ImportError>;

    /// Returns the reference attitudes.
    fn reference_attitudes(&self) -> Result<Samples<'_, Attitude>, ImportError>;

    /// Passes all rate and force samples to `rows`.
    ///
    /// `progress` receives the bytes read so far, in the unit of `total_bytes`.
    fn write_rows(&self, rows: &mut RowWriter, progress: &mut dyn FnMut(u64)) -> Result<ForceAligner, ImportError>;
}
