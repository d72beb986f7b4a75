//! Kalman filter of gyro bias and scale, driven by the levelled specific force.
//!
//! Updates run at 5 Hz, and more often just after the level was initialised.
//!
//! The gyro reads ω + b + m ∘ ω, with the rate ω, the bias b and the scale error m of each axis. A
//! tilt error ε appears as a horizontal force h = g ε. Bias and scale change the tilt error at the
//! rate −j Σ a_i (b_i + m_i ω_i), where a_i is the horizontal part of body axis i. The levelling
//! loop corrects the tilt at the known rate κ:
//!
//! ε' = −j Σ a_i (b_i + m_i ω_i) − κ,   h/g = ε + acceleration/g.
//!
//! Accelerations are not white noise, but derivatives of a bounded velocity. The force is therefore
//! also integrated to a leaky velocity V with the time constant T_c. The part of V caused by the
//! tilt error is χ: V' = h/g − V/T_c, χ' = ε − χ/T_c, V = χ + velocity/g. Each update uses the
//! force or the velocity, whichever is more informative.
//!
//! The levelling loop keeps its own dynamics. The filter corrects only the accumulated effect of
//! the gyro errors and of the initial level error. If it applied the estimated tilt itself, the
//! level would respond more slowly as the filter becomes more certain of the gyro. At rest, the
//! correction is derived from the force instead, which then shows the remaining error directly. The
//! accumulated effect is not used there, because accelerations before the rest may have masked it.

use core::f64::consts::PI;

use super::{
    heading::Drift,
    initial_velocity::InitialVelocityEstimator,
    level::{LoopError, LoopResponse},
    noise::{self, InnovationNoise},
    settings::Settings,
    tilt_fault::TiltFaultMonitor,
    time_constants::T1_S,
};
use crate::{
    Complex, GRAVITY_M_S2, J, Vector3,
    fuser::{estimate::Estimate, gyro_scale::GyroScale, rest::BIAS_SD_AT_REST_RAD_S},
    rotation::Rotation,
    scalars::{Scalars, visit_fields},
    stage::bias_validation_error,
    state::BodyAxes,
};
use nalgebra::{SMatrix, SVector};

/// Interval of the updates, s. Slightly below 0.2 s to tolerate rounding in sums of intervals.
const UPDATE_INTERVAL_S: f64 = 0.2 - 1e-6;
/// First update interval after the level is initialised, s. Short intervals let the level follow
/// the mean force from the start.
const INITIAL_INTERVAL_S: f64 = 0.02 - 1e-6;
/// Length of the update intervals after the first, as a fraction of the time since the level was
/// initialised.
///
/// The length is limited to [`UPDATE_INTERVAL_S`].
const INITIAL_INTERVAL_FRACTION: f64 = 0.15;
/// Time after initialisation during which the level follows the plain mean of the force, s.
///
/// The estimated noise has no influence during this time.
const MEAN_ONLY_S: f64 = 0.6;
/// Duration that the first sample represents in the mean force after initialisation, s. A hand does
/// not change its acceleration within a shorter time.
const FIRST_SAMPLE_DURATION_S: f64 = 0.07;
/// Factor applied to the standard deviation of a bias that is adopted together with a level. It
/// allows for the correlation between the errors of bias and level, which is not handed over.
const JOINT_HANDOVER_SD_FACTOR: f64 = core::f64::consts::SQRT_2;
/// Largest standard deviation of the bias, rad/s. It is that of a consumer MEMS gyro after its own
/// calibration.
const MAX_BIAS_SD_RAD_S: f64 = 0.003;
/// Largest change of the bias at a rest that is corrected without a restart, rad/s.
///
/// The change is the difference between the estimated bias and the bias measured at rest. The limit
/// is five standard deviations of a calibrated gyro.
const MAX_LINEAR_BIAS_CHANGE_RAD_S: f64 = 5.0 * MAX_BIAS_SD_RAD_S;
/// Largest standard deviation of the scale error, for a consumer MEMS gyro.
const MAX_SCALE_SD: f64 = 0.002;
/// Largest scale error that is corrected. Data sheets allow at most 1 %.
const MAX_SCALE: f64 = 0.01;
/// Additional random walk of the bias per unit of rate, 1/√s.
///
/// This random walk models the effect of misaligned axes at a changing rate.
const BIAS_WALK_PER_RATE: f64 = 2e-5;
/// Random walk of the scale error, 1/√s. It models the effect of a few degrees of warming in an
/// hour.
const SCALE_WALK: f64 = 1e-5;
/// Additional random walk of the tilt per unit of rate, √s.
const TILT_WALK_PER_RATE: f64 = 2.5e-4;
/// Largest rate used for the process noise, rad/s.
const MAX_RATE_RAD_S: f64 = 100.0;
/// Rate assumed during a gyro outage, rad/s. A body turned over by hand rotates at about this rate.
pub(super) const ASSUMED_UNOBSERVED_RATE_RAD_S: f64 = 3.0;
/// Standard deviation of an initial level, rad. It allows for a body that is moved by hand with an
/// acceleration of 3 m/s² when the level is initialised.
const INITIAL_LEVEL_SD_RAD: f64 = 0.3;
/// Standard deviation of a level after a tilt fault, rad. It allows for a vehicle that accelerates
/// by 1 m/s² when the level is re-initialised.
const REINITIALISED_LEVEL_SD_RAD: f64 = 0.1;
/// Time constant of the leaky velocity, s.
const VELOCITY_MEMORY_S: f64 = 3.0;
/// Time after the initialisation of the level during which only the force is used, s.
const FORCE_ONLY_S: f64 = 2.0;
/// Standard deviation of the velocity divided by g after [`FORCE_ONLY_S`], s.
const INITIAL_VELOCITY_SD_S: f64 = 0.1;
/// Initial standard deviation of χ, s. χ is the velocity caused by the tilt error, divided by g. It
/// starts at zero by definition.
const ZERO_VELOCITY_SD_S: f64 = 1e-4;
/// Smallest assumed standard deviation of the noise of the levelled force, divided by g.
const MIN_FORCE_SD: f64 = 1e-3;
/// Lower limit of the assumed velocity noise (standard deviation) divided by g, s.
const MIN_VELOCITY_SD_S: f64 = 6e-3;
/// Initial standard deviation of the force innovations after a start.
const INITIAL_FORCE_INNOVATION_SD: f64 = 0.01;
/// Initial standard deviation of the force innovations after a hand-over.
///
/// A hand-over may happen in the middle of a movement.
const MOVING_FORCE_INNOVATION_SD: f64 = 0.1;
/// Initial standard deviation of the velocity innovations after a start, s.
const INITIAL_VELOCITY_INNOVATION_SD_S: f64 = 0.075;
/// Initial standard deviation of the velocity innovations after a hand-over, s.
const MOVING_VELOCITY_INNOVATION_SD_S: f64 = 0.3;
/// Lower and upper limit for the number of successive force innovations that count as one
/// independent innovation. The number can exceed one because successive innovations are correlated.
///
/// Accelerations keep their direction for less than 1 s. Over longer times they cancel, because the
/// resulting velocity does not persist.
const FORCE_CORRELATION: (f64, f64) = (1.0, 4.0);
/// Lower and upper limit for the number of successive velocity innovations that count as one
/// independent innovation. The number is large because a velocity keeps its direction for seconds.
const VELOCITY_CORRELATION: (f64, f64) = (10.0, 20.0);

