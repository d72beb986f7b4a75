//! The gyro's bias and scale from the levelled force: a Kalman filter of the tilt error and of both, at 5 Hz, of a first level faster.
//!
//! The gyro reads ω + b + m ∘ ω. A tilt error ε shows as a horizontal force g ε. Bias and scale drive it by
//! −j Σ a_i (b_i + m_i ω_i), a_i the horizontal parts of the body's axes; the levelling loop takes from it what it leans, which is known:
//!
//! ε' = −j Σ a_i (b_i + m_i ω_i) − κ,   h/g = ε + acceleration/g.
//!
//! Accelerations are no white noise, but derivatives of a velocity that stays bounded. So the force is also summed to a leaky velocity V
//! with the memory T_c, of which χ is what the tilt error has made: V' = h/g − V/T_c, χ' = ε − χ/T_c, V = χ + velocity/g. Each update
//! uses the one of the two, force or velocity, that says more.
//!
//! The loop stays what it is: of the filter's findings it is only told what the errors of the gyro, and of the first level, did to
//! it until now. To fuse the tilt itself here would make the level as slow as the filter is sure of its gyro. At rest it is told nothing
//! of that: accelerations of the movement before may have hidden it, and the force shows what is left of both.

use core::f64::consts::PI;

use super::{
    initial_velocity::InitialVelocity,
    level::{Error, Response},
    noise::{self, Noise},
    settings::Settings,
    tilt_fault::TiltFaultMonitor,
    time_constants::T1_S,
};
use crate::{
    Complex, GRAVITY_M_S2, J, Vector3,
    fuser::{estimate::Estimate, gyro_scale::GyroScale, rest::SD_REST_RAD_S},
    numbers::Numbers,
    stage::bias_flaw,
    state::Axes,
    turn::Turn,
};
use nalgebra::{SMatrix, SVector};

/// Interval of the updates, s; less a little, for sums of intervals that are rounded.
const INTERVAL_S: f64 = 0.2 - 1e-6;
/// Of a first level the first interval, s, and each after it as a share of the time before: the level follows the mean at once.
const FIRST_INTERVAL_S: f64 = 0.02 - 1e-6;
const FIRST_SHARE: f64 = 0.15;
/// For how long a first level is the mean whatever its noise seems to be, s.
const MEAN_ALONE_S: f64 = 0.6;
/// For how long a first sample stands in that mean, s: the acceleration of a hand changes no faster.
const FIRST_SAMPLE_S: f64 = 0.07;
/// Factor on the deviation of a bias that is taken over together with a level: their errors are
/// correlated, and the correlation is not handed over.
const BESIDE_LEVEL: f64 = core::f64::consts::SQRT_2;
/// Largest standard deviation of the bias, rad/s: a consumer MEMS gyro after its own calibration.
const BIAS_SD_MAX_RAD_S: f64 = 0.003;
/// Largest standard deviation of the scale: the same gyro. Data sheets allow 1 % at most, which is the most that is taken off.
const SCALE_SD_MAX: f64 = 0.002;
const SCALE_MAX: f64 = 0.01;
/// Random walk of the bias besides that of the settings, for each rad/s of the rate, 1/√s: what errors of the axes make of a rate that
/// changes.
const BIAS_WALK_BY_RATE: f64 = 2e-5;
/// Random walk of the scale, 1/√s: what a few degrees of warming make of it in an hour.
const SCALE_WALK: f64 = 1e-5;
/// Random walk of the tilt besides that of the settings, for each rad/s of the rate, 1/√s.
const TILT_WALK_BY_RATE: f64 = 2.5e-4;
/// More is no rate of a body, rad/s; what a body may turn by while nobody measures it: a hand that turns it over.
const RATE_MAX_RAD_S: f64 = 100.0;
const UNSEEN_RAD_S: f64 = 3.0;
/// Standard deviation of the first level, rad: a hand that swings the body, by 3 m/s² at that moment.
const SD_FIRST_RAD: f64 = 0.3;
/// Standard deviation of a level that was found, rad: a vehicle that accelerates by 1 m/s² at that moment.
const SD_LEVEL_RAD: f64 = 0.1;
/// Memory of the velocity, s.
const VELOCITY_MEMORY_S: f64 = 3.0;
/// How long a first level is left to the force alone, s, and the velocity over g that it then has unseen, s.
const FORCE_ALONE_S: f64 = 2.0;
const FIRST_VELOCITY_SD_S: f64 = 0.1;
/// Standard deviation with which a velocity begins that is zero by definition, s.
const VELOCITY_SD_BEGUN_S: f64 = 1e-4;
/// Least noise of the levelled force over g, and of the velocity over g, s.
const FORCE_SD_MIN: f64 = 1e-3;
const VELOCITY_SD_MIN_S: f64 = 5e-3;
/// Standard deviations of the innovations before there were any, at a beginning and in the middle of a movement.
const FORCE_SD_BEFORE: f64 = 0.01;
const FORCE_SD_MOVING: f64 = 0.1;
const VELOCITY_SD_BEFORE_S: f64 = 0.075;
const VELOCITY_SD_MOVING_S: f64 = 0.3;
/// How many innovations count as one because they are alike, at least and at most. Accelerations keep their direction for less than
/// 1 s; for longer they are made up for by others, since they bring a velocity that ends. A velocity keeps its own for seconds.
const FORCES_ALIKE: (f64, f64) = (1.0, 4.0);
const VELOCITIES_ALIKE: (f64, f64) = (10.0, 20.0);

