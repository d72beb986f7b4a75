//! Covariance of the error (dv, φ, db, ds, dL) and its update by a scalar measurement.
//!
//! The components are the errors of velocity, attitude, gyro bias b, accelerometer bias s and
//! receiver latency L. φ rotates the true attitude into the estimated one about reference axes. dv,
//! db and ds are estimate minus truth, dL is truth minus estimate. Between measurements
//! dv' = −[f ×] φ − R ds and φ' = −R db, with the specific force f in reference axes and R body →
//! reference.

use nalgebra::SVector;

use crate::{Matrix3, Vector3, scalars::Scalars};

/// Interval between two propagations of the covariance, s.
pub(super) const INTERVAL_S: f64 = 0.05;

/// Index of the velocity error, m/s. Each vector occupies three consecutive components.
pub(super) const VELOCITY: usize = 0;
/// Index of the rotation about east, north and up, rad.
pub(super) const ROTATION: usize = 3;
/// Index of the heading, the last component of the rotation.
pub(super) const HEADING: usize = 5;
/// Index of the gyro bias in body axes, rad/s.
pub(super) const GYRO: usize = 6;
/// Index of the gyro bias about the body's vertical axis.
pub(super) const GYRO_UP: usize = 8;
/// Index of the accelerometer bias in body axes, m/s².
pub(super) const ACCEL: usize = 9;
/// Index of the latency, s.
pub(super) const LATENCY: usize = 12;
/// Number of components of the error state.
pub(super) const COUNT: usize = 13;

pub(super) type ErrorState = SVector<f64, COUNT>;

type Row = [f64; COUNT];

/// Covariance of the error state. It is symmetric, and both halves are stored.
///
/// Plain arrays are used because their loops need fewer instructions than views of a nalgebra
/// matrix.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Covariance([Row; COUNT]);

/// Motion over one propagation interval.
#[derive(Debug, Clone, Copy)]
pub(super) struct PropagationInterval {
    /// Mean specific force in reference axes, m/s².
    pub(super) force_m_s2: Vector3<f64>,
    /// Rotation matrix R, body → reference.
    pub(super) to_reference: Matrix3<f64>,
    /// `true` if the heading refers to north. Only then does a heading error affect the velocity.
    pub(super) heading_acts: bool,
    pub(super) dt_s: f64,
    /// Variances added over the interval.
    pub(super) noise: ErrorState,
}

/// Scalar measurement of the error state δ: e = h·δ + noise.
#[derive(Debug, Clone, Copy)]
pub(super) struct Measurement<'a> {
    /// Measured value e.
    pub(super) residual: f64,
    /// Non-zero components of h, with their indices.
    pub(super) row: &'a [(usize, f64)],
    /// Variance of the measurement noise.
    pub(super) variance: f64,
    /// Indices of the states that are considered but not corrected (Schmidt–Kalman).
    pub(super) considered: &'a [usize],
}

impl Covariance {
    pub(super) fn from_variances(variances: ErrorState) -> Self {
        let mut rows = [[0.0; COUNT]; COUNT];
        rows.iter_mut().zip(variances.iter()).enumerate().for_each(|(i, (row, variance))| row[i] = *variance);
        Self(rows)
    }

    pub(super) fn variance(&self, index: usize) -> f64 {
        self.0[index][index]
    }

    /// Propagates P ← F P Fᵀ + Q.
    pub(super) fn propagate(&mut self, interval: &PropagationInterval) {
        let PropagationInterval { force_m_s2, to_reference, heading_acts, dt_s, noise } = interval;
        let mut tilt_coupling = force_m_s2.cross_matrix() * -*dt_s;
        if !heading_acts {
            tilt_coupling.column_mut(2).fill(0.0);
        }
        let bias_coupling = to_reference * -*dt_s;
        let p = &mut self.0;
        // F P changes the rows. The velocity rows are updated before the rotation rows, because
        // they depend on the old values of the rotation rows.
        for i in 0..3 {
            let by_tilt = weighted_sum(&tilt_coupling, i, &p[ROTATION..GYRO]);
            let by_bias = weighted_sum(&bias_coupling, i, &p[ACCEL..LATENCY]);
            for j in 0..COUNT {
                p[VELOCITY + i][j] += by_tilt[j] + by_bias[j];
            }
        }
        for i in 0..3 {
            let by_bias = weighted_sum(&bias_coupling, i, &p[GYRO..ACCEL]);
            for j in 0..COUNT {
                p[ROTATION + i][j] += by_bias[j];
            }
        }
        // (F P) Fᵀ changes the columns. The columns of the biases stay the same, so only the block
        // of velocity and rotation remains to be updated.
        let product = |row: &Row, first: usize, coupling: &Matrix3<f64>, j: usize| {
            row[first] * coupling[(j, 0)] + row[first + 1] * coupling[(j, 1)] + row[first + 2] * coupling[(j, 2)]
        };
        for row in &mut p[..GYRO] {
            let old = *row;
            for j in 0..3 {
                row[VELOCITY + j] +=
                    product(&old, ROTATION, &tilt_coupling, j) + product(&old, ACCEL, &bias_coupling, j);
                row[ROTATION + j] += product(&old, GYRO, &bias_coupling, j);
            }
        }
        for i in 0..COUNT {
            p[i][i] += noise[i];
            (0..i.min(GYRO)).for_each(|j| {
                let above = p[j][i];
                let mean = if i < GYRO { 0.5 * (p[i][j] + above) } else { above };
                (p[i][j], p[j][i]) = (mean, mean);
            });
        }
    }

