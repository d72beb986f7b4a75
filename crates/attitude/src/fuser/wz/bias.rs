//! Gyro bias from the levelled force: a Kalman filter of the tilt error and the bias, at 5 Hz.
//!
//! A tilt error ε shows as a horizontal force g ε. A bias b drives it by −j Σ a_i b_i, a_i the horizontal parts of the body's axes;
//! the levelling loop takes from it what it leans, which is known:
//!
//! ε' = −j Σ a_i b_i − κ,   h/g = ε + acceleration/g.
//!
//! The loop stays what it is: of the filter's findings it is only told what the error of the bias, and of the first level, did to
//! it until now. To fuse the tilt itself here would make the level as slow as the filter is sure of its gyro. At rest it is told nothing
//! of that: accelerations of the movement before may have hidden it, and the force shows what is left of both.

use super::{
    initial_velocity::InitialVelocity,
    level::{Error, Response},
    tilt_fault::TiltFaultMonitor,
    time_constants::T1_S,
};
use crate::{
    Complex, GRAVITY_M_S2, J, Vector3, fuser::rest::SD_REST_RAD_S, numbers::Numbers, stage::bias_flaw, state::Axes,
};
use nalgebra::{SMatrix, SVector};

/// Interval of the updates, s; less a little, for sums of intervals that are rounded.
const INTERVAL_S: f64 = 0.2 - 1e-6;
/// Largest standard deviation of the bias, rad/s: a consumer MEMS gyro after its own calibration.
const SD_MAX_RAD_S: f64 = 0.003;
/// Random walk of the bias of a body that does not turn, rad/s/√s: 1 °/s in half a day, 0.1 °/s while it warms up for an hour.
const WALK_RAD_S: f64 = 3e-5;
/// Random walk of the bias, for each rad/s of the rate, 1/√s: what errors of scale and axes make of a rate that changes.
const WALK_BY_RATE: f64 = 2e-4;
/// Random walk of the tilt, rad/√s: noise and coning of a consumer MEMS gyro.
const TILT_WALK_RAD: f64 = 5e-4;
/// Standard deviation of the first level, rad: a hand that swings the body, by 3 m/s² at that moment.
const SD_FIRST_RAD: f64 = 0.3;
/// Standard deviation of a level that was found, rad: a vehicle that accelerates by 1 m/s² at that moment.
const SD_LEVEL_RAD: f64 = 0.1;
/// Least noise of the levelled force over g.
const FORCE_SD_MIN: f64 = 1e-3;
/// Memory of the innovation's mean square, s.
const INNOVATION_MEMORY_S: f64 = 5.0;
/// Standard deviation of the innovation before there were any, at a beginning and in the middle of a movement, and for how long they
/// have been like that.
const FORCE_SD_BEFORE: f64 = 0.01;
const FORCE_SD_MOVING: f64 = 0.1;
const MEMORY_BEFORE_S: f64 = 0.5;
/// Most innovations that count as one because they are alike: accelerations keep their direction for less than 1 s. For longer they
/// are made up for by others, since they bring a velocity that ends.
const ALIKE_MAX: f64 = 4.0;
/// Square of the largest innovation that is believed, in standard deviations.
const OUTLIER2: f64 = 9.0;

/// ε across and along, rad; b_x, b_y, b_z, rad/s.
type State = SVector<f64, 5>;
type Covariance = SMatrix<f64, 5, 5>;

/// Estimates the gyro bias.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct BiasFilter {
    bias_rad_s: Vector3<f64>,
    tilt_rad: Complex<f64>,
    covariance: Covariance,
    /// What a unit of bias about each body axis, and of today's tilt, has to do with the error of the loop.
    bias_share: [Error; 3],
    tilt_share: [f64; 2],
    /// Since the last update.
    drift_s: [Complex<f64>; 3],
    force_dt_m_s: Complex<f64>,
    length_dt_m_s: f64,
    since_update_s: f64,
    tilt_sd_rad: f64,
    noise: Noise,
    tilt_fault: TiltFaultMonitor,
    initial_velocity: InitialVelocity,
}

