//! Noise model, and its fit to Allan variances by generalised least squares.
//!
//! The Allan variance is σ²(τ) = N²/τ + (2 ln 2 / π) B² + K² τ/3 (IEEE Std 952-1997, annex C) with
//! the random walk N of the integrated signal, the bias instability B and the random walk K of the
//! bias. The coefficients N², B² and K² are fitted with the covariance matrix of all estimates. The
//! matrix depends on the coefficients, so the fit is repeated until the coefficients no longer
//! change. None of the coefficients may be negative.

use nalgebra::{SMatrix, SVector};

use super::allan::{Coefficients, Covariances, TYPES};

/// Maximum number of repetitions of the fit.
const MAX_REPETITIONS: usize = 100;
/// Relative change of the coefficients below which the fit counts as converged.
const TOLERANCE: f64 = 1e-6;
/// Share of the change that is applied in each repetition. If the whole change were applied, the
/// repetitions could alternate between two sets of noise types.
const STEP: f64 = 0.5;

/// Fitted coefficients.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Fit {
    pub(super) coefficients: Coefficients,
    /// Standard deviations that the coefficients would have if they could be negative.
    pub(super) sds: Coefficients,
    /// Sum of the squared normalised residuals.
    pub(super) chi_square: f64,
    /// Number of Allan variances less the number of coefficients.
    pub(super) freedom: f64,
}

/// Returns the contributions of the noise types to the Allan variance for coefficients of 1.
fn contributions(tau_s: f64) -> Coefficients {
    [1.0 / tau_s, 2.0 * std::f64::consts::LN_2 / std::f64::consts::PI, tau_s / 3.0]
}

/// Returns the Allan variance of the model.
pub(super) fn variance(coefficients: &Coefficients, tau_s: f64) -> f64 {
    coefficients.iter().zip(contributions(tau_s)).map(|(coefficient, contribution)| coefficient * contribution).sum()
}

/// Fits the model to Allan variances. Returns `None` if there are fewer variances than
/// coefficients or the fit does not converge.
pub(super) fn fit(taus_s: &[f64], variances: &[f64], covariances: &Covariances) -> Option<Fit> {
    let scale = *variances.first()?;
    if taus_s.len() < TYPES || scale <= 0.0 {
        return None;
    }
    // The variances are divided by the first one, so that the numbers are of the order of 1.
    let relative: Vec<f64> = variances.iter().map(|variance| variance / scale).collect();
    let mut coefficients = [taus_s[0], 0.0, 0.0];
    for _ in 0..MAX_REPETITIONS {
        let solved = Equations::new(taus_s, &relative, covariances, &coefficients)?.solve()?;
        let distance: f64 = taus_s
            .iter()
            .map(|tau_s| (variance(&solved, *tau_s) / variance(&coefficients, *tau_s) - 1.0).abs())
            .fold(0.0, f64::max);
        if distance < TOLERANCE {
            break;
        }
        coefficients = std::array::from_fn(|i| coefficients[i] + STEP * (solved[i] - coefficients[i]));
    }
    let equations = Equations::new(taus_s, &relative, covariances, &coefficients)?;
    let coefficients = equations.solve()?;
    let sds = equations.sds()?;
    Some(Fit {
        coefficients: coefficients.map(|coefficient| coefficient * scale),
        sds: sds.map(|sd| sd * scale),
        chi_square: equations.chi_square(&coefficients),
        freedom: (taus_s.len() - TYPES) as f64,
    })
}

/// Returns the standard deviations that a fit would have if the true coefficients were
/// `coefficients`.
pub(super) fn expected_sds(
    taus_s: &[f64],
    coefficients: &Coefficients,
    covariances: &Covariances,
) -> Option<Coefficients> {
    let scale = variance(coefficients, *taus_s.first()?);
    let relative = coefficients.map(|coefficient| coefficient / scale);
    let zeros = vec![0.0; taus_s.len()];
    let sds = Equations::new(taus_s, &zeros, covariances, &relative)?.sds()?;
    Some(sds.map(|sd| sd * scale))
}

/// Equations of a generalised least-squares fit, with residuals of unit covariance.
struct Equations {
    rows: Vec<SVector<f64, TYPES>>,
    values: Vec<f64>,
    /// Unit of each coefficient, chosen so that the largest contribution to a variance is 1.
    units: Coefficients,
}

