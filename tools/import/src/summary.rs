//! Result of an import.

use std::{fmt, path::PathBuf};

use foreign::ForeignText;

use crate::{Format, timeline::Segment};

/// Maximum number of segments that a note lists.
const MAX_LISTED_SEGMENTS: usize = 20;

/// Result of an import.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// Format of the source.
    pub format: Format,
    /// Number of rows written.
    pub rows: u64,
    /// Number of rows of the source, or of the segment that the user chose, including those that
    /// were not used.
    pub source_rows: u64,
    /// Parts of the source between restarts of its clock.
    pub segments: Vec<Segment>,
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
    /// Path of the fixes file; `None` without fixes.
    pub fixes_file: Option<PathBuf>,
    /// Sensors from which the user can choose one.
    pub sensors: Vec<Sensor>,
    /// Skipped, missing or implausible data, most important first.
    pub notes: Vec<Note>,
}

/// Inertial sensor, magnetometer or receiver recorded in a log.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensor {
    /// Option and number that choose the sensor, such as `--imu 1`.
    pub option: String,
    /// Name of the sensor in the log.
    pub name: ForeignText,
    /// Number of samples.
    pub samples: u64,
    /// Mean rate, Hz; NaN if unknown.
    pub rate_hz: f64,
    /// State, such as `healthy`.
    pub state: &'static str,
    /// `true` if the sensor is read.
    pub is_read: bool,
}

impl fmt::Display for Sensor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { option, name, samples, rate_hz, state, is_read } = self;
        let read = if *is_read { ", read" } else { "" };
        write!(f, "{option}: {name}, {samples} samples at {rate_hz:.1} Hz, {state}{read}")
    }
}

