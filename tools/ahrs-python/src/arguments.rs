//! Arguments that are given by name or have several types.

use launch::GyroSamples;
use plumbline_ahrs::{
    Calibration, Frame, Mounting, RateKind, Sensor, Slot,
    attitude::{Matrix3, Vector3},
};
use pyo3::prelude::*;

use crate::error::value_error;

/// Rows of a matrix.
pub(crate) type Rows = [[f64; 3]; 3];

const SENSORS: [(&str, Sensor); 3] = [("gyro", Sensor::Gyro), ("accel", Sensor::Accel), ("mag", Sensor::Mag)];
const RATE_KINDS: [(&str, RateKind); 2] = [("mean", RateKind::Mean), ("instant", RateKind::Instant)];
const GYRO_SAMPLES: [(&str, GyroSamples); 2] = [("mean", GyroSamples::Means), ("instant", GyroSamples::Instants)];

/// Returns the value of the choice with the given name.
fn named<T: Copy>(argument: &str, choices: &[(&str, T)], name: &str) -> PyResult<T> {
    choices.iter().find(|(choice, _)| *choice == name).map(|(_, value)| *value).ok_or_else(|| {
        let names: Vec<_> = choices.iter().map(|(choice, _)| *choice).collect();
        value_error(format_args!("unknown {argument} `{name}`; choose one of {}", names.join(", ")))
    })
}

/// Returns the frame with the given name.
pub(crate) fn frame(name: &str) -> PyResult<Frame> {
    named("frame", &Frame::NAMES, name)
}

/// Returns the slot with the given name.
pub(crate) fn slot(name: &str) -> PyResult<Slot> {
    named("slot", &Slot::ALL.map(|slot| (slot.name(), slot)), name)
}

/// Returns the sensor with the given name.
pub(crate) fn sensor(name: &str) -> PyResult<Sensor> {
    named("sensor", &SENSORS, name)
}

/// Returns the rate kind with the given name.
pub(crate) fn rate_kind(name: &str) -> PyResult<RateKind> {
    named("gyro_samples", &RATE_KINDS, name)
}

/// Returns the kind of rate samples with the given name, for a score.
pub(crate) fn gyro_samples(name: &str) -> PyResult<GyroSamples> {
    named("gyro_samples", &GYRO_SAMPLES, name)
}

/// Orientation of the sensors in the body.
#[derive(FromPyObject)]
pub(crate) enum MountingArgument {
    /// Name that gives the directions of the axes, such as `flu`.
    Name(String),
    /// Rotation matrix M, v_body = M v_sensor.
    Matrix(Rows),
}

impl MountingArgument {
    /// Returns the mounting.
    pub(crate) fn mounting(&self) -> PyResult<Mounting> {
        match self {
            Self::Name(name) => Mounting::from_name(name),
            Self::Matrix(rows) => Mounting::from_matrix(matrix(rows)),
        }
        .map_err(value_error)
    }
}

/// Returns the calibration out = M (raw − bias).
pub(crate) fn calibration(rows: &Rows, bias: [f64; 3]) -> PyResult<Calibration> {
    Calibration::new(Vector3::from(bias), matrix(rows)).map_err(value_error)
}

fn matrix(rows: &Rows) -> Matrix3<f64> {
    Matrix3::from_row_slice(rows.as_flattened())
}
