//! Native part of the Python package `plumbline_ahrs`.
//!
//! `python/plumbline_ahrs/_native.pyi` describes the classes for users; the docstrings are those of
//! this crate.
//!
//! Input: numbers, sequences and numpy arrays of the caller; recordings; the bus of a running
//! system.
//!
//! Failure: a Python exception with the message of the Rust error. The objects are then unchanged.

use pyo3::prelude::*;

mod arguments;
mod attitude_output;
mod batch;
mod error;
mod filter;
mod read_options;
mod recordings;
mod scores;
mod structured;
mod subscriber;
mod values;

/// Native classes of the package `plumbline_ahrs`.
#[pymodule(name = "_native")]
mod native {
    #[pymodule_export]
    use crate::{
        attitude_output::Attitude,
        batch::Batch,
        filter::Ahrs,
        recordings::{Recording, read},
        scores::score,
        subscriber::Subscriber,
    };
}
