//! Pitch and roll from the direction of gravity, computed by every stage of the accel slot in the
//! axes of S2.
//!
//! In S2, the axes are X forward, Y right and Z along the vertical. A level accelerometer at rest
//! reads +g on Z. The stages use ξ right, η forward and ζ up, hence f_ξ = −gy, f_η = −gx, f_ζ = gz.

use attitude::{GRAVITY_M_S2, Vector3, accel::Accelerometer, stage::Stage, state::wrapped_rad};

/// Number of grid cells in roll.
pub(crate) const COLUMNS: usize = 72;
/// Number of grid cells in pitch.
pub(crate) const ROWS: usize = 36;
/// One thousandth of g, m/s².
const MILLI_G_M_S2: f64 = 1e-3 * GRAVITY_M_S2;

/// Angles β and ψ, or differences between such angles, degrees.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Tilt {
    /// Pitch β.
    pub pitch_deg: f64,
    /// Roll ψ.
    pub roll_deg: f64,
}

impl Tilt {
    fn minus(self, other: Self) -> Self {
        let roll_rad = wrapped_rad((self.roll_deg - other.roll_deg).to_radians());
        Self { pitch_deg: self.pitch_deg - other.pitch_deg, roll_deg: roll_rad.to_degrees() }
    }

    fn max_abs(self, other: Self) -> Self {
        Self {
            pitch_deg: self.pitch_deg.abs().max(other.pitch_deg.abs()),
            roll_deg: self.roll_deg.abs().max(other.roll_deg.abs()),
        }
    }

    /// Returns gravity in the axes of S2: gx = −g sin β, gy = g sin ψ cos β, gz = g cos ψ cos β.
    fn gravity_m_s2(self) -> Vector3<f64> {
        let ((sin_pitch, cos_pitch), (sin_roll, cos_roll)) =
            (self.pitch_deg.to_radians().sin_cos(), self.roll_deg.to_radians().sin_cos());
        Vector3::new(-sin_pitch, sin_roll * cos_pitch, cos_roll * cos_pitch) * GRAVITY_M_S2
    }
}

/// Method of computing the angles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Method {
    Matrix,
    Quaternion,
    Projector,
}

impl Method {
    const ALL: [Self; 3] = [Self::Matrix, Self::Quaternion, Self::Projector];

    fn stage(self) -> &'static str {
        match self {
            Self::Matrix => "inclinometer-matrix",
            Self::Quaternion => "inclinometer-quaternion",
            Self::Projector => "projector",
        }
    }

    /// Returns the angles that the stage computes from gravity; NaN if the stage does not exist.
    fn tilt(self, gravity_m_s2: Vector3<f64>) -> Tilt {
        let force_m_s2 = Vector3::new(-gravity_m_s2.y, -gravity_m_s2.x, gravity_m_s2.z);
        let up = Accelerometer::from_name(self.stage())
            .map_or(Vector3::repeat(f64::NAN), |mut stage| stage.step(&force_m_s2).up.direction());
        let pitch_rad = up.y.atan2(up.x.hypot(up.z));
        Tilt { pitch_deg: pitch_rad.to_degrees(), roll_deg: (-up.x).atan2(up.z).to_degrees() }
    }
}

/// Grid cell: a direction of gravity, given by its true angles, with the estimates of all methods.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cell {
    truth: Tilt,
    estimates: [Tilt; 3],
}

impl Cell {
    pub(crate) fn estimate(&self, method: Method) -> Tilt {
        self.estimates[method as usize]
    }

    /// Returns the angles of the matrix method minus those of the quaternion method.
    pub(crate) fn method_difference(&self) -> Tilt {
        self.estimate(Method::Matrix).minus(self.estimate(Method::Quaternion))
    }
}

/// Returns the cells of the sphere, row by row from β = −90°. Each is evaluated at its centre.
pub(crate) fn sphere_cells() -> Vec<Cell> {
    let cell = |index: usize| {
        let middle = |index: usize, count: usize, range: f64| ((index as f64 + 0.5) / count as f64 - 0.5) * range;
        let truth =
            Tilt { pitch_deg: middle(index / COLUMNS, ROWS, 180.0), roll_deg: middle(index % COLUMNS, COLUMNS, 360.0) };
        Cell { truth, estimates: Method::ALL.map(|method| method.tilt(truth.gravity_m_s2())) }
    };
    (0..COLUMNS * ROWS).map(cell).collect()
}

