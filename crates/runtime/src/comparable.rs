//! Attitude of an output, used to compare two stages of the same slot.

use attitude::{Quaternion, state::Attitude};
use messages::{AccelPoint, AttitudeOutput, FusedState, GyroStep};

use crate::convert;

/// An output that contains an attitude.
pub trait Comparable {
    /// Returns the attitude, body to reference, or `None` if a value is not finite.
    fn attitude(&self) -> Option<Quaternion<f64>>;
}

impl Comparable for GyroStep {
    fn attitude(&self) -> Option<Quaternion<f64>> {
        Some(convert::motion(self, 0.0)?.attitude.quaternion())
    }
}

impl Comparable for AccelPoint {
    fn attitude(&self) -> Option<Quaternion<f64>> {
        Some(Attitude::from_up(convert::up(self)?).quaternion())
    }
}

impl Comparable for FusedState {
    fn attitude(&self) -> Option<Quaternion<f64>> {
        Some(convert::attitude(self)?.quaternion())
    }
}

impl Comparable for AttitudeOutput {
    fn attitude(&self) -> Option<Quaternion<f64>> {
        let [w, x, y, z] = self.quaternion;
        let is_finite = [w, x, y, z, self.course_rad].iter().all(|number| number.is_finite());
        is_finite.then(|| Quaternion::new(w, x, y, z))
    }
}
