//! Kalman filter of sixteen states for one hypothesis about the magnetic field.
//!
//! | state | number | meaning | frame |
//! | --- | --- | --- | --- |
//! | e | 3 | ambient field | reference |
//! | β | 1 | drift rate of the gyro heading | reference |
//! | τ | 1 | delay of the magnetometer | |
//! | b | 3 | hard iron | body |
//! | d | 3 | local disturbance at the position of the body | reference |
//! | κ | 3 | scale error of each gyro axis | body |
//! | p | 2 | horizontal field at the last rest site | reference |
//!
//! The measurement consists of the means y, R', Ω of an interval (see `field_averager`), where y is
//! the mean of R'm:
//!
//! y = e + (τ − τ') Ω × e + R' b + d + v,
//!
//! where τ' is the delay for which R' was rotated back, and v is noise.
//!
//! - e rotates about the vertical by βT + Σ κ_i ψ_i between intervals, where T is the length of the
//!   interval and ψ_i = ∫ u_i ω_i dt is the rotation about the vertical contributed by body axis i,
//!   with the up vector u in body axes. The random walk of e acts along ζ0 × e, because gyro noise
//!   rotates the field and does not stretch it.
//! - κ models a drift that appears only while the body keeps turning one way: at a scale error of
//!   half a per cent, a full turn causes 2° of drift. Without κ, β would follow this drift for a
//!   minute, although β represents drift that does not depend on motion. The level filter estimates
//!   the scale error as well, and its variance limits the variance of κ.
//! - d fades with the distance that the body has moved, and only slowly while the body stays,
//!   because a sensor that does not move cannot measure the field elsewhere. It is reset whenever a
//!   movement or a rest starts.
//! - p rotates as e does. When the body rests at the same site again, the measurement 0 = e + d − p
//!   + v reveals the drift of the gyro since the previous rest there.
//!
//! The three components of y are used in one step. With the innovation ν, the measurement matrix H
//! and the Cholesky factor L of S = H P Hᵀ + R: W = P Hᵀ L⁻ᵀ, x += W L⁻¹ν, P −= W Wᵀ.
//!
//! Plain arrays and an unrolled factor of three rows are used because they are faster than
//! nalgebra's `SMatrix` and `Cholesky`, although those read better. An update of the whole chain
//! takes 0.39 times as long as an update of the same chain with VQF. With nalgebra it takes 0.42
//! times as long, 8 % more (`plumb score --fuser wz --fuser vqf`, four alternating runs of each).

use super::field_averager::IntervalMeans;
use crate::{
    Vector3,
    fuser::{hard_iron::HardIron, wz::settings::Settings},
    scalars::Scalars,
};

/// Number of states.
pub(super) const STATES: usize = 16;
/// Index of the ambient magnetic field e in reference axes, µT.
pub(super) const E: usize = 0;
/// Index of the drift rate β.
pub(super) const BETA: usize = 3;
/// Index of the magnetometer delay τ.
pub(super) const TAU: usize = 4;
/// Index of the hard iron b.
pub(super) const B: usize = 5;
/// Index of the local disturbance d.
const D: usize = 8;
/// Index of the gyro scale error κ.
pub(super) const KAPPA: usize = 11;
/// Index of the horizontal magnetic field p at the last rest site, in reference axes, µT.
const SITE: usize = 14;