/// The noise of the levelled force, from the innovations.
#[derive(Debug, Clone, PartialEq)]
struct Noise {
    mean_square: f64,
    mean_product: f64,
    before: Complex<f64>,
    memory_s: f64,
    /// The level is one of a single sample, so that what the force shows may be its error.
    first_level: bool,
}

impl Default for BiasFilter {
    fn default() -> Self {
        Self::of(Vector3::zeros(), SD_MAX_RAD_S, SD_FIRST_RAD)
    }
}

impl BiasFilter {
    /// Begins with a bias and a level of these standard deviations.
    pub(super) fn of(bias_rad_s: Vector3<f64>, bias_sd_rad_s: f64, level_sd_rad: f64) -> Self {
        let (bias_sd, level_sd) = (bias_sd_rad_s.min(SD_MAX_RAD_S), level_sd_rad.min(SD_FIRST_RAD));
        Self {
            bias_rad_s,
            tilt_rad: Complex::new(0.0, 0.0),
            covariance: Covariance::from_diagonal(
                &[level_sd, level_sd, bias_sd, bias_sd, bias_sd].map(|sd| sd * sd).into(),
            ),
            bias_share: [Error::default(); 3],
            tilt_share: [1.0, 0.0],
            drift_s: [Complex::new(0.0, 0.0); 3],
            force_dt_m_s: Complex::new(0.0, 0.0),
            length_dt_m_s: 0.0,
            since_update_s: 0.0,
            tilt_sd_rad: level_sd,
            noise: Noise::before(),
            tilt_fault: TiltFaultMonitor::default(),
            initial_velocity: InitialVelocity::default(),
        }
    }

    /// Goes on with a bias and a level that another stage found, perhaps in the middle of a movement: what the force shows is that
    /// until it has lasted.
    pub(super) fn found(bias_rad_s: Vector3<f64>, bias_sd_rad_s: f64, level_sd_rad: f64) -> Self {
        let begun = Self::of(bias_rad_s, bias_sd_rad_s, level_sd_rad);
        Self { noise: Noise::moving(), initial_velocity: InitialVelocity::begun(), ..begun }
    }

    /// The bias, rad/s, body axes.
    #[inline]
    pub(super) fn bias_rad_s(&self) -> Vector3<f64> {
        self.bias_rad_s
    }

    /// Standard deviation of the inclination, rad.
    #[inline]
    pub(super) fn tilt_sd_rad(&self) -> f64 {
        self.tilt_sd_rad
    }

    /// Standard deviation of the worst component of the bias, rad/s.
    pub(super) fn sd_rad_s(&self) -> f64 {
        libm::sqrt((2..5).map(|i| self.covariance[(i, i)]).fold(0.0, f64::max))
    }

    /// The level begins anew, with an unknown error; the bias stays.
    pub(super) fn restart(&mut self) {
        let mut begun = Self { bias_rad_s: self.bias_rad_s, ..Self::default() };
        begun.covariance.fixed_view_mut::<3, 3>(2, 2).copy_from(&self.covariance.fixed_view::<3, 3>(2, 2));
        *self = begun;
    }

    /// The body's axes were in this position for `dt_s`.
    #[inline]
    pub(super) fn drift(&mut self, axes: &Axes, dt_s: f64) {
        for (drift_s, axis) in self.drift_s.iter_mut().zip(axes.horizontal) {
            *drift_s += axis * dt_s;
        }
    }

    /// The integral of the levelled force over `dt_s`, and the length of the force.
    #[inline]
    pub(super) fn observe(&mut self, force_dt_m_s: Complex<f64>, length_m_s2: f64, dt_s: f64) {
        self.force_dt_m_s += force_dt_m_s;
        self.length_dt_m_s += length_m_s2 * dt_s;
        self.since_update_s += dt_s;
    }