/// Largest squared heading drift that is consistent with its uncertainty.
///
/// The squared drift is divided by the sum of the variances of drift and bias. After a larger
/// drift, the bias about the vertical counts as unknown.
const MAX_DRIFT2: f64 = 9.0;
/// Largest variance of a heading drift that is used as a measurement of the bias.
///
/// The limit is a fraction of the variance of the bias about the vertical. A drift that is no
/// better known than the bias contains no new information, because the bias may have been derived
/// from that drift.
const MAX_DRIFT_VARIANCE_FRACTION: f64 = 0.25;

/// Number of states.
const STATES: usize = 10;
/// Index of the tilt error ε (two axes), rad.
const TILT: usize = 0;
/// Index of the gyro bias b, rad/s.
const BIAS: usize = 2;
/// Index of the gyro scale error m.
const SCALE: usize = 5;
/// Index of χ, the velocity caused by the tilt error, divided by g (two axes), s.
const VELOCITY: usize = 8;
/// Number of gyro errors: a bias and a scale error of each of the three axes.
const GYRO_ERRORS: usize = 6;

type State = SVector<f64, STATES>;
type Covariance = SMatrix<f64, STATES, STATES>;
type ErrorCovariance = SMatrix<f64, GYRO_ERRORS, GYRO_ERRORS>;

/// Input of an update.
#[derive(Debug, Clone, Copy)]
pub(super) struct UpdateInput {
    pub(super) rate_rad_s: Vector3<f64>,
    /// Tilt that the loop has applied since the last update, rad.
    pub(super) tilt_correction_rad: Complex<f64>,
    /// Mean rate at rest, rad/s; `None` while the body moves.
    pub(super) bias_at_rest: Option<Vector3<f64>>,
    /// Leaky velocity of the loop divided by g, s.
    pub(super) loop_velocity_s: Complex<f64>,
    /// Time constant of the loop's tilt, s.
    pub(super) t2_s: f64,
}

/// State at the end of an interval, before the measurement of the interval is used.
#[derive(Debug, Clone, Copy)]
struct Prediction {
    innovation: Complex<f64>,
    /// Mean levelled force divided by g.
    force: Complex<f64>,
    interval_s: f64,
}

/// Result of an update.
#[derive(Debug, Clone, Copy)]
pub(super) struct UpdateOutcome {
    /// Remaining error of the loop, accumulated from the gyro errors and the initial level error.
    pub(super) error: LoopError,
    /// Horizontal force divided by g, without the part that the estimated tilt error causes.
    pub(super) acceleration: Complex<f64>,
    /// `true` if the filter was restarted after a tilt fault.
    pub(super) is_restarted: bool,
}

/// Samples accumulated since the last update, and the gyro errors that were removed from them.
#[derive(Debug, Clone, Copy)]
pub(super) struct Samples {
    drift: [Complex<f64>; GYRO_ERRORS],
    outage_s: f64,
    force_dt_m_s: Complex<f64>,
    since_update_s: f64,
    bias_rad_s: Vector3<f64>,
    scale: Vector3<f64>,
}

impl Samples {
    /// Returns the duration of the samples, s.
    pub(super) fn interval_s(&self) -> f64 {
        self.since_update_s
    }
}

/// Kalman filter of gyro bias and scale.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct GyroErrorFilter {
    bias_rad_s: Vector3<f64>,
    scale: Vector3<f64>,
    tilt_rad: Complex<f64>,
    /// Leaky velocity V divided by g, s.
    velocity_s: Complex<f64>,
    /// χ, s: the part of the leaky velocity that was caused by the tilt error, divided by g.
    tilt_velocity_s: Complex<f64>,
    covariance: Covariance,
    /// Error of the levelling loop per unit of bias and of scale about each body axis.
    loop_sensitivity: [LoopError; GYRO_ERRORS],
    /// Tilt and velocity errors of the levelling loop per unit of initial level error.
    tilt_sensitivity: [f64; 2],
    /// Horizontal rotation due to the gyro errors since the last update, per unit of bias and of
    /// scale.
    drift: [Complex<f64>; GYRO_ERRORS],
    /// Duration of gyro outages since the last update, s.
    outage_s: f64,
    force_dt_m_s: Complex<f64>,
    norm_dt_m_s: f64,
    since_update_s: f64,
    tilt_sd_rad: f64,
    /// Standard deviation of the bias about a horizontal axis, rad/s.
    horizontal_bias_sd_rad_s: f64,
    /// Upper limit of the bias's standard deviation, rad/s.
    max_bias_sd_rad_s: f64,
    force_noise: InnovationNoise,
    velocity_noise: InnovationNoise,
    /// Set unless the level was adopted from another filter or stage. If set, the force may show
    /// the error of the initial level.
    is_initial_level: bool,
    /// Set if the level was initialised from one sample. Not set if the level was kept through an
    /// outage, corrected after a tilt fault or adopted from another filter or stage.
    from_one_sample: bool,
    tilt_fault: TiltFaultMonitor,
    initial_velocity: InitialVelocityEstimator,
}