/// Standard deviation of an unknown ambient magnetic field, µT. It is close to the strongest field
/// on Earth.
const FIELD_SD_UT: f64 = 60.0;
/// Initial standard deviation of the drift rate, rad/s, equal to that of the gyro bias in the level
/// filter. The random walk does not increase it beyond about this value.
pub(super) const DRIFT_SD_RAD_S: f64 = 0.003;
/// Random walk of the drift rate while the body moves, rad/s/√s.
const DRIFT_WALK_RAD_S: f64 = 2e-5;
/// Random change of the body's tilt in motion, rad/√s. A body that tilts by a small angle turns the
/// vertical by this angle relative to the unknown gyro bias, and so changes the drift rate.
const TILT_CHANGE_RAD: f64 = 0.045;
/// Additional random walk of the drift rate per unit of rate, 1/√s.
const DRIFT_WALK_PER_RATE: f64 = 1.5e-5;
/// Additional random walk of the drift rate while the body vibrates, rad/s/√s. It is needed because
/// the bias of a vibrating gyro differs from that at rest.
const VIBRATION_DRIFT_WALK_RAD_S: f64 = 2.2e-4;
/// Factor applied to the level filter's standard deviation of the gyro scale error.
///
/// The largest standard deviation of the scale error κ is the root sum of squares of this product
/// and [`SCALE_SD_FLOOR`].
const SCALE_SD_FACTOR: f64 = 1.5;
/// Floor of the largest standard deviation of the gyro scale error κ.
///
/// The floor applies even if the level filter's standard deviation of the scale error is zero.
const SCALE_SD_FLOOR: f64 = 3e-4;
/// Initial standard deviation of the gyro scale error κ. Data sheets of MEMS gyros allow at most
/// 0.5 to 1 %.
const SCALE_SD: f64 = 0.003;
/// Random walk of the gyro scale error κ, 1/√s. It models the effect of a few degrees of warming in
/// an hour.
const SCALE_WALK: f64 = 1e-5;
/// Random walk of the gyro heading, rad/√s.
const HEADING_WALK_RAD: f64 = 2e-4;
/// Additional random walk of the gyro heading per unit of rate, √s.
const HEADING_WALK_PER_RATE: f64 = 6e-4;
/// Random walk of the ambient field, µT/√s.
const FIELD_WALK_UT: f64 = 0.01;
/// Standard deviation of the local disturbance, µT. The disturbance is due to iron in a building
/// and to the sensor's soft iron.
const LOCAL_FIELD_SD_UT: f64 = 1.23;
/// Decay rate of the local disturbance at rest, 1/s.
const DECAY_AT_REST: f64 = 0.06;
/// Increase of the local disturbance's decay rate per unit of rotation rate, 1/rad.
const DECAY_PER_TURN: f64 = 0.2;
/// Increase of the local disturbance's decay rate per unit of acceleration above
/// [`ACCELERATION_THRESHOLD_M_S2`], 1/s per m/s².
const DECAY_PER_ACCELERATION: f64 = 0.15;
/// Acceleration above which the local disturbance decays faster, m/s².
const ACCELERATION_THRESHOLD_M_S2: f64 = 0.3;
/// Noise on each axis when the field is compared with that of the last rest site, µT.
const REVISIT_SD_UT: f64 = 0.2;
/// Gate for the normalised innovation squared when the magnetic field is compared with that of the
/// last rest site. The gate is tight because the field at another site may be similar.
const REVISIT_GATE: f64 = 4.0;
/// Lower limit of the magnetometer delay, s.
const MIN_DELAY_S: f64 = -0.01;
/// Upper limit of the magnetometer delay, s.
const MAX_DELAY_S: f64 = 0.04;

/// Time update between two measurements, common to all hypotheses.
#[derive(Debug, Clone, Copy)]
pub(super) struct Propagation {
    duration_s: f64,
    /// Rotation about the vertical contributed by each body axis, rad.
    vertical_rotation_rad: [f64; 3],
    /// Set if the body moved, so that the gyro heading drifted.
    is_moving: bool,
    /// Set if a movement or a rest starts with the interval. The local disturbance d is then reset.
    motion_changed: bool,
    /// Variance added to the drift rate β, rad²/s².
    drift_variance_rad2_s2: f64,
    /// Largest variance of the gyro scale error κ on each axis.
    max_scale_variance: [f64; 3],
    /// Fraction of the local disturbance d that remains after the interval.
    local_field_decay: f64,
    /// Variance added to the local disturbance d, µT².
    local_field_variance_ut2: f64,
    /// Variance added to the gyro heading, rad².
    heading_variance_rad2: f64,
    /// Variance added to the ambient field e, µT².
    field_variance_ut2: f64,
}

