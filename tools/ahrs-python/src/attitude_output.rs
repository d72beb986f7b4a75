//! Attitude as a Python object.

use plumbline_ahrs::CourseReference;
use pyo3::{prelude::*, types::PyAny};

use crate::{arguments::frame, values};

/// Attitude after a sample, with heading, gyro bias, standard deviations and flags.
///
/// Values without a frame are in the frame of Plumbline: reference axes east, north, up and body
/// axes right, forward, up ("enu-rfu"). The other frames are "enu-flu" (ROS), "nwu-flu" and
/// "ned-frd" (PX4, ArduPilot).
#[pyclass(frozen, eq, from_py_object, module = "plumbline_ahrs")]
#[derive(Clone, PartialEq)]
pub(crate) struct Attitude(pub(crate) plumbline_ahrs::Attitude);

#[pymethods]
impl Attitude {
    /// Unit quaternion from body to reference axes, w x y z: v_ref = q v_body q*.
    ///
    /// The sign is chosen such that successive quaternions are close to each other.
    #[getter]
    fn quaternion(&self) -> (f64, f64, f64, f64) {
        self.0.quaternion().into()
    }

    /// Return the unit quaternion from body to reference axes of a frame, w x y z.
    fn quaternion_in(&self, frame: &str) -> PyResult<(f64, f64, f64, f64)> {
        Ok(self.0.quaternion_in(self::frame(frame)?).into())
    }

    /// Yaw (counter-clockwise from above), pitch (nose up) and roll (right side down), rad.
    #[getter]
    fn angles<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        values::angles(py, self.0.angles())
    }

    /// Return yaw, pitch and roll by the conventions of a frame, rad.
    fn angles_in<'py>(&self, py: Python<'py>, frame: &str) -> PyResult<Bound<'py, PyAny>> {
        values::angles(py, self.0.angles_in(self::frame(frame)?))
    }

    /// Heading, rad, clockwise from above, [0, 2π). It is zero in the direction
    /// `heading_reference`.
    #[getter]
    fn heading_rad(&self) -> f64 {
        self.0.heading_rad()
    }

    /// Direction in which the heading is zero: "magnetic", "true", or "arbitrary" if no sensor
    /// observes north.
    #[getter]
    fn heading_reference(&self) -> &'static str {
        match self.0.heading_reference() {
            CourseReference::Arbitrary => "arbitrary",
            CourseReference::Magnetic => "magnetic",
            CourseReference::True => "true",
        }
    }

    /// Standard deviation of the heading, rad; π if the heading is unknown.
    #[getter]
    fn heading_sd_rad(&self) -> f64 {
        self.0.heading_sd_rad()
    }

    /// Declination that the heading includes, rad, east positive.
    #[getter]
    fn declination_rad(&self) -> f64 {
        self.0.declination_rad()
    }

    /// Standard deviation of the inclination, rad.
    #[getter]
    fn inclination_sd_rad(&self) -> f64 {
        self.0.inclination_sd_rad()
    }

    /// Body rate in body axes with the bias removed, rad/s.
    #[getter]
    fn rate_rad_s(&self) -> (f64, f64, f64) {
        self.0.rate_rad_s().into()
    }

    /// Return the body rate in the body axes of a frame with the bias removed, rad/s.
    fn rate_rad_s_in(&self, frame: &str) -> PyResult<(f64, f64, f64)> {
        Ok(self.0.rate_rad_s_in(self::frame(frame)?).into())
    }

    /// Estimated gyro bias in body axes, rad/s; zero if the stage does not estimate it.
    #[getter]
    fn gyro_bias_rad_s(&self) -> (f64, f64, f64) {
        self.0.gyro_bias_rad_s().into()
    }

    /// Return the estimated gyro bias in the body axes of a frame, rad/s.
    fn gyro_bias_rad_s_in(&self, frame: &str) -> PyResult<(f64, f64, f64)> {
        Ok(self.0.gyro_bias_rad_s_in(self::frame(frame)?).into())
    }

    /// Angle between the up directions of accelerometer and attitude, rad.
    #[getter]
    fn innovation_rad(&self) -> f64 {
        self.0.innovation_rad()
    }

    /// Faults and events of the sample.
    #[getter]
    fn flags<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        values::flags(py, self.0.flags())
    }

    /// True once a force has aligned the attitude. Before that, it is arbitrary.
    #[getter]
    fn is_aligned(&self) -> bool {
        self.0.is_aligned()
    }

    /// Number of jumps of the attitude or the heading since the first alignment.
    #[getter]
    fn reset_counter(&self) -> u64 {
        self.0.reset_counter()
    }

    /// Newest jump of the attitude as a quaternion w x y z in body axes. It is the rotation from
    /// the expected to the new attitude.
    #[getter]
    fn jump(&self) -> (f64, f64, f64, f64) {
        self.0.jump().into()
    }

    /// Number of accepted samples before this one.
    #[getter]
    fn tick(&self) -> u64 {
        self.0.tick()
    }

    /// Time of the attitude, ns: the sample timestamp, corrected for jumps of the sensor clock.
    #[getter]
    fn t_ns(&self) -> i64 {
        self.0.t_ns()
    }

    fn __repr__(&self) -> String {
        let [w, x, y, z] = self.0.quaternion();
        format!(
            "Attitude(tick={}, quaternion=({w:.6}, {x:.6}, {y:.6}, {z:.6}), heading_deg={:.2}, is_aligned={})",
            self.0.tick(),
            self.0.heading_rad().to_degrees(),
            if self.0.is_aligned() { "True" } else { "False" },
        )
    }
}