/// Returns the errors of pitch and roll near the singularity, for ψ = 0 and an error of 1 mg in gy.
///
/// Each entry consists of a true pitch β, from 80° to just below 90°, and the errors at this pitch.
pub(crate) fn errors_near_singularity(method: Method) -> Vec<(f64, Tilt)> {
    let at = |step: i32| {
        let truth = Tilt { pitch_deg: 80.0 + f64::from(step) * 0.02, roll_deg: 0.0 };
        let estimate = method.tilt(truth.gravity_m_s2() + Vector3::new(0.0, MILLI_G_M_S2, 0.0));
        (truth.pitch_deg, estimate.minus(truth))
    };
    (0..500).map(at).collect()
}

/// Returns the sensitivities dβ/dgx and dψ/dgy in degrees per thousandth of g, computed by central
/// differences.
pub(crate) fn sensitivity(pitch_deg: f64, roll_deg: f64) -> (f64, f64) {
    let step_m_s2 = 1e-3 * MILLI_G_M_S2;
    let gravity_m_s2 = Tilt { pitch_deg, roll_deg }.gravity_m_s2();
    let difference_along = |axis: Vector3<f64>| {
        let [plus, minus] = [1.0, -1.0].map(|sign| Method::Matrix.tilt(gravity_m_s2 + axis * (sign * step_m_s2)));
        plus.minus(minus)
    };
    let scale = MILLI_G_M_S2 / (2.0 * step_m_s2);
    (difference_along(Vector3::x()).pitch_deg * scale, difference_along(Vector3::y()).roll_deg * scale)
}

/// Largest errors and differences over the sphere.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Results {
    /// Largest error of the matrix method.
    pub matrix: Tilt,
    /// Largest error of the quaternion method.
    pub quaternion: Tilt,
    /// Largest error of the method of S1, a projection (stage `projector`).
    pub projector: Tilt,
    /// Largest difference between the matrix and the quaternion method.
    pub matrix_vs_quaternion: Tilt,
}

impl Results {
    pub(crate) fn new(cells: &[Cell]) -> Self {
        let largest =
            |difference: &dyn Fn(&Cell) -> Tilt| cells.iter().map(difference).fold(Tilt::default(), Tilt::max_abs);
        let error_of = |method: Method| largest(&move |cell: &Cell| cell.estimate(method).minus(cell.truth));
        Self {
            matrix: error_of(Method::Matrix),
            quaternion: error_of(Method::Quaternion),
            projector: error_of(Method::Projector),
            matrix_vs_quaternion: largest(&Cell::method_difference),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn methods_return_true_angles_within_rounding() {
        let results = Results::new(&sphere_cells());
        println!("{results:?}");
        for largest in [results.matrix, results.quaternion, results.projector, results.matrix_vs_quaternion] {
            assert!(largest.pitch_deg < 1e-12 && largest.roll_deg < 1e-11, "{largest:?}");
        }
    }

    #[test]
    fn sensitivities_match_equations() {
        for (pitch_deg, roll_deg) in [(0.0, 0.0), (30.0, 45.0), (-60.0, 75.0), (85.0, 0.0)] {
            let (pitch, roll) = sensitivity(pitch_deg, roll_deg);
            let cos = pitch_deg.to_radians().cos();
            let (want_pitch, want_roll) = (-cos * 1e-3, 1e-3 * roll_deg.to_radians().cos() / cos);
            assert!((pitch - want_pitch.to_degrees()).abs() < 1e-6, "{pitch_deg}°: {pitch}");
            assert!((roll - want_roll.to_degrees()).abs() < 1e-5, "{pitch_deg}°: {roll}");
        }
    }

    #[test]
    fn roll_error_diverges_near_singularity_pitch_stays() {
        for method in [Method::Matrix, Method::Quaternion] {
            let errors = errors_near_singularity(method);
            let (at_deg, last) = errors[errors.len() - 1];
            assert!(at_deg > 89.9 && last.roll_deg.abs() > 60.0, "{method:?}: {last:?} at {at_deg}°");
            assert!(errors.iter().all(|(_, error)| error.pitch_deg.abs() < 0.06), "{method:?}");
        }
    }
}