impl Propagation {
    /// Creates the time update of an interval. `motion_changed` is `true` if a movement or a rest
    /// starts with the interval.
    pub(super) fn from_interval(interval: &IntervalMeans, motion_changed: bool) -> Self {
        let (t_s, rate_rms_rad_s) = (interval.duration_s, interval.rate_rms_rad_s);
        let acceleration_m_s2 = (interval.acceleration_rms_m_s2 - ACCELERATION_THRESHOLD_M_S2).max(0.0);
        let decay_rate = DECAY_AT_REST + DECAY_PER_TURN * rate_rms_rad_s + DECAY_PER_ACCELERATION * acceleration_m_s2;
        let local_field_decay = libm::exp(-decay_rate * t_s);
        let square = |x: f64| x * x;
        let drift_walk2 = square(DRIFT_WALK_RAD_S)
            + square(TILT_CHANGE_RAD) * interval.vertical_bias_variance
            + square(DRIFT_WALK_PER_RATE * rate_rms_rad_s)
            + if interval.is_vibrating { square(VIBRATION_DRIFT_WALK_RAD_S) } else { 0.0 };
        let walk_rad = HEADING_WALK_RAD + HEADING_WALK_PER_RATE * rate_rms_rad_s;
        Self {
            duration_s: t_s,
            vertical_rotation_rad: interval.vertical_rotation_rad,
            is_moving: !interval.at_rest,
            motion_changed,
            drift_variance_rad2_s2: drift_walk2 * t_s,
            max_scale_variance: interval
                .scale_variance
                .map(|variance| square(SCALE_SD_FACTOR) * variance + square(SCALE_SD_FLOOR)),
            local_field_decay,
            local_field_variance_ut2: LOCAL_FIELD_SD_UT
                * LOCAL_FIELD_SD_UT
                * (1.0 - local_field_decay * local_field_decay),
            heading_variance_rad2: walk_rad * walk_rad * t_s,
            field_variance_ut2: FIELD_WALK_UT * FIELD_WALK_UT * t_s,
        }
    }
}

/// Result of a measurement for one hypothesis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct MeasurementResult {
    /// Normalised innovation squared, three degrees of freedom.
    pub(super) nis: f64,
    /// Determinant of the innovation covariance, µT⁶.
    pub(super) determinant: f64,
    /// Set if the innovation passed the gate and was used.
    pub(super) accepted: bool,
}

/// Drift of the gyro heading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::fuser::wz) struct Drift {
    pub(in crate::fuser::wz) rate_rad_s: f64,
    pub(in crate::fuser::wz) variance_rad2_s2: f64,
    /// Mean of the vertical in body axes over the time in which the drift was observed. A gyro bias
    /// has caused its scalar product with this vector as drift.
    pub(in crate::fuser::wz) axis: Vector3<f64>,
}

/// Kalman filter of one hypothesis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FieldFilter {
    pub(super) x: [f64; STATES],
    /// Covariance. It is symmetric, and both halves are stored.
    p: [[f64; STATES]; STATES],
}

impl FieldFilter {
    /// Creates a filter from the settings alone.
    pub(super) fn new(settings: &Settings) -> Self {
        let mut filter = Self { x: [0.0; STATES], p: [[0.0; STATES]; STATES] };
        filter.x[TAU] = settings.magnetometer_delay_s;
        filter.inflate(E, FIELD_SD_UT);
        filter.inflate(B, settings.hard_iron_sd_ut);
        filter.inflate(D, LOCAL_FIELD_SD_UT);
        filter.inflate(KAPPA, SCALE_SD);
        filter.reset(BETA, DRIFT_SD_RAD_S);
        filter.p[TAU][TAU] = settings.magnetometer_delay_sd_s * settings.magnetometer_delay_sd_s;
        filter
    }

    /// Copies drift rate, gyro scale error and delay from `known`. Adds `hard_iron_sd_ut` to the
    /// uncertainty of the hard iron.
    pub(super) fn keep_gyro_and_delay(&mut self, known: &Self, hard_iron_sd_ut: f64) {
        for i in [BETA, TAU, KAPPA, KAPPA + 1, KAPPA + 2] {
            self.x[i] = known.x[i];
            self.p[i][i] = known.p[i][i];
        }
        self.inflate(B, hard_iron_sd_ut);
    }

