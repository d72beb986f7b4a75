//! The gradient of what the sensors see against what the attitude expects.

use crate::{Quaternion, Vector3};

/// The directions that the sensors see, unit vectors in body axes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Seen {
    pub(super) up: Option<Vector3<f64>>,
    pub(super) field: Option<Vector3<f64>>,
}

impl Seen {
    /// ∇F = Jᵀ F at q, of a unit quaternion.
    pub(super) fn gradient(&self, q: Quaternion<f64>, field_weight: f64) -> Quaternion<f64> {
        let part = |direction: Vector3<f64>, seen: Vector3<f64>| {
            let expected = (q.conjugate() * Quaternion::from_imag(direction) * q).imag();
            Quaternion::from_parts(1.0 - expected.dot(&seen), expected.cross(&seen))
        };
        let mut sum = Quaternion::from_imag(Vector3::zeros());
        if let Some(up) = self.up {
            sum += part(Vector3::z(), up);
        }
        if let Some(field) = self.field {
            let h = (q * Quaternion::from_imag(field) * q.conjugate()).imag();
            sum += part(Vector3::new(0.0, libm::sqrt(h.x * h.x + h.y * h.y), h.z), field) * field_weight;
        }
        q * sum * 2.0
    }
}

/// The same direction with length 1; `None` where there is no direction.
pub(super) fn normalized(q: Quaternion<f64>) -> Option<Quaternion<f64>> {
    let length = q.norm();
    (length > 0.0 && length.is_finite()).then(|| q / length)
}
