//! The accelerometer stages `inclinometer-matrix` and `inclinometer-quaternion`: pitch and roll first, as geonavigation does it.
//!
//! The published axes are X forward, Y right, Z down, and what is read is gravity, so that Z reads +g at rest. In the axes used here
//! (ξ right, η forward, ζ up) and with the specific force f, which is gravity reversed,
//!
//! g_x = −f_η, g_y = −f_ξ, g_z = f_ζ.
//!
//! Pitch β is nose up, roll ψ right side down: ϑ and γ of Matveev 2025, (22).
//!
//! β = atan2(−g_x, √(g_y² + g_z²)), ψ = atan2(g_y, g_z) — Mathematical modelling of geonavigation measuring systems with
//! three-component accelerometers (matrix and quaternion methods).

use super::inclination::{FORCE_MIN_M_S2, Inclination, finite, trust};
use crate::{
    Quaternion, Vector3,
    numbers::Numbers,
    point::Point,
    stage::{RestoreError, Stage, attitude_flaw},
    state::Attitude,
};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Method {
    Matrix,
    Quaternion,
}

/// An accelerometer stage by way of pitch and roll.
///
/// It assumes what the paper assumes: linear characteristics, equal slopes, orthogonal axes; a
/// [`Calibration`](crate::calibration::Calibration) makes a sensor so.
#[derive(Debug, Clone, PartialEq)]
pub struct Inclinometer {
    method: Method,
    up: Point,
}

impl Inclinometer {
    /// `inclinometer-matrix`: the point of the vertical's direction cosines.
    pub fn matrix() -> Self {
        Self { method: Method::Matrix, up: Point::default() }
    }

    /// `inclinometer-quaternion`: the point of the quaternion.
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
                Point::of(Vector3::new(-sin_roll * cos_pitch, sin_pitch, cos_roll * cos_pitch))
            }
            Self::Quaternion => Some(Attitude::of_quaternion(levelling(pitch_rad, roll_rad)).up),
        }
    }
}

/// λ = (cos β/2 cos ψ/2, cos β/2 sin ψ/2, sin β/2 cos ψ/2, −sin β/2 sin ψ/2) about X, Y, Z, here about ξ = Y, η = X, ζ = −Z.
fn levelling(pitch_rad: f64, roll_rad: f64) -> Quaternion<f64> {
    let ((sin_pitch, cos_pitch), (sin_roll, cos_roll)) = (libm::sincos(0.5 * pitch_rad), libm::sincos(0.5 * roll_rad));
    Quaternion::new(cos_pitch * cos_roll, sin_pitch * cos_roll, cos_pitch * sin_roll, sin_pitch * sin_roll)
}

impl Stage for Inclinometer {
    type Input = Vector3<f64>;
    type Output = Inclination;
    /// Where up seemed to be last.
    type Common = Point;

    fn name(&self) -> &'static str {
        match self.method {
            Method::Matrix => "inclinometer-matrix",
            Method::Quaternion => "inclinometer-quaternion",
        }
    }

    fn step(&mut self, force_m_s2: &Vector3<f64>) -> Inclination {
        let force_m_s2 = finite(force_m_s2);
        let norm_m_s2 = force_m_s2.norm().min(f64::MAX);
        let usable = (FORCE_MIN_M_S2..f64::MAX).contains(&norm_m_s2);
        let seen = usable.then(|| self.method.point(force_m_s2)).flatten();
        self.up = seen.unwrap_or(self.up);
        Inclination { up: self.up, force_m_s2, norm_m_s2, trust: trust(norm_m_s2, seen.is_some()) }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.up.visit(visit);
    }

    fn flaw(&self) -> Option<&'static str> {
        attitude_flaw(Attitude::levelled(self.up))
    }

    fn common(&self) -> Point {
        self.up
    }

    fn adopt(&mut self, up: &Point) -> Result<(), RestoreError> {
        Attitude::levelled(*up).checked()?;
        self.up = *up;
        Ok(())
    }
}