    /// Sets the hard iron if it is known. Otherwise the prior from the settings is kept.
    pub(super) fn set_hard_iron(&mut self, hard_iron: HardIron) {
        let HardIron { field_ut, sd_ut } = hard_iron;
        if sd_ut.is_finite() {
            for (i, part_ut) in (B..).zip(field_ut.iter()) {
                self.reset(i, sd_ut);
                self.x[i] = *part_ut;
            }
        }
    }

    /// Returns the hard iron, or [`HardIron::UNKNOWN`] if it is assumed to be zero.
    pub(super) fn hard_iron(&self) -> HardIron {
        let variance_ut2 = (B..B + 3).map(|i| self.p[i][i]).fold(0.0, f64::max);
        if variance_ut2 == 0.0 {
            return HardIron::UNKNOWN;
        }
        let field_ut = Vector3::new(self.x[B], self.x[B + 1], self.x[B + 2]);
        HardIron { field_ut, sd_ut: libm::sqrt(variance_ut2) }
    }

    /// Returns the squared distance between the hard irons of two hypotheses, µT².
    pub(super) fn hard_iron_distance2_ut2(&self, other: &Self) -> f64 {
        (B..B + 3).map(|i| (self.x[i] - other.x[i]) * (self.x[i] - other.x[i])).sum()
    }

    /// Returns the mean magnetic field minus the hard iron in reference axes, µT.
    pub(super) fn field_without_hard_iron_ut(&self, interval: &IntervalMeans) -> [f64; 3] {
        let hard_iron = |[a, b, c]: [f64; 3]| a * self.x[B] + b * self.x[B + 1] + c * self.x[B + 2];
        core::array::from_fn(|i| interval.field_ut[i] - hard_iron(interval.axes[i]))
    }

    /// Adds `sd` to the uncertainty of three states starting at `first`.
    pub(super) fn inflate(&mut self, first: usize, sd: f64) {
        for i in first..first + 3 {
            self.p[i][i] += sd * sd;
        }
    }

    /// Resets a state to zero with the standard deviation `sd`, uncorrelated with the other states.
    pub(super) fn reset(&mut self, i: usize, sd: f64) {
        self.x[i] = 0.0;
        self.p[i] = [0.0; STATES];
        self.p.iter_mut().for_each(|row| row[i] = 0.0);
        self.p[i][i] = sd * sd;
    }

    /// Sets the ambient magnetic field such that the present heading is kept. `sd_rad` becomes the
    /// standard deviation of the heading.
    ///
    /// The local disturbance adds to the uncertainty. The strength of the field is taken from the
    /// sample, but its variance is left unchanged.
    pub(super) fn set_north(&mut self, field_ut: [f64; 3], sd_rad: f64) {
        let horizontal = libm::hypot(field_ut[0], field_ut[1]);
        (self.x[E], self.x[E + 1], self.x[E + 2]) = (0.0, horizontal, field_ut[2]);
        self.p[E][E] = horizontal * horizontal * sd_rad * sd_rad + LOCAL_FIELD_SD_UT * LOCAL_FIELD_SD_UT;
    }

    /// Returns the drift of the gyro heading about `axis`.
    pub(super) fn drift(&self, axis: Vector3<f64>) -> Drift {
        Drift { rate_rad_s: self.x[BETA], variance_rad2_s2: self.p[BETA][BETA], axis }
    }

    /// Adds a variance to the gyro heading. The ambient field e and the rest-site field p rotate
    /// with it.
    pub(super) fn add_heading_variance(&mut self, variance_rad2: f64) {
        let derivative = [(E, -self.x[E + 1]), (E + 1, self.x[E]), (SITE, -self.x[SITE + 1]), (SITE + 1, self.x[SITE])];
        for (i, by_i) in derivative {
            for (j, by_j) in derivative {
                self.p[i][j] += variance_rad2 * (by_i * by_j);
            }
        }
    }

