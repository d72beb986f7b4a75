//! Normal equations of weighted least squares, and two covariances of what they give.
//!
//! With residuals r_i, Jacobians J_i and weights w_i: H = Σ w JᵀJ, g = Σ w Jᵀr, the step of Gauss and Newton is −H⁻¹g. The covariance is
//! H⁻¹ where the weights are the inverse variances. Where errors of neighbours hang together, as those of a magnetometer in a room do,
//! it is H⁻¹ (Σ_b s_b s_bᵀ) H⁻¹ with s_b = Σ w Jᵀr over block b of neighbours (White 1980; Liang and Zeger 1986); of few blocks that may come out too
//! small by chance, so that no parameter is taken to be better known than errors of the residuals' size that are all independent allow.

use nalgebra::{Cholesky, SMatrix, SVector};

/// Sums over residuals of N parameters.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Normal<const N: usize> {
    information: SMatrix<f64, N, N>,
    gradient: SVector<f64, N>,
    cost: f64,
    weight: f64,
    block: SVector<f64, N>,
    spread: SMatrix<f64, N, N>,
    /// Σ w² JᵀJ.
    squares: SMatrix<f64, N, N>,
    count: usize,
    blocks: usize,
}

impl<const N: usize> Normal<N> {
    pub(crate) fn new() -> Self {
        Self {
            information: SMatrix::zeros(),
            gradient: SVector::zeros(),
            cost: 0.0,
            weight: 0.0,
            block: SVector::zeros(),
            spread: SMatrix::zeros(),
            squares: SMatrix::zeros(),
            count: 0,
            blocks: 0,
        }
    }

    /// A residual and its derivatives.
    pub(crate) fn add(&mut self, residual: f64, jacobian: &SVector<f64, N>, weight: f64) {
        self.information.ger(weight, jacobian, jacobian, 1.0);
        self.squares.ger(weight * weight, jacobian, jacobian, 1.0);
        self.count += 1;
        self.block.axpy(weight * residual, jacobian, 1.0);
        self.cost += weight * residual * residual;
        self.weight += weight;
    }

    /// What follows hangs no more together with what was added.
    pub(crate) fn end_block(&mut self) {
        if self.block.amax() > 0.0 {
            self.spread.ger(1.0, &self.block, &self.block, 1.0);
            self.gradient += self.block;
            self.block = SVector::zeros();
            self.blocks += 1;
        }
    }

    /// What is to be added to the parameters; none where the residuals do not determine them. Ends the block.
    pub(crate) fn step(&mut self) -> Option<SVector<f64, N>> {
        self.end_block();
        let step = -Cholesky::new(self.information)?.solve(&self.gradient);
        step.iter().all(|part| part.is_finite()).then_some(step)
    }

    /// Σ w r².
    pub(crate) fn cost(&self) -> f64 {
        self.cost
    }

    /// Root of the weighted mean of the squares.
    pub(crate) fn rms(&self) -> f64 {
        (self.cost / self.weight.max(f64::MIN_POSITIVE)).sqrt()
    }

    /// H⁻¹.
    pub(crate) fn covariance(&self) -> Option<SMatrix<f64, N, N>> {
        Some(Cholesky::new(self.information)?.inverse())
    }

    /// That of errors which hang together within a block; none where there are too few blocks to tell.
    pub(crate) fn block_covariance(&self) -> Option<SMatrix<f64, N, N>> {
        let inverse = self.covariance()?;
        let free = self.blocks.checked_sub(N).filter(|free| *free >= N)?;
        // The residuals are smaller than the errors by what the parameters took.
        let correction = self.blocks as f64 / free as f64;
        let by_blocks = inverse * self.spread * inverse * correction;
        let variance = self.cost / self.weight * self.count as f64 / self.count.checked_sub(N)?.max(1) as f64;
        let by_each = inverse * self.squares * inverse * variance;
        let widened = SVector::<f64, N>::from_fn(|i, _| (by_each[(i, i)] / by_blocks[(i, i)]).max(1.0).sqrt());
        Some(by_blocks.component_mul(&(widened * widened.transpose())))
    }
}
