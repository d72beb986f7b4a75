//! Value classes that the Python part of the package defines.

use plumbline_ahrs::{Angles, Flags, Parameter};
use pyo3::{
    prelude::*,
    sync::PyOnceLock,
    types::{PyAny, PyType},
};

/// Classes of the module `plumbline_ahrs._values`.
struct Classes {
    angles: Py<PyType>,
    flags: Py<PyType>,
    parameter: Py<PyType>,
}

/// Returns the classes. The module is imported on the first call.
fn classes(py: Python<'_>) -> PyResult<&Classes> {
    static CLASSES: PyOnceLock<Classes> = PyOnceLock::new();
    CLASSES.get_or_try_init(py, || {
        let module = py.import("plumbline_ahrs._values")?;
        let class = |name| -> PyResult<Py<PyType>> { Ok(module.getattr(name)?.cast_into::<PyType>()?.unbind()) };
        Ok(Classes { angles: class("Angles")?, flags: class("Flags")?, parameter: class("Parameter")? })
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
