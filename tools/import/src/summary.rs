//! Result of an import.

use std::{fmt, path::PathBuf};

use foreign::ForeignText;

use crate::Format;

/// Result of an import.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// Format of the source.
    pub format: Format,
    /// Number of rows written.
    pub rows: u64,
    /// Sampling rate, Hz.
    ///
    /// Inverse of the median of the first 100,000 intervals; NaN if there is only one row.
    pub rate_hz: f64,
    /// Time from the first to the last row, s.
    pub duration_s: f64,
    /// Mean magnitude of the specific force, m/s².
    ///
    /// Close to 9.8 unless the vehicle accelerates for a long time.
    pub mean_force_m_s2: f64,
    /// Number of rows with a magnetic field.
    pub field_rows: u64,
    /// Number of rows with a reference attitude.
    pub reference_rows: u64,
    /// Number of fixes written.
    pub fixes: u64,
    /// Path of the fixes file; `None` if there are no fixes.
    pub fixes_file: Option<PathBuf>,
    /// Skipped, missing or implausible data, most important first.
    pub notes: Vec<Note>,
}

/// Skipped, missing or implausible data.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Note {
    /// The log is truncated or damaged. Data after the damage was not read.
    Damage {
        /// Offset of the damage, bytes.
        at_byte: u64,
        /// Length of the file, bytes.
        length_bytes: u64,
        /// Description of the damage.
        found: ForeignText,
    },
    /// The logger dropped data because it could not keep up.
    Dropouts {
        /// Number of dropouts.
        count: u64,
        /// Total duration of the dropouts, ms.
        total_ms: u64,
    },
    /// The mean force does not match gravity: its unit is wrong, or gravity has been removed.
    ImplausibleForce {
        /// Mean magnitude of the force, m/s².
        mean_force_m_s2: f64,
    },
    /// Samples were skipped.
    Skipped {
        /// Kind of samples, as a plural noun.
        what: &'static str,
        /// Number of samples.
        count: u64,
        /// Reason why the samples were skipped.
        reason: &'static str,
    },
    /// A file of a bag is damaged. Data after the damage was not read from that file.
    DamagedFile {
        /// Name of the file.
        file: ForeignText,
        /// Description of the damage.
        found: ForeignText,
    },
    /// Rates are instantaneous values, not means over an interval. A recording cannot express this.
    InstantRates,
    /// Several topics contain the same quantity. One of them was read.
    OtherTopics {
        /// Quantity that the topics contain.
        what: &'static str,
        /// Name of the topic that was read.
        read: ForeignText,
        /// Names of the other topics.
        others: Vec<ForeignText>,
    },
    /// A topic is read only if it is named with `--topic`.
    TopicOnRequest {
        /// Quantity that the topic may contain.
        what: &'static str,
        /// Name of the topic.
        topic: ForeignText,
        /// Axes in which the topic is interpreted.
        interpretation: &'static str,
    },
    /// Several instances of a sensor were logged. One of them was read.
    OtherInstances {
        /// Name of the topic or message type.
        topic: &'static str,
        /// Number of the instance that was read.
        read: u8,
        /// Number of samples from the other instances.
        others: u64,
    },
    /// A quantity is missing from the source.
    Missing {
        /// Name of the quantity.
        what: &'static str,
    },
    /// The fixes file is not found automatically when the recording is read.
    ///
    /// This happens if the name of the recording does not end in `_imu.csv` or `_imu.csv.gz`.
    FixesNotDiscoverable {
        /// Path of the fixes file.
        fixes: PathBuf,
    },
}

impl fmt::Display for Note {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Damage { at_byte, length_bytes, found } => {
                write!(f, "read up to byte {at_byte} of {length_bytes}: {found}; the rest was not read")
            }
            Self::Dropouts { count, total_ms } => {
                write!(f, "log dropouts: {count}, {total_ms} ms in total; samples in them are missing")
            }
            Self::ImplausibleForce { mean_force_m_s2 } => write!(
                f,
                "mean force {mean_force_m_s2:.2} m/s², expected about 9.8; check its unit and that it includes gravity"
            ),
            Self::Skipped { what, count, reason } => write!(f, "skipped {count} {what}: {reason}"),
            Self::DamagedFile { file, found } => {
                write!(f, "{file} is damaged: {found}; the rest was not read")
            }
            Self::InstantRates => f.write_str(
                "rates are instantaneous: score with --gyro-samples instants, replay with gyro_samples = \"instants\" in [ingest.replay]",
            ),
            Self::OtherTopics { what, read, others } => {
                write!(f, "read {what} from {read}; also available: {}; select with --topic", foreign::list(others))
            }
            Self::TopicOnRequest { what, topic, interpretation } => {
                write!(f, "{topic} may hold {what}; --topic {topic} reads it as {interpretation}")
            }
            Self::OtherInstances { topic, read, others } => {
                write!(f, "read instance {read} of {topic}; skipped {others} samples of other instances")
            }
            Self::Missing { what } => write!(f, "no {what}"),
            Self::FixesNotDiscoverable { fixes } => {
                write!(
                    f,
                    "specify {} when reading the recording: fixes are found automatically only for NAME_imu.csv[.gz]",
                    foreign::path(fixes)
                )
            }
        }
    }
}