impl Default for GyroErrorFilter {
    fn default() -> Self {
        Self::new(Vector3::zeros(), MAX_BIAS_SD_RAD_S, INITIAL_LEVEL_SD_RAD)
    }
}

impl GyroErrorFilter {
    /// Creates a filter with the given bias and the standard deviations of bias and level.
    pub(super) fn new(bias_rad_s: Vector3<f64>, bias_sd_rad_s: f64, level_sd_rad: f64) -> Self {
        let (bias_sd, level_sd) = (bias_sd_rad_s.min(MAX_BIAS_SD_RAD_S), level_sd_rad.min(INITIAL_LEVEL_SD_RAD));
        let mut sds = [level_sd; STATES];
        sds[BIAS..SCALE].fill(bias_sd);
        sds[SCALE..VELOCITY].fill(MAX_SCALE_SD);
        sds[VELOCITY..].fill(ZERO_VELOCITY_SD_S);
        let zero = Complex::new(0.0, 0.0);
        Self {
            bias_rad_s,
            scale: Vector3::zeros(),
            tilt_rad: zero,
            velocity_s: zero,
            tilt_velocity_s: zero,
            covariance: Covariance::from_diagonal(&sds.map(|sd| sd * sd).into()),
            loop_sensitivity: [LoopError::default(); GYRO_ERRORS],
            tilt_sensitivity: [1.0, 0.0],
            drift: [zero; GYRO_ERRORS],
            outage_s: 0.0,
            force_dt_m_s: zero,
            norm_dt_m_s: 0.0,
            since_update_s: 0.0,
            tilt_sd_rad: level_sd,
            horizontal_bias_sd_rad_s: bias_sd,
            max_bias_sd_rad_s: MAX_BIAS_SD_RAD_S,
            force_noise: InnovationNoise::new(INITIAL_FORCE_INNOVATION_SD),
            velocity_noise: InnovationNoise::new(INITIAL_VELOCITY_INNOVATION_SD_S),
            is_initial_level: true,
            from_one_sample: true,
            tilt_fault: TiltFaultMonitor::default(),
            initial_velocity: InitialVelocityEstimator::default(),
        }
    }

    /// Creates a filter from the bias, scale and level of another stage.
    ///
    /// The body may be in the middle of a movement, so the innovations are assumed to be those of a
    /// moving body until enough of them have been observed.
    pub(super) fn from_estimate(common: &Estimate) -> Self {
        let Estimate { bias_rad_s, bias_sd_rad_s, inclination_sd_rad, gyro_scale, leaky_velocity, .. } = *common;
        let has_level = inclination_sd_rad < PI;
        let bias_sd_rad_s = if has_level { bias_sd_rad_s * JOINT_HANDOVER_SD_FACTOR } else { bias_sd_rad_s };
        let mut filter = Self {
            force_noise: InnovationNoise::new(MOVING_FORCE_INNOVATION_SD),
            velocity_noise: InnovationNoise::new(MOVING_VELOCITY_INNOVATION_SD_S),
            is_initial_level: false,
            from_one_sample: false,
            initial_velocity: InitialVelocityEstimator::new(leaky_velocity.initial_sd_m_s()),
            scale: gyro_scale.error.map(|error| error.clamp(-MAX_SCALE, MAX_SCALE)),
            ..Self::new(bias_rad_s, bias_sd_rad_s, inclination_sd_rad)
        };
        for (i, sd) in (SCALE..).zip(gyro_scale.sd.iter()) {
            let sd = sd.min(MAX_SCALE_SD);
            filter.covariance[(i, i)] = sd * sd;
        }
        filter
    }

    /// Creates a copy in which the standard deviation of the bias is `bias_sd_rad_s`. The copy is
    /// updated by [`Self::update_unused`].
    pub(super) fn with_unknown_bias(&self, bias_sd_rad_s: f64) -> Self {
        let mut copy = Self { max_bias_sd_rad_s: bias_sd_rad_s, ..self.clone() };
        for i in BIAS..SCALE {
            copy.covariance.row_mut(i).fill(0.0);
            copy.covariance.column_mut(i).fill(0.0);
            copy.covariance[(i, i)] = bias_sd_rad_s * bias_sd_rad_s;
        }
        copy
    }

    /// Returns the samples accumulated since the last update.
    pub(super) fn samples(&self) -> Samples {
        let Self { bias_rad_s, scale, drift, outage_s, force_dt_m_s, since_update_s, .. } = *self;
        Samples { drift, outage_s, force_dt_m_s, since_update_s, bias_rad_s, scale }
    }

    /// Updates a filter that runs in parallel with another one. `samples` are those of the other
    /// filter, together with the gyro errors that it removed from them.
    ///
    /// `corrected_rad` is the tilt that the other filter has corrected.
    pub(super) fn update_unused(
        &mut self,
        samples: &Samples,
        input: &UpdateInput,
        corrected_rad: Complex<f64>,
        settings: &Settings,
    ) {
        self.drift = samples.drift;
        self.outage_s = samples.outage_s;
        self.force_dt_m_s = samples.force_dt_m_s;
        self.since_update_s = samples.since_update_s;
        // The other filter has removed its own bias and scale from the samples. The samples
        // therefore still contain the difference between these errors and those of this filter.
        let bias_rad_s = self.bias_rad_s - samples.bias_rad_s;
        let scale = self.scale - samples.scale;
        for (drift, error) in samples.drift.iter().zip(bias_rad_s.iter().chain(scale.iter())) {
            self.tilt_rad -= J * *drift * *error;
        }
        let Prediction { innovation, interval_s, .. } = self.predict(input, settings);
        let change = self.measure(innovation, interval_s);
        self.apply(&change);
        self.tilt_rad -= corrected_rad;
    }

