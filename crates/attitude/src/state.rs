//! The attitude (w, z) and what acts on it.
//!
//! Input: turns of the body, corrections of the level. Output: an attitude bounded in its chart, |w| ≤ 1.2. Time: none.
//! Failure: none; every attitude has a chart in which it is far from the pole.

use core::f64::consts::{PI, TAU};

use crate::{
    Complex, J, Matrix3, Quaternion, Vector3,
    point::{Chart, Point},
    turn::Turn,
};

/// |w|² beyond which the chart is changed: the modulus 1.2, so that an attitude on the equator does not flutter.
const CHART_LIMIT: f64 = 1.44;

/// The attitude of a body: first a turn z about the vertical, then the shortest turn that tilts it to w.
///
/// A = A(w) A(z) — Matveev 2025, (1), (7), (15). In the inverted chart the same holds for the body turned by π about ξ.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Attitude {
    /// Where the up vector is.
    pub up: Point,
    /// The turn about the vertical, rad, counter-clockwise from above, (−π, π].
    pub z_rad: f64,
}

/// An attitude after it was acted on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moved {
    /// The new attitude.
    pub attitude: Attitude,
    /// e^{−j Δz}: multiplies horizontal vectors kept in the level frame, which turned by Δz.
    pub swing: Complex<f64>,
}

impl Attitude {
    /// The attitude in which `up` is up, with z = 0.
    pub fn levelled(up: Point) -> Self {
        Self { up, z_rad: 0.0 }
    }

    /// From a quaternion body → reference, of any length but zero.
    ///
    /// w = j β/α, z = 2 arg α with α = q0 + j q3, β = q1 + j q2; ŵ = −j α/β, ẑ = 2 arg β.
    pub fn of_quaternion(q: Quaternion<f64>) -> Self {
        let (alpha, beta) = (Complex::new(q.w, q.k), Complex::new(q.i, q.j));
        if alpha.norm_sqr() >= beta.norm_sqr() {
            Self { up: Point { w: J * beta / alpha, chart: Chart::Upright }, z_rad: double_arg(alpha) }
        } else {
            Self { up: Point { w: -J * alpha / beta, chart: Chart::Inverted }, z_rad: double_arg(beta) }
        }
    }

    /// The unit quaternion body → reference; its sign carries no meaning.
    pub fn quaternion(self) -> Quaternion<f64> {
        let (sin, cos) = libm::sincos(0.5 * self.z_rad);
        let first = Complex::new(cos, sin) / libm::sqrt(1.0 + self.up.w.norm_sqr());
        let second = -J * self.up.w * first;
        let (alpha, beta) = match self.up.chart {
            Chart::Upright => (first, second),
            Chart::Inverted => (second, -first),
        };
        Quaternion::new(alpha.re, beta.re, beta.im, alpha.im)
    }

    /// Direction cosines reference → body, v_body = A v_ref — Matveev 2025, (14), (15).
    pub fn matrix(self) -> Matrix3<f64> {
        let (u, v) = (self.up.w.re, self.up.w.im);
        let rho = u * u + v * v;
        let tilt = Matrix3::new(
            1.0 - u * u + v * v,
            -2.0 * u * v,
            2.0 * u,
            -2.0 * u * v,
            1.0 + u * u - v * v,
            2.0 * v,
            -2.0 * u,
            -2.0 * v,
            1.0 - rho,
        ) / (1.0 + rho);
        let (sin, cos) = libm::sincos(self.z_rad);
        let heading = Matrix3::new(cos, sin, 0.0, -sin, cos, 0.0, 0.0, 0.0, 1.0);
        let sign = self.up.chart.sign();
        Matrix3::from_diagonal(&Vector3::new(1.0, sign, sign)) * tilt * heading
    }

    /// The attitude after a turn of the body; exact for any turn.
    ///
    /// w⁺ = (p̄ w + j s)/m, z⁺ = z + 2 arg m, m = p + j s̄ w: the solution of Matveev 2025, (18)–(20) for a constant rate.
    pub fn turned(self, turn: Turn) -> Moved {
        let Turn { p, s } = turn.view(self.up.chart);
        let w = self.up.w;
        self.mapped(p.conj() * w + J * s, p + J * s.conj() * w)
    }

    /// The attitude after a turn of the body during which its level frame was leaned, by a point of that frame before the turn.
    ///
    /// w⁺ = (n + l m̄)/(m − l n̄), z⁺ = z + 2 arg(m − l n̄), n = p̄ w + j s, m = p + j s̄ w: both maps in one.
    #[inline]
    pub(crate) fn turned_and_leaned(self, turn: Turn, lean: Complex<f64>) -> Moved {
        let Turn { p, s } = turn.view(self.up.chart);
        let w = self.up.w;
        let (n, m) = (p.conj() * w + J * s, p + J * s.conj() * w);
        self.mapped(n + lean * m.conj(), m - lean * n.conj())
    }