    /// Applies the measurement e + d = p. Returns `true` if the innovation passed the gate.
    ///
    /// The equation holds if the body is back at the last rest site. e is the ambient field, d the
    /// local disturbance and p the magnetic field at the last rest site.
    pub(super) fn update_at_rest_site(&mut self) -> bool {
        const VARIANCE_UT2: f64 = REVISIT_SD_UT * REVISIT_SD_UT;
        let [across, along] = [0, 1].map(|i| self.rest_site_column(i));
        let s = |v: &[f64; STATES], i: usize| v[E + i] + v[D + i] - v[SITE + i];
        let r0 = libm::sqrt(s(&across, 0).max(0.0) + VARIANCE_UT2).recip();
        let l10 = s(&across, 1) * r0;
        let r1 = libm::sqrt((s(&along, 1) - l10 * l10).max(0.0) + VARIANCE_UT2).recip();
        let z0 = -s(&self.x, 0) * r0;
        let z1 = (-s(&self.x, 1) - l10 * z0) * r1;
        if z0 * z0 + z1 * z1 >= REVISIT_GATE {
            return false;
        }
        let w0 = across.map(|part| part * r0);
        let w1: [f64; STATES] = core::array::from_fn(|i| (along[i] - l10 * w0[i]) * r1);
        for i in 0..STATES {
            self.x[i] += w0[i] * z0 + w1[i] * z1;
            for j in 0..STATES {
                self.p[i][j] -= w0[i] * w0[j] + w1[i] * w1[j];
            }
            self.p[i][i] = self.p[i][i].max(0.0);
        }
        true
    }

    /// Returns the covariance between the state and component `i` of e + d − p.
    fn rest_site_column(&self, i: usize) -> [f64; STATES] {
        core::array::from_fn(|j| self.p[E + i][j] + self.p[D + i][j] - self.p[SITE + i][j])
    }

    /// Stores e + d as p, the magnetic field expected on a return to this rest site.
    pub(super) fn store_rest_site(&mut self) {
        for i in 0..2 {
            self.x[SITE + i] = self.x[E + i] + self.x[D + i];
            self.p[SITE + i] = core::array::from_fn(|j| self.p[E + i][j] + self.p[D + i][j]);
            for row in &mut self.p {
                row[SITE + i] = row[E + i] + row[D + i];
            }
        }
    }

    /// Makes the direction of the horizontal magnetic field unknown.
    ///
    /// The standard deviation of both components is set to the strength of the field, so that a
    /// field from any direction passes the gate.
    pub(super) fn invalidate_direction(&mut self) {
        let horizontal2 = self.x[E] * self.x[E] + self.x[E + 1] * self.x[E + 1];
        self.p[E][E] += horizontal2;
        self.p[E + 1][E + 1] += horizontal2;
    }

    /// Returns the angle (rad) that rotates the horizontal magnetic field to north, and its
    /// variance.
    pub(super) fn heading_correction(&self) -> (f64, f64) {
        let (x, y) = (self.x[E], self.x[E + 1]);
        let across = self.p[0][0] * y * y - 2.0 * self.p[0][1] * x * y + self.p[1][1] * x * x;
        let square = x * x + y * y;
        (libm::atan2(x, y), across.max(0.0) / (square * square).max(1e-12))
    }

    /// Propagates state and covariance over an interval.
    pub(super) fn predict(&mut self, propagation: &Propagation) {
        if propagation.motion_changed {
            (D..D + 3).for_each(|i| self.reset(i, LOCAL_FIELD_SD_UT));
        }
        for (i, max_variance) in (KAPPA..).zip(propagation.max_scale_variance) {
            self.limit_variance(i, max_variance);
        }
        if propagation.is_moving {
            self.propagate_drift(propagation);
        }
        for i in D..D + 3 {
            self.x[i] *= propagation.local_field_decay;
            self.p[i].iter_mut().for_each(|part| *part *= propagation.local_field_decay);
        }
        for row in &mut self.p {
            row[D..D + 3].iter_mut().for_each(|part| *part *= propagation.local_field_decay);
        }
        for i in 0..3 {
            self.p[D + i][D + i] += propagation.local_field_variance_ut2;
            self.p[E + i][E + i] += propagation.field_variance_ut2;
        }
        for i in [SITE, SITE + 1] {
            self.p[i][i] += propagation.field_variance_ut2;
        }
        self.add_heading_variance(propagation.heading_variance_rad2);
    }