    /// Returns the squared distance between the biases of two filters in standard deviations.
    pub(super) fn bias_distance2(&self, other: &Self) -> f64 {
        let difference_rad_s = self.bias_rad_s - other.bias_rad_s;
        let covariance: SMatrix<f64, 3, 3> = self.covariance.fixed_view::<3, 3>(BIAS, BIAS).into();
        covariance.cholesky().map_or(0.0, |factor| difference_rad_s.dot(&factor.solve(&difference_rad_s)))
    }

    /// Returns the norm of the difference between the biases of two filters, rad/s.
    pub(super) fn bias_difference_rad_s(&self, other: &Self) -> f64 {
        (self.bias_rad_s - other.bias_rad_s).norm()
    }

    /// Prepares a parallel filter to replace the loop's filter. Returns the error of the loop. The
    /// entire velocity of the loop counts as error, because the wrong bias caused it.
    pub(super) fn take_over(&mut self, loop_velocity_s: Complex<f64>) -> LoopError {
        self.loop_sensitivity = [LoopError::default(); GYRO_ERRORS];
        self.tilt_sensitivity = [0.0, 0.0];
        self.initial_velocity = InitialVelocityEstimator::default();
        self.tilt_fault = TiltFaultMonitor::default();
        self.is_initial_level = false;
        self.from_one_sample = false;
        LoopError { tilt: core::mem::take(&mut self.tilt_rad), velocity: loop_velocity_s }
    }

    /// Returns the standard deviation of the bias about a direction in body axes, rad/s.
    pub(super) fn bias_sd_about(&self, direction: Vector3<f64>) -> f64 {
        let covariance: SMatrix<f64, 3, 3> = self.covariance.fixed_view::<3, 3>(BIAS, BIAS).into();
        libm::sqrt(direction.dot(&(covariance * direction)).max(0.0))
    }

    /// Returns the standard deviation of the bias about a horizontal axis, rad/s.
    pub(super) fn horizontal_bias_sd_rad_s(&self) -> f64 {
        self.horizontal_bias_sd_rad_s
    }

    /// Returns the standard deviation (rad) of the rotation about one horizontal axis that the bias
    /// error causes. `drift` is the rotation per unit of bias.
    fn bias_sd_across(&self, drift: &[Complex<f64>; GYRO_ERRORS]) -> f64 {
        let across = Vector3::new(drift[0].re, drift[1].re, drift[2].re);
        let along = Vector3::new(drift[0].im, drift[1].im, drift[2].im);
        libm::hypot(self.bias_sd_about(across), self.bias_sd_about(along)) * core::f64::consts::FRAC_1_SQRT_2
    }

    /// Returns the standard deviation of the remaining error of the loop's initial velocity, m/s.
    pub(super) fn initial_velocity_sd_m_s(&self) -> f64 {
        self.initial_velocity.remaining_sd_m_s()
    }

    #[inline]
    pub(super) fn bias_rad_s(&self) -> Vector3<f64> {
        self.bias_rad_s
    }

    /// Removes bias and scale error from a rotation measured by the gyro over `dt_s`.
    #[inline]
    pub(super) fn corrected_rotation(&self, rotation: Rotation, dt_s: f64) -> Rotation {
        let bias_rad_s = self.bias_rad_s - self.scale.component_mul(&self.bias_rad_s);
        rotation.minus_fraction(self.scale).minus_half_angle(bias_rad_s * (0.5 * dt_s))
    }

    /// Removes bias and scale error from a rate measured by the gyro, rad/s.
    #[inline]
    pub(super) fn corrected_rate_rad_s(&self, rate_rad_s: Vector3<f64>) -> Vector3<f64> {
        let rate_rad_s = rate_rad_s - self.bias_rad_s;
        rate_rad_s - self.scale.component_mul(&rate_rad_s)
    }

    /// Returns the scale error of each axis with its uncertainty.
    pub(super) fn scale(&self) -> GyroScale {
        GyroScale { error: self.scale, sd: Vector3::from(self.scale_variance().map(libm::sqrt)) }
    }

    /// Returns the variance of the bias about the vertical, rad²/s².
    ///
    /// This variance is the trace of the covariance of the bias minus the variances about the two
    /// horizontal axes.
    #[inline]
    pub(super) fn vertical_bias_variance(&self) -> f64 {
        let sum: f64 = (BIAS..SCALE).map(|i| self.covariance[(i, i)]).sum();
        (sum - 2.0 * self.horizontal_bias_sd_rad_s * self.horizontal_bias_sd_rad_s).max(0.0)
    }

    /// Returns the variance of the scale error of each axis.
    #[inline]
    pub(super) fn scale_variance(&self) -> [f64; 3] {
        [SCALE, SCALE + 1, SCALE + 2].map(|i| self.covariance[(i, i)])
    }

    /// Returns the standard deviation of the inclination, rad.
    #[inline]
    pub(super) fn tilt_sd_rad(&self) -> f64 {
        self.tilt_sd_rad
    }

    /// Returns the standard deviation of the least certain component of the bias, rad/s.
    pub(super) fn bias_sd_rad_s(&self) -> f64 {
        libm::sqrt((BIAS..SCALE).map(|i| self.covariance[(i, i)]).fold(0.0, f64::max))
    }

    /// Restarts the filter with an unknown level error. Bias and scale are kept.
    ///
    /// `from_one_sample` is `true` if the level comes from the next sample, `false` if the level
    /// was kept through an outage.
    pub(super) fn restart(&mut self, from_one_sample: bool) {
        let known: ErrorCovariance = self.covariance.fixed_view::<GYRO_ERRORS, GYRO_ERRORS>(BIAS, BIAS).into();
        *self = Self { bias_rad_s: self.bias_rad_s, scale: self.scale, from_one_sample, ..Self::default() };
        self.covariance.fixed_view_mut::<GYRO_ERRORS, GYRO_ERRORS>(BIAS, BIAS).copy_from(&known);
    }

