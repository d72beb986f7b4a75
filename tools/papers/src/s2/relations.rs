//! Pitch and roll from a direction of gravity, by every stage of the slot accel, in S2's own axes.
//!
//! S2's axes are X forward, Y to the right, Z along the vertical that the accelerometer reads as +g; here ξ is right, η forward, ζ up,
//! and f_ξ = −gy, f_η = −gx, f_ζ = gz.

use attitude::{GRAVITY_M_S2, Vector3, accel::Accelerometer, stage::Stage, state::wrapped_rad};

/// Cells of the sphere, each by its middle.
pub(crate) const COLUMNS: usize = 72;
pub(crate) const ROWS: usize = 36;
/// g, m/s², of a thousandth.
const MILLI_G_M_S2: f64 = 1e-3 * GRAVITY_M_S2;

/// β and ψ, or differences of them, degrees.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Tilt {
    /// β, pitch.
    pub pitch_deg: f64,
    /// ψ, roll.
    pub roll_deg: f64,
}

impl Tilt {
    fn less(self, other: Self) -> Self {
        let roll_rad = wrapped_rad((self.roll_deg - other.roll_deg).to_radians());
        Self { pitch_deg: self.pitch_deg - other.pitch_deg, roll_deg: roll_rad.to_degrees() }
    }

    fn larger(self, other: Self) -> Self {
        Self {
            pitch_deg: self.pitch_deg.abs().max(other.pitch_deg.abs()),
            roll_deg: self.roll_deg.abs().max(other.roll_deg.abs()),
        }
    }

    /// gx = −g sin β, gy = g sin ψ cos β, gz = g cos ψ cos β.
    fn gravity_m_s2(self) -> Vector3<f64> {
        let ((sin_pitch, cos_pitch), (sin_roll, cos_roll)) =
            (self.pitch_deg.to_radians().sin_cos(), self.roll_deg.to_radians().sin_cos());
        Vector3::new(-sin_pitch, sin_roll * cos_pitch, cos_roll * cos_pitch) * GRAVITY_M_S2
    }
}

/// By which stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Way {
    Matrix,
    Quaternion,
    Projector,
}

impl Way {
    const ALL: [Self; 3] = [Self::Matrix, Self::Quaternion, Self::Projector];

    fn stage(self) -> &'static str {
        match self {
            Self::Matrix => "inclinometer-matrix",
            Self::Quaternion => "inclinometer-quaternion",
            Self::Projector => "projector",
        }
    }

    /// What the stage makes of a gravity; nothing where there is no such stage.
    fn of(self, gravity_m_s2: Vector3<f64>) -> Tilt {
        let force_m_s2 = Vector3::new(-gravity_m_s2.y, -gravity_m_s2.x, gravity_m_s2.z);
        let up = Accelerometer::from_name(self.stage())
            .map_or(Vector3::repeat(f64::NAN), |mut stage| stage.step(&force_m_s2).up.direction());
        let pitch_rad = up.y.atan2(up.x.hypot(up.z));
        Tilt { pitch_deg: pitch_rad.to_degrees(), roll_deg: (-up.x).atan2(up.z).to_degrees() }
    }
}

/// A direction of gravity, and what each stage makes of it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cell {
    truth: Tilt,
    seen: [Tilt; 3],
}

impl Cell {
    pub(crate) fn seen(&self, way: Way) -> Tilt {
        self.seen[way as usize]
    }

    /// Matrix less quaternion.
    pub(crate) fn between(&self) -> Tilt {
        self.seen(Way::Matrix).less(self.seen(Way::Quaternion))
    }
}

/// The sphere, row by row from β = −90°.
pub(crate) fn cells() -> Vec<Cell> {
    let at = |index: usize| {
        let middle = |index: usize, of: usize, range: f64| ((index as f64 + 0.5) / of as f64 - 0.5) * range;
        let truth =
            Tilt { pitch_deg: middle(index / COLUMNS, ROWS, 180.0), roll_deg: middle(index % COLUMNS, COLUMNS, 360.0) };
        Cell { truth, seen: Way::ALL.map(|way| way.of(truth.gravity_m_s2())) }
    };
    (0..COLUMNS * ROWS).map(at).collect()
}