    /// Limits the variance of a state. Correlations are kept.
    pub(super) fn limit_variance(&mut self, i: usize, max_variance: f64) {
        if self.p[i][i] > max_variance {
            let scale = libm::sqrt(max_variance / self.p[i][i]);
            self.p[i].iter_mut().for_each(|part| *part *= scale);
            self.p.iter_mut().for_each(|row| row[i] *= scale);
        }
    }

    /// Rotates the ambient field e and the rest-site field p by the drift βT + Σ κψ.
    fn propagate_drift(&mut self, propagation: &Propagation) {
        let Propagation { duration_s: t_s, vertical_rotation_rad: [psi_x, psi_y, psi_z], .. } = *propagation;
        let drift = |v: &[f64]| t_s * v[BETA] + psi_x * v[KAPPA] + psi_y * v[KAPPA + 1] + psi_z * v[KAPPA + 2];
        let sin = drift(&self.x).clamp(-0.1, 0.1);
        let cos = 1.0 - 0.5 * sin * sin;
        // F P Fᵀ: first the rows, then the columns.
        let (by_beta, [by_x, by_y, by_z]) = (self.p[BETA], [self.p[KAPPA], self.p[KAPPA + 1], self.p[KAPPA + 2]]);
        let rotation_row: [f64; STATES] =
            core::array::from_fn(|j| t_s * by_beta[j] + psi_x * by_x[j] + psi_y * by_y[j] + psi_z * by_z[j]);
        let horizontal_fields = [E, SITE].map(|i| (i, self.x[i], self.x[i + 1]));
        for (i, x, y) in horizontal_fields {
            (self.x[i], self.x[i + 1]) = (cos * x - sin * y, cos * y + sin * x);
            let (p0, p1) = (self.p[i], self.p[i + 1]);
            self.p[i] = core::array::from_fn(|j| cos * p0[j] - sin * p1[j] - y * rotation_row[j]);
            self.p[i + 1] = core::array::from_fn(|j| cos * p1[j] + sin * p0[j] + x * rotation_row[j]);
        }
        for row in &mut self.p {
            let c = drift(row);
            for (i, x, y) in horizontal_fields {
                let (a, b) = (row[i], row[i + 1]);
                row[i] = cos * a - sin * b - y * c;
                row[i + 1] = cos * b + sin * a + x * c;
            }
        }
        for i in KAPPA..KAPPA + 3 {
            self.p[i][i] += SCALE_WALK * SCALE_WALK * t_s;
        }
        // Copies one half of the symmetric covariance to the other, so that both are identical. A
        // snapshot stores only one of them.
        let summed = [E, E + 1, SITE, SITE + 1];
        for (k, i) in summed.into_iter().enumerate() {
            summed[k + 1..].iter().for_each(|j| self.p[*j][i] = self.p[i][*j]);
        }
        let drift_variance = &mut self.p[BETA][BETA];
        if *drift_variance < DRIFT_SD_RAD_S * DRIFT_SD_RAD_S {
            *drift_variance += propagation.drift_variance_rad2_s2;
        }
    }

