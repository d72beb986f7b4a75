//! Gyro bias from the tilt corrections: a Kalman filter of three states, and two for how the level began.
//!
//! A bias tilts the level, and the levelling loop corrects it; but the correction lags, and in a turning body a lagging correction
//! fed back as an integral pushes the wrong way. Here the response of the correction to a unit bias about each body axis is
//! computed by copies of the loop itself, so that the correction is an exact linear function of the bias:
//!
//! c + C_u = C_x b_x + C_y b_y + C_z b_z + C_0 ε0 + noise,
//!
//! C_u the response to the bias already taken off, ε0 the unknown error of the first level and C_0 the response to it.

use super::{T1_S, T2_S};
use crate::{
    Complex, J, Vector3,
    stage::{Numbers, bias_flaw},
    state::Attitude,
};
use nalgebra::{SMatrix, SVector};

/// Interval of the updates, s.
const INTERVAL_S: f64 = 0.1;
/// Largest standard deviation of the bias, rad/s: a consumer MEMS gyro after its own calibration.
const SD_MAX_RAD_S: f64 = 0.003;
/// Random walk of the bias, rad/s/√s.
const WALK_RAD_S: f64 = 2e-4;
/// Standard deviation of the bias found at rest, rad/s.
const SD_REST_RAD_S: f64 = 5e-4;
/// Standard deviation of the first level, rad: a vehicle that accelerates by 1 m/s² at that moment.
const SD_LEVEL_RAD: f64 = 0.1;
/// Least noise of the correction, rad/s.
const CORRECTION_SD_MIN_RAD_S: f64 = 1e-3;
/// Memory of the innovation's mean square, s.
const INNOVATION_MEMORY_S: f64 = 5.0;
/// Time over which accelerations are alike, s.
const CORRELATION_S: f64 = 1.0;

/// Relative error that rounding may leave in the covariance.
const ROUNDING: f64 = 1e-6;
/// Larger than any response to a unit bias: that of a level left to itself for eleven days, s.
const FAR: f64 = 1e6;

/// b_x, b_y, b_z in rad/s, ε0 across and along in rad.
type State = SVector<f64, 5>;

/// A copy of the levelling loop, driven by a bias instead of by a force: the tilt error E and the velocity W it causes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Response {
    pub(super) tilt: Complex<f64>,
    pub(super) velocity: Complex<f64>,
}

impl Response {
    /// The loop's correction, as it reads this response.
    fn correction(self) -> Complex<f64> {
        self.velocity / (T1_S * T2_S)
    }
}

/// Estimates the gyro bias.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct BiasFilter {
    state: State,
    covariance: SMatrix<f64, 5, 5>,
    /// To a unit bias about ξ, η, ζ.
    unit: [Response; 3],
    /// To the bias taken off.
    taken_off: Response,
    /// To a unit error of the first level.
    level: Response,
    since_update_s: f64,
    innovation2_rad2_s2: f64,
}

impl Default for BiasFilter {
    fn default() -> Self {
        Self {
            state: State::zeros(),
            covariance: SMatrix::from_diagonal(
                &[SD_MAX_RAD_S, SD_MAX_RAD_S, SD_MAX_RAD_S, SD_LEVEL_RAD, SD_LEVEL_RAD].map(|sd| sd * sd).into(),
            ),
            unit: [Response::default(); 3],
            taken_off: Response::default(),
            level: Response { tilt: Complex::new(1.0, 0.0), velocity: Complex::new(0.0, 0.0) },
            since_update_s: 0.0,
            innovation2_rad2_s2: 0.0,
        }
    }
}

impl BiasFilter {
    /// The bias, rad/s, body axes.
    pub(super) fn bias_rad_s(&self) -> Vector3<f64> {
        self.state.fixed_rows::<3>(0).into()
    }

    /// Mean square of the innovation of the tilt correction, rad²/s².
    pub(super) fn innovation2_rad2_s2(&self) -> f64 {
        self.innovation2_rad2_s2
    }

    /// Standard deviation of the worst component of the bias, rad/s.
    pub(super) fn sd_rad_s(&self) -> f64 {
        libm::sqrt((0..3).map(|i| self.covariance[(i, i)]).fold(0.0, f64::max))
    }

