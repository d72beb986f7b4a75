//! Errors of the Rust crates as exceptions with the same message.

use std::io::ErrorKind;

use import::ImportError;
use pyo3::{
    PyErr,
    exceptions::{PyFileNotFoundError, PyOSError, PyPermissionError, PyValueError},
};
use recording::RecordingError;
use score::ScoreError;

/// Returns an error as a `ValueError`.
pub(crate) fn value_error(error: impl core::fmt::Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// Error with the message `text`, which may differ from that of the error in the path of the file.
pub(crate) trait FileError {
    /// Returns the kind of the operating system error if a file could not be opened.
    fn open_error(&self) -> Option<ErrorKind>;

    /// Returns `OSError` if a file could not be opened, else `ValueError`.
    fn exception(&self, text: String) -> PyErr {
        match self.open_error() {
            Some(ErrorKind::NotFound) => PyFileNotFoundError::new_err(text),
            Some(ErrorKind::PermissionDenied) => PyPermissionError::new_err(text),
            Some(_) => PyOSError::new_err(text),
            None => PyValueError::new_err(text),
        }
    }
}

impl FileError for RecordingError {
    fn open_error(&self) -> Option<ErrorKind> {
        match self {
            Self::Open { cause, .. } => Some(cause.kind()),
            _ => None,
        }
    }
}

impl FileError for ImportError {
    fn open_error(&self) -> Option<ErrorKind> {
        match self {
            Self::Open { cause, .. } => Some(cause.kind()),
            Self::Recording(error) => error.open_error(),
            _ => None,
        }
    }
}

impl FileError for ScoreError {
    fn open_error(&self) -> Option<ErrorKind> {
        match self {
            Self::Recording(error) => error.open_error(),
            _ => None,
        }
    }
}
