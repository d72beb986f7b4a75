//! The exact rotation of a body over one step.
//!
//! Input: a rotation vector in body axes. Output: the pair (p, s), that is the unit quaternion δ = d0 + d1 i + d2 j + d3 k with
//! p = d0 + j d3 and s = d1 + j d2. Time: none. Failure: none for finite input.

use crate::{Complex, Quaternion, Vector3, numbers::Numbers, point::Chart};

/// A rotation of the body in its own axes; acts on an attitude as a Möbius map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Turn {
    /// d0 + j d3.
    pub p: Complex<f64>,
    /// d1 + j d2.
    pub s: Complex<f64>,
}

impl Default for Turn {
    fn default() -> Self {
        Self::NONE
    }
}

impl Turn {
    /// No rotation.
    pub const NONE: Self = Self { p: Complex::new(1.0, 0.0), s: Complex::new(0.0, 0.0) };

    /// δ = exp(½ φ) of a rotation vector φ, rad, body axes.
    #[inline]
    pub fn of_rotation_vector(rotation_rad: Vector3<f64>) -> Self {
        let (cos, sinc) = cos_and_sinc(rotation_rad.norm_squared() * 0.25);
        let half = rotation_rad * (0.5 * sinc);
        Self { p: Complex::new(cos, half.z), s: Complex::new(half.x, half.y) }
    }

    /// The turn as a unit quaternion (d0, d1, d2, d3).
    pub fn quaternion(self) -> Quaternion<f64> {
        Quaternion::new(self.p.re, self.s.re, self.s.im, self.p.im)
    }

    /// The turn of a quaternion; its length does not matter.
    pub fn of_quaternion(q: Quaternion<f64>) -> Self {
        Self { p: Complex::new(q.w, q.k), s: Complex::new(q.i, q.j) }
    }

    /// This turn followed by another.
    pub fn then(self, next: Self) -> Self {
        Self { p: self.p * next.p - self.s * next.s.conj(), s: self.p * next.s + self.s * next.p.conj() }
    }

    /// This turn less a small rotation spread over it, of which half the vector h is given, rad, body axes: ½ (δ h + h δ) taken
    /// from δ, which is exact to θ² |h|/3 in a turn by 2θ. Its length is not 1; a Möbius map has no length.
    #[inline]
    pub(crate) fn less(self, half: Vector3<f64>) -> Self {
        let along = half.x * self.s.re + half.y * self.s.im + half.z * self.p.im;
        Self {
            p: Complex::new(self.p.re + along, self.p.im - self.p.re * half.z),
            s: Complex::new(self.s.re - self.p.re * half.x, self.s.im - self.p.re * half.y),
        }
    }

    /// This turn less a small part of it about each body axis. Its length is not 1.
    #[inline]
    pub(crate) fn scaled_less(self, part: Vector3<f64>) -> Self {
        Self {
            p: Complex::new(self.p.re, self.p.im * (1.0 - part.z)),
            s: Complex::new(self.s.re * (1.0 - part.x), self.s.im * (1.0 - part.y)),
        }
    }

    /// What stands still, in body axes before the turn, as the body sees it after it: δ* v δ.
    #[inline]
    pub(crate) fn seen_after(self, body: Vector3<f64>) -> Vector3<f64> {
        let axis = Vector3::new(self.s.re, self.s.im, self.p.im);
        let across = axis.cross(&body);
        body + (axis.cross(&across) - across * self.p.re) * 2.0
    }

    /// The turn as the formulas of `chart` take it.
    #[inline]
    pub(crate) fn view(self, chart: Chart) -> Self {
        let sign = chart.sign();
        Self { p: Complex::new(self.p.re, sign * self.p.im), s: Complex::new(self.s.re, sign * self.s.im) }
    }
}

impl Numbers for Turn {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let Self { p, s } = self;
        p.visit(visit);
        s.visit(visit);
    }
}

/// cos x and sin x / x from x², by their series while those are exact to the last bit; of a turn without bounds, no turn.
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
    fn series_and_library_agree_where_they_meet() {
        for x in [0.0999, 0.099_999_999] {
            let (cos, sinc) = cos_and_sinc(x * x);
            assert!((cos - libm::cos(x)).abs() < 3e-16);
            assert!((sinc - libm::sin(x) / x).abs() < 3e-16);
        }
    }
}
