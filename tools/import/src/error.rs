//! Errors of an import.

use std::{
    fmt, io,
    path::{Path, PathBuf},
};

use foreign::ForeignText;
use mapping::HeaderError;
use recording::RecordingError;

use crate::{MappingError, format::Format};

/// Error that prevents an import.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// No input file is given.
    #[error("importing: no input file; name at least one")]
    NoFiles,
    /// The temporary folder for an intermediate recording cannot be created.
    #[error("creating a temporary folder: {cause}; free disk space, or set TMPDIR to another folder")]
    TemporaryFolder {
        /// Operating system error.
        cause: io::Error,
    },
    /// The MCAP file cannot be written.
    #[error("writing {}: {cause}", foreign::path(path))]
    WriteMcap {
        /// Path of the MCAP file.
        path: PathBuf,
        /// Error of the MCAP writer or the operating system.
        cause: String,
    },
    /// The file cannot be opened or read.
    #[error("opening {}: {cause}; {remedy}", foreign::path(path))]
    Open {
        /// Path of the file.
        path: PathBuf,
        /// Operating system error.
        cause: io::Error,
        /// Suggested remedy.
        remedy: &'static str,
    },
    /// The format of the file is unknown.
    #[error(
        "importing {}: unknown format, expected ULog, MCAP, a ROS 2 bag, an ArduPilot log, a tlog or UTF-8 CSV (save text as \"CSV UTF-8\")",
        foreign::path(path)
    )]
    UnknownFormat {
        /// Path of the file.
        path: PathBuf,
    },
    /// The format of the file is known but not supported.
    #[error("importing {}: found {format}; {remedy}", foreign::path(path))]
    UnsupportedFormat {
        /// Path of the file.
        path: PathBuf,
        /// Format of the file.
        format: Format,
        /// Suggested remedy, with the command that converts the file.
        remedy: ForeignText,
    },
    /// A log is given together with other files.
    #[error(
        "importing {}: {format} cannot be combined with other files, found {count}; import each file separately",
        foreign::path(path)
    )]
    MultipleFiles {
        /// Path of the log.
        path: PathBuf,
        /// Format of the log.
        format: Format,
        /// Number of files given.
        count: usize,
    },
    /// A mapping is given for a format that defines its own columns.
    #[error(
        "importing {}: {format} defines its own columns; leave out --map, --units and --frame",
        foreign::path(path)
    )]
    MappingNotApplicable {
        /// Path of the log.
        path: PathBuf,
        /// Format of the log.
        format: Format,
    },
    /// Topics are selected for a format that has no topics.
    #[error("importing {}: {format} has no topics; leave out --topic", foreign::path(path))]
    TopicsNotApplicable {
        /// Path of the log.
        path: PathBuf,
        /// Format of the log.
        format: Format,
    },
    /// A selected topic does not exist or has an unsupported type.
    #[error("importing {}: no readable topic {found:?}{}; available topics: {}", foreign::path(path), suggestion(near.as_ref()), quoted_list(known))]
    UnknownTopic {
        /// Path of the log.
        path: PathBuf,
        /// Name of the selected topic.
        found: String,
        /// Readable topic with a similar name.
        near: Option<ForeignText>,
        /// All readable topics.
        known: Vec<ForeignText>,
    },
    /// Two selected topics contain the same quantity.
    #[error(
        "importing {}: --topic names both {first:?} and {second:?}, expected one topic for {what}",
        foreign::path(path)
    )]
    ConflictingTopics {
        /// Path of the log.
        path: PathBuf,
        /// Name of the first topic.
        first: String,
        /// Name of the second topic.
        second: String,
        /// Quantity that both topics contain.
        what: &'static str,
    },
    /// The bag cannot be read.
    #[error("reading {}: found {found}, expected {}", foreign::path(path), expected.replace("FOLDER", &foreign::shell_word(&path.to_string_lossy())))]
    UnreadableBag {
        /// Path of the bag.
        path: PathBuf,
        /// Description of what was found.
        found: ForeignText,
        /// Description of what was expected, or a suggested remedy.
        expected: &'static str,
    },
    /// A CSV file is given, but no mapping of its columns.
    #[error(
        "importing {}: the meaning of its columns is unknown; map them with --map {map}; available columns: {}",
        foreign::path(path),
        quoted_list(columns)
    )]
    MappingRequired {
        /// Path of the file.
        path: PathBuf,
        /// Value of `--map` with the recognised columns.
        map: ForeignText,
        /// Names of the columns in the file.
        columns: Vec<ForeignText>,
    },
    /// Several columns may hold the same quantity.
    #[error(
        "importing {}: {target} may be any of the columns {}; choose with --map {map}",
        foreign::path(path),
        quoted_list(alternatives)
    )]
    AmbiguousHeader {
        /// Path of the file.
        path: PathBuf,
        /// Target of the columns.
        target: &'static str,
        /// Value of `--map` with the first of the columns.
        map: ForeignText,
        /// Names of the columns.
        alternatives: Vec<ForeignText>,
    },
    /// The column names do not determine the units.
    #[error("importing {}: {error}; name the right units, as with --units {}", foreign::path(path), error.remedy())]
    HeaderUnits {
        /// Path of the file.
        path: PathBuf,
        /// Error in the column names.
        error: Box<HeaderError>,
    },
    /// The mapping is invalid.
    #[error("reading --{}: {}", .0.setting(), .0)]
    Mapping(#[from] MappingError),
    /// A mapped column does not exist.
    #[error("mapping {target}: no column {found:?}{}; available columns: {}", suggestion(near.as_ref()), quoted_list(known))]
    UnknownColumn {
        /// Target of the mapping.
        target: &'static str,
        /// Name of the column.
        found: String,
        /// Column with a similar name.
        near: Option<ForeignText>,
        /// Names of all columns.
        known: Vec<ForeignText>,
    },
    /// A mapped column exists more than once.
    #[error("mapping {target}: more than one column is named {found:?}; use {}", joined(alternatives, " or "))]
    AmbiguousColumn {
        /// Target of the mapping.
        target: &'static str,
        /// Name of the column.
        found: String,
        /// Unambiguous ways to name the column.
        alternatives: Vec<ForeignText>,
    },
    /// The components of a vector are in different files, so their times differ.
    #[error("mapping {}: found columns of {}, expected all in one file", group.join(", "), quoted_list(files))]
    SplitVector {
        /// Mapping targets of the vector's components.
        group: Vec<&'static str>,
        /// File of each component.
        files: Vec<ForeignText>,
    },
    /// The text of a file is malformed.
    #[error("reading {}: {position}: found {found}, expected {expected}", foreign::path(path))]
    Malformed {
        /// Path of the file.
        path: PathBuf,
        /// Position of the error in the text.
        position: Box<TextPosition>,
        /// Description of what was found.
        found: ForeignText,
        /// Description of what was expected.
        expected: String,
    },
    /// A ULog file is damaged before its data section.
    #[error("reading {}: byte {at_byte}: found {found} before any data; copy the file again", foreign::path(path))]
    DamagedStart {
        /// Path of the file.
        path: PathBuf,
        /// Offset of the damage, bytes.
        at_byte: u64,
        /// Description of the damage.
        found: ForeignText,
    },
    /// A required field is missing from a topic.
    #[error(
        "reading {}: topic {topic}: no field {field} of type {expected}; available fields: {}",
        foreign::path(path),
        quoted_list(known)
    )]
    MissingField {
        /// Path of the log.
        path: PathBuf,
        /// Name of the topic.
        topic: ForeignText,
        /// Name of the field.
        field: &'static str,
        /// Required type of the field.
        expected: &'static str,
        /// Names of all fields of the topic.
        known: Vec<ForeignText>,
    },
    /// The source has no samples of rate and force.
    #[error("importing {}: found no sample of rate and force{}, expected {expected}", foreign::path(path), parenthesised(reason.as_ref()))]
    NoRows {
        /// Path of the file.
        path: PathBuf,
        /// Reason for the missing samples, if known.
        reason: Option<ForeignText>,
        /// Description of the data that provides rate and force.
        expected: ForeignText,
    },
    /// The times of the samples never increase.
    #[error("importing {}: found {rows} samples whose times never increase, expected increasing times; {}", foreign::path(path), remedy.replace("FILE", &foreign::shell_word(&path.to_string_lossy())))]
    ConstantTimes {
        /// Path of the file.
        path: PathBuf,
        /// Number of samples.
        rows: u64,
        /// Suggested remedy.
        remedy: &'static str,
    },
    /// The requested segment does not exist.
    #[error(
        "reading {}: no segment {found}, expected 1 to {count}; `plumb info` lists the segments",
        foreign::path(path)
    )]
    UnknownSegment {
        /// Path of the file.
        path: PathBuf,
        /// Number of the requested segment.
        found: usize,
        /// Number of segments.
        count: usize,
    },
    /// The requested sensor does not exist.
    #[error("reading {}: {what} {found}: no such sensor, expected {}", foreign::path(path), match count {
        0 => "a log with several sensors; leave out the option".to_owned(),
        count => format!("0 to {}", count - 1),
    })]
    UnknownSensor {
        /// Path of the file.
        path: PathBuf,
        /// Option that requested the sensor.
        what: &'static str,
        /// Number of the requested sensor.
        found: usize,
        /// Number of sensors.
        count: usize,
    },
    /// The output would overwrite an input.
    #[error("writing {}: the output is also an input; choose another name", foreign::path(path))]
    OutputIsInput {
        /// Path of the input.
        path: PathBuf,
    },
    /// The import has no fixes, but a fixes file of another recording exists next to the output.
    #[error(
        "writing {}: no fixes were imported, but {} would be read as its fixes; move that file, or choose another output name",
        foreign::path(path),
        foreign::path(fixes)
    )]
    StaleFixes {
        /// Path of the recording.
        path: PathBuf,
        /// Path of the existing fixes file.
        fixes: PathBuf,
    },
    /// The recording cannot be read or written.
    #[error(transparent)]
    Recording(Box<RecordingError>),
}