    /// Updates the state with the mean magnetic field of an interval. `variance_ut2` is the
    /// variance of the field on each axis.
    ///
    /// The measurement is used only if the innovation passes the gate.
    pub(super) fn measure(
        &mut self,
        interval: &IntervalMeans,
        delay_s: f64,
        variance_ut2: f64,
        gate: f64,
    ) -> MeasurementResult {
        let (rate, e) = (interval.rate_rad_s, [self.x[0], self.x[1], self.x[2]]);
        let field_rate =
            [rate[1] * e[2] - rate[2] * e[1], rate[2] * e[0] - rate[0] * e[2], rate[0] * e[1] - rate[1] * e[0]];
        let delay_error_s = self.x[TAU] - delay_s;
        let mut innovation = [0.0; 3];
        let mut w = [[0.0; STATES]; 3];
        for i in 0..3 {
            let [a, b, c] = interval.axes[i];
            let hard_iron = a * self.x[B] + b * self.x[B + 1] + c * self.x[B + 2];
            innovation[i] = interval.field_ut[i] - (e[i] + delay_error_s * field_rate[i] + hard_iron + self.x[D + i]);
            for (j, w) in w[i].iter_mut().enumerate() {
                *w = self.p[E + i][j]
                    + self.p[D + i][j]
                    + field_rate[i] * self.p[TAU][j]
                    + a * self.p[B][j]
                    + b * self.p[B + 1][j]
                    + c * self.p[B + 2][j];
            }
        }
        let s = |i: usize, j: usize| {
            let ([a, b, c], w) = (interval.axes[j], &w[i]);
            w[E + j] + w[D + j] + field_rate[j] * w[TAU] + a * w[B] + b * w[B + 1] + c * w[B + 2]
        };
        // S = L Lᵀ. Each pivot is at least the noise variance, regardless of rounding.
        let d0 = s(0, 0).max(0.0) + variance_ut2;
        let r0 = libm::sqrt(d0).recip();
        let (l10, l20) = (s(0, 1) * r0, s(0, 2) * r0);
        let d1 = (s(1, 1) - l10 * l10).max(0.0) + variance_ut2;
        let r1 = libm::sqrt(d1).recip();
        let l21 = (s(1, 2) - l10 * l20) * r1;
        let d2 = (s(2, 2) - l20 * l20 - l21 * l21).max(0.0) + variance_ut2;
        let r2 = libm::sqrt(d2).recip();
        let z0 = innovation[0] * r0;
        let z1 = (innovation[1] - l10 * z0) * r1;
        let z2 = (innovation[2] - l20 * z0 - l21 * z1) * r2;
        let nis = z0 * z0 + z1 * z1 + z2 * z2;
        let accepted = nis < gate;
        if accepted {
            let [w0, w1, w2] = &mut w;
            for ((w0, w1), w2) in w0.iter_mut().zip(&mut *w1).zip(&mut *w2) {
                *w0 *= r0;
                *w1 = (*w1 - l10 * *w0) * r1;
                *w2 = (*w2 - l20 * *w0 - l21 * *w1) * r2;
            }
            for i in 0..STATES {
                self.x[i] += w0[i] * z0 + w1[i] * z1 + w2[i] * z2;
                for j in 0..STATES {
                    self.p[i][j] -= w0[i] * w0[j] + w1[i] * w1[j] + w2[i] * w2[j];
                }
                self.p[i][i] = self.p[i][i].max(0.0);
            }
            self.x[TAU] = self.x[TAU].clamp(MIN_DELAY_S, MAX_DELAY_S);
        }
        MeasurementResult { nis, determinant: d0 * d1 * d2, accepted }
    }

    /// Returns the reason why the state is invalid, or `None` if it is valid.
    ///
    /// The covariance is checked by its factorisation L D Lᵀ.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        let mut remainder = self.p;
        for k in 0..STATES {
            let (pivot, min_pivot) = (remainder[k][k], -1e-9 * self.p[k][k].max(0.0));
            if self.p[k][k] < 0.0 || pivot < min_pivot {
                return Some("a covariance of the field that is not positive semidefinite");
            }
            let row = remainder[k];
            for i in k + 1..STATES {
                let factor = if pivot > -min_pivot { row[i] / pivot } else { 0.0 };
                if factor == 0.0 && row[i] * row[i] > 1e-9 * self.p[k][k] * self.p[i][i] {
                    return Some("a covariance of the field that is not positive semidefinite");
                }
                remainder[i].iter_mut().zip(row).for_each(|(part, pivot_part)| *part -= factor * pivot_part);
            }
        }
        (self.x.iter().any(|x| x.abs() > 1e4)).then_some("a field above 10,000 µT")
    }
}

impl Scalars for FieldFilter {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.x.iter_mut().for_each(&mut *visit);
        for i in 0..STATES {
            for j in i..STATES {
                visit(&mut self.p[i][j]);
                self.p[j][i] = self.p[i][j];
            }
        }
    }
}
