//! Structured numpy arrays from words of 8 bytes.

use numpy::{IntoPyArray as _, PyArrayDescr};
use pyo3::{
    prelude::*,
    types::{PyAny, PyDict},
};

/// Field of a structured array.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Field {
    pub(crate) name: &'static str,
    /// Type in the notation of numpy, such as `(3,)f8`.
    pub(crate) format: String,
    /// Offset from the start of the element, bytes.
    pub(crate) offset: usize,
}

impl Field {
    /// Returns fields that follow each other, from names, formats and sizes in words.
    pub(crate) fn successive(fields: &[(&'static str, &str, usize)]) -> Vec<Self> {
        let mut offset = 0;
        let place = |(name, format, words): &(&'static str, &str, usize)| {
            let field = Self { name, format: (*format).into(), offset };
            offset += words * size_of::<u64>();
            field
        };
        fields.iter().map(place).collect()
    }
}

/// Returns the type of an element of `size` bytes.
pub(crate) fn dtype<'py>(py: Python<'py>, fields: &[Field], size: usize) -> PyResult<Bound<'py, PyArrayDescr>> {
    let description = PyDict::new(py);
    description.set_item("names", fields.iter().map(|field| field.name).collect::<Vec<_>>())?;
    description.set_item("formats", fields.iter().map(|field| &field.format[..]).collect::<Vec<_>>())?;
    description.set_item("offsets", fields.iter().map(|field| field.offset).collect::<Vec<_>>())?;
    description.set_item("itemsize", size)?;
    PyArrayDescr::new(py, description)
}

/// Moves words into a structured array. Nothing is copied.
pub(crate) fn array<'py>(words: Vec<u64>, dtype: &Bound<'py, PyArrayDescr>) -> PyResult<Bound<'py, PyAny>> {
    words.into_pyarray(dtype.py()).into_any().call_method1("view", (dtype,))
}
