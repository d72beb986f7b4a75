//! Differential equations of (w, z) and two numerical integrators, for comparison with the exact
//! step.
//!
//! Input: an attitude, the rate over a step and the duration of the step.
//!
//! Output: the attitude after the step.
//!
//! Failure: both integrators drift, which is what the comparison shows.

use crate::{Complex, Vector3, point::Point, state::Attitude};

/// Returns d(u, v, z)/dt in the attitude's chart — Matveev 2025, (18)–(20).
///
/// `rate_rad_s` is in body axes. The result is w' = u' + j v' in 1/s and z' in rad/s.
pub fn derivative(attitude: Attitude, rate_rad_s: Vector3<f64>) -> (Complex<f64>, f64) {
    let (u, v) = (attitude.up.w.re, attitude.up.w.im);
    let rate = attitude.up.chart.flip(rate_rad_s);
    let u_dot = v * rate.z + u * v * rate.x - 0.5 * rate.y * (1.0 + u * u - v * v);
    let v_dot = -u * rate.z - u * v * rate.y + 0.5 * rate.x * (1.0 - u * u + v * v);
    (Complex::new(u_dot, v_dot), rate.z + u * rate.x + v * rate.y)
}

/// Integrates one step by Euler's method, a first-order method: the global error is of the order of
/// dt.
pub fn euler(attitude: Attitude, rate_rad_s: Vector3<f64>, dt_s: f64) -> Attitude {
    advanced(attitude, derivative(attitude, rate_rad_s), dt_s).normalised()
}

/// Integrates one step by the classical fourth-order Runge–Kutta method.
///
/// `rate_rad_s` returns the body rate at a fraction 0, ½ or 1 of the step.
pub fn rk4(attitude: Attitude, rate_rad_s: impl Fn(f64) -> Vector3<f64>, dt_s: f64) -> Attitude {
    let k1 = derivative(attitude, rate_rad_s(0.0));
    let k2 = derivative(advanced(attitude, k1, 0.5 * dt_s), rate_rad_s(0.5));
    let k3 = derivative(advanced(attitude, k2, 0.5 * dt_s), rate_rad_s(0.5));
    let k4 = derivative(advanced(attitude, k3, dt_s), rate_rad_s(1.0));
    let slope = ((k1.0 + (k2.0 + k3.0) * 2.0 + k4.0) / 6.0, (k1.1 + (k2.1 + k3.1) * 2.0 + k4.1) / 6.0);
    advanced(attitude, slope, dt_s).normalised()
}

fn advanced(attitude: Attitude, slope: (Complex<f64>, f64), dt_s: f64) -> Attitude {
    let up = Point { w: attitude.up.w + slope.0 * dt_s, chart: attitude.up.chart };
    Attitude { up, z_rad: attitude.z_rad + slope.1 * dt_s }
}

impl Attitude {
    /// Brings the attitude back within the bounds of its chart after an addition to w or z.
    pub(crate) fn normalised(self) -> Self {
        self.tilted(Complex::new(0.0, 0.0)).attitude
    }
}
