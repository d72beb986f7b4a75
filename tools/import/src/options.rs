//! Options of an import.

use mapping::Mapping;

/// Options for reading the input files.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Options {
    /// Meaning of the columns. Required for CSV and rejected for other formats.
    pub mapping: Option<Mapping>,
    /// Topics to read if several contain the same quantity. Allowed only for bags and MCAP files.
    pub topics: Vec<String>,
    /// Number of the inertial sensor to read, from 0. If `None`, the first sensor that works is
    /// read.
    pub imu: Option<usize>,
    /// Number of the magnetometer to read, from 0.
    pub mag: Option<usize>,
    /// Number of the receiver to read, from 0.
    pub gnss: Option<usize>,
    /// Number of the segment to read, from 1; the longest one if `None`.
    pub segment: Option<usize>,
    /// Width of the time in bits if the time is a wrapping counter.
    pub time_bits: Option<u8>,
}
