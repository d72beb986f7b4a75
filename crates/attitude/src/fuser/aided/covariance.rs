//! The covariance of the error (dv, φ, db, ds, dL) and the gain of a scalar measurement.
//!
//! φ turns the true attitude into the estimated one about reference axes; dv, db, ds are estimate less truth, dL truth less estimate.
//! In between measurements dv' = −[f ×] φ − R ds, φ' = −R db, with f the specific force in reference axes and R body → reference.

use nalgebra::{SMatrix, SVector};

use crate::{Matrix3, Vector3, numbers::Numbers};

/// Time between two steps of the covariance, s.
pub(super) const INTERVAL_S: f64 = 0.05;

/// Components of the error: velocity, m/s.
pub(super) const VELOCITY: usize = 0;
/// Rotation about east, north, up, rad.
pub(super) const ROTATION: usize = 3;
/// The last of these: heading.
pub(super) const HEADING: usize = 5;
/// Gyro bias, rad/s, body axes.
pub(super) const GYRO: usize = 6;
/// The gyro bias about the body's vertical axis.
pub(super) const GYRO_UP: usize = 8;
/// Accelerometer bias, m/s², body axes.
pub(super) const ACCEL: usize = 9;
/// Latency, s.
pub(super) const LATENCY: usize = 12;
/// All of them.
pub(super) const COUNT: usize = 13;

pub(super) type Error = SVector<f64, COUNT>;

/// Of all of them.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Covariance(SMatrix<f64, COUNT, COUNT>);

/// One interval of the motion.
#[derive(Debug, Clone, Copy)]
pub(super) struct Interval {
    /// Mean specific force, m/s², reference axes.
    pub(super) force_m_s2: Vector3<f64>,
    /// R.
    pub(super) to_reference: Matrix3<f64>,
    /// Whether heading acts on the velocity: only where it is counted from north.
    pub(super) heading_acts: bool,
    /// Its length.
    pub(super) dt_s: f64,
    /// Variances that it adds.
    pub(super) noise: Error,
}

/// One scalar measurement e = h·δ + noise.
#[derive(Debug, Clone, Copy)]
pub(super) struct Measurement<'a> {
    /// e.
    pub(super) residual: f64,
    /// The components of h that are not zero.
    pub(super) row: &'a [(usize, f64)],
    /// Variance of the noise.
    pub(super) variance: f64,
    /// Components that are considered and not corrected.
    pub(super) considered: &'a [usize],
}

impl Covariance {
    pub(super) fn of_variances(variances: Error) -> Self {
        Self(SMatrix::from_diagonal(&variances))
    }

    pub(super) fn variance(&self, index: usize) -> f64 {
        self.0[(index, index)]
    }

    /// P ← F P Fᵀ + Q.
    pub(super) fn advance(&mut self, interval: &Interval) {
        let Interval { force_m_s2, to_reference, heading_acts, dt_s, noise } = interval;
        let mut tilting = force_m_s2.cross_matrix() * -*dt_s;
        if !heading_acts {
            tilting.column_mut(2).fill(0.0);
        }
        let biasing = to_reference * -*dt_s;
        // Rows; the velocity first, because it needs the rotation's as they were.
        let velocity = tilting * self.0.fixed_rows::<3>(ROTATION) + biasing * self.0.fixed_rows::<3>(ACCEL);
        let rotation = biasing * self.0.fixed_rows::<3>(GYRO);
        let mut rows = self.0.fixed_rows_mut::<3>(VELOCITY);
        rows += velocity;
        let mut rows = self.0.fixed_rows_mut::<3>(ROTATION);
        rows += rotation;
        // Columns: those of the biases do not move, so that only the corner of velocity and rotation is left.
        let velocity = self.0.fixed_view::<6, 3>(0, ROTATION) * tilting.transpose()
            + self.0.fixed_view::<6, 3>(0, ACCEL) * biasing.transpose();
        let rotation = self.0.fixed_view::<6, 3>(0, GYRO) * biasing.transpose();
        let mut columns = self.0.fixed_view_mut::<6, 3>(0, VELOCITY);
        columns += velocity;
        let mut columns = self.0.fixed_view_mut::<6, 3>(0, ROTATION);
        columns += rotation;
        for i in 0..COUNT {
            self.0[(i, i)] += noise[i];
            for j in 0..i.min(GYRO) {
                let above = self.0[(j, i)];
                let both = if i < GYRO { 0.5 * (self.0[(i, j)] + above) } else { above };
                self.0[(i, j)] = both;
                self.0[(j, i)] = both;
            }
        }
    }

