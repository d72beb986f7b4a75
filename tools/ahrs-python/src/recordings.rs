//! Recordings as structured arrays.
//!
//! Input: a recording of Plumbline, or a log of another system.
//!
//! Output: one element per sample and per fix, without a copy.
//!
//! Failure: `OSError` if a file cannot be opened, else `ValueError`. The messages are those of
//! `plumb`; an option such as `--units` is the argument of the same name.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use import::{
    Options, Table,
    readable::{Event, ReadableFile, ReadableTable},
};
use pyo3::{
    prelude::*,
    types::{PyAny, PyList, PyTuple},
};
use recording::{Reader, RecordingError, References, gnss};

use crate::{
    error::FileError as _,
    read_options::{self, Log, ReadArguments},
    structured::{self, Field},
    values,
};

/// Words of a sample, a reference and a fix.
const SAMPLE_WORDS: usize = 10;
const REFERENCE_WORDS: usize = 5;
const FIX_WORDS: usize = 7;

/// Samples, fixes and reference attitudes of a recording.
///
/// The sensor axes are those of the recording; for a log of another system, they are right,
/// forward, up.
#[pyclass(frozen, get_all, module = "plumbline_ahrs")]
pub(crate) struct Recording {
    /// Samples, structured array, shape (n,): `t_ns` (int64, ns, clock of the recording),
    /// `gyro_rad_s` (3), `accel_m_s2` (3; specific force), `field_ut` (3; NaN without a sample).
    samples: Py<PyAny>,
    /// Reference attitude at each sample, structured array, shape (n,): `quaternion` (4; w x y z,
    /// body to east-north-up, NaN if unknown), `is_scored` (bool; `score` compares with it).
    references: Py<PyAny>,
    /// Fixes of the satellite receiver, structured array, shape (m,): `t_ns` (int64, ns, time of
    /// arrival), `velocity_m_s` (3; east, north, up), `latitude_deg`, `longitude_deg`,
    /// `altitude_m` (NaN if unknown).
    fixes: Py<PyAny>,
    /// Format of the file, such as "ULog"; "recording" for a recording of Plumbline.
    format: String,
    /// Skipped or missing data and assumptions, as `plumb import` prints them.
    notes: Vec<String>,
    /// Findings that make the result doubtful, such as "used only 10 of 30 rows".
    warnings: Vec<String>,
    /// Parts between restarts of the clock, list of `Segment`; empty if the clock never restarts.
    segments: Py<PyList>,
    /// Sensors of which one can be chosen, list of `RecordedSensor`.
    sensors: Py<PyList>,
}

#[pymethods]
impl Recording {
    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        self.samples.bind(py).len()
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        Ok(format!("Recording({}, {} samples, {} fixes)", self.format, self.__len__(py)?, self.fixes.bind(py).len()?))
    }
}

/// Read a recording: CSV, CSV.gz, PX4 ULog, ArduPilot log, tlog, MCAP or ROS 2 bag.
///
/// Most formats need no argument. The GIL is released while the file is read.
///
/// files: path of the recording, or of several CSV files that are joined by time.
/// map: columns of a CSV by quantity, such as {"gx": "gyro_x"}; quantities are t, gx, gy, gz, ax,
///     ay, az, and optionally mx, my, mz, qw, qx, qy, qz, ve, vn, vu or vd, lat, lon, alt.
/// units: units of a CSV, MCAP or bag, such as "ms,deg/s,g"; default "rad/s,m/s2,uT,s".
/// frame: body axes "rfu" (the default), "frd" or "flu", or with a reference such as "ned-frd".
/// topics: topics to read if a bag or an MCAP file has several of a kind.
/// segment: segment to read, from 1, if the clock of the log restarts; default the longest.
/// time_bits: bits of the time counter of a CSV if it wraps, 1 to 63.
/// imu, mag, gnss: indices of the sensors to read, from 0; see `Recording.sensors`.
/// reference: file with the reference attitude t_s,qw,qx,qy,qz, body to east-north-up.
///
/// Raises OSError if a file cannot be opened, and ValueError if its contents or the arguments are
/// invalid. An option in the message, such as `--units`, is the argument of the same name.
#[pyfunction]
#[pyo3(signature = (*files, map = None, units = None, frame = None, topics = None, segment = None,
    time_bits = None, imu = None, mag = None, gnss = None, reference = None))]
