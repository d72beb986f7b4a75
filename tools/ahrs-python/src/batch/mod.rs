//! Many samples in one call.
//!
//! Input: numpy arrays with one row per sample. Arrays of `float64` are read in place, with any
//! strides.
//!
//! Output: numpy arrays with one row per sample. The results are not copied.
//!
//! Failure: if an array has the wrong shape, the call fails before the first sample is processed.

mod pages;
mod rows;
mod two_threads;

use numpy::{
    AllowTypeChange, IntoPyArray as _, PyArray1, PyArray2, PyArrayLikeDyn, PyArrayMethods as _,
    PyUntypedArrayMethods as _, TypeMustMatch,
    ndarray::{ArrayView1, ArrayView2, Ix1, Ix2},
};
use plumbline_ahrs::{
    Frame,
    attitude::{course::DeferredAngles, fuser::Fuser},
    parts::{CheckedSample, SampleTime, Sensors},
};
use pyo3::{exceptions::PyTypeError, prelude::*, sync::PyOnceLock};

use crate::error::value_error;
use rows::Rows;

/// Numbers from the caller: an array, or a sequence that numpy converts to an array.
pub(crate) type Numbers<'py> = PyArrayLikeDyn<'py, f64, AllowTypeChange>;
/// Timestamps passed by the caller. Only `int64` is accepted, because other types could lose
/// digits.
pub(crate) type Stamps<'py> = PyArrayLikeDyn<'py, i64, TypeMustMatch>;

/// Attitudes after each sample of a batch, one row per sample.
///
/// The row of a rejected sample equals the row before it, including `tick`.
#[pyclass(frozen, module = "plumbline_ahrs")]
pub(crate) struct Batch {
    /// Unit quaternions from body to reference axes of the frame, w x y z, shape (n, 4).
    #[pyo3(get)]
    quaternion: Py<PyArray2<f64>>,
    frame: Frame,
    /// Values from which the angles and the headings are computed.
    deferred: Vec<DeferredAngles>,
    angles: PyOnceLock<Angles>,
    /// Standard deviations of the heading, rad, shape (n,); π if the heading is unknown.
    #[pyo3(get)]
    heading_sd_rad: Py<PyArray1<f64>>,
    /// Standard deviations of the inclination, rad, shape (n,).
    #[pyo3(get)]
    inclination_sd_rad: Py<PyArray1<f64>>,
    /// Body rates in the body axes of the frame with the bias removed, rad/s, shape (n, 3).
    #[pyo3(get)]
    rate_rad_s: Py<PyArray2<f64>>,
    /// Gyro biases in the body axes of the frame, rad/s, shape (n, 3).
    #[pyo3(get)]
    gyro_bias_rad_s: Py<PyArray2<f64>>,
    /// Bits of `Flags`, uint64, shape (n,).
    #[pyo3(get)]
    flags: Py<PyArray1<u64>>,
    /// Number of samples accepted before each sample, uint64, shape (n,).
    #[pyo3(get)]
    tick: Py<PyArray1<u64>>,
    /// Number of jumps of the attitude or the heading so far, uint64, shape (n,).
    #[pyo3(get)]
    reset_counter: Py<PyArray1<u64>>,
}

/// Angles and headings of a batch.
struct Angles {
    angles_rad: Py<PyArray2<f64>>,
    heading_rad: Py<PyArray1<f64>>,
}

#[pymethods]
impl Batch {
    /// Yaw, pitch and roll by the conventions of the frame, rad, shape (n, 3).
    ///
    /// They are computed on the first access.
    #[getter]
    fn angles_rad(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        Ok(self.angles(py)?.angles_rad.clone_ref(py))
    }

    /// Headings, rad, clockwise from above, [0, 2π), shape (n,).
    ///
    /// They are computed on the first access.
    #[getter]
    fn heading_rad(&self, py: Python<'_>) -> PyResult<Py<PyArray1<f64>>> {
        Ok(self.angles(py)?.heading_rad.clone_ref(py))
    }

    fn __len__(&self) -> usize {
        self.deferred.len()
    }

    fn __repr__(&self) -> String {
        format!("Batch of {} attitudes", self.__len__())
    }
}

impl Batch {
    /// Moves the memory of the rows into numpy arrays.
    fn new(py: Python<'_>, rows: Rows) -> PyResult<Self> {
        let Rows {
            frame,
            quaternion,
            angles,
            heading_sd_rad,
            inclination_sd_rad,
            rate_rad_s,
            gyro_bias_rad_s,
            flags,
            tick,
            reset_counter,
            ..
        } = rows;
        Ok(Self {
            quaternion: table(py, quaternion)?,
            frame,
            deferred: angles,
            angles: PyOnceLock::new(),
            heading_sd_rad: heading_sd_rad.into_pyarray(py).unbind(),
            inclination_sd_rad: inclination_sd_rad.into_pyarray(py).unbind(),
            rate_rad_s: table(py, rate_rad_s)?,
            gyro_bias_rad_s: table(py, gyro_bias_rad_s)?,
            flags: flags.into_pyarray(py).unbind(),
            tick: tick.into_pyarray(py).unbind(),
            reset_counter: reset_counter.into_pyarray(py).unbind(),
        })
    }

    /// Returns the angles and the headings. The first call computes them, without the GIL.
    fn angles(&self, py: Python<'_>) -> PyResult<&Angles> {
        self.angles.get_or_try_init(py, || {
            let compute = |deferred: &DeferredAngles| {
                let (angles, heading_rad) = deferred.compute();
                let angles = self.frame.angles(angles);
                ([angles.yaw_rad, angles.pitch_rad, angles.roll_rad], heading_rad)
            };
            let (angles_rad, heading_rad): (Vec<_>, Vec<_>) = py.detach(|| self.deferred.iter().map(compute).unzip());
            Ok(Angles { angles_rad: table(py, angles_rad)?, heading_rad: heading_rad.into_pyarray(py).unbind() })
        })
    }
}

