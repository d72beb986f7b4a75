//! Conversion of raw readings to body axes: the calibration of the sensor, then its mounting.
//!
//! Input: a reading of a three-axis sensor (angular rate, specific force or magnetic field) in the
//! sensor's own axes and units.
//!
//! Output: the vector in body axes (ξ right, η forward, ζ up).
//!
//! Failure: an invalid calibration or mounting is rejected on construction.
//!
//! The order is fixed: `body = mounting.apply(calibration.apply(raw))`. A calibration belongs to
//! the sensor and moves with it; a mounting belongs to the vehicle. A bias is therefore in raw axes
//! and raw units.

use core::fmt;

use nalgebra::{Rotation3, UnitQuaternion};

use crate::{Matrix3, Quaternion, Vector3, angles::Angles, frames::Body, state::Attitude};

/// Maximum deviation of any element of M Mᵀ from the identity matrix, for a mounting with the
/// matrix M. The limit admits rotations given to three decimals.
const ROTATION_TOLERANCE: f64 = 2e-3;

/// Minimum volume spanned by the normalised rows of a calibration matrix. Below it, the rows count
/// as dependent.
const MIN_VOLUME: f64 = 1e-3;

/// Bias, scale and misalignment of one three-axis sensor: out = M (raw − bias).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calibration {
    bias: Vector3<f64>,
    matrix: Matrix3<f64>,
}

impl Default for Calibration {
    /// Returns the calibration of an ideal sensor: out = raw.
    fn default() -> Self {
        Self { bias: Vector3::zeros(), matrix: Matrix3::identity() }
    }
}

impl Calibration {
    /// Creates a calibration from the full matrix M and the bias in raw units.
    ///
    /// M is in SI units per raw unit (µT for a magnetometer). For a magnetometer the bias is the
    /// hard iron and M compensates the soft iron.
    ///
    /// # Errors
    ///
    /// Returns an error if a number is not finite or the rows of the matrix are not independent.
    pub fn new(bias: Vector3<f64>, matrix: Matrix3<f64>) -> Result<Self, CalibrationError> {
        if !bias.iter().chain(&matrix).all(|x| x.is_finite()) {
            return Err(CalibrationError::NotFinite);
        }
        let row = |i: usize| matrix.row(i).transpose().normalize();
        let volume = libm::fabs(row(0).cross(&row(1)).dot(&row(2)));
        // A row of zeros makes `volume` NaN. This form of the comparison also rejects NaN.
        if volume >= MIN_VOLUME { Ok(Self { bias, matrix }) } else { Err(CalibrationError::Singular) }
    }

    /// Creates a calibration from data-sheet values: M = misalignment · diag(scale).
    ///
    /// `scale` is in SI units per raw unit on each raw axis, 1 for a sensor with SI output.
    /// `misalignment` converts the scaled axes to an orthogonal frame. It is the inverse of the
    /// matrix whose rows are the directions of the sensor's axes.
    ///
    /// # Errors
    ///
    /// Returns an error if a number is not finite or the rows of M are not independent.
    pub fn from_parts(
        bias: Vector3<f64>,
        scale: Vector3<f64>,
        misalignment: Matrix3<f64>,
    ) -> Result<Self, CalibrationError> {
        Self::new(bias, misalignment * Matrix3::from_diagonal(&scale))
    }

    /// Returns the length of each row of the matrix, which is the factor from raw units to SI
    /// units.
    pub fn row_lengths(&self) -> [f64; 3] {
        core::array::from_fn(|row| self.matrix.row(row).norm())
    }

    /// Returns the calibrated reading in the sensor's axes.
    pub fn apply(&self, raw: Vector3<f64>) -> Vector3<f64> {
        self.matrix * (raw - self.bias)
    }
}

/// Orientation of a sensor in the body: the rotation sensor → body, v_body = M v_sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mounting {
    matrix: Matrix3<f64>,
}