    /// Goes on from a bias and a level that another stage found.
    pub(super) fn adopt(&mut self, bias_rad_s: Vector3<f64>, bias_sd_rad_s: f64, level_sd_rad: f64) {
        let mut begun = Self::default();
        begun.state.fixed_rows_mut::<3>(0).copy_from(&bias_rad_s);
        for (i, sd) in [bias_sd_rad_s, bias_sd_rad_s, bias_sd_rad_s, level_sd_rad, level_sd_rad].into_iter().enumerate()
        {
            begun.covariance[(i, i)] = begun.covariance[(i, i)].min(sd * sd);
        }
        *self = begun;
    }

    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        let variance = |i: usize| self.covariance[(i, i)];
        // The update keeps symmetry up to rounding.
        let lopsided = |(i, j): (usize, usize)| {
            let (one, other) = (self.covariance[(i, j)], self.covariance[(j, i)]);
            let bound = libm::sqrt(variance(i) * variance(j)) * (1.0 + ROUNDING) + f64::EPSILON;
            libm::fabs(one) > bound || libm::fabs(one - other) > ROUNDING * bound + f64::EPSILON
        };
        let far = |response: &Response| response.tilt.norm_sqr().max(response.velocity.norm_sqr()) > FAR * FAR;
        let flaws = [
            ((0..5).any(|i| variance(i) < 0.0) || self.innovation2_rad2_s2 < 0.0, "a variance below zero"),
            ((0..5).any(|i| (0..i).any(|j| lopsided((i, j)))), "a covariance that is not one"),
            (self.state.fixed_rows::<2>(3).amax() > 1.0, "a level that is off by more than 1 rad"),
            (self.unit.iter().chain([&self.taken_off, &self.level]).any(far), "a response that no bias has"),
            (!(0.0..=1.0).contains(&self.since_update_s), "an interval that is not one"),
        ];
        let flaw = flaws.into_iter().find(|(holds, _)| *holds).map(|(_, flaw)| flaw);
        bias_flaw(self.bias_rad_s()).or(flaw)
    }

    /// The level frame turned by the inverse of `swing`.
    pub(super) fn swing(&mut self, swing: Complex<f64>) {
        for response in self.responses() {
            response.tilt *= swing;
            response.velocity *= swing;
        }
    }

    /// What a bias did to the level over one interval: ε' = −j h(b).
    pub(super) fn drift(&mut self, attitude: Attitude, dt_s: f64) {
        for (i, axis) in attitude.horizontal_axes().into_iter().enumerate() {
            let drift_rad = -J * axis * dt_s;
            self.unit[i].tilt += drift_rad;
            self.taken_off.tilt += drift_rad * self.state[i];
        }
    }

    /// The copies of the loop correct as the loop did, by `correction_rad_s`. When that has updated the bias: what the error of
    /// the bias and of the first level had done to the loop until now, to be taken back.
    pub(super) fn follow(&mut self, correction_rad_s: Complex<f64>, dt_s: f64) -> Option<Response> {
        for response in self.responses() {
            response.velocity += (response.tilt - response.velocity / T1_S) * dt_s;
            response.tilt -= response.correction() * dt_s;
        }
        self.since_update_s += dt_s;
        if self.since_update_s < INTERVAL_S {
            return None;
        }
        self.update(correction_rad_s, self.since_update_s);
        self.since_update_s = 0.0;
        Some(self.take_back())
    }

    /// The known part of the loop's error, which leaves the regressors with it.
    fn take_back(&mut self) -> Response {
        let level = Complex::new(self.state[3], self.state[4]);
        let known = |part: fn(&Response) -> Complex<f64>| {
            let bias = part(&self.unit[0]) * self.state[0]
                + part(&self.unit[1]) * self.state[1]
                + part(&self.unit[2]) * self.state[2];
            (bias, bias - part(&self.taken_off) + part(&self.level) * level)
        };
        let ((tilt, tilt_known), (velocity, velocity_known)) = (known(|r| r.tilt), known(|r| r.velocity));
        self.taken_off = Response { tilt, velocity };
        self.state[3] = 0.0;
        self.state[4] = 0.0;
        Response { tilt: tilt_known, velocity: velocity_known }
    }

    /// The level begins anew, with an unknown error; the bias stays.
    pub(super) fn restart(&mut self) {
        let Self { state, mut covariance, .. } = *self;
        for i in 3..5 {
            covariance.row_mut(i).fill(0.0);
            covariance.column_mut(i).fill(0.0);
            covariance[(i, i)] = SD_LEVEL_RAD * SD_LEVEL_RAD;
        }
        *self = Self { state, covariance, ..Self::default() };
    }

    /// The bias was seen directly, at rest.
    pub(super) fn at_rest(&mut self, bias_rad_s: Vector3<f64>) {
        self.state.fixed_rows_mut::<3>(0).copy_from(&bias_rad_s);
        for i in 0..3 {
            self.covariance.row_mut(i).fill(0.0);
            self.covariance.column_mut(i).fill(0.0);
            self.covariance[(i, i)] = SD_REST_RAD_S * SD_REST_RAD_S;
        }
    }

    fn responses(&mut self) -> impl Iterator<Item = &mut Response> {
        self.unit.iter_mut().chain([&mut self.taken_off, &mut self.level])
    }

    fn update(&mut self, correction_rad_s: Complex<f64>, interval_s: f64) {
        for i in 0..3 {
            let cap = SD_MAX_RAD_S * SD_MAX_RAD_S;
            let variance = &mut self.covariance[(i, i)];
            *variance = (*variance + WALK_RAD_S * WALK_RAD_S * interval_s).min(cap);
        }
        let [x, y, z] = self.unit.map(Response::correction);
        let level = self.level.correction();
        let seen = correction_rad_s + self.taken_off.correction();
        let noise =
            (CORRECTION_SD_MIN_RAD_S * CORRECTION_SD_MIN_RAD_S + self.innovation2_rad2_s2 * CORRELATION_S) / interval_s;
        let across = self.update_by(seen.re, State::new(x.re, y.re, z.re, level.re, -level.im), noise);
        let along = self.update_by(seen.im, State::new(x.im, y.im, z.im, level.im, level.re), noise);
        let share = (interval_s / INNOVATION_MEMORY_S).min(1.0);
        self.innovation2_rad2_s2 += ((across * across + along * along) / 2.0 - self.innovation2_rad2_s2) * share;
    }

    /// One scalar measurement; its innovation.
    fn update_by(&mut self, seen: f64, regressor: State, noise: f64) -> f64 {
        let innovation = seen - regressor.dot(&self.state);
        let spread = self.covariance * regressor;
        let gain = spread / (regressor.dot(&spread) + noise);
        self.state += gain * innovation;
        self.covariance -= gain * spread.transpose();
        innovation
    }
}

impl Numbers for BiasFilter {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.state.iter_mut().for_each(&mut *visit);
        self.covariance.iter_mut().for_each(&mut *visit);
        for response in self.responses() {
            response.tilt.visit(visit);
            response.velocity.visit(visit);
        }
        self.since_update_s.visit(visit);
        self.innovation2_rad2_s2.visit(visit);
    }
}
