//! Why there is no recording.

use std::{
    fmt, io,
    path::{Path, PathBuf},
};

use recording::RecordingError;

use crate::{Format, MappingError};

/// Why there is no recording.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// No file is named.
    #[error("importing: found no file, expected one")]
    Nothing,
    /// There is no folder for what is imported on the way.
    #[error(
        "making a folder for the import: {cause}; is there space for temporary files (TMPDIR names another place)?"
    )]
    Folder {
        /// What the system said.
        cause: io::Error,
    },
    /// The MCAP file cannot be written.
    #[error("writing {}: {cause}", path.display())]
    Mcap {
        /// The file.
        path: PathBuf,
        /// What was said about it.
        cause: String,
    },
    /// The file cannot be opened or read.
    #[error("opening {}: {cause}; {remedy}", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// What the system said.
        cause: io::Error,
        /// What to do about it.
        remedy: &'static str,
    },
    /// The file is none of the known formats.
    #[error(
        "recognising {}: found no known format, expected ULog, MCAP, a ROS 2 bag, an ArduPilot log or CSV; text must be UTF-8 (save it as \"CSV UTF-8\")",
        path.display()
    )]
    Unknown {
        /// The file.
        path: PathBuf,
    },
    /// The format is known and not read.
    #[error("importing {}: it is {format}; {remedy}", path.display())]
    Unread {
        /// The file.
        path: PathBuf,
        /// What it is.
        format: Format,
        /// What to do about it.
        remedy: &'static str,
    },
    /// More than one log, or a log beside other files.
    #[error("importing {}: {format} is imported alone, found {count} files; import each by itself", path.display())]
    NotAlone {
        /// The log.
        path: PathBuf,
        /// What it is.
        format: Format,
        /// How many files are named.
        count: usize,
    },
    /// A log, which names its own columns, and a mapping.
    #[error("importing {}: {format} says itself what its columns are; leave out --map, --units and --frame", path.display())]
    MappingUnused {
        /// The log.
        path: PathBuf,
        /// What it is.
        format: Format,
    },
    /// Topics chosen of a file that has none.
    #[error("importing {}: {format} has no topics to choose from; leave out --topic", path.display())]
    TopicsUnused {
        /// The log.
        path: PathBuf,
        /// What it is.
        format: Format,
    },
    /// A topic that is not there, or that nothing is read of.
    #[error("importing {}: there is no topic {found:?} to read{}; there are {}", path.display(), guess(near.as_deref()), names(known))]
    UnknownTopic {
        /// The log.
        path: PathBuf,
        /// The topic's name.
        found: String,
        /// The topic of nearly that name.
        near: Option<String>,
        /// Those that can be read.
        known: Vec<String>,
    },
    /// Two topics chosen for one thing.
    #[error("importing {}: --topic names both {first:?} and {second:?}, expected one of {what}", path.display())]
    TopicTwice {
        /// The log.
        path: PathBuf,
        /// The first.
        first: String,
        /// The second.
        second: String,
        /// What both hold.
        what: &'static str,
    },
    /// A bag that cannot be read.
    #[error("reading {}: found {found}, expected {expected}", path.display())]
    NoBag {
        /// The bag.
        path: PathBuf,
        /// What is there.
        found: String,
        /// What was expected, or what to do.
        expected: &'static str,
    },
    /// Text with columns and no mapping.
    #[error(
        "importing {}: nothing says what its columns are; name them with --map t=COLUMN,gx=COLUMN,…; there are {}",
        path.display(),
        names(columns)
    )]
    MappingNeeded {
        /// The file.
        path: PathBuf,
        /// Its columns.
        columns: Vec<String>,
    },
    /// The mapping is none.
    #[error("reading --{}: {}", .0.setting(), .0)]
    Mapping(#[from] MappingError),
    /// A column that no file has.
    #[error("mapping {target}: there is no column {found:?}{}; there are {}", guess(near.as_deref()), names(known))]
    UnknownColumn {
        /// What it is mapped to.
        target: &'static str,
        /// Its name.
        found: String,
        /// The column of nearly that name.
        near: Option<String>,
        /// All columns.
        known: Vec<String>,
    },
    /// A column that is there more than once.
    #[error("mapping {target}: there is more than one column {found:?}; say {}", places.join(" or "))]
    Ambiguous {
        /// What it is mapped to.
        target: &'static str,
        /// Its name.
        found: String,
        /// How to say which.
        places: Vec<String>,
    },
    /// A vector whose components are not samples of one time.
    #[error("mapping {}: found columns of {}, expected all of them in one file", group.join(", "), names(files))]
    Split {
        /// The components.
        group: Vec<&'static str>,
        /// The files they are in.
        files: Vec<String>,
    },
    /// The text of a file is not what it must be.
    #[error("reading {}: {place}: found {found}, expected {expected}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Where in it.
        place: Box<Place>,
        /// What is there.
        found: String,
        /// What was expected.
        expected: String,
    },
    /// A log whose beginning is damaged.
    #[error("reading {}: byte {at_byte}: found {found}, expected a log; copy the file again", path.display())]
    NoLog {
        /// The file.
        path: PathBuf,
        /// How far it was read.
        at_byte: u64,
        /// What is there.
        found: String,
    },
    /// A topic without what is needed of it.
    #[error("reading {}: the topic {topic}: found no field {field} of the type {expected}, there are {}", path.display(), names(known))]
    NoField {
        /// The log.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// The field.
        field: &'static str,
        /// Its type.
        expected: &'static str,
        /// The fields there are.
        known: Vec<String>,
    },
    /// No sample of rate and force.
    #[error("importing {}: found no sample of rate and force{}, expected {expected}", path.display(), because(reason.as_deref()))]
    NoRows {
        /// The file.
        path: PathBuf,
        /// What is known about it.
        reason: Option<String>,
        /// Where they would be.
        expected: String,
    },
    /// The recording would replace its source.
    #[error("writing {}: that is the file it is made of; name another", path.display())]
    OutIsSource {
        /// The file.
        path: PathBuf,
    },
    /// The fixes of another recording would be taken for those of this one.
    #[error("writing {}: there are no fixes, and those of another recording lie at {}; move them, or name another file", path.display(), fixes.display())]
    OldFixes {
        /// The recording.
        path: PathBuf,
        /// The fixes beside it.
        fixes: PathBuf,
    },
    /// The recording cannot be written.
    #[error(transparent)]
    Recording(Box<RecordingError>),
}