    /// Enough has been seen for an update.
    #[inline]
    pub(super) fn is_due(&self) -> bool {
        self.since_update_s >= INTERVAL_S
    }

    /// For how long the force was seen since the last update, s, and its integral, m/s.
    pub(super) fn seen(&self) -> (f64, Complex<f64>) {
        (self.since_update_s, self.force_dt_m_s)
    }

    /// The update, of a body that turns by `rate_rad_s`. The loop has leaned by `leaned_rad` since the last and has the leaky
    /// velocity `velocity_s`, over g. What the error of the
    /// bias and of the first level had done to the loop until now, to be taken back.
    #[inline(never)]
    pub(super) fn update(
        &mut self,
        rate_rad_s: Vector3<f64>,
        leaned_rad: Complex<f64>,
        bias_at_rest: Option<Vector3<f64>>,
        velocity_s: Complex<f64>,
    ) -> Error {
        let interval_s = self.since_update_s;
        let force = self.force_dt_m_s / (GRAVITY_M_S2 * interval_s);
        let drift = core::mem::take(&mut self.drift_s).map(|axis_s| -J * axis_s);
        let length = core::mem::take(&mut self.length_dt_m_s) / (GRAVITY_M_S2 * interval_s);
        self.force_dt_m_s = Complex::new(0.0, 0.0);
        self.since_update_s = 0.0;
        let walk2 = WALK_RAD_S * WALK_RAD_S + WALK_BY_RATE * WALK_BY_RATE * rate_rad_s.norm_squared();
        self.propagate(&drift, (walk2 * interval_s).min(SD_MAX_RAD_S * SD_MAX_RAD_S), interval_s);
        self.share(&drift, interval_s);

        // The force is that of the middle of the interval.
        let innovation = force - self.tilt_rad + leaned_rad * 0.5;
        self.tilt_rad -= leaned_rad;
        if let Some(wrong_rad) = self.tilt_fault.observe(innovation, force, length, interval_s) {
            return self.begin_anew(wrong_rad, velocity_s);
        }
        let known = 0.5 * (self.covariance[(0, 0)] + self.covariance[(1, 1)]);
        let variance = self.noise.variance(innovation, interval_s, known);
        let mut change = self.update_by(0, innovation.re, variance);
        change += self.update_by(1, innovation.im - change[1], variance);
        if let Some(bias_rad_s) = bias_at_rest {
            self.bias_is(bias_rad_s - self.bias_rad_s, &mut change);
        }
        self.bias_rad_s += change.fixed_rows::<3>(2);
        let tilt = Complex::new(change[0], change[1]);
        let error = if bias_at_rest.is_some() {
            self.settled(velocity_s, force - leaned_rad * 0.5)
        } else {
            self.error(&change)
        };
        self.tilt_rad += tilt - error.tilt;
        let variance = 0.5 * (self.covariance[(0, 0)] + self.covariance[(1, 1)]);
        let under_way = self.initial_velocity.observe(self.tilt_rad, variance, interval_s);
        self.tilt_rad -= under_way.tilt;
        self.tilt_sd_rad = libm::sqrt(self.tilt_rad.norm_sqr() + variance);
        Error { tilt: error.tilt + under_way.tilt, velocity: error.velocity + under_way.velocity }
    }

    /// What the bias, and the first level, had done to the loop, by as much as they have changed.
    fn error(&self, change: &State) -> Error {
        let [x, y, z] = self.bias_share;
        let tilt = Complex::new(change[0], change[1]);
        Error {
            tilt: x.tilt * change[2] + y.tilt * change[3] + z.tilt * change[4] + tilt * self.tilt_share[0],
            velocity: x.velocity * change[2]
                + y.velocity * change[3]
                + z.velocity * change[4]
                + tilt * self.tilt_share[1],
        }
    }

