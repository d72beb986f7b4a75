//! The filter as a Python object.

use std::collections::BTreeMap;

use plumbline_ahrs::{
    AhrsBuilder, GnssFix,
    attitude::fuser::{Fuser, multiple_model::MultipleModel},
};
use pyo3::{
    prelude::*,
    types::{PyAny, PyBytes},
};

use crate::{
    arguments::{self, MountingArgument, Rows},
    attitude_output::Attitude,
    batch::{self, Batch, Numbers, Samples, Stamps},
    error::value_error,
    values,
};

/// Attitude and heading reference system.
///
/// No argument is necessary. All units are SI units, with angles in radians; the magnetic field is
/// in µT.
///
/// fuser, gyro, accel, course: names of the stages, see `stages`. The default fuser suits every
///     combination of sensors.
/// parameters: values of parameters by slot and name, such as {"fuser": {"name": 1.0}}, see
///     `parameters`.
/// mounting: orientation of the sensors in the body: "rfu" (right, forward, up; the default),
///     "flu", "frd", the body directions of the x and y axes such as "x-forward-y-left", or a
///     rotation matrix M, shape (3, 3), v_body = M v_sensor.
/// calibration: matrix M, shape (3, 3), and bias, shape (3,), of the sensors "gyro", "accel" and
///     "mag" in their own axes: out = M (raw − bias).
/// gyro_samples: "mean" if rates are means over their intervals (the default), or "instant".
/// sample_rate_hz: nominal sampling rate, 0.1 to 100,000 Hz; default 100.
/// gyro_range_deg_s: range of the gyro, 1 to 100,000 °/s; default 2000.
/// accel_range_g: range of the accelerometer, 0.1 to 10,000 g; default 16.
/// mag_range_ut: range of the magnetometer, 1 to 1,000,000 µT; default 2000.
/// gap_s: longest interval that is not flagged as a gap, 0.001 to 10 s; default 0.1.
/// frozen_after_s: time after which a repeated value counts as frozen, 0.01 to 60 s; default 0.5.
/// declination_deg: magnetic declination, −180° to 180°, east positive; default 0. It converts a
///     magnetic heading to a true heading.
///
/// Raises ValueError if a name is unknown or a value is out of range.
#[pyclass(module = "plumbline_ahrs")]
pub(crate) struct Ahrs {
    filter: plumbline_ahrs::Ahrs<Fuser>,
}

