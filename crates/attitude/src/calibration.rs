//! What stands between a raw reading and the body axes: the sensor's calibration, then how it is mounted.
//!
//! Input: a reading of a three-axis sensor (rate, force or field) in the sensor's own axes and units. Output: the vector in body axes
//! (ξ right, η forward, ζ up). Time: none. Failure: what is no calibration or no rotation is refused when it is made.
//!
//! The order is fixed: `body = mounting.apply(calibration.apply(raw))`. A calibration belongs to the sensor and moves with it, a
//! mounting belongs to the vehicle; a bias is therefore in raw axes and raw units.

use core::fmt;

use nalgebra::{Rotation3, UnitQuaternion};

use crate::{Matrix3, Quaternion, Vector3, angles::Angles, state::Attitude};

/// Farthest that a given rotation may be from a rotation, element by element of M Mᵀ: numbers given to three decimals are taken.
const ROTATION_TOLERANCE: f64 = 2e-3;

/// Least volume that the rows of a calibration, each made of unit length, must span.
const VOLUME_MIN: f64 = 1e-3;

/// Bias, scale and misalignment of one three-axis sensor: out = M (raw − bias).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calibration {
    bias: Vector3<f64>,
    matrix: Matrix3<f64>,
}

impl Default for Calibration {
    /// That of an ideal sensor: out = raw.
    fn default() -> Self {
        Self { bias: Vector3::zeros(), matrix: Matrix3::identity() }
    }
}

impl Calibration {
    /// From the full matrix M, in SI units per raw unit (µT for a magnetometer), and the bias in raw units.
    ///
    /// For a magnetometer the bias is the hard iron and M undoes the soft iron.
    pub fn new(bias: Vector3<f64>, matrix: Matrix3<f64>) -> Result<Self, CalibrationError> {
        if !bias.iter().chain(&matrix).all(|x| x.is_finite()) {
            return Err(CalibrationError::NotFinite);
        }
        let row = |i: usize| matrix.row(i).transpose().normalize();
        let volume = libm::fabs(row(0).cross(&row(1)).dot(&row(2)));
        // Written so that a row of zeros, whose direction is not a number, is refused too.
        if volume >= VOLUME_MIN { Ok(Self { bias, matrix }) } else { Err(CalibrationError::Singular) }
    }

    /// From a data sheet's parts: M = misalignment · diag(scale).
    ///
    /// `scale` is SI units per raw unit on each raw axis, 1 for a sensor that gives SI units. `misalignment` turns what the scaled
    /// axes read into an orthogonal frame: the inverse of the matrix whose rows are the directions of the sensor's axes.
    pub fn of_parts(
        bias: Vector3<f64>,
        scale: Vector3<f64>,
        misalignment: Matrix3<f64>,
    ) -> Result<Self, CalibrationError> {
        Self::new(bias, misalignment * Matrix3::from_diagonal(&scale))
    }

    /// The reading as an exact sensor in the same place would give it, in the sensor's axes.
    pub fn apply(&self, raw: Vector3<f64>) -> Vector3<f64> {
        self.matrix * (raw - self.bias)
    }
}

/// How a sensor sits in the body: the rotation sensor → body, v_body = M v_sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mounting {
    matrix: Matrix3<f64>,
}

impl Default for Mounting {
    /// `x-right-y-forward`: the sensor's axes are the body's.
    fn default() -> Self {
        Self { matrix: Matrix3::identity() }
    }
}

impl Mounting {
    /// The names of directions of the body.
    pub const DIRECTIONS: [&str; 6] = ["right", "left", "forward", "back", "up", "down"];
    /// The short names, and what they are short for.
    pub const SHORT_NAMES: [(&str, &str); 3] =
        [("rfu", "x-right-y-forward"), ("flu", "x-forward-y-left"), ("frd", "x-forward-y-right")];

    /// By the directions in which the sensor's x and y axes point in the body: `x-right-y-forward`, `x-forward-y-left`,
    /// `x-down-y-back`.
    ///
    /// The directions are right, left, forward, back, up and down; z completes the right-handed frame. There are 24 names. Three of them
    /// have a short one, by the directions of x, y and z: `rfu` (ours), `flu` (ROS), `frd` (PX4, MAVLink).
    pub fn named(name: &str) -> Result<Self, CalibrationError> {
        let name = Self::SHORT_NAMES.iter().find(|(short, _)| *short == name).map_or(name, |(_, long)| long);
        let directions = name.strip_prefix("x-").and_then(|rest| rest.split_once("-y-"));
        let axes = directions.and_then(|(x, y)| Some((direction(x)?, direction(y)?)));
        let (x, y) = axes.filter(|(x, y)| x.dot(y) == 0.0).ok_or(CalibrationError::Name)?;
        Ok(Self { matrix: Matrix3::from_columns(&[x, y, x.cross(&y)]) })
    }