    /// Accumulates the sensitivity of the tilt to the gyro errors over a tick. `axes` are the body
    /// axes, and `rotation` is the measured rotation.
    #[inline]
    pub(super) fn accumulate_drift(&mut self, axes: &BodyAxes, rotation: Rotation, dt_s: f64) {
        let rotation_rad = Vector3::new(rotation.s.re, rotation.s.im, rotation.p.im) * 2.0 - self.bias_rad_s * dt_s;
        let (bias_drift, scale_drift) = self.drift.split_at_mut(3);
        for (i, axis) in axes.horizontal.into_iter().enumerate() {
            bias_drift[i] += axis * dt_s;
            scale_drift[i] += axis * rotation_rad[i];
        }
    }

    /// Records a gyro outage. Force innovations that span it do not update bias or scale.
    #[inline]
    pub(super) fn add_outage(&mut self, outage_s: f64) {
        self.outage_s += outage_s;
    }

    /// Adds a sample: the integral of the levelled force over `dt_s`, and the norm of the force.
    #[inline]
    pub(super) fn accumulate_force(&mut self, force_dt_m_s: Complex<f64>, norm_m_s2: f64, dt_s: f64) {
        self.force_dt_m_s += force_dt_m_s;
        self.norm_dt_m_s += norm_m_s2 * dt_s;
        self.since_update_s += dt_s;
    }

    /// Returns `true` if enough samples have been accumulated for an update.
    #[inline]
    pub(super) fn is_update_due(&self) -> bool {
        let min_interval_s = if self.from_one_sample {
            (INITIAL_INTERVAL_FRACTION * self.observed_s()).max(INITIAL_INTERVAL_S)
        } else {
            UPDATE_INTERVAL_S
        };
        self.since_update_s >= min_interval_s.min(UPDATE_INTERVAL_S)
    }

    /// Returns the time for which innovations have been observed, s. It is limited to their
    /// averaging time.
    #[inline]
    fn observed_s(&self) -> f64 {
        self.force_noise.memory_s() - noise::INITIAL_MEMORY_S
    }

    /// Returns the duration (s) and the integral of the levelled force (m/s) accumulated since the
    /// last update.
    pub(super) fn accumulated(&self) -> (f64, Complex<f64>) {
        (self.since_update_s, self.force_dt_m_s)
    }

    /// Updates the filter with the samples accumulated since the last update.
    #[inline(never)]
    pub(super) fn update(&mut self, input: &UpdateInput, settings: &Settings) -> UpdateOutcome {
        let UpdateInput { tilt_correction_rad, bias_at_rest, loop_velocity_s, t2_s, .. } = *input;
        let norm = core::mem::take(&mut self.norm_dt_m_s) / (GRAVITY_M_S2 * self.since_update_s);
        let Prediction { innovation, force, interval_s } = self.predict(input, settings);
        if let Some(level_error_rad) = self.tilt_fault.observe(innovation, force, norm, interval_s) {
            let error = self.reset_after_tilt_fault(level_error_rad, loop_velocity_s);
            return UpdateOutcome { error, acceleration: Complex::new(0.0, 0.0), is_restarted: true };
        }
        if let Some(bias_rad_s) = bias_at_rest.filter(|bias_rad_s| self.is_new_bias(*bias_rad_s)) {
            let error = self.restart_at_rest(bias_rad_s, force - tilt_correction_rad * 0.5, loop_velocity_s);
            return UpdateOutcome { error, acceleration: Complex::new(0.0, 0.0), is_restarted: true };
        }
        let mut change = self.measure(innovation, interval_s);
        let error = if let Some(bias_rad_s) = bias_at_rest {
            self.set_bias_at_rest(bias_rad_s - self.bias_rad_s, &mut change);
            self.settle_at_rest(loop_velocity_s, force - tilt_correction_rad * 0.5)
        } else {
            self.loop_error(&change)
        };
        self.apply(&change);
        self.tilt_rad -= error.tilt;
        let variance = self.tilt_variance_rad2();
        let initial = self.initial_velocity.observe(self.tilt_rad, variance, interval_s, t2_s);
        self.tilt_rad -= initial.tilt;
        self.tilt_sd_rad = libm::sqrt(0.5 * self.tilt_rad.norm_sqr() + variance);
        UpdateOutcome { error: error + initial, acceleration: innovation, is_restarted: false }
    }

    /// Propagates the filter to the end of the interval and returns the innovation of the force.
    fn predict(&mut self, input: &UpdateInput, settings: &Settings) -> Prediction {
        let UpdateInput { rate_rad_s, tilt_correction_rad, t2_s, .. } = *input;
        let interval_s = core::mem::take(&mut self.since_update_s);
        let force = core::mem::take(&mut self.force_dt_m_s) / (GRAVITY_M_S2 * interval_s);
        let drift = core::mem::take(&mut self.drift).map(|horizontal| -J * horizontal);
        let rate2 = rate_rad_s.norm_squared().min(MAX_RATE_RAD_S * MAX_RATE_RAD_S);
        self.propagate(&drift, rate2, interval_s, settings);
        self.inflate_tilt_covariance();
        self.propagate_sensitivity(&drift, interval_s, t2_s);
        self.horizontal_bias_sd_rad_s = self.bias_sd_across(&drift) / interval_s;
        // The mean force refers to the middle of the interval. At that time, half of the tilt
        // correction had been applied.
        let innovation = force - self.tilt_rad + tilt_correction_rad * 0.5;
        self.tilt_rad -= tilt_correction_rad;
        let decay = decay(interval_s);
        self.velocity_s = self.velocity_s * decay + force * interval_s;
        self.tilt_velocity_s = self.tilt_velocity_s * decay + (self.tilt_rad + tilt_correction_rad * 0.5) * interval_s;
        Prediction { innovation, force, interval_s }
    }

