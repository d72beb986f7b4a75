//! Gradient of the difference between measured and expected directions.

use crate::{Quaternion, Vector3};

/// Measured reference directions, unit vectors in body axes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct ReferenceDirections {
    pub(super) up: Option<Vector3<f64>>,
    pub(super) field: Option<Vector3<f64>>,
}

impl ReferenceDirections {
    /// Returns ∇F = Jᵀ F at the unit quaternion `q`.
    pub(super) fn gradient(&self, q: Quaternion<f64>, field_weight: f64) -> Quaternion<f64> {
        let term = |direction: Vector3<f64>, measured: Vector3<f64>| {
            let expected = (q.conjugate() * Quaternion::from_imag(direction) * q).imag();
            Quaternion::from_parts(1.0 - expected.dot(&measured), expected.cross(&measured))
        };
        let mut sum = Quaternion::from_imag(Vector3::zeros());
        if let Some(up) = self.up {
            sum += term(Vector3::z(), up);
        }
        if let Some(field) = self.field {
            let h = (q * Quaternion::from_imag(field) * q.conjugate()).imag();
            sum += term(Vector3::new(0.0, libm::sqrt(h.x * h.x + h.y * h.y), h.z), field) * field_weight;
        }
        q * sum * 2.0
    }
}

/// Normalises a quaternion. Returns `None` if its length is zero or not finite.
pub(super) fn normalized(q: Quaternion<f64>) -> Option<Quaternion<f64>> {
    let length = q.norm();
    (length > 0.0 && length.is_finite()).then(|| q / length)
}
