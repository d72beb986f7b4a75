//! Exact rotation of a body over one step.
//!
//! Input: a rotation vector in body axes.
//!
//! Output: the pair (p, s), which represents the unit quaternion δ = d0 + d1 i + d2 j + d3 k with p
//! = d0 + j d3 and s = d1 + j d2.

use crate::{Complex, Quaternion, Vector3, point::Chart, scalars::scalars};

/// Rotation of the body in its own axes. It acts on an attitude as a Möbius map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rotation {
    /// Components d0 and d3 of the unit quaternion δ, as d0 + j d3.
    pub p: Complex<f64>,
    /// Components d1 and d2 of the unit quaternion δ, as d1 + j d2.
    pub s: Complex<f64>,
}

impl Default for Rotation {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl Rotation {
    /// Identity rotation.
    pub const IDENTITY: Self = Self { p: Complex::new(1.0, 0.0), s: Complex::new(0.0, 0.0) };

    /// Creates δ = exp(½ φ) from a rotation vector φ in body axes, rad.
    #[inline]
    pub fn from_rotation_vector(rotation_rad: Vector3<f64>) -> Self {
        let (cos, sinc) = cos_and_sinc(rotation_rad.norm_squared() * 0.25);
        let half = rotation_rad * (0.5 * sinc);
        Self { p: Complex::new(cos, half.z), s: Complex::new(half.x, half.y) }
    }

    /// Returns the rotation as a unit quaternion (d0, d1, d2, d3).
    pub fn quaternion(self) -> Quaternion<f64> {
        Quaternion::new(self.p.re, self.s.re, self.s.im, self.p.im)
    }

    /// Creates the rotation from a quaternion. Its length does not matter.
    pub fn from_quaternion(q: Quaternion<f64>) -> Self {
        Self { p: Complex::new(q.w, q.k), s: Complex::new(q.i, q.j) }
    }

    /// Returns this rotation followed by `next`.
    pub fn then(self, next: Self) -> Self {
        Self { p: self.p * next.p - self.s * next.s.conj(), s: self.p * next.s + self.s * next.p.conj() }
    }

    /// Subtracts a small rotation that is spread evenly over this one.
    ///
    /// The small rotation is given by h, half its rotation vector in body axes, rad. The result is
    /// δ − ½ (δ h + h δ). If this rotation has the angle 2θ, the error of the result is at most θ²
    /// |h|/3. The result does not have unit length, which a Möbius map does not need.
    #[inline]
    pub(crate) fn minus_half_angle(self, half_rad: Vector3<f64>) -> Self {
        let along = half_rad.x * self.s.re + half_rad.y * self.s.im + half_rad.z * self.p.im;
        Self {
            p: Complex::new(self.p.re + along, self.p.im - self.p.re * half_rad.z),
            s: Complex::new(self.s.re - self.p.re * half_rad.x, self.s.im - self.p.re * half_rad.y),
        }
    }

    /// Subtracts a small fraction of this rotation about each body axis. The result does not have
    /// unit length, which a Möbius map does not need.
    #[inline]
    pub(crate) fn minus_fraction(self, fraction: Vector3<f64>) -> Self {
        Self {
            p: Complex::new(self.p.re, self.p.im * (1.0 - fraction.z)),
            s: Complex::new(self.s.re * (1.0 - fraction.x), self.s.im * (1.0 - fraction.y)),
        }
    }

    /// Returns δ* v δ. If `body` is a space-fixed vector v in the body axes before the rotation,
    /// the result is the same vector in the body axes after it.
    #[inline]
    pub(crate) fn apply_inverse(self, body: Vector3<f64>) -> Vector3<f64> {
        let axis = Vector3::new(self.s.re, self.s.im, self.p.im);
        let across = axis.cross(&body);
        body + (axis.cross(&across) - across * self.p.re) * 2.0
    }

    /// Returns the rotation in the axes of `chart`.
    #[inline]
    pub(crate) fn in_chart(self, chart: Chart) -> Self {
        let sign = chart.sign();
        Self { p: Complex::new(self.p.re, sign * self.p.im), s: Complex::new(self.s.re, sign * self.s.im) }
    }
}

scalars!(Rotation: p, s);

/// Returns cos x and sin x / x for a given x². Power series are used as long as they are exact to
/// the last bit. An infinite x yields (1, 0), which represents no rotation.
#[inline]
fn cos_and_sinc(x2: f64) -> (f64, f64) {
    if x2 < 0.01 {
        let sinc = 1.0 - x2 * (1.0 / 6.0 - x2 * (1.0 / 120.0 - x2 * (1.0 / 5040.0 - x2 * (1.0 / 362_880.0))));
        return (libm::sqrt(1.0 - x2 * sinc * sinc), sinc);
    }
    wide_cos_and_sinc(x2)
}

#[cold]
#[inline(never)]
fn wide_cos_and_sinc(x2: f64) -> (f64, f64) {
    if !x2.is_finite() {
        return (1.0, 0.0);
    }
    let x = libm::sqrt(x2);
    let (sin, cos) = libm::sincos(x);
    (cos, sin / x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn series_and_library_agree_at_switch() {
        for x in [0.0999, 0.099_999_999] {
            let (cos, sinc) = cos_and_sinc(x * x);
            assert!((cos - libm::cos(x)).abs() < 3e-16);
            assert!((sinc - libm::sin(x) / x).abs() < 3e-16);
        }
    }
}