/// β near 90° with ψ = 0 and 1 mg too much across: the errors of both angles.
pub(crate) fn near_the_singularity(way: Way) -> Vec<(f64, Tilt)> {
    let at = |step: i32| {
        let truth = Tilt { pitch_deg: 80.0 + f64::from(step) * 0.02, roll_deg: 0.0 };
        let seen = way.of(truth.gravity_m_s2() + Vector3::new(0.0, MILLI_G_M_S2, 0.0));
        (truth.pitch_deg, seen.less(truth))
    };
    (0..500).map(at).collect()
}

/// dβ/dgx and dψ/dgy, ° for a thousandth of g, by central differences.
pub(crate) fn sensitivity(pitch_deg: f64, roll_deg: f64) -> (f64, f64) {
    let step_m_s2 = 1e-3 * MILLI_G_M_S2;
    let gravity_m_s2 = Tilt { pitch_deg, roll_deg }.gravity_m_s2();
    let along = |axis: Vector3<f64>| {
        let [more, less] = [1.0, -1.0].map(|sign| Way::Matrix.of(gravity_m_s2 + axis * (sign * step_m_s2)));
        more.less(less)
    };
    let of = MILLI_G_M_S2 / (2.0 * step_m_s2);
    (along(Vector3::x()).pitch_deg * of, along(Vector3::y()).roll_deg * of)
}

/// The largest differences over the sphere.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Numbers {
    /// Of the matrix method from what was put in.
    pub matrix: Tilt,
    /// Of the quaternion method.
    pub quaternion: Tilt,
    /// Of S1's projection.
    pub projector: Tilt,
    /// Of the matrix method from the quaternion method.
    pub between: Tilt,
}

impl Numbers {
    pub(crate) fn of(cells: &[Cell]) -> Self {
        let most =
            |difference: &dyn Fn(&Cell) -> Tilt| cells.iter().map(difference).fold(Tilt::default(), Tilt::larger);
        let off = |way: Way| most(&move |cell: &Cell| cell.seen(way).less(cell.truth));
        Self {
            matrix: off(Way::Matrix),
            quaternion: off(Way::Quaternion),
            projector: off(Way::Projector),
            between: most(&Cell::between),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_ways_give_what_was_put_in_but_for_rounding() {
        let numbers = Numbers::of(&cells());
        println!("{numbers:?}");
        for most in [numbers.matrix, numbers.quaternion, numbers.projector, numbers.between] {
            assert!(most.pitch_deg < 1e-12 && most.roll_deg < 1e-11, "{most:?}");
        }
    }

    #[test]
    fn the_sensitivities_are_those_of_the_equations() {
        for (pitch_deg, roll_deg) in [(0.0, 0.0), (30.0, 45.0), (-60.0, 75.0), (85.0, 0.0)] {
            let (pitch, roll) = sensitivity(pitch_deg, roll_deg);
            let cos = pitch_deg.to_radians().cos();
            let (want_pitch, want_roll) = (-cos * 1e-3, 1e-3 * roll_deg.to_radians().cos() / cos);
            assert!((pitch - want_pitch.to_degrees()).abs() < 1e-6, "{pitch_deg}°: {pitch}");
            assert!((roll - want_roll.to_degrees()).abs() < 1e-5, "{pitch_deg}°: {roll}");
        }
    }

    #[test]
    fn towards_the_singularity_roll_loses_its_meaning_and_pitch_does_not() {
        for way in [Way::Matrix, Way::Quaternion] {
            let errors = near_the_singularity(way);
            let (at_deg, last) = errors[errors.len() - 1];
            assert!(at_deg > 89.9 && last.roll_deg.abs() > 60.0, "{way:?}: {last:?} at {at_deg}°");
            assert!(errors.iter().all(|(_, error)| error.pitch_deg.abs() < 0.06), "{way:?}");
        }
    }
}