impl Default for Mounting {
    /// Returns `x-right-y-forward`, the mounting of a sensor with axes parallel to those of the
    /// body.
    fn default() -> Self {
        Self { matrix: Matrix3::identity() }
    }
}

impl Mounting {
    /// Names of the body directions that can occur in the name of a mounting.
    pub const DIRECTIONS: [&str; 6] = ["right", "left", "forward", "back", "up", "down"];
    /// Short names and the full names that they stand for.
    pub const SHORT_NAMES: [(&str, &str); 3] =
        [("rfu", "x-right-y-forward"), ("flu", "x-forward-y-left"), ("frd", "x-forward-y-right")];

    /// Creates a mounting from the body directions of the sensor's x and y axes, such as
    /// `x-forward-y-left`.
    ///
    /// The directions are right, left, forward, back, up and down; z completes the right-handed
    /// frame. There are 24 names. Three of them also have a short form made of the initials of the
    /// directions of x, y and z: `rfu` (native), `flu` (ROS), `frd` (PX4, MAVLink).
    ///
    /// # Errors
    ///
    /// Returns [`CalibrationError::UnknownName`] for any other name.
    pub fn from_name(name: &str) -> Result<Self, CalibrationError> {
        let name = Self::SHORT_NAMES.iter().find(|(short, _)| *short == name).map_or(name, |(_, long)| long);
        let directions = name.strip_prefix("x-").and_then(|rest| rest.split_once("-y-"));
        let axes = directions.and_then(|(x, y)| Some((direction(x)?, direction(y)?)));
        let (x, y) = axes.filter(|(x, y)| x.dot(y) == 0.0).ok_or(CalibrationError::UnknownName)?;
        Ok(Self { matrix: Matrix3::from_columns(&[x, y, x.cross(&y)]) })
    }

    /// Creates the mounting of a sensor with the given axes.
    pub fn from_axes(axes: Body) -> Self {
        let column = |axis: Vector3<f64>| axes.to_native(axis.into()).into();
        Self { matrix: Matrix3::from_columns(&[Vector3::x(), Vector3::y(), Vector3::z()].map(column)) }
    }

    /// Creates a mounting from the attitude of the sensor in the body.
    ///
    /// The sensor's axes are obtained from the body axes by a yaw rotation about ζ, then a pitch
    /// rotation about ξ, then a roll rotation about η. A sensor whose x axis points to the right
    /// has yaw 0. Yaw is counter-clockwise from above, pitch raises the sensor's y axis, roll
    /// lowers its x axis. M = A(ψ, ϑ, γ)ᵀ — Matveev 2025, (22).
    ///
    /// # Errors
    ///
    /// Returns [`CalibrationError::NotFinite`] if an angle is not finite.
    pub fn from_angles(angles: Angles) -> Result<Self, CalibrationError> {
        let Angles { yaw_rad, pitch_rad, roll_rad } = angles;
        if ![yaw_rad, pitch_rad, roll_rad].iter().all(|x| x.is_finite()) {
            return Err(CalibrationError::NotFinite);
        }
        Ok(Self { matrix: Attitude::from_angles(angles).matrix().transpose() })
    }

    /// Creates a mounting from the unit quaternion sensor → body, v_body = q v_sensor q*.
    ///
    /// # Errors
    ///
    /// Returns an error if a component is not finite or the length is not 1.
    pub fn from_quaternion(q: Quaternion<f64>) -> Result<Self, CalibrationError> {
        let length = q.norm();
        if !length.is_finite() {
            return Err(CalibrationError::NotFinite);
        }
        if libm::fabs(length - 1.0) > 0.5 * ROTATION_TOLERANCE {
            return Err(CalibrationError::NotUnitLength { length });
        }
        Ok(Self { matrix: Attitude::from_quaternion(q).matrix().transpose() })
    }

