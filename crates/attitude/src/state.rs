//! Attitude (w, z) and the operations on it.
//!
//! Input: rotations of the body and corrections of the level.
//!
//! Output: an attitude bounded in its chart, |w| ≤ 1.2.
//!
//! Failure: no operation fails, because every attitude has a chart in which it is far from the
//! pole.

use core::f64::consts::{PI, TAU};

use crate::{
    Complex, J, Matrix3, Quaternion, Vector3,
    point::{Chart, Point},
    rotation::Rotation,
    scalars::scalars,
};

/// Value of |w|² above which the chart changes.
///
/// The corresponding modulus of 1.2, instead of 1, provides hysteresis, so that attitudes near the
/// equator do not switch charts back and forth.
const MAX_CHART_NORM_SQUARED: f64 = 1.44;

/// Attitude of a body: a rotation z about the vertical, then the shortest rotation that tilts the
/// body to w.
///
/// A = A(w) A(z) — Matveev 2025, (1), (7), (15). The inverted chart describes the body rotated by π
/// about ξ.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Attitude {
    /// Up vector in body axes.
    pub up: Point,
    /// Rotation about the vertical, rad, counter-clockwise from above, (−π, π].
    pub z_rad: f64,
}

/// Result of an operation on an attitude.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AttitudeUpdate {
    /// Attitude after the operation.
    pub attitude: Attitude,
    /// Factor e^{−j Δz} by which to multiply horizontal vectors in the level frame.
    ///
    /// The factor accounts for the rotation of the level frame by Δz.
    pub level_frame_rotation: Complex<f64>,
}

/// Body axes in a frame with a vertical third axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BodyAxes {
    /// Horizontal part ξ + j η of each axis.
    pub(crate) horizontal: [Complex<f64>; 3],
    /// Vertical parts of the axes, which form the up vector in body axes.
    pub(crate) up: Vector3<f64>,
}

impl BodyAxes {
    /// Returns the horizontal part of a body vector.
    #[inline]
    pub(crate) fn horizontal(&self, body: Vector3<f64>) -> Complex<f64> {
        let [x, y, z] = self.horizontal;
        x * body.x + y * body.y + z * body.z
    }
}

impl Attitude {
    /// Creates the attitude with the given up vector and z = 0.
    pub fn from_up(up: Point) -> Self {
        Self { up, z_rad: 0.0 }
    }

    /// Creates the attitude from a quaternion body → reference of any non-zero length.
    ///
    /// w = j β/α, z = 2 arg α with α = q0 + j q3, β = q1 + j q2; ŵ = −j α/β, ẑ = 2 arg β.
    pub fn from_quaternion(q: Quaternion<f64>) -> Self {
        let (alpha, beta) = (Complex::new(q.w, q.k), Complex::new(q.i, q.j));
        if alpha.norm_sqr() >= beta.norm_sqr() {
            Self { up: Point { w: J * beta / alpha, chart: Chart::Upright }, z_rad: wrapped_rad(double_arg(alpha)) }
        } else {
            Self { up: Point { w: -J * alpha / beta, chart: Chart::Inverted }, z_rad: wrapped_rad(double_arg(beta)) }
        }
    }

    /// Returns the unit quaternion body → reference. Its sign has no meaning.
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