impl From<RecordingError> for ImportError {
    fn from(error: RecordingError) -> Self {
        Self::Recording(error.into())
    }
}

impl ImportError {
    /// Returns the exit code of `plumb`.
    ///
    /// This is 3 for an invalid input file, 2 for an invalid command line, 1 otherwise.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::NoFiles
            | Self::MultipleFiles { .. }
            | Self::MappingNotApplicable { .. }
            | Self::TopicsNotApplicable { .. }
            | Self::UnknownTopic { .. }
            | Self::ConflictingTopics { .. }
            | Self::MappingRequired { .. }
            | Self::Mapping(_)
            | Self::AmbiguousHeader { .. }
            | Self::HeaderUnits { .. }
            | Self::UnknownColumn { .. }
            | Self::AmbiguousColumn { .. }
            | Self::SplitVector { .. }
            | Self::UnknownSegment { .. }
            | Self::UnknownSensor { .. }
            | Self::OutputIsInput { .. }
            | Self::StaleFixes { .. } => 2,
            Self::Open { .. }
            | Self::UnknownFormat { .. }
            | Self::UnsupportedFormat { .. }
            | Self::Malformed { .. }
            | Self::DamagedStart { .. }
            | Self::UnreadableBag { .. }
            | Self::MissingField { .. }
            | Self::ConstantTimes { .. }
            | Self::NoRows { .. } => 3,
            Self::Recording(error) if matches!(**error, RecordingError::Malformed { .. }) => 3,
            Self::Recording(_) | Self::TemporaryFolder { .. } | Self::WriteMcap { .. } => 1,
        }
    }
}