    /// Creates a mounting from the matrix M, v_body = M v_sensor. The columns of M are the
    /// directions of the sensor's axes in body axes.
    ///
    /// # Errors
    ///
    /// Returns an error if an element is not finite or the matrix is not a rotation.
    pub fn from_matrix(matrix: Matrix3<f64>) -> Result<Self, CalibrationError> {
        if !matrix.iter().all(|x| x.is_finite()) {
            return Err(CalibrationError::NotFinite);
        }
        let deviation = (matrix * matrix.transpose() - Matrix3::identity()).amax();
        let determinant = matrix.determinant();
        if !(0.0..=ROTATION_TOLERANCE).contains(&deviation) || determinant < 0.0 {
            return Err(CalibrationError::NotARotation { deviation, determinant });
        }
        Ok(Self { matrix: orthogonalised(matrix) })
    }

    /// Returns the rotation matrix, v_body = M v_sensor.
    pub fn matrix(&self) -> &Matrix3<f64> {
        &self.matrix
    }

    /// Rotates a vector from the sensor's axes to body axes.
    pub fn apply(&self, sensor: Vector3<f64>) -> Vector3<f64> {
        self.matrix * sensor
    }

    /// Returns the attitude of the body for a given attitude of the sensor.
    ///
    /// The sensor's attitude is a unit quaternion sensor → reference, and the result is a unit
    /// quaternion body → reference.
    ///
    /// Because v_ref = q v_sensor q* and v_body = M v_sensor, q_body = q m*, with m the quaternion
    /// of M.
    pub fn attitude(&self, sensor: Quaternion<f64>) -> Quaternion<f64> {
        if self.matrix == Matrix3::identity() {
            return sensor;
        }
        sensor
            * UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(self.matrix))
                .conjugate()
                .into_inner()
    }
}

/// Returns the rotation nearest to a rotation matrix with rounded elements.
///
/// M ← M (3 − MᵀM)/2 doubles the number of correct digits in each iteration.
fn orthogonalised(matrix: Matrix3<f64>) -> Matrix3<f64> {
    (0..4).fold(matrix, |m, _| m * (Matrix3::identity() * 3.0 - m.transpose() * m) * 0.5)
}

/// Returns the unit vector of a named direction of the body.
fn direction(name: &str) -> Option<Vector3<f64>> {
    Some(match name {
        "right" => Vector3::x(),
        "left" => -Vector3::x(),
        "forward" => Vector3::y(),
        "back" => -Vector3::y(),
        "up" => Vector3::z(),
        "down" => -Vector3::z(),
        _ => return None,
    })
}

/// Error in a calibration or a mounting.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CalibrationError {
    /// A number is infinite or NaN.
    NotFinite,
    /// The rows of the calibration matrix are not independent.
    Singular,
    /// The axis name is unknown.
    UnknownName,
    /// The quaternion does not have unit length.
    NotUnitLength {
        /// Length of the quaternion.
        length: f64,
    },
    /// The matrix is not orthogonal or contains a reflection.
    NotARotation {
        /// Largest absolute element of M Mᵀ − 1, with M the rejected matrix.
        deviation: f64,
        /// Determinant: +1 for a rotation, −1 for a reflection.
        determinant: f64,
    },
}

impl fmt::Display for CalibrationError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite => write!(f, "a number is not finite"),
            Self::Singular => write!(f, "the calibration matrix is singular: its rows must be independent"),
            Self::UnknownName => write!(
                f,
                "expected x-DIRECTION-y-DIRECTION, two directions at right angles of right, left, forward, back, up, down; \
                 for example x-right-y-forward; or the short form rfu, flu or frd"
            ),
            Self::NotUnitLength { length } => {
                write!(f, "expected a unit quaternion (w, x, y, z), found one of length {length}")
            }
            Self::NotARotation { deviation, determinant } if *determinant < 0.0 && *deviation <= ROTATION_TOLERANCE => {
                write!(f, "expected a rotation, found a reflection (determinant −1); check the sign of one axis")
            }
            Self::NotARotation { deviation, .. } => {
                write!(
                    f,
                    "expected a rotation, found a matrix that deviates by {deviation:.3} from orthogonal columns of length 1"
                )
            }
        }
    }
}

impl core::error::Error for CalibrationError {}
