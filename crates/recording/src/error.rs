//! Errors when reading and writing recordings, with the position in the file.

use std::{fmt, io, path::PathBuf};

/// Error when reading or writing a recording.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file could not be opened, or its first bytes could not be read.
    #[error("opening the recording {}: {cause}; {remedy}", foreign::path(path))]
    Open {
        /// Path of the recording.
        path: PathBuf,
        /// Operating system error.
        cause: io::Error,
        /// Suggested remedy.
        remedy: &'static str,
    },
    /// The contents are not a valid recording.
    #[error("reading the recording {}: {position}: {error}", foreign::path(path))]
    Malformed {
        /// Path of the recording.
        path: PathBuf,
        /// Position of the error.
        position: Position,
        /// Cause of the error.
        error: ParseError,
    },
    /// No row is later than its predecessor, so the sampling rate is undefined.
    #[error(
        "reading the recording {}: found no time interval in {rows} row(s), expected increasing times (t_s)",
        foreign::path(path)
    )]
    NoInterval {
        /// Path of the recording.
        path: PathBuf,
        /// Number of rows.
        rows: u64,
    },
    /// The file could not be created or written.
    #[error("writing {}: {cause}; free disk space or choose another path", foreign::path(path))]
    Write {
        /// Path of the file.
        path: PathBuf,
        /// Operating system error.
        cause: io::Error,
    },
    /// The row has a value that the file cannot represent.
    #[error("writing {}: row {row}: found {found}, expected {expected}", foreign::path(path))]
    InvalidRow {
        /// Path of the file.
        path: PathBuf,
        /// Row number, from 1.
        row: u64,
        /// Value that cannot be written.
        found: String,
        /// Values that can be written.
        expected: &'static str,
    },
}

impl RecordingError {
    /// Returns `true` if the file is empty or cannot be read up to its first line.
    pub fn is_unreadable(&self) -> bool {
        let Self::Malformed { error, .. } = self else { return false };
        matches!(error, ParseError::Empty | ParseError::Truncated | ParseError::Unreadable(_))
    }

    /// Returns `true` if a column name is unknown and resembles a known one, or if columns are
    /// missing or occur twice.
    pub fn suggests_name(&self) -> bool {
        let Self::Malformed { error, .. } = self else { return false };
        match error {
            ParseError::UnknownColumn { suggestion, .. } => suggestion.is_some(),
            ParseError::MissingColumns { .. } | ParseError::DuplicateColumn { .. } => true,
            _ => false,
        }
    }
}

/// Position in a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Position {
    /// Line number, from 1.
    pub line: u64,
    /// Column number, from 1. `None` for the entire line.
    pub column: Option<usize>,
    /// Column name. `None` if the column has no known name.
    pub name: Option<&'static str>,
}

impl Position {
    pub(crate) fn line(line: u64) -> Self {
        Self { line, column: None, name: None }
    }

    /// Returns the position of a field. `index` counts from 0.
    pub(crate) fn field(line: u64, index: usize, name: Option<&'static str>) -> Self {
        Self { line, column: Some(index + 1), name }
    }
}

impl fmt::Display for Position {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}", self.line)?;
        if let Some(column) = self.column {
            write!(f, ", column {column}")?;
        }
        if let Some(name) = self.name {
            write!(f, " ({name})")?;
        }
        Ok(())
    }
}

/// Returns a hint to use `--map`, which applies to recordings but not to fixes and references.
fn mapping_hint(known: &[&str]) -> &'static str {
    if known.contains(&"gx") {
        "; name another logger's columns with --map, as --map t=COLUMN,gx=COLUMN,…"
    } else {
        ""
    }
}

/// Cause of a parse error.
#[derive(Debug, thiserror::Error)]
pub enum ParseError {
    /// The file is empty.
    #[error("found the end of the file, expected the header line")]
    Empty,
    /// The file has a header but no rows.
    #[error("found the end of the file, expected a row")]
    NoRows,
    /// The compressed data is incomplete.
    #[error("found the end of the file inside the compressed data, expected the rest of it; copy the file again")]
    Truncated,
    /// The line could not be read: I/O error, corrupt compressed data or excessive length.
    #[error("cannot read the line: {0}")]
    Unreadable(io::Error),
    /// The header has an unknown column name.
    #[error("found {found:?}, expected {}", match suggestion {
        Some(suggestion) => format!("a known column; did you mean {suggestion:?}?"),
        None => format!("one of {}{}", known.join(", "), mapping_hint(known)),
    })]
    UnknownColumn {
        /// Unknown name.
        found: String,
        /// Most similar known name; `None` if all differ too much.
        suggestion: Option<&'static str>,
        /// All known names.
        known: &'static [&'static str],
    },
    /// The header has the same column name twice.
    #[error("found a duplicate name, expected it in column {first} only")]
    DuplicateColumn {
        /// Number of the first column with this name, from 1.
        first: usize,
    },
    /// The header lacks required columns.
    #[error("found no column {}, expected all of {}", missing.join(", "), expected.join(", "))]
    MissingColumns {
        /// Missing columns.
        missing: Vec<&'static str>,
        /// Group of columns that are required together.
        expected: &'static [&'static str],
    },
    /// The number of fields in the row differs from that in the header.
    #[error("found {found} fields, expected {expected} as in the header")]
    RowLength {
        /// Number of fields in the row.
        found: usize,
        /// Number of fields in the header.
        expected: usize,
    },
    /// The value is malformed or out of range.
    #[error("found {found:?}, expected {expected}")]
    InvalidValue {
        /// Text of the value, at most 40 characters.
        found: String,
        /// Accepted values.
        expected: &'static str,
    },
}

impl ParseError {
    pub(crate) fn invalid_value(found: &[u8], expected: &'static str) -> Self {
        Self::InvalidValue { found: excerpt(found), expected }
    }
}

/// Returns the first 40 characters of a text, or the whole text if it is shorter.
pub(crate) fn excerpt(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).chars().take(40).collect()
}
