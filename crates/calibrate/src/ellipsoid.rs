//! Model shared by accelerometer and magnetometer: a vector of constant length, distorted by a bias
//! and a matrix.
//!
//! The model is |M (v − b)| = R for a reading v in any direction, with the bias b, the matrix M and
//! the constant length R. M is symmetric, because a common rotation of all readings does not change
//! their lengths. The model has N = 6 or N = 9 parameters: b (3), the diagonal of M (3) and, only
//! if N = 9, the elements xy, xz, yz of M (3).
//!
//! The fit uses Gauss-Newton steps on the lengths themselves, because the noise of a length equals
//! the noise of a reading.
//!
//! Merayo et al. 2000, Scalar calibration of vector magnetometers, Meas. Sci. Technol. 11, 120;
//! Olivares et al. 2013.

use attitude::{Matrix3, Vector3};
use nalgebra::{SMatrix, SVector};

use crate::motion::MeanForce;

/// Parameters of the model: N is 6 or 9.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Ellipsoid<const N: usize>(pub(crate) SVector<f64, N>);

impl<const N: usize> Ellipsoid<N> {
    /// Creates the model of a sphere: the vector `scale` · (reading − `centre`) has a constant
    /// length.
    pub(crate) fn sphere(centre: Vector3<f64>, scale: f64) -> Self {
        let parameters = [centre.x, centre.y, centre.z, scale, scale, scale, 0.0, 0.0, 0.0];
        Self(SVector::from_fn(|i, _| parameters[i]))
    }

    pub(crate) fn bias(&self) -> Vector3<f64> {
        Vector3::new(self.0[0], self.0[1], self.0[2])
    }

    pub(crate) fn matrix(&self) -> Matrix3<f64> {
        let part = |i: usize| if i < N { self.0[i] } else { 0.0 };
        let (xy, xz, yz) = (part(6), part(7), part(8));
        Matrix3::new(part(3), xy, xz, xy, part(4), yz, xz, yz, part(5))
    }

    /// Returns the residual and its derivatives for a mean of readings that were rotated into one
    /// frame.
    pub(crate) fn residual_of_mean(&self, mean_force: &MeanForce, radius: f64) -> (f64, SVector<f64, N>) {
        let (matrix, bias) = (self.matrix(), self.bias());
        let mean = mean_force.corrected(&matrix, &bias);
        let length = mean.norm();
        let along = mean / length.max(f64::MIN_POSITIVE);
        let d_bias = -(matrix * (mean_force.mean_rotation.transpose() * along));
        // Derivative of the length with respect to the element of M at row i and column j.
        let d_element = |i: usize, j: usize| {
            (mean_force.component_means[j].column(i) - mean_force.mean_rotation.column(i) * bias[j]).dot(&along)
        };
        let d_cross = |i: usize, j: usize| d_element(i, j) + d_element(j, i);
        let parts = [
            d_bias.x,
            d_bias.y,
            d_bias.z,
            d_element(0, 0),
            d_element(1, 1),
            d_element(2, 2),
            d_cross(0, 1),
            d_cross(0, 2),
            d_cross(1, 2),
        ];
        (length - radius, SVector::from_fn(|i, _| parts[i]))
    }

    /// Returns the residual |M (v − b)| − R and its derivatives, with the reading v and the radius
    /// R.
    pub(crate) fn residual(&self, reading: &Vector3<f64>, radius: f64) -> (f64, SVector<f64, N>) {
        let (matrix, arm) = (self.matrix(), reading - self.bias());
        let corrected = matrix * arm;
        let length = corrected.norm();
        let along = corrected / length.max(f64::MIN_POSITIVE);
        let d_bias = -(matrix * along);
        let d_cross = |i: usize, j: usize| along[i] * arm[j] + along[j] * arm[i];
        let parts = [
            d_bias.x,
            d_bias.y,
            d_bias.z,
            along.x * arm.x,
            along.y * arm.y,
            along.z * arm.z,
            d_cross(0, 1),
            d_cross(0, 2),
            d_cross(1, 2),
        ];
        (length - radius, SVector::from_fn(|i, _| parts[i]))
    }
}

/// Returns the standard deviations of the bias, of the diagonal elements of M and of its
/// off-diagonal elements. Those of the off-diagonal elements are zero if N = 6.
pub(crate) fn standard_deviations<const N: usize>(covariance: &SMatrix<f64, N, N>) -> [Vector3<f64>; 3] {
    let sd = |i: usize| if i < N { covariance[(i, i)].max(0.0).sqrt() } else { 0.0 };
    [0, 3, 6].map(|first| Vector3::new(sd(first), sd(first + 1), sd(first + 2)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> Ellipsoid<9> {
        Ellipsoid([0.3, -0.2, 0.1, 1.02, 0.97, 1.01, 0.01, -0.02, 0.03].into())
    }

    fn assert_derivatives(residual: impl Fn(&Ellipsoid<9>) -> (f64, SVector<f64, 9>)) {
        let (length, derivatives) = residual(&example());
        for i in 0..9 {
            let mut shifted = example();
            shifted.0[i] += 1e-7;
            let numeric = (residual(&shifted).0 - length) / 1e-7;
            assert!((numeric - derivatives[i]).abs() < 1e-5, "{i}: {numeric} {}", derivatives[i]);
        }
    }

    #[test]
    fn jacobian_matches_finite_differences() {
        let reading = Vector3::new(3.0, -7.0, 5.0);
        assert_derivatives(|model| model.residual(&reading, 9.0));
        let rotation = nalgebra::Rotation3::from_euler_angles(0.3, -0.5, 0.8).into_inner() * 0.9;
        let component_means = [0, 1, 2].map(|axis| rotation * (reading[axis] + 0.5) + Matrix3::identity() * 0.2);
        let mean = MeanForce { component_means, mean_rotation: rotation, sides_up: [false; 6] };
        assert_derivatives(|model| model.residual_of_mean(&mean, 9.0));
    }

    #[test]
    fn mean_residual_of_one_reading_equals_its_residual() {
        let reading = Vector3::new(3.0, -7.0, 5.0);
        let (one, mean) =
            (example().residual(&reading, 9.0), example().residual_of_mean(&MeanForce::at_rest(&reading), 9.0));
        assert!((one.0 - mean.0).abs() < 1e-12 && (one.1 - mean.1).amax() < 1e-12);
    }
}
