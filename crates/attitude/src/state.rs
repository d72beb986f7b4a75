//! The attitude (w, z) and what acts on it.
//!
//! Input: turns of the body, corrections of the level. Output: an attitude bounded in its chart, |w| ≤ 1.2. Time: none.
//! Failure: none; every attitude has a chart in which it is far from the pole.

use core::f64::consts::{PI, TAU};

use crate::{
    Complex, J, Matrix3, Quaternion, Vector3,
    numbers::Numbers,
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

/// The body's axes in a frame with a vertical.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Axes {
    /// Of each axis, its horizontal part ξ + j η.
    pub(crate) horizontal: [Complex<f64>; 3],
    /// Of each axis, its part along the vertical: the up vector in body axes.
    pub(crate) up: Vector3<f64>,
}

impl Axes {
    /// Horizontal part of a body vector.
    #[inline]
    pub(crate) fn horizontal(&self, body: Vector3<f64>) -> Complex<f64> {
        let [x, y, z] = self.horizontal;
        x * body.x + y * body.y + z * body.z
    }
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
            Self { up: Point { w: J * beta / alpha, chart: Chart::Upright }, z_rad: wrapped_rad(double_arg(alpha)) }
        } else {
            Self { up: Point { w: -J * alpha / beta, chart: Chart::Inverted }, z_rad: wrapped_rad(double_arg(beta)) }
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
    #[inline]
    pub fn turned(self, turn: Turn) -> Moved {
        let Turn { p, s } = turn.view(self.up.chart);
        let w = self.up.w;
        self.mapped(p.conj() * w + J * s, p + J * s.conj() * w)
    }

    /// [`Attitude::turned`], in place.
    #[inline]
    pub(crate) fn turn(&mut self, turn: Turn) {
        let Turn { p, s } = turn.view(self.up.chart);
        let w = self.up.w;
        let (numerator, m) = (p.conj() * w + J * s, p + J * s.conj() * w);
        let m2 = m.norm_sqr();
        if numerator.norm_sqr() > CHART_LIMIT * m2 {
            *self = self.rechart(numerator, m).attitude;
            return;
        }
        self.up.w = numerator * m.conj() * (1.0 / m2);
        self.z_rad = wrapped_rad(self.z_rad + double_arg(m));
    }

    /// Turns the body while the level frame is leaned, by a point of that frame before the turn; `azimuth` is the unit number that
    /// takes what is in the level frame to where it does not turn. The body's axes there.
    ///
    /// w⁺ = N/M, z⁺ = z + 2 arg M, N = n + l m̄, M = m − l n̄, n = p̄ w + j s, m = p + j s̄ w: both maps in one. With the azimuth
    /// r⁺ = r M²/|M|² the axes need one division, by |M|² + |N|².
    #[inline]
    pub(crate) fn turn_and_lean(&mut self, turn: Turn, lean: Complex<f64>, azimuth: &mut Complex<f64>) -> Axes {
        let Turn { p, s } = turn.view(self.up.chart);
        let w = self.up.w;
        let (n, m) = (p.conj() * w + J * s, p + J * s.conj() * w);
        let (numerator, m) = (n + lean * m.conj(), m - lean * n.conj());
        let (numerator2, m2) = (numerator.norm_sqr(), m.norm_sqr());
        if numerator2 > CHART_LIMIT * m2 {
            let moved = self.rechart(numerator, m);
            *azimuth *= moved.swing.conj();
            *self = moved.attitude;
            return self.axes(*azimuth);
        }
        let (inverse, half) = (1.0 / m2, 1.0 / (m2 + numerator2));
        let turned = *azimuth * m;
        *azimuth = turned * m * inverse;
        self.up.w = numerator * m.conj() * inverse;
        self.z_rad = wrapped_rad(self.z_rad + double_arg(m));
        let tilt = turned * numerator * (2.0 * half);
        self.axes_of(*azimuth, tilt, 2.0 * m2 * half)
    }

    /// The attitude after its level frame was leaned by the rotation that brings ζ0 to the level-frame point `lean`.
    ///
    /// w⁺ = (w + l)/m, z⁺ = z + 2 arg m, m = 1 − w̄ l: a turn about a horizontal axis, so heading does not follow the tilt.
    #[inline]
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
    #[inline]
    pub fn horizontal(self, body: Vector3<f64>) -> Complex<f64> {
        let f = self.up.chart.view(body);
        let (w, plane) = (self.up.w, Complex::new(f.x, f.y));
        plane - w * (2.0 / (1.0 + w.norm_sqr()) * (f.z + w.re * plane.re + w.im * plane.im))
    }

    /// The body's axes in the level frame turned by `azimuth`, a unit number.
    pub(crate) fn axes(self, azimuth: Complex<f64>) -> Axes {
        let scale = 2.0 / (1.0 + self.up.w.norm_sqr());
        self.axes_of(azimuth, azimuth * self.up.w * scale, scale)
    }

    /// `scale` is 2/(1 + ρ), `tilt` the azimuth times w times that.
    #[inline]
    fn axes_of(self, azimuth: Complex<f64>, tilt: Complex<f64>, scale: f64) -> Axes {
        let (w, sign) = (self.up.w, self.up.chart.sign());
        let second = (J * azimuth - tilt * w.im) * sign;
        let up = Vector3::new(scale * w.re, sign * scale * w.im, sign * (scale - 1.0));
        Axes { horizontal: [azimuth - tilt * w.re, second, tilt * -sign], up }
    }

    /// The image of a Möbius map given as numerator and m, in the chart where it is far from the pole.
    #[inline]
    fn mapped(self, numerator: Complex<f64>, m: Complex<f64>) -> Moved {
        let size2 = m.norm_sqr();
        if numerator.norm_sqr() > CHART_LIMIT * size2 {
            return self.rechart(numerator, m);
        }
        let inverse = m.conj() * (1.0 / size2);
        let up = Point { w: numerator * inverse, chart: self.up.chart };
        let z_rad = wrapped_rad(self.z_rad + double_arg(m));
        Moved { attitude: Self { up, z_rad }, swing: m.conj() * inverse }
    }

    /// ŵ = m/numerator, ẑ = z + 2 arg(numerator) + π.
    #[cold]
    #[inline(never)]
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
#[inline]
pub fn wrapped_rad(angle_rad: f64) -> f64 {
    if angle_rad > -PI && angle_rad <= PI { angle_rad } else { far_wrapped_rad(angle_rad) }
}

#[cold]
#[inline(never)]
fn far_wrapped_rad(angle_rad: f64) -> f64 {
    let wrapped = angle_rad - TAU * libm::rint(angle_rad / TAU);
    if wrapped.abs() > 4.0 {
        // So many turns that their product with 2π is not exact.
        return libm::remainder(angle_rad, TAU);
    }
    if wrapped <= -PI { wrapped + TAU } else { wrapped }
}

#[inline]
fn double_arg(m: Complex<f64>) -> f64 {
    2.0 * arg(m)
}

/// arg m, rad, (−π, π]: by its series for the small angles of a sample.
#[inline]
pub(crate) fn arg(m: Complex<f64>) -> f64 {
    let t = m.im / m.re;
    let t2 = t * t;
    if m.re > 0.0 && t2 < 9e-4 {
        return t * (1.0 - t2 * (1.0 / 3.0 - t2 * (0.2 - t2 * (1.0 / 7.0 - t2 * (1.0 / 9.0)))));
    }
    wide_arg(m)
}

fn wide_arg(m: Complex<f64>) -> f64 {
    let t = m.im / m.re;
    let t2 = t * t;
    if m.re > 0.0 && t2 < 0.0144 {
        let low = 1.0 / 3.0 - t2 * (0.2 - t2 * (1.0 / 7.0 - t2 * (1.0 / 9.0)));
        let high = 1.0 / 11.0 - t2 * (1.0 / 13.0 - t2 * (1.0 / 15.0 - t2 * (1.0 / 17.0)));
        let t4 = t2 * t2;
        return t * (1.0 - t2 * (low + t4 * t4 * high));
    }
    libm::atan2(m.im, m.re)
}

impl Numbers for Attitude {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let Self { up, z_rad } = self;
        up.visit(visit);
        z_rad.visit(visit);
    }
}