    /// δ += K (e − h δ); the innovation over its standard deviation. An innovation beyond `limit` standard deviations keeps the pull it has there.
    ///
    /// P ← (1 − K h) P (1 − K h)ᵀ + K R Kᵀ, which holds for every gain, also for one that leaves out what is only considered.
    pub(super) fn update(&mut self, error: &mut Error, limit: f64, measurement: &Measurement<'_>) -> f64 {
        let Measurement { residual, row, variance, considered } = *measurement;
        let mut spread = Error::zeros();
        for (index, weight) in row {
            spread.axpy(*weight, &self.0.column(*index), 1.0);
        }
        let innovation = row.iter().fold(residual, |rest, (index, weight)| rest - weight * error[*index]);
        let mut total = row.iter().fold(variance, |sum, (index, weight)| sum + weight * spread[*index]);
        let normalised = innovation / libm::sqrt(total);
        let beyond = normalised * normalised / (limit * limit);
        if beyond > 1.0 {
            total *= beyond;
        }
        if !(total > 0.0 && total.is_finite()) {
            return 0.0;
        }
        let mut gain = spread / total;
        for index in considered {
            gain[*index] = 0.0;
        }
        *error += gain * innovation;
        for j in 0..COUNT {
            for i in 0..=j {
                let less = gain[i] * spread[j] + spread[i] * gain[j] - gain[i] * gain[j] * total;
                self.0[(i, j)] -= less;
                self.0[(j, i)] = self.0[(i, j)];
            }
        }
        normalised
    }

    /// This variance, uncorrelated with everything else.
    pub(super) fn begin(&mut self, index: usize, variance: f64) {
        self.0.row_mut(index).fill(0.0);
        self.0.column_mut(index).fill(0.0);
        self.0[(index, index)] = variance;
    }

    /// No variance above its limit; what is held back keeps its correlations.
    pub(super) fn hold(&mut self, limits: &Error) {
        for (i, limit) in limits.iter().enumerate() {
            let variance = self.variance(i);
            if variance > *limit {
                let scale = libm::sqrt(limit / variance);
                self.0.row_mut(i).scale_mut(scale);
                self.0.column_mut(i).scale_mut(scale);
            }
        }
    }

    /// What is wrong with it. A variance may be zero, the pivots of P = L D Lᵀ may not be below it by more than rounding.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        if (0..COUNT).any(|i| !(0.0..1e12).contains(&self.variance(i))) {
            return Some("a variance below zero");
        }
        if (0..COUNT).any(|i| (0..i).any(|j| self.0[(i, j)] != self.0[(j, i)])) {
            return Some("a covariance that is not symmetric");
        }
        let mut rest = self.0;
        for k in 0..COUNT {
            let pivot = rest[(k, k)];
            let rounding = 1e-9 * self.variance(k);
            if pivot < -rounding {
                return Some("a covariance that is not positive");
            }
            for i in k + 1..COUNT {
                let share = if pivot > rounding { rest[(i, k)] / pivot } else { 0.0 };
                for j in k + 1..COUNT {
                    rest[(i, j)] -= share * rest[(k, j)];
                }
            }
        }
        None
    }
}

impl Numbers for Covariance {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.0.iter_mut().for_each(visit);
    }
}