impl From<RecordingError> for ImportError {
    fn from(error: RecordingError) -> Self {
        Self::Recording(error.into())
    }
}

impl ImportError {
    /// The exit code of `plumb`: 3 when an input file is wrong, 2 when the command line is, else 1.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Nothing
            | Self::NotAlone { .. }
            | Self::MappingUnused { .. }
            | Self::TopicsUnused { .. }
            | Self::UnknownTopic { .. }
            | Self::TopicTwice { .. }
            | Self::MappingNeeded { .. }
            | Self::Mapping(_)
            | Self::UnknownColumn { .. }
            | Self::Ambiguous { .. }
            | Self::Split { .. }
            | Self::OutIsSource { .. }
            | Self::OldFixes { .. } => 2,
            Self::Open { .. }
            | Self::Unknown { .. }
            | Self::Unread { .. }
            | Self::Malformed { .. }
            | Self::NoLog { .. }
            | Self::NoBag { .. }
            | Self::NoField { .. }
            | Self::NoRows { .. } => 3,
            Self::Recording(_) | Self::Folder { .. } | Self::Mcap { .. } => 1,
        }
    }
}

/// A place in a text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    /// Line, from 1.
    pub line: u64,
    /// Field, from 1; `None` for the line as a whole.
    pub column: Option<usize>,
    /// The field's name, as the header has it.
    pub name: Option<String>,
}

impl fmt::Display for Place {
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

pub(crate) fn opening(path: &Path, cause: io::Error) -> ImportError {
    let remedy = match cause.kind() {
        io::ErrorKind::NotFound => "check the path",
        io::ErrorKind::PermissionDenied => "give this user the right to read it",
        io::ErrorKind::IsADirectory => "name a file in it",
        _ => "check that the file can be read",
    };
    ImportError::Open { path: path.to_owned(), cause, remedy }
}

/// The first 40 characters, in quotes.
pub(crate) fn excerpt(bytes: &[u8]) -> String {
    format!("{:?}", String::from_utf8_lossy(bytes).chars().take(40).collect::<String>())
}

/// Names of columns in a message: so many, and each so long.
const MAX_NAMES: usize = 40;

fn names(names: &[String]) -> String {
    let mut text: Vec<_> = names.iter().take(MAX_NAMES).map(|name| excerpt(name.as_bytes())).collect();
    if names.len() > MAX_NAMES {
        text.push(format!("and {} more", names.len() - MAX_NAMES));
    }
    text.join(", ")
}

fn guess(near: Option<&str>) -> String {
    near.map_or_else(String::new, |near| format!(", did you mean {near:?}?"))
}

fn because(reason: Option<&str>) -> String {
    reason.map_or_else(String::new, |reason| format!(" ({reason})"))
}