    /// At rest the force shows all that the loop is off by, whatever did it: with the velocity of that tilt alone the loop settles in
    /// T2, and nothing is to be told of what came before.
    fn settled(&mut self, velocity_s: Complex<f64>, tilt_rad: Complex<f64>) -> Error {
        for share in &mut self.bias_share {
            share.velocity = share.tilt * T1_S;
        }
        self.tilt_share[1] = self.tilt_share[0] * T1_S;
        self.initial_velocity = InitialVelocity::default();
        Error { tilt: Complex::new(0.0, 0.0), velocity: velocity_s - tilt_rad * T1_S }
    }

    /// The level was wrong by `wrong_rad` more than was known, so the velocity is its work: level and bias are as unknown as at the
    /// beginning.
    #[cold]
    fn begin_anew(&mut self, wrong_rad: Complex<f64>, velocity_s: Complex<f64>) -> Error {
        let tilt = self.tilt_rad + wrong_rad;
        *self = Self::of(self.bias_rad_s, SD_MAX_RAD_S, SD_LEVEL_RAD);
        Error { tilt, velocity: velocity_s }
    }

    /// P ← F P Fᵀ + Q.
    fn propagate(&mut self, drift: &[Complex<f64>; 3], bias_walk2: f64, interval_s: f64) {
        let p = &mut self.covariance;
        for j in 0..5 {
            p[(0, j)] += drift[0].re * p[(2, j)] + drift[1].re * p[(3, j)] + drift[2].re * p[(4, j)];
            p[(1, j)] += drift[0].im * p[(2, j)] + drift[1].im * p[(3, j)] + drift[2].im * p[(4, j)];
        }
        for i in 0..5 {
            p[(i, 0)] += drift[0].re * p[(i, 2)] + drift[1].re * p[(i, 3)] + drift[2].re * p[(i, 4)];
            p[(i, 1)] += drift[0].im * p[(i, 2)] + drift[1].im * p[(i, 3)] + drift[2].im * p[(i, 4)];
        }
        p[(1, 0)] = p[(0, 1)];
        for i in 0..5 {
            let tilt_walk2 = TILT_WALK_RAD * TILT_WALK_RAD * interval_s;
            let (walk2, most) = if i < 2 { (tilt_walk2, 1.0) } else { (bias_walk2, SD_MAX_RAD_S) };
            p[(i, i)] += walk2;
            if p[(i, i)] > most * most {
                let scale = most / libm::sqrt(p[(i, i)]);
                p.row_mut(i).scale_mut(scale);
                p.column_mut(i).scale_mut(scale);
            }
        }
    }

    /// The shares follow the loop over an interval, half of the drift before and half after.
    fn share(&mut self, drift: &[Complex<f64>; 3], interval_s: f64) {
        let response = Response::over(interval_s);
        let [e0, w0] = self.tilt_share;
        let [e1, w1] = response.after(e0, w0);
        for (share, drift) in self.bias_share.iter_mut().zip(drift) {
            let tilt = share.tilt + drift * (0.5 - 0.5 * e0);
            let velocity = share.velocity - drift * (0.5 * w0);
            let [tilt, velocity] = response.after(tilt, velocity);
            share.tilt = tilt + drift * (0.5 - 0.5 * e1);
            share.velocity = velocity - drift * (0.5 * w1);
        }
        self.tilt_share = [e1, w1];
    }

    /// One component of the tilt was seen; the change of the state.
    fn update_by(&mut self, component: usize, innovation: f64, variance: f64) -> State {
        let column: State = self.covariance.column(component).into();
        let scale = 1.0 / libm::sqrt(column[component] + variance);
        let gain = column * scale;
        self.covariance -= gain * gain.transpose();
        gain * (innovation * scale)
    }

