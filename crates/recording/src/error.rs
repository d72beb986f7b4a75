//! What can be wrong with a recording, and where.

use std::{fmt, io, path::PathBuf};

/// A recording that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file could not be opened or its first bytes not read.
    #[error("opening the recording {}: {cause}; {remedy}", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// What the system said.
        cause: io::Error,
        /// What to do about it.
        remedy: &'static str,
    },
    /// The contents are not a recording's.
    #[error("reading the recording {}: {place}: {fault}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Where in it.
        place: Position,
        /// What was found there and what was expected.
        fault: Fault,
    },
    /// Time never increases, so there is no sampling rate.
    #[error(
        "surveying the recording {}: found no interval in {rows} row(s), expected rows at increasing times (t_s)",
        path.display()
    )]
    NoInterval {
        /// The file.
        path: PathBuf,
        /// The rows it has.
        rows: u64,
    },
    /// The file cannot be made or written.
    #[error("writing {}: {cause}; make room, or name another place", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system said.
        cause: io::Error,
    },
    /// A row that would not be read as it is.
    #[error("writing {}: row {row}: found {found}, expected {expected}", path.display())]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// The row, from 1.
        row: u64,
        /// What it has.
        found: String,
        /// What can be written.
        expected: &'static str,
    },
}

/// A place in a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Position {
    /// Line, from 1.
    pub line: u64,
    /// Field, from 1; `None` for the line as a whole.
    pub column: Option<usize>,
    /// The field's name; `None` where the header gives no known one.
    pub name: Option<&'static str>,
}

impl Position {
    pub(crate) fn line(line: u64) -> Self {
        Self { line, column: None, name: None }
    }

    /// The place of the field with this index, from 0.
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

/// Readings have columns of many names, and there is a way to read them.
fn hint(known: &[&str]) -> &'static str {
    if known.contains(&"gx") { "; name another logger's columns with --map, as --map t=COLUMN,gx=COLUMN,…" } else { "" }
}

/// What is wrong at a place.
#[derive(Debug, thiserror::Error)]
pub enum Fault {
    /// Nothing in the file.
    #[error("found the end of the file, expected the header line")]
    Empty,
    /// A header and nothing else.
    #[error("found the end of the file, expected a row")]
    NoRows,
    /// The gzip stream lacks its end.
    #[error("found the end of the file inside the gzip stream, expected the rest of it; copy the file again")]
    Truncated,
    /// A bad disk, a damaged gzip stream, an endless line.
    #[error("found {0}, expected a readable line")]
    Unreadable(io::Error),
    /// A column nobody reads.
    #[error("found {found:?}, expected {}", match near {
        Some(near) => format!("a known column; did you mean {near:?}?"),
        None => format!("one of {}{}", known.join(", "), hint(known)),
    })]
    UnknownColumn {
        /// Its name.
        found: String,
        /// The known column of nearly that name.
        near: Option<&'static str>,
        /// All known columns.
        known: &'static [&'static str],
    },
    /// A column twice.
    #[error("found the name again, expected it in column {first} only")]
    RepeatedColumn {
        /// Where it was first, from 1.
        first: usize,
    },
    /// Columns that must be there.
    #[error("found no column {}, expected all of {}", missing.join(", "), expected.join(", "))]
    MissingColumns {
        /// Those not there.
        missing: Vec<&'static str>,
        /// The group they belong to.
        expected: &'static [&'static str],
    },
    /// A row longer or shorter than the header.
    #[error("found {found} fields, expected {expected} as in the header")]
    RowLength {
        /// Fields in the row.
        found: usize,
        /// Fields in the header.
        expected: usize,
    },
    /// A value that is none.
    #[error("found {found:?}, expected {expected}")]
    Value {
        /// Its text, shortened.
        found: String,
        /// What the column holds.
        expected: &'static str,
    },
}

impl Fault {
    pub(crate) fn value(found: &[u8], expected: &'static str) -> Self {
        Self::Value { found: excerpt(found), expected }
    }
}

/// The first 40 characters.
pub(crate) fn excerpt(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).chars().take(40).collect()
}