impl Summary {
    /// Returns a warning if less than half of the source was used.
    pub fn warning(&self) -> Option<String> {
        let Self { rows, source_rows, .. } = *self;
        if rows.saturating_mul(2) >= source_rows {
            return None;
        }
        let reasons: Vec<_> = self.notes.iter().filter(|note| note.loses_rows()).map(Note::to_string).collect();
        let reasons = if reasons.is_empty() { String::new() } else { format!(": {}", reasons.join("; ")) };
        Some(format!("used only {rows} of {source_rows} rows{reasons}"))
    }
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
    /// The mean specific force does not match gravity. Either its unit is wrong, or gravity has
    /// been removed.
    ImplausibleForce {
        /// Mean magnitude of the force, m/s².
        mean_force_m_s2: f64,
    },
    /// The magnetic field does not match that of the Earth, because its unit is wrong.
    ImplausibleField {
        /// Mean magnitude of the magnetic field, µT.
        mean_field_ut: f64,
        /// Unit in which the magnetic field would be plausible; `None` if there is no such unit, or
        /// if the format defines the unit.
        unit: Option<&'static str>,
    },
    /// All samples of the magnetometer are equal.
    ConstantField {
        /// Number of samples.
        count: u64,
    },
    /// Rows of text could not be read.
    MalformedRows {
        /// Number of rows.
        count: u64,
        /// Line number of the first malformed row, from 1.
        line: u64,
        /// Text found in that row.
        found: ForeignText,
        /// Text expected.
        expected: String,
    },
    /// The last row of text has no line end. The row was read, but its last number may be
    /// truncated.
    UnendedRow {
        /// Line number, from 1.
        line: u64,
    },
    /// The clock of the source went back. Each such step starts a new segment.
    Segments {
        /// Number of the segment that was read, from 1.
        read: usize,
        /// `true` if the segment was requested.
        is_requested: bool,
        /// All segments.
        segments: Vec<Segment>,
    },
    /// Units were taken from the column names.
    HeaderUnits {
        /// Names of the units.
        units: Vec<&'static str>,
    },
    /// The time counter wrapped. The times continue across the wrap.
    Wrapped {
        /// Number of wraps.
        count: u64,
    },
    /// The times of the messages never change. The times at which they were logged were used.
    LogTimes {
        /// Name of the topic.
        topic: ForeignText,
    },
    /// A sensor was skipped because all its samples are equal.
    DeadSensor {
        /// Name of the sensor.
        sensor: ForeignText,
        /// Name of the sensor that was read instead.
        read: ForeignText,
    },
    /// Rate and force were read from two topics and joined by time.
    Joined {
        /// Topic of the rate.
        rate: ForeignText,
        /// Topic of the force.
        force: ForeignText,
    },
    /// The times of a series do not overlap those of the rows.
    NoOverlap {
        /// Kind of samples, as a plural noun.
        what: &'static str,
        /// First and last time of the series, ns.
        series_ns: [i64; 2],
        /// First and last time of the rows, ns.
        rows_ns: [i64; 2],
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
    /// Rates are instantaneous values, not means over an interval. The recording format cannot
    /// express this.
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

impl Note {
    /// Returns `true` if the note reports rows that were not used.
    fn loses_rows(&self) -> bool {
        match self {
            Self::MalformedRows { .. } | Self::Segments { .. } | Self::Damage { .. } | Self::DamagedFile { .. } => true,
            Self::Skipped { what, .. } => what.starts_with("rate") || what.starts_with("messages"),
            _ => false,
        }
    }
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
            Self::ImplausibleField { mean_field_ut, unit } => {
                write!(f, "mean field {mean_field_ut:.3e} µT, expected 22 to 67 µT; ")?;
                match unit {
                    Some(unit) => write!(f, "read it with --units {unit}"),
                    None => f.write_str("check the magnetometer and its scale"),
                }
            }
            Self::ConstantField { count } => write!(
                f,
                "all {count} field samples are equal: the magnetometer is dead or not read; check its wiring and driver"
            ),
            Self::MalformedRows { count, line, found, expected } => {
                let rows = if *count == 1 { "row" } else { "rows" };
                write!(f, "skipped {count} malformed {rows}, the first in line {line}: found {found}, expected {expected}")
            }
            Self::UnendedRow { line } => write!(
                f,
                "line {line}, the last one, has no line end: if the file was cut, the last number of the row is incomplete"
            ),
            Self::Segments { read, is_requested, segments } => {
                write!(f, "the clock goes back, so the log has {} segments:", segments.len())?;
                for (number, segment) in (1..=MAX_LISTED_SEGMENTS).zip(segments) {
                    let Segment { first_ns, samples, .. } = segment;
                    let (first_s, duration_s) = (*first_ns as f64 / 1e9, segment.duration_s());
                    write!(f, " {number}: {samples} samples, {duration_s:.1} s from {first_s:.3} s;")?;
                }
                if segments.len() > MAX_LISTED_SEGMENTS {
                    write!(f, " and {} more;", segments.len() - MAX_LISTED_SEGMENTS)?;
                }
                let choice = if *is_requested { "as requested" } else { "the longest" };
                write!(f, " read segment {read}, {choice}; choose with --segment")
            }
            Self::HeaderUnits { units } => {
                write!(f, "units from the column names: {}; name others with --units", units.join(", "))
            }
            Self::Wrapped { count } => {
                let times = if *count == 1 { "once" } else { "times" };
                let count = if *count == 1 { String::new() } else { format!("{count} ") };
                write!(f, "the counter of the times wrapped {count}{times}; the times were continued")
            }
            Self::LogTimes { topic } => write!(
                f,
                "the timestamps of {topic} never change; the times at which the messages were logged were used instead"
            ),
            Self::DeadSensor { sensor, read } => {
                write!(f, "{sensor} is dead: its samples never change or are marked as unhealthy; read {read} instead")
            }
            Self::Joined { rate, force } => write!(f, "joined the rate of {rate} with the force of {force} by time"),
            Self::NoOverlap { what, series_ns, rows_ns } => {
                let [first_s, last_s, rows_first_s, rows_last_s] =
                    [series_ns[0], series_ns[1], rows_ns[0], rows_ns[1]].map(|t_ns| t_ns as f64 / 1e9);
                write!(
                    f,
                    "no {what} used: their times, {first_s:.3} to {last_s:.3} s, lie outside those of the samples, {rows_first_s:.3} to {rows_last_s:.3} s; give them the clock of the samples"
                )
            }
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