    /// The bias was seen directly, at rest.
    fn bias_is(&mut self, change_rad_s: Vector3<f64>, change: &mut State) {
        change.fixed_rows_mut::<3>(2).copy_from(&change_rad_s);
        for i in 2..5 {
            self.covariance.row_mut(i).fill(0.0);
            self.covariance.column_mut(i).fill(0.0);
            self.covariance[(i, i)] = SD_REST_RAD_S * SD_REST_RAD_S;
        }
    }

    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        let asymmetry = (self.covariance - self.covariance.transpose()).amax();
        let indefinite = asymmetry > 1e-12 || self.covariance.cholesky().is_none();
        bias_flaw(self.bias_rad_s)
            .or(indefinite.then_some("a covariance that is not symmetric and positive"))
            .or_else(|| self.tilt_fault.flaw())
            .or_else(|| self.initial_velocity.flaw())
            .or((self.noise.mean_square < 0.0).then_some("a mean square below zero"))
            .or((self.since_update_s < 0.0 || self.tilt_sd_rad < 0.0 || self.noise.memory_s <= 0.0)
                .then_some("a time or standard deviation below zero"))
    }
}

impl Noise {
    /// Before there were any innovations.
    fn before() -> Self {
        Self {
            mean_square: FORCE_SD_BEFORE * FORCE_SD_BEFORE,
            mean_product: 0.0,
            before: Complex::new(0.0, 0.0),
            memory_s: MEMORY_BEFORE_S,
            first_level: true,
        }
    }

    /// In the middle of a movement.
    fn moving() -> Self {
        Self { mean_square: FORCE_SD_MOVING * FORCE_SD_MOVING, first_level: false, ..Self::before() }
    }

    /// The variance that one innovation stands for, were the next independent of it, on a tilt of the variance `known`.
    ///
    /// Before the memory is full a first level taken in motion is part of the innovations, and they cannot tell it from noise. There
    /// the level is at least the mean of what was seen: a gain of 1/(1 + number of updates).
    fn variance(&mut self, innovation: Complex<f64>, interval_s: f64, known: f64) -> f64 {
        self.memory_s = (self.memory_s + interval_s).min(INNOVATION_MEMORY_S);
        let share = (interval_s / self.memory_s).min(1.0);
        let square = 0.5 * innovation.norm_sqr();
        let product = 0.5 * (innovation.re * self.before.re + innovation.im * self.before.im);
        self.mean_square += (square - self.mean_square) * share;
        self.mean_product += (product - self.mean_product) * share;
        self.before = innovation;
        // The mean of a sequence whose neighbours correlate by ρ varies by (1 + ρ)/(1 − ρ) as much as if they did not.
        let (together, apart) = (self.mean_square + self.mean_product, self.mean_square - self.mean_product);
        let alike = if together < ALIKE_MAX * apart { (together / apart).max(1.0) } else { ALIKE_MAX };
        let variance = FORCE_SD_MIN * FORCE_SD_MIN + (self.mean_square * alike).max(square / OUTLIER2);
        if self.first_level && self.memory_s < INNOVATION_MEMORY_S {
            variance.min(known * (self.memory_s - MEMORY_BEFORE_S) / interval_s)
        } else {
            variance
        }
    }
}

impl Numbers for BiasFilter {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.bias_rad_s.visit(visit);
        self.tilt_rad.visit(visit);
        self.covariance.iter_mut().for_each(&mut *visit);
        for share in &mut self.bias_share {
            share.tilt.visit(visit);
            share.velocity.visit(visit);
        }
        self.tilt_share.iter_mut().for_each(&mut *visit);
        self.drift_s.iter_mut().for_each(|drift_s| drift_s.visit(visit));
        self.force_dt_m_s.visit(visit);
        self.length_dt_m_s.visit(visit);
        self.since_update_s.visit(visit);
        self.tilt_sd_rad.visit(visit);
        self.noise.mean_square.visit(visit);
        self.noise.mean_product.visit(visit);
        self.noise.before.visit(visit);
        self.noise.memory_s.visit(visit);
        self.noise.first_level.visit(visit);
        self.tilt_fault.visit(visit);
        self.initial_velocity.visit(visit);
    }
}