/// Numbers in the state, and where its parts begin: ε across and along, rad; b, rad/s; m; χ across and along, s.
const STATES: usize = 10;
const TILT: usize = 0;
const BIAS: usize = 2;
const SCALE: usize = 5;
const VELOCITY: usize = 8;
/// Errors of the gyro.
const ERRORS: usize = 6;

type State = SVector<f64, STATES>;
type Covariance = SMatrix<f64, STATES, STATES>;
type ErrorCovariance = SMatrix<f64, ERRORS, ERRORS>;

/// Estimates bias and scale of the gyro.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct GyroErrorFilter {
    bias_rad_s: Vector3<f64>,
    scale: Vector3<f64>,
    tilt_rad: Complex<f64>,
    /// V and χ, over g, s.
    velocity_s: Complex<f64>,
    tilt_velocity_s: Complex<f64>,
    covariance: Covariance,
    /// What a unit of bias and of scale about each body axis, and of today's tilt, has to do with the error of the loop.
    share: [Error; ERRORS],
    tilt_share: [f64; 2],
    /// Since the last update: what a unit of bias and of scale did to the tilt.
    drift: [Complex<f64>; ERRORS],
    /// For how long of it nobody saw the body turn, s.
    unseen_s: f64,
    force_dt_m_s: Complex<f64>,
    length_dt_m_s: f64,
    since_update_s: f64,
    tilt_sd_rad: f64,
    force_noise: Noise,
    velocity_noise: Noise,
    /// The level is one of a single sample, so that what the force shows may be its error.
    first_level: bool,
    /// And that sample was taken as it came, not where a level was found to be wrong.
    of_one_sample: bool,
    tilt_fault: TiltFaultMonitor,
    initial_velocity: InitialVelocity,
}

impl Default for GyroErrorFilter {
    fn default() -> Self {
        Self::of(Vector3::zeros(), BIAS_SD_MAX_RAD_S, SD_FIRST_RAD)
    }
}

impl GyroErrorFilter {
    /// Begins with a bias and a level of these standard deviations.
    pub(super) fn of(bias_rad_s: Vector3<f64>, bias_sd_rad_s: f64, level_sd_rad: f64) -> Self {
        let (bias_sd, level_sd) = (bias_sd_rad_s.min(BIAS_SD_MAX_RAD_S), level_sd_rad.min(SD_FIRST_RAD));
        let mut sds = [level_sd; STATES];
        sds[BIAS..SCALE].fill(bias_sd);
        sds[SCALE..VELOCITY].fill(SCALE_SD_MAX);
        sds[VELOCITY..].fill(VELOCITY_SD_BEGUN_S);
        let zero = Complex::new(0.0, 0.0);
        Self {
            bias_rad_s,
            scale: Vector3::zeros(),
            tilt_rad: zero,
            velocity_s: zero,
            tilt_velocity_s: zero,
            covariance: Covariance::from_diagonal(&sds.map(|sd| sd * sd).into()),
            share: [Error::default(); ERRORS],
            tilt_share: [1.0, 0.0],
            drift: [zero; ERRORS],
            unseen_s: 0.0,
            force_dt_m_s: zero,
            length_dt_m_s: 0.0,
            since_update_s: 0.0,
            tilt_sd_rad: level_sd,
            force_noise: Noise::before(FORCE_SD_BEFORE),
            velocity_noise: Noise::before(VELOCITY_SD_BEFORE_S),
            first_level: true,
            of_one_sample: true,
            tilt_fault: TiltFaultMonitor::default(),
            initial_velocity: InitialVelocity::default(),
        }
    }