    /// Updates the error δ with the gain K, δ += K (e − h δ). Returns the innovation divided by its
    /// standard deviation.
    ///
    /// An innovation above `limit` standard deviations has the same effect as one of exactly
    /// `limit`.
    ///
    /// The covariance is P ← (1 − K h) P (1 − K h)ᵀ + K R Kᵀ, with the noise variance R. This holds
    /// for every gain, including one that is zero for considered states.
    pub(super) fn update(&mut self, error: &mut ErrorState, limit: f64, measurement: &Measurement<'_>) -> f64 {
        let Measurement { residual, row, variance, considered } = *measurement;
        let mut p_h = [0.0; COUNT];
        for (index, weight) in row {
            p_h.iter_mut().zip(&self.0[*index]).for_each(|(sum, part)| *sum += weight * part);
        }
        let innovation = row.iter().fold(residual, |remainder, (index, weight)| remainder - weight * error[*index]);
        let mut innovation_variance = row.iter().fold(variance, |sum, (index, weight)| sum + weight * p_h[*index]);
        let normalised = innovation / libm::sqrt(innovation_variance);
        let excess = normalised * normalised / (limit * limit);
        if excess > 1.0 {
            innovation_variance *= excess;
        }
        if !(innovation_variance > 0.0 && innovation_variance.is_finite()) {
            return 0.0;
        }
        let mut gain = p_h.map(|part| part / innovation_variance);
        for index in considered {
            gain[*index] = 0.0;
        }
        error.iter_mut().zip(gain).for_each(|(error, gain)| *error += gain * innovation);
        for i in 0..COUNT {
            for j in i..COUNT {
                let reduction = gain[i] * p_h[j] + p_h[i] * gain[j] - gain[i] * gain[j] * innovation_variance;
                self.0[i][j] -= reduction;
                self.0[j][i] = self.0[i][j];
            }
        }
        normalised
    }

    /// Sets the variance of a state and removes its correlations.
    pub(super) fn reset(&mut self, index: usize, variance: f64) {
        self.0[index] = [0.0; COUNT];
        self.0.iter_mut().for_each(|row| row[index] = 0.0);
        self.0[index][index] = variance;
    }

    /// Limits the variances. Correlations are kept.
    pub(super) fn limit_variances(&mut self, limits: &ErrorState) {
        for (i, limit) in limits.iter().enumerate() {
            let variance = self.variance(i);
            if variance > *limit {
                let scale = libm::sqrt(limit / variance);
                self.0[i].iter_mut().for_each(|part| *part *= scale);
                self.0.iter_mut().for_each(|row| row[i] *= scale);
            }
        }
    }

    /// Returns the reason why the covariance is invalid, or `None` if it is valid.
    ///
    /// A variance may be zero. The pivots of P = L D Lᵀ may be negative only by rounding.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        if (0..COUNT).any(|i| !(0.0..1e12).contains(&self.variance(i))) {
            return Some("a variance below zero");
        }
        if (0..COUNT).any(|i| (0..i).any(|j| self.0[i][j] != self.0[j][i])) {
            return Some("a covariance that is not symmetric");
        }
        let mut remainder = self.0;
        for k in 0..COUNT {
            let pivot_row = remainder[k];
            let pivot = pivot_row[k];
            let rounding = 1e-9 * self.variance(k);
            if pivot < -rounding {
                return Some("a covariance that is not positive");
            }
            for row in remainder.iter_mut().skip(k + 1) {
                let factor = if pivot > rounding { row[k] / pivot } else { 0.0 };
                let parts = row.iter_mut().zip(pivot_row).skip(k + 1);
                parts.for_each(|(part, pivot_part)| *part -= factor * pivot_part);
            }
        }
        None
    }
}

impl Scalars for Covariance {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.0.as_flattened_mut().iter_mut().for_each(visit);
    }
}

/// Returns the product of row `i` of a matrix with three rows of a covariance.
#[inline]
fn weighted_sum(matrix: &Matrix3<f64>, i: usize, rows: &[Row]) -> Row {
    let [a, b, c] = [matrix[(i, 0)], matrix[(i, 1)], matrix[(i, 2)]];
    core::array::from_fn(|j| a * rows[0][j] + b * rows[1][j] + c * rows[2][j])
}
