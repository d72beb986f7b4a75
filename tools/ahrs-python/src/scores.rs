//! Errors of stages on recordings.
//!
//! Output: the numbers that `plumb score --json` prints.

use std::{collections::BTreeMap, path::PathBuf};

use ::score::{
    Request,
    stages::{Setting, StageSelection},
    table::Scores,
    trial::{Gnss, TrialOptions},
};
use import::{
    Options, Table,
    readable::{ReadableFile, ReadableTable},
};
use launch::Launch;
use pyo3::{
    prelude::*,
    types::{PyAny, PyDict, PyTuple},
};

use crate::{
    arguments,
    error::{FileError as _, value_error},
    read_options::{self, Log, ReadArguments},
};

/// Prefix of the names of simulations.
const SIMULATION: &str = "sim:";

/// Index of a sensor, or a name such as `off`.
#[derive(FromPyObject)]
pub(crate) enum SensorChoice {
    Index(usize),
    Name(String),
}

/// Compute the errors of a fuser stage against the reference attitude of recordings.
///
/// The numbers are those of `plumb score --json`. The GIL is released, and all cores are used.
///
/// files: paths of recordings in the formats of `read`, or simulations such as "sim:s1"; at least
///     one. Every segment of a log is scored.
/// fuser, gyro, accel, course: names of the stages, see `Ahrs.stages`.
/// parameters: values of parameters by slot and name, see `Ahrs.parameters`.
/// gyro_samples: "mean" if rates are means over their intervals (the default), or "instant".
/// mag: "on" (the default), "off", or the index of the magnetometer.
/// gnss: "auto" (the default) for the fixes of the recording, "off", or the index of the receiver.
/// reference: file with the reference attitude t_s,qw,qx,qy,qz, body to east-north-up; for a single
///     recording.
///
/// The other arguments are those of `read`. The result is a dict, see `Score`. Errors are root mean
/// squares in degrees over the samples with a reference; None without a reference.
///
/// Raises OSError if a file cannot be opened, and ValueError if its contents or the arguments are
/// invalid.
#[pyfunction]
#[pyo3(signature = (*files, fuser = "multiple-model", gyro = None, accel = None, course = None,
    parameters = None, gyro_samples = None, mag = None, gnss = None, reference = None, map = None,
    units = None, frame = None, topics = None, segment = None, time_bits = None, imu = None))]
#[allow(clippy::too_many_arguments, reason = "keyword arguments")]
pub(crate) fn score<'py>(
    py: Python<'py>,
    files: &Bound<'_, PyTuple>,
    fuser: &str,
    gyro: Option<String>,
    accel: Option<String>,
    course: Option<String>,
    parameters: Option<BTreeMap<String, BTreeMap<String, f64>>>,
    gyro_samples: Option<&str>,
    mag: Option<SensorChoice>,
    gnss: Option<SensorChoice>,
    reference: Option<PathBuf>,
    map: Option<BTreeMap<String, String>>,
    units: Option<&str>,
    frame: Option<&str>,
    topics: Option<Vec<String>>,
    segment: Option<usize>,
    time_bits: Option<u8>,
    imu: Option<usize>,
) -> PyResult<Bound<'py, PyAny>> {
    let paths = read_options::paths(files)?;
    let (mag, without_field) = sensor("mag", mag, "on")?;
    let (gnss, without_fixes) = sensor("gnss", gnss, "auto")?;
    let reading = ReadArguments { map, units, frame, topics, segment, time_bits, imu, mag, gnss }.options()?;
    let settings = parameters.into_iter().flatten().flat_map(|(slot, values)| {
        values.into_iter().map(move |(key, value)| Setting { target: Some(slot.clone()), key, value })
    });
    let selection = StageSelection {
        gyro,
        accel,
        course,
        fusers: vec![fuser.into()],
        launch: Launch::default(),
        settings: settings.collect(),
    };
    let options = TrialOptions {
        gnss: if without_fixes { Gnss::Off } else { Gnss::Auto },
        without_field,
        reference,
        gyro_samples: gyro_samples.map(arguments::gyro_samples).transpose()?,
        ..TrialOptions::default()
    };
    let (scores, warnings) = py.detach(|| compute(&paths, &reading, selection, options))?;
    let json = py.import("json")?.call_method1("loads", (scores.json(),))?;
    let stage = json.get_item("stages")?.get_item(0)?.cast_into::<PyDict>()?;
    let found = scores.warnings.iter().map(|warning| format!("{}: {}", warning.trial, warning.text));
    stage.set_item("warnings", warnings.into_iter().chain(found).collect::<Vec<_>>())?;
    Ok(stage.into_any())
}

/// Opens the recordings and scores the stages. Also returns the warnings of the import.
fn compute(
    paths: &[PathBuf],
    reading: &Options,
    selection: StageSelection,
    options: TrialOptions,
) -> PyResult<(Scores, Vec<String>)> {
    let is_simulation = |path: &PathBuf| path.to_string_lossy().starts_with(SIMULATION);
    if options.reference.is_some() && (paths.len() > 1 || paths.iter().any(is_simulation)) {
        return Err(value_error("reference belongs to a single recording; score the other files separately"));
    }
    let mut log = Log::default();
    let mut files = Vec::new();
    // An imported recording is a temporary file that is removed on drop.
    let mut readable = Vec::new();
    for path in paths {
        if is_simulation(path) {
            files.push(path.to_string_lossy().into_owned());
            continue;
        }
        let segments = ReadableFile::open_segments(path, reading, &mut |event| log.record(event))
            .map_err(|error| error.exception(error.to_string()))?;
        files.extend(segments.iter().map(|segment| segment.path.to_string_lossy().into_owned()));
        readable.extend(segments);
    }
    let table = options.reference.as_ref();
    let table = table.map(|path| ReadableTable::open(path, Table::Reference, &mut |event| log.record(event)));
    let with_axes = readable.iter().filter(|file| file.has_own_axes());
    let request = Request {
        files,
        files_with_axes: with_axes.map(|file| file.path.to_string_lossy().into_owned()).collect(),
        options: TrialOptions { reference: table.as_ref().map(|table| table.path.clone()), ..options },
        selection,
        ..Request::default()
    };
    let scores = ::score::run(&request, &mut |_, _| {}).map_err(|error| {
        let text = readable.iter().fold(error.to_string(), |text, file| file.with_user_path(&text));
        error.exception(table.iter().fold(text, |text, table| table.with_user_path(&text)))
    })?;
    Ok((scores, log.warnings))
}

/// Returns the index of the sensor, if any, and `true` if the sensor is off.
fn sensor(argument: &str, choice: Option<SensorChoice>, default: &str) -> PyResult<(Option<usize>, bool)> {
    match choice {
        None => Ok((None, false)),
        Some(SensorChoice::Index(index)) => Ok((Some(index), false)),
        Some(SensorChoice::Name(name)) if name == default => Ok((None, false)),
        Some(SensorChoice::Name(name)) if name == "off" => Ok((None, true)),
        Some(SensorChoice::Name(name)) => Err(value_error(format_args!(
            "unknown {argument} `{name}`; choose {default}, off or the index of a sensor"
        ))),
    }
}