    /// Adds a change to the state of the filter.
    fn apply(&mut self, change: &State) {
        self.bias_rad_s += change.fixed_rows::<3>(BIAS);
        self.scale = (self.scale + change.fixed_rows::<3>(SCALE)).map(|m| m.clamp(-MAX_SCALE, MAX_SCALE));
        self.tilt_velocity_s += Complex::new(change[VELOCITY], change[VELOCITY + 1]);
        self.tilt_rad += Complex::new(change[TILT], change[TILT + 1]);
    }

    /// Returns the estimated tilt error of the loop, rad.
    pub(super) fn tilt_error_rad(&self) -> Complex<f64> {
        self.tilt_rad
    }

    /// Returns the variance of the tilt about one axis, rad².
    fn tilt_variance_rad2(&self) -> f64 {
        0.5 * (self.covariance[(TILT, TILT)] + self.covariance[(TILT + 1, TILT + 1)])
    }

    /// Updates with the force or the velocity, whichever is more informative, and returns the
    /// change of the state.
    ///
    /// If the level was initialised while the body moved, the innovations include the resulting
    /// level error. This error cannot be distinguished from noise until the averaging time of the
    /// innovations has passed. Until then the gain is at least that of a mean, 1/(1 + number of
    /// updates). If the level was set from one sample, the estimated tilt then equals the mean over
    /// time of the tilts measured by the force. The variance of the tilt, however, falls as if each
    /// update interval contained one measurement.
    fn measure(&mut self, innovation: Complex<f64>, interval_s: f64) -> State {
        let mut force_variance =
            MIN_FORCE_SD * MIN_FORCE_SD + self.force_noise.update(innovation, interval_s, FORCE_CORRELATION);
        let observed_s = self.observed_s();
        let mean_variance = self.tilt_variance_rad2() * (observed_s - interval_s + UPDATE_INTERVAL_S) / interval_s;
        let is_less_informative = force_variance > mean_variance && self.force_noise.memory_s() < noise::MEMORY_S;
        let is_mean = self.is_initial_level && is_less_informative || self.from_one_sample && observed_s < MEAN_ONLY_S;
        if is_mean {
            force_variance = mean_variance;
        }
        if self.is_initial_level && observed_s < FORCE_ONLY_S {
            self.reset_velocity();
            let mut change = self.update_pair(TILT, innovation, force_variance);
            if is_mean && self.from_one_sample {
                let time_gain = (observed_s + UPDATE_INTERVAL_S) / (observed_s + FIRST_SAMPLE_DURATION_S);
                change.fixed_rows_mut::<2>(TILT).scale_mut(time_gain);
            }
            return change;
        }
        let velocity_innovation_s = self.velocity_s - self.tilt_velocity_s;
        let velocity_variance = MIN_VELOCITY_SD_S * MIN_VELOCITY_SD_S
            + self.velocity_noise.update(velocity_innovation_s, interval_s, VELOCITY_CORRELATION);
        if velocity_variance < force_variance * (VELOCITY_MEMORY_S * VELOCITY_MEMORY_S) {
            self.update_pair(VELOCITY, velocity_innovation_s, velocity_variance)
        } else {
            self.update_pair(TILT, innovation, force_variance)
        }
    }

    /// Restarts the velocity sum at zero.
    fn reset_velocity(&mut self) {
        (self.velocity_s, self.tilt_velocity_s) = (Complex::new(0.0, 0.0), Complex::new(0.0, 0.0));
        for i in [VELOCITY, VELOCITY + 1] {
            self.covariance.row_mut(i).fill(0.0);
            self.covariance.column_mut(i).fill(0.0);
            self.covariance[(i, i)] = INITIAL_VELOCITY_SD_S * INITIAL_VELOCITY_SD_S;
        }
    }

    /// Returns the change of the loop's error that corresponds to a change of the state.
    fn loop_error(&self, change: &State) -> LoopError {
        let tilt = Complex::new(change[TILT], change[TILT + 1]);
        let first = LoopError { tilt: tilt * self.tilt_sensitivity[0], velocity: tilt * self.tilt_sensitivity[1] };
        self.loop_sensitivity.iter().zip(change.fixed_rows::<GYRO_ERRORS>(BIAS).iter()).fold(
            first,
            |sum, (sensitivity, change)| {
                sum + LoopError { tilt: sensitivity.tilt * *change, velocity: sensitivity.velocity * *change }
            },
        )
    }

    /// Returns the correction at standstill.
    ///
    /// At standstill the force reveals the entire error of the loop, regardless of its cause.
    ///
    /// The correction matches the loop's velocity to its current tilt, so that the tilt settles
    /// within T2. Sensitivities to earlier errors are adjusted accordingly.
    fn settle_at_rest(&mut self, loop_velocity_s: Complex<f64>, tilt_rad: Complex<f64>) -> LoopError {
        for sensitivity in &mut self.loop_sensitivity {
            sensitivity.velocity = sensitivity.tilt * T1_S;
        }
        self.tilt_sensitivity[1] = self.tilt_sensitivity[0] * T1_S;
        self.initial_velocity = InitialVelocityEstimator::default();
        LoopError { tilt: Complex::new(0.0, 0.0), velocity: loop_velocity_s - tilt_rad * T1_S }
    }

    /// Returns `true` if a bias measured at rest is far from the estimate.
    ///
    /// The effects of the estimate can then not be corrected linearly.
    fn is_new_bias(&self, bias_rad_s: Vector3<f64>) -> bool {
        (bias_rad_s - self.bias_rad_s).amax() > MAX_LINEAR_BIAS_CHANGE_RAD_S
    }