    /// Goes on with bias, scale and level that another stage found, perhaps in the middle of a movement: what the force shows is that
    /// until it has lasted.
    pub(super) fn found(common: &Estimate) -> Self {
        let Estimate { bias_rad_s, bias_sd_rad_s, inclination_sd_rad, gyro_scale, leaky_velocity, .. } = *common;
        let with_level = inclination_sd_rad < PI;
        let bias_sd_rad_s = if with_level { bias_sd_rad_s * BESIDE_LEVEL } else { bias_sd_rad_s };
        let mut filter = Self {
            force_noise: Noise::before(FORCE_SD_MOVING),
            velocity_noise: Noise::before(VELOCITY_SD_MOVING_S),
            first_level: false,
            of_one_sample: false,
            initial_velocity: InitialVelocity::begun(leaky_velocity.first_sd_m_s()),
            scale: gyro_scale.error.map(|error| error.clamp(-SCALE_MAX, SCALE_MAX)),
            ..Self::of(bias_rad_s, bias_sd_rad_s, inclination_sd_rad)
        };
        for (i, sd) in (SCALE..).zip(gyro_scale.sd.iter()) {
            let sd = sd.min(SCALE_SD_MAX);
            filter.covariance[(i, i)] = sd * sd;
        }
        filter
    }

    /// Standard deviation of what the velocity of the loop still has of the error it began with, m/s.
    pub(super) fn first_velocity_sd_m_s(&self) -> f64 {
        self.initial_velocity.left_sd_m_s()
    }

    /// The bias, rad/s, body axes.
    #[inline]
    pub(super) fn bias_rad_s(&self) -> Vector3<f64> {
        self.bias_rad_s
    }

    /// A turn as the gyro saw it, less what bias and scale add in `dt_s`.
    #[inline]
    pub(super) fn corrected_turn(&self, turn: Turn, dt_s: f64) -> Turn {
        turn.scaled_less(self.scale).less(self.bias_rad_s * (0.5 * dt_s))
    }

    /// A rate as the gyro saw it, rad/s, less what bias and scale add.
    #[inline]
    pub(super) fn corrected_rad_s(&self, rate_rad_s: Vector3<f64>) -> Vector3<f64> {
        rate_rad_s - self.bias_rad_s - self.scale.component_mul(&rate_rad_s)
    }

    /// The error of the scale of each axis.
    pub(super) fn scale(&self) -> GyroScale {
        GyroScale { error: self.scale, sd: Vector3::from(self.scale_variance().map(libm::sqrt)) }
    }

    /// Variance of the scale of each axis.
    #[inline]
    pub(super) fn scale_variance(&self) -> [f64; 3] {
        [SCALE, SCALE + 1, SCALE + 2].map(|i| self.covariance[(i, i)])
    }

    /// Standard deviation of the inclination, rad.
    #[inline]
    pub(super) fn tilt_sd_rad(&self) -> f64 {
        self.tilt_sd_rad
    }

    /// Standard deviation of the worst component of the bias, rad/s.
    pub(super) fn bias_sd_rad_s(&self) -> f64 {
        libm::sqrt((BIAS..SCALE).map(|i| self.covariance[(i, i)]).fold(0.0, f64::max))
    }

