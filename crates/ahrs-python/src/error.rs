//! Errors of the Rust crate as exceptions.

use pyo3::{PyErr, exceptions::PyValueError};

/// Returns an error as a `ValueError` with the same message.
pub(crate) fn value_error(error: impl core::fmt::Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}
