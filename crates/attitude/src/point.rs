//! Direction in body axes as a point of the complex plane, by stereographic projection.
//!
//! Input: a direction, usually the up vector in body axes.
//!
//! Output: a point with |w| ≤ 1 in one of two charts.
//!
//! Failure: a vector that is zero or not finite has no point.

use crate::{Complex, Vector3, scalars::Scalars};

/// Pole from which the sphere is projected.
///
/// The inverted chart is the upright chart of a body rotated by π about its ξ axis, ŵ = 1/w. Every
/// formula of the upright chart holds in the inverted chart for vectors whose η and ζ components
/// are negated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
// With the size of a coordinate, a direction has no padding and is copied in fewer instructions.
#[repr(u64)]
pub enum Chart {
    /// Projection from −ζ: w = 0 is level, w = ∞ upside down.
    #[default]
    Upright,
    /// Projection from +ζ: ŵ = 0 is upside down, ŵ = ∞ level.
    Inverted,
}

impl Chart {
    /// Returns the opposite chart.
    pub fn other(self) -> Self {
        match self {
            Self::Upright => Self::Inverted,
            Self::Inverted => Self::Upright,
        }
    }

    /// Converts a body vector to the axes of the chart or back. The inverted chart negates η and ζ.
    #[inline]
    pub fn flip(self, body: Vector3<f64>) -> Vector3<f64> {
        let sign = self.sign();
        Vector3::new(body.x, sign * body.y, sign * body.z)
    }

    /// Returns +1 for the upright chart and −1 for the inverted one.
    #[inline]
    pub fn sign(self) -> f64 {
        [1.0, -1.0][self as usize]
    }
}

/// Unit vector in body axes as a point of a chart.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Point {
    /// Coordinates u + j v, dimensionless.
    pub w: Complex<f64>,
    /// Chart in which `w` is given.
    pub chart: Chart,
}

impl Point {
    /// Projects a direction into the chart where |w| ≤ 1. Returns `None` for a vector that is zero
    /// or not finite.
    ///
    /// With the unit vector (a, b, c) along the direction, in the axes of the chart: w = (a + j b)
    /// / (1 + c) — Matveev 2025, (12), (28).
    pub fn from_direction(direction: Vector3<f64>) -> Option<Self> {
        let norm = direction.norm();
        (norm > f64::MIN_POSITIVE && norm.is_finite()).then(|| Self::from_direction_and_norm(direction, norm))
    }

    /// Projects a direction with the given norm, which must be finite and above 0.
    #[inline]
    pub(crate) fn from_direction_and_norm(direction: Vector3<f64>, norm: f64) -> Self {
        let chart = if direction.z >= 0.0 { Chart::Upright } else { Chart::Inverted };
        let v = chart.flip(direction);
        let scale = 1.0 / (norm + v.z);
        Self { w: Complex::new(v.x * scale, v.y * scale), chart }
    }

    /// Returns the unit vector in body axes — Matveev 2025, (13).
    #[inline]
    pub fn direction(self) -> Vector3<f64> {
        let rho = self.w.norm_sqr();
        let scale = 1.0 / (1.0 + rho);
        self.chart.flip(Vector3::new(2.0 * self.w.re, 2.0 * self.w.im, 1.0 - rho) * scale)
    }

    /// Returns the coordinate w of this direction in `chart`.
    ///
    /// The pole of a chart lies at infinity, but sums of points need a finite substitute in the
    /// same direction. |w| is therefore limited to `max_modulus` if the direction is stored in the
    /// other chart.
    pub fn w_in_chart(self, chart: Chart, max_modulus: f64) -> Complex<f64> {
        if self.chart == chart {
            return self.w;
        }
        let modulus = libm::sqrt(self.w.norm_sqr());
        if modulus * max_modulus < 1.0 {
            let direction = if modulus > 0.0 { self.w.conj() / modulus } else { Complex::new(1.0, 0.0) };
            return direction * max_modulus;
        }
        self.w.inv()
    }
}

impl Scalars for Point {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let Self { w, chart } = self;
        let mut inverted = *chart == Chart::Inverted;
        inverted.visit(visit);
        *chart = if inverted { Chart::Inverted } else { Chart::Upright };
        w.visit(visit);
    }
}
