//! Interface of all source formats.
//!
//! A source is read in several passes: a survey, one pass for the rows, and one pass for each
//! series that is merged into the rows. The memory required therefore does not grow with the length
//! of the source.

use foreign::ForeignText;

use crate::{
    Format, ImportError, Note, Sensor,
    row_writer::Sample,
    row_writer::{Attitude, Samples},
    timeline::{Segment, SourceClock, Timed},
};

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

impl Timed for ReceiverFix {
    fn t_ns(&self) -> i64 {
        self.t_ns
    }

    fn shift(&mut self, offset_ns: i64) {
        self.t_ns = self.t_ns.saturating_add(offset_ns);
    }
}

impl Timed for Attitude {
    fn t_ns(&self) -> i64 {
        self.t_ns
    }

    fn shift(&mut self, offset_ns: i64) {
        self.t_ns = self.t_ns.saturating_add(offset_ns);
    }
}

/// Sample of body rate, specific force or both, each with its own time.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Inertial {
    pub(crate) rate: Option<Sample>,
    pub(crate) force: Option<Sample>,
}

impl Inertial {
    /// Creates a sample from a rate and a force that were measured at the same time.
    pub(crate) fn joint(t_ns: i64, rate_rad_s: [f64; 3], force_m_s2: [f64; 3]) -> Self {
        Self { rate: Some((t_ns, rate_rad_s)), force: Some((t_ns, force_m_s2)) }
    }
}

impl Timed for Inertial {
    fn t_ns(&self) -> i64 {
        self.rate.or(self.force).map_or(0, |(t_ns, _)| t_ns)
    }

    fn shift(&mut self, offset_ns: i64) {
        for (t_ns, _) in [&mut self.rate, &mut self.force].into_iter().flatten() {
            *t_ns = t_ns.saturating_add(offset_ns);
        }
    }
}

impl Timed for Sample {
    fn t_ns(&self) -> i64 {
        self.0
    }

    fn shift(&mut self, offset_ns: i64) {
        self.0 = self.0.saturating_add(offset_ns);
    }
}

/// Samples of rate and force.
pub(crate) enum Motion<'a> {
    /// One series in file order.
    Joint(Samples<'a, Inertial>),
    /// Two series on one clock, which are merged by time.
    Separate { rates: Samples<'a, Sample>, forces: Samples<'a, Sample> },
}

/// Result of the first pass.
#[derive(Debug, Clone, Default)]
pub(crate) struct Survey {
    pub(crate) has_field: bool,
    pub(crate) has_reference: bool,
    pub(crate) has_fixes: bool,
    pub(crate) notes: Vec<Note>,
    /// Sensors from which the user can choose one.
    pub(crate) sensors: Vec<Sensor>,
    /// Reason to report if no row was written.
    pub(crate) reason: Option<ForeignText>,
    /// Description of the data that provides rate and force, for the error if the source has no
    /// rows.
    pub(crate) expected: ForeignText,
    pub(crate) clock: SourceClock,
    /// Segments of the series that determines the rows.
    pub(crate) segments: Vec<Segment>,
    /// Number of times that the time counter of the series wrapped.
    pub(crate) wraps: u64,
    /// Number of rows that cannot be read.
    pub(crate) unreadable_rows: u64,
}

/// Recording made by another system.
pub(crate) trait Source {
    fn format(&self) -> Format;

    /// Returns the total number of bytes read by all passes.
    ///
    /// Before the survey, the value is an estimate.
    fn total_bytes(&self) -> u64;

    /// Returns the number of bytes read so far by all passes.
    fn read_bytes(&self) -> u64;

    /// Makes the first pass. `progress` receives the bytes read so far, in the unit of
    /// `total_bytes`.
    fn survey(&mut self, progress: &mut dyn FnMut(u64)) -> Result<Survey, ImportError>;

    /// Returns the samples of rate and force.
    fn motion(&self) -> Result<Motion<'_>, ImportError>;

    /// Returns the factor that converts the magnetic field of the source to µT; `None` if the
    /// source defines the unit.
    fn field_factor(&self) -> Option<f64> {
        None
    }

    /// Returns the magnetic field samples.
    fn field_samples(&self) -> Result<Samples<'_, Sample>, ImportError>;

    /// Returns the reference attitudes.
    fn reference_attitudes(&self) -> Result<Samples<'_, Attitude>, ImportError>;

    /// Returns the fixes, which may be out of order.
    fn fixes(&self) -> Result<Samples<'_, ReceiverFix>, ImportError>;
}