    /// By the attitude of the sensor in the body: from the body axes turned by yaw about ζ, then pitch about ξ, then roll about η.
    ///
    /// A sensor with its x axis to the right has yaw 0; yaw is counter-clockwise from above, pitch raises its y axis, roll lowers
    /// its x axis. M = A(ψ, ϑ, γ)ᵀ — Matveev 2025, (22).
    pub fn of_angles(angles: Angles) -> Result<Self, CalibrationError> {
        let Angles { yaw_rad, pitch_rad, roll_rad } = angles;
        if ![yaw_rad, pitch_rad, roll_rad].iter().all(|x| x.is_finite()) {
            return Err(CalibrationError::NotFinite);
        }
        Ok(Self { matrix: Attitude::of_angles(angles).matrix().transpose() })
    }

    /// By the unit quaternion sensor → body, v_body = q v_sensor q*.
    pub fn of_quaternion(q: Quaternion<f64>) -> Result<Self, CalibrationError> {
        let length = q.norm();
        if !length.is_finite() {
            return Err(CalibrationError::NotFinite);
        }
        if libm::fabs(length - 1.0) > 0.5 * ROTATION_TOLERANCE {
            return Err(CalibrationError::Length { length });
        }
        Ok(Self { matrix: Attitude::of_quaternion(q).matrix().transpose() })
    }

    /// By the matrix, v_body = M v_sensor: its columns are the sensor's axes in the body.
    pub fn of_matrix(matrix: Matrix3<f64>) -> Result<Self, CalibrationError> {
        if !matrix.iter().all(|x| x.is_finite()) {
            return Err(CalibrationError::NotFinite);
        }
        let off = (matrix * matrix.transpose() - Matrix3::identity()).amax();
        let determinant = matrix.determinant();
        if !(0.0..=ROTATION_TOLERANCE).contains(&off) || determinant < 0.0 {
            return Err(CalibrationError::NotARotation { off, determinant });
        }
        Ok(Self { matrix: orthogonal(matrix) })
    }

    /// The rotation, v_body = M v_sensor.
    pub fn matrix(&self) -> &Matrix3<f64> {
        &self.matrix
    }

    /// A vector of the sensor's axes in body axes.
    pub fn apply(&self, sensor: Vector3<f64>) -> Vector3<f64> {
        self.matrix * sensor
    }

    /// The attitude of the body, where `sensor` is that of the sensor: both as unit quaternions, axes → reference.
    ///
    /// v_ref = q v_sensor q* and v_body = M v_sensor, so q_body = q m*, with m the quaternion of M.
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

/// The rotation next to a matrix that is one up to its last decimals: M ← M (3 − MᵀM)/2, which doubles the right digits.
fn orthogonal(matrix: Matrix3<f64>) -> Matrix3<f64> {
    (0..4).fold(matrix, |m, _| m * (Matrix3::identity() * 3.0 - m.transpose() * m) * 0.5)
}

/// A direction of the body by its name.
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

/// Why a calibration or a mounting was refused.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CalibrationError {
    /// A number is infinite or not a number.
    NotFinite,
    /// The matrix loses a direction.
    Singular,
    /// The name is none of the 24.
    Name,
    /// A quaternion that is not of unit length.
    Length {
        /// Its length.
        length: f64,
    },
    /// A matrix that is not orthogonal, or that mirrors.
    NotARotation {
        /// Largest element of M Mᵀ − 1.
        off: f64,
        /// +1 for a rotation, −1 for a mirror.
        determinant: f64,
    },
}

impl fmt::Display for CalibrationError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite => write!(f, "a number that is not finite"),
            Self::Singular => write!(f, "the calibration matrix loses a direction: its rows must be independent"),
            Self::Name => write!(
                f,
                "expected x-DIRECTION-y-DIRECTION, two directions at right angles of right, left, forward, back, up, down; \
                 for example x-right-y-forward; or rfu, flu or frd, in short"
            ),
            Self::Length { length } => {
                write!(f, "expected a unit quaternion (w, x, y, z), found one of length {length}")
            }
            Self::NotARotation { off, determinant } if *determinant < 0.0 && *off <= ROTATION_TOLERANCE => {
                write!(f, "expected a rotation, found a mirror (determinant −1); check the sign of one axis")
            }
            Self::NotARotation { off, .. } => {
                write!(
                    f,
                    "expected a rotation, found a matrix that is off by {off:.3} from orthogonal columns of length 1"
                )
            }
        }
    }
}

impl core::error::Error for CalibrationError {}