/// Moves the memory of vectors into a numpy array of the shape (n, `COLUMNS`).
fn table<const COLUMNS: usize>(py: Python<'_>, rows: Vec<[f64; COLUMNS]>) -> PyResult<Py<PyArray2<f64>>> {
    let len = rows.len();
    Ok(rows.into_flattened().into_pyarray(py).reshape([len, COLUMNS])?.unbind())
}

/// Times of the samples.
enum Times<'a> {
    /// Interval before every sample, s.
    Interval(f64),
    /// Interval before each sample, s.
    Intervals(ArrayView1<'a, f64>),
    /// Timestamps, ns.
    Stamps(ArrayView1<'a, i64>),
}

/// Samples of a batch.
pub(crate) struct Samples<'a, 'py> {
    pub(crate) gyro_rad_s: &'a Numbers<'py>,
    pub(crate) accel_m_s2: &'a Numbers<'py>,
    pub(crate) field_ut: Option<&'a Numbers<'py>>,
    pub(crate) dt_s: Option<&'a Numbers<'py>>,
    pub(crate) t_ns: Option<&'a Stamps<'py>>,
}

/// Passes the samples to the filter without the GIL.
pub(crate) fn update(
    py: Python<'_>,
    ahrs: &mut plumbline_ahrs::Ahrs<Fuser>,
    samples: &Samples<'_, '_>,
    frame: Frame,
) -> PyResult<Batch> {
    let rates = vectors("gyro_rad_s", samples.gyro_rad_s, None)?;
    let len = rates.nrows();
    let forces = vectors("accel_m_s2", samples.accel_m_s2, Some(len))?;
    let fields = samples.field_ut.map(|field| vectors("field_ut", field, Some(len))).transpose()?;
    let times = match (samples.dt_s, samples.t_ns) {
        (Some(dt_s), None) if dt_s.ndim() == 0 => Times::Interval(dt_s.as_array().sum()),
        (Some(dt_s), None) => Times::Intervals(
            dt_s.as_array().into_dimensionality::<Ix1>().ok().filter(|values| values.len() == len).ok_or_else(
                || shape_error("dt_s", dt_s.shape(), &format!("(), or ({len},) as gyro_rad_s has {len} rows")),
            )?,
        ),
        (None, Some(t_ns)) => {
            Times::Stamps(
                t_ns.as_array().into_dimensionality::<Ix1>().ok().filter(|values| values.len() == len).ok_or_else(
                    || shape_error("t_ns", t_ns.shape(), &format!("({len},) as gyro_rad_s has {len} rows")),
                )?,
            )
        }
        (Some(_), Some(_)) => return Err(PyTypeError::new_err("dt_s and t_ns exclude each other; omit one of them")),
        (None, None) => return Err(PyTypeError::new_err("the times of the samples are missing; pass dt_s or t_ns")),
    };
    let source = Arrays { rates, forces, fields, times };
    let rows = py.detach(|| {
        let mut rows = Rows::with_capacity(len, frame);
        two_threads::run(ahrs, &source, &mut rows);
        rows
    });
    Batch::new(py, rows)
}

/// Views of the arrays of a batch.
struct Arrays<'a> {
    rates: ArrayView2<'a, f64>,
    forces: ArrayView2<'a, f64>,
    fields: Option<ArrayView2<'a, f64>>,
    times: Times<'a>,
}

impl two_threads::Source for Arrays<'_> {
    fn len(&self) -> usize {
        self.rates.nrows()
    }

    #[inline]
    fn check(&self, index: usize, sensors: &mut Sensors<'_>, sample: &mut CheckedSample) {
        let [rate, force] = [&self.rates, &self.forces].map(|values| row(values, index));
        let field = self.fields.as_ref().map(|values| row(values, index));
        let field = field.filter(|field| !field.iter().all(|x| x.is_nan()));
        let time = match &self.times {
            Times::Interval(dt_s) => SampleTime::Interval { dt_s: *dt_s },
            Times::Intervals(dt_s) => SampleTime::Interval { dt_s: dt_s[index] },
            Times::Stamps(t_ns) => SampleTime::Stamp { t_ns: t_ns[index] },
        };
        sensors.process(rate, force, field, time, sample);
    }
}

fn row(values: &ArrayView2<'_, f64>, i: usize) -> [f64; 3] {
    [values[[i, 0]], values[[i, 1]], values[[i, 2]]]
}

/// Returns a view of an array of vectors. `len` is the expected number of rows.
fn vectors<'a>(name: &str, array: &'a Numbers<'_>, len: Option<usize>) -> PyResult<ArrayView2<'a, f64>> {
    let view = array.as_array().into_dimensionality::<Ix2>().ok();
    view.filter(|view| view.ncols() == 3 && len.is_none_or(|len| view.nrows() == len)).ok_or_else(|| {
        let expected = len.map_or_else(|| "(n, 3)".into(), |len| format!("({len}, 3) as gyro_rad_s has {len} rows"));
        shape_error(name, array.shape(), &expected)
    })
}

fn shape_error(name: &str, found: &[usize], expected: &str) -> PyErr {
    let sizes: Vec<_> = found.iter().map(ToString::to_string).collect();
    let found = if let [size] = &sizes[..] { format!("({size},)") } else { format!("({})", sizes.join(", ")) };
    value_error(format_args!("{name} has the shape {found}, expected {expected}"))
}