    /// Restarts the filter with a bias measured at rest.
    ///
    /// Returns the error of the loop, which the force shows at rest.
    #[cold]
    fn restart_at_rest(
        &mut self,
        bias_rad_s: Vector3<f64>,
        tilt: Complex<f64>,
        loop_velocity_s: Complex<f64>,
    ) -> LoopError {
        *self =
            Self { from_one_sample: false, ..Self::new(bias_rad_s, BIAS_SD_AT_REST_RAD_S, REINITIALISED_LEVEL_SD_RAD) };
        LoopError { tilt, velocity: loop_velocity_s }
    }

    /// Restarts the filter after a tilt fault and returns the error of the loop.
    ///
    /// The true error of the level exceeds the estimated error by `level_error_rad`, so the
    /// velocity of the loop is an artefact. The bias becomes as uncertain as after initialisation.
    /// The standard deviation of the level becomes [`REINITIALISED_LEVEL_SD_RAD`].
    #[cold]
    fn reset_after_tilt_fault(&mut self, level_error_rad: Complex<f64>, loop_velocity_s: Complex<f64>) -> LoopError {
        let tilt = self.tilt_rad + level_error_rad;
        let mut reset = Self {
            scale: self.scale,
            from_one_sample: false,
            ..Self::new(self.bias_rad_s, MAX_BIAS_SD_RAD_S, REINITIALISED_LEVEL_SD_RAD)
        };
        let known = self.covariance.fixed_view::<3, 3>(SCALE, SCALE);
        reset.covariance.fixed_view_mut::<3, 3>(SCALE, SCALE).copy_from(&known);
        *self = reset;
        LoopError { tilt, velocity: loop_velocity_s }
    }

    /// Propagates the covariance: P ← F P Fᵀ + Q.
    fn propagate(&mut self, drift: &[Complex<f64>; GYRO_ERRORS], rate2: f64, interval_s: f64, settings: &Settings) {
        let max_bias_sd_rad_s = self.max_bias_sd_rad_s;
        let p = &mut self.covariance;
        let decay = decay(interval_s);
        let (across, along) = (drift.map(|drift| drift.re), drift.map(|drift| drift.im));
        let sum = |drift: &[f64; GYRO_ERRORS], values: [f64; GYRO_ERRORS]| {
            drift.iter().zip(values).map(|(a, b)| a * b).sum::<f64>()
        };
        for j in 0..STATES {
            let values: [f64; GYRO_ERRORS] = core::array::from_fn(|k| p[(BIAS + k, j)]);
            p[(TILT, j)] += sum(&across, values);
            p[(TILT + 1, j)] += sum(&along, values);
            p[(VELOCITY, j)] = decay * p[(VELOCITY, j)] + interval_s * p[(TILT, j)];
            p[(VELOCITY + 1, j)] = decay * p[(VELOCITY + 1, j)] + interval_s * p[(TILT + 1, j)];
        }
        for i in 0..STATES {
            let values: [f64; GYRO_ERRORS] = core::array::from_fn(|k| p[(i, BIAS + k)]);
            p[(i, TILT)] += sum(&across, values);
            p[(i, TILT + 1)] += sum(&along, values);
            p[(i, VELOCITY)] = decay * p[(i, VELOCITY)] + interval_s * p[(i, TILT)];
            p[(i, VELOCITY + 1)] = decay * p[(i, VELOCITY + 1)] + interval_s * p[(i, TILT + 1)];
        }
        // The two halves of the symmetric covariance were summed in different orders. Copying one
        // to the other removes the rounding difference.
        let summed = [TILT, TILT + 1, VELOCITY, VELOCITY + 1];
        for (k, i) in summed.into_iter().enumerate() {
            summed[k + 1..].iter().for_each(|j| p[(*j, i)] = p[(i, *j)]);
        }
        let square = |walk: f64| walk * walk;
        let (noise_rad, walk_rad_s) =
            (settings.level_noise_deg_sqrt_s.to_radians(), settings.gyro_bias_walk_deg_s_sqrt_s.to_radians());
        let tilt_walk2 = square(noise_rad) + square(TILT_WALK_PER_RATE) * rate2;
        let bias_walk2 = square(walk_rad_s) + square(BIAS_WALK_PER_RATE) * rate2;
        for i in 0..VELOCITY {
            let (walk2, max_sd) = match i {
                TILT..BIAS => (tilt_walk2, 1.0),
                BIAS..SCALE => (bias_walk2, max_bias_sd_rad_s),
                _ => (square(SCALE_WALK), MAX_SCALE_SD),
            };
            p[(i, i)] += walk2 * interval_s;
            if p[(i, i)] > max_sd * max_sd {
                let scale = max_sd / libm::sqrt(p[(i, i)]);
                p.row_mut(i).scale_mut(scale);
                p.column_mut(i).scale_mut(scale);
            }
        }
    }

    /// Increases the tilt variance to account for rotation that was not observed during gyro
    /// outages.
    fn inflate_tilt_covariance(&mut self) {
        let unobserved_rad = (ASSUMED_UNOBSERVED_RATE_RAD_S * core::mem::take(&mut self.outage_s)).min(1.0);
        for i in [TILT, TILT + 1] {
            self.covariance[(i, i)] += unobserved_rad * unobserved_rad;
        }
    }

    /// Propagates the sensitivities of the loop over an interval. Half of the drift is applied at
    /// the start of the interval, the other half at its end.
    fn propagate_sensitivity(&mut self, drift: &[Complex<f64>; GYRO_ERRORS], interval_s: f64, t2_s: f64) {
        let response = LoopResponse::new(interval_s, t2_s);
        let [e0, w0] = self.tilt_sensitivity;
        let [e1, w1] = response.apply(e0, w0);
        for (sensitivity, drift) in self.loop_sensitivity.iter_mut().zip(drift) {
            let tilt = sensitivity.tilt + drift * (0.5 - 0.5 * e0);
            let velocity = sensitivity.velocity - drift * (0.5 * w0);
            let [tilt, velocity] = response.apply(tilt, velocity);
            sensitivity.tilt = tilt + drift * (0.5 - 0.5 * e1);
            sensitivity.velocity = velocity - drift * (0.5 * w1);
        }
        self.tilt_sensitivity = [e1, w1];
    }