    /// The level begins anew, with an unknown error, `of_one_sample` or as it was held; bias and scale stay.
    pub(super) fn restart(&mut self, of_one_sample: bool) {
        let known: ErrorCovariance = self.covariance.fixed_view::<ERRORS, ERRORS>(BIAS, BIAS).into();
        *self = Self { bias_rad_s: self.bias_rad_s, scale: self.scale, of_one_sample, ..Self::default() };
        self.covariance.fixed_view_mut::<ERRORS, ERRORS>(BIAS, BIAS).copy_from(&known);
    }

    /// The body's axes were in this position for `dt_s`, in which the gyro saw it turn by `turn`.
    #[inline]
    pub(super) fn drift(&mut self, axes: &Axes, turn: Turn, dt_s: f64) {
        let turned_rad = [turn.s.re, turn.s.im, turn.p.im].map(|half| 2.0 * half);
        let (by_bias, by_scale) = self.drift.split_at_mut(3);
        for (i, axis) in axes.horizontal.into_iter().enumerate() {
            by_bias[i] += axis * dt_s;
            by_scale[i] += axis * turned_rad[i];
        }
    }

    /// Nobody saw the body turn for `unseen_s`: what the force shows then tells nothing of the gyro.
    #[inline]
    pub(super) fn overlook(&mut self, unseen_s: f64) {
        self.unseen_s += unseen_s;
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
        let least_s =
            if self.of_one_sample { (FIRST_SHARE * self.innovations_s()).max(FIRST_INTERVAL_S) } else { INTERVAL_S };
        self.since_update_s >= least_s.min(INTERVAL_S)
    }

    /// For how long innovations were seen, s, up to what their memory adds to that before the first.
    #[inline]
    fn innovations_s(&self) -> f64 {
        self.force_noise.memory_s() - noise::MEMORY_BEFORE_S
    }

    /// For how long the force was seen since the last update, s, and its integral, m/s.
    pub(super) fn seen(&self) -> (f64, Complex<f64>) {
        (self.since_update_s, self.force_dt_m_s)
    }

    /// The update, of a body that turns by `rate_rad_s`. The loop has leaned by `leaned_rad` since the last and has the leaky
    /// velocity `loop_velocity_s`, over g. What the errors of the gyro and of the first level had done to the loop until now, to be
    /// taken back.
    #[inline(never)]
    pub(super) fn update(
        &mut self,
        rate_rad_s: Vector3<f64>,
        leaned_rad: Complex<f64>,
        bias_at_rest: Option<Vector3<f64>>,
        loop_velocity_s: Complex<f64>,
        settings: &Settings,
    ) -> Error {
        let interval_s = self.since_update_s;
        let force = self.force_dt_m_s / (GRAVITY_M_S2 * interval_s);
        let drift = core::mem::take(&mut self.drift).map(|horizontal| -J * horizontal);
        let length = core::mem::take(&mut self.length_dt_m_s) / (GRAVITY_M_S2 * interval_s);
        self.force_dt_m_s = Complex::new(0.0, 0.0);
        self.since_update_s = 0.0;
        let rate2 = rate_rad_s.norm_squared().min(RATE_MAX_RAD_S * RATE_MAX_RAD_S);
        self.propagate(&drift, rate2, interval_s, settings);
        self.loosen();
        self.follow(&drift, interval_s);

        // The force is that of the middle of the interval.
        let innovation = force - self.tilt_rad + leaned_rad * 0.5;
        self.tilt_rad -= leaned_rad;
        if let Some(wrong_rad) = self.tilt_fault.observe(innovation, force, length, interval_s) {
            return self.begin_anew(wrong_rad, loop_velocity_s);
        }
        let kept = kept(interval_s);
        self.velocity_s = self.velocity_s * kept + force * interval_s;
        self.tilt_velocity_s = self.tilt_velocity_s * kept + (self.tilt_rad + leaned_rad * 0.5) * interval_s;
        let mut change = self.measure(innovation, interval_s);
        if let Some(bias_rad_s) = bias_at_rest {
            self.bias_is(bias_rad_s - self.bias_rad_s, &mut change);
        }
        self.bias_rad_s += change.fixed_rows::<3>(BIAS);
        self.scale = (self.scale + change.fixed_rows::<3>(SCALE)).map(|m| m.clamp(-SCALE_MAX, SCALE_MAX));
        self.tilt_velocity_s += Complex::new(change[VELOCITY], change[VELOCITY + 1]);
        let tilt = Complex::new(change[TILT], change[TILT + 1]);
        let error = if bias_at_rest.is_some() {
            self.settled(loop_velocity_s, force - leaned_rad * 0.5)
        } else {
            self.error(&change)
        };
        self.tilt_rad += tilt - error.tilt;
        let variance = self.tilt_variance_rad2();
        let under_way = self.initial_velocity.observe(self.tilt_rad, variance, interval_s);
        self.tilt_rad -= under_way.tilt;
        self.tilt_sd_rad = libm::sqrt(0.5 * self.tilt_rad.norm_sqr() + variance);
        Error { tilt: error.tilt + under_way.tilt, velocity: error.velocity + under_way.velocity }
    }