#[pymethods]
impl Ahrs {
    #[new]
    #[pyo3(signature = (*, fuser = None, gyro = None, accel = None, course = None, parameters = None,
        mounting = None, calibration = None, gyro_samples = None, sample_rate_hz = None,
        gyro_range_deg_s = None, accel_range_g = None, mag_range_ut = None, gap_s = None,
        frozen_after_s = None, declination_deg = None))]
    #[allow(clippy::too_many_arguments, reason = "keyword arguments")]
    fn new(
        fuser: Option<&str>,
        gyro: Option<&str>,
        accel: Option<&str>,
        course: Option<&str>,
        parameters: Option<BTreeMap<String, BTreeMap<String, f64>>>,
        mounting: Option<MountingArgument>,
        calibration: Option<BTreeMap<String, (Rows, [f64; 3])>>,
        gyro_samples: Option<&str>,
        sample_rate_hz: Option<f64>,
        gyro_range_deg_s: Option<f64>,
        accel_range_g: Option<f64>,
        mag_range_ut: Option<f64>,
        gap_s: Option<f64>,
        frozen_after_s: Option<f64>,
        declination_deg: Option<f64>,
    ) -> PyResult<Self> {
        let mut builder = default_builder();
        builder = applied(builder, fuser, AhrsBuilder::fuser_stage)?;
        builder = applied(builder, gyro, AhrsBuilder::gyro_stage)?;
        builder = applied(builder, accel, AhrsBuilder::accel_stage)?;
        builder = applied(builder, course, AhrsBuilder::course_stage)?;
        for (slot, values) in parameters.unwrap_or_default() {
            let slot = arguments::slot(&slot)?;
            for (name, value) in values {
                builder = builder.parameter(slot, &name, value).map_err(value_error)?;
            }
        }
        if let Some(mounting) = mounting {
            builder = builder.mounting(mounting.mounting()?);
        }
        for (sensor, (matrix, bias)) in calibration.unwrap_or_default() {
            builder = builder.calibration(arguments::sensor(&sensor)?, arguments::calibration(&matrix, bias)?);
        }
        if let Some(kind) = gyro_samples {
            builder = builder.gyro_samples(arguments::rate_kind(kind)?);
        }
        builder = applied(builder, sample_rate_hz, AhrsBuilder::sample_rate_hz)?;
        builder = applied(builder, gyro_range_deg_s, AhrsBuilder::gyro_range_deg_s)?;
        builder = applied(builder, accel_range_g, AhrsBuilder::accel_range_g)?;
        builder = applied(builder, mag_range_ut, AhrsBuilder::mag_range_ut)?;
        builder = applied(builder, gap_s, AhrsBuilder::gap_s)?;
        builder = applied(builder, frozen_after_s, AhrsBuilder::frozen_after_s)?;
        builder = applied(builder, declination_deg, AhrsBuilder::declination_deg)?;
        Ok(Self { filter: builder.build() })
    }

    /// Process a sample of all sensors and return the new attitude.
    ///
    /// gyro_rad_s: body rate, rad/s, shape (3,).
    /// accel_m_s2: specific force, m/s², shape (3,); points up at rest.
    /// field_ut: magnetic field, µT, shape (3,), or None for the newest field that `update_mag`
    ///     has stored since the previous sample, if any.
    /// dt_s: time since the previous sample, s. A value that is 0, negative or not finite marks a
    ///     late or repeated sample. The first sample only starts the clock.
    ///
    /// A missing value is NaN. If the sample is rejected, the attitude is unchanged.
    fn update(
        &mut self,
        gyro_rad_s: [f64; 3],
        accel_m_s2: [f64; 3],
        field_ut: Option<[f64; 3]>,
        dt_s: f64,
    ) -> Attitude {
        Attitude(self.filter.update(gyro_rad_s, accel_m_s2, field_ut, dt_s))
    }

    /// Process a timestamped sample of all sensors and return the new attitude.
    ///
    /// t_ns: end of the sample's interval on the clock of the sensors, ns.
    ///
    /// The other arguments are those of `update`.
    fn update_at(
        &mut self,
        gyro_rad_s: [f64; 3],
        accel_m_s2: [f64; 3],
        field_ut: Option<[f64; 3]>,
        t_ns: i64,
    ) -> Attitude {
        Attitude(self.filter.update_at(gyro_rad_s, accel_m_s2, field_ut, t_ns))
    }

    /// Store a magnetometer sample, µT, shape (3,). It takes effect with the next gyro and
    /// accelerometer sample.
    fn update_mag(&mut self, field_ut: [f64; 3]) {
        self.filter.update_mag(field_ut);
    }

    /// Store a velocity from the satellite receiver. It takes effect with the next gyro and
    /// accelerometer sample.
    ///
    /// velocity_m_s: velocity (east, north, up), m/s, shape (3,). velocity_sd_m_s: standard
    /// deviation of each component, m/s, if the receiver reports it. age_s: age of the velocity on
    /// arrival, s, if known. latitude_rad: geodetic latitude, rad, north positive, if known.
    #[pyo3(signature = (velocity_m_s, *, velocity_sd_m_s = None, age_s = None, latitude_rad = None))]
    fn update_gnss(
        &mut self,
        velocity_m_s: [f64; 3],
        velocity_sd_m_s: Option<f64>,
        age_s: Option<f64>,
        latitude_rad: Option<f64>,
    ) {
        self.filter.update_gnss(&GnssFix { velocity_m_s, velocity_sd_m_s, age_s, latitude_rad });
    }

    /// Process many samples and return the attitude after each. The GIL is released meanwhile.
    ///
    /// gyro_rad_s: body rates, rad/s, shape (n, 3). accel_m_s2: specific forces, m/s², shape (n,
    /// 3). field_ut: magnetic fields, µT, shape (n, 3). A row of NaN means that there is no sample.
    /// dt_s: time before each sample, s: a number, or shape (n,). t_ns: timestamps in ns, given
    /// instead of dt_s, int64, shape (n,). frame: frame of the results.
    ///
    /// The result equals that of n calls of `update` or `update_at`, bit for bit. Arrays of float64
    /// are not copied. Other threads must not change the arrays during the call.
    ///
    /// With the default fuser, two threads process a batch of 2,000 samples or more. The
    /// angles and the headings of the result are computed on the first access.
    ///
    /// Raises ValueError, without processing any sample, if an array has the wrong shape.
    #[pyo3(signature = (gyro_rad_s, accel_m_s2, field_ut = None, dt_s = None, *, t_ns = None, frame = "enu-rfu"))]
    #[allow(clippy::too_many_arguments, reason = "keyword arguments")]
    fn update_batch<'py>(
        &mut self,
        py: Python<'py>,
        gyro_rad_s: Numbers<'py>,
        accel_m_s2: Numbers<'py>,
        field_ut: Option<Numbers<'py>>,
        dt_s: Option<Numbers<'py>>,
        t_ns: Option<Stamps<'py>>,
        frame: &str,
    ) -> PyResult<Batch> {
        let samples = Samples {
            gyro_rad_s: &gyro_rad_s,
            accel_m_s2: &accel_m_s2,
            field_ut: field_ut.as_ref(),
            dt_s: dt_s.as_ref(),
            t_ns: t_ns.as_ref(),
        };
        batch::update(py, &mut self.filter, &samples, arguments::frame(frame)?)
    }

    /// Newest attitude. Before the first sample it is level and not aligned.
    #[getter]
    fn attitude(&self) -> Attitude {
        Attitude(self.filter.attitude())
    }

    /// Number of rejected samples so far.
    #[getter]
    fn rejected(&self) -> u64 {
        self.filter.rejected()
    }

    /// Name of the fuser stage.
    #[getter]
    fn fuser(&self) -> &'static str {
        use plumbline_ahrs::attitude::stage::Stage as _;
        self.filter.fuser().name()
    }

    /// Start with the sensor errors that another filter has estimated: gyro bias, gyro scale and
    /// hard iron. The attitude of the other filter is not used.
    fn seed_sensor_errors(&mut self, other: &Self) -> PyResult<()> {
        self.filter.seed_sensor_errors(&other.filter.estimate()).map_err(value_error)
    }

    /// Return the whole state as bytes. The arguments of the constructor are not part of it.
    fn snapshot<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        PyBytes::new_with(py, self.filter.snapshot_len(), |buffer| {
            self.filter.save(buffer).map(drop).map_err(value_error)
        })
    }

    /// Continue from a snapshot of a filter with the same stages.
    ///
    /// Raises ValueError if the bytes are not a snapshot of such a filter. The filter is then
    /// unchanged.
    fn restore(&mut self, snapshot: &[u8]) -> PyResult<()> {
        self.filter.restore(snapshot).map_err(value_error)
    }

    /// Return an independent filter with the same arguments and state.
    fn copy(&self) -> Self {
        Self { filter: self.filter.clone() }
    }

    /// Return the names of the stages that can fill a slot: "gyro", "accel", "fuser" or "course".
    /// The first is the default.
    #[staticmethod]
    fn stages(slot: &str) -> PyResult<Vec<&'static str>> {
        Ok(arguments::slot(slot)?.stages().to_vec())
    }

    /// Return the parameters of a stage, by default of the slot's default stage.
    #[staticmethod]
    #[pyo3(signature = (slot, stage = None))]
    fn parameters<'py>(py: Python<'py>, slot: &str, stage: Option<&str>) -> PyResult<Vec<Bound<'py, PyAny>>> {
        let slot = arguments::slot(slot)?;
        let builder = applied(default_builder(), stage, |builder, name| builder.stage(slot, name))?;
        builder.parameters(slot).iter().map(|parameter| values::parameter(py, parameter)).collect()
    }

    fn __repr__(&self) -> String {
        format!("Ahrs(fuser={:?}, tick={})", self.fuser(), self.filter.attitude().tick())
    }
}

/// Returns a builder with the default stages and a fuser type that can hold any stage.
fn default_builder() -> AhrsBuilder<Fuser> {
    AhrsBuilder::new().fuser(Fuser::MultipleModel(MultipleModel::default()))
}

/// Applies an argument to the builder if it is given.
fn applied<T>(
    builder: AhrsBuilder<Fuser>,
    argument: Option<T>,
    apply: impl FnOnce(AhrsBuilder<Fuser>, T) -> Result<AhrsBuilder<Fuser>, plumbline_ahrs::BuildError>,
) -> PyResult<AhrsBuilder<Fuser>> {
    argument.map_or(Ok(builder.clone()), |argument| apply(builder, argument)).map_err(value_error)
}
