//! Accelerometer stages `inclinometer-matrix` and `inclinometer-quaternion`, which derive the up
//! direction from pitch and roll.
//!
//! The method comes from geonavigation. The paper's axes are X forward, Y right, Z down, and its
//! sensor measures gravity, so Z reads +g at rest. In the axes of this crate (ξ right, η forward, ζ
//! up) and with the specific force f, which is opposite to gravity,
//!
//! g_x = −f_η, g_y = −f_ξ, g_z = f_ζ.
//!
//! Pitch β is positive nose up and roll ψ positive right side down. They are ϑ and γ of Matveev
//! 2025, (22).
//!
//! β = atan2(−g_x, √(g_y² + g_z²)), ψ = atan2(g_y, g_z) — Mathematical modelling of geonavigation
//! measuring systems with three-component accelerometers (matrix and quaternion methods).

use super::inclination::{Inclination, MIN_FORCE_M_S2, finite_or_zero, trust};
use crate::{
    Quaternion, Vector3,
    point::Point,
    scalars::visit_fields,
    stage::{RestoreError, Stage, attitude_validation_error},
    state::Attitude,
};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Method {
    Matrix,
    Quaternion,
}

/// Accelerometer stage that computes pitch and roll.
///
/// Like the paper, it assumes linear characteristics, equal slopes and orthogonal axes, which a
/// [`Calibration`](crate::calibration::Calibration) provides.
#[derive(Debug, Clone, PartialEq)]
pub struct Inclinometer {
    method: Method,
    up: Point,
}

impl Inclinometer {
    /// Creates `inclinometer-matrix`, which projects the direction cosines of the vertical.
    pub fn matrix() -> Self {
        Self { method: Method::Matrix, up: Point::default() }
    }

    /// Creates `inclinometer-quaternion`, which uses the up vector of the quaternion.
    pub fn quaternion() -> Self {
        Self { method: Method::Quaternion, up: Point::default() }
    }
}

impl Method {
    fn point(self, force_m_s2: Vector3<f64>) -> Option<Point> {
        let (gx, gy, gz) = (-force_m_s2.y, -force_m_s2.x, force_m_s2.z);
        let pitch_rad = libm::atan2(-gx, libm::hypot(gy, gz));
        let roll_rad = libm::atan2(gy, gz);
        match self {
            Self::Matrix => {
                let ((sin_pitch, cos_pitch), (sin_roll, cos_roll)) = (libm::sincos(pitch_rad), libm::sincos(roll_rad));
                Point::from_direction(Vector3::new(-sin_roll * cos_pitch, sin_pitch, cos_roll * cos_pitch))
            }
            Self::Quaternion => Some(Attitude::from_quaternion(tilt_quaternion(pitch_rad, roll_rad)).up),
        }
    }
}

/// Returns the quaternion of pitch and roll.
///
/// λ = (cos β/2 cos ψ/2, cos β/2 sin ψ/2, sin β/2 cos ψ/2, −sin β/2 sin ψ/2) about X, Y, Z, which
/// here are η, ξ and −ζ.
fn tilt_quaternion(pitch_rad: f64, roll_rad: f64) -> Quaternion<f64> {
    let ((sin_pitch, cos_pitch), (sin_roll, cos_roll)) = (libm::sincos(0.5 * pitch_rad), libm::sincos(0.5 * roll_rad));
    Quaternion::new(cos_pitch * cos_roll, sin_pitch * cos_roll, cos_pitch * sin_roll, sin_pitch * sin_roll)
}

impl Stage for Inclinometer {
    type Input = Vector3<f64>;
    type Output = Inclination;
    /// Latest measured up direction.
    type Common = Point;

    fn name(&self) -> &'static str {
        match self.method {
            Method::Matrix => "inclinometer-matrix",
            Method::Quaternion => "inclinometer-quaternion",
        }
    }

    fn step(&mut self, force_m_s2: &Vector3<f64>) -> Inclination {
        let force_m_s2 = finite_or_zero(force_m_s2);
        let norm_m_s2 = force_m_s2.norm().min(f64::MAX);
        let usable = (MIN_FORCE_M_S2..f64::MAX).contains(&norm_m_s2);
        let point = usable.then(|| self.method.point(force_m_s2)).flatten();
        self.up = point.unwrap_or(self.up);
        Inclination { up: self.up, force_m_s2, norm_m_s2, trust: trust(norm_m_s2, point.is_some()) }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        visit_fields!(self, visit: up; without method);
    }

    fn validation_error(&self) -> Option<&'static str> {
        attitude_validation_error(Attitude::from_up(self.up))
    }

    fn common(&self) -> Point {
        self.up
    }

    fn adopt(&mut self, up: &Point) -> Result<(), RestoreError> {
        Attitude::from_up(*up).validate()?;
        self.up = *up;
        Ok(())
    }
}