    /// The attitude after its level frame was leaned by the rotation that brings ζ0 to the level-frame point `lean`.
    ///
    /// w⁺ = (w + l)/m, z⁺ = z + 2 arg m, m = 1 − w̄ l: a turn about a horizontal axis, so heading does not follow the tilt.
    pub fn leaned(self, lean: Complex<f64>) -> Moved {
        self.mapped(self.up.w + lean, Complex::new(1.0, 0.0) - self.up.w.conj() * lean)
    }

    /// The attitude after the shortest turn of its level that brings `up` up; heading does not follow.
    pub fn realigned(self, up: Point) -> Moved {
        let seen = up.direction();
        let vertical = 1.0 + seen.dot(&self.up.direction());
        // Exactly upside down there is no shortest turn: any horizontal axis will do.
        let lean = if vertical > 1e-9 { self.horizontal(seen) / vertical } else { Complex::new(1e9, 0.0) };
        self.leaned(lean)
    }

    /// Horizontal part of a body vector in the level frame, the reference frame turned by z: ξ + j η.
    ///
    /// h = F − (a + j b)(f_ζ + Re(w̄ F)), F = f_ξ + j f_η: the first two rows of A(w)ᵀ f.
    pub fn horizontal(self, body: Vector3<f64>) -> Complex<f64> {
        let f = self.up.chart.view(body);
        let (w, plane) = (self.up.w, Complex::new(f.x, f.y));
        plane - w * (2.0 / (1.0 + w.norm_sqr()) * (f.z + w.re * plane.re + w.im * plane.im))
    }

    /// Horizontal parts of the body axes in the level frame.
    pub(crate) fn horizontal_axes(self) -> [Complex<f64>; 3] {
        let (w, sign) = (self.up.w, self.up.chart.sign());
        let tilt = w * (2.0 / (1.0 + w.norm_sqr()));
        [Complex::new(1.0, 0.0) - tilt * w.re, (J - tilt * w.im) * sign, -tilt * sign]
    }

    /// The image of a Möbius map given as numerator and m, in the chart where it is far from the pole.
    fn mapped(self, numerator: Complex<f64>, m: Complex<f64>) -> Moved {
        let size2 = m.norm_sqr();
        if numerator.norm_sqr() > CHART_LIMIT * size2 {
            return self.rechart(numerator, m);
        }
        let up = Point { w: numerator * m.conj() / size2, chart: self.up.chart };
        let z_rad = wrapped_rad(self.z_rad + double_arg(m));
        Moved { attitude: Self { up, z_rad }, swing: m.conj() * m.conj() / size2 }
    }

    /// ŵ = m/numerator, ẑ = z + 2 arg(numerator) + π.
    fn rechart(self, numerator: Complex<f64>, m: Complex<f64>) -> Moved {
        let size2 = numerator.norm_sqr();
        let up = Point { w: m * numerator.conj() / size2, chart: self.up.chart.other() };
        let z_rad = wrapped_rad(self.z_rad + double_arg(J * numerator));
        Moved { attitude: Self { up, z_rad }, swing: -numerator.conj() * numerator.conj() / size2 }
    }
}

impl Turn {
    /// The turn that takes one attitude to another, q_from* q_to.
    pub fn between(from: Attitude, to: Attitude) -> Self {
        Self::of_quaternion(from.quaternion().conjugate() * to.quaternion())
    }
}

/// The same angle in (−π, π].
pub fn wrapped_rad(angle_rad: f64) -> f64 {
    if angle_rad > -PI && angle_rad <= PI {
        return angle_rad;
    }
    let wrapped = angle_rad - TAU * libm::rint(angle_rad / TAU);
    if wrapped <= -PI { wrapped + TAU } else { wrapped }
}

fn double_arg(m: Complex<f64>) -> f64 {
    2.0 * arg(m)
}

/// arg m, rad, (−π, π]: by its series for the small angles of a sample.
pub(crate) fn arg(m: Complex<f64>) -> f64 {
    if m.re > 0.0 && m.im.abs() < 0.03 * m.re {
        let t = m.im / m.re;
        let t2 = t * t;
        return t * (1.0 - t2 * (1.0 / 3.0 - t2 * (0.2 - t2 * (1.0 / 7.0 - t2 * (1.0 / 9.0 - t2 / 11.0)))));
    }
    libm::atan2(m.im, m.re)
}