    /// Returns the direction cosine matrix reference → body, v_body = A v_ref — Matveev 2025, (14),
    /// (15).
    pub fn matrix(self) -> Matrix3<f64> {
        let (u, v) = (self.up.w.re, self.up.w.im);
        let rho = u * u + v * v;
        let scale = 1.0 + rho;
        let (xx, xy, yy) = ((1.0 - u * u + v * v) / scale, -2.0 * u * v / scale, (1.0 + u * u - v * v) / scale);
        let (xz, yz, zz) = (2.0 * u / scale, 2.0 * v / scale, (1.0 - rho) / scale);
        let sign = self.up.chart.sign();
        let (sin, cos) = libm::sincos(self.z_rad);
        // The sum with 0 is never −0.
        let row = |x: f64, y: f64, z: f64| [x * cos - y * sin + 0.0, x * sin + y * cos + 0.0, z + 0.0];
        let [a, b, c] = [row(xx, xy, xz), row(sign * xy, sign * yy, sign * yz), row(-sign * xz, -sign * yz, sign * zz)];
        Matrix3::new(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2])
    }

    /// Returns the attitude after a rotation of the body, exact for any angle.
    ///
    /// w⁺ = (p̄ w + j s)/m, z⁺ = z + 2 arg m, m = p + j s̄ w. This is the solution of Matveev 2025,
    /// (18)–(20) for a constant rate.
    #[inline(always)]
    pub fn rotated(self, rotation: Rotation) -> AttitudeUpdate {
        let Rotation { p, s } = rotation.in_chart(self.up.chart);
        let w = self.up.w;
        self.mapped(p.conj() * w + J * s, p + J * s.conj() * w)
    }

    /// Applies [`Attitude::rotated`] in place.
    #[inline(always)]
    pub(crate) fn rotate(&mut self, rotation: Rotation) {
        let Rotation { p, s } = rotation.in_chart(self.up.chart);
        let w = self.up.w;
        let (numerator, m) = (p.conj() * w + J * s, p + J * s.conj() * w);
        let m2 = m.norm_sqr();
        if numerator.norm_sqr() > MAX_CHART_NORM_SQUARED * m2 {
            *self = self.rechart(numerator, m).attitude;
            return;
        }
        self.up.w = numerator * m.conj() * (1.0 / m2);
        self.z_rad = wrapped_rad(self.z_rad + double_arg(m));
    }

    /// Rotates the body and tilts the level frame in one step, and returns the new body axes.
    ///
    /// `tilt` is a point of the level frame before the rotation. `azimuth` is the complex number of
    /// modulus 1 that converts the level frame to a frame that does not rotate about the vertical.
    /// The returned axes refer to this second frame.
    ///
    /// With l the tilt and (p, s) the rotation, the composition of both maps is w⁺ = N/M and
    /// z⁺ = z + 2 arg M, where N = n + l m̄, M = m − l n̄, n = p̄ w + j s and m = p + j s̄ w. With
    /// the azimuth r⁺ = r M²/|M|², the axes need only one division, by |M|² + |N|².
    #[inline(always)]
    pub(crate) fn rotate_and_tilt(
        &mut self,
        rotation: Rotation,
        tilt: Complex<f64>,
        azimuth: &mut Complex<f64>,
    ) -> BodyAxes {
        let Rotation { p, s } = rotation.in_chart(self.up.chart);
        let w = self.up.w;
        let (n, m) = (p.conj() * w + J * s, p + J * s.conj() * w);
        let (numerator, m) = (n + tilt * m.conj(), m - tilt * n.conj());
        let (numerator2, m2) = (numerator.norm_sqr(), m.norm_sqr());
        if numerator2 > MAX_CHART_NORM_SQUARED * m2 {
            let moved = self.rechart(numerator, m);
            *azimuth *= moved.level_frame_rotation.conj();
            *self = moved.attitude;
            return self.axes(*azimuth);
        }
        let (inverse, half) = (1.0 / m2, 1.0 / (m2 + numerator2));
        let rotated = *azimuth * m;
        *azimuth = rotated * m * inverse;
        self.up.w = numerator * m.conj() * inverse;
        self.z_rad = wrapped_rad(self.z_rad + double_arg(m));
        let scaled_tilt = rotated * numerator * (2.0 * half);
        self.axes_from_tilt(*azimuth, scaled_tilt, 2.0 * m2 * half)
    }

    /// Returns the attitude after a tilt of its level frame.
    ///
    /// The tilt is the rotation that brings ζ0 to the level-frame point `tilt`: w⁺ = (w + l)/m, z⁺
    /// = z + 2 arg m, m = 1 − w̄ l, with l the tilt. The rotation axis is horizontal, so the
    /// heading does not change with the tilt.
    #[inline]
    pub fn tilted(self, tilt: Complex<f64>) -> AttitudeUpdate {
        self.mapped(self.up.w + tilt, Complex::new(1.0, 0.0) - self.up.w.conj() * tilt)
    }

    /// Returns the attitude after the shortest tilt that makes `up` the up vector. The heading is
    /// kept.
    pub fn realigned(self, up: Point) -> AttitudeUpdate {
        let direction = up.direction();
        let vertical = 1.0 + direction.dot(&self.up.direction());
        // If `up` is opposite to the present up vector, the shortest rotation is not unique, so the
        // choice of its horizontal axis is arbitrary.
        let tilt = if vertical > 1e-9 { self.horizontal(direction) / vertical } else { Complex::new(1e9, 0.0) };
        self.tilted(tilt)
    }

    /// Returns the horizontal part ξ + j η of a body vector in the level frame.
    ///
    /// The level frame is the reference frame rotated by z.
    ///
    /// h = F − (a + j b)(f_ζ + Re(w̄ F)) with F = f_ξ + j f_η and a + j b = 2w/(1 + |w|²). These
    /// are the first two rows of A(w)ᵀ f.
    #[inline]
    pub fn horizontal(self, body: Vector3<f64>) -> Complex<f64> {
        let f = self.up.chart.flip(body);
        let (w, plane) = (self.up.w, Complex::new(f.x, f.y));
        plane - w * (2.0 / (1.0 + w.norm_sqr()) * (f.z + w.re * plane.re + w.im * plane.im))
    }

    /// Returns the body axes in the level frame rotated by `azimuth`, a complex number of modulus
    /// 1.
    pub(crate) fn axes(self, azimuth: Complex<f64>) -> BodyAxes {
        let scale = 2.0 / (1.0 + self.up.w.norm_sqr());
        self.axes_from_tilt(azimuth, azimuth * self.up.w * scale, scale)
    }

    /// Returns the body axes for `scale` = 2/(1 + |w|²) and `scaled_tilt` = azimuth · w · scale.
    #[inline]
    fn axes_from_tilt(self, azimuth: Complex<f64>, scaled_tilt: Complex<f64>, scale: f64) -> BodyAxes {
        let (w, sign) = (self.up.w, self.up.chart.sign());
        let second = (J * azimuth - scaled_tilt * w.im) * sign;
        let up = Vector3::new(scale * w.re, sign * scale * w.im, sign * (scale - 1.0));
        BodyAxes { horizontal: [azimuth - scaled_tilt * w.re, second, scaled_tilt * -sign], up }
    }

    /// Returns the image numerator/m of a Möbius map, in the chart in which it is far from the
    /// pole.
    #[inline(always)]
    fn mapped(self, numerator: Complex<f64>, m: Complex<f64>) -> AttitudeUpdate {
        let size2 = m.norm_sqr();
        if numerator.norm_sqr() > MAX_CHART_NORM_SQUARED * size2 {
            return self.rechart(numerator, m);
        }
        let inverse = m.conj() * (1.0 / size2);
        let up = Point { w: numerator * inverse, chart: self.up.chart };
        let z_rad = wrapped_rad(self.z_rad + double_arg(m));
        AttitudeUpdate { attitude: Self { up, z_rad }, level_frame_rotation: m.conj() * inverse }
    }

    /// Returns the image in the other chart: ŵ = m/numerator, ẑ = z + 2 arg(numerator) + π.
    #[cold]
    #[inline(never)]
    fn rechart(self, numerator: Complex<f64>, m: Complex<f64>) -> AttitudeUpdate {
        let size2 = numerator.norm_sqr();
        let up = Point { w: m * numerator.conj() / size2, chart: self.up.chart.other() };
        let z_rad = wrapped_rad(self.z_rad + double_arg(J * numerator));
        AttitudeUpdate {
            attitude: Self { up, z_rad },
            level_frame_rotation: -numerator.conj() * numerator.conj() / size2,
        }
    }
}

impl Rotation {
    /// Returns the rotation from one attitude to another, q_from* q_to.
    pub fn between(from: Attitude, to: Attitude) -> Self {
        Self::from_quaternion(from.quaternion().conjugate() * to.quaternion())
    }
}

/// Wraps an angle to (−π, π].
#[inline]
pub fn wrapped_rad(angle_rad: f64) -> f64 {
    if angle_rad > -PI && angle_rad <= PI { angle_rad } else { wrap_large_rad(angle_rad) }
}

#[cold]
#[inline(never)]
fn wrap_large_rad(angle_rad: f64) -> f64 {
    let wrapped = angle_rad - TAU * libm::rint(angle_rad / TAU);
    if wrapped.abs() > 4.0 {
        // The angle is so large that the product with 2π is not exact, so the exact remainder is
        // used.
        return libm::remainder(angle_rad, TAU);
    }
    if wrapped <= -PI { wrapped + TAU } else { wrapped }
}

#[inline]
fn double_arg(m: Complex<f64>) -> f64 {
    2.0 * arg(m)
}

/// Returns arg m, rad, (−π, π]. For small angles, such as those within one sample, a series is
/// used.
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

scalars!(Attitude: up, z_rad);