#[allow(clippy::too_many_arguments, reason = "keyword arguments")]
pub(crate) fn read(
    py: Python<'_>,
    files: &Bound<'_, PyTuple>,
    map: Option<BTreeMap<String, String>>,
    units: Option<&str>,
    frame: Option<&str>,
    topics: Option<Vec<String>>,
    segment: Option<usize>,
    time_bits: Option<u8>,
    imu: Option<usize>,
    mag: Option<usize>,
    gnss: Option<usize>,
    reference: Option<PathBuf>,
) -> PyResult<Recording> {
    let paths = read_options::paths(files)?;
    let options = ReadArguments { map, units, frame, topics, segment, time_bits, imu, mag, gnss }.options()?;
    let (rows, log) = py.detach(|| read_rows(&paths, &options, reference.as_deref()))?;
    let Rows { samples, references, fixes } = rows;
    let sample =
        [("t_ns", "i8", 1), ("gyro_rad_s", "(3,)f8", 3), ("accel_m_s2", "(3,)f8", 3), ("field_ut", "(3,)f8", 3)];
    let reference = [("quaternion", "(4,)f8", 4), ("is_scored", "?", 1)];
    let fix = [
        ("t_ns", "i8", 1),
        ("velocity_m_s", "(3,)f8", 3),
        ("latitude_deg", "f8", 1),
        ("longitude_deg", "f8", 1),
        ("altitude_m", "f8", 1),
    ];
    let array = |words: Vec<u64>, fields: &[_], size: usize| -> PyResult<Py<PyAny>> {
        let dtype = structured::dtype(py, &Field::successive(fields), size * size_of::<u64>())?;
        Ok(structured::array(words, &dtype)?.unbind())
    };
    let Log { summary, notes, warnings } = log;
    Ok(Recording {
        samples: array(samples, &sample, SAMPLE_WORDS)?,
        references: array(references, &reference, REFERENCE_WORDS)?,
        fixes: array(fixes, &fix, FIX_WORDS)?,
        format: summary.as_ref().map_or(import::Format::Recording, |summary| summary.format).to_string(),
        notes,
        warnings,
        segments: values::segments(py, summary.iter().flat_map(|summary| &summary.segments))?,
        sensors: values::sensors(py, summary.iter().flat_map(|summary| &summary.sensors))?,
    })
}

/// Words of all elements.
#[derive(Default)]
struct Rows {
    samples: Vec<u64>,
    references: Vec<u64>,
    fixes: Vec<u64>,
}

/// Opens and reads the recording. Also returns what was reported.
fn read_rows(paths: &[PathBuf], options: &Options, reference: Option<&Path>) -> PyResult<(Rows, Log)> {
    let mut log = Log::default();
    let mut record = |event: Event<'_>| log.record(event);
    let readable = match paths {
        [path] => ReadableFile::open(path, options, &mut record),
        _ => ReadableFile::import(paths, options, &mut record).map(|(readable, summary)| {
            record(Event::Imported { path: &readable.user_path, summary: &summary });
            readable
        }),
    };
    let readable = readable.map_err(|error| error.exception(error.to_string()))?;
    let table = reference.map(|path| ReadableTable::open(path, Table::Reference, &mut record));
    let rows = rows(&readable.path, table.as_ref().map(|table| table.path.as_path())).map_err(|error| {
        let text = readable.with_user_path(&error.to_string());
        error.exception(table.as_ref().map_or_else(|| text.clone(), |table| table.with_user_path(&text)))
    })?;
    Ok((rows, log))
}

/// Reads the rows of a recording and its fixes.
fn rows(recording: &Path, reference: Option<&Path>) -> Result<Rows, RecordingError> {
    let mut rows = Rows::default();
    let mut separate = reference.map(References::open).transpose()?;
    for row in Reader::open(recording)? {
        let row = row?;
        rows.samples.push(row.t_ns as u64);
        let field_ut = row.field_ut.unwrap_or([f64::NAN; 3]);
        rows.samples
            .extend([row.rate_rad_s, row.force_m_s2, field_ut].as_flattened().iter().copied().map(f64::to_bits));
        let reference = match &mut separate {
            Some(references) => references.attitude_at(row.t_ns, row.rate_rad_s)?,
            None => row.reference,
        };
        let quaternion = reference.map_or([f64::NAN; 4], |reference| reference.quaternion);
        rows.references.extend(quaternion.map(f64::to_bits));
        rows.references.push(reference.is_some_and(|reference| reference.scored).into());
    }
    if let Some(path) = gnss::find_for(recording) {
        for fix in gnss::FixReader::open(&path)? {
            let gnss::Fix { t_ns, velocity_m_s, latitude_deg, longitude_deg, altitude_m } = fix?;
            rows.fixes.push(t_ns as u64);
            rows.fixes.extend(velocity_m_s.map(f64::to_bits));
            let position = [latitude_deg, longitude_deg, altitude_m];
            rows.fixes.extend(position.map(|part| part.unwrap_or(f64::NAN).to_bits()));
        }
    }
    Ok(rows)
}
