//! A direction of the body frame as a point of the complex plane: the stereographic projection of the sphere.
//!
//! Input: a direction, usually the up vector in body axes. Output: a point with |w| ≤ 1 in one of two charts.
//! Time: none. Failure: a vector without a direction has no point.

use crate::{Complex, Vector3, numbers::Numbers};

/// From which pole the sphere is projected.
///
/// The inverted chart is the upright chart of a body turned by π about its ξ axis, ŵ = 1/w: every formula of the upright chart
/// holds in it for vectors whose η and ζ components have changed sign.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Chart {
    /// Projected from −ζ: w = 0 is level, w = ∞ upside down.
    #[default]
    Upright,
    /// Projected from +ζ: ŵ = 0 is upside down, ŵ = ∞ level.
    Inverted,
}

impl Chart {
    /// The other chart.
    pub fn other(self) -> Self {
        match self {
            Self::Upright => Self::Inverted,
            Self::Inverted => Self::Upright,
        }
    }

    /// The components of a body vector as this chart's formulas take them; its own inverse.
    #[inline]
    pub fn view(self, body: Vector3<f64>) -> Vector3<f64> {
        let sign = self.sign();
        Vector3::new(body.x, sign * body.y, sign * body.z)
    }

    /// +1 upright, −1 inverted.
    #[inline]
    pub fn sign(self) -> f64 {
        [1.0, -1.0][self as usize]
    }
}

/// A unit vector of the body frame as a point of a chart.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Point {
    /// u + j v, dimensionless.
    pub w: Complex<f64>,
    /// The chart that `w` is in.
    pub chart: Chart,
}

impl Point {
    /// The point of a direction, in the chart where |w| ≤ 1; `None` for a vector that is zero or not finite.
    ///
    /// w = (a + j b) / (1 + c) — Matveev 2025, (12), (28).
    pub fn of(direction: Vector3<f64>) -> Option<Self> {
        let norm = direction.norm();
        (norm > f64::MIN_POSITIVE && norm.is_finite()).then(|| Self::of_known_norm(direction, norm))
    }

    /// The point of a direction whose norm is known, above 0 and finite.
    #[inline]
    pub(crate) fn of_known_norm(direction: Vector3<f64>, norm: f64) -> Self {
        let chart = if direction.z >= 0.0 { Chart::Upright } else { Chart::Inverted };
        let v = chart.view(direction);
        let scale = 1.0 / (norm + v.z);
        Self { w: Complex::new(v.x * scale, v.y * scale), chart }
    }

    /// The unit vector in body axes — Matveev 2025, (13).
    #[inline]
    pub fn direction(self) -> Vector3<f64> {
        let rho = self.w.norm_sqr();
        let scale = 1.0 / (1.0 + rho);
        self.chart.view(Vector3::new(2.0 * self.w.re, 2.0 * self.w.im, 1.0 - rho) * scale)
    }

    /// The same direction in `chart`, with |w| held to `limit`.
    ///
    /// The pole of a chart is at infinity; sums of points need a finite stand-in in the same direction.
    pub fn seen_in(self, chart: Chart, limit: f64) -> Complex<f64> {
        if self.chart == chart {
            return self.w;
        }
        let size = libm::sqrt(self.w.norm_sqr());
        if size * limit < 1.0 {
            let heading = if size > 0.0 { self.w.conj() / size } else { Complex::new(1.0, 0.0) };
            return heading * limit;
        }
        self.w.inv()
    }
}

impl Numbers for Point {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let Self { w, chart } = self;
        let mut inverted = *chart == Chart::Inverted;
        inverted.visit(visit);
        *chart = if inverted { Chart::Inverted } else { Chart::Upright };
        w.visit(visit);
    }
}