impl Equations {
    /// Sets up the equations. Returns `None` if the covariance matrix is not positive definite.
    fn new(taus_s: &[f64], variances: &[f64], covariances: &Covariances, coefficients: &Coefficients) -> Option<Self> {
        let factor = cholesky(covariances.matrix(coefficients))?;
        let contributions: Vec<_> = taus_s.iter().map(|tau_s| contributions(*tau_s)).collect();
        let units = std::array::from_fn(|i| contributions.iter().map(|row| row[i]).fold(0.0, f64::max).recip());
        let columns: [Vec<f64>; TYPES] = std::array::from_fn(|i| {
            forward_substitute(&factor, contributions.iter().map(|row| row[i] * units[i]).collect())
        });
        let rows = (0..taus_s.len()).map(|k| SVector::from_fn(|i, _| columns[i][k])).collect();
        Some(Self { rows, values: forward_substitute(&factor, variances.to_vec()), units })
    }

    fn information(&self) -> SMatrix<f64, TYPES, TYPES> {
        self.rows.iter().map(|row| row * row.transpose()).sum()
    }

    fn sds(&self) -> Option<Coefficients> {
        let covariance = self.information().try_inverse()?;
        Some(std::array::from_fn(|i| covariance[(i, i)].max(0.0).sqrt() * self.units[i]))
    }

    fn chi_square(&self, coefficients: &Coefficients) -> f64 {
        let scaled = SVector::<f64, TYPES>::from_fn(|i, _| coefficients[i] / self.units[i]);
        self.rows.iter().zip(&self.values).map(|(row, value)| (value - row.dot(&scaled)).powi(2)).sum()
    }

    /// Returns the best coefficients that are not negative. Each set of noise types is tried.
    fn solve(&self) -> Option<Coefficients> {
        let information = self.information();
        let gradient: SVector<f64, TYPES> = self.rows.iter().zip(&self.values).map(|(row, value)| row * *value).sum();
        let solve_set = |set: usize| {
            let is_used = |i: usize| set & (1 << i) != 0;
            // An unused coefficient has the equation 1 · coefficient = 0.
            let reduced = SMatrix::<f64, TYPES, TYPES>::from_fn(|i, j| match (is_used(i), is_used(j)) {
                (true, true) => information[(i, j)],
                _ => f64::from(u8::from(i == j)),
            });
            let right = SVector::<f64, TYPES>::from_fn(|i, _| if is_used(i) { gradient[i] } else { 0.0 });
            let solution = reduced.cholesky()?.solve(&right);
            let coefficients = std::array::from_fn(|i| solution[i] * self.units[i]);
            solution.iter().all(|x| *x >= 0.0).then_some(coefficients)
        };
        let candidates = (1..1 << TYPES).filter_map(solve_set);
        candidates.min_by(|a, b| self.chi_square(a).total_cmp(&self.chi_square(b)))
    }
}

/// Returns the lower Cholesky factor of a matrix, or `None` if the matrix is not positive definite.
fn cholesky(mut matrix: Vec<Vec<f64>>) -> Option<Vec<Vec<f64>>> {
    for i in 0..matrix.len() {
        for j in 0..=i {
            let sum: f64 = (0..j).map(|k| matrix[i][k] * matrix[j][k]).sum();
            let rest = matrix[i][j] - sum;
            matrix[i][j] = match i == j {
                true if rest > 0.0 => rest.sqrt(),
                true => return None,
                false => rest / matrix[j][j],
            };
        }
    }
    Some(matrix)
}

/// Solves L x = `right` for a lower triangular matrix L.
fn forward_substitute(factor: &[Vec<f64>], mut right: Vec<f64>) -> Vec<f64> {
    for i in 0..right.len() {
        let sum: f64 = (0..i).map(|k| factor[i][k] * right[k]).sum();
        right[i] = (right[i] - sum) / factor[i][i];
    }
    right
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fit_of_exact_variances_returns_the_coefficients() {
        let taus_s: Vec<f64> = (0..10).map(|octave| f64::from(1 << octave)).collect();
        let covariances = Covariances::new(&taus_s, &[4000.0]);
        for truth in [[1.0, 0.2, 0.01], [1e-10, 0.0, 0.0], [3.0, 0.0, 0.02], [0.0, 1e-6, 0.0]] {
            let variances: Vec<_> = taus_s.iter().map(|tau_s| variance(&truth, *tau_s)).collect();
            let fit = fit(&taus_s, &variances, &covariances).unwrap();
            for (i, (found, truth)) in fit.coefficients.iter().zip(truth).enumerate() {
                assert!((found - truth).abs() < 1e-3 * fit.sds[i], "{fit:?}");
            }
            assert!(fit.chi_square < 1e-6 && fit.freedom == 7.0, "{fit:?}");
        }
        assert_eq!(fit(&taus_s[..2], &[1.0, 0.5], &Covariances::new(&taus_s[..2], &[4000.0])), None);
        assert_eq!(fit(&taus_s, &[0.0; 10], &covariances), None);
    }
}
