//! Many samples in one call.
//!
//! Input: numpy arrays with one row per sample. Arrays of `float64` are read in place, with any
//! strides.
//!
//! Output: numpy arrays with one row per sample. The results are not copied.
//!
//! Failure: if an array has the wrong shape, the call fails before the first sample is processed.

use numpy::{
    AllowTypeChange, IntoPyArray as _, PyArray1, PyArray2, PyArrayLikeDyn, PyArrayMethods as _,
    PyUntypedArrayMethods as _, TypeMustMatch,
    ndarray::{ArrayView1, ArrayView2, Ix1, Ix2},
};
use plumbline_ahrs::{Frame, attitude::fuser::Fuser};
use pyo3::{exceptions::PyTypeError, prelude::*};

use crate::error::value_error;

/// Numbers from the caller: an array, or a sequence that numpy converts to an array.
pub(crate) type Numbers<'py> = PyArrayLikeDyn<'py, f64, AllowTypeChange>;
/// Timestamps passed by the caller. Only `int64` is accepted, because other types could lose
/// digits.
pub(crate) type Stamps<'py> = PyArrayLikeDyn<'py, i64, TypeMustMatch>;

/// Attitudes after each sample of a batch, one row per sample.
///
/// The row of a rejected sample equals the row before it, including `tick`.
#[pyclass(frozen, get_all, module = "plumbline_ahrs")]
pub(crate) struct Batch {
    /// Unit quaternions from body to reference axes of the frame, w x y z, shape (n, 4).
    quaternion: Py<PyArray2<f64>>,
    /// Yaw, pitch and roll by the conventions of the frame, rad, shape (n, 3).
    angles_rad: Py<PyArray2<f64>>,
    /// Headings, rad, clockwise from above, [0, 2π), shape (n,).
    heading_rad: Py<PyArray1<f64>>,
    /// Standard deviations of the heading, rad, shape (n,); π if the heading is unknown.
    heading_sd_rad: Py<PyArray1<f64>>,
    /// Standard deviations of the inclination, rad, shape (n,).
    inclination_sd_rad: Py<PyArray1<f64>>,
    /// Body rates in the body axes of the frame with the bias removed, rad/s, shape (n, 3).
    rate_rad_s: Py<PyArray2<f64>>,
    /// Gyro biases in the body axes of the frame, rad/s, shape (n, 3).
    gyro_bias_rad_s: Py<PyArray2<f64>>,
    /// Bits of `Flags`, uint64, shape (n,).
    flags: Py<PyArray1<u64>>,
    /// Number of samples accepted before each sample, uint64, shape (n,).
    tick: Py<PyArray1<u64>>,
    /// Number of jumps of the attitude or the heading so far, uint64, shape (n,).
    reset_counter: Py<PyArray1<u64>>,
}

#[pymethods]
impl Batch {
    fn __len__(&self, py: Python<'_>) -> usize {
        self.tick.bind(py).len()
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        format!("Batch of {} attitudes", self.__len__(py))
    }
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

/// Values of the attitudes, row by row.
struct Rows {
    quaternion: Vec<f64>,
    angles_rad: Vec<f64>,
    heading_rad: Vec<f64>,
    heading_sd_rad: Vec<f64>,
    inclination_sd_rad: Vec<f64>,
    rate_rad_s: Vec<f64>,
    gyro_bias_rad_s: Vec<f64>,
    flags: Vec<u64>,
    tick: Vec<u64>,
    reset_counter: Vec<u64>,
}

impl Rows {
    fn with_capacity(len: usize) -> Self {
        Self {
            quaternion: Vec::with_capacity(4 * len),
            angles_rad: Vec::with_capacity(3 * len),
            heading_rad: Vec::with_capacity(len),
            heading_sd_rad: Vec::with_capacity(len),
            inclination_sd_rad: Vec::with_capacity(len),
            rate_rad_s: Vec::with_capacity(3 * len),
            gyro_bias_rad_s: Vec::with_capacity(3 * len),
            flags: Vec::with_capacity(len),
            tick: Vec::with_capacity(len),
            reset_counter: Vec::with_capacity(len),
        }
    }

    fn push(&mut self, attitude: &plumbline_ahrs::Attitude, frame: Frame) {
        let angles = attitude.angles_in(frame);
        self.quaternion.extend_from_slice(&attitude.quaternion_in(frame));
        self.angles_rad.extend_from_slice(&[angles.yaw_rad, angles.pitch_rad, angles.roll_rad]);
        self.heading_rad.push(attitude.heading_rad());
        self.heading_sd_rad.push(attitude.heading_sd_rad());
        self.inclination_sd_rad.push(attitude.inclination_sd_rad());
        self.rate_rad_s.extend_from_slice(&attitude.rate_rad_s_in(frame));
        self.gyro_bias_rad_s.extend_from_slice(&attitude.gyro_bias_rad_s_in(frame));
        self.flags.push(attitude.flags().0);
        self.tick.push(attitude.tick());
        self.reset_counter.push(attitude.reset_counter());
    }

    /// Moves the memory of the rows into numpy arrays.
    fn into_batch(self, py: Python<'_>) -> PyResult<Batch> {
        let len = self.tick.len();
        let table = |values: Vec<f64>, columns: usize| -> PyResult<Py<PyArray2<f64>>> {
            Ok(values.into_pyarray(py).reshape([len, columns])?.unbind())
        };
        Ok(Batch {
            quaternion: table(self.quaternion, 4)?,
            angles_rad: table(self.angles_rad, 3)?,
            heading_rad: self.heading_rad.into_pyarray(py).unbind(),
            heading_sd_rad: self.heading_sd_rad.into_pyarray(py).unbind(),
            inclination_sd_rad: self.inclination_sd_rad.into_pyarray(py).unbind(),
            rate_rad_s: table(self.rate_rad_s, 3)?,
            gyro_bias_rad_s: table(self.gyro_bias_rad_s, 3)?,
            flags: self.flags.into_pyarray(py).unbind(),
            tick: self.tick.into_pyarray(py).unbind(),
            reset_counter: self.reset_counter.into_pyarray(py).unbind(),
        })
    }
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
    let rows = py.detach(|| {
        let mut rows = Rows::with_capacity(len);
        for i in 0..len {
            let [rate, force] = [&rates, &forces].map(|values| row(values, i));
            let field = fields.as_ref().map(|values| row(values, i)).filter(|field| !field.iter().all(|x| x.is_nan()));
            let attitude = match &times {
                Times::Interval(dt_s) => ahrs.update(rate, force, field, *dt_s),
                Times::Intervals(dt_s) => ahrs.update(rate, force, field, dt_s[i]),
                Times::Stamps(t_ns) => ahrs.update_at(rate, force, field, t_ns[i]),
            };
            rows.push(&attitude, frame);
        }
        rows
    });
    rows.into_batch(py)
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
