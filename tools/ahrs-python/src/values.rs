//! Value classes that the Python part of the package defines.

use import::{Segment, Sensor};
use plumbline_ahrs::{Angles, Flags, Parameter};
use pyo3::{
    prelude::*,
    sync::PyOnceLock,
    types::{PyAny, PyList, PyType},
};

/// Classes of the module `plumbline_ahrs._values`.
struct Classes {
    angles: Py<PyType>,
    flags: Py<PyType>,
    parameter: Py<PyType>,
    segment: Py<PyType>,
    sensor: Py<PyType>,
}

/// Returns the classes. The module is imported on the first call.
fn classes(py: Python<'_>) -> PyResult<&Classes> {
    static CLASSES: PyOnceLock<Classes> = PyOnceLock::new();
    CLASSES.get_or_try_init(py, || {
        let module = py.import("plumbline_ahrs._values")?;
        let class = |name| -> PyResult<Py<PyType>> { Ok(module.getattr(name)?.cast_into::<PyType>()?.unbind()) };
        Ok(Classes {
            angles: class("Angles")?,
            flags: class("Flags")?,
            parameter: class("Parameter")?,
            segment: class("Segment")?,
            sensor: class("RecordedSensor")?,
        })
    })
}

/// Creates an `Angles`.
pub(crate) fn angles<'py>(py: Python<'py>, angles: Angles) -> PyResult<Bound<'py, PyAny>> {
    let Angles { yaw_rad, pitch_rad, roll_rad } = angles;
    classes(py)?.angles.bind(py).call1((yaw_rad, pitch_rad, roll_rad))
}

/// Creates a `Flags`.
pub(crate) fn flags<'py>(py: Python<'py>, flags: Flags) -> PyResult<Bound<'py, PyAny>> {
    classes(py)?.flags.bind(py).call1((flags.0,))
}

/// Creates a `Parameter`.
pub(crate) fn parameter<'py>(py: Python<'py>, parameter: &Parameter) -> PyResult<Bound<'py, PyAny>> {
    let Parameter { name, unit, default, min, max, description } = *parameter;
    classes(py)?.parameter.bind(py).call1((name, unit, default, min, max, description))
}

/// Creates a list of `Segment`.
pub(crate) fn segments<'a>(py: Python<'_>, segments: impl Iterator<Item = &'a Segment>) -> PyResult<Py<PyList>> {
    let class = classes(py)?.segment.bind(py);
    let create = |Segment { first_ns, last_ns, samples }: &Segment| class.call1((first_ns, last_ns, samples));
    Ok(PyList::new(py, segments.map(create).collect::<PyResult<Vec<_>>>()?)?.unbind())
}

/// Creates a list of `RecordedSensor`.
pub(crate) fn sensors<'a>(py: Python<'_>, sensors: impl Iterator<Item = &'a Sensor>) -> PyResult<Py<PyList>> {
    let class = classes(py)?.sensor.bind(py);
    let create = |sensor: &Sensor| {
        let Sensor { option, name, samples, rate_hz, state, is_read } = sensor;
        class.call1((option, name.raw(), samples, rate_hz, *state, is_read))
    };
    Ok(PyList::new(py, sensors.map(create).collect::<PyResult<Vec<_>>>()?)?.unbind())
}
