//! Normal equations of weighted least squares, with two covariance estimates.
//!
//! With residuals r_i, Jacobians J_i and weights w_i: H = Σ w JᵀJ, g = Σ w Jᵀr, and the
//! Gauss-Newton step is −H⁻¹g. If the weights are inverse variances, the covariance is H⁻¹.
//!
//! If the errors of neighbouring residuals are correlated, as for a magnetometer in a room, the
//! covariance is H⁻¹ (Σ_b s_b s_bᵀ) H⁻¹ with s_b = Σ w Jᵀr over block b of neighbours (White 1980;
//! Liang and Zeger 1986). With few blocks, this estimate can be too small by chance. Each variance
//! is therefore at least the one for independent errors of the same size as the residuals.

use nalgebra::{Cholesky, SMatrix, SVector};

/// Sums of the normal equations for N parameters.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NormalEquations<const N: usize> {
    information: SMatrix<f64, N, N>,
    gradient: SVector<f64, N>,
    cost: f64,
    weight: f64,
    /// Score Σ w Jᵀr of the current block.
    block_score: SVector<f64, N>,
    /// Σ s sᵀ over the completed blocks, each with the score s.
    block_scatter: SMatrix<f64, N, N>,
    /// Sum Σ w² JᵀJ over the residuals.
    squared_information: SMatrix<f64, N, N>,
    count: usize,
    blocks: usize,
}

impl<const N: usize> NormalEquations<N> {
    pub(crate) fn new() -> Self {
        Self {
            information: SMatrix::zeros(),
            gradient: SVector::zeros(),
            cost: 0.0,
            weight: 0.0,
            block_score: SVector::zeros(),
            block_scatter: SMatrix::zeros(),
            squared_information: SMatrix::zeros(),
            count: 0,
            blocks: 0,
        }
    }

    /// Adds a residual with its derivatives.
    pub(crate) fn add(&mut self, residual: f64, jacobian: &SVector<f64, N>, weight: f64) {
        self.information.ger(weight, jacobian, jacobian, 1.0);
        self.squared_information.ger(weight * weight, jacobian, jacobian, 1.0);
        self.count += 1;
        self.block_score.axpy(weight * residual, jacobian, 1.0);
        self.cost += weight * residual * residual;
        self.weight += weight;
    }

    /// Ends the current block. Residuals added afterwards are assumed to be uncorrelated with those
    /// of the ended block.
    pub(crate) fn end_block(&mut self) {
        if self.block_score.amax() > 0.0 {
            self.block_scatter.ger(1.0, &self.block_score, &self.block_score, 1.0);
            self.gradient += self.block_score;
            self.block_score = SVector::zeros();
            self.blocks += 1;
        }
    }

    /// Ends the current block and returns the Gauss-Newton step. Returns `None` if the residuals do
    /// not determine the parameters.
    pub(crate) fn step(&mut self) -> Option<SVector<f64, N>> {
        self.end_block();
        let step = -Cholesky::new(self.information)?.solve(&self.gradient);
        step.iter().all(|part| part.is_finite()).then_some(step)
    }

    /// Returns the cost Σ w r² of the residuals r with the weights w.
    pub(crate) fn cost(&self) -> f64 {
        self.cost
    }

    /// Returns the weighted root mean square of the residuals.
    pub(crate) fn rms(&self) -> f64 {
        (self.cost / self.weight.max(f64::MIN_POSITIVE)).sqrt()
    }

    /// Returns H⁻¹, which is the covariance if the weights are inverse variances.
    pub(crate) fn covariance(&self) -> Option<SMatrix<f64, N, N>> {
        Some(Cholesky::new(self.information)?.inverse())
    }

    /// Returns the covariance for errors correlated within blocks, or `None` if there are too few
    /// blocks.
    pub(crate) fn block_covariance(&self) -> Option<SMatrix<f64, N, N>> {
        let inverse = self.covariance()?;
        let free = self.blocks.checked_sub(N).filter(|free| *free >= N)?;
        // Small-sample correction, because the fit makes the residuals smaller than the errors.
        let correction = self.blocks as f64 / free as f64;
        let clustered = inverse * self.block_scatter * inverse * correction;
        let variance = self.cost / self.weight * self.count as f64 / self.count.checked_sub(N)?.max(1) as f64;
        let independent = inverse * self.squared_information * inverse * variance;
        let inflation = SVector::<f64, N>::from_fn(|i, _| (independent[(i, i)] / clustered[(i, i)]).max(1.0).sqrt());
        Some(clustered.component_mul(&(inflation * inflation.transpose())))
    }
}