    /// Applies a measurement of the states `first` and `first` + 1. Returns the change of the
    /// state.
    fn update_pair(&mut self, first: usize, innovation: Complex<f64>, variance: f64) -> State {
        let change = self.update_scalar(first, innovation.re, variance);
        change + self.update_scalar(first + 1, innovation.im - change[first + 1], variance)
    }

    fn update_scalar(&mut self, component: usize, innovation: f64, variance: f64) -> State {
        let column: State = self.covariance.column(component).into();
        let scale = 1.0 / libm::sqrt(column[component] + variance);
        let gain = column * scale;
        self.covariance -= gain * gain.transpose();
        gain * (innovation * scale)
    }

    /// Returns `true` if the filter started with a bias less certain than that of a calibrated
    /// gyro.
    pub(super) fn has_wide_prior(&self) -> bool {
        self.max_bias_sd_rad_s > MAX_BIAS_SD_RAD_S
    }

    /// Returns `true` if the bias about a direction is known as well as that of a calibrated gyro.
    pub(super) fn is_bias_known_about(&self, direction: Vector3<f64>) -> bool {
        self.bias_sd_about(direction) < MAX_BIAS_SD_RAD_S
    }

    /// Raises the upper limit of the bias's standard deviation, because the bias is large.
    pub(super) fn widen_prior(&mut self, max_bias_sd_rad_s: f64) {
        self.max_bias_sd_rad_s = max_bias_sd_rad_s;
    }

    /// Applies the drift of the heading as a measurement of the bias error about its axis.
    ///
    /// Returns the change of the drift (rad/s) and the error of the loop, or `None` if the drift is
    /// not much better known than the bias. If the drift is many standard deviations in size, the
    /// bias about the axis counts as unknown.
    pub(super) fn observe_vertical_bias(&mut self, drift: &Drift) -> Option<(f64, LoopError)> {
        let Drift { rate_rad_s, variance_rad2_s2, axis } = *drift;
        let bias_sd_rad_s = self.bias_sd_about(axis);
        let (rate2, bias_variance) = (rate_rad_s * rate_rad_s, bias_sd_rad_s * bias_sd_rad_s);
        let is_unexpected = rate2 > MAX_DRIFT2 * (bias_variance + variance_rad2_s2);
        let added_variance = if is_unexpected { rate2 } else { 0.0 };
        if variance_rad2_s2 > MAX_DRIFT_VARIANCE_FRACTION * (bias_variance + added_variance) {
            return None;
        }
        let mut bias_covariance = self.covariance.fixed_view_mut::<3, 3>(BIAS, BIAS);
        let direction = axis / axis.norm_squared();
        bias_covariance += direction * direction.transpose() * added_variance;
        let column = self.covariance.fixed_columns::<3>(BIAS) * axis;
        let scale = 1.0 / libm::sqrt(bias_variance + added_variance + variance_rad2_s2);
        let gain = column * scale;
        self.covariance -= gain * gain.transpose();
        let change = gain * (rate_rad_s * scale);
        let error = self.loop_error(&change);
        self.apply(&change);
        self.tilt_rad -= error.tilt;
        Some((change.fixed_rows::<3>(BIAS).dot(&axis), error))
    }

    /// Sets the bias from a direct measurement at rest.
    fn set_bias_at_rest(&mut self, change_rad_s: Vector3<f64>, change: &mut State) {
        change.fixed_rows_mut::<3>(BIAS).copy_from(&change_rad_s);
        for i in BIAS..SCALE {
            self.covariance.row_mut(i).fill(0.0);
            self.covariance.column_mut(i).fill(0.0);
            self.covariance[(i, i)] = BIAS_SD_AT_REST_RAD_S * BIAS_SD_AT_REST_RAD_S;
        }
    }

    /// Returns the reason why the state is invalid, or `None` if it is valid.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        let asymmetry = (self.covariance - self.covariance.transpose()).amax();
        let indefinite = asymmetry > 1e-12 || self.covariance.cholesky().is_none();
        bias_validation_error(self.bias_rad_s)
            .or((self.scale.amax() > MAX_SCALE).then_some("a gyro scale error above 0.01"))
            .or(indefinite.then_some("a covariance that is not symmetric and positive definite"))
            .or_else(|| self.force_noise.validation_error())
            .or_else(|| self.velocity_noise.validation_error())
            .or_else(|| self.tilt_fault.validation_error())
            .or_else(|| self.initial_velocity.validation_error())
            .or((self.horizontal_bias_sd_rad_s < 0.0 || self.max_bias_sd_rad_s <= 0.0)
                .then_some("a standard deviation of the bias below zero"))
            .or((self.since_update_s < 0.0 || self.outage_s < 0.0 || self.tilt_sd_rad < 0.0)
                .then_some("a time or standard deviation below zero"))
    }
}

/// Returns the fraction of a velocity that remains after an interval.
fn decay(interval_s: f64) -> f64 {
    libm::exp(-interval_s / VELOCITY_MEMORY_S)
}

impl Scalars for GyroErrorFilter {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.bias_rad_s.visit(visit);
        self.scale.visit(visit);
        self.tilt_rad.visit(visit);
        self.velocity_s.visit(visit);
        self.tilt_velocity_s.visit(visit);
        for i in 0..STATES {
            for j in i..STATES {
                visit(&mut self.covariance[(i, j)]);
                self.covariance[(j, i)] = self.covariance[(i, j)];
            }
        }
        visit_fields!(self, visit:
            loop_sensitivity, tilt_sensitivity, drift, outage_s, force_dt_m_s, norm_dt_m_s, since_update_s,
            tilt_sd_rad, horizontal_bias_sd_rad_s, max_bias_sd_rad_s, force_noise, velocity_noise, is_initial_level,
            from_one_sample, tilt_fault, initial_velocity;
            without bias_rad_s, scale, tilt_rad, velocity_s, tilt_velocity_s, covariance
        );
    }
}
