//! The model that accelerometer and magnetometer have in common: a vector of one length, seen through a bias and a matrix.
//!
//! |M (v − b)| = R for readings v in any direction, M symmetric: a turn of all readings together is not seen in their lengths, and the
//! symmetric matrix is the one that turns least. Parameters: b(3), the diagonal of M (3), and xy, xz, yz of M (3) where there are nine.
//! Merayo et al. 2000, Scalar calibration of vector magnetometers, Meas. Sci. Technol. 11, 120; Olivares et al. 2013; here by
//! Gauss and Newton in the lengths themselves, whose noise is that of the readings.

use attitude::{Matrix3, Vector3};
use nalgebra::{SMatrix, SVector};

use crate::motion::Seen;

/// The six or nine parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Ellipsoid<const N: usize>(pub(crate) SVector<f64, N>);

impl<const N: usize> Ellipsoid<N> {
    /// A sphere about a centre; `scale` times a reading less the centre has the length that is looked for.
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

    /// The same of a mean of readings that were turned into one frame.
    pub(crate) fn residual_of_mean(&self, seen: &Seen, radius: f64) -> (f64, SVector<f64, N>) {
        let (matrix, bias) = (self.matrix(), self.bias());
        let mean = seen.corrected(&matrix, &bias);
        let length = mean.norm();
        let along = mean / length.max(f64::MIN_POSITIVE);
        let by_bias = -(matrix * (seen.turn.transpose() * along));
        // By the part of M at row i and column j.
        let by_part = |i: usize, j: usize| (seen.turned[j].column(i) - seen.turn.column(i) * bias[j]).dot(&along);
        let off = |i: usize, j: usize| by_part(i, j) + by_part(j, i);
        let parts = [
            by_bias.x,
            by_bias.y,
            by_bias.z,
            by_part(0, 0),
            by_part(1, 1),
            by_part(2, 2),
            off(0, 1),
            off(0, 2),
            off(1, 2),
        ];
        (length - radius, SVector::from_fn(|i, _| parts[i]))
    }

    /// |M (v − b)| − R, and its derivatives.
    pub(crate) fn residual(&self, reading: &Vector3<f64>, radius: f64) -> (f64, SVector<f64, N>) {
        let (matrix, arm) = (self.matrix(), reading - self.bias());
        let seen = matrix * arm;
        let length = seen.norm();
        let along = seen / length.max(f64::MIN_POSITIVE);
        let by_bias = -(matrix * along);
        let off = |i: usize, j: usize| along[i] * arm[j] + along[j] * arm[i];
        let parts = [
            by_bias.x,
            by_bias.y,
            by_bias.z,
            along.x * arm.x,
            along.y * arm.y,
            along.z * arm.z,
            off(0, 1),
            off(0, 2),
            off(1, 2),
        ];
        (length - radius, SVector::from_fn(|i, _| parts[i]))
    }
}

/// Standard deviations: of the bias, of the diagonal, and of the rest (zero where that was not looked for).
pub(crate) fn deviations<const N: usize>(covariance: &SMatrix<f64, N, N>) -> [Vector3<f64>; 3] {
    let sd = |i: usize| if i < N { covariance[(i, i)].max(0.0).sqrt() } else { 0.0 };
    [0, 3, 6].map(|first| Vector3::new(sd(first), sd(first + 1), sd(first + 2)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn somewhere() -> Ellipsoid<9> {
        Ellipsoid([0.3, -0.2, 0.1, 1.02, 0.97, 1.01, 0.01, -0.02, 0.03].into())
    }

    fn assert_derivatives(residual: impl Fn(&Ellipsoid<9>) -> (f64, SVector<f64, 9>)) {
        let (length, derivatives) = residual(&somewhere());
        for i in 0..9 {
            let mut moved = somewhere();
            moved.0[i] += 1e-7;
            let by_difference = (residual(&moved).0 - length) / 1e-7;
            assert!((by_difference - derivatives[i]).abs() < 1e-5, "{i}: {by_difference} {}", derivatives[i]);
        }
    }

    #[test]
    fn the_derivatives_are_those_of_the_residuals() {
        let reading = Vector3::new(3.0, -7.0, 5.0);
        assert_derivatives(|at| at.residual(&reading, 9.0));
        let turn = nalgebra::Rotation3::from_euler_angles(0.3, -0.5, 0.8).into_inner() * 0.9;
        let turned = [0, 1, 2].map(|axis| turn * (reading[axis] + 0.5) + Matrix3::identity() * 0.2);
        assert_derivatives(|at| at.residual_of_mean(&Seen { turned, turn, sides_up: [false; 6] }, 9.0));
    }

    #[test]
    fn a_mean_of_one_is_that_one() {
        let reading = Vector3::new(3.0, -7.0, 5.0);
        let (one, mean) =
            (somewhere().residual(&reading, 9.0), somewhere().residual_of_mean(&Seen::still(&reading), 9.0));
        assert!((one.0 - mean.0).abs() < 1e-12 && (one.1 - mean.1).amax() < 1e-12);
    }
}