/// Position in a text file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TextPosition {
    /// Line number, from 1.
    pub line: u64,
    /// Column number, from 1; `None` if the error concerns the whole line.
    pub column: Option<usize>,
    /// Name of the column in the header; `None` if unknown.
    pub name: Option<ForeignText>,
}

impl fmt::Display for TextPosition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}", self.line)?;
        if let Some(column) = self.column {
            write!(f, ", column {column}")?;
        }
        if let Some(name) = &self.name {
            write!(f, " ({name})")?;
        }
        Ok(())
    }
}

pub(crate) fn open_error(path: &Path, cause: io::Error) -> ImportError {
    let remedy = match cause.kind() {
        io::ErrorKind::NotFound => "check the path",
        io::ErrorKind::PermissionDenied => "give this user permission to read it",
        io::ErrorKind::IsADirectory => "name a file in the folder",
        _ => "check that the file is readable",
    };
    ImportError::Open { path: path.to_owned(), cause, remedy }
}

/// Returns the first 40 characters of a text, enclosed in quotes.
pub(crate) fn excerpt(bytes: &[u8]) -> String {
    format!("{:?}", String::from_utf8_lossy(bytes).chars().take(40).collect::<String>())
}

/// Maximum number of names listed in an error message.
const MAX_LISTED_NAMES: usize = 40;

fn quoted_list(names: &[ForeignText]) -> String {
    let mut text: Vec<_> = names.iter().take(MAX_LISTED_NAMES).map(|name| excerpt(name.raw().as_bytes())).collect();
    if names.len() > MAX_LISTED_NAMES {
        text.push(format!("and {} more", names.len() - MAX_LISTED_NAMES));
    }
    text.join(", ")
}

fn joined(texts: &[ForeignText], separator: &str) -> String {
    texts.iter().map(ToString::to_string).collect::<Vec<_>>().join(separator)
}

fn suggestion(near: Option<&ForeignText>) -> String {
    near.map_or_else(String::new, |near| format!(" (did you mean {near:?}?)"))
}

fn parenthesised(reason: Option<&ForeignText>) -> String {
    reason.map_or_else(String::new, |reason| format!(" ({reason})"))
}