    /// Of one axis.
    fn tilt_variance_rad2(&self) -> f64 {
        0.5 * (self.covariance[(TILT, TILT)] + self.covariance[(TILT + 1, TILT + 1)])
    }

    /// By the force or by the velocity, whichever says more; the change of the state.
    ///
    /// Before the memory is full a first level taken in motion is part of the innovations, and they cannot tell it from noise. There
    /// the level is at least the mean of what was seen: a gain of 1/(1 + number of updates). At first it is that mean, of time, while its
    /// variance falls as if what is seen within an interval were one.
    fn measure(&mut self, innovation: Complex<f64>, interval_s: f64) -> State {
        let mut force_variance =
            FORCE_SD_MIN * FORCE_SD_MIN + self.force_noise.variance(innovation, interval_s, FORCES_ALIKE);
        let seen_s = self.innovations_s();
        let of_mean = self.tilt_variance_rad2() * (seen_s - interval_s + INTERVAL_S) / interval_s;
        let tells_less = force_variance > of_mean && self.force_noise.memory_s() < noise::MEMORY_S;
        let is_mean = self.first_level && tells_less || self.of_one_sample && seen_s < MEAN_ALONE_S;
        if is_mean {
            force_variance = of_mean;
        }
        if self.first_level && seen_s < FORCE_ALONE_S {
            self.begin_velocity();
            let mut change = self.measure_at(TILT, innovation, force_variance);
            if is_mean && self.of_one_sample {
                let more = (seen_s + INTERVAL_S) / (seen_s + FIRST_SAMPLE_S);
                change.fixed_rows_mut::<2>(TILT).scale_mut(more);
            }
            return change;
        }
        let off_s = self.velocity_s - self.tilt_velocity_s;
        let velocity_variance =
            VELOCITY_SD_MIN_S * VELOCITY_SD_MIN_S + self.velocity_noise.variance(off_s, interval_s, VELOCITIES_ALIKE);
        if velocity_variance < force_variance * (VELOCITY_MEMORY_S * VELOCITY_MEMORY_S) {
            self.measure_at(VELOCITY, off_s, velocity_variance)
        } else {
            self.measure_at(TILT, innovation, force_variance)
        }
    }

    /// The velocity is summed from here on.
    fn begin_velocity(&mut self) {
        (self.velocity_s, self.tilt_velocity_s) = (Complex::new(0.0, 0.0), Complex::new(0.0, 0.0));
        for i in [VELOCITY, VELOCITY + 1] {
            self.covariance.row_mut(i).fill(0.0);
            self.covariance.column_mut(i).fill(0.0);
            self.covariance[(i, i)] = FIRST_VELOCITY_SD_S * FIRST_VELOCITY_SD_S;
        }
    }

    /// What the errors of the gyro, and the first level, had done to the loop, by as much as they have changed.
    fn error(&self, change: &State) -> Error {
        let tilt = Complex::new(change[TILT], change[TILT + 1]);
        let first = Error { tilt: tilt * self.tilt_share[0], velocity: tilt * self.tilt_share[1] };
        self.share.iter().zip(change.fixed_rows::<ERRORS>(BIAS).iter()).fold(first, |sum, (share, change)| Error {
            tilt: sum.tilt + share.tilt * *change,
            velocity: sum.velocity + share.velocity * *change,
        })
    }

