//! Covariance of the error (dv, φ, db, ds, dL) and its update by a scalar measurement.
//!
//! The components are the errors of velocity, attitude, gyro bias b, accelerometer bias s and
//! receiver latency L. φ rotates the true attitude into the estimated one about reference axes. dv,
//! db and ds are estimate minus truth, dL is truth minus estimate. Between measurements
//! dv' = −[f ×] φ − R ds and φ' = −R db, with the specific force f in reference axes and R body →
//! reference.

use nalgebra::{SMatrix, SVector};

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

/// Covariance of the error state.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Covariance(SMatrix<f64, COUNT, COUNT>);

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
        Self(SMatrix::from_diagonal(&variances))
    }

    pub(super) fn variance(&self, index: usize) -> f64 {
        self.0[(index, index)]
    }

    /// Propagates P ← F P Fᵀ + Q.
    pub(super) fn propagate(&mut self, interval: &PropagationInterval) {
        let PropagationInterval { force_m_s2, to_reference, heading_acts, dt_s, noise } = interval;
        let mut tilt_coupling = force_m_s2.cross_matrix() * -*dt_s;
        if !heading_acts {
            tilt_coupling.column_mut(2).fill(0.0);
        }
        let bias_coupling = to_reference * -*dt_s;
        // F P changes the rows. The velocity rows are updated before the rotation rows, because
        // they depend on the old values of the rotation rows.
        let velocity = tilt_coupling * self.0.fixed_rows::<3>(ROTATION) + bias_coupling * self.0.fixed_rows::<3>(ACCEL);
        let rotation = bias_coupling * self.0.fixed_rows::<3>(GYRO);
        let mut rows = self.0.fixed_rows_mut::<3>(VELOCITY);
        rows += velocity;
        let mut rows = self.0.fixed_rows_mut::<3>(ROTATION);
        rows += rotation;
        // (F P) Fᵀ changes the columns. The columns of the biases stay the same, so only the block
        // of velocity and rotation remains to be updated.
        let velocity = self.0.fixed_view::<6, 3>(0, ROTATION) * tilt_coupling.transpose()
            + self.0.fixed_view::<6, 3>(0, ACCEL) * bias_coupling.transpose();
        let rotation = self.0.fixed_view::<6, 3>(0, GYRO) * bias_coupling.transpose();
        let mut columns = self.0.fixed_view_mut::<6, 3>(0, VELOCITY);
        columns += velocity;
        let mut columns = self.0.fixed_view_mut::<6, 3>(0, ROTATION);
        columns += rotation;
        for i in 0..COUNT {
            self.0[(i, i)] += noise[i];
            for j in 0..i.min(GYRO) {
                let above = self.0[(j, i)];
                let mean = if i < GYRO { 0.5 * (self.0[(i, j)] + above) } else { above };
                self.0[(i, j)] = mean;
                self.0[(j, i)] = mean;
            }
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
        let mut p_h = ErrorState::zeros();
        for (index, weight) in row {
            p_h.axpy(*weight, &self.0.column(*index), 1.0);
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
        let mut gain = p_h / innovation_variance;
        for index in considered {
            gain[*index] = 0.0;
        }
        *error += gain * innovation;
        for j in 0..COUNT {
            for i in 0..=j {
                let reduction = gain[i] * p_h[j] + p_h[i] * gain[j] - gain[i] * gain[j] * innovation_variance;
                self.0[(i, j)] -= reduction;
                self.0[(j, i)] = self.0[(i, j)];
            }
        }
        normalised
    }

    /// Sets the variance of a state and removes its correlations.
    pub(super) fn reset(&mut self, index: usize, variance: f64) {
        self.0.row_mut(index).fill(0.0);
        self.0.column_mut(index).fill(0.0);
        self.0[(index, index)] = variance;
    }

    /// Limits the variances. Correlations are kept.
    pub(super) fn limit_variances(&mut self, limits: &ErrorState) {
        for (i, limit) in limits.iter().enumerate() {
            let variance = self.variance(i);
            if variance > *limit {
                let scale = libm::sqrt(limit / variance);
                self.0.row_mut(i).scale_mut(scale);
                self.0.column_mut(i).scale_mut(scale);
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
        if (0..COUNT).any(|i| (0..i).any(|j| self.0[(i, j)] != self.0[(j, i)])) {
            return Some("a covariance that is not symmetric");
        }
        let mut remainder = self.0;
        for k in 0..COUNT {
            let pivot = remainder[(k, k)];
            let rounding = 1e-9 * self.variance(k);
            if pivot < -rounding {
                return Some("a covariance that is not positive");
            }
            for i in k + 1..COUNT {
                let factor = if pivot > rounding { remainder[(i, k)] / pivot } else { 0.0 };
                for j in k + 1..COUNT {
                    remainder[(i, j)] -= factor * remainder[(k, j)];
                }
            }
        }
        None
    }
}

impl Scalars for Covariance {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.0.iter_mut().for_each(visit);
    }
}
