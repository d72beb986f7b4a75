//! What came of an import.

use std::{fmt, path::PathBuf};

use crate::Format;

/// What came of an import.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// What the source was.
    pub format: Format,
    /// Rows written.
    pub rows: u64,
    /// Sampling rate, Hz: the inverse of the median of the first 100,000 intervals; nan of a single row.
    pub rate_hz: f64,
    /// From the first row to the last, s.
    pub duration_s: f64,
    /// Mean magnitude of the specific force, m/s²; near 9.8 wherever the vehicle does not accelerate for long.
    pub mean_force_m_s2: f64,
    /// Rows with a magnetic field.
    pub field_rows: u64,
    /// Rows with a reference attitude.
    pub reference_rows: u64,
    /// Fixes written.
    pub fixes: u64,
    /// The file they are in.
    pub fixes_file: Option<PathBuf>,
    /// What was refused, missing or odd, most important first.
    pub notes: Vec<Note>,
}

/// Something that was refused, missing or odd.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Note {
    /// The log ends in a message, or is damaged: nothing from there on was read.
    Damage {
        /// How far it was read, bytes.
        at_byte: u64,
        /// Length of the file, bytes.
        length_bytes: u64,
        /// What is there.
        found: String,
    },
    /// The system that made the log could not keep up.
    Dropouts {
        /// How often.
        count: u64,
        /// For how long in all, ms.
        total_ms: u64,
    },
    /// The force is not what gravity makes of it: another unit, or gravity has been taken out.
    NotGravity {
        /// Its mean magnitude, m/s².
        mean_force_m_s2: f64,
    },
    /// Samples that were left out.
    LeftOut {
        /// Of what.
        what: &'static str,
        /// How many.
        count: u64,
        /// Why.
        why: &'static str,
    },
    /// A part of a bag that cannot be read, and what was behind it.
    Unread {
        /// The file.
        file: String,
        /// What is there.
        found: String,
    },
    /// Rates are values at the ends of their intervals, which a recording does not say.
    Instants,
    /// Only one of several topics of a kind was read.
    OtherTopics {
        /// What they hold.
        what: &'static str,
        /// The topic that was read.
        read: String,
        /// The others.
        others: Vec<String>,
    },
    /// A topic that is read only where it is named.
    Unnamed {
        /// What it may hold.
        what: &'static str,
        /// The topic.
        topic: String,
        /// What it means where it is named.
        meaning: &'static str,
    },
    /// Only one of several sensors of a kind was read.
    OtherInstances {
        /// The topic.
        topic: &'static str,
        /// The instance that was read.
        read: u8,
        /// Samples of the others.
        others: u64,
    },
    /// Nothing of this kind was there.
    Missing {
        /// What.
        what: &'static str,
    },
    /// The name of the recording does not end in `_imu.csv` or `_imu.csv.gz`, so nobody finds the fixes by it.
    FixesNotFound {
        /// Where they are.
        fixes: PathBuf,
    },
}

impl fmt::Display for Note {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Damage { at_byte, length_bytes, found } => {
                write!(f, "read up to byte {at_byte} of {length_bytes}: {found}; nothing from there on was read")
            }
            Self::Dropouts { count, total_ms } => {
                write!(f, "dropouts of the log: {count}, {total_ms} ms in all; what was measured then is not in it")
            }
            Self::NotGravity { mean_force_m_s2 } => write!(
                f,
                "the mean force is {mean_force_m_s2:.2} m/s², not near 9.8: check its unit, and that gravity is in it"
            ),
            Self::LeftOut { what, count, why } => write!(f, "left out {count} of the {what}: {why}"),
            Self::Unread { file, found } => {
                write!(f, "{file} is not whole: {found}; nothing from there on was read of it")
            }
            Self::Instants => f.write_str(
                "its rates are instants: score it with --gyro-samples instants, replay it with gyro_samples = \"instants\" in [ingest.replay]",
            ),
            Self::OtherTopics { what, read, others } => {
                write!(f, "read {what} of {read}; there is also {}: --topic chooses another", others.join(", "))
            }
            Self::Unnamed { what, topic, meaning } => {
                write!(f, "{topic} may hold {what}; --topic {topic} reads it as {meaning}")
            }
            Self::OtherInstances { topic, read, others } => {
                write!(f, "read instance {read} of {topic}; not read of other instances: {others}")
            }
            Self::Missing { what } => write!(f, "there is no {what}"),
            Self::FixesNotFound { fixes } => {
                write!(
                    f,
                    "name {} where the recording is read: only beside a name that ends in _imu.csv.gz is it found",
                    fixes.display()
                )
            }
        }
    }
}