    /// At rest the force shows all that the loop is off by, whatever did it: with the velocity of that tilt alone the loop settles in
    /// T2, and nothing is to be told of what came before.
    fn settled(&mut self, loop_velocity_s: Complex<f64>, tilt_rad: Complex<f64>) -> Error {
        for share in &mut self.share {
            share.velocity = share.tilt * T1_S;
        }
        self.tilt_share[1] = self.tilt_share[0] * T1_S;
        self.initial_velocity = InitialVelocity::default();
        Error { tilt: Complex::new(0.0, 0.0), velocity: loop_velocity_s - tilt_rad * T1_S }
    }

    /// The level was wrong by `wrong_rad` more than was known, so the velocity is its work: level and bias are as unknown as at the
    /// beginning.
    #[cold]
    fn begin_anew(&mut self, wrong_rad: Complex<f64>, loop_velocity_s: Complex<f64>) -> Error {
        let tilt = self.tilt_rad + wrong_rad;
        let mut anew = Self {
            scale: self.scale,
            of_one_sample: false,
            ..Self::of(self.bias_rad_s, BIAS_SD_MAX_RAD_S, SD_LEVEL_RAD)
        };
        let known = self.covariance.fixed_view::<3, 3>(SCALE, SCALE);
        anew.covariance.fixed_view_mut::<3, 3>(SCALE, SCALE).copy_from(&known);
        *self = anew;
        Error { tilt, velocity: loop_velocity_s }
    }

    /// P ← F P Fᵀ + Q.
    fn propagate(&mut self, drift: &[Complex<f64>; ERRORS], rate2: f64, interval_s: f64, settings: &Settings) {
        let p = &mut self.covariance;
        let kept = kept(interval_s);
        let (across, along) = (drift.map(|drift| drift.re), drift.map(|drift| drift.im));
        let sum = |drift: &[f64; ERRORS], of: [f64; ERRORS]| drift.iter().zip(of).map(|(a, b)| a * b).sum::<f64>();
        for j in 0..STATES {
            let of: [f64; ERRORS] = core::array::from_fn(|k| p[(BIAS + k, j)]);
            p[(TILT, j)] += sum(&across, of);
            p[(TILT + 1, j)] += sum(&along, of);
            p[(VELOCITY, j)] = kept * p[(VELOCITY, j)] + interval_s * p[(TILT, j)];
            p[(VELOCITY + 1, j)] = kept * p[(VELOCITY + 1, j)] + interval_s * p[(TILT + 1, j)];
        }
        for i in 0..STATES {
            let of: [f64; ERRORS] = core::array::from_fn(|k| p[(i, BIAS + k)]);
            p[(i, TILT)] += sum(&across, of);
            p[(i, TILT + 1)] += sum(&along, of);
            p[(i, VELOCITY)] = kept * p[(i, VELOCITY)] + interval_s * p[(i, TILT)];
            p[(i, VELOCITY + 1)] = kept * p[(i, VELOCITY + 1)] + interval_s * p[(i, TILT + 1)];
        }
        // Both halves alike to the last bit, where they were summed in another order.
        let summed = [TILT, TILT + 1, VELOCITY, VELOCITY + 1];
        for (k, i) in summed.into_iter().enumerate() {
            summed[k + 1..].iter().for_each(|j| p[(*j, i)] = p[(i, *j)]);
        }
        let square = |walk: f64| walk * walk;
        let (noise_rad, walk_rad_s) =
            (settings.level_noise_deg_sqrt_s.to_radians(), settings.gyro_bias_walk_deg_s_sqrt_s.to_radians());
        let tilt_walk2 = square(noise_rad) + square(TILT_WALK_BY_RATE) * rate2;
        let bias_walk2 = square(walk_rad_s) + square(BIAS_WALK_BY_RATE) * rate2;
        for i in 0..VELOCITY {
            let (walk2, most) = match i {
                TILT..BIAS => (tilt_walk2, 1.0),
                BIAS..SCALE => (bias_walk2, BIAS_SD_MAX_RAD_S),
                _ => (square(SCALE_WALK), SCALE_SD_MAX),
            };
            p[(i, i)] += walk2 * interval_s;
            if p[(i, i)] > most * most {
                let scale = most / libm::sqrt(p[(i, i)]);
                p.row_mut(i).scale_mut(scale);
                p.column_mut(i).scale_mut(scale);
            }
        }
    }

    /// The tilt is as unknown as the turn that nobody saw.
    fn loosen(&mut self) {
        let unseen_rad = (UNSEEN_RAD_S * core::mem::take(&mut self.unseen_s)).min(1.0);
        for i in [TILT, TILT + 1] {
            self.covariance[(i, i)] += unseen_rad * unseen_rad;
        }
    }

    /// The shares follow the loop over an interval, half of the drift before and half after.
    fn follow(&mut self, drift: &[Complex<f64>; ERRORS], interval_s: f64) {
        let response = Response::over(interval_s);
        let [e0, w0] = self.tilt_share;
        let [e1, w1] = response.after(e0, w0);
        for (share, drift) in self.share.iter_mut().zip(drift) {
            let tilt = share.tilt + drift * (0.5 - 0.5 * e0);
            let velocity = share.velocity - drift * (0.5 * w0);
            let [tilt, velocity] = response.after(tilt, velocity);
            share.tilt = tilt + drift * (0.5 - 0.5 * e1);
            share.velocity = velocity - drift * (0.5 * w1);
        }
        self.tilt_share = [e1, w1];
    }

    /// Two components of the state from `first` on were seen; the change of the state.
    fn measure_at(&mut self, first: usize, innovation: Complex<f64>, variance: f64) -> State {
        let change = self.update_by(first, innovation.re, variance);
        change + self.update_by(first + 1, innovation.im - change[first + 1], variance)
    }

    fn update_by(&mut self, component: usize, innovation: f64, variance: f64) -> State {
        let column: State = self.covariance.column(component).into();
        let scale = 1.0 / libm::sqrt(column[component] + variance);
        let gain = column * scale;
        self.covariance -= gain * gain.transpose();
        gain * (innovation * scale)
    }

    /// The bias was seen directly, at rest.
    fn bias_is(&mut self, change_rad_s: Vector3<f64>, change: &mut State) {
        change.fixed_rows_mut::<3>(BIAS).copy_from(&change_rad_s);
        for i in BIAS..SCALE {
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
            .or((self.scale.amax() > SCALE_MAX).then_some("a scale of the gyro that no gyro has"))
            .or(indefinite.then_some("a covariance that is not symmetric and positive"))
            .or_else(|| self.force_noise.flaw())
            .or_else(|| self.velocity_noise.flaw())
            .or_else(|| self.tilt_fault.flaw())
            .or_else(|| self.initial_velocity.flaw())
            .or((self.since_update_s < 0.0 || self.unseen_s < 0.0 || self.tilt_sd_rad < 0.0)
                .then_some("a time or standard deviation below zero"))
    }
}

/// What is left of a velocity after an interval.
fn kept(interval_s: f64) -> f64 {
    libm::exp(-interval_s / VELOCITY_MEMORY_S)
}

impl Numbers for GyroErrorFilter {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.bias_rad_s.visit(visit);
        self.scale.visit(visit);
        self.tilt_rad.visit(visit);
        self.velocity_s.visit(visit);
        self.tilt_velocity_s.visit(visit);
        self.covariance.iter_mut().for_each(&mut *visit);
        for share in &mut self.share {
            share.tilt.visit(visit);
            share.velocity.visit(visit);
        }
        self.tilt_share.iter_mut().for_each(&mut *visit);
        self.drift.iter_mut().for_each(|drift| drift.visit(visit));
        self.unseen_s.visit(visit);
        self.force_dt_m_s.visit(visit);
        self.length_dt_m_s.visit(visit);
        self.since_update_s.visit(visit);
        self.tilt_sd_rad.visit(visit);
        self.force_noise.visit(visit);
        self.velocity_noise.visit(visit);
        self.first_level.visit(visit);
        self.of_one_sample.visit(visit);
        self.tilt_fault.visit(visit);
        self.initial_velocity.visit(visit);
    }
}
